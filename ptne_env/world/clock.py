"""Time transformations t = λ(s), and the table of an episode's steps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt
import scipy

from ptne_env.shared.arrays import FloatArray, freeze, require_count, require_non_negative, require_positive
from ptne_env.shared.names import require_name
from ptne_env.shared.parts import Part, checked

Spacing: TypeAlias = Literal["effective", "transformed", "physical"]

Times: TypeAlias = "FloatArray | float"
"""One time, or an array of times of any shape."""


class TimeTransformation(Part, ABC):
    """A function t = λ(s) of Lemma 1, from s ∈ [0, ∞) onto t ∈ [0, T).

    Attributes:
        deadline: T in seconds, the prescribed time.
    """

    deadline: float = checked(require_positive, " (T, in seconds)")

    @abstractmethod
    def time(self, s: Times) -> FloatArray:
        """t = λ(s), in seconds."""

    @abstractmethod
    def derivative(self, s: Times) -> FloatArray:
        """λ'(s), in seconds per unit of s."""

    @abstractmethod
    def inverse(self, t: Times) -> FloatArray:
        """s = λ^{-1}(t) for t < T."""

    def gain(self, t: npt.ArrayLike, constant: float = 0.0) -> FloatArray:
        """g(t) = c + 1/λ'(λ^{-1}(t)) for t < T and c from T on, in 1/s: the prescribed-time gain of eq. (10)."""
        times = np.asarray(t, dtype=np.float64)
        before = times < self.deadline
        s = self.inverse(np.where(before, times, 0.0))
        return np.where(before, constant + 1 / self.derivative(s), constant)

    def effective_time(self, s: Times, constant: float) -> FloatArray:
        """τ = s + c λ(s), the time in which every law's loop is dx/dτ = u."""
        return s + constant * self.time(s)

    def from_effective_time(self, tau: FloatArray, constant: float) -> FloatArray:
        """The s with s + c λ(s) = τ, by root finding; transformations with a closed form override this."""
        tolerance = min(1e-15, 1e-13 / (1 + constant * self.deadline))  # s starts like τ/(1 + c T)

        def solve(value: float) -> float:
            if value <= 0:
                return 0.0
            residual = lambda s: float(self.effective_time(s, constant)) - value  # noqa: E731 - closes over value
            return float(scipy.optimize.brentq(residual, 0.0, value, xtol=tolerance, rtol=8.9e-16, maxiter=200))

        return np.vectorize(solve, otypes=[np.float64])(tau)


class Exponential(TimeTransformation):
    """The paper's λ(s) = T (1 − e^{−s}), eq. (9), for which the gain is c + 1/(T − t)."""

    def time(self, s: Times) -> FloatArray:
        return -self.deadline * np.expm1(-s)

    def derivative(self, s: Times) -> FloatArray:
        return self.deadline * np.exp(-s)

    def inverse(self, t: Times) -> FloatArray:
        return -np.log1p(-t / self.deadline)

    def from_effective_time(self, tau: FloatArray, constant: float) -> FloatArray:
        """τ − C + ω(ln C + C − τ) with C = cT and Wright's ω, and a step of Newton where C cancels most digits."""
        scale = constant * self.deadline
        if scale == 0:
            return tau.copy()
        s = tau - scale + scipy.special.wrightomega(np.log(scale) + scale - tau)
        if scale > 100:
            s = s - (self.effective_time(s, constant) - tau) / (1 + constant * self.derivative(s))
        return np.maximum(s, 0.0)


class Rational(TimeTransformation):
    """λ(s) = T s/(1 + s), whose gain is c + T/(T − t)²."""

    def time(self, s: Times) -> FloatArray:
        return np.asarray(self.deadline * s / (1 + s))

    def derivative(self, s: Times) -> FloatArray:
        return np.asarray(self.deadline / (1 + s) ** 2)

    def inverse(self, t: Times) -> FloatArray:
        return np.asarray(t / (self.deadline - t))


class HyperbolicTangent(TimeTransformation):
    """λ(s) = T tanh s, whose gain is c + T/(T² − t²)."""

    def time(self, s: Times) -> FloatArray:
        return self.deadline * np.tanh(s)

    def derivative(self, s: Times) -> FloatArray:
        decay = np.exp(-2 * s)  # T/cosh² s, written so that it never overflows
        return 4 * self.deadline * decay / (1 + decay) ** 2

    def inverse(self, t: Times) -> FloatArray:
        return np.arctanh(t / self.deadline)


class StepClock:
    """The table of an episode's steps: K steps to the deadline, then an optional hold phase.

    Instant k = 0..K+H is the start of step k; instant K is the deadline, where the clock is set to T with the
    estimates unchanged. Step k holds its input over Δs_k of transformed time and Δt_k of physical time, and the
    update x_{k+1} = x_k + Θ_k u_k with Θ_k = Δs_k + c Δt_k is then exact. In the hold phase Θ = c Δt is the mean Θ
    of the episode.

    Args:
        transformation: λ, with its deadline T.
        gain: c ≥ 0 in 1/s, the constant part of the prescribed-time gain.
        steps, hold_steps: K ≥ 1 and H ≥ 0.
        s_end: transformed time at which the steps to the deadline stop, > 0.
        spacing: the time divided evenly: τ (``effective``), s (``transformed``) or t (``physical``).

    Attributes:
        t: physical time of each instant in seconds, shape (K+H+1,), with t[K] = T.
        s: transformed time of each instant, shape (K+H+1,); stays s_end in the hold phase.
        theta: Θ_k of each step, shape (K+H+1,); 0 at the terminal instant.
        dt: Δt_k of each step in seconds, shape (K+H+1,); 0 at the terminal instant.
        time_reached: t_K = λ(s_end) < T, the end of the last step before the deadline.

    Raises:
        ValueError: for a value outside these ranges, or hold steps with c = 0.
    """

    def __init__(
        self,
        transformation: TimeTransformation,
        *,
        gain: float,
        steps: int,
        s_end: float,
        spacing: Spacing = "effective",
        hold_steps: int = 0,
    ) -> None:
        require_name("spacing", spacing, get_args(Spacing))
        self.transformation = transformation
        self.gain = require_non_negative("gain (c)", gain)
        self.steps = require_count("steps (K)", steps, 1)
        self.s_end = require_positive("s_end", s_end)
        self.spacing: Spacing = spacing
        self.hold_steps = require_count("hold_steps", hold_steps, 0)
        if self.hold_steps and self.gain == 0:
            raise ValueError("hold_steps need a gain c > 0: with c = 0 nothing moves after the deadline")

        s = self._grid()
        t = transformation.time(s)
        self.time_reached = float(t[-1])
        if not self.time_reached < self.deadline:
            raise ValueError(
                f"s_end = {s_end} is too long: float64 cannot tell T − t from 0 there; shorten it (36 is the limit of "
                "the exponential transformation)"
            )
        dt = np.diff(t)
        if not np.all(dt > 0):
            raise ValueError(
                f"steps = {steps} up to s_end = {s_end} are too short near the deadline: float64 cannot tell t from "
                "the t of the next step; use fewer steps or a shorter s_end"
            )
        theta = np.diff(s) + self.gain * dt
        hold_theta = np.full(self.hold_steps, theta.mean())
        hold_dt = hold_theta / self.gain if self.hold_steps else hold_theta
        self.t = freeze(np.concatenate([t[:-1], self.deadline + np.concatenate([[0.0], np.cumsum(hold_dt)])]))
        self.s = freeze(np.concatenate([s, np.full(self.hold_steps, s[-1])]))
        self.theta = freeze(np.concatenate([theta, hold_theta, [0.0]]))
        self.dt = freeze(np.concatenate([dt, hold_dt, [0.0]]))

    def _grid(self) -> FloatArray:
        fractions = np.linspace(0.0, 1.0, self.steps + 1)
        if self.spacing == "effective":
            end = float(self.transformation.effective_time(self.s_end, self.gain))
            s = self.transformation.from_effective_time(fractions * end, self.gain)
        elif self.spacing == "transformed":
            s = fractions * self.s_end
        else:
            s = self.transformation.inverse(fractions * float(self.transformation.time(self.s_end)))
        s[0], s[-1] = 0.0, self.s_end
        return s

    @property
    def deadline(self) -> float:
        """T in seconds."""
        return self.transformation.deadline

    @property
    def total_steps(self) -> int:
        """K + H."""
        return self.steps + self.hold_steps

    @property
    def shortfall(self) -> float:
        """1 − t_K/T, the time between the end of the last step and the deadline, as a fraction of T."""
        return 1 - self.time_reached / self.deadline

    @property
    def effective_time(self) -> float:
        """τ_K = s_end + c t_K = Σ Θ_k over the steps to the deadline."""
        return self.s_end + self.gain * self.time_reached

    @property
    def topology_times(self) -> dict[str, FloatArray]:
        """The clocks of topologies at each instant: t, and s, which continues as s_end + c (t − T) after T."""
        hold = self.gain * (self.t[self.steps :] - self.deadline)
        return {"physical": self.t, "transformed": np.concatenate([self.s[: self.steps], self.s_end + hold])}
