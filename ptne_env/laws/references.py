"""Reference policies, which stand at the ends of every table: no input, random actions, and an oracle."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from ptne_env.laws.base import Law, per_step
from ptne_env.perception.observation import Interface, Observation, ObservationLayout
from ptne_env.perception.policy import RowPolicy
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, require_count
from ptne_env.shared.counter_random import uniforms


class ZeroInput(Law):
    """A law that does nothing, u = 0: estimates and strategies stay at the start."""

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        return np.zeros_like(observation.gradient), memory


class Oracle(Law):
    """A law that knows the equilibrium: u^i = (x* − x^i)/Θ moves every estimate there within one step.

    The input limit holds for it too. It needs the interface ``full``, which ``parallel_env`` refuses, and every table
    marks it.
    """

    needs: ClassVar[tuple[str, ...]] = ("relative_equilibrium",)
    interface: ClassVar[Interface] = Interface("full")

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        return per_step(observation.relative_equilibrium, observation), memory


class RandomPolicy(RowPolicy):
    """A policy that draws actions uniformly from the action box, by a hash of the seed and of the own observation.

    So an observation gets the same action in every batch and place. The hash is the multiply-add of M. Dietzfelbinger,
    "Universal hashing and k-wise independent random variables via integer arithmetic without primes" (STACS 1996), of
    the observation's bits, and keys a stream of :mod:`ptne_env.shared.counter_random`.

    Args:
        layout: the layout of the environment, with any interface.
        seed: the seed of the policy's own draws.

    Raises:
        ValueError: for a negative seed.
    """

    def __init__(self, layout: ObservationLayout, seed: int = 0) -> None:
        self.layout, self.made_for = layout, {"size": layout.size}
        generator = np.random.default_rng(require_count("seed", seed, 0))
        self._factors = generator.integers(2**64, size=layout.size, dtype=np.uint64)
        self._offset = generator.integers(2**64, size=1, dtype=np.uint64)

    def decide(self, rows: Float32Array, memory: Any, starts: BoolArray, *, deterministic: bool) -> tuple[Any, Any]:  # noqa: ARG002 - it has no memory
        words = np.ascontiguousarray(rows).view(np.uint32)
        keys = (words @ self._factors)[..., None] + self._offset
        numbers = uniforms(keys, np.arange(self.layout.action_size, dtype=np.uint64))
        return (self.layout.action_bound * (2 * numbers - 1)).astype(np.float32), memory
