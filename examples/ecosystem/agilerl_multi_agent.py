"""AgileRL: its asynchronous vector of PettingZoo environments, IPPO and MADDPG with a network for each player.

Run it with: python examples/ecosystem/agilerl_multi_agent.py
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from agilerl.algorithms import IPPO, MADDPG
from agilerl.components.replay_buffer import ReplayBuffer
from agilerl.training.train_multi_agent_off_policy import train_multi_agent_off_policy
from agilerl.training.train_multi_agent_on_policy import train_multi_agent_on_policy
from agilerl.vector import AsyncPettingZooVecEnv
from gymnasium.spaces import Box
from yardstick import EPISODES, SCENARIO, TASK, Acting, digits, law, report

import ptne_env

STEPS = 8_000
NETWORK = {"encoder_config": {"hidden_size": [64]}, "head_config": {"hidden_size": [64]}}


def vector(num_envs: int, **arguments: str) -> AsyncPettingZooVecEnv:
    """The environments, each in a process; AgileRL resets one in the step that ends it."""
    return AsyncPettingZooVecEnv([partial(ptne_env.parallel_env, SCENARIO, **arguments)] * num_envs)


def spaces(env: AsyncPettingZooVecEnv) -> tuple[list[Box], list[Box]]:
    """Of the players' observations and actions."""
    return (
        [env.single_observation_space(agent) for agent in env.agents],
        [env.single_action_space(agent) for agent in env.agents],
    )


def law_digits() -> np.ndarray:
    """Digits that the law gains in the episodes of :func:`yardstick.report`."""
    env = vector(EPISODES)
    policy = law(ptne_env.parallel_env(SCENARIO).layout)
    observations, _ = env.reset(seed=0)
    gained, memory, over = np.zeros(EPISODES), None, np.zeros(EPISODES, dtype=bool)
    while not over.all():
        rows = np.concatenate([observations[agent] for agent in env.agents])
        actions, memory = policy.predict(rows, memory)
        parts = dict(zip(env.agents, np.split(actions, len(env.agents)), strict=True))
        observations, rewards, over, _, _ = env.step(parts)
        gained += np.mean(list(rewards.values()), axis=0)
        over = over["player_0"]
    env.close()
    return gained


class OwnNetworks:
    """A network for each player. AgileRL groups agents by their names and shares a network in each group.

    IPPO of 2.58.0 trains a group of several agents on wrong pairs: observations and actions stand agent by agent,
    advantages and probabilities step by step.
    """

    def get_group_id(self, agent_id: str) -> str:
        """Every agent is a group."""
        return agent_id


class OwnIPPO(OwnNetworks, IPPO):
    """IPPO with a network for each player."""


class OwnMADDPG(OwnNetworks, MADDPG):
    """MADDPG with a network for each player."""


def acting(decide: Callable[[str, torch.Tensor], torch.Tensor], agents: list[str]) -> Acting:
    """A policy from the actions (R, action size) that the network of an agent takes; each row has its player's."""

    def act(rows: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            answers = torch.stack([decide(agent, torch.from_numpy(rows)) for agent in agents])
        player = rows[:, -len(agents) :].argmax(axis=1)
        return answers.numpy()[player, np.arange(len(rows))]

    return Acting(act)


def ippo(env: AsyncPettingZooVecEnv) -> tuple[float, float]:
    """Digits before and after a training."""
    agent = OwnIPPO(
        *spaces(env), env.agents, net_config=NETWORK, batch_size=100, lr=1e-3, learn_step=400, gamma=0.9,
        gae_lambda=0.9, ent_coef=0.0, update_epochs=5,
    )  # fmt: skip

    def mean(player: str, rows: torch.Tensor) -> torch.Tensor:
        agent.actors[player](rows)
        return agent.actors[player].head_net.dist.mu.clamp(-1, 1)

    for actor in agent.actors.values():
        # ``action_std_init`` is the logarithm of the deviation and must not be negative: a deviation of 1 or more.
        torch.nn.init.constant_(actor.head_net.log_std, -1.0)
    policy = acting(mean, env.agents)
    before = digits(policy)
    train_multi_agent_on_policy(
        env, SCENARIO, "IPPO", [agent], max_steps=STEPS, evo_steps=STEPS, eval_steps=1, verbose=False
    )
    return before, digits(policy)


def maddpg(env: AsyncPettingZooVecEnv) -> tuple[float, float]:
    """Digits before and after a training.

    With AgileRL's own settings digits fall: its actors learn ten times more slowly than its critics, here a hundred
    times, and its noise is small and drifts, while here it is wide and new in every step.
    """
    agent = OwnMADDPG(
        *spaces(env), env.agents, net_config=NETWORK, batch_size=256, lr_actor=3e-5, lr_critic=3e-3, learn_step=8,
        gamma=0.8, O_U_noise=False, expl_noise=0.4, vect_noise_dim=env.num_envs,
    )  # fmt: skip
    policy = acting(lambda player, rows: agent.actors[player](rows), env.agents)
    before = digits(policy)
    train_multi_agent_off_policy(
        env, SCENARIO, "MADDPG", [agent], ReplayBuffer(STEPS), max_steps=STEPS, evo_steps=STEPS, eval_steps=1,
        verbose=False,
    )  # fmt: skip
    return before, digits(policy)


def main() -> None:
    """The law's digits through the vector, and two trainings."""
    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002 - AgileRL draws from it
    gained = law_digits()
    env = vector(8, **TASK)
    env.reset(seed=0)  # the training resets without a seed, which continues these generators
    report(gained, *ippo(env), "IPPO")
    env = vector(8, **TASK)
    env.reset(seed=1)
    report(gained, *maddpg(env), "MADDPG")


if __name__ == "__main__":
    main()
