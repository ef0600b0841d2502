"""The oracle: a law that uses information players lack."""

from __future__ import annotations

from typing import ClassVar

from ptne_env.laws.base import Law, per_step
from ptne_env.perception.observation import Interface, Observation
from ptne_env.shared.arrays import FloatArray


class Oracle(Law):
    """u^i = (x* − x^i)/Θ: every player knows the game, and moves its estimate to the equilibrium within one step.

    The input limit stays, and binds where it is small. The law needs the interface ``full``, which ``parallel_env``
    refuses, and every table marks it.
    """

    needs_full_information: ClassVar[bool] = True
    interface: ClassVar[Interface] = Interface("full")

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        return per_step(observation.relative_equilibrium, observation), memory
