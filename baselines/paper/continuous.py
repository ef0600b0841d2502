"""The paper's loops in continuous time, integrated in effective time τ, where each is dx/dτ = u.

With τ = s + c t the prescribed-time gain disappears (eq. (13) has θ = dτ/ds), the instant T lies at s = ∞ instead of a
singularity, and the phase after T has the same equation with dτ = c dt. The state is the error x − 1⊗x*, which keeps
its relative precision as it vanishes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import integrate, linalg

from ptne_env.games import Game
from ptne_env.shared.arrays import FloatArray
from ptne_env.theory import closed_loop_matrix
from ptne_env.world.clock import TimeTransformation
from ptne_env.world.distances import SUCCESS_DISTANCE
from ptne_env.world.switching import SwitchingTopology

RELATIVE_TOLERANCE = 1e-13
ABSOLUTE_TOLERANCE = 1e-16
MAX_STEP = 0.1
"""In τ; longer steps of DOP853 would limit the accuracy of the samples interpolated between them."""


@dataclass(frozen=True)
class Segment:
    """An interval of effective time on which one graph acts.

    Attributes:
        start: τ at which it starts.
        end: τ at which it ends.
        mode: index of the graph in the topology.
    """

    start: float
    end: float
    mode: int


@dataclass(frozen=True)
class Timeline:
    """The instants at which a run is sampled, and the intervals between switches.

    Attributes:
        tau: effective time of each sample, shape (S,), not decreasing; includes the switches.
        s: transformed time, shape (S,); constant in the hold phase, and equal to t without a prescribed time.
        t: physical time in seconds, shape (S,).
        segments: cover [tau[0], tau[-1]] in order.
        deadline_index: the sample at which the approach of T ends; the last sample without a hold phase.
    """

    tau: FloatArray
    s: FloatArray
    t: FloatArray
    segments: tuple[Segment, ...]
    deadline_index: int

    def after_deadline(self) -> Timeline:
        """The hold phase alone."""
        first = self.deadline_index
        return Timeline(
            tau=self.tau[first:],
            s=self.s[first:],
            t=self.t[first:],
            segments=tuple(segment for segment in self.segments if segment.start >= self.tau[first]),
            deadline_index=0,
        )


def plain_timeline(topology: SwitchingTopology, horizon: float, *, samples: int = 2001) -> Timeline:
    """Physical time [0, horizon], for dx/dt = u without the prescribed-time gain (Corollary 1).

    Args:
        topology: on the physical clock.
        horizon: end in seconds.
        samples: evenly spaced instants, to which the switches are added.
    """
    switches = topology.switches(0.0, horizon)
    t = np.union1d(np.linspace(0.0, horizon, samples), switches)
    segments = _segments(topology, switches, switches, (0.0, horizon), (0.0, horizon))
    return Timeline(tau=t, s=t, t=t, segments=segments, deadline_index=t.size - 1)


def prescribed_timeline(
    topology: SwitchingTopology,
    transformation: TimeTransformation,
    constant: float,
    *,
    s_end: float = 30.0,
    hold: float = 0.0,
    samples: int = 2001,
) -> Timeline:
    """The approach of T up to s_end, sampled evenly in τ, and then ``hold`` seconds after T.

    Args:
        topology: on either clock; after T a transformed clock continues as s_end + c (t − T).
        transformation: λ, with its deadline T.
        constant: c ≥ 0 in 1/s.
        s_end: transformed time at which the approach stops; the state there stands for the state at T.
        hold: seconds after T.
        samples: instants of the approach, to which the switches are added; the hold phase has the same density.
    """
    deadline, physical = transformation.deadline, topology.clock == "physical"
    end = float(transformation.effective_time(s_end, constant))
    # The approach stops at s_end, so switches in physical time after it do not happen.
    stop = float(transformation.time(s_end)) if physical else s_end
    switches = topology.switches(0.0, stop)
    s_switches = transformation.inverse(switches) if physical else switches
    tau_switches = transformation.effective_time(s_switches, constant)
    regular = np.linspace(0.0, end, samples)
    s_regular = transformation.from_effective_time(regular, constant)
    s_regular[0], s_regular[-1] = 0.0, s_end
    tau = np.concatenate([regular, tau_switches])
    order = np.argsort(tau, kind="stable")
    tau, s = tau[order], np.concatenate([s_regular, s_switches])[order]
    t = transformation.time(s)
    segments = _segments(topology, switches, tau_switches, (0.0, stop), (0.0, end))
    deadline_index = tau.size - 1
    if hold > 0:
        # In the hold phase dτ = c dt, on the transformed clock too.
        span = (deadline, deadline + hold) if physical else (s_end, s_end + constant * hold)
        later = topology.switches(*span)
        tau_later = end + (constant if physical else 1.0) * (later - span[0])
        count = max(2, round(samples * constant * hold / end))
        tau_hold = np.union1d(np.linspace(end, end + constant * hold, count), tau_later)[1:]
        segments += _segments(topology, later, tau_later, span, (end, end + constant * hold))
        tau = np.concatenate([tau, tau_hold])
        s = np.concatenate([s, np.full(tau_hold.size, s_end)])
        t = np.concatenate([t, deadline + (tau_hold - end) / constant])
    return Timeline(tau=tau, s=s, t=t, segments=segments, deadline_index=deadline_index)


def _segments(
    topology: SwitchingTopology,
    switches: FloatArray,
    tau_switches: FloatArray,
    span: tuple[float, float],
    tau_span: tuple[float, float],
) -> tuple[Segment, ...]:
    bounds = np.concatenate([[span[0]], switches, [span[1]]])
    tau_bounds = np.concatenate([[tau_span[0]], tau_switches, [tau_span[1]]])
    # The middle of an interval is inside it in spite of rounding at its ends.
    modes = topology.schedule((bounds[:-1] + bounds[1:]) / 2).modes
    intervals = zip(tau_bounds[:-1], tau_bounds[1:], modes, strict=True)
    return tuple(Segment(float(start), float(end), int(mode)) for start, end, mode in intervals)


@dataclass(frozen=True)
class Run:
    """A continuous-time trajectory of all players' estimates.

    Attributes:
        game: the game.
        topology: the communication graphs.
        timeline: the S instants.
        errors: x^i − x*, shape (S, N, n), with a row per player.
        gains: κ_ij of each link of the union graph, shape (S, E), in the order of ``topology.union.edges``.
    """

    game: Game
    topology: SwitchingTopology
    timeline: Timeline
    errors: FloatArray
    gains: FloatArray

    @cached_property
    def estimates(self) -> FloatArray:
        """x^i, shape (S, N, n)."""
        return self.errors + self.game.nash_equilibrium

    @cached_property
    def strategy_distance(self) -> FloatArray:
        """‖x − x*‖/‖x*‖ of the strategies, shape (S,): the paper's relative error."""
        components = np.arange(self.game.dimension)
        return np.linalg.norm(self.errors[:, self.game.owners, components], axis=1) / float(
            self.game.equilibrium_scale[0]
        )

    @cached_property
    def estimate_distance(self) -> FloatArray:
        """‖**x** − 1⊗x*‖/(√N ‖x*‖) of all estimates, shape (S,): the error of the theorems."""
        norms = np.linalg.norm(self.errors, axis=(1, 2))
        return norms / (np.sqrt(self.game.num_players) * float(self.game.equilibrium_scale[0]))

    def input_norm(self, sample: int, mode: int) -> float:
        """‖**u**‖ of the law at a sample on the graph ``mode``; at a switch, that before or after it."""
        u, _ = _Loop(self.game, self.topology).slopes(self.errors[sample], self.gains[sample], mode)
        return float(np.linalg.norm(u))

    def strategy_distance_at(self, t: float) -> float:
        """The strategies' distance at the last sample up to ``t`` seconds; at T, the end of the approach."""
        return float(self.strategy_distance[np.searchsorted(self.timeline.t, t, side="right") - 1])

    def settling_time(self, threshold: float = SUCCESS_DISTANCE) -> float | None:
        """The instant in seconds after which the strategies' distance stays at or below ``threshold``.

        The crossing is interpolated in the logarithm of the distance. ``None`` when the run ends above the threshold.
        """
        above = np.flatnonzero(self.strategy_distance > threshold)
        if above.size == 0:
            return 0.0
        last = int(above[-1])
        if last == self.strategy_distance.size - 1:
            return None
        levels = np.log(self.strategy_distance[[last + 1, last]])
        return float(np.interp(np.log(threshold), levels, self.timeline.t[[last + 1, last]]))


class _Loop:
    """The right-hand sides of the laws, dx/dτ = u and dκ_ij/dτ = γ a_ij ‖x^i − x^j‖², with one κ per link."""

    def __init__(self, game: Game, topology: SwitchingTopology) -> None:
        self.game = game
        edges = topology.union.edges
        self.incidence = np.zeros((game.num_players, len(edges)))
        for column, (i, j) in enumerate(edges):
            self.incidence[[i, j], column] = 1.0, -1.0
        self.weights = [np.array([graph.adjacency[edge] for edge in edges]) for graph in topology.graphs]
        self.components = np.arange(game.dimension)

    def slopes(self, error: FloatArray, gains: FloatArray, mode: int) -> tuple[FloatArray, FloatArray]:
        """u^i = −R_iᵀ ∂J_i/∂x_i(x^i) − Σ_j κ_ij a_ij (x^i − x^j), shape (N, n), and a_ij ‖x^i − x^j‖², shape (E,)."""
        weights, differences = self.weights[mode], self.incidence.T @ error
        u = -self.incidence @ ((gains * weights)[:, None] * differences)
        estimates = (error + self.game.nash_equilibrium).T[:, :, None]
        u[self.game.owners, self.components] -= self.game.own_gradients(estimates)[:, 0]
        return u, weights * np.einsum("en,en->e", differences, differences)


def simulate(
    game: Game,
    topology: SwitchingTopology,
    start: npt.ArrayLike,
    timeline: Timeline,
    *,
    initial_gain: float | Sequence[float],
    gamma: float = 0.0,
) -> Run:
    """Integrate the adaptive law, of which the static one is the case γ = 0 with κ = ``initial_gain``.

    Covers eqs. (10), (36) and (47) of the paper and, on a :func:`plain_timeline`, Corollary 1. ``solve_ivp`` (DOP853)
    restarts at every switch, so that no step contains a switch.

    Args:
        game: the game.
        topology: the communication graphs.
        start: x^i(0), shape (N, n), with a row per player.
        timeline: the instants.
        initial_gain: κ_ij(0) ≥ 0, one number or one per link of the union graph.
        gamma: γ_ij ≥ 0, the same for all links.

    Raises:
        ArithmeticError: when the integrator fails or the run diverges.
    """
    players, dimension = game.num_players, game.dimension
    edges = topology.union.edges
    gains = np.broadcast_to(np.asarray(initial_gain, dtype=np.float64), (len(edges),))
    loop, size = _Loop(game, topology), players * dimension
    state = np.concatenate([(np.asarray(start) - game.nash_equilibrium).ravel(), gains])
    states = np.empty((timeline.tau.size, state.size))

    for segment in timeline.segments:

        def derivative(_: float, y: FloatArray, mode: int = segment.mode) -> FloatArray:
            u, growth = loop.slopes(y[:size].reshape(players, dimension), y[size:], mode)
            return np.concatenate([u.ravel(), gamma * growth])

        inside = (timeline.tau >= segment.start) & (timeline.tau <= segment.end)
        instants = timeline.tau[inside]
        solution = integrate.solve_ivp(
            derivative,
            (segment.start, segment.end),
            state,
            method="DOP853",
            t_eval=np.union1d(instants, [segment.end]),
            rtol=RELATIVE_TOLERANCE,
            atol=ABSOLUTE_TOLERANCE,
            max_step=MAX_STEP,
        )
        if not (solution.success and np.all(np.isfinite(solution.y))):
            raise ArithmeticError(f"the integration failed between τ = {segment.start} and {segment.end}")
        states[inside] = solution.y.T[np.searchsorted(solution.t, instants)]
        state = solution.y[:, -1]
    errors = states[:, :size].reshape(-1, players, dimension)
    return Run(game, topology, timeline, errors, states[:, size:])


def exact_static(
    game: Game, topology: SwitchingTopology, start: npt.ArrayLike, timeline: Timeline, *, kappa: float
) -> Run:
    """The static law by matrix exponentials, x(τ) = x* + e^{−Mτ}(x(0) − x*) piecewise; for affine F only.

    Args:
        game: with affine F.
        topology: the communication graphs.
        start: x^i(0), shape (N, n).
        timeline: the instants.
        kappa: κ ≥ 0.
    """
    matrices = [closed_loop_matrix(game, graph, kappa) for graph in topology.graphs]
    state = (np.asarray(start) - game.nash_equilibrium).ravel()
    states = np.empty((timeline.tau.size, state.size))
    for segment in timeline.segments:
        inside = (timeline.tau >= segment.start) & (timeline.tau <= segment.end)
        spans = np.append(timeline.tau[inside], segment.end) - segment.start
        propagators = linalg.expm(-matrices[segment.mode] * spans[:, None, None])
        states[inside] = propagators[:-1] @ state
        state = propagators[-1] @ state
    gains = np.full((timeline.tau.size, len(topology.union.edges)), float(kappa))
    return Run(game, topology, timeline, states.reshape(-1, game.num_players, game.dimension), gains)
