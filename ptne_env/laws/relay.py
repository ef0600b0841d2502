"""The relay: news travel one link a step, and players answer with best responses by a model of their own gradient."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np

from ptne_env.laws.base import Law, per_step
from ptne_env.laws.identification import (
    Model,
    clip_to_reach,
    identify,
    initial_model,
    largest,
    own_curvatures,
    own_entries,
    shorten,
    with_own,
)
from ptne_env.laws.sources import Contacts, find_sources, initial_contacts, mean_difference
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, require_count, require_positive, row_maxima

_SMALLEST = 1e-3
"""The scale of a problem is the largest own estimate, and at least a step of Θ along the own gradient: a start at 0 is
no small problem. But where that is more than this share of what the input limit allows, the share counts."""

_SPREAD = 3.0
"""Standard deviation of the entries of dF before anything is identified, in units of the first gradient per scale."""

_FIRST = 1 / (3 * _SPREAD)
"""Longest first own displacement, in units of the scale: the response to three standard deviations of curvature."""

_LEAD = 0.5
"""Most steps beside the delay for which a damped response expects the copies to go on. This number, and 1 + T in the
damping, follow from the eigenvalues of linear games that rotate ten times as fast as they contract, with delays of up
to two steps; with longer delays, random worlds that rotate say the same."""

_WINDOW = 3.0
"""Number of delays over which the directions of responses are averaged: the others answer a move in about two."""

_STEADY, _RATE = 0.6, 0.5
"""Length of the mean direction at which the damping is right: it is 1 where responses creep, and near 0 where they turn
back within a window. Per delay, the logarithm of the share of the damping changes by the rate times what is missing."""

_LEAST = 0.125
"""Smallest share of the damping; smaller ones let responses turn before the mean direction shows it."""

_SHORTEST, _LONGEST = 2.0, 4
"""The shortest delay in steps, that of an answer over one link; and the longest one, in numbers of players: on graphs
that switch, the first news may take much longer than the later ones, and averages over noise lag without limit."""

_SIGNAL = 3.0
"""A difference to the sources above this many σ is no noise."""

_CALMER = 2.0
"""Messages come to rest where σ falls to the last σ over this number, and then they are no noise."""

_LEAST_NEWS, _NEWS, _LOUDEST = 2.0, 6.0, 0.3
"""A copy has news once it moved by more than ``_LOUDEST`` of the scale, but no less than ``_LEAST_NEWS`` times and no
more than ``_NEWS`` times the noise of the second step."""

_OUTLIER, _PACE = 4.0, 1.1
"""A difference to the sources above this many running medians is an outlier, as one of 140 of normal noise is; and the
factor by which the running median rises or falls in a step."""

_NOISY = 1e-3
"""Share of the scale that the change of messages in the second step exceeds where differences may be outliers."""

_HELD, _RESOLVED = 0.1, 1e-6
"""A bound holds a component that moved less than this share of the displacement that was asked for; and the smallest
displacement, in units of the scale, at which that is judged."""


class Noise(NamedTuple):
    """What R players know of the noise of messages."""

    last: FloatArray  # messages of the step before, shape (R, D, n)
    before: FloatArray  # those of the step before that, shape (R, D, n)
    age: FloatArray  # steps for which links have been live without a break, shape (R, D)
    total: FloatArray  # of the changes of messages in this window, shape (R, 1)
    number: FloatArray  # of these changes, shape (R, 1)
    level: FloatArray  # σ, their mean in the last full window, shape (R, 1)
    second: FloatArray  # the change of messages in the second step, shape (R, 1)
    since: FloatArray  # k, the steps in which messages have not come to rest, shape (R, 1)


class RelayMemory(NamedTuple):
    """What R players remember from step to step."""

    steps: FloatArray  # number of steps so far, shape (R, 1)
    contacts: Contacts  # with the neighbours
    noise: Noise  # of their messages
    model: Model  # of the own gradient
    asked: FloatArray  # the displacement that was asked for, shape (R, n)
    share: FloatArray  # e, of the damping, shape (R, 1)
    direction: FloatArray  # v, the mean direction of the responses, shape (R, m)
    unheard: FloatArray  # F, the steps before there was news of every component, or so far, from 2 to 4 N, shape (R, 1)
    delay: FloatArray  # T, shape (R, 1)
    trail: FloatArray  # q, own moves, of which a delay forgets all but 1/e, shape (R, n)
    behind: FloatArray  # the sum of (x_i − neighbours' copies of it)·q, shape (R, 1)
    passed: FloatArray  # the sum of (the last own move)·q over the same steps and links, shape (R, 1)
    median: FloatArray  # the running median of |differences to the sources|, 0 before the first one, shape (R, n)
    outlier: FloatArray  # the sign of the last difference if it was an outlier, and else 0, shape (R, n)


class Relay(Law):
    """A law that copies estimates hop by hop, and takes best responses by an identified model of the own gradient.

    docs/mathematics.md has the reasons. In every step a player does the following.

    1. *Noise.* A message changes by |y_k − y_{k−1}| or |y_k − 2 y_{k−1} + y_{k−2}|/√3, whichever is smaller, and the
       largest over components and over links that have been live for three steps counts. σ is its mean over the last
       full window of ``patience`` steps, and before the first window ends the change in the second step.
    2. *Sources.* :func:`~ptne_env.laws.sources.find_sources` says which neighbours have fresher copies of a component.
    3. *Copies.* Δx^i_c = w × mean of (x^j_c − x^i_c) over the live sources j of each component c of another player.
       Let k count the steps since σ last halved from window to window, or since a difference to the sources was above
       3 σ. Up to ``patience`` such steps w = 1, and then w = p/(p + k), p being ``forgetting``. Where the change of
       messages in the second step was above 1e-3 of the scale, a mean above four times its running median is an outlier
       and counts as 0, unless the one before was an outlier of the same sign. Where c never had a source in
       max(``patience``, N) steps, as where rounding hides all, all neighbours count as sources. A source that says what
       the player's copy was before its last move copies the player in turn; then Δx^i_c is half of that, and the two
       meet, instead of exchanging their copies for ever.
    4. *Identification.* :func:`~ptne_env.laws.identification.identify` updates the rows G of dF.
    5. *Response.* Δx_i = −D⁻¹ (∂J_i/∂x_i + l Σ_{j≠i} G_ij Δx_j), the best response to the copies. D has the
       eigenvectors of the symmetric part of the own block G_ii, and the eigenvalues d + e (1 + T) max(0, S − d), where
       d is the curvature (|d| plus three standard deviations where it is not certainly positive), and S the largest row
       sum of |G_ij| over all j ≠ i. Where S ≤ d, D is G_ii and l = 1; else l is the least of T + ½ and the eigenvalues
       of D over S. A component at a bound, which did not move when it was asked to, counts as fixed for the other own
       ones. No component of the response is larger than the trust region of the model.
    6. *Delay.* T = F + L − 1, from 2 to 4 N. F counts the steps before there was news of every component. L ≥ 1 is the
       sum over steps and live links of (x_i − x^j_i)·q over that of δ·q, where δ is the last own move and
       q ← (1 − 1/T) q + δ the *trail* of own moves. Steps up to 2 F do not count: neighbours may not yet have heard of
       any own move.
    7. *Damping.* e ← e exp((0.6 − |v|)/(2 T)), within [1/8, 1] and from 1 on, where v ← v + (Δx_i/|Δx_i| − v)/(3 T) is
       the mean direction, in the maximum norm. Steps that the trust region or the input limit shortens do not count:
       they keep one direction whatever the damping.

    In the first m steps, m being the largest n_i, the copies rest, and one own component after the other moves, so that
    the first changes of messages are noise alone, and the own block of dF is known at once.

    Args:
        layout: the layout of the environment, with the interface ``physical``.
        patience: the number of steps of a window, ≥ 1, after which σ counts as noise if it has not halved.
        forgetting: p > 0: larger numbers forget earlier messages faster.

    Raises:
        ValueError: for a patience below 1, a forgetting that is not positive, or another interface.
    """

    needs: ClassVar[tuple[str, ...]] = ("own_estimate",)

    def __init__(self, layout: ObservationLayout, patience: int = 25, forgetting: float = 3.0) -> None:
        super().__init__(layout)
        self.patience = require_count("patience", patience, 1)
        self.forgetting = require_positive("forgetting", forgetting)

    def initial_memory(self, rows: int) -> RelayMemory:
        layout, none, own = self.layout, np.zeros((rows, 1)), np.zeros((rows, self.layout.dimension))
        messages, response = np.zeros((rows, layout.slots, layout.dimension)), np.zeros((rows, max(layout.action_dims)))
        noise = Noise(messages, messages, messages[:, :, 0], none, none, none, none, none)
        contacts, model = initial_contacts(layout, rows), initial_model(layout, rows)
        delay = none + _SHORTEST
        return RelayMemory(
            none, contacts, noise, model, own, none + 1, response, delay, delay, own, none, none, own, own
        )

    def inputs(self, observation: Observation, memory: RelayMemory) -> tuple[FloatArray, RelayMemory]:
        layout, was, player = self.layout, memory, observation.player
        is_own, owners = layout.own_mask[player], layout.neighbour_components[player]
        blocks, estimate = layout.own_components[player], observation.own_estimate
        reach = layout.action_bound * observation.theta
        descent = np.minimum(largest(observation.gradient) * observation.theta, _SMALLEST * reach)
        scale = np.maximum(largest(estimate), descent)

        noise = _measure(observation, was.noise, was.steps, owners | is_own[:, None])
        loudest = np.clip(_LOUDEST * scale, _LEAST_NEWS * noise.second, _NEWS * noise.second)
        drifted = np.where(is_own, 0.0, was.asked)
        sources, contacts = find_sources(observation, was.contacts, was.steps > 0, drifted, owners, loudest[:, :, None])
        is_silent = (contacts.news == 0) & (was.steps >= max(self.patience, layout.num_players))
        live = (observation.weights > 0)[:, :, None]
        sources |= is_silent[:, None] & live
        is_probe = was.steps < blocks.shape[1]
        mean = np.where(is_own | is_probe, 0.0, mean_difference(observation, sources))
        is_noisy = (noise.second > _NOISY * scale) & (was.steps > 2)
        mean, median, outlier = _drop_outliers(mean, was.median, was.outlier, is_noisy)
        noise, weight = self._weigh(noise, mean, was.steps)
        before, smallest = was.model.estimate, np.maximum(_RESOLVED * scale, loudest)
        repeats = live & sources & (np.abs(noise.last - before[:, None]) <= smallest[:, :, None])
        exchanges = repeats.any(axis=1) & (np.abs(estimate - before) > smallest)
        drift = np.where(exchanges, 0.5, 1.0) * weight * mean

        gradient = own_entries(observation.gradient, blocks)
        widest = _SPREAD * largest(gradient) / np.where(scale > 0, scale, 1.0)
        model = identify(was.model, estimate, gradient, widest, _FIRST * scale, is_own)
        asked, moved = own_entries(was.asked, blocks), own_entries(estimate - was.model.estimate, blocks)
        held = (np.abs(moved) < _HELD * np.abs(asked)) & (np.abs(asked) > _RESOLVED * scale)
        longest = _LONGEST * layout.num_players
        lacks_news = ((was.contacts.news == 0) & ~is_own).any(axis=1, keepdims=True)
        unheard = np.where(lacks_news, np.clip(was.steps, _SHORTEST, longest), was.unheard)
        own_moves = np.where(is_own & (was.steps > 0), estimate - before, 0.0)
        lag, trail, behind, passed = _measure_lag(observation, was, own_moves)
        delay = np.minimum(unheard + lag - 1, longest)
        wanted = _respond(model, drift, blocks, is_own, held, delay, was.share)
        response = shorten(wanted, model.radius)
        response = np.where(is_probe & (np.arange(blocks.shape[1]) != was.steps), 0.0, response)
        displacement = with_own(drift, response, blocks)
        asked = clip_to_reach(displacement, observation, layout)
        is_whole = (own_entries(asked, blocks) == wanted).all(axis=1, keepdims=True)
        share, direction = _adapt(was, wanted, is_whole, delay)
        known = was.steps + 1, contacts, noise, model, asked, share, direction, unheard, delay, trail, behind, passed
        return per_step(displacement, observation), RelayMemory(*known, median, outlier)

    def _weigh(self, noise: Noise, mean: FloatArray, steps: FloatArray) -> tuple[Noise, FloatArray]:
        """Return the noise after the differences (R, n) to the sources, and the weight w of copies, shape (R, 1)."""
        ends = steps % self.patience == self.patience - 1
        level = np.where(ends & (noise.number > 0), noise.total / np.maximum(noise.number, 1), noise.level)
        calmer = (ends & (level <= noise.level / _CALMER)) | (steps < 1)
        count = np.where(calmer | (largest(mean) > _SIGNAL * noise.level), 0.0, noise.since + 1)
        weight = np.where(count > self.patience, self.forgetting / (self.forgetting + count), 1.0)
        total, number = (np.where(ends, 0.0, part) for part in (noise.total, noise.number))
        return noise._replace(total=total, number=number, level=level, since=count), weight


def _measure(observation: Observation, was: Noise, steps: FloatArray, owned: BoolArray) -> Noise:
    """Return the noise after the messages of this step.

    In the second step, after which the estimates of others move, their first differences are noise alone; ``owned``
    says whether sender or receiver own a component, (R, D, n), and ``steps`` (R, 1) counts the steps so far.
    """
    live, content = observation.weights > 0, observation.own_estimate[:, None] + observation.relative_estimates
    age = np.where(live, was.age + 1, 0.0)
    change = np.abs(content - was.last)
    smooth = np.abs(content - 2 * was.last + was.before) / np.sqrt(3)
    is_second = steps == 1
    change = np.where(is_second[:, :, None], np.where(owned, 0.0, change), np.minimum(change, smooth))
    lasted = age >= np.where(is_second, 2, 3)
    largest_change = np.where(lasted, row_maxima(change), -np.inf).max(axis=1, keepdims=True)
    is_known = lasted.any(axis=1, keepdims=True)
    largest_change = np.where(is_known, largest_change, 0.0)
    return was._replace(
        last=content,
        before=was.last.copy(),  # a memory shares nothing with the one before
        age=age,
        total=was.total + largest_change,
        number=was.number + is_known,
        level=np.where(is_second, largest_change, was.level),
        second=np.where(is_second, largest_change, was.second),
    )


def _drop_outliers(
    mean: FloatArray, median: FloatArray, outlier: FloatArray, is_noisy: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the differences (R, n) to the sources without outliers, and the new ``median`` and ``outlier``.

    A second outlier of the same sign is news, and then the running median is what makes it none.
    """
    found, heard = np.abs(mean), mean != 0
    is_loud = is_noisy & (median > 0) & (found > _OUTLIER * median)
    is_news = is_loud & (outlier * mean > 0)
    paced = np.where(found > median, median * _PACE, median / _PACE)
    paced = np.where(is_news, found / _OUTLIER, np.where(median > 0, paced, found))
    signs = np.where(is_loud, np.sign(mean), 0.0)
    kept = np.where(is_loud & ~is_news, 0.0, mean)
    return kept, np.where(heard, paced, median), np.where(heard, signs, outlier)


def _measure_lag(observation: Observation, was: RelayMemory, moves: FloatArray) -> tuple[FloatArray, ...]:
    """Return the lag L ≥ 1 of the neighbours' copies of the own strategy (R, 1), after the last own ``moves`` (R, n).

    A copy that is L steps old differs from the strategy by the sum of L moves. Both this and the last move are weighted
    by the trail, on which noise does not depend. The other arrays are the trail and the two sums.
    """
    trail = (1 - 1 / was.delay) * was.trail + moves
    counts = (observation.weights > 0) & (was.steps > 2 * was.unheard)  # until then neighbours may not know of any move
    ahead = np.where(counts[:, :, None], -observation.relative_estimates, 0.0)
    behind = was.behind + np.einsum("rdn,rn->r", ahead, trail)[:, None]
    passed = was.passed + counts.sum(axis=1, keepdims=True) * np.einsum("rn,rn->r", moves, trail)[:, None]
    lag = np.where(passed > 0, behind / np.where(passed > 0, passed, 1.0), 1.0)
    return np.clip(lag, 1.0, np.maximum(was.steps, 1.0)), trail, behind, passed


def _adapt(
    was: RelayMemory, response: FloatArray, is_whole: BoolArray, delay: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the share of the damping (R, 1), and the mean direction after a ``response`` (R, m) if it ``is_whole``."""
    length = largest(response)
    counts = is_whole & (length > 0)
    heading = response / np.where(counts, length, 1.0)
    direction = np.where(counts, was.direction + (heading - was.direction) / (_WINDOW * delay), was.direction)
    share = was.share * np.exp(_RATE * (_STEADY - largest(direction)) / delay)
    return np.where(counts, np.clip(share, _LEAST, 1.0), was.share), direction


def _respond(
    model: Model,
    drift: FloatArray,
    blocks: IntArray,
    is_own: BoolArray,
    held: BoolArray,
    delay: FloatArray,
    share: FloatArray,
) -> FloatArray:
    """Return the damped best response Δx_i to the estimates after a ``drift`` (R, n) of the others, shape (R, m)."""
    curvature, doubt, vectors = own_curvatures(model, blocks, held)
    curvature = np.where(curvature > doubt, curvature, np.abs(curvature) + doubt)
    others = np.where(is_own[:, None], 0.0, model.rows)
    coupling = np.abs(others).sum(axis=2).max(axis=1, keepdims=True)
    excess = np.maximum(coupling - curvature, 0.0)
    divisor = curvature + share * (1 + delay) * excess
    is_loose = excess.any(axis=1, keepdims=True)
    lead = np.minimum(_LEAD + delay, divisor.min(axis=1, keepdims=True) / np.where(is_loose, coupling, 1.0))
    wanted = model.gradient + np.einsum("rmn,rn->rm", others, np.where(is_loose, lead, 1.0) * drift)
    along = np.einsum("rba,rb->ra", vectors, wanted)
    along = np.where(divisor > 0, along / np.where(divisor > 0, divisor, 1.0), 0.0)
    return -np.einsum("rab,rb->ra", vectors, along)
