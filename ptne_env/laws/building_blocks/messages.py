"""What neighbours say: who has the fresher copy of a component, and what a noisy or rounded message means.

Contacts show, from own links and memory alone, which neighbours have fresher copies. Filters measure how much noise the
messages carry and whether they are rounded, and average what lies beneath.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, fold, ordered_sum, row_maxima

_MOVED = 1e-5
"""Relative change of a float32 message above which it has moved, and is not only rounded otherwise."""

RATES = (1 / 4, 1 / 16, 1 / 64, 1 / 256)
"""Smallest weights of the present message in the means, from quick ones to slow ones."""

_DEVIATIONS = 3.0
"""Half-width of the interval around each mean, in standard deviations: means agree where all intervals meet."""

_RECONNECTED = 1 / 6
"""Smallest variance of a mean, in that of a message, when a link comes up again: the sender has moved meanwhile."""

_FALLS, _RISES, _LEAP = 1 / 8, 1 / 32, 4.0
"""Weights of a step in the estimate of noise, which falls sooner than it rises; and the largest multiple of it that a
step counts as. So the moves of the start are no noise for long, and noise may begin late."""

_QUARTILE = 0.184
"""Lower quartile of min(|ξ − ξ'|/√2, |ξ − 2 ξ' + ξ''|/√6) for independent normal ξ, ξ', ξ'', found by sampling."""

_FINE = 2e-6
"""Noise and steps of rounding below this share of the largest own estimate are those of float32."""

_REPEATS = 3e-7
"""A message that moves less than this share of the largest own estimate is the one before, in float32."""

_CALM = 60
"""Steps in which noise does not halve before it counts: messages that converge halve their changes sooner."""

_CALMEST, _TURNS = 120.0, 1 / 3
"""The most such steps; and share of changes that turn back, of which noise has two thirds: without it, moves count."""

_START = 20
"""Steps before messages are taken for rounded."""

_ON_GRID = 1e-2
"""Largest distance of a rounded message from a multiple of the step, in steps."""

_FORGETTING = (3.0, 2.0)
"""p of the weights p/(p + k) of rounded messages in their mean, and of that mean in the mean of means."""

_GOLDEN_RATIO = (5**0.5 - 1) / 2


class NeighbourMessages(NamedTuple):
    """What R players hear in a step, in natural units."""

    live: BoolArray  # live links, shape (R, D)
    was_live: BoolArray  # links that were live in the step before, shape (R, D)
    content: FloatArray  # the neighbours' estimates x^j, shape (R, D, n)
    change: FloatArray  # |change| since the step before; it means something where the link lasted, shape (R, D, n)

    @property
    def lasted(self) -> BoolArray:
        """Links that are live in both steps, shape (R, D)."""
        return self.live & self.was_live


def read_messages(observation: Observation, was_live: FloatArray, before: FloatArray) -> NeighbourMessages:
    """Return the messages of this step, compared with those of the step ``before``, in which links ``was_live``."""
    live = observation.weights > 0
    content = observation.own_estimate[:, None] + observation.relative_estimates
    return NeighbourMessages(live, was_live > 0, content, np.abs(content - before))


class Contacts(NamedTuple):
    """What R players remember of their contacts."""

    live: FloatArray  # whether links were live in the step before, shape (R, D)
    heard: FloatArray  # whether they ever were, shape (R, D)
    moved: FloatArray  # own moves since the last contact, shape (R, D, n)
    seen: FloatArray  # relative estimates at its end, infinite before the first, shape (R, D, n)
    source: FloatArray  # whether the neighbour is a source, a player with a fresher copy, shape (R, D, n)
    votes: FloatArray  # for the neighbour less those against it, shape (R, D, n)
    news: FloatArray  # whether there is news of a component, shape (R, n)


def initial_contacts(layout: ObservationLayout) -> Contacts:
    """Return the contacts of one player at the start of an episode."""
    links, slots = np.zeros((1, layout.slots)), np.zeros((1, layout.slots, layout.dimension))
    return Contacts(links, links, slots, slots + np.inf, slots, slots, np.zeros((1, layout.dimension)))


def noise_level(messages: NeighbourMessages, noise: FloatArray, steps: FloatArray, owned: BoolArray) -> FloatArray:
    """Return σ_i, the smallest change from one step to the next in what senders say about components of others.

    The first one is that of the first step, in which these estimates rest; a player without links then takes messages
    for perfect. Of several neighbours, the one with the smallest change counts. ``noise`` is σ_i so far, and ``owned``
    says whether j or i owns c, shape (R, D, n). σ_i and the number of steps have the shape (R, 1).
    """
    change = row_maxima(np.where(owned, 0.0, messages.change))
    least = np.where(messages.lasted, change, np.inf).min(axis=1, keepdims=True)
    first = np.where(np.isfinite(least), least, 0.0)
    return np.where(steps <= 1, first, np.minimum(noise, least))


def find_sources(
    observation: Observation,
    was: Contacts,
    has_begun: BoolArray,
    drift: FloatArray,
    leaders: BoolArray,
    noise: FloatArray | float = 0.0,
) -> tuple[BoolArray, Contacts]:
    """Find the neighbours that have fresher copies of each component.

    A *contact* is a time in which a link is live without a break. At its start, player i compares how far its own copy
    of component c and the neighbour's copy have moved since the last contact, at the end of which they knew each other.
    If only one copy has moved, it is the fresher copy, and the neighbour gets a vote for it or against it. If both have
    moved, the votes decide; with equal votes, the copy that has moved further is the fresher copy. In the first contact
    the player takes the neighbour's copy if it has no news of c. During a contact, the neighbour becomes the source
    when its copy moves by more than noise while the own copy rests, unless there is a live source and the neighbour's
    copy moves towards the own copy. An owner is the only source as soon as the player has met it.

    On a fixed graph with perfect messages the sources are the neighbours that are nearer to the owner.

    Args:
        observation: of R players.
        was: the contacts so far.
        has_begun: whether a step has been done, shape (R, 1).
        drift: the last moves of the estimates of others, 0 for own components, shape (R, n).
        leaders: whether j owns c, shape (R, D, n).
        noise: the largest change of messages that may be noise, in natural units, shape (R, 1, 1).

    Returns:
        The sources, shape (R, D, n), and the contacts for the next step.
    """
    links, linked = observation.weights > 0, was.live > 0
    live, heard = links[:, :, None], was.heard[:, :, None] > 0
    relative = observation.relative_estimates * observation.unit[:, :, None]
    mine, met = was.moved + drift[:, None], np.isfinite(was.seen)
    seen = np.where(met, was.seen, relative)
    theirs = relative + mine
    theirs -= seen
    i_moved, j_moved = np.abs(mine), np.abs(np.where(met, theirs, 0.0))
    distance, distance_before = np.abs(relative), np.abs(seen)
    floor = distance + i_moved
    floor += distance_before
    floor *= _MOVED

    # During a contact.
    source = (was.source > 0) & live
    wakes = (distance > distance_before) | ~_any_slot(source)
    wakes &= np.abs(drift)[:, None] <= floor
    wakes &= j_moved > floor + noise
    wakes &= (links & linked)[:, :, None]

    # At the start of a contact, of few links in most steps.
    votes, starts = was.votes, np.nonzero(links & ~linked)
    if starts[0].size:
        rows, first = starts[0], ~met[starts]
        i_has, j_has = i_moved[starts] > floor[starts], j_moved[starts] > floor[starts]
        votes = votes.copy()
        votes[starts] += np.where(first, 0, j_has.astype(np.int64) - i_has)
        judgement = votes[starts]
        both = np.where(judgement == 0, j_moved[starts] > i_moved[starts], judgement > 0)
        is_newcomer = has_begun & (was.news == 0)
        wakes[starts] = np.where(first, is_newcomer[rows], np.where(i_has & j_has, both, j_has & ~i_has))

    source = np.where(_any_slot(wakes), wakes, source)
    # While the own copy rests, changes of the neighbour's add up from where it was.
    rests = links & linked
    rests = rests[:, :, None] & ~source & (i_moved <= floor)
    owners = leaders & (live | heard)
    source = np.where(_any_slot(owners), owners & live, source)
    return source, Contacts(
        live=links.astype(np.float64),
        heard=np.maximum(was.heard, links),
        moved=np.where(live & ~rests, 0.0, mine),
        seen=np.where(live, np.where(rests, seen, relative), was.seen),
        source=source.astype(np.float64),
        votes=votes,
        news=np.maximum(was.news, _any_slot(source)[:, 0]),
    )


def mean_difference(observation: Observation, sources: BoolArray) -> FloatArray:
    """Return the mean of x^j_c − x^i_c over the live sources j of component c, 0 without one, shape (R, n)."""
    live = sources & (observation.weights > 0)[:, :, None]
    count: IntArray = fold(np.add, live.astype(np.int32), axis=1).astype(np.int64)
    return ordered_sum(np.where(live, observation.relative_estimates, 0.0), axis=1) / np.maximum(count, 1)


def _any_slot(array: BoolArray) -> BoolArray:
    """Return whether any neighbour slot is True, (R, D, n) to (R, 1, n)."""
    return fold(np.logical_or, array, axis=1)[:, None]


class Filters(NamedTuple):
    """What R players remember of their neighbours' messages."""

    age: FloatArray  # steps for which links have been live without a break, shape (R, D)
    last: FloatArray  # messages of the last step, shape (R, D, n)
    before: FloatArray  # those of the step before it, shape (R, D, n)
    noise: FloatArray  # standard deviation of the noise of messages, shape (R, 1)
    level: FloatArray  # the largest noise since it last halved, shape (R, 1)
    calm: FloatArray  # steps since noise last halved, shape (R, 1)
    width: FloatArray  # the smallest change of a message: the step of rounding, if they are rounded, shape (R, 1)
    dithered: FloatArray  # steps for which messages have been rounded, shape (R, 1)
    means: FloatArray  # per rate, shape (R, L, D, n)
    variances: FloatArray  # of the means, in that of a message, shape (R, L, D, n)


class Damage(NamedTuple):
    """What R players know of the damage of messages, shapes (R, 1)."""

    noise: FloatArray  # standard deviation, 0 where messages are exact
    step: FloatArray  # of rounding, 0 where messages are not rounded, or noise hides it

    @property
    def deviation(self) -> FloatArray:
        """Standard deviation of a message, 0 where messages are exact."""
        return np.maximum(self.noise, self.step / np.sqrt(12))


def initial_filters(layout: ObservationLayout) -> Filters:
    """Return the filters of one player at the start of an episode."""
    slots, none = np.zeros((1, layout.slots, layout.dimension)), np.zeros((1, 1))
    means = np.zeros((1, len(RATES), layout.slots, layout.dimension))
    return Filters(slots[..., 0], slots, slots, none, none, none, none + np.inf, none, means, means + 1e6)


def measure_damage(
    messages: NeighbourMessages, was: Filters, steps: FloatArray, owners: BoolArray, scale: FloatArray
) -> tuple[Filters, Damage]:
    """Take the messages of this step into the filters, except for their means, and measure the damage of messages.

    Noise is measured by second differences of messages from step to step, which are small where senders move smoothly,
    and by first differences, which are small where senders rest after a jump; of both, and of all components and links,
    the lower quartile counts. In the first step the estimates of others rest, and first differences are noise alone.
    A message that repeats the one before was held on its way, and says nothing. Noise counts once it has not halved for
    60 steps, or from the first step on, until it has vanished.

    Args:
        messages: of this step.
        was: the filters so far.
        steps: number of steps so far, shape (R, 1).
        owners: whether the sender owns the component, (R, D, n).
        scale: the largest own estimate, shape (R, 1).
    """
    live, content = messages.live, messages.content
    age, is_first = np.where(live, was.age + 1, 0.0), steps == 1
    first, second = np.abs(content - was.last) / np.sqrt(2), np.abs(content - 2 * was.last + was.before) / np.sqrt(6)
    says = live & ((first > _REPEATS * scale[:, :, None]).any(axis=2) | is_first) & (age >= np.where(is_first, 2, 3))
    change = np.where(is_first[:, :, None], first * (_QUARTILE / 0.319), np.minimum(first, second))
    sample, is_known = _lower_quartile(np.where(says[:, :, None] & ~owners, change, np.inf))
    sample = sample / _QUARTILE
    most = np.where(is_first, np.inf, np.maximum(_LEAP * was.noise, _FINE * scale))
    rate = np.where(is_first, 1.0, np.where(sample < was.noise, _FALLS, _RISES))
    noise = np.where(is_known, was.noise + rate * (np.minimum(sample, most) - was.noise), was.noise)

    is_fine = noise <= _FINE * scale
    halves = (noise < was.level / 2) & (was.calm < _CALM) & (steps > 1)
    counts = is_known & (sample <= _LEAP * was.noise)  # noise that is far from what it measures is not known yet
    # Noise turns back and forth, but moves do not, even if they are held for some steps on their way.
    turn = np.where(says[:, :, None], (content - was.last) * (was.last - was.before), 0.0)
    moves = np.abs(turn) > (_REPEATS * scale[:, :, None]) ** 2
    turns = (moves & (turn < 0)).sum(axis=(1, 2)) - _TURNS * moves.sum(axis=(1, 2))
    step = counts * np.sign(turns)[:, None]
    calm = np.where(halves | is_fine, 0.0, np.where(is_first, _CALMEST, np.clip(was.calm + step, 0.0, _CALMEST)))
    level = np.where(halves, noise, np.maximum(was.level, noise))

    moved = messages.lasted[:, :, None] & (messages.change > _FINE * scale[:, :, None])
    width = np.minimum(was.width, np.where(moved, messages.change, np.inf).min(axis=(1, 2))[:, None])
    ticks = content / np.where(np.isfinite(width), width, np.inf)[:, :, None]
    off = row_maxima(np.where(live[:, :, None], np.abs(ticks - np.round(ticks)), 0.0)).max(axis=1, keepdims=True)
    is_rounded = np.isfinite(width) & (width > 100 * _FINE * scale) & (steps >= _START) & (off < _ON_GRID)
    is_rounded &= live.any(axis=1, keepdims=True) & (noise < 3 * width)
    fresh = was._replace(age=age, last=content, before=was.last, noise=noise, level=level, calm=calm, width=width)
    fresh = fresh._replace(dithered=np.where(is_rounded, was.dithered + 1, 0.0))
    audible = np.where((calm >= _CALM) & ~is_rounded, noise, 0.0)
    return fresh, Damage(audible, np.where(is_rounded, width, 0.0))


def filter_messages(
    messages: NeighbourMessages, was: Filters, fresh: Filters, damage: Damage
) -> tuple[Filters, tuple[FloatArray, FloatArray]]:
    """Return the slowest mean of each message that agrees with all quicker ones, and its relative variance.

    Means agree as far as their confidence intervals have a point in common (A. Goldenshluger and A. Nemirovski, "On
    spatially adaptive estimation of nonparametric regression", Mathematical Methods of Statistics 6(2), 1997). Means
    that do not agree begin anew where the slowest that agrees is. The quickest "mean" is the median of three messages,
    and a message counts as at most three deviations away from it: so single outliers move nothing.

    Rounded messages of dithered strategies are averaged twice, so that the weights vanish at both ends: the dither is
    no noise, and its mean over a smooth window is closer to 0.

    ``was`` are the filters before this step, ``fresh`` those of :func:`measure_damage`. Means and variances have the
    shape (R, D, n); variances are those of means in that of a message.
    """
    live, content = messages.live[:, :, None], messages.content
    low, high = np.minimum(content, was.last), np.maximum(content, was.last)
    agreed = np.where((fresh.age >= 3)[:, :, None], np.clip(was.before, low, high), content)
    half = _DEVIATIONS * damage.deviation[:, :, None]
    lower, upper = agreed - half, agreed + half
    content = np.clip(content, lower, upper)
    variance, agrees = np.ones_like(agreed), np.ones_like(agreed, dtype=np.bool_)
    means, variances = was.means.copy(), was.variances.copy()
    renewed = np.where(fresh.age == 1, _RECONNECTED, 0.0)[:, :, None]
    for level, least in enumerate(RATES):
        mean, spread = was.means[:, level], np.maximum(was.variances[:, level], renewed)
        rate = np.where(live, np.maximum(least, spread / (1 + spread)), 0.0)
        mean, spread = mean + rate * (content - mean), (1 - rate) ** 2 * spread + rate**2
        wide = half * np.sqrt(spread)
        lower, upper = np.maximum(lower, mean - wide), np.minimum(upper, mean + wide)
        agrees &= lower <= upper
        agreed, variance = np.where(agrees, mean, agreed), np.where(agrees, spread, variance)
        starts = live & ~agrees
        means[:, level], variances[:, level] = np.where(starts, agreed, mean), np.where(starts, variance, spread)

    rounded = (damage.step > 0)[:, :, None]
    if rounded.any():
        k, (p, q) = fresh.dithered[:, :, None] - 1, _FORGETTING
        mean = was.means[:, 0] + np.where(live, p / (p + k), 0.0) * (messages.content - was.means[:, 0])
        smooth = was.means[:, 1] + np.where(live, q / (q + k), 0.0) * (mean - was.means[:, 1])
        means[:, 0], means[:, 1] = np.where(rounded, mean, means[:, 0]), np.where(rounded, smooth, means[:, 1])
        agreed, variance = np.where(rounded, smooth, agreed), np.where(rounded, 1.0, variance)
    return fresh._replace(means=means, variances=variances), (agreed, variance)


def dither(steps: FloatArray) -> FloatArray:
    """Return evenly spread numbers in [−½, ½), (R, 1): the fractional part of steps × golden ratio, minus ½.

    A strategy that moves by ``dither`` × the step of rounding is rounded up in the share of steps by which it lies
    above the multiple below, so the mean of its rounded messages is the strategy.
    """
    return (steps * _GOLDEN_RATIO) % 1.0 - 0.5


def _lower_quartile(array: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the lower quartile of the finite entries of each row, (R, D, n) to (R, 1), and whether there are any."""
    ordered = np.sort(array.reshape(len(array), -1), axis=1)
    number = np.isfinite(ordered).sum(axis=1, keepdims=True)
    quartile = np.take_along_axis(ordered, np.minimum(number // 4, ordered.shape[1] - 1), axis=1)
    return np.where(number > 0, quartile, 0.0), number > 0
