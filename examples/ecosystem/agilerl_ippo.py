"""AgileRL: its asynchronous vector of PettingZoo environments, and IPPO with a network for each player.

Run it with: python examples/ecosystem/agilerl_ippo.py
"""

from functools import partial

import numpy as np
import torch
from agilerl.algorithms import IPPO
from agilerl.training.train_multi_agent_on_policy import train_multi_agent_on_policy
from agilerl.vector import AsyncPettingZooVecEnv
from yardstick import EPISODES, LAW, SCENARIO, digits, law, policy_of, report

import ptne_env

LAYOUT = ptne_env.parallel_env(SCENARIO).layout
STEPS = 8_000
NETWORK = {"encoder_config": {"hidden_size": [64]}, "head_config": {"hidden_size": [64]}}


class OwnNetworks(IPPO):
    """IPPO with a network for each player.

    AgileRL groups agents by the part of their names before the last ``_`` and shares a network in each group. IPPO of
    2.58.0 trains a group of several agents on wrong pairs: observations and actions stand agent by agent, advantages
    and probabilities step by step.
    """

    def get_group_id(self, agent_id: str) -> str:
        """Return every agent as a group of its own."""
        return agent_id


def vector(num_envs: int, **arguments: str) -> AsyncPettingZooVecEnv:
    """Return the environments, each in a process; AgileRL resets one in the step that ends it."""
    return AsyncPettingZooVecEnv([partial(ptne_env.parallel_env, SCENARIO, **arguments)] * num_envs)


def law_digits() -> np.ndarray:
    """Return the digits that the law gains in the episodes of :func:`yardstick.report`."""
    env = vector(EPISODES, **LAW)
    policy = law(ptne_env.parallel_env(SCENARIO, **LAW).layout)
    observations, _ = env.reset(seed=0)
    gained, over = np.zeros(EPISODES), np.zeros(EPISODES, dtype=bool)
    while not over.any():  # the episodes of a scenario end together unless one diverges
        actions, _ = policy.predict(np.concatenate([observations[agent] for agent in env.agents]))
        parts = dict(zip(env.agents, np.split(actions, len(env.agents)), strict=True))
        observations, rewards, terminated, _, _ = env.step(parts)
        gained, over = gained + np.mean(list(rewards.values()), axis=0), terminated["player_0"]
    env.close()
    return gained


def train() -> tuple[float, float]:
    """Return the digits before and after training."""
    env = vector(8)
    env.reset(seed=0)  # the training resets without a seed, which continues these generators
    agent = OwnNetworks(
        [env.single_observation_space(player) for player in env.agents],
        [env.single_action_space(player) for player in env.agents],
        env.agents, net_config=NETWORK, batch_size=100, lr=1e-3, learn_step=400, gamma=0.9, gae_lambda=0.9,
        ent_coef=0.0, update_epochs=5,
    )  # fmt: skip
    for actor in agent.actors.values():
        # ``action_std_init`` is the logarithm of the deviation and must not be negative: a deviation of 1 or more.
        torch.nn.init.constant_(actor.head_net.log_std, -1.0)

    def mean(player: str, rows: torch.Tensor) -> torch.Tensor:
        agent.actors[player](rows)
        return agent.actors[player].head_net.dist.mu.clamp(-1, 1)

    @torch.no_grad()
    def act(rows: np.ndarray) -> np.ndarray:
        of_all = torch.stack([mean(player, torch.from_numpy(rows)) for player in env.agents]).numpy()
        return of_all[LAYOUT.select(rows, "player").argmax(axis=1), np.arange(len(rows))]

    before = digits(policy_of(act))
    train_multi_agent_on_policy(
        env, SCENARIO, "IPPO", [agent], max_steps=STEPS, evo_steps=STEPS, eval_steps=1, verbose=False
    )
    return before, digits(policy_of(act))


def main() -> None:
    """Print the law's digits through the vector and those of a short training."""
    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002 - AgileRL draws from it
    report(law_digits(), *train())


if __name__ == "__main__":
    main()
