"""The compiled step: transition, own gradients, distances and observations in one pass over memory; needs numba.

:mod:`ptne_env.world.fused` calls it. The equations are those of ``dynamics``, ``games``, ``distances`` and ``encoder``,
with the same operations in the same order, so that all numbers are the same bit for bit.

Environments are last. The pass works on a tile of them at a time, whose numbers stay in the first cache. The table of
games has one column per environment, or one tile of columns where all environments play one game.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

# Without fastmath: no operation is reordered, and none is contracted.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}


def _part(function: Any) -> Any:
    """``function`` as a part of another, with which it is compiled and kept."""
    return njit(**_OPTIONS)(function)


def kept_on_disk(function: Any) -> Any:
    """``function``, compiled at its first call, and kept on disk, unless there is no folder to write it to."""
    try:
        return njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:  # "cannot cache function …: no locator available for file …"
        return njit(**_OPTIONS)(function)


@kept_on_disk
def is_inside(actions: Any, bound: float) -> bool:
    """Whether all actions (B, N, n) are finite and within ±bound."""
    flat, inside = actions.reshape(-1), True
    for k in range(flat.size):
        inside &= abs(flat[k]) <= bound
    return inside


@_part
def _move(x: Any, estimates: Any, actions: Any, held: Any, first: int, width: int) -> None:
    """x^i + Θ u^i, where u^i is the action."""
    n, players = x.shape[:2]
    for i in range(players):
        theta = held[min(i, len(held) - 1)]
        for c in range(n):
            new, old = x[c, i], estimates[c, i, first : first + width]
            for w in range(width):
                new[w] = theta[w] * np.float64(actions[first + w, i, c]) + old[w]


@_part
def _project(x: Any, owners: Any, box: Any, at: int, width: int) -> None:
    """Π(x): the real strategies in the box, whose lower bounds are the first half of its rows."""
    for c in range(len(box) // 2):
        own, low, high = x[c, owners[c]], box[c, at : at + width], box[len(box) // 2 + c, at : at + width]
        for w in range(width):
            own[w] = min(max(own[w], low[w]), high[w])


@_part
def _affine_gradients(gradients: Any, x: Any, owners: Any, game: Any, at: int, width: int) -> None:
    """Block i is Σ_j A_ij x^i_j + b_i."""
    n = len(gradients)
    for k in range(n):
        total, constant = gradients[k], game[n * n + k, at : at + width]
        for c in range(n):
            entry, estimate = game[c * n + k, at : at + width], x[c, owners[k]]
            for w in range(width):
                total[w] = entry[w] * estimate[w] if c == 0 else total[w] + entry[w] * estimate[w]
        for w in range(width):
            total[w] += constant[w]


@_part
def _energy_gradients(gradients: Any, x: Any, game: Any, at: int, width: int) -> None:
    """c Σ_j x^i_j + (2 a_i + c) x^i_i + (d − 2 a_i b_i)."""
    players, price = len(gradients), game[0, at : at + width]
    for i in range(players):
        total, own = gradients[i], x[i, i]
        factor, constant = game[1 + i, at : at + width], game[1 + players + i, at : at + width]
        for c in range(players):
            estimate = x[c, i]
            for w in range(width):
                total[w] = estimate[w] if c == 0 else total[w] + estimate[w]
        for w in range(width):
            total[w] = total[w] * price[w] + factor[w] * own[w] + constant[w]


@_part
def _distances(distances: Any, x: Any, game: Any, total: Any, at: int, first: int, width: int) -> None:
    """d^i = ‖x^i − x*‖/‖x*‖."""
    n, players = x.shape[:2]
    norm = game[n, at : at + width]
    for i in range(players):
        for c in range(n):
            estimate, goal = x[c, i], game[c, at : at + width]
            for w in range(width):
                error = estimate[w] - goal[w]
                total[w] = error * error if c == 0 else total[w] + error * error
        for w in range(width):
            distances[first + w, i] = np.sqrt(total[w]) / norm[w]


@_part
def _keep(target: Any, rows: Any, largest: float, first: int, width: int) -> bool:
    """Copy rows of a tile to where it belongs; whether every entry is a number within ±largest."""
    inside = True
    for k in range(len(rows)):
        row, kept = rows[k], target[k, first : first + width]
        for w in range(width):
            kept[w] = row[w]
            inside &= abs(row[w]) <= largest
    return inside


@_part
def _show(  # noqa: C901 - one loop per slice
    shown: Any, i: int, x: Any, gradients: Any, weight: Any, shared: Any, places: Any, width: int
) -> None:
    """The observations of player i in a tile of environments."""
    n, slots = len(x), len(weight)
    m, at = (len(places) - slots) // 2, 0
    for place in range(m):  # own gradient, padded with 0
        entry, gradient, factor = shown[at + place], gradients[places[slots + place, i]], places[slots + m + place, i]
        for w in range(width):
            entry[w] = gradient[w] * factor
    at += m
    for c in range(n):
        entry, mine = shown[at + c], x[c, i]
        for w in range(width):
            entry[w] = mine[w]
    for d in range(slots):  # x^j − x^i, 0 where the link is down
        at, link = at + n, weight[d, i]
        for c in range(n):
            entry, theirs, mine = shown[at + c], x[c, places[d, i]], x[c, i]
            for w in range(width):
                entry[w] = (theirs[w] - mine[w]) * (link[w] > 0)
    at += n
    for d in range(slots):
        entry, link = shown[at + d], weight[d, i]
        for w in range(width):
            entry[w] = link[w]
    at += slots
    for k in range(len(shared)):  # the clock, and the age of the graph
        shown[at + k, :width] = shared[k, min(i, shared.shape[1] - 1), :width]
    at += len(shared)
    shown[at : at + x.shape[1], :width] = 0
    shown[at + i, :width] = 1


@kept_on_disk
def step(
    # Actions; where observations go.
    actions: Any, observations: Any,
    # State.
    instants: Any, estimates: Any,
    # Results.
    next_instants: Any, next_estimates: Any, gradients: Any, distances: Any, is_last: Any,
    # Graph and its age by instant.
    modes: Any, ages: Any,
    # Games, row by row: x*, ‖x*‖, the box in 2 n rows or none, and A transposed and b, or c, 2a + c and d − 2ab.
    game: Any, boxes: int, is_affine: bool, tile: int,
    # World: Θ and the clock as observed, by instant; a_ij by slot; owners of components. For each player: neighbour by
    # slot, own gradients, and 1 or 0 for places that are own or padded. The half-width of the action box; the range.
    theta: Any, clock: Any, weights: Any, owners: Any, places: Any, bound: float, largest: float,
) -> bool:  # fmt: skip
    """Everything that a step does to B environments.

    ``False`` if an action is outside the box, before anything is written, or if an environment left the range.
    """
    if not is_inside(actions, bound):
        return False
    n, players, batch = estimates.shape
    slots, end, size = len(weights), theta.shape[1] - 1, observations.shape[2]
    box, formula = game[n + 1 : n + 1 + boxes], game[n + 1 + boxes :]
    x, weight = np.empty((n, players, tile)), np.empty((slots, players, tile))
    gradient, line, held = np.empty((n, tile)), np.empty(tile), np.empty((len(theta), tile))
    shared, shown = np.empty((5, clock.shape[1], tile), np.float32), np.empty((size, tile), np.float32)
    inside = True
    for first in range(0, batch, tile):
        width = min(tile, batch - first)
        at = first if game.shape[1] > tile else 0
        for w in range(width):
            b, now = first + w, instants[first + w]
            after = min(now + 1, end)
            next_instants[b], is_last[b] = after, after == end
            held[:, w] = theta[:, now]
            shared[:4, :, w] = clock[:4, :, after]
            shared[4, :, w] = ages[after, b if ages.shape[1] > 1 else 0]
            mode = 0 if weights.shape[2] == 1 else modes[after, b if modes.shape[1] > 1 else 0]
            weight[:, :, w] = weights[:, :, mode]
        _move(x, estimates, actions, held, first, width)
        _project(x, owners, box, at, width)
        if is_affine:
            _affine_gradients(gradient, x, owners, formula, at, width)
        else:
            _energy_gradients(gradient, x, formula, at, width)
        _distances(distances, x, game, line, at, first, width)
        inside &= _keep(gradients, gradient, largest, first, width)
        inside &= _keep(next_estimates.reshape(n * players, -1), x.reshape(n * players, -1), largest, first, width)
        for i in range(players):
            _show(shown, i, x, gradient, weight, shared, places, width)
            for w in range(width):
                row = observations[first + w, i]
                for k in range(size):
                    row[k] = shown[k, w]
    return inside
