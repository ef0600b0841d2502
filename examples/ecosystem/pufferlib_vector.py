"""PufferLib: environments that write into the arrays of its vectors, all by one call or one at a time.

It needs PufferLib's vectors alone, which the package ``pufferlib-core`` has.

Run it with: python examples/ecosystem/pufferlib_vector.py
"""

from collections.abc import Mapping

import numpy as np
import pufferlib.vector
from pufferlib.emulation import PettingZooPufferEnv
from yardstick import EPISODES, LAW, SCENARIO, law, report

import ptne_env
from ptne_env.envs.vector import VectorParallelEnv

LAYOUT = ptne_env.parallel_env(SCENARIO, **LAW).layout
Buffers = Mapping[str, np.ndarray]


class Players(pufferlib.PufferEnv):
    """A vector of B·N agents, the players of B environments, in the arrays of the trainer."""

    def __init__(self, num_envs: int, buf: Buffers | None = None, seed: int | None = None) -> None:
        self.vector, self.start = VectorParallelEnv(SCENARIO, num_envs, **LAW), seed
        self.num_agents = num_envs * self.vector.num_players
        self.single_observation_space = self.vector.single_observation_space
        self.single_action_space = self.vector.single_action_space
        super().__init__(buf)

    def reset(self, seed: int | None = None) -> tuple[np.ndarray, list]:
        """Start all episodes; successive seeds of workers have no episode in common."""
        seed, self.start = self.start if seed is None else seed, None
        first = None if seed is None else seed * self.vector.num_envs
        self.observations[:] = self.vector.reset(first)[0].reshape(self.num_agents, -1)
        return self.observations, []

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, list]:
        """Step all environments, and reset those that end."""
        players = self.vector.num_players
        outcome = self.vector.step(np.reshape(actions, (self.vector.num_envs, players, -1)))
        over, observations = outcome.terminated | outcome.truncated, outcome.observations
        if over.any():
            observations, _ = self.vector.reset(mask=over)
        self.observations[:] = observations.reshape(self.num_agents, -1)
        self.rewards[:] = outcome.rewards.reshape(-1)
        self.terminals[:], self.truncations[:] = outcome.terminated.repeat(players), outcome.truncated.repeat(players)
        return self.observations, self.rewards, self.terminals, self.truncations, []

    def close(self) -> None:
        """Do nothing; there is nothing to release."""


def stepped_together(num_envs: int, workers: int) -> pufferlib.vector.Serial:
    """Workers that step their share of the environments by one call."""

    def make(buf: Buffers | None = None, seed: int | None = None) -> Players:
        return Players(num_envs // workers, buf, seed)

    return pufferlib.vector.make(make, backend=pufferlib.vector.Serial, num_envs=workers)


def one_at_a_time(num_envs: int) -> pufferlib.vector.Serial:
    """PettingZoo environments through PufferLib's emulation."""

    def make(buf: Buffers | None = None, seed: int = 0) -> PettingZooPufferEnv:
        return PettingZooPufferEnv(env_creator=lambda: ptne_env.parallel_env(SCENARIO, **LAW), buf=buf, seed=seed)

    return pufferlib.vector.make(make, backend=pufferlib.vector.Serial, num_envs=num_envs)


def law_digits(vector: pufferlib.vector.Serial) -> list[float]:
    """Return the digits that the law gains; ``reset(seed=0)`` starts the episodes 0, 1, …."""
    policy = law(LAYOUT)
    observations, _ = vector.reset(seed=0)
    gained, over = np.zeros(vector.num_agents), np.zeros(vector.num_agents, dtype=bool)
    while not over.all():
        observations, rewards, over, *_ = vector.step(policy.predict(observations)[0])
        gained += rewards
    return gained.reshape(EPISODES, -1).mean(axis=1).tolist()


def main() -> None:
    """Print the law's digits by both routes."""
    report(law_digits(one_at_a_time(EPISODES)), what="one at a time")
    report(law_digits(stepped_together(EPISODES, workers=2)), what="stepped together")


if __name__ == "__main__":
    main()
