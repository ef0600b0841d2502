"""Lemma 1 and Assumptions 1–4 of the paper on one scenario, each with the number that decides it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from ptne_env.evaluation.metrics import number
from ptne_env.games import Game
from ptne_env.shared.arrays import BoolArray, FloatArray, freeze
from ptne_env.theory.constants import SAMPLES, MonotonicityConstants, jacobian_at_equilibrium
from ptne_env.world.clock import TimeTransformation
from ptne_env.world.world import World

Verdict: TypeAlias = Literal["holds", "fails", "sampled only"]

_GRID = freeze(np.linspace(0.0, 6.0, 2001))
"""Transformed times s at which a time transformation is checked."""

_LIMIT_TOLERANCE = 1e-4
"""Fraction of T below which a limit counts as 0."""

_SAMPLES, _RADIUS = 64, 5.0
"""The number of joint strategies on which costs are tested, and the size of their components."""


class LemmaViolationError(ValueError):
    """A time transformation violates a condition of Lemma 1."""


@dataclass(frozen=True)
class AssumptionCheck:
    """The check of one assumption of the paper on one scenario.

    Attributes:
        name: ``"Lemma 1"`` or ``"Assumption 1"`` to ``"Assumption 4"``.
        statement: the assumption in words.
        value: the number that decides; ``None`` where λ violates Lemma 1 before there is a number.
        meaning: what the number is.
        verdict: ``"holds"``, ``"fails"``, or ``"sampled only"`` where no sample refutes it and nothing proves it.
    """

    name: str
    statement: str
    value: float | None
    meaning: str
    verdict: Verdict

    def __str__(self) -> str:
        return f"{self.verdict}: {self.statement} ({number(self.value)}: {self.meaning})"


def check_assumptions(world: World, constants: MonotonicityConstants) -> tuple[AssumptionCheck, ...]:
    """Check Lemma 1 on λ, and Assumptions 1–4 on the graphs and the game; of a family, on its representative."""
    topology = world.topology
    smallest = min(graph.algebraic_connectivity for graph in topology.graphs)
    joint = topology.union.algebraic_connectivity
    connected = "the fixed graph is connected" if topology.is_fixed else "every graph is connected at every instant"
    # A random topology stays longer than any given time in one disconnected mode, now and then.
    is_uniform = not topology.is_random or smallest > 0
    directed = "; but links are directed" * any(graph.is_directed for graph in topology.graphs)
    union = "λ2 of the union graph" + " (over all time, almost surely, within no fixed ν)" * (not is_uniform) + directed
    modes = f"smallest λ2 over the modes{directed}"
    curvature, meaning, convex = _judge_convexity(world.game)
    kind = "exact" if constants.exact else f"from {SAMPLES} samples within {constants.radius:g} of x*"
    monotone: Verdict = "fails" if constants.epsilon <= 0 else "holds" if constants.exact else "sampled only"
    return (
        _check_lemma(world),
        AssumptionCheck("Assumption 1", connected, smallest, modes, _holds(smallest > 0 and not directed)),
        AssumptionCheck(
            "Assumption 2",
            "the graphs are jointly connected within some ν",
            joint,
            union,
            _holds(joint > 0 and is_uniform and not directed),
        ),
        AssumptionCheck(
            "Assumption 3", "each J_i is strictly convex and radially unbounded in x_i", curvature, meaning, convex
        ),
        AssumptionCheck(
            "Assumption 4",
            "F is strongly monotone and Lipschitz continuous",
            constants.epsilon,
            f"ε; ι = {constants.iota:.3g} ({kind})",
            monotone,
        ),
    )


def _holds(is_met: bool) -> Verdict:  # noqa: FBT001
    return "holds" if is_met else "fails"


def _check_lemma(world: World) -> AssumptionCheck:
    statement, meaning = "λ(0) = 0, λ'(0) = T, λ' > 0, λ → T, λ' → 0", "1 − λ/T at the largest s tried, up to 1e6"
    try:
        remaining = check_time_transformation(world.clock.transformation)
    except LemmaViolationError as error:
        return AssumptionCheck("Lemma 1", f"{statement} ({error})", None, meaning, "fails")
    verdict: Verdict = "holds" if remaining <= _LIMIT_TOLERANCE else "sampled only"
    return AssumptionCheck("Lemma 1", statement, remaining, meaning, verdict)


def _judge_convexity(game: Game) -> tuple[float, str, Verdict]:
    """Return the number that decides Assumption 3, what it is, and the verdict."""
    if game.is_affine:
        # With F affine J_i is quadratic in x_i with this Hessian, so its definiteness decides both properties.
        jacobian = jacobian_at_equilibrium(game)
        blocks = [jacobian[np.ix_(game.owners == i, game.owners == i)] for i in range(game.num_players)]
        curvature = min(float(np.linalg.eigvalsh((block + block.T) / 2)[0]) for block in blocks)
        return curvature, "smallest curvature of a J_i in x_i (exact)", _holds(curvature > 0)
    refuted = int(np.count_nonzero(~np.logical_and(*check_costs(game))))
    return float(refuted), "players whose J_i a sample refutes", "fails" if refuted else "sampled only"


def check_time_transformation(transformation: TimeTransformation) -> float:
    """Check the conditions (7a)–(7c) of Lemma 1, and that λ, λ' and λ^{-1} agree with each other.

    (7a), (7b) and the inverse are checked on a grid that ends where λ is within 1e-7 T of T, or at s = 6. The limits
    (7c) are the values at s = 10, 100, …, 1e6, up to where a formula overflows. A λ that still rises there may be
    right, such as one that approaches T with 1/ln s.

    Returns:
        1 − λ(s)/T at the last of these s; a warning says where it is not small, and still falls.

    Raises:
        LemmaViolationError: when a condition is violated; the message names the first one.
    """
    deadline = transformation.deadline
    reached = np.abs(deadline - transformation.time(_GRID)) < 1e-7 * deadline
    grid = np.linspace(0.0, float(_GRID[max(int(reached.argmax()), 1)]), _GRID.size) if reached.any() else _GRID
    time, derivative, step = transformation.time(grid), transformation.derivative(grid), grid[1]
    simpson = (derivative[:-1] + 4 * transformation.derivative(grid[:-1] + step / 2) + derivative[1:]) / 6
    mismatch = float(np.max(np.abs(np.diff(time) / step - simpson)))
    far = np.logspace(1, 6, 6, dtype=np.float64)
    with np.errstate(all="ignore"):  # formulas may overflow far out
        remaining, slopes = 1 - transformation.time(far) / deadline, transformation.derivative(far) / deadline
        valid = np.isfinite(remaining) & np.isfinite(slopes)
        last = np.flatnonzero(valid)[-1] if valid.any() else 0
        error = float(np.max(np.abs(transformation.inverse(time) - grid)))
    still = f"T − λ(s) is still {remaining[last] * deadline:.3g} s at s = {far[last]:g}"
    slope = f"λ'(s) is still {slopes[last] * deadline:.3g} at s = {far[last]:g}"
    falls = 0 < remaining[last] < 0.99 * remaining[last - 1]  # where only the first is finite, the other is NaN
    rises = np.all(np.diff(time) > 0) and np.all(transformation.derivative(_GRID) > 0) and not np.any(slopes[valid] < 0)
    conditions = (
        ("(7a) λ(0) = 0", abs(time[0]) <= 1e-12 * deadline, f"λ(0) = {time[0]}"),
        (
            "(7a) λ'(0) = T",
            abs(derivative[0] - deadline) <= 1e-9 * deadline,
            f"λ'(0) = {derivative[0]}, T = {deadline}",
        ),
        ("(7a) λ is differentiable with derivative λ'", mismatch <= 1e-5 * deadline, f"off by {mismatch:.3g} s"),
        ("(7b) λ is strictly increasing", rises, "λ decreases or stalls on [0, 6], or λ' is negative further out"),
        ("(7c) λ(s) → T", abs(remaining[last]) <= _LIMIT_TOLERANCE or falls, still),
        ("(7c) λ'(s) → 0", abs(slopes[last]) <= _LIMIT_TOLERANCE, slope),
        ("λ^{-1}(λ(s)) = s", error <= 1e-6, f"off by {error:.3g}"),
    )
    for condition, holds, evidence in conditions:
        if not holds:
            raise LemmaViolationError(f"{type(transformation).__name__} violates {condition} of Lemma 1: {evidence}")
    if remaining[last] > _LIMIT_TOLERANCE:
        warnings.warn(
            f"{still}: λ satisfies Lemma 1 only if it goes on to T as slowly as it has come here", stacklevel=2
        )
    return float(remaining[last])


def check_costs(game: Game) -> tuple[BoolArray, BoolArray]:
    """Test on samples which costs J_i are strictly convex, and which are radially unbounded, in the own strategy x_i.

    Samples can refute Assumption 3 but not prove it. They are 64 joint strategies with components of U(−5, 5); with two
    bounds, from the interval between them; with one bound, from an interval of length 10 next to it.

    Returns:
        Per player, shape (N,) each, whether every sampled chord of J_i lies above J_i, and whether J_i grew along every
        sampled ray. Where the box is bounded the second holds, as a minimiser exists then.
    """
    generator = np.random.default_rng(0)
    points = _move_into_box(game, generator.uniform(-_RADIUS, _RADIUS, (game.dimension, _SAMPLES)))
    verdicts = []
    for player in range(game.num_players):
        direction = np.zeros_like(points)
        direction[game.owners == player] = generator.normal(size=(game.action_dims[player], _SAMPLES))
        direction /= np.linalg.norm(direction, axis=0)
        convex = _is_strictly_convex(game, points, player, direction)
        verdicts.append((convex, _grows_along_rays(game, points, player, direction)))
    convex, unbounded = np.array(verdicts).T
    return convex, unbounded


def _move_into_box(game: Game, drawn: FloatArray) -> FloatArray:
    """Map points drawn from [−5, 5] into the game's box."""
    if game.box is None:
        return drawn
    low, high = game.box
    low = np.where(np.isfinite(low), low, np.where(np.isfinite(high), high - 2 * _RADIUS, -_RADIUS))
    high = np.where(np.isfinite(high), high, low + 2 * _RADIUS)
    return low + (high - low) * (drawn + _RADIUS) / (2 * _RADIUS)


def _costs_on_ray(
    game: Game, points: FloatArray, player: int, ray: FloatArray, distances: Sequence[float]
) -> FloatArray:
    """Return the player's costs after its strategy moved by these distances, shape (distances, samples)."""
    with np.errstate(over="ignore"):  # an exponential cost may overflow to +inf, which is growth
        return np.array([game.costs(points + distance * ray)[player] for distance in distances])


def _is_strictly_convex(game: Game, points: FloatArray, player: int, direction: FloatArray) -> bool:
    if game.box is not None:  # between two points of the box
        direction = np.where(direction != 0, np.roll(points, 1, axis=1) - points, 0.0) / 2
        points = points + direction
    low, middle, high = _costs_on_ray(game, points, player, direction, (-1.0, 0.0, 1.0))
    return bool(np.all(low + high - 2 * middle > 1e-9 * (1 + np.abs(middle))))


def _grows_along_rays(game: Game, points: FloatArray, player: int, direction: FloatArray) -> bool:
    grows = True
    for sign in (-1.0, 1.0):
        ray = sign * direction
        if game.box is not None:  # only in unbounded directions
            ray = np.where(np.isinf(np.where(ray < 0, *game.box)), ray, 0.0)
            ray /= np.maximum(np.linalg.norm(ray, axis=0), 1e-300)
        start, *costs = _costs_on_ray(game, points, player, ray, (0.0, 1e2, 1e3, 1e4))[:, np.any(ray != 0, axis=0)]
        grows &= bool(np.all(np.greater_equal(costs[1:], costs[:-1])) and np.all(costs[-1] > start))
    return grows
