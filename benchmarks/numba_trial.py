"""What numba would bring: ``pip install numba``, then ``python -m benchmarks.numba_trial``.

The two parts of a step that every game shares, and that cost most, written as numba kernels: reading actions into
inputs, and writing observations, both under the ``physical`` interface with a fixed graph. They give the same bits. The
vector environment is run with and without them, in turns. ``docs/performance.md`` says what followed.
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any
from unittest import mock

import numpy as np
import numpy.typing as npt
from numba import njit
from rich.console import Console

from benchmarks.ours import vector
from benchmarks.timing import Contender, Plan, interleave, ratio
from ptne_env import dynamics
from ptne_env.arrays import Float32Array, FloatArray, IntArray
from ptne_env.dynamics import State
from ptne_env.encoder import Encoder
from ptne_env.envs.vector import VectorParallelEnv

_TILE = 16
"""Environments whose observations are put together before they are written: a cache line of float32."""


@njit(error_model="numpy")
def _observe(
    estimates: FloatArray,
    gradients: FloatArray,
    neighbours: IntArray,
    constants: Float32Array,
    out: Float32Array,
) -> None:
    n, players, batch = estimates.shape
    slots, size = neighbours.shape[0], out.shape[2]
    tile = np.zeros((size, _TILE), np.float32)
    for i in range(players):
        for k in range(constants.shape[0]):
            tile[size - constants.shape[0] + k] = constants[k, i]
        for start in range(0, batch, _TILE):
            width = min(_TILE, batch - start)
            part = slice(start, start + width)
            tile[0, :width] = gradients[i, part]
            tile[1 : 1 + n, :width] = estimates[:, i, part]
            for d in range(slots):
                first = 1 + n + d * n
                tile[first : first + n, :width] = estimates[:, neighbours[d, i], part] - estimates[:, i, part]
            for w in range(width):
                for k in range(size):
                    out[start + w, i, k] = tile[k, w]


@njit(error_model="numpy")
def _inputs(actions: Float32Array, out: FloatArray) -> None:
    batch, players, n = actions.shape
    for i in range(players):
        for start in range(0, batch, _TILE):
            for c in range(n):
                for b in range(start, min(start + _TILE, batch)):
                    out[c, i, b] = actions[b, i, c]


def observe(encoder: Encoder, state: State, out: Float32Array) -> Float32Array:
    """:meth:`Encoder.observe` under ``physical``: one-dimensional strategies, a fixed graph, environments in lockstep."""
    world, layout = encoder.world, encoder.layout
    players = layout.num_players
    clocks = encoder._clock_table[:, :, dynamics.shared_step(state)[0]]  # noqa: SLF001 - a trial from outside
    clock = np.broadcast_to(clocks, (len(clocks), players))
    constants = np.concatenate([world.mode_weights[:, :, 0], clock, np.eye(players)]).astype(np.float32)
    _observe(state.estimates, state.own_gradients, world.neighbours, constants, out)
    return out


def inputs(encoder: Encoder, actions: npt.NDArray[np.floating], state: State) -> FloatArray:  # noqa: ARG001 - the signature
    """:meth:`Encoder.inputs` under ``physical``."""
    result = np.empty(actions.shape[::-1])
    _inputs(actions, result)
    return result


def kernels() -> ExitStack:
    """While open, the kernels are used."""
    stack = ExitStack()
    stack.enter_context(mock.patch.object(Encoder, "observe", observe))
    stack.enter_context(mock.patch.object(Encoder, "inputs", inputs))
    return stack


def check() -> None:
    """Compare observations of both ways, bit for bit."""
    envs = [VectorParallelEnv("energy", 100) for _ in range(2)]
    generator = np.random.default_rng(0)
    for env in envs:
        env.reset(seed=0)
    for _ in range(20):
        actions = generator.uniform(-9, 9, (100, 5, 5)).astype(np.float32)
        plain = envs[0].step(actions).observations
        with kernels():
            changed = envs[1].step(actions).observations
        if not np.array_equal(plain, changed):
            raise AssertionError("the kernels give other observations")


def main() -> None:
    """Check that the bits are the same, then measure."""
    check()
    console = Console()
    for batch in (1024, 8192):
        plain = vector("physical", batch)
        changed = vector("physical", batch)

        def with_kernels(step: Any = changed.step) -> None:
            with kernels():
                step()

        fast = Contender("with numba kernels", changed.agent_steps, with_kernels)
        rates = interleave([plain, fast], Plan())
        gain = ratio(rates, fast.name, plain.name)
        console.print(f"{batch} environments: {gain.median:.2f} times as fast ({gain.low:.2f} to {gain.high:.2f})")


if __name__ == "__main__":
    main()
