"""Variational inequalities on a box: the equilibria of games whose strategies are confined."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ptne_env.arrays import FloatArray, ordered_sum

Field = Callable[[FloatArray], FloatArray]

TOLERANCE = 1e-12
"""‖x − Π(x − F(x))‖, relative to 1 + ‖x‖, at which the solver stops."""


def natural_map(points: FloatArray, field: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """x − Π(x − F(x)), which is 0 exactly at the solutions of the variational inequality; all (n, G)."""
    return points - np.clip(points - field, low, high)


def solve_box(
    field: Field,
    jacobian: Field | None,
    low: FloatArray,
    high: FloatArray,
    start: FloatArray,
    *,
    iterations: int = 10_000,
) -> FloatArray:
    """x in [low, high] with F(x)ᵀ(y − x) ≥ 0 for all y in the box, for G monotone Lipschitz fields F at once.

    A step is Newton's on the natural map (the active-set step: components pressed against a bound are put on it, the
    others solve F = 0) wherever that at least halves the smallest residual so far, and otherwise Korpelevich's
    extragradient step with a searched length. The latter alone converges for monotone F, the former ends an affine
    problem as soon as the active set is right. See Facchinei and Pang, Finite-Dimensional Variational Inequalities and
    Complementarity Problems, 2003, chapters 8 and 12. What happens to one field does not depend on the others.

    Args:
        field: F, (n, G) to (n, G).
        jacobian: dF, (n, G) to (n, n, G); without it every step is an extragradient step.
        low: lower bounds, (n, G) or (n, 1); −inf where there is none.
        high: upper bounds likewise.
        start: first points, (n, G).
        iterations: most steps to take.

    Returns:
        The points reached, (n, G). Whether they solve the inequality is for the caller to check.
    """
    x = np.clip(start, low, high)
    value = field(x)
    residual = _norm(natural_map(x, value, low, high))
    goal = np.full_like(residual, np.inf)  # a Newton step must reach half of the residual that the last one left
    length = np.ones_like(residual)
    for _ in range(iterations):
        unsolved = residual > TOLERANCE * (1 + _norm(x))
        if not unsolved.any():
            break
        newton = np.zeros_like(unsolved)
        if jacobian is not None:
            trial, reached = _newton(field, jacobian, x, value, low, high)
            newton = unsolved & (reached <= goal / 2)  # False where the step does not exist and is NaN
            goal = np.where(newton, reached, goal)
            x = np.where(newton, trial, x)
        if (unsolved & ~newton).any():
            middle = np.clip(x - length * value, low, high)
            there = field(middle)
            steepness = length * _norm(there - value)
            moved = _norm(middle - x)
            short = steepness <= 0.9 * moved
            x = np.where(unsolved & ~newton & short, np.clip(x - length * there, low, high), x)
            length = np.where(short, np.where(steepness <= 0.4 * moved, 1.5 * length, length), length / 2)
        value = field(x)
        residual = _norm(natural_map(x, value, low, high))
    if jacobian is not None:  # one step more, to the last digits
        trial, reached = _newton(field, jacobian, x, value, low, high)
        x = np.where(reached <= residual, trial, x)
    return x


def _newton(
    field: Field, jacobian: Field, x: FloatArray, value: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Newton's next point in the box, and its residual."""
    trial = np.clip(_active_set_step(x, value, jacobian(x), low, high), low, high)
    return trial, _norm(natural_map(trial, field(trial), low, high))


def _active_set_step(
    x: FloatArray, value: FloatArray, jacobian: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Newton's next point; NaN where its system is singular."""
    below, above = x - value <= low, x - value >= high
    held = below | above
    matrices = np.where(held[:, None], np.eye(len(x))[:, :, None], jacobian)
    wanted = np.where(below, low - x, np.where(above, high - x, -value))
    stack, right = np.moveaxis(matrices, 2, 0).copy(), wanted.T[..., None].copy()
    singular = np.linalg.slogdet(stack)[0] == 0
    stack[singular], right[singular] = np.eye(len(x)), np.nan
    return x + np.linalg.solve(stack, right)[..., 0].T


def _norm(vectors: FloatArray) -> FloatArray:
    return np.sqrt(ordered_sum(vectors**2))
