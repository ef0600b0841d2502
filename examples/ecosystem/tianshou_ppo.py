"""Tianshou: PPO with one network for the players of all environments, which are members of Tianshou's vector.

Run it with: python examples/ecosystem/tianshou_ppo.py
"""

from typing import Any

import numpy as np
import torch
from tianshou.algorithm import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import BaseVectorEnv, PettingZooEnv
from tianshou.trainer import OnPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic
from torch.distributions import Independent, Normal
from yardstick import EPISODES, LAW, SCENARIO, digits, law, policy_of, report

from ptne_env.envs.parallel import aec_env
from ptne_env.envs.vector import VectorParallelEnv

STEPS = 20_000


class Players(BaseVectorEnv):
    """Every player of B environments as one of B·N members, stepped by one call; all of them in every step."""

    def __init__(self, num_envs: int, **arguments: str) -> None:
        self.vector = VectorParallelEnv(SCENARIO, num_envs, **arguments)
        self.env_num = num_envs * self.vector.num_players
        self.is_async = self.is_closed = False

    def get_env_attr(self, key: str, id: Any = None) -> list[Any]:  # noqa: A002 - Tianshou's signature
        """The spaces of the members."""
        return [getattr(self.vector, f"single_{key}")] * len(self._wrap_id(id))

    def reset(self, env_id: Any = None, *, seed: int | None = None, **_: Any) -> tuple[np.ndarray, np.ndarray]:
        """Start the environments of some members, which end together."""
        members = self._wrap_id(env_id)
        mask = np.zeros(self.vector.num_envs, dtype=bool)
        mask[np.asarray(members) // self.vector.num_players] = True
        observations = self.vector.reset(seed, mask)[0].reshape(self.env_num, -1)
        return observations[members], np.array([{} for _ in members])

    def step(self, action: np.ndarray, id: Any = None) -> tuple[np.ndarray, ...]:  # noqa: A002, ARG002
        """Step all members."""
        outcome = self.vector.step(action.reshape(self.vector.num_envs, self.vector.num_players, -1))
        players = self.vector.num_players
        return (
            outcome.observations.reshape(self.env_num, -1),
            outcome.rewards.reshape(-1),
            outcome.terminated.repeat(players),
            outcome.truncated.repeat(players),
            np.array([{"env_id": member} for member in range(self.env_num)]),
        )

    def close(self) -> None:
        """Do nothing; there is nothing to release."""


def law_digits() -> np.ndarray:
    """Return the digits that the law gains in the episodes of :func:`yardstick.report`."""
    env = Players(EPISODES, **LAW)
    policy, (rows, _) = law(env.vector.layout), env.reset(seed=0)
    gained, memory, over = np.zeros(env.env_num), None, np.zeros(1)
    while not over.all():
        actions, memory = policy.predict(rows, memory)
        rows, rewards, over, _, _ = env.step(actions)
        gained += rewards
    return gained.reshape(EPISODES, -1).mean(axis=1)


def rewards_of_turns() -> np.ndarray:
    """The reward that Tianshou's ``PettingZooEnv`` gives each player for its own step, summed over ten turns."""
    env = PettingZooEnv(aec_env(SCENARIO))
    env.reset(seed=0)
    total = np.zeros(len(env.agents))
    for turn in range(10 * len(env.agents)):
        _, rewards, *_ = env.step(np.ones(len(env.agents), dtype=np.float32))
        total[turn % len(env.agents)] += rewards[turn % len(env.agents)]
    return total


def train() -> tuple[float, float]:
    """Return the digits before and after a short training."""
    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002 - Tianshou draws from it
    env = Players(16)
    env.reset(seed=0)  # the training resets without a seed, which continues these generators
    box, actions = env.observation_space[0], env.action_space[0]

    def hidden() -> Net:
        return Net(state_shape=box.shape, hidden_sizes=[64, 64], activation=torch.nn.Tanh)

    actor = ContinuousActorProbabilistic(preprocess_net=hidden(), action_shape=actions.shape, unbounded=True)
    torch.nn.init.constant_(actor.sigma_param, -1.0)
    torch.nn.init.constant_(actor.mu.model[-1].bias, 0.0)
    actor.mu.model[-1].weight.data *= 0.01
    policy = ProbabilisticActorPolicy(
        actor=actor, dist_fn=lambda mean_and_deviation: Independent(Normal(*mean_and_deviation), 1),
        action_space=actions, observation_space=box, deterministic_eval=True,
    )  # fmt: skip
    algorithm = PPO(
        policy=policy, critic=ContinuousCritic(preprocess_net=hidden()), optim=AdamOptimizerFactory(lr=1e-3),
        ent_coef=0.0, max_grad_norm=0.5, gae_lambda=0.9, gamma=0.9,
    )  # fmt: skip

    def act(rows: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            (mean, _), _ = actor(rows)
        return mean.clamp(-1, 1).numpy()

    before = digits(policy_of(act))
    collector = Collector(algorithm, env, VectorReplayBuffer(4_000, env.env_num))
    algorithm.run_training(
        OnPolicyTrainerParams(
            training_collector=collector, max_epochs=1, epoch_num_steps=STEPS, collection_step_num_env_steps=4_000,
            batch_size=500, update_step_num_repetitions=5, verbose=False, show_progress=False,
        )
    )  # fmt: skip
    return before, digits(policy_of(act))


def main() -> None:
    """The law's digits and a short training; and the reason why the route is not ``PettingZooEnv``."""
    own = rewards_of_turns()
    if own[:-1].any() or not own[-1]:
        raise SystemExit(f"PettingZooEnv gives rewards {own}; so far the last player alone had one")
    report(law_digits(), *train())


if __name__ == "__main__":
    main()
