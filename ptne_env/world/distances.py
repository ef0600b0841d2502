"""Relative distances to the equilibrium, which rewards, the success criterion and metrics share.

Where x* = 0, within the tolerance of solvers, the scale is 1 instead of ‖x*‖.
"""

from __future__ import annotations

import numpy as np

from ptne_env.games import Game
from ptne_env.shared.arrays import BoolArray, FloatArray, array_namespace, is_numpy, ordered_sum, root

FLOOR = 1e-12
"""The least distance of which the logarithm is taken, so that at most twelve digits count."""

# Arrays, because numpy takes longer to read a number of Python than to multiply by it.
_FLOOR, _DIGITS_PER_NAT = np.array(FLOOR), np.array(-1 / np.log(10))

SUCCESS_DISTANCE = 5e-3
"""The relative distance within which an episode succeeds and a run has settled (the paper's 0.5 %)."""

_FAILED = np.zeros(1, dtype=np.bool_)
_FAILED.flags.writeable = False


def player_distances(estimates: FloatArray, game: Game) -> FloatArray:
    """Return d^i = ‖x^i − x*‖/‖x*‖ of each player's estimate: (n, N, B) to (N, B)."""
    distances = root(player_squares(estimates, game))
    distances /= game.equilibrium_scale
    return distances


def player_squares(estimates: FloatArray, game: Game) -> FloatArray:
    """Return ‖x^i − x*‖² of each player's estimate: (n, N, B) to (N, B)."""
    errors = estimates - game.nash_equilibria[:, None, :]
    return np.einsum("cib,cib->ib", errors, errors) if is_numpy(errors) else ordered_sum(errors**2)


def strategy_distance(strategies: FloatArray, game: Game) -> FloatArray:
    """Return ‖x − x*‖/‖x*‖, the paper's relative error: (n, B) to (B,)."""
    return root(ordered_sum((strategies - game.nash_equilibria) ** 2)) / game.equilibrium_scale


def estimate_distance(estimates: FloatArray, game: Game) -> FloatArray:
    """Return ‖𝐱 − 1⊗x*‖/(√N ‖x*‖), the quantity of the theorems: (n, N, B) to (B,)."""
    return over_players(player_distances(estimates, game))


def is_success(distances: FloatArray) -> BoolArray:
    """Return whether all estimates together are within :data:`SUCCESS_DISTANCE`, from the d^i: (N, B) to (B,)."""
    players, batch = distances.shape
    reach = players * SUCCESS_DISTANCE  # a player alone may be √N times as far away as all are together
    if batch == 1 and distances.item(0) > reach:
        return _FAILED
    within: BoolArray = distances[0] <= reach
    if np.count_nonzero(within):
        within[within] = over_players(distances[:, within]) <= SUCCESS_DISTANCE
    return within


def over_players(distances: FloatArray) -> FloatArray:
    """Return the distance of all estimates, from the d^i: (N, B) to (B,)."""
    return root(ordered_sum(distances**2) / len(distances))


def digits(distance: FloatArray) -> FloatArray:
    """Return −log10 of a distance, floored at 1e-12; any shape."""
    # The natural logarithm is vectorised in numpy and several times as fast as log10.
    xp = array_namespace(distance)
    result: FloatArray = xp.log(xp.maximum(distance, _FLOOR))
    result *= _DIGITS_PER_NAT
    return result
