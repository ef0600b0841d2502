"""Laws that only the tests run."""

import numpy as np

from ptne_env.laws import Law, Static


class Damped(Static):
    """The static law, divided by 1 + Θ/T + Δt/T: it looks at its step in a way of its own."""

    def _inputs(self, reading, memory):
        inputs, memory = super()._inputs(reading, memory)
        return inputs / (1 + (reading.theta + reading.dt) / self.layout.deadline), memory


class Sign(Law):
    """u = −sign of the gradient."""

    def _inputs(self, reading, memory):
        return -np.sign(reading.gradient), memory
