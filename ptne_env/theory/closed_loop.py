"""The closed loop dx/dτ = −M (x − 1⊗x*) of a law that is linear in gradient and differences, and its rates.

Everything here is in effective time τ = s + c t and in the paper's player-major stacking x = col(x^1, …, x^N), its eq.
(11): entry i n + k belongs to x^i_k. For games with affine F it is exact; for the others M is the linearisation at x*.
Strategies that bounds hold at x* do not move, and their entries are left out.

The sampled loop e_{k+1} = (I − h_k M_k) e_k gives the error of an episode step by step. For games with affine F it is
the environment itself, up to rounding to float32 at the interface, while no input saturates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from scipy import linalg

from ptne_env.games import Game
from ptne_env.laws import Law
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, require_non_negative
from ptne_env.theory.constants import jacobian_at_equilibrium, last_modes, rounding_error
from ptne_env.world.clock import TimeTransformation
from ptne_env.world.graphs import Graph
from ptne_env.world.switching import SwitchingTopology
from ptne_env.world.world import World

LoopClock: TypeAlias = Literal["effective", "physical"]
"""The time in which the loop of a law is dx = −M x: τ, or t for a law without the time gain."""


_NEAR = 2.0**-10
"""The size of errors at which the loop of a law is measured: laws may saturate at larger ones."""

_ROUNDING, _EXACT_ROUNDING = 2.0**-20, 2.0**-48
"""More than the rounding of a step at the interface, as a fraction of the error, and in float64, of the strategies."""


class NoClosedLoopError(ValueError):
    """A law is not of the form that has a closed loop dx/dτ = −M (x − 1⊗x*)."""


def closed_loop_matrix(game: Game, graph: Graph, kappa: float) -> FloatArray:
    """Return M = Rᵀ dF + κ L⊗I_n of the static law around x*, (Nn, Nn) less the entries that bounds hold at x*.

    Args:
        game: the game; its F is linearised at x* unless it is affine.
        graph: the communication graph of the game's players.
        kappa: κ ≥ 0. For the adaptive law at frozen gains, use a graph with the weights κ_ij a_ij and κ = 1.

    Raises:
        ValueError: when κ is negative, or the graph has another number of players.
    """
    require_non_negative("kappa", kappa)
    if graph.num_players != game.num_players:
        raise ValueError(f"the game has {game.num_players} players and the graph {graph.num_players}")
    n, jacobian = game.dimension, jacobian_at_equilibrium(game)
    matrix = np.asarray(kappa * np.kron(graph.laplacian, np.eye(n)))
    for component, owner in enumerate(game.owners):
        matrix[owner * n + component, owner * n : (owner + 1) * n] += jacobian[component]
    return _restrict(matrix, game)


def law_matrix(law: Law, game: Game, graph: Graph) -> FloatArray:
    """Return M of a law that is linear in gradient and differences, u = −M (x − 1⊗x*), as measured on the law.

    Each player observes errors of its own estimate, and messages, of one component near x*, at t = 0 in a step with
    Θ = Δt = 1; its inputs are the columns of M. So M is that of the code that acts in the environment, and a new law
    needs nothing added here.

    Args:
        law: built for the layout of an environment with these players, whose union graph holds ``graph``; its gains,
            if it has any, are those of the start.
        game: the game; its F is linearised at x* unless it is affine.
        graph: the active graph.

    Returns:
        Shape (Nn, Nn), less the entries of strategies that bounds hold at x*.

    Raises:
        NoClosedLoopError: for a law that is not linear in gradient and differences near x*, reads more than these and
            its own estimate, or remembers more than gains.
    """
    name, unknown = type(law).__name__, sorted(set(law.needs) - {"own_estimate"})
    if (type(law).decide, type(law).predict) != (Law.decide, Law.predict):
        raise NoClosedLoopError(f"{name} overrides decide or predict; closed loops are of what Law.inputs returns")
    if unknown:
        raise NoClosedLoopError(
            f"{name} reads {', '.join(unknown)}; closed loops are of laws that act on gradient and differences alone"
        )
    if law.has_memory and not law.has_gains:
        raise NoClosedLoopError(f"{name} remembers more than gains, so it has no closed-loop matrix")
    n, players, slots = game.dimension, game.num_players, law.layout.slots
    neighbours = np.array(law.layout.neighbours)  # (N, D)
    weights = graph.adjacency[np.arange(players)[:, None], neighbours]

    # What players see: an error of one component, a mixture of all, a small one of all, and rest.
    kinds, small = (1 + slots) * n, 2.0**-20
    mixture = np.random.default_rng(0).uniform(0.5, 1.5, kinds)
    seen = _NEAR * np.vstack([np.eye(kinds), mixture, small * mixture, 0 * mixture])
    seen = np.broadcast_to(seen.reshape(-1, 1 + slots, n), (players, kinds + 3, 1 + slots, n))
    inputs = _respond(law, game, seen, weights[:, None], theta=np.ones(kinds + 3), dt=np.ones(kinds + 3)) / _NEAR
    mixed = np.tensordot(inputs[:, :kinds], mixture, axes=(1, 0))
    wanted, scale = np.stack([mixed, small * mixed, 0 * mixed], axis=1), 1e-9 * (1 + np.abs(mixed).max())
    if np.any(np.abs(wanted - inputs[:, kinds:]).max(axis=(0, 2)) > scale * np.array([1, small, small])):
        raise NoClosedLoopError(f"{name} is not linear in gradient and differences, so it has no closed-loop matrix")

    matrix = np.zeros((players, n, players, n))
    for i in range(players):
        matrix[i, :, i] = -inputs[i, :n].T
        for slot in np.flatnonzero(weights[i]):
            matrix[i, :, neighbours[i, slot]] -= inputs[i, n + slot * n : n + (slot + 1) * n].T
    return _restrict(matrix.reshape(players * n, -1), game)


def _respond(law: Law, game: Game, seen: FloatArray, weights: FloatArray, **times: Any) -> FloatArray:
    """Return the inputs of R observations of each player, shape (N, R, n).

    Players see their own errors and then those in every slot, (N, R, 1 + D, n), with weights (N, R or 1, D); each time
    has the shape (R,).
    """
    players, rows, _, n = seen.shape
    own, error = game.owners == np.arange(players)[:, None], seen[:, :, 0]
    player = np.repeat(np.arange(players), rows)
    blank = np.zeros((player.size, law.layout.size))
    blank[:, law.layout.slices["player"]] = np.eye(players)[player]
    relative = (seen[:, :, 1:] - seen[:, :, :1]) * (weights > 0)[..., None]
    observation = law.layout.read(blank)._replace(
        gradient=np.where(own[:, None], error @ jacobian_at_equilibrium(game).T, 0.0).reshape(-1, n),
        relative_estimates=relative.reshape(player.size, -1, n),
        weights=np.broadcast_to(weights, relative.shape[:3]).reshape(player.size, -1),
        own_estimate=error.reshape(-1, n) + game.nash_equilibrium,
        **{name: np.tile(values, players)[:, None] for name, values in times.items()},
    )
    return law.inputs(observation, law.initial_memory(player.size))[0].reshape(players, rows, n)


def spectral_abscissa(matrix: FloatArray) -> float:
    """Return min Re μ over the eigenvalues μ of M, the rate of e^{−Mτ}; exactly 0 where only rounding remains."""
    smallest = float(np.linalg.eigvals(matrix).real.min())
    return 0.0 if abs(smallest) <= rounding_error(matrix) else smallest


def decay_rate(
    matrices: Sequence[FloatArray], topology: SwitchingTopology, deadline: float, clock: LoopClock = "effective"
) -> float:
    """Return the rate r of the error of dx = −M x, which decays like e^{−r τ} as t → T, or e^{−r t} on the clock t.

    ``matrices`` are the M of the modes of a topology that is not random; T is the deadline in seconds.

    A fixed graph gives the spectral abscissa of M. A periodic topology on the clock of the loop, which is the
    transformed one for a loop in τ since dτ/ds → 1, gives the Floquet rate −ln ρ(Π e^{−M_m Δ_m})/period. On the
    physical clock a loop in τ meets finitely many switches before T, so only the last graph counts, and the rate is 0
    where that graph is disconnected (docs/errata.md, 2). On the transformed clock a loop in t meets ever faster
    switches, which gives the spectral abscissa of the mean of M. The rate is a lower bound where what is slow in each
    mode vanishes so fast in the others that the product underflows.
    """
    if topology.is_fixed:
        return spectral_abscissa(matrices[0])
    if clock == "effective" and topology.clock == "physical":
        return spectral_abscissa(matrices[last_modes(topology, deadline)[0]])
    if clock == "physical" and topology.clock == "transformed":
        return spectral_abscissa(np.average(matrices, axis=0, weights=topology.mode_dwells))
    decay, identity = 0.0, np.eye(len(matrices[0]))
    monodromy = identity
    for matrix, dwell in zip(matrices, topology.mode_dwells, strict=True):
        rate = spectral_abscissa(matrix)  # taken out, since its exponential may be 0 in float64
        decay += rate * dwell
        monodromy = linalg.expm((rate * identity - matrix) * dwell) @ monodromy
    remaining = max(float(np.abs(np.linalg.eigvals(monodromy)).max()), float(np.finfo(np.float64).tiny))
    return float((decay - math.log(remaining)) / topology.period)


def largest_stable_step(matrix: FloatArray) -> float | None:
    """Return the supremum of Θ with |1 − Θμ| ≤ 1 for every eigenvalue μ of M: min 2 Re μ/|μ|².

    Zero eigenvalues, which every disconnected graph has, are neither amplified nor damped and do not count.

    Returns:
        The step in units of τ; ``None`` when every step amplifies some error, and ∞ when none does.
    """
    eigenvalues = np.linalg.eigvals(matrix)
    eigenvalues = eigenvalues[np.abs(eigenvalues) > rounding_error(matrix)]
    if eigenvalues.real.min(initial=1.0) <= 0:
        return None
    return float((2 * eigenvalues.real / np.abs(eigenvalues) ** 2).min(initial=math.inf))


def gain_growth(transformation: TimeTransformation) -> float:
    """Return the p with which 1/λ'(s) grows like e^{p s}: 1 for the paper's λ, 2 for tanh, 0 for the rational λ.

    docs/theory.md says for which rates r of e^{−r s} the velocity g(t) u is bounded, and ∫‖g u‖² dt finite.
    """
    instants = 300 / 2.0 ** np.arange(12)
    shown = transformation.derivative(instants) > 1e-250 * transformation.deadline  # the others may have underflowed
    far = instants[shown.argmax()]
    early, middle, late = -np.log(transformation.derivative(far / np.array([4.0, 2.0, 1.0])))
    # Slopes of a power of s halve when s doubles, and cancel here; those of an exponential function stay.
    return round(float(4 * (late - 2 * middle + early) / far), 3)


def _restrict(matrix: FloatArray, game: Game) -> FloatArray:
    """Leave out the entries of M that do not move near x*: strategies that bounds hold there."""
    free = _is_free(game)
    return matrix if free.all() else np.asarray(matrix[np.ix_(free, free)])


def _is_free(game: Game) -> BoolArray:
    """Return whether each entry of x moves near x*, shape (Nn,)."""
    own = game.owners == np.arange(game.num_players)[:, None]
    return ~(own & game.held_at_equilibrium[:, 0]).ravel()


@dataclass(frozen=True)
class SampledLoop:
    """The closed loop of an episode to T, step by step.

    Attributes:
        matrices: M of every mode of the topology, in order, shape (Nn, Nn) each.
        modes: the mode that acts in each step, shape (K,); of a random topology one draw, with seed 0.
        steps: h_k, by which each step advances, shape (K,): Θ_k, or Δt_k for a law without the time gain.
        clock: ``"effective"`` or ``"physical"``.
        scale: the largest |x*_c|, in proportion to which strategies and gradients round at x*.
    """

    matrices: tuple[FloatArray, ...]
    modes: IntArray
    steps: FloatArray
    clock: LoopClock
    scale: float

    def errors(self, start: FloatArray, generator: np.random.Generator | None = None) -> FloatArray:
        """Return the error **x** − 1⊗x* at every instant.

        Args:
            start: the initial error, shape (Nn,).
            generator: draws an error for every step that is larger than its rounding; without it, none is added.

        Returns:
            Shape (K+1, Nn); not finite from where a diverging loop leaves the range of float64.
        """
        result = np.full((self.steps.size + 1, len(start)), np.inf)
        result[0] = start
        for k, (mode, step) in enumerate(zip(self.modes, self.steps, strict=True)):
            result[k + 1] = result[k] - step * (self.matrices[mode] @ result[k])
            if generator is not None:
                size = _ROUNDING * np.abs(result[k]) + _EXACT_ROUNDING * self.scale
                result[k + 1] += step * generator.uniform(-1, 1, len(start)) * (np.abs(self.matrices[mode]) @ size)
            if not np.all(np.abs(result[k + 1]) < 1e150):  # squares of larger errors would overflow
                result[k + 1] = np.inf
                break
        return result


def sampled_loop(world: World, law: Law) -> SampledLoop:
    """Return the loop of a law, built for the layout of the world; in a world of random games, on its typical game.

    Raises:
        NoClosedLoopError: as :func:`law_matrix`, and for a law whose gains depend on time, or on the length of the step
            for more than to undo the time gain.
    """
    clock, topology = world.clock, world.topology
    matrices = tuple(law_matrix(law, world.game, graph) for graph in topology.graphs)
    instants = clock.topology_times[topology.clock][: clock.steps]
    modes = topology.draw(instants, [np.random.default_rng(0)]).modes[:, 0]
    errors = np.random.default_rng(0).uniform(-_NEAR, _NEAR, (clock.steps, len(matrices[0])))
    lengths: dict[LoopClock, FloatArray] = {"effective": clock.theta, "physical": clock.dt}
    scale = float(np.abs(world.game.nash_equilibrium).max())
    for name, steps in lengths.items():
        loop = SampledLoop(matrices, modes, steps[: clock.steps], name, scale)
        if follows(law, world, loop, errors):
            return loop
    raise NoClosedLoopError(f"the gains of {type(law).__name__} depend on time, so it has another loop in every step")


def follows(law: Law, world: World, loop: SampledLoop, errors: FloatArray) -> bool:
    """Return whether the inputs of a law are those of its loop, at an error (steps, Nn) in each of the first steps.

    If they are at ``loop.errors(start)``, the episode from this start is the loop, by induction.
    """
    clock, game = world.clock, world.game
    players, n, free = game.num_players, game.dimension, _is_free(game)
    neighbours, everyone = np.array(law.layout.neighbours), np.arange(players)[:, None]
    adjacency = np.array([graph.adjacency[everyone, neighbours] for graph in world.topology.graphs])
    parts = len(errors) * neighbours.size * n // 2**22 + 1  # each of which fits in memory
    for part in np.array_split(np.arange(len(errors)), parts):
        modes, theta, error = loop.modes[part], clock.theta[part], np.zeros((part.size, players * n))
        error[:, free] = errors[part]
        seen = error.reshape(-1, players, n)[:, np.hstack([everyone, neighbours])].swapaxes(0, 1)
        times = {"dt": clock.dt[part], "elapsed": clock.t[part] / clock.deadline, "transformed": clock.s[part]}
        inputs = _respond(law, game, seen, adjacency[modes].swapaxes(0, 1), theta=theta, **times)
        moves = np.array([loop.matrices[mode] @ error for mode, error in zip(modes, errors[part], strict=True)])
        ratio = (loop.steps[part] / theta)[:, None]
        off = np.abs(inputs.swapaxes(0, 1).reshape(part.size, -1)[:, free] + ratio * moves)
        scale = np.abs(loop.matrices).max() * np.abs(errors[part]).max(axis=1, keepdims=True)
        if not np.all(off <= 1e-9 * ratio.max() * scale):
            return False
    return True


def distance(errors: FloatArray, game: Game) -> FloatArray:
    """Return ‖**x** − 1⊗x*‖/(√N ‖x*‖) of errors (..., Nn), shape (...)."""
    return np.linalg.norm(errors, axis=-1) / (math.sqrt(game.num_players) * float(game.equilibrium_scale[0]))
