"""The paper's assumptions on one scenario, each with the number that decides it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from ptne_env.games import Game, check_game
from ptne_env.theory.constants import MonotonicityConstants, jacobians, monotonicity_constants
from ptne_env.world.clock import LemmaViolationError, TimeTransformation, check_time_transformation
from ptne_env.world.switching import SwitchingTopology

Verdict: TypeAlias = Literal["holds", "fails", "sampled only"]


@dataclass(frozen=True)
class AssumptionCheck:
    """One assumption of the paper on one scenario.

    Attributes:
        number: 1 to 4.
        statement: in words.
        value: the number that decides.
        meaning: name of that number.
        verdict: ``"holds"``, ``"fails"``, or ``"sampled only"`` where no sample refutes it and nothing proves it.
    """

    number: int
    statement: str
    value: float
    meaning: str
    verdict: Verdict


@dataclass(frozen=True)
class LemmaCheck:
    """Whether λ is a time transformation of Lemma 1.

    Attributes:
        remaining: the limit of 1 − λ(s)/T as s → ∞, extrapolated; ``None`` where λ fails an earlier condition.
        verdict: ``"holds"`` or ``"fails"``.
        reason: the first condition that is violated; empty when none is.
    """

    remaining: float | None
    verdict: Verdict
    reason: str


def check_assumptions(
    game: Game, topology: SwitchingTopology, constants: MonotonicityConstants | None = None
) -> tuple[AssumptionCheck, ...]:
    """Assumptions 1–4 of the paper, each with the number that decides it.

    Args:
        game: the game of Assumptions 3 and 4.
        topology: the graphs of Assumptions 1 and 2.
        constants: of the game, when already known.
    """
    constants = constants or monotonicity_constants(game)
    smallest = min(graph.algebraic_connectivity for graph in topology.graphs)
    joint = topology.union.algebraic_connectivity
    convexity, meaning, verdict = _check_convexity(game)
    monotone: Verdict = "fails" if constants.epsilon <= 0 else "holds" if constants.exact else "sampled only"
    kind = "exact" if constants.exact else f"smallest of {constants.samples} samples within {constants.radius:g} of x*"
    return (
        AssumptionCheck(
            1,
            "the fixed graph is connected" if topology.is_fixed else "every graph is connected at every instant",
            smallest,
            "smallest λ2 over the modes",
            "holds" if smallest > 0 else "fails",
        ),
        AssumptionCheck(
            2,
            "the graphs are jointly connected over a period",
            joint,
            "λ2 of the union graph" + (", almost surely" if topology.joint_connectivity == "almost surely" else ""),
            "holds" if joint > 0 else "fails",
        ),
        AssumptionCheck(3, "each J_i is strictly convex and radially unbounded in x_i", convexity, meaning, verdict),
        AssumptionCheck(
            4, "F is strongly monotone and Lipschitz continuous", constants.epsilon, f"ε ({kind})", monotone
        ),
    )


def check_lemma(transformation: TimeTransformation) -> LemmaCheck:
    """Lemma 1 on λ; see :func:`ptne_env.world.clock.check_time_transformation`."""
    try:
        return LemmaCheck(check_time_transformation(transformation), "holds", "")
    except LemmaViolationError as error:
        return LemmaCheck(None, "fails", str(error))


def _check_convexity(game: Game) -> tuple[float, str, Verdict]:
    """Assumption 3: the deciding number, its meaning and the verdict."""
    if game.is_affine:
        # With F affine J_i is quadratic in x_i with this Hessian, so its definiteness decides both properties.
        jacobian = jacobians(game, game.nash_equilibrium[:, None])[:, :, 0]
        blocks = [jacobian[np.ix_(game.owners == i, game.owners == i)] for i in range(game.num_players)]
        curvature = min(float(np.linalg.eigvalsh((block + block.T) / 2)[0]) for block in blocks)
        return curvature, "smallest curvature of a J_i in x_i (exact)", "holds" if curvature > 0 else "fails"
    report = check_game(game)
    pairs = zip(report.strictly_convex, report.radially_unbounded, strict=True)
    refuted = sum(not (convex and unbounded) for convex, unbounded in pairs)
    return float(refuted), "players whose J_i a sample refutes", "fails" if refuted else "sampled only"
