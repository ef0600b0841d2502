"""Speed of our environments and of their peers, as a table in Markdown: ``python -m benchmarks.speed [--quick]``.

Agent-steps per second with random actions and full observations. Contenders take turns; figures are medians with their
range. Missing peers are left out and named. The run takes about two minutes on two cores; ``--quick`` takes seconds and
only checks that everything runs.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from statistics import median
from typing import Any

import numpy as np

from benchmarks import peers
from benchmarks.timing import Contender, interleave
from ptne_env import parallel_env
from ptne_env.envs.vector import VectorParallelEnv
from ptne_env.perception.fields import InterfaceKind
from ptne_env.shared.arrays import Float32Array

INTERFACES: tuple[InterfaceKind, ...] = ("scaled", "physical")

ENVIRONMENTS = {"vector": 1024, "Stable-Baselines3": 64, "TorchRL": 256}
"""Environments stepped together."""


def actions(bound: float, shape: tuple[int, ...]) -> Iterator[Float32Array]:
    """Endless random actions from the whole box; their mean is 0, so that estimates diffuse and do not drift."""
    generator = np.random.default_rng(0)
    half = [generator.uniform(-bound, bound, shape).astype(np.float32) for _ in range(16)]
    endless: Iterator[Float32Array] = peers.iter_forever([*half, *(-batch for batch in half)])
    return endless


def single(interface: InterfaceKind) -> Contender:
    """One PettingZoo environment of the scenario ``energy``."""
    env = parallel_env("energy", interface=interface)
    env.reset(seed=0)
    agents = env.possible_agents
    tables = actions(env.layout.action_bound, (len(agents), env.layout.action_size))
    turn = peers.iter_forever([dict(zip(agents, next(tables), strict=True)) for _ in range(256)])

    def step() -> None:
        if not env.agents:
            env.reset()
        env.step(next(turn))

    return Contender(f"ptne_env, {interface}", len(agents), step)


def vector(interface: InterfaceKind, num_envs: int) -> Contender:
    """The vector environment; finished episodes are reset."""
    env = VectorParallelEnv("energy", num_envs, interface=interface)
    env.reset(seed=0)
    turn = actions(env.layout.action_bound, (num_envs, env.num_players, env.layout.action_size))

    def step() -> None:
        outcome = env.step(next(turn))
        over = outcome.terminated | outcome.truncated
        if over.any():
            env.reset(mask=over)

    return Contender(f"ptne_env, {interface}", num_envs * env.num_players, step)


def players(interface: InterfaceKind, num_envs: int) -> Contender:
    """The ``VecEnv`` of Stable-Baselines3.

    Raises:
        MissingPeerError: when Stable-Baselines3 is not installed.
    """
    try:
        from ptne_env.envs.sb3 import PlayerVecEnv
    except ImportError as error:
        raise peers.MissingPeerError(f"the adapter of Stable-Baselines3 is left out: {error}") from error
    env = PlayerVecEnv("energy", num_envs, interface=interface, seed=0)
    env.reset()
    turn = actions(env.layout.action_bound, (env.num_envs, env.layout.action_size))
    return Contender(f"ptne_env, {interface}", env.num_envs, lambda: env.step(next(turn)))


def tensordicts(interface: InterfaceKind, num_envs: int, *, is_wrapped: bool = False) -> Contender:
    """TorchRL's batched environment, or as many environments in series, each through its wrapper of PettingZoo.

    Raises:
        MissingPeerError: when TorchRL is not installed.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the wrapper asks for an older PettingZoo
        try:
            from torchrl.envs import PettingZooWrapper, SerialEnv

            from ptne_env.envs.torchrl import TorchRLEnv
        except ImportError as error:
            message = f"TorchRL is left out: {error}; to compare with it: pip install torchrl"
            raise peers.MissingPeerError(message) from error
        env = (
            SerialEnv(num_envs, lambda: PettingZooWrapper(parallel_env("energy", interface=interface)))
            if is_wrapped
            else TorchRLEnv("energy", num_envs, interface=interface)
        )
        following = env.reset()
    pool = [env.full_action_spec.rand() for _ in range(16)]
    turn, agents = peers.iter_forever(pool), pool[0]["player", "action"].shape[:-1].numel()

    def step() -> None:
        nonlocal following
        _, following = env.step_and_maybe_reset(following.update(next(turn)))

    return Contender("TorchRL's PettingZooWrapper" if is_wrapped else f"ptne_env, {interface}", agents, step)


def groups(*, is_quick: bool) -> Iterator[tuple[str, list[Contender], list[str]]]:
    """Title, contenders and notes on missing peers of each group; the first peer comes after ours."""
    counts = dict.fromkeys(ENVIRONMENTS, 4) if is_quick else ENVIRONMENTS
    batch, slots, tensors = counts.values()
    kinds: dict[str, tuple[Callable[[InterfaceKind], Contender], Callable[[], Any]]] = {
        "one environment": (single, peers.mpe2),
        f"{batch} environments": (lambda kind: vector(kind, batch), lambda: peers.vmas(batch)),
        f"Stable-Baselines3, {slots} environments": (lambda kind: players(kind, slots), lambda: peers.supersuit(slots)),
        f"TorchRL, {tensors} environments": (
            lambda kind: tensordicts(kind, tensors),
            lambda: tensordicts("physical", tensors, is_wrapped=True),
        ),
    }
    for title, (ours, theirs) in kinds.items():
        contenders: list[Contender] = []
        notes: list[str] = []
        for build in (lambda ours=ours: [ours(kind) for kind in INTERFACES], theirs):
            try:
                built = build()
                contenders += built if isinstance(built, list) else [built]
            except peers.MissingPeerError as error:
                notes.append(str(error))
        yield title, contenders, notes


def table(*, is_quick: bool = False) -> list[str]:
    """The lines of the table, and the notes."""
    lines = ["| Agent-steps per second | median | range | times the fastest peer |", "| --- | ---: | --- | ---: |"]
    left_out = []
    for title, contenders, notes in groups(is_quick=is_quick):
        left_out += notes
        rates = interleave(contenders, *((2, 0.02) if is_quick else (5, 1.0)))
        others = [name for name in rates if not name.startswith("ptne_env")]
        best = max(others, key=lambda name: median(rates[name]), default=None)
        for name, found in rates.items():
            times = ""
            if best and name not in others:
                times = f"{median(mine / peer for mine, peer in zip(found, rates[best], strict=True)):.3g}"
            lines.append(
                f"| {title}: {name} | {median(found):,.0f} | {min(found):,.0f} – {max(found):,.0f} | {times} |"
            )
    return [*lines, *(f"\n{note}" for note in left_out)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed", description=__doc__.split(":")[0])
    parser.add_argument("--quick", action="store_true", help="only check that everything runs")
    print("\n".join(table(is_quick=parser.parse_args(arguments).quick)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
