"""Sources: which neighbours have fresher copies of a component, as own links and memory alone show."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, fold, ordered_sum

_MOVED = 1e-5
"""Relative change of a float32 message above which it has moved, and is not only rounded otherwise."""


class Contacts(NamedTuple):
    """What R players remember of their contacts."""

    live: FloatArray  # whether links were live in the step before, shape (R, D)
    heard: FloatArray  # whether they ever were, shape (R, D)
    moved: FloatArray  # own moves since the last contact, shape (R, D, n)
    seen: FloatArray  # relative estimates at its end, infinite before the first, shape (R, D, n)
    before: FloatArray  # the own move that led there, shape (R, D, n)
    source: FloatArray  # whether the neighbour is a source, a player with a fresher copy, shape (R, D, n)
    votes: FloatArray  # for the neighbour less those against it, shape (R, D, n)
    news: FloatArray  # whether there is news of a component, shape (R, n)


def initial_contacts(layout: ObservationLayout, rows: int) -> Contacts:
    """Return the contacts of R players at the start of an episode."""
    links, slots = np.zeros((rows, layout.slots)), np.zeros((rows, layout.slots, layout.dimension))
    none = np.zeros((rows, layout.dimension))
    return Contacts(links, links, slots, slots + np.inf, slots, slots, slots, none)


def find_sources(
    observation: Observation,
    was: Contacts,
    has_begun: BoolArray,
    drift: FloatArray,
    leaders: BoolArray,
    noise: FloatArray | float = 0.0,
) -> tuple[BoolArray, Contacts]:
    """Find the neighbours that have fresher copies of each component.

    A *contact* is a time in which a link is live without a break. At its start, of the two copies of a component the
    one that moved since the last contact is the fresher one; if both have moved, the votes of earlier contacts decide,
    and with equal votes the longer move (docs/mathematics.md). In the first contact a player that has no news of c
    takes the neighbour's copy. During a contact, the neighbour becomes a source when its copy moves by more than noise
    while no source is live, unless it repeats the own moves of the step before. As soon as the player has met the owner
    of a component, the owner is its only source.

    On a fixed graph whose links may add constants to messages, the sources are the neighbours nearer to the owner.

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
    floor = np.abs(relative) + i_moved
    floor += np.abs(seen)
    floor *= _MOVED

    # During a contact.
    source = (was.source > 0) & live
    wakes = (j_moved > floor + noise) & ~_any_slot(source)
    wakes &= np.abs(theirs - (was.before + was.moved)) > floor + noise  # else the neighbour copies the own moves
    wakes &= (links & linked)[:, :, None]

    # At the start of a contact, of few links in most steps.
    votes, starts = was.votes.copy(), np.nonzero(links & ~linked)
    if starts[0].size:
        rows, first = starts[0], ~met[starts]
        i_has, j_has = i_moved[starts] > floor[starts], j_moved[starts] > floor[starts]
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
        before=np.where(live & ~rests, drift[:, None], was.before),
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
