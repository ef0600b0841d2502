"""The compiled step: transition, own gradients, distances and observations in one pass over memory; needs numba.

:mod:`ptne_env.world.fused` calls it. The equations are those of ``dynamics``, ``games``, ``distances`` and ``encoder``, with
the same operations in the same order, so that all numbers are the same bit for bit.

Environments are last. The pass works on a tile of them at a time, whose numbers stay in the first cache. The table of
games has one column per environment, or one tile of columns where all environments play one game.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

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


@intrinsic  # type: ignore[untyped-decorator]  # numba ships no types
def _transpose_block(context: Any, target: Any, target_row: Any, source: Any, source_row: Any) -> Any:  # noqa: ARG001
    """Four rows of four float32 as columns, in registers: addresses, and the bytes from row to row.

    A loop over entries would load and store them one by one.
    """
    number, row = ir.IntType(32), ir.VectorType(ir.FloatType(), 4)

    def generate(_: Any, builder: Any, __: Any, arguments: Any) -> Any:
        target, target_row, source, source_row = arguments

        def place(start: Any, stride: Any, k: int) -> Any:
            address = builder.add(start, builder.mul(stride, ir.Constant(start.type, k)))
            return builder.inttoptr(address, row.as_pointer())

        def chosen(first: Any, second: Any, entries: list[int]) -> Any:
            return builder.shuffle_vector(first, second, ir.Constant(ir.VectorType(number, 4), entries))

        a, b, c, d = (builder.load(place(source, source_row, k), align=4) for k in range(4))
        low, high = [0, 4, 1, 5], [2, 6, 3, 7]
        ac, bd = (chosen(a, c, low), chosen(a, c, high)), (chosen(b, d, low), chosen(b, d, high))
        for k in range(4):
            column = chosen(ac[k // 2], bd[k // 2], (low, high)[k % 2])
            builder.store(column, place(target, target_row, k), align=4)

    return types.void(*[types.intp] * 4), generate


@_part
def _transpose(target: Any, source: Any) -> None:
    """Rows of float32 as columns."""
    rows, columns = source.shape
    if min(rows, columns) < 4:
        for row in range(rows):
            for column in range(columns):
                target[column, row] = source[row, column]
        return
    to, into = target.ctypes.data, target.strides[0]
    start, along = source.ctypes.data, source.strides[0]
    for each in range(0, rows, 4):
        row = min(each, rows - 4)  # the last block overlaps the block before it
        for other in range(0, columns, 4):
            column = min(other, columns - 4)
            _transpose_block(to + column * into + 4 * row, into, start + row * along + 4 * column, along)


@kept_on_disk
def is_inside(actions: Any, bound: float) -> bool:
    """Whether all actions (B, N, action size) are finite and within ±bound."""
    flat, inside = actions.reshape(-1), True
    for k in range(flat.size):
        inside &= abs(flat[k]) <= bound
    return inside


@kept_on_disk
def show_entry(observations: Any, place: int, values: Any) -> None:
    """Values (N, B) as one entry of observations (B, N, size)."""
    for i in range(len(values)):
        for b in range(len(observations)):
            observations[b, i, place] = values[i, b]


@_part
def _tick(after: Any, is_last: Any, held: Any, now: Any, theta: Any) -> None:
    """The next instants, whether they are the last, and the Θ of this one by each clock."""
    for w in range(len(now)):
        after[w] = min(now[w] + 1, theta.shape[1] - 1)
        is_last[w] = after[w] == theta.shape[1] - 1
        for i in range(len(theta)):
            held[i, w] = theta[i, now[w]]


@_part
def _scale(unit: Any, sigma: Any, action_scale: float, first: int, width: int) -> None:
    """An action of 1, in units of each player."""
    for i in range(len(sigma)):
        for w in range(width):
            unit[i, w] = action_scale * sigma[i, first + w]


@_part
def _move(
    x: Any, estimates: Any, played: Any, theta: Any, unit: Any, order: Any, limit: float, first: int, width: int
) -> None:
    """x^i + Θ u^i, where u^i is the action, or under ``local`` the action in units of σ_i within the limit."""
    n, players = x.shape[:2]
    for i in range(players):
        held = theta[min(i, len(theta) - 1)]
        for place in range(n):
            c = order[place, i]
            new, old, action = x[c, i], estimates[c, i, first : first + width], played[i * n + place]
            if len(unit):
                scale = unit[i]
                for w in range(width):
                    u = min(np.float64(action[w]) * scale[w], limit)
                    new[w] = held[w] * max(u, -limit) + old[w]
            else:
                for w in range(width):
                    new[w] = held[w] * np.float64(action[w]) + old[w]


@_part
def _project(x: Any, owners: Any, low: Any, high: Any, boxes: int, at: int, width: int) -> None:
    """Π(x): the real strategies in the box."""
    for c in range(boxes):
        own, lowest, highest = x[c, owners[c]], low[c, at : at + width], high[c, at : at + width]
        for w in range(width):
            own[w] = min(max(own[w], lowest[w]), highest[w])


@_part
def _affine_gradients(gradients: Any, x: Any, owners: Any, game: Any, at: int, width: int) -> None:
    """Block i is Σ_j A_ij x^i_j + b_i."""
    n = len(gradients)
    for k in range(n):
        total, constant = gradients[k], game[n * n + k, at : at + width]
        for c in range(n):
            entry, estimate = game[c * n + k, at : at + width], x[c, owners[k]]
            if c == 0:
                for w in range(width):
                    total[w] = entry[w] * estimate[w]
            else:
                for w in range(width):
                    total[w] += entry[w] * estimate[w]
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
    width, scale = stop - first, norm[at : at + stop - first]
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
def _show_own(shown: Any, row: int, i: int, values: Any, width: int) -> None:
    """Player i's part of values (rows, N, environments), from ``row`` on."""
    for k in range(len(values)):
        entry, value = shown[row + k], values[k, i]  # whose layout numba knows, which of values[:, i] it would not
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
def _show_player(shown: Any, row: int, i: int, players: int, width: int) -> None:
    """The one-hot of player i, where zeros or that of the player before stood; from ``row`` on."""
    before, own = shown[row + (i or players) - 1], shown[row + i]
    for w in range(width):
        before[w] = 0
    for w in range(width):
        own[w] = 1


@_part
def _show_gradient(shown: Any, i: int, gradients: Any, own: Any, mask: Any, width: int) -> None:
    """Player i's own gradient, padded with 0."""
    for place in range(len(own)):
        entry, gradient, factor = shown[place], gradients[own[place, i]], mask[place, i]
        for w in range(width):
            entry[w] = gradient[w] * factor


@_part
def _show_relative(
    shown: Any, row: int, i: int, x: Any, senders: Any, order: Any, live: Any, is_fixed: bool, width: int
) -> None:
    """x^j − x^i of player i's neighbour in each slot, 0 where the link is down; from ``row`` on."""
    n = len(x)
    for d in range(len(senders)):
        alive = live[d, i]
        for place in range(n):
            c = order[place, i]
            entry, theirs, mine = shown[row + d * n + place], x[c, senders[d, i]], x[c, i]
            if is_fixed:
                for w in range(width):
                    entry[w] = theirs[w] - mine[w]
            else:
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
def step(
    # Actions; where observations go.
    actions: Any, bound: float, observations: Any, has_constants: bool,
    # State; σ_i, the unit of actions, is (N, B), or (0, 0) under ``physical``.
    instants: Any, estimates: Any, sigma: Any,
    # Results.
    next_instants: Any, next_estimates: Any, next_sigma: Any, gradients: Any, distances: Any, is_last: Any,
    # Graph and its age by instant.
    modes: Any, ages: Any,
    # Games, row by row: x*, ‖x*‖, the box in 2 n rows or none, and A transposed and b, or c, 2a + c and d − 2ab.
    game: Any, boxes: int, is_affine: bool, tile: int,
    # World: Θ and the clock as observed, by instant; a_ij by slot; owners of components. For each player: neighbour by
    # slot, own gradients, 1 or 0 for places that are own or padded, and components in the player's order.
    theta: Any, clock: Any, weights: Any, owners: Any, places: Any,
    # Units of actions; the range.
    limit: float, action_scale: float, smallest: float, largest: float,
) -> bool:  # fmt: skip
    """Everything that a step does to B environments; ``False`` if an environment left the range.

    Actions that are not within ±bound are refused with ``False`` before anything is written.
    The entry log10 σ_i of an observation is left out; player one-hots are, if ``has_constants`` says that they stand.
    """
    if bound < np.inf and not is_inside(actions, bound):
        return False
    n, players, batch = estimates.shape
    slots, size, is_local = len(weights), observations.shape[2], len(sigma) > 0
    m = (len(places) - slots - n) // 2
    senders, own, mask, order = places[:slots], places[slots : slots + m], places[-n - m : -n], places[-n:]
    formula = game[n + 1 + 2 * boxes :]
    games_differ, is_fixed = game.shape[1] > tile, weights.shape[2] == 1
    x, links = np.empty((n, players, tile)), np.empty((2 * slots, players, tile))
    weight, live = links[:slots], links[slots:]
    rows = np.empty((n + len(theta) + len(sigma) + 1 + m + slots * n, tile))  # allocated at once, and parted
    gradient, held, rows = rows[:n], rows[n : n + len(theta)], rows[n + len(theta) :]
    unit, line, differences = rows[: len(sigma)], rows[len(sigma)], rows[len(sigma) + 1 :]
    played, shown = np.empty((players * n, tile), np.float32), np.zeros((size, tile), np.float32)
    of_weights = m + slots * n + (0 if is_local else n)
    of_clock = of_weights + slots + is_local
    of_player = of_clock + 5
    written = of_player if has_constants else size
    inside = True
    for first in range(0, batch, tile):
        stop = min(first + tile, batch)
        width = stop - first
        at, after = first if games_differ else 0, next_instants[first:stop]
        _tick(after, is_last[first:stop], held, instants[first:stop], theta)
        _transpose(played[:, :width], actions[first:stop].reshape(width, -1))
        _scale(unit, sigma, action_scale, first, width)
        _move(x, estimates, played, held, unit, order, limit, first, width)
        _project(x, owners, game[n + 1 : n + 1 + boxes], game[n + 1 + boxes :], boxes, at, width)
        if is_affine:
            _affine_gradients(gradient, x, owners, formula, at, width)
        else:
            _energy_gradients(gradient, x, formula, at, width)
        _distances(distances, x, game[:n], game[n], line, at, first, stop)
        inside &= _keep(gradients, gradient, largest, first, stop)
        inside &= _keep(next_estimates.reshape(n * players, -1), x.reshape(n * players, -1), largest, first, stop)

        if first == 0 or not is_fixed:
            _weigh(weight, live, weights, modes, after, first)
        for i in range(players):
            if is_local:
                _show_gradient(differences, i, gradient, own, mask, width)
                _show_relative(differences, m, i, x, senders, order, live, is_fixed, width)
                _show_in_units(shown, differences, next_sigma[i, first:stop], line, smallest)
            else:
                _show_gradient(shown, i, gradient, own, mask, width)
                _show_own(shown, m, i, x, width)
                _show_relative(shown, m + n, i, x, senders, order, live, is_fixed, width)
            _show_own(shown, of_weights, i, weight, width)
            if i < len(theta):  # one clock for all, or one for each
                _show_clock(shown, of_clock, clock[:, i], ages, after, first)
            _show_player(shown, of_player, i, players, width)
            _transpose(observations[first:stop, i, :written], shown[:written, :width])
    return inside
