"""Lemma 1 and Assumptions 1–4 of the paper on one scenario, each with the number that decides it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from ptne_env.games import Game
from ptne_env.theory.check_game import check_game
from ptne_env.theory.constants import MonotonicityConstants, jacobian_at_equilibrium
from ptne_env.world.clock import LemmaViolationError, check_time_transformation
from ptne_env.world.world import World

Verdict: TypeAlias = Literal["holds", "fails", "sampled only"]


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
    union = "λ2 of the union graph" + ", almost surely" * (topology.joint_connectivity == "almost surely")
    curvature, meaning, convex = _check_convexity(world.game)
    kind = "exact" if constants.exact else f"from {constants.samples} samples within {constants.radius:g} of x*"
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
