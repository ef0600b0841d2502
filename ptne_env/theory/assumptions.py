"""Lemma 1 and Assumptions 1–4 of the paper on one scenario, each with the number that decides it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from ptne_env.games import Game
from ptne_env.shared.arrays import frozen
from ptne_env.theory.check_game import check_game
from ptne_env.theory.constants import SAMPLES, MonotonicityConstants, jacobian_at_equilibrium
from ptne_env.world.clock import TimeTransformation
from ptne_env.world.world import World

Verdict: TypeAlias = Literal["holds", "fails", "sampled only"]

_GRID = frozen(np.linspace(0.0, 6.0, 2001))
"""Transformed times s at which a time transformation is checked."""

_LIMIT_TOLERANCE = 1e-4
"""A limit counts as 0 when it is within this fraction of T."""


class LemmaViolationError(ValueError):
    """The function violates a condition of Lemma 1."""


@dataclass(frozen=True)
class AssumptionCheck:
    """One assumption of the paper on one scenario.

    Attributes:
        name: ``"Lemma 1"`` or ``"Assumption 1"`` to ``"Assumption 4"``.
        statement: in words.
        value: the number that decides; ``None`` where λ violates Lemma 1 before there is a number.
        meaning: name of that number.
        verdict: ``"holds"``, ``"fails"``, or ``"sampled only"`` where no sample refutes it and nothing proves it.
    """

    name: str
    statement: str
    value: float | None
    meaning: str
    verdict: Verdict


def check_assumptions(world: World, constants: MonotonicityConstants) -> tuple[AssumptionCheck, ...]:
    """Lemma 1 on λ and Assumptions 1–4 on the graphs and the game (of a family: its representative).

    Args:
        world: the scenario, built.
        constants: of its game.
    """
    topology = world.topology
    smallest = min(graph.algebraic_connectivity for graph in topology.graphs)
    joint = topology.union.algebraic_connectivity
    connected = "the fixed graph is connected" if topology.is_fixed else "every graph is connected at every instant"
    union = "λ2 of the union graph" + ", almost surely" * (topology.is_random and smallest == 0)
    curvature, meaning, convex = _check_convexity(world.game)
    kind = "exact" if constants.exact else f"from {SAMPLES} samples within {constants.radius:g} of x*"
    monotone: Verdict = "fails" if constants.epsilon <= 0 else "holds" if constants.exact else "sampled only"
    return (
        _check_lemma(world),
        AssumptionCheck("Assumption 1", connected, smallest, "smallest λ2 over the modes", _holds(smallest > 0)),
        AssumptionCheck(
            "Assumption 2", "the graphs are jointly connected over a period", joint, union, _holds(joint > 0)
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
    statement = "λ is strictly increasing, λ → T, λ' → 0"
    try:
        remaining = check_time_transformation(world.clock.transformation)
    except LemmaViolationError as error:
        return AssumptionCheck("Lemma 1", f"{statement} ({error})", None, "limit of 1 − λ/T", "fails")
    return AssumptionCheck("Lemma 1", statement, remaining, "limit of 1 − λ/T", "holds")


def _check_convexity(game: Game) -> tuple[float, str, Verdict]:
    """Assumption 3: the deciding number, its meaning and the verdict."""
    if game.is_affine:
        # With F affine J_i is quadratic in x_i with this Hessian, so its definiteness decides both properties.
        jacobian = jacobian_at_equilibrium(game)
        blocks = [jacobian[np.ix_(game.owners == i, game.owners == i)] for i in range(game.num_players)]
        curvature = min(float(np.linalg.eigvalsh((block + block.T) / 2)[0]) for block in blocks)
        return curvature, "smallest curvature of a J_i in x_i (exact)", _holds(curvature > 0)
    report = check_game(game)
    pairs = zip(report.strictly_convex, report.radially_unbounded, strict=True)
    refuted = sum(not (convex and unbounded) for convex, unbounded in pairs)
    return float(refuted), "players whose J_i a sample refutes", "fails" if refuted else "sampled only"


def check_time_transformation(transformation: TimeTransformation) -> float:
    """Check the conditions (7a)–(7c) of Lemma 1, and that λ, λ' and λ^{-1} are consistent.

    (7a), (7b) and the inverse are checked on a grid that ends where λ is within 1e-7 T of T, or at s = 6. The limits
    (7c) are the values at s = 10, 100, …, 1e6, up to where a formula overflows; a slower λ, such as one that approaches
    T with 1/ln s, is refused.

    Returns:
        1 − λ(s)/T at the last of these s.

    Raises:
        LemmaViolationError: naming the first condition that is violated.
    """
    deadline = transformation.deadline
    reached = np.abs(deadline - transformation.time(_GRID)) < 1e-7 * deadline
    grid = np.linspace(0.0, float(_GRID[max(int(reached.argmax()), 1)]), _GRID.size) if reached.any() else _GRID
    time, derivative, step = transformation.time(grid), transformation.derivative(grid), grid[1]
    simpson = (derivative[:-1] + 4 * transformation.derivative(grid[:-1] + step / 2) + derivative[1:]) / 6
    mismatch = float(np.max(np.abs(np.diff(time) / step - simpson)))
    far = 10.0 ** np.arange(1, 7)
    with np.errstate(all="ignore"):  # formulas may overflow far out
        remaining, slopes = 1 - transformation.time(far) / deadline, transformation.derivative(far) / deadline
        valid = np.isfinite(remaining) & np.isfinite(slopes)
        last = np.flatnonzero(valid)[-1] if valid.any() else 0
        error = float(np.max(np.abs(transformation.inverse(time) - grid)))
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
        (
            "(7c) λ(s) → T",
            abs(remaining[last]) <= _LIMIT_TOLERANCE,
            f"T − λ(s) tends to {remaining[last] * deadline:.3g} s",
        ),
        ("(7c) λ'(s) → 0", abs(slopes[last]) <= _LIMIT_TOLERANCE, f"λ'(s) tends to {slopes[last] * deadline:.3g}"),
        ("λ^{-1}(λ(s)) = s", error <= 1e-6, f"off by {error:.3g}"),
    )
    for condition, holds, found in conditions:
        if not holds:
            raise LemmaViolationError(f"{type(transformation).__name__} violates {condition} of Lemma 1: {found}")
    return float(remaining[last])
