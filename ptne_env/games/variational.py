"""Variational inequalities on a box, whose solutions are the equilibria of games with bounded strategies."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ptne_env.shared.arrays import FloatArray, ordered_sum

Field = Callable[[FloatArray], FloatArray]


def natural_map(points: FloatArray, field: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """x − Π(x − F(x)), which is 0 exactly at the solutions of the variational inequality; all (n, G)."""
    return points - np.clip(points - field, low, high)


def solve_box(field: Field, jacobian: Field, low: FloatArray, high: FloatArray, start: FloatArray) -> FloatArray:
    """Find x in [low, high] with F(x)ᵀ(y − x) ≥ 0 for all y in the box, for G monotone Lipschitz fields F at once.

    A step is Newton's on the natural map (the active-set step: components pressed against a bound are set to it, the
    others solve F = 0) wherever that at least halves the smallest residual so far, and otherwise Korpelevich's
    extragradient step with a line search. Extragradient steps converge for every monotone F; a Newton step solves an
    affine problem as soon as the active set is right. See Facchinei and Pang, Finite-Dimensional Variational
    Inequalities and Complementarity Problems, 2003, chapters 8 and 12. Fields are solved independently of each other.

    Args:
        field: F, (n, G) to (n, G).
        jacobian: dF, (n, G) to (n, n, G).
        low: lower bounds, (n, G) or (n, 1); −inf where there is none.
        high: upper bounds likewise.
        start: first points, (n, G).

    Returns:
        The points reached when ‖x − Π(x − F(x))‖ ≤ 1e-12 (1 + ‖x‖), or after 10,000 steps, (n, G). The caller checks
        whether they solve the inequality.
    """
    x = np.clip(start, low, high)
    value = field(x)
    residual = _norm(natural_map(x, value, low, high))
    goal = np.full_like(residual, np.inf)  # a Newton step must reach half the residual of the last Newton step
    length = np.ones_like(residual)
    for _ in range(10_000):
        unsolved = residual > 1e-12 * (1 + _norm(x))
        if not unsolved.any():
            break
        trial, reached = _newton(field, jacobian, x, value, low, high)
        newton = unsolved & (reached <= goal / 2)  # False where no Newton step exists and the residual is NaN
        goal = np.where(newton, reached, goal)
        x = np.where(newton, trial, x)
        others = unsolved & ~newton
        if others.any():
            middle = np.clip(x - length * value, low, high)
            there = field(middle)
            steepness = length * _norm(there - value)
            moved = _norm(middle - x)
            short = steepness <= 0.9 * moved
            x = np.where(others & short, np.clip(x - length * there, low, high), x)
            changed = np.where(short, np.where(steepness <= 0.4 * moved, 1.5 * length, length), length / 2)
            length = np.where(others, changed, length)
        value = field(x)
        residual = _norm(natural_map(x, value, low, high))
    trial, reached = _newton(field, jacobian, x, value, low, high)  # a further step, to the last digits
    return np.where(reached <= residual, trial, x)


def _newton(
    field: Field, jacobian: Field, x: FloatArray, value: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the point of the active-set step, in the box, and its residual; NaN where its system is singular."""
    below, above = x - value <= low, x - value >= high
    matrices = np.where((below | above)[:, None], np.eye(len(x))[:, :, None], jacobian(x))
    wanted = np.where(below, low - x, np.where(above, high - x, -value))
    stack, right = np.moveaxis(matrices, 2, 0).copy(), wanted.T[..., None].copy()
    with np.errstate(invalid="ignore"):
        singular = ~(np.abs(np.linalg.slogdet(stack)[0]) > 0)  # also where dF does not exist
    stack[singular], right[singular] = np.eye(len(x)), np.nan
    trial = np.clip(x + np.linalg.solve(stack, right)[..., 0].T, low, high)
    return trial, _norm(natural_map(trial, field(trial), low, high))


def _norm(vectors: FloatArray) -> FloatArray:
    return np.sqrt(ordered_sum(vectors**2))
