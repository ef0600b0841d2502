"""Speed of the world on JAX beside numpy and peers, as tables: ``python -m benchmarks.speed_jax [--quick]``.

A call makes the next 100 steps of all environments in compiled scans over tiles of at most 1,024 environments, one
thread per core. A step moves, observes, pays the reward of digits and starts episodes that are over again; all
observations and rewards are summed up, because XLA drops what nobody reads. All contenders run in one process, in
turns. Missing peers are left out and named. ``--quick`` only checks that everything runs.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from statistics import median
from typing import Any, NamedTuple

# Every tile has a thread: a second level of threads, inside XLA, would halve the speed. JAX reads this when it starts.
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")

import jax
import jax.numpy as jnp
import numpy as np

import ptne_env.jax
from benchmarks import peers, speed
from benchmarks.timing import Contender, interleave
from ptne_env import FactorySpec

STEPS, TILE, THREADS, POOL = 100, 1024, os.cpu_count() or 1, 4
SCENARIO, COUNTS = "random-energy-switching", (1, 64, 1024, 8192, 65536)
MOST_OF_PEERS = 8192
"""Environments beyond which peers take minutes and are no faster."""


class Twin(NamedTuple):
    """A contender, the seconds of its compilation, and bytes of a state and its observations per environment."""

    contender: Contender
    compile_seconds: float
    size: int


def ours(num_envs: int, name: str = "ptne_env on JAX", scenario: str = SCENARIO, **changes: Any) -> Twin:
    """The world on JAX, in as many environments, with some fields of the scenario changed."""
    world = ptne_env.jax.JaxWorld(scenario, interface="physical", **changes)
    tile = min(TILE, max(1, num_envs // THREADS)) if jax.default_backend() == "cpu" else num_envs

    first = jax.jit(lambda key: world.reset(key, tile))
    shape = jax.eval_shape(first, jax.random.key(0)).estimates.shape
    inputs = jax.random.uniform(jax.random.key(1), (POOL, *shape), jnp.float32, -0.1, 0.1)

    @jax.jit
    def run(state: Any, key: jax.Array) -> Any:
        def step(carry: tuple[Any, Any], now: tuple[jax.Array, jax.Array]) -> tuple[Any, jax.Array]:
            (before, seen), (number, key) = carry, now
            after = world.step(before, inputs[number % POOL])
            paid = world.rewards(before, after)
            after = world.restarted(key, after)
            return (after, seen + world.observe(after)), paid

        carry = state, jnp.zeros_like(world.observe(state))
        (state, seen), paid = jax.lax.scan(step, carry, (jnp.arange(STEPS), jax.random.split(key, STEPS)))
        return state, seen, paid.sum(0)

    keys, pool = jax.random.split(jax.random.key(0), max(1, num_envs // tile)), ThreadPoolExecutor(THREADS)
    states = [first(key) for key in keys]
    began = time.perf_counter()
    run.lower(states[0], keys[0]).compile()
    seconds = time.perf_counter() - began
    shapes = jax.eval_shape(lambda key: (state := world.reset(key, TILE), world.observe(state)), keys[0])
    arrays = [leaf for leaf in jax.tree.leaves(shapes) if leaf.shape[-1:] == (TILE,)]
    size = sum(leaf.size * leaf.dtype.itemsize for leaf in arrays) // TILE
    agents = tile * len(keys) * world.layout.num_players

    def advanced(state: Any, key: jax.Array) -> Any:
        return jax.block_until_ready(run(state, key))[0]

    def move() -> None:
        states[:] = pool.map(advanced, states, keys)

    return Twin(Contender(name, agents * STEPS, move), seconds, size)


def copied(num_envs: int, size: int) -> Contender:
    """A copy of as many bytes as a step must read and write: the limit of any implementation without a cache."""
    source = np.zeros(num_envs * size, dtype=np.uint8)
    target = source.copy()
    return Contender("a copy of the bytes of a step", num_envs * peers.PLAYERS, lambda: np.copyto(target, source))


def others(num_envs: int) -> tuple[list[Contender], list[str]]:
    """Our numpy path and the peers, and notes on those that are missing."""
    makers = [lambda: speed.vector("physical", num_envs), lambda: peers.jaxmarl(num_envs, STEPS)]
    if num_envs == 1:
        makers = [lambda: speed.single("physical"), peers.mpe2, *makers[1:]]
    found, notes = [], []
    for make in (*makers, lambda: peers.vmas(num_envs)):
        try:
            made: Any = make()
            found += made if isinstance(made, list) else [made]
        except peers.MissingPeerError as error:
            notes.append(str(error))
    return found, notes


def row(title: str, found: Sequence[float], twin: Twin | None = None) -> str:
    """A line of a table."""
    cells = [f"{twin.compile_seconds:.1f}", f"{twin.size:,}"] if twin else ["", ""]
    return f"| {title} | {median(found):,.0f} | {min(found):,.0f} – {max(found):,.0f} | {' | '.join(cells)} |"


def table(counts: Sequence[int], turns: int, seconds: float) -> list[str]:
    """Speed by number of environments, beside peers."""
    lines = [f"| Agent-steps per second, {jax.devices()[0].device_kind} | median | range | compile, s | bytes |"]
    lines.append("| --- | ---: | --- | ---: | ---: |")
    missing: list[str] = []
    for count in counts:
        twin, (rivals, notes) = ours(count), others(count) if count <= MOST_OF_PEERS else ([], [])
        rates = interleave([twin.contender, *rivals, copied(count, twin.size)], turns, seconds)
        missing += [note for note in notes if note not in missing]
        for name, found in rates.items():
            lines.append(row(f"{count:,} environments: {name}", found, twin if name == twin.contender.name else None))
    count = min(TILE, counts[-1])
    for title, changes in growths().items():
        twin = ours(count, f"{count:,} environments, {title}", **changes)
        (found,) = interleave([twin.contender], turns, seconds).values()
        lines.append(row(twin.contender.name, found, twin))
    if jax.default_backend() == "cpu":
        lines.append("| an accelerator | not measured | | | |")
    return [*lines, *(f"\n{note}" for note in missing)]


def growths() -> dict[str, dict[str, Any]]:
    """Worlds of other sizes and with other parts, by title."""
    part = FactorySpec.of
    found: dict[str, dict[str, Any]] = {"noise": {"channel": part("channel:noise", std=0.001)}}
    for players, offsets in ((5, (1,)), (10, (1,)), (20, (1,)), (10, (1, 2)), (10, (1, 2, 3))):
        topology = part("topology:circulant", players=players, offsets=offsets)
        game = part("game:random-energy", players=players)
        found[f"N = {players}, D = {2 * len(offsets)}"] = {"topology": topology, "game": game}
    return found


def episode(num_envs: int) -> str:
    """A whole episode under the static law, in one call."""
    world = ptne_env.jax.JaxWorld(SCENARIO, interface="physical")
    policy = ptne_env.jax.static(world.layout)
    run = jax.jit(lambda key: ptne_env.jax.rollout(world, policy, key, num_envs).digits[-1])
    times = []
    for seed in range(4):
        began = time.perf_counter()
        jax.block_until_ready(run(jax.random.key(seed)))
        times.append(time.perf_counter() - began)
    return f"An episode of {num_envs:,} games under the static law takes {min(times[1:]):.2f} s in one call."


def seeds(count: int = 16, updates: int = 20) -> str:
    """Trainings of several seeds at once, against one."""
    world = ptne_env.jax.JaxWorld(SCENARIO)

    def act(params: Any, observation: jax.Array, memory: Any) -> tuple[jax.Array, Any]:
        return jnp.tanh(params["out"] @ jnp.tanh(params["in"] @ observation)), memory

    def loss(params: Any, key: jax.Array) -> jax.Array:
        return -ptne_env.jax.rollout(world, ptne_env.jax.JaxPolicy(act, params), key, 16, steps=20).rewards.mean()

    def train(key: jax.Array) -> jax.Array:
        shapes = {"in": (64, world.layout.size), "out": (world.layout.action_size, 64)}
        params = {name: jax.random.normal(key, shape, jnp.float32) / 10 for name, shape in shapes.items()}

        def update(params: Any, key: jax.Array) -> tuple[Any, jax.Array]:
            value, slope = jax.value_and_grad(loss)(params, key)
            return jax.tree.map(lambda old, new: old - 0.01 * new, params, slope), value

        return jax.lax.scan(update, params, jax.random.split(key, updates))[1]

    times = []
    for run, keys in (
        (jax.jit(train), jax.random.key(0)),
        (jax.jit(jax.vmap(train)), jax.random.split(jax.random.key(0), count)),
    ):
        jax.block_until_ready(run(keys))
        began = time.perf_counter()
        jax.block_until_ready(run(keys))
        times.append(time.perf_counter() - began)
    return f"{count} trainings at once take {times[1] / times[0]:.1f} times as long as one."


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed_jax", description=__doc__.split(":")[0])
    parser.add_argument("--quick", action="store_true", help="only check that everything runs")
    is_quick = parser.parse_args(arguments).quick
    jax.config.update("jax_enable_x64", val=True)
    lines = table((1, 8), 1, 0.02) if is_quick else table(COUNTS, 3, 1.0)
    print("\n".join(lines), episode(8 if is_quick else TILE), seeds(), sep="\n\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
