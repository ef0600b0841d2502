"""PufferLib's interface: two workers write into one array of the trainer, and nothing is copied.

It runs without PufferLib, whose pins admit no Gymnasium of today. Where PufferLib asks for its own type:
``class Players(PlayerBufferEnv, pufferlib.PufferEnv)``.

Run it with: python examples/ecosystem/pufferlib_buffers.py
"""

from collections.abc import Callable

import numpy as np
from yardstick import ENVIRONMENTS, EPISODES, SCENARIO, law, report, speeds

import ptne_env
from ptne_env.envs.puffer import PlayerBufferEnv

WORKERS = 2
Buffers = dict[str, np.ndarray]


def buffers(agents: int, layout: ptne_env.ObservationLayout) -> Buffers:
    """The arrays of PufferLib's trainer."""
    return {
        "observations": np.zeros((agents, layout.size), dtype=np.float32),
        "rewards": np.zeros(agents, dtype=np.float32),
        "terminals": np.zeros(agents, dtype=bool),
        "truncations": np.zeros(agents, dtype=bool),
        "masks": np.ones(agents, dtype=bool),
        "actions": np.zeros((agents, layout.action_size), dtype=np.float32),
    }


class OneAtATime:
    """PettingZoo environments, each of which is written into its part of the arrays, as PufferLib's emulation does."""

    def __init__(self, scenario: str, num_envs: int, *, buf: Buffers, seed: int) -> None:
        """Environment b gets seed · B + b."""
        self.envs = [ptne_env.parallel_env(scenario) for _ in range(num_envs)]
        self.parts = [{name: array[5 * index :][:5] for name, array in buf.items()} for index in range(num_envs)]
        self.actions, self.seed = buf["actions"], seed * num_envs

    def async_reset(self) -> None:
        """Start all episodes."""
        for index, (env, part) in enumerate(zip(self.envs, self.parts, strict=True)):
            part["observations"][:] = list(env.reset(seed=self.seed + index)[0].values())

    def send(self, actions: np.ndarray) -> None:  # noqa: ARG002 - they are those of the parts
        """Step one environment after the other."""
        for env, part in zip(self.envs, self.parts, strict=True):
            observations, *results = env.step(dict(zip(env.agents, part["actions"], strict=True)))
            for name, values in zip(("rewards", "terminals", "truncations"), results, strict=False):
                part[name][:] = list(values.values())
            if not env.agents:
                observations, _ = env.reset()
            part["observations"][:] = list(observations.values())


Worker = type[OneAtATime] | type[PlayerBufferEnv]


def law_digits(kind: Worker) -> list[float]:
    """The digits that the law gains; each worker has a part of the arrays, and the next seed."""
    policy = law(ptne_env.parallel_env(SCENARIO).layout)
    together, share = buffers(5 * EPISODES, policy.layout), 5 * EPISODES // WORKERS
    parts = [{name: array[k * share :][:share] for name, array in together.items()} for k in range(WORKERS)]
    workers = [kind(SCENARIO, EPISODES // WORKERS, buf=part, seed=seed) for seed, part in enumerate(parts)]
    for worker in workers:
        worker.async_reset()
    gained = np.zeros(5 * EPISODES)
    while not together["terminals"].all():
        together["actions"][:], _ = policy.predict(together["observations"])
        for worker in workers:
            worker.send(worker.actions)
        gained += together["rewards"]
    return gained.reshape(EPISODES, 5).mean(axis=1).tolist()


def stepping(kind: Worker) -> Callable[[], int]:
    """A function that steps all environments once and returns the number of agent-steps."""
    agents = 5 * ENVIRONMENTS
    worker = kind(SCENARIO, ENVIRONMENTS, buf=buffers(agents, ptne_env.parallel_env(SCENARIO).layout), seed=0)
    worker.async_reset()

    def step() -> int:
        worker.send(worker.actions)
        return agents

    return step


def main() -> None:
    """The law's digits and the speed of both kinds of worker."""
    slow, fast = speeds(stepping(OneAtATime), stepping(PlayerBufferEnv))
    report(law_digits(OneAtATime), what="one at a time", speed=slow)
    report(law_digits(PlayerBufferEnv), what="stepped together", speed=fast)


if __name__ == "__main__":
    main()
