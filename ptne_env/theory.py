"""What can be promised beforehand: assumptions, gain condition, rate, predicted digits, largest stable step.

The closed loop of the static law is dx/dτ = −M (x − 1⊗x*) in effective time τ = s + c t, with
M = Rᵀ dF + κ L⊗I_n in the paper's player-major stacking x = col(x^1, …, x^N) (eq. StackedVariable, eq.
ClosedLoopSystem). For games with affine F this is exact; for the others M is the linearisation at x*.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from scipy import linalg

from ptne_env.arrays import FloatArray, require_count, require_non_negative, require_positive
from ptne_env.clock import TimeTransformation
from ptne_env.games import Game, check_game
from ptne_env.graphs import Graph, Signal
from ptne_env.scenario import SHORTFALL_WARNING, Scenario

Verdict: TypeAlias = Literal["holds", "fails", "sampled only"]

_ZERO = 1e-10
"""Eigenvalues below this fraction of ‖M‖ count as zero; those of a disconnected graph's kernel are rounding."""


@dataclass(frozen=True)
class MonotonicityConstants:
    """The constants of Assumption 4.

    Where ``exact`` is false they come from sampled Jacobians: ε is then an upper bound and ι a lower bound of the
    constant on the sampled box, and nothing is known outside it.

    Attributes:
        epsilon: ε, the largest constant for which F is ε-strongly monotone; not positive when F is not.
        iota_strategies: ι_F, the Lipschitz constant of F on R^n.
        iota_estimates: the Lipschitz constant of the stacked **F** on R^{Nn}.
        exact: whether F is affine, so that the numbers are exact and global.
        samples: number of points behind them; 1 when exact.
        radius: half-width of the sampled box around x*; ``None`` when exact.
    """

    epsilon: float
    iota_strategies: float
    iota_estimates: float
    exact: bool
    samples: int
    radius: float | None

    @property
    def iota(self) -> float:
        """The larger of the two Lipschitz constants, ι of eq. GainCondition."""
        return max(self.iota_strategies, self.iota_estimates)


@dataclass(frozen=True)
class AssumptionCheck:
    """One assumption of the paper on one scenario.

    Attributes:
        number: 1 to 4.
        statement: what it says.
        value: the number that decides.
        meaning: what that number is.
        verdict: ``"holds"``, ``"fails"``, or ``"sampled only"`` where no sample refutes it and nothing proves it.
    """

    number: int
    statement: str
    value: float
    meaning: str
    verdict: Verdict


@dataclass(frozen=True)
class Certificate:
    """What can be said about the static law on a scenario before anything runs; see :func:`certify`.

    Attributes:
        scenario: name.
        kappa: κ of the static law.
        assumptions: the paper's Assumptions 1–4.
        constants: ε and ι.
        algebraic_connectivity: smallest λ2 over the modes of the signal.
        gain_bound: (ι²/ε + ι)/λ2, or ``None`` when no gain satisfies the condition.
        gain_condition_holds: whether κ exceeds it (sufficient for convergence, not necessary).
        rate: r with which the error decays like e^{−r s} as t → T; 0 or less when it does not vanish.
        rate_is_exact: whether the loop is linear, F being affine and no box confining the strategies; otherwise the
            rate is that of the linearisation at x*.
        effective_time: τ_K = s_end + c t_K, the sum of the steps Θ_k.
        digits_from_rate: r (cT + s_end)/ln 10, the digits of the estimate error that the rate alone promises.
        digits_sampled: digits that the sampled loop, the product of (I − Θ_k M_k), has from the scenario's start:
            −log10 ‖**x** − 1⊗x*‖/(√N ‖x*‖); ``None`` when the loop is not linear.
        largest_step: the largest Θ_k of the scenario.
        largest_stable_step: the step beyond which explicit steps on some mode's M amplify an error; ``None`` when no
            step is stable.
        step_margin: largest_stable_step / largest_step, above 1 when the steps are short enough; ``None`` likewise.
        input_rate: the rate at which u decays; it exceeds ``rate`` where u vanishes and the error does not.
        velocity_bounded: whether g(t) u stays bounded as t → T: ``input_rate`` ≥ 1 for the paper's λ.
        energy_finite: whether ∫‖g u‖² dt is finite: ``input_rate`` > 1/2 for the paper's λ.
        shortfall: 1 − t_K/T, how far short of the deadline the last step ends, as a fraction of T.
        notes: what else a reader must know.
    """

    scenario: str
    kappa: float
    assumptions: tuple[AssumptionCheck, ...]
    constants: MonotonicityConstants
    algebraic_connectivity: float
    gain_bound: float | None
    gain_condition_holds: bool
    rate: float
    rate_is_exact: bool
    effective_time: float
    digits_from_rate: float
    digits_sampled: float | None
    largest_step: float
    largest_stable_step: float | None
    step_margin: float | None
    input_rate: float
    velocity_bounded: bool
    energy_finite: bool
    shortfall: float
    notes: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """A JSON object; what does not exist is null, and no number is NaN or infinite."""
        data = dataclasses.asdict(self)
        data["constants"]["iota"] = self.constants.iota
        data["assumptions"] = list(data["assumptions"])
        data["notes"] = list(data["notes"])
        return data


def monotonicity_constants(
    game: Game, *, samples: int = 256, radius: float = 10.0, seed: int = 0
) -> MonotonicityConstants:
    """ε and ι of Assumption 4: exact for affine F, sampled bounds otherwise.

    ε = λ_min of the symmetric part of dF, ι_F = ‖dF‖₂, and for **F** the largest ‖rows of player i in dF‖₂, since
    block i of **F** depends on x^i alone.

    Args:
        game: the game.
        samples: number of points drawn from U(x* − radius, x* + radius) when F is not affine, and
            projected into the game's box.
        radius: half-width of that box.
        seed: of the draws.

    Raises:
        ValueError: when samples < 1 or radius ≤ 0.
    """
    require_count("samples", samples, 1)
    require_positive("radius", radius)
    points = game.nash_equilibrium[:, None]
    if not game.is_affine:
        generator = np.random.default_rng(seed)
        points = game.project(points + generator.uniform(-radius, radius, (game.dimension, samples)))
    jacobians = np.moveaxis(_jacobians(game, points), 2, 0)
    symmetric = (jacobians + jacobians.transpose(0, 2, 1)) / 2
    blocks = [jacobians[:, game.owners == player] for player in range(game.num_players)]
    smallest = float(np.linalg.eigvalsh(symmetric)[:, 0].min())
    return MonotonicityConstants(
        epsilon=0.0 if abs(smallest) <= _ZERO * _largest_norm(symmetric) else smallest,
        iota_strategies=_largest_norm(jacobians),
        iota_estimates=max(_largest_norm(block) for block in blocks),
        exact=game.is_affine,
        samples=points.shape[1],
        radius=None if game.is_affine else float(radius),
    )


def require_strong_monotonicity(game: Game) -> None:
    """Check Assumption 4 on every game of a batch with affine F, whose Jacobian is the same everywhere.

    Raises:
        ValueError: naming the first game whose dF has no positive definite symmetric part.
    """
    jacobians = game.jacobian(np.zeros((game.dimension, game.batch_size))) if game.is_affine else None
    if jacobians is None:
        raise ValueError(f"strong monotonicity of {type(game).__name__} cannot be decided: F is not affine")
    symmetric = np.moveaxis(jacobians + jacobians.transpose(1, 0, 2), 2, 0) / 2
    try:
        np.linalg.cholesky(symmetric)
    except np.linalg.LinAlgError:
        smallest = np.linalg.eigvalsh(symmetric)[:, 0]
        raise ValueError(
            f"game {int(smallest.argmin())} of the batch is not strongly monotone: ε = {smallest.min():.3g}"
        ) from None


def gain_bound(constants: MonotonicityConstants, algebraic_connectivity: float) -> float | None:
    """(ι²/ε + ι)/λ2, which κ must exceed in Theorem 1 (eq. GainCondition); ``None`` when ε or λ2 is not positive."""
    if constants.epsilon <= 0 or algebraic_connectivity <= 0:
        return None
    return (constants.iota**2 / constants.epsilon + constants.iota) / algebraic_connectivity


def closed_loop_matrix(game: Game, graph: Graph, kappa: float, point: FloatArray | None = None) -> FloatArray:
    """M = Rᵀ dF + κ L⊗I_n of the static law, in the player-major stacking of eq. StackedVariable.

    Args:
        game: the game; its F is linearised unless it is affine.
        graph: the communication graph, on the game's players.
        kappa: κ ≥ 0. For the adaptive law at frozen gains, use a graph with the weights κ_ij a_ij and κ = 1.
        point: joint strategy (n,) at which dF is taken; x* when left out.

    Returns:
        Shape (Nn, Nn); entry i n + k belongs to x^i_k. Around an x* at which bounds hold some strategies, these do not
        move, and their rows and columns are left out.

    Raises:
        ValueError: when κ < 0 or the graph has another number of players.
    """
    require_non_negative("kappa", kappa)
    if graph.num_players != game.num_players:
        raise ValueError(f"the game has {game.num_players} players and the graph {graph.num_players}")
    at = game.nash_equilibrium if point is None else np.asarray(point, dtype=np.float64)
    jacobian = _jacobians(game, at[:, None])[:, :, 0]
    own = game.owners[:, None] == np.arange(game.num_players)
    blocks = [np.where(own[:, [player]], jacobian, 0.0) for player in range(game.num_players)]
    matrix = np.asarray(linalg.block_diag(*blocks) + kappa * np.kron(graph.laplacian, np.eye(game.dimension)))
    if point is None and game.has_bounds:
        free = ~(own & game.held_at_equilibrium).T.ravel()
        matrix = matrix[np.ix_(free, free)]
    return matrix


def spectral_abscissa(matrix: FloatArray) -> float:
    """Min Re μ over the eigenvalues μ of M, the rate of e^{−Mτ}; exactly 0 when that is rounding."""
    smallest = float(np.linalg.eigvals(matrix).real.min())
    return 0.0 if abs(smallest) <= _ZERO * np.linalg.norm(matrix, 2) else smallest


def convergence_rate(game: Game, signal: Signal, kappa: float, deadline: float) -> float:
    """The rate r with which the static law's error decays like e^{−r s} as t → T.

    A fixed graph gives the spectral abscissa of M. A signal on the transformed clock gives the Floquet rate
    −ln ρ(Π e^{−M_m Δ_m})/period, since dτ/ds → 1. A signal on the physical clock switches finitely often before T,
    so only its last graph counts, and the rate is 0 when that one is disconnected (docs/errata.md, 2).

    Args:
        game: the game; linearised at x* unless affine.
        signal: who hears whom.
        kappa: κ ≥ 0.
        deadline: T in seconds.

    Raises:
        ValueError: when κ < 0 or the signal has another number of players.
    """
    if signal.is_fixed or signal.clock == "physical":
        return spectral_abscissa(closed_loop_matrix(game, _last_graph(signal, deadline), kappa))
    steps = [
        linalg.expm(-closed_loop_matrix(game, graph, kappa) * dwell)
        for graph, dwell in zip(signal.graphs, signal.dwells, strict=True)
    ]
    monodromy = functools.reduce(lambda product, step: step @ product, steps)
    return -math.log(float(np.abs(np.linalg.eigvals(monodromy)).max())) / signal.period


def largest_stable_step(matrix: FloatArray) -> float | None:
    """The supremum of Θ with |1 − Θμ| ≤ 1 for every eigenvalue μ of M: min 2 Re μ/|μ|².

    Zero eigenvalues, which every disconnected graph has, are neither amplified nor damped and do not count.

    Returns:
        The step in units of τ; ``None`` when every step amplifies some error, or M = 0.
    """
    eigenvalues = np.linalg.eigvals(matrix)
    eigenvalues = eigenvalues[np.abs(eigenvalues) > _ZERO * np.linalg.norm(matrix, 2)]
    if eigenvalues.size == 0 or eigenvalues.real.min() <= 0:
        return None
    return float((2 * eigenvalues.real / np.abs(eigenvalues) ** 2).min())


def gain_growth(transformation: TimeTransformation) -> float:
    """The exponent p with which 1/λ'(s) grows like e^{p s}: 1 for the paper's λ, 2 for tanh, about 0 for rational λ.

    An error that decays like e^{−r s} has a bounded velocity g(t) u when r ≥ p and a finite ∫‖g u‖² dt when r > p/2.
    """
    near, far = 100.0, 200.0  # far enough for the limit, near enough for float64
    growth = np.log(transformation.derivative(near)) - np.log(transformation.derivative(far))
    return float(growth) / (far - near)


def certify(scenario: Scenario, kappa: float = 2.0) -> Certificate:
    """Everything that the theory says about the static law on ``scenario``.

    Args:
        scenario: the experiment; a random start is drawn once, with seed 0.
        kappa: κ ≥ 0 of the static law.

    Raises:
        ValueError: when κ < 0.
    """
    game, signal, clock = scenario.built_game, scenario.built_signal, scenario.built_clock
    constants = monotonicity_constants(game)
    connectivity = min(_connectivity(graph) for graph in signal.graphs)
    bound = gain_bound(constants, connectivity)
    matrices = [closed_loop_matrix(game, graph, kappa) for graph in signal.graphs]
    rate = convergence_rate(game, signal, kappa, scenario.deadline)
    largest_step = float(clock.theta[: clock.steps].max())
    steps = [largest_stable_step(matrix) for matrix in matrices]
    stable_step = min((step for step in steps if step is not None), default=None) if None not in steps else None
    input_rate, growth = _input_rate(game, signal, kappa, scenario.deadline, rate), gain_growth(clock.transformation)
    is_linear = game.is_affine and not game.has_bounds
    digits, peak_input = _sampled_digits(scenario, matrices) if is_linear else (None, 0.0)

    notes = []
    if not game.is_affine:
        notes.append("F is not affine: rate and largest stable step are those of the linearisation at x*")
    if game.has_bounds:
        held = int(game.held_at_equilibrium.sum())
        notes.append(
            f"a box confines the strategies and holds {held} of {game.dimension} components at x*; the theorems are "
            "for strategies without bounds, and the rate is the one near x*, of what the box does not hold"
        )
    if not signal.is_fixed and signal.clock == "physical":
        switches = signal.switches(0.0, scenario.deadline).size
        notes.append(
            f"the signal dwells in t: it switches {switches} times before T and its last graph is then frozen, so "
            "Assumption 2 fails in the transformed time in which the proof lives (docs/errata.md, 2)"
        )
    if not signal.is_fixed:
        notes.append(
            "the signal switches: the rate is what remains as t → T and says little about the time before, and the "
            "largest stable step is the smallest over the modes, which does not prove that their products are stable"
        )
    if bound is not None and kappa <= bound and rate > 0:
        notes.append("κ violates the gain condition, which is sufficient only: the rate shows convergence")
    if peak_input > scenario.input_limit:
        notes.append(f"the start asks for |u| = {peak_input:.4g}, above the input limit, which the prediction ignores")
    if scenario.built_start.is_random:
        notes.append("the start is random: the sampled digits are those of one draw, with seed 0")
    if clock.shortfall > SHORTFALL_WARNING:
        notes.append(f"the last step ends {clock.shortfall:.2%} of T short of the deadline; raise s_end to come closer")
    return Certificate(
        scenario=scenario.name,
        kappa=float(kappa),
        assumptions=check_assumptions(game, signal, constants),
        constants=constants,
        algebraic_connectivity=connectivity,
        gain_bound=bound,
        gain_condition_holds=bound is not None and kappa > bound,
        rate=rate,
        rate_is_exact=is_linear,
        effective_time=clock.effective_time,
        digits_from_rate=rate * (scenario.gain * scenario.deadline + scenario.s_end) / math.log(10),
        digits_sampled=digits,
        largest_step=largest_step,
        largest_stable_step=stable_step,
        step_margin=None if stable_step is None else stable_step / largest_step,
        input_rate=input_rate,
        velocity_bounded=input_rate >= growth,
        energy_finite=input_rate > growth / 2,
        shortfall=clock.shortfall,
        notes=tuple(notes),
    )


def check_assumptions(
    game: Game, signal: Signal, constants: MonotonicityConstants | None = None
) -> tuple[AssumptionCheck, ...]:
    """Assumptions 1–4 of the paper, each with the number that decides it.

    Args:
        game: the game of Assumptions 3 and 4.
        signal: the graphs of Assumptions 1 and 2.
        constants: of the game, when already known.
    """
    constants = constants or monotonicity_constants(game)
    smallest = min(_connectivity(graph) for graph in signal.graphs)
    joint = _connectivity(signal.union)
    convexity, meaning, verdict = _check_convexity(game)
    monotone: Verdict = "fails" if constants.epsilon <= 0 else "holds" if constants.exact else "sampled only"
    kind = "exact" if constants.exact else f"smallest of {constants.samples} samples within {constants.radius:g} of x*"
    return (
        AssumptionCheck(
            1,
            "the fixed graph is connected" if signal.is_fixed else "every graph is connected at every instant",
            smallest,
            "smallest λ2 over the modes",
            "holds" if smallest > 0 else "fails",
        ),
        AssumptionCheck(
            2,
            "the graphs are jointly connected over a period",
            joint,
            "λ2 of the union graph",
            "holds" if joint > 0 else "fails",
        ),
        AssumptionCheck(3, "each J_i is strictly convex and radially unbounded in x_i", convexity, meaning, verdict),
        AssumptionCheck(
            4, "F is strongly monotone and Lipschitz continuous", constants.epsilon, f"ε ({kind})", monotone
        ),
    )


def _check_convexity(game: Game) -> tuple[float, str, Verdict]:
    """Assumption 3: the deciding number, its meaning and the verdict."""
    report = check_game(game)
    if game.is_affine:
        # With F affine J_i is quadratic in x_i with this Hessian, so its definiteness decides both properties.
        jacobian = _jacobians(game, game.nash_equilibrium[:, None])[:, :, 0]
        blocks = [jacobian[np.ix_(game.owners == i, game.owners == i)] for i in range(game.num_players)]
        curvature = min(float(np.linalg.eigvalsh((block + block.T) / 2)[0]) for block in blocks)
        holds = curvature > 0 and report.assumption_3_holds
        return curvature, "smallest curvature of a J_i in x_i (exact)", "holds" if holds else "fails"
    pairs = zip(report.strictly_convex, report.radially_unbounded, strict=True)
    refuted = sum(not (convex and unbounded) for convex, unbounded in pairs)
    return float(refuted), "players whose J_i a sample refutes", "fails" if refuted else "sampled only"


def _jacobians(game: Game, points: FloatArray) -> FloatArray:
    """The Jacobian dF at points (n, B), shape (n, n, B); by central differences where the game does not know it."""
    known = game.jacobian(points)
    if known is not None:
        return known
    result = np.empty((game.dimension, game.dimension, points.shape[1]))
    for component in range(game.dimension):
        # A step of ε^{1/3} balances truncation and rounding; for an affine F only rounding is left.
        step = np.cbrt(np.finfo(np.float64).eps) * (1 + np.abs(points[component]))
        forward, backward = points.copy(), points.copy()
        forward[component] += step
        backward[component] -= step
        width = forward[component] - backward[component]
        result[:, component] = (game.pseudo_gradient(forward) - game.pseudo_gradient(backward)) / width
    return result


def _largest_norm(matrices: FloatArray) -> float:
    return float(np.linalg.svd(matrices, compute_uv=False)[:, 0].max())


def _connectivity(graph: Graph) -> float:
    """λ2, without the rounding that a disconnected graph's has."""
    return graph.algebraic_connectivity if graph.is_connected else 0.0


def _last_graph(signal: Signal, deadline: float) -> Graph:
    """The graph that acts as t → T."""
    if signal.is_fixed:
        return signal.graphs[0]
    last_switch = float(np.max(signal.switches(0.0, deadline), initial=0.0))
    return signal.graphs[int(signal.schedule((last_switch + deadline) / 2).modes)]


def _input_rate(game: Game, signal: Signal, kappa: float, deadline: float, rate: float) -> float:
    """The rate with which u decays as t → T.

    It is the error's, except that on a frozen disconnected graph the error stops short of x* while u still vanishes,
    at the smallest positive real part.
    """
    if signal.is_fixed or signal.clock == "transformed" or rate != 0:
        return rate
    matrix = closed_loop_matrix(game, _last_graph(signal, deadline), kappa)
    eigenvalues = np.linalg.eigvals(matrix)
    moving = eigenvalues[np.abs(eigenvalues) > _ZERO * np.linalg.norm(matrix, 2)]
    return float(moving.real.min(initial=math.inf))


def _sampled_digits(scenario: Scenario, matrices: list[FloatArray]) -> tuple[float, float]:
    """Digits at T of the sampled loop, the product of (I − Θ_k M_k), and the largest |u| on the way."""
    game, signal, clock = scenario.built_game, scenario.built_signal, scenario.built_clock
    start = scenario.built_start.draw(game.num_players, game.dimension, np.random.default_rng(0))
    error = (start - game.nash_equilibrium[:, None]).T.ravel()
    modes = signal.schedule(clock.signal_times[signal.clock][: clock.steps]).modes
    peak = 0.0
    for mode, theta in zip(modes, clock.theta[: clock.steps], strict=True):
        step = matrices[mode] @ error
        peak = max(peak, float(np.abs(step).max()))
        error = error - theta * step
        if not np.all(np.abs(error) < 1e150):  # squares would overflow; the loop has diverged beyond doubt
            error = np.full_like(error, 1e150)
            break
    distance = float(np.linalg.norm(error)) / (math.sqrt(game.num_players) * float(game.equilibrium_scale[0]))
    return -math.log10(max(distance, float(np.finfo(np.float64).tiny))), peak
