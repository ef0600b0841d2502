"""The compiled step: transition, own gradients, distances and observations in one pass over memory; needs numba.

:mod:`ptne_env.fused` calls it. The equations are those of ``dynamics``, ``games``, ``distances`` and ``encoder``, with
the same operations in the same order, so that all numbers are the same bit for bit.

Environments are last. The pass works on a tile of them at a time, whose numbers stay in the first cache. A table of
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
    """Whether all actions (B, N, action size) are finite and within ±bound."""
    flat, inside = actions.reshape(-1), True
    for k in range(flat.size):
        inside &= abs(flat[k]) <= bound
    return inside


@_part
def _tick(after: Any, held: Any, now: Any, theta: Any) -> None:
    """The next instants, and the Θ of this one by each clock."""
    for w in range(len(now)):
        after[w] = min(now[w] + 1, theta.shape[1] - 1)
        for i in range(len(theta)):
            held[i, w] = theta[i, now[w]]


@_part
def _move(
    x: Any, estimates: Any, actions: Any, theta: Any, unit: Any, order: Any, limit: float, first: int, stop: int
) -> None:
    """x^i + Θ u^i, where u^i is the action, or under ``local`` the action in units of σ_i within the limit."""
    n, players = x.shape[:2]
    for i in range(players):
        held = theta[min(i, len(theta) - 1)]
        for place in range(n):
            c = order[i, place]
            new, old, action = x[c, i], estimates[c, i, first:stop], actions[first:stop, i, place]
            if len(unit):
                scale = unit[i]
                for w in range(stop - first):
                    u = min(np.float64(action[w]) * scale[w], limit)
                    new[w] = held[w] * max(u, -limit) + old[w]
            else:
                for w in range(stop - first):
                    new[w] = held[w] * np.float64(action[w]) + old[w]


@_part
def _project(x: Any, owners: Any, low: Any, high: Any, at: int, width: int) -> None:
    """Π(x): the real strategies in the box."""
    for c in range(len(low)):
        own, lowest, highest = x[c, owners[c]], low[c, at : at + width], high[c, at : at + width]
        for w in range(width):
            own[w] = min(max(own[w], lowest[w]), highest[w])


@_part
def _affine_gradients(gradients: Any, x: Any, owners: Any, transposed: Any, offset: Any, at: int, width: int) -> None:
    """Block i is Σ_j A_ij x^i_j + b_i."""
    n = len(gradients)
    for k in range(n):
        total, constant = gradients[k], offset[k, at : at + width]
        for c in range(n):
            entry, estimate = transposed[c, k, at : at + width], x[c, owners[k]]
            if c == 0:
                for w in range(width):
                    total[w] = entry[w] * estimate[w]
            else:
                for w in range(width):
                    total[w] += entry[w] * estimate[w]
        for w in range(width):
            total[w] += constant[w]


@_part
def _energy_gradients(gradients: Any, x: Any, coupling: Any, slope: Any, intercept: Any, at: int, width: int) -> None:
    """c Σ_j x^i_j + (2 a_i + c) x^i_i + (d − 2 a_i b_i)."""
    players, price = len(gradients), coupling[0, at : at + width]
    for i in range(players):
        total, own = gradients[i], x[i, i]
        factor, constant = slope[i, at : at + width], intercept[i, at : at + width]
        for c in range(players):
            estimate = x[c, i]
            if c == 0:
                for w in range(width):
                    total[w] = estimate[w]
            else:
                for w in range(width):
                    total[w] += estimate[w]
        for w in range(width):
            total[w] = total[w] * price[w] + factor[w] * own[w] + constant[w]


@_part
def _distances(distances: Any, x: Any, equilibrium: Any, norm: Any, total: Any, at: int, first: int, stop: int) -> None:
    """d^i = ‖x^i − x*‖/‖x*‖."""
    n, players = x.shape[:2]
    width, scale = stop - first, norm[0, at : at + stop - first]
    for i in range(players):
        for c in range(n):
            estimate, goal = x[c, i], equilibrium[c, at : at + width]
            for w in range(width):
                error = estimate[w] - goal[w]
                total[w] = error * error if c == 0 else total[w] + error * error
        for w in range(width):
            total[w] = np.sqrt(total[w]) / scale[w]
        for w in range(width):
            distances[first + w, i] = total[w]


@_part
def _keep(target: Any, rows: Any, largest: float, first: int, stop: int) -> bool:
    """Copy rows of a tile to where it belongs; whether every entry is a number within ±largest."""
    inside = True
    for k in range(len(rows)):
        row, kept = rows[k], target[k, first:stop]
        for w in range(stop - first):
            kept[w] = row[w]
            inside &= abs(row[w]) <= largest
    return inside


@_part
def _weigh(weight: Any, live: Any, weights: Any, modes: Any, after: Any, first: int) -> None:
    """a_ij of the active graph, and 1 or 0 for links that are up or down."""
    slots, players, graphs = weights.shape
    for w in range(weight.shape[2] if graphs == 1 else len(after)):  # of a fixed graph for every tile
        mode = 0 if graphs == 1 else modes[after[w], first + w if modes.shape[1] > 1 else 0]
        for d in range(slots):
            for i in range(players):
                weight[d, i, w] = weights[d, i, mode]
                live[d, i, w] = weight[d, i, w] > 0


@_part
def _show_rows(shown: Any, row: int, values: Any, width: int) -> None:
    """Values in several rows, from ``row`` on."""
    for k in range(len(values)):
        entry, value = shown[row + k], values[k]
        for w in range(width):
            entry[w] = value[w]


@_part
def _show_clock(shown: Any, row: int, clock: Any, ages: Any, after: Any, first: int) -> None:
    """Clock, then the age of the graph, from ``row`` on."""
    for w in range(len(after)):
        for k in range(4):
            shown[row + k, w] = clock[k, after[w]]
        shown[row + 4, w] = ages[after[w], first + w if ages.shape[1] > 1 else 0]


@_part
def _show_gradient(shown: Any, i: int, gradients: Any, own: Any, mask: Any, width: int) -> None:
    """Player i's own gradient, padded with 0."""
    for place in range(len(own)):
        entry, gradient, factor = shown[place], gradients[own[place, i]], mask[place, i]
        for w in range(width):
            entry[w] = gradient[w] * factor


@_part
def _show_relative(shown: Any, row: int, i: int, x: Any, senders: Any, order: Any, live: Any, width: int) -> None:
    """x^j − x^i of player i's neighbour in each slot, 0 where the link is down; from ``row`` on."""
    n = len(x)
    for d in range(len(senders)):
        alive = live[d, i]
        for place in range(n):
            c = order[i, place]
            entry, theirs, mine = shown[row + d * n + place], x[c, senders[d, i]], x[c, i]
            for w in range(width):
                entry[w] = (theirs[w] - mine[w]) * alive[w]


@_part
def _show_in_units(shown: Any, differences: Any, sigma: Any, per_sigma: Any, smallest: float) -> None:
    """Differences over σ_i, the largest size of any; σ_i and 1/σ_i are written too."""
    width = len(sigma)
    for w in range(width):
        sigma[w] = smallest
    for k in range(len(differences)):
        difference = differences[k]
        for w in range(width):
            sigma[w] = max(sigma[w], abs(difference[w]))
    for w in range(width):
        per_sigma[w] = 1 / sigma[w]
    for k in range(len(differences)):
        difference, entry = differences[k], shown[k]
        for w in range(width):
            entry[w] = difference[w] * per_sigma[w]


@kept_on_disk
def step(  # noqa: C901, PLR0912 - one pass over the memory
    # State; actions, and σ_i as their unit, (N, B), or (0, 0) under ``physical``; graph and its age by instant.
    estimates: Any, instants: Any, actions: Any, sigma: Any, modes: Any, ages: Any,
    # Results.
    next_estimates: Any, next_instants: Any, gradients: Any, distances: Any, next_sigma: Any, observations: Any,
    has_constants: bool,
    # Game: A transposed, or without entries for an energy game, whose c and 2a + c follow; offset, box, x*, ‖x*‖.
    transposed: Any, coupling: Any, slope: Any, offset: Any, low: Any, high: Any, equilibrium: Any, norm: Any,
    tile: int,
    # World: Θ and the clock as observed, by instant; a_ij and neighbour by slot; owners of components.
    theta: Any, clock: Any, weights: Any, senders: Any, owners: Any,
    # Layout: components in each player's order, rows of own gradients and their mask, units of actions; the range.
    order: Any, own: Any, mask: Any, limit: float, action_scale: float, smallest: float, largest: float,
) -> bool:  # fmt: skip
    """Everything that a step does to B environments; ``False`` if an environment left the range.

    The entry log10 σ_i of an observation is left out; player one-hots are, if ``has_constants`` says that they stand.
    """
    n, players, batch = estimates.shape
    slots, m, size, is_local = len(senders), len(own), observations.shape[2], len(sigma) > 0
    games_differ, is_fixed = norm.shape[1] > tile, weights.shape[2] == 1
    x, gradient = np.empty((n, players, tile)), np.empty((n, tile))
    held, unit = np.empty((len(theta), tile)), np.empty((len(sigma), tile))
    weight, live = np.empty((slots, players, tile)), np.empty((slots, players, tile))
    shown, differences = np.empty((size, tile), np.float32), np.empty((m + slots * n, tile))
    line = np.empty(tile)
    of_weights = m + slots * n + (0 if is_local else n)
    of_clock = of_weights + slots + is_local
    of_player = of_clock + 5
    written = of_player if has_constants else size
    inside = True
    for first in range(0, batch, tile):
        stop = min(first + tile, batch)
        width = stop - first
        at, after = first if games_differ else 0, next_instants[first:stop]
        _tick(after, held, instants[first:stop], theta)
        for i in range(len(sigma)):
            for w in range(width):
                unit[i, w] = action_scale * sigma[i, first + w]
        _move(x, estimates, actions, held, unit, order, limit, first, stop)
        _project(x, owners, low, high, at, width)
        if transposed.size:
            _affine_gradients(gradient, x, owners, transposed, offset, at, width)
        else:
            _energy_gradients(gradient, x, coupling, slope, offset, at, width)
        _distances(distances, x, equilibrium, norm, line, at, first, stop)
        inside &= _keep(gradients, gradient, largest, first, stop)
        for c in range(n):
            inside &= _keep(next_estimates[c], x[c], largest, first, stop)

        if first == 0 or not is_fixed:
            _weigh(weight, live, weights, modes, after, first)
        for i in range(players):
            if is_local:
                _show_gradient(differences, i, gradient, own, mask, width)
                _show_relative(differences, m, i, x, senders, order, live, width)
                _show_in_units(shown, differences, next_sigma[i, first:stop], line, smallest)
            else:
                _show_gradient(shown, i, gradient, own, mask, width)
                _show_rows(shown, m, x[:, i], width)
                _show_relative(shown, m + n, i, x, senders, order, live, width)
            _show_rows(shown, of_weights, weight[:, i], width)
            if i < len(theta):  # one clock for all, or one for each
                _show_clock(shown, of_clock, clock[:, i], ages, after, first)
            for j in range(players):
                shown[of_player + j, :width] = i == j
            for w in range(width):
                row = observations[first + w, i]
                for k in range(written):
                    row[k] = shown[k, w]
    return inside
