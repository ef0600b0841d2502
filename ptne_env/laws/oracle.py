"""The oracle: a law that uses information players lack."""

from __future__ import annotations

from typing import ClassVar

from ptne_env.laws.base import Law, per_step
from ptne_env.perception.observation import Interface, Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, require_positive


class CentralisedOracle(Law):
    """u^i = (x − x^i)/Θ − g F(x): pseudo-gradient play dx/dτ = −g F(x) on the real strategies x.

    Every player knows the real strategies and moves its estimates onto them within the step. The law needs the
    interface ``full``, which ``parallel_env`` refuses, and every table marks it; the input limit stays.

    Args:
        layout: with :attr:`interface`.
        gradient_gain: g > 0.

    Raises:
        ValueError: for another interface, or a gain that is not positive.
    """

    needs_full_information: ClassVar[bool] = True
    interface: ClassVar[Interface] = Interface("full")

    def __init__(self, layout: ObservationLayout, gradient_gain: float = 1.0) -> None:
        super().__init__(layout)
        self.gradient_gain = require_positive("gradient_gain", gradient_gain)

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        descent = self.gradient_gain * observation.pseudo_gradient
        return per_step(observation.relative_strategies, observation) - descent, memory
