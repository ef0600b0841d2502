"""PufferLib: environments that write into the arrays of its vectors, all by one call or one at a time.

It needs PufferLib's vectors alone, which the package ``pufferlib-core`` has.

Run it with: python examples/ecosystem/pufferlib_vector.py
"""

from collections.abc import Callable, Mapping

import numpy as np
import pufferlib.vector
from pufferlib.emulation import PettingZooPufferEnv
from yardstick import ENVIRONMENTS, EPISODES, SCENARIO, law, report, speeds

import ptne_env
from ptne_env.envs.puffer import PlayerBufferEnv

LAYOUT = ptne_env.parallel_env(SCENARIO).layout
Buffers = Mapping[str, np.ndarray]


class Players(PlayerBufferEnv, pufferlib.PufferEnv):
    """Ours, with the type that PufferLib asks for."""


def stepped_together(num_envs: int, workers: int) -> pufferlib.vector.Serial:
    """Workers that step their share of the environments by one call."""

    def make(buf: Buffers | None = None, seed: int | None = None) -> Players:
        return Players(SCENARIO, num_envs // workers, buf=buf, seed=seed)

    return pufferlib.vector.make(make, backend=pufferlib.vector.Serial, num_envs=workers)


def one_at_a_time(num_envs: int) -> pufferlib.vector.Serial:
    """PettingZoo environments through PufferLib's emulation."""

    def make(buf: Buffers | None = None, seed: int = 0) -> PettingZooPufferEnv:
        return PettingZooPufferEnv(env_creator=lambda: ptne_env.parallel_env(SCENARIO), buf=buf, seed=seed)

    return pufferlib.vector.make(make, backend=pufferlib.vector.Serial, num_envs=num_envs)


def law_digits(vector: pufferlib.vector.Serial) -> list[float]:
    """The digits that the law gains; ``reset(seed=0)`` starts the episodes 0, 1, …."""
    policy = law(LAYOUT)
    observations, _ = vector.reset(seed=0)
    gained, over = np.zeros(vector.num_agents), np.zeros(vector.num_agents, dtype=bool)
    while not over.all():
        observations, rewards, over, *_ = vector.step(policy.predict(observations)[0])
        gained += rewards
    return gained.reshape(EPISODES, -1).mean(axis=1).tolist()


def stepping(vector: pufferlib.vector.Serial) -> Callable[[], int]:
    """A function that steps all environments and returns the number of agent-steps."""
    vector.reset(seed=0)
    actions = np.zeros(vector.action_space.shape, dtype=np.float32)
    return lambda: len(vector.step(actions)[1])


def main() -> None:
    """The law's digits and the speed, of both routes."""
    slow, fast = speeds(stepping(one_at_a_time(ENVIRONMENTS)), stepping(stepped_together(ENVIRONMENTS, workers=1)))
    report(law_digits(one_at_a_time(EPISODES)), what="one at a time", speed=slow)
    report(law_digits(stepped_together(EPISODES, workers=2)), what="stepped together", speed=fast)


if __name__ == "__main__":
    main()
