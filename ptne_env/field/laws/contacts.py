"""Contacts: the neighbours that have fresher copies of a component, as far as own links and memory show them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, fold, row_maxima

_MOVED = 1e-5
"""Relative change of a float32 message above which it has moved, and is not only rounded otherwise."""


_DIFFERENT = 1e-3
"""Copies at rest that differ by more than this share of the largest own estimate are different."""


def contact_parts(layout: ObservationLayout) -> dict[str, tuple[int, ...]]:
    """Shapes of the parts of the memory that :func:`contacts` changes; at the start ``seen`` is infinite, others 0."""
    n, slots = layout.dimension, layout.slots
    return {
        "moved": (slots, n),  # own moves since the last contact
        "seen": (slots, n),  # relative estimates at its end, infinite before the first
        "source": (slots, n),
        "votes": (slots, n),
        "news": (n,),  # of which components
    }


def noise_level(observation: Observation, memory: Mapping[str, FloatArray], owned: BoolArray) -> FloatArray:
    """σ_i, the smallest change of messages from step to step about components that their sender does not own.

    The first one is that of the first step, in which these estimates rest; a player without links then takes messages
    for perfect. Of several neighbours, the one with the smallest change counts.

    Args:
        observation: of R players, with own estimates.
        memory: σ_i as ``noise``, shape (R, 1), and of the step before: whether links were ``live``, shape (R, D), and
            the ``messages``, shape (R, D, n); the number of ``steps``, shape (R, 1).
        owned: whether j or i owns c, shape (R, D, n).

    Returns:
        σ_i in natural units, shape (R, 1).
    """
    lasts = (observation.weights > 0) & (memory["live"] > 0)
    messages = observation.own_estimate[:, None] + observation.relative_estimates
    messages -= memory["messages"]
    change = row_maxima(np.where(owned, 0.0, np.abs(messages, out=messages)))
    least = np.where(lasts, change, np.inf).min(axis=1, keepdims=True)
    first = np.where(np.isfinite(least), least, 0.0)
    return np.where(memory["steps"] <= 1, first, np.minimum(memory["noise"], least))


def contacts(
    observation: Observation,
    memory: Mapping[str, FloatArray],
    drift: FloatArray,
    leaders: BoolArray,
    noise: FloatArray | float = 0.0,
) -> tuple[BoolArray, dict[str, FloatArray]]:
    """The neighbours that have fresher copies of each component.

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
        memory: the parts of :func:`contact_parts`, and before this step: whether links were ``live`` in the step
            before and were ever ``heard``, shape (R, D), and the number of ``steps``, shape (R, 1).
        drift: the last moves of the estimates of others, 0 for own components, shape (R, n).
        leaders: whether j owns c, shape (R, D, n).
        noise: the largest change of messages that may be noise, in natural units, shape (R, 1, 1).

    Returns:
        The sources, shape (R, D, n), and the changed parts of the memory.
    """
    links, linked = observation.weights > 0, memory["live"] > 0
    live, heard = links[:, :, None], memory["heard"][:, :, None] > 0
    relative = observation.relative_estimates * observation.unit[:, :, None]
    mine, met = memory["moved"] + drift[:, None], np.isfinite(memory["seen"])
    seen = np.where(met, memory["seen"], relative)
    theirs = relative + mine
    theirs -= seen
    i_moved, j_moved = np.abs(mine), np.abs(np.where(met, theirs, 0.0))
    distance, distance_before = np.abs(relative), np.abs(seen)
    floor = distance + i_moved
    floor += distance_before
    floor *= _MOVED

    # During a contact.
    source = (memory["source"] > 0) & live
    wakes = (distance > distance_before) | ~_any_slot(source)
    wakes &= np.abs(drift)[:, None] <= floor
    wakes &= j_moved > floor + noise
    wakes &= (links & linked)[:, :, None]

    # At the start of a contact, of few links in most steps.
    votes, starts = memory["votes"], np.nonzero(links & ~linked)
    if starts[0].size:
        rows, first = starts[0], ~met[starts]
        i_has, j_has = i_moved[starts] > floor[starts], j_moved[starts] > floor[starts]
        votes = votes.copy()
        votes[starts] += np.where(first, 0, j_has.astype(np.int64) - i_has)
        judgement = votes[starts]
        both = np.where(judgement == 0, j_moved[starts] > i_moved[starts], judgement > 0)
        is_newcomer = (memory["steps"] > 0) & (memory["news"] == 0)
        wakes[starts] = np.where(first, is_newcomer[rows], np.where(i_has & j_has, both, j_has & ~i_has))

    source = np.where(_any_slot(wakes), wakes, source)
    owners = leaders & (live | heard)
    source = np.where(_any_slot(owners), owners & live, source)
    return source, {
        "moved": np.where(live, 0.0, mine),
        "seen": np.where(live, relative, memory["seen"]),
        "source": source.astype(np.float64),
        "votes": votes,
        "news": np.maximum(memory["news"], _any_slot(source)[:, 0]),
    }


def contradictions(
    observation: Observation, memory: Mapping[str, FloatArray], drift: FloatArray, sources: BoolArray, own: BoolArray
) -> FloatArray:
    """Steps for which a neighbour has contradicted the own copy and its sources, while all of them rested, (R, D, n).

    Where every player copies, copies at rest are equal. They differ where a player and its source follow each other,
    as with a neighbour that averages, and both have never heard the owner. A neighbour contradicts only as long as it
    is right about the own strategy: so a liar does not.

    Args:
        observation: of R players.
        memory: these steps as ``contradicted``, shape (R, D, n); of the step before whether links were ``live``, shape
            (R, D), and the ``messages``, shape (R, D, n).
        drift: the last moves of the estimates of others, 0 for own components, shape (R, n).
        sources: the live sources, shape (R, D, n).
        own: own components, shape (R, n).
    """
    lasts = (observation.weights > 0) & (memory["live"] > 0)
    messages = observation.own_estimate[:, None] + observation.relative_estimates
    scale = np.abs(observation.own_estimate).max(axis=1)[:, None, None]
    rests = np.abs(messages - memory["messages"]) <= _MOVED * scale
    is_other = np.abs(observation.relative_estimates) > _DIFFERENT * scale
    rests &= (np.abs(drift)[:, None] <= _MOVED * scale) & ~own[:, None]
    knows = ~(is_other & own[:, None]).any(axis=2)
    agrees = ~_any_slot(sources & (is_other | ~rests))
    contradicts = rests & is_other & agrees & (lasts & knows)[:, :, None] & ~sources
    return np.where(contradicts, memory["contradicted"] + 1, 0.0)


def _any_slot(array: BoolArray) -> BoolArray:
    """Whether any neighbour slot is True, (R, D, n) to (R, 1, n)."""
    return fold(np.logical_or, array, axis=1)[:, None]
