"""What every law shares: reading observations, writing actions, memory, and the condition under which it works."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from ptne_env.arrays import BoolArray, Float32Array, FloatArray, IntArray
from ptne_env.observation import Interface, Observation, ObservationLayout


@dataclass(frozen=True)
class ProblemConstants:
    """What a theorem may ask of a scenario, in numbers. ``ptne_env.theory.constants`` reads them off a scenario.

    Attributes:
        epsilon: ε, largest constant for which F is ε-strongly monotone; not positive when F is not.
        iota_strategies: ι_F, Lipschitz constant of F.
        iota_estimates: ι, Lipschitz constant of the stacked **F**.
        exact: whether these are exact and global (F affine), or sampled.
        jacobian: dF, shape (n, n); at x* unless F is affine.
        owners: the player who owns each component, shape (n,).
        laplacians: L of every mode of the topology, each (N, N).
        recurring_connectivity: λ2 of the union of the graphs that act as s → ∞: all modes on the transformed clock, the
            last one on the physical clock (docs/errata.md, 2).
        largest_step: largest Θ_k.
        effective_time: τ_K, the sum of the steps.
        gain: c in 1/s.
    """

    epsilon: float
    iota_strategies: float
    iota_estimates: float
    exact: bool
    jacobian: FloatArray
    owners: IntArray
    laplacians: tuple[FloatArray, ...]
    recurring_connectivity: float
    largest_step: float
    effective_time: float
    gain: float

    @property
    def iota(self) -> float:
        """The larger Lipschitz constant, ι of eq. GainCondition."""
        return max(self.iota_strategies, self.iota_estimates)

    @property
    def num_players(self) -> int:
        """N."""
        return len(self.laplacians[0])

    @cached_property
    def connectivity(self) -> float:
        """The smallest λ2 over the modes; exactly 0 where a mode is disconnected."""
        return min(algebraic_connectivity(laplacian) for laplacian in self.laplacians)

    @property
    def largest_degree(self) -> float:
        """The largest Σ_j a_ij over players and modes."""
        return max(float(laplacian.diagonal().max()) for laplacian in self.laplacians)

    def loop(self, laplacian: FloatArray, kappa: float) -> FloatArray:
        """M of the static law; see :func:`loop_matrix`."""
        return loop_matrix(self.jacobian, self.owners, laplacian, kappa)


def loop_matrix(jacobian: FloatArray, owners: IntArray, laplacian: FloatArray, kappa: float) -> FloatArray:
    """M = R^T d**F** + κ L⊗I of the static law in the paper's stacking col(x^1 … x^N) (eq. StackedVariable).

    Args:
        jacobian: dF, shape (n, n).
        owners: the player who owns each component, shape (n,).
        laplacian: L, shape (N, N).
        kappa: κ.

    Returns:
        Shape (Nn, Nn); entry i n + k belongs to x^i_k.
    """
    n = len(owners)
    matrix = kappa * np.kron(laplacian, np.eye(n))
    for component, owner in enumerate(owners):
        matrix[owner * n + component, owner * n : (owner + 1) * n] += jacobian[component]
    return np.asarray(matrix)


def algebraic_connectivity(laplacian: FloatArray) -> float:
    """λ2 of a Laplacian, without the rounding that a disconnected graph's has."""
    second = float(np.linalg.eigvalsh(laplacian)[1])
    return second if second > 1e-10 * max(1.0, float(laplacian.max())) else 0.0


@dataclass(frozen=True)
class Condition:
    """What a law's theorem asks, and whether a scenario meets it.

    Attributes:
        name: the condition in words or symbols, with the direction in which ``value`` is compared with ``bound``.
        value: the number that decides.
        bound: what it is compared with; infinite or NaN where no number would do.
        holds: whether the scenario meets the condition.
        exact: whether the numbers are exact; otherwise they come from samples or a linearisation and prove nothing.
    """

    name: str
    value: float
    bound: float
    holds: bool
    exact: bool = True

    @classmethod
    def above(cls, name: str, value: float, bound: float, *, exact: bool = True) -> Condition:
        """The condition value > bound."""
        return cls(name, float(value), float(bound), bool(value > bound), exact)

    @classmethod
    def below(cls, name: str, value: float, bound: float, *, exact: bool = True) -> Condition:
        """The condition value < bound."""
        return cls(name, float(value), float(bound), bool(value < bound), exact)


def decisive(*conditions: Condition) -> Condition:
    """All of several conditions as one: the first that fails, or else the last."""
    return next((condition for condition in conditions if not condition.holds), conditions[-1])


def strong_monotonicity(constants: ProblemConstants) -> Condition:
    """ε > 0 (Assumption 4)."""
    return Condition.above("F is strongly monotone: ε > 0", constants.epsilon, 0.0, exact=constants.exact)


def lasting_connectivity(constants: ProblemConstants) -> Condition:
    """λ2 > 0 for the union of the graphs that act as s → ∞ (Assumptions 1 and 2)."""
    return Condition.above("the graphs are connected as s → ∞: λ2 > 0", constants.recurring_connectivity, 0.0)


class Law(ABC):
    """A policy built from a layout, acting from observations and its own memory alone.

    Args:
        layout: of the environment's observations, ``env.layout``; either interface.

    Raises:
        ValueError: when the layout's action mode or interface is one through which the law cannot act, or lacks a slice
            that the law reads.
    """

    needs_full_information = False
    """Whether the law is an oracle that reads what no player can see."""

    needs: ClassVar[tuple[str, ...]] = ()
    """Slices that the law reads and not every layout has."""

    interface: ClassVar[Interface] = Interface()
    """Through which it acts in comparisons."""

    def __init__(self, layout: ObservationLayout) -> None:
        name = type(self).__name__
        if layout.interface.action_mode != "input" and not self._acts_through_gains():
            raise ValueError(f"{name} needs action_mode='input', this layout has {layout.interface.action_mode!r}")
        if self.needs_full_information and layout.interface.kind != "full":
            raise ValueError(f"{name} is an oracle and needs the interface 'full', got {layout.interface.kind!r}")
        missing = [need for need in self.needs if need not in layout.slices]
        if missing:
            raise ValueError(
                f"{name} reads {', '.join(missing)}, which the layout of {layout.interface} lacks; build the "
                f"environment with {self.interface}"
            )
        self.layout = layout

    def predict(
        self,
        observation: npt.NDArray[np.float32],
        state: Any = None,
        episode_start: BoolArray | None = None,
        deterministic: bool = False,  # noqa: ARG002, FBT001, FBT002 - Stable-Baselines3's signature
    ) -> tuple[Float32Array, Any]:
        """Actions for observations; see :meth:`ptne_env.policy.Policy.predict`. Laws are deterministic.

        Raises:
            ValueError: when observations or memory are not of this law's shape.
        """
        observation = np.asarray(observation)
        single = observation.ndim == 1
        rows = observation[None] if single else observation
        reading = self.layout.read(rows)
        fresh = self._initial_memory(len(rows))
        memory = fresh if state is None or fresh is None else _restart(state, fresh, episode_start)
        inputs, memory = self._inputs(reading, memory)
        actions = self._actions(inputs, reading)
        return (actions[0] if single else actions), memory

    def inputs(self, reading: Observation, memory: Any = None) -> tuple[FloatArray, Any]:
        """What :meth:`predict` decides, in float64 and before the action box; it is what theory computes with.

        Args:
            reading: of R players.
            memory: the law's, as it returned it; a fresh one if left out.

        Returns:
            The inputs u^i in the reading's unit, shape (R, n), and the memory for the next step.
        """
        return self._inputs(reading, self._initial_memory(len(reading.player)) if memory is None else memory)

    @property
    def has_memory(self) -> bool:
        """Whether the law remembers something from step to step."""
        return self._initial_memory(1) is not None

    def initial_memory(self, rows: int) -> Any:
        """A fresh memory for R players, one row each; ``None`` for a law without memory."""
        return self._initial_memory(rows)

    def gains(self, memory: Any) -> FloatArray | None:  # noqa: ARG002 - laws whose gains adapt use it
        """The gains that act, from a memory with one row per player; ``None`` for a law that adapts none.

        With these gains frozen, the law is one without memory.
        """
        return None

    def condition(self, constants: ProblemConstants) -> Condition | None:  # noqa: ARG002 - laws with a theorem use it
        """Whether a scenario meets the law's condition, with the number that decides; ``None`` if it promises nothing.

        Args:
            constants: of the scenario; ``ptne_env.theory.condition`` reads them off one.
        """
        return None

    @abstractmethod
    def _inputs(self, reading: Observation, memory: Any) -> tuple[FloatArray, Any]:
        """Inputs u^i in the reading's unit, shape (R, n), and the memory for the next step."""

    def _actions(self, inputs: FloatArray, reading: Observation) -> Float32Array:
        return self.layout.write(inputs, reading)

    def _acts_through_gains(self) -> bool:
        return False

    def _initial_memory(self, rows: int) -> Any:  # noqa: ARG002 - laws with memory use it
        return None


def _restart(memory: Any, fresh: FloatArray, episode_start: BoolArray | None) -> FloatArray:
    """``memory`` with a fresh row wherever an episode starts."""
    if np.shape(memory) != fresh.shape:
        raise ValueError(
            f"the memory has the shape {np.shape(memory)} and these observations need {fresh.shape}; pass "
            "state=None to start afresh"
        )
    if episode_start is None:
        return np.asarray(memory)
    return np.where(np.reshape(episode_start, (len(fresh), *(1,) * (fresh.ndim - 1))), fresh, memory)


def consensus(weights: FloatArray, relative_estimates: FloatArray) -> FloatArray:
    """Σ_j a_ij (x^j − x^i) over neighbour slots: (R, D) and (R, D, n) to (R, n)."""
    return np.einsum("rd,rdn->rn", weights, relative_estimates)


def per_step(displacements: FloatArray, reading: Observation) -> FloatArray:
    """The inputs (R, n) that move estimates by ``displacements`` in the coming step; 0 where no step comes."""
    over = reading.theta == 0  # the terminal observation, from which nobody acts
    return displacements / np.where(over, np.inf, reading.theta)
