"""How far from the equilibrium: the relative distances that rewards, success and metrics share.

Where x* = 0 the scale is 1 instead of ‖x*‖.
"""

from __future__ import annotations

import numpy as np

from ptne_env.arrays import FloatArray, ordered_sum

FLOOR = 1e-12
"""Distances are floored here before their logarithm is taken: twelve digits is all that is counted."""

SUCCESS_DISTANCE = 5e-3
"""An episode succeeds, and a run has settled, within this relative distance (the paper's 0.5 %)."""


def scale(equilibrium: FloatArray) -> float:
    """‖x*‖, or 1 where x* = 0; equilibrium of shape (n,)."""
    return float(np.linalg.norm(equilibrium)) or 1.0


def player_distances(estimates: FloatArray, equilibrium: FloatArray) -> FloatArray:
    """d^i = ‖x^i − x*‖/‖x*‖ of each player's estimate: (n, N, B) and (n,) to (N, B)."""
    errors = estimates - equilibrium[:, None, None]
    errors *= errors
    distances = np.add.reduce(errors, axis=0)
    np.sqrt(distances, out=distances)
    distances /= scale(equilibrium)
    return distances


def strategy_distance(strategies: FloatArray, equilibrium: FloatArray) -> FloatArray:
    """‖x − x*‖/‖x*‖, the paper's relative error: (n, B) and (n,) to (B,)."""
    return np.sqrt(ordered_sum((strategies - equilibrium[:, None]) ** 2)) / scale(equilibrium)


def estimate_distance(estimates: FloatArray, equilibrium: FloatArray) -> FloatArray:
    """‖𝐱 − 1⊗x*‖/(√N ‖x*‖), what the theorems claim: (n, N, B) and (n,) to (B,)."""
    return np.sqrt(ordered_sum(player_distances(estimates, equilibrium) ** 2) / estimates.shape[1])


def consensus_error(estimates: FloatArray, equilibrium: FloatArray) -> FloatArray:
    """‖𝐱 − 1⊗x̄‖/(√N ‖x*‖) with x̄ the mean of all estimates: (n, N, B) and (n,) to (B,)."""
    players = estimates.shape[1]
    deviations = estimates - ordered_sum(estimates, axis=1)[:, None] / players
    return np.sqrt(ordered_sum(ordered_sum(deviations**2)) / players) / scale(equilibrium)


def digits(distance: FloatArray) -> FloatArray:
    """−log10 of a distance, floored at 1e-12; any shape."""
    return -np.log10(np.maximum(distance, FLOOR))
