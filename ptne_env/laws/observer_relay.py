"""The observer relay: best responses and copies as in the contact relay, beneath noise, rounding, lies and gaps."""

from __future__ import annotations

from collections.abc import Collection
from typing import ClassVar, NamedTuple

import numpy as np

from ptne_env.laws.base import RecordLaw, per_step, select_rows, step_length
from ptne_env.laws.building_blocks import messages as messaging
from ptne_env.laws.building_blocks import reactions
from ptne_env.laws.building_blocks.messages import Contacts, Damage, Filters
from ptne_env.laws.building_blocks.own_gradient import (
    LARGEST_ROW,
    OwnMemory,
    OwnSide,
    clip_to_reach,
    initial_own_memory,
    largest,
    observe_own_side,
    own_block,
    own_places,
    with_own,
)
from ptne_env.laws.building_blocks.reactions import Damping, Planes
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, fold

RULES = ("noise", "rounding", "restraint", "statement", "trust", "damping", "reactions")
"""The rules that ``without`` may switch off."""

_NEWS = 5.0
"""A copy has news once it moved by more than this many standard deviations of a difference of two messages."""

_NEAR = 2.0
"""A copy follows its source at once where the last two messages are farther away than this many deviations."""

_HALF = 0.5
"""The weight of a noisy copy otherwise."""

_LIE, _GROSS = 4.0, 0.01
"""Error about the own strategy that a neighbour may make: in standard deviations, plus a share of the own estimate."""

_OTHERS, _DOUBTFUL = 0.03, 0.1
"""Neighbours that are no source get the first weight where every source is trusted less than the second."""

_CLOSING = 1.0
"""Transformed time before the end from which on beliefs are stated, in the last step at the latest."""

_FADE = 0.7
"""Share of the recent error of predictions that is left after a step: one good prediction proves little."""


class ObserverRelayMemory(NamedTuple):
    """What R players remember from step to step."""

    steps: FloatArray  # number of steps so far, shape (R, 1)
    own: OwnMemory  # the own side
    contacts: Contacts  # with the neighbours
    filters: Filters  # of their messages
    damping: Damping  # of responses
    doubt: FloatArray  # the recent error of predictions of the own gradient, as a displacement, shape (R, 1)
    broke: FloatArray  # whether a link of the player ever broke, shape (R, 1)
    planes: Planes | tuple[()]  # the neighbours' reactions; empty in games with more than 32 components
    reckoned: FloatArray  # the own estimates by dead reckoning, in float64, shape (R, n)


class ObserverRelay(RecordLaw):
    """A contact relay that observes noise, rounding, lies and the reactions of neighbours.

    Of each neighbour's messages a player keeps private means; those of sources, weighted by their variances, are its
    *belief*. While an episode lasts, its estimates are nearly raw copies, because news must travel fast and averages
    that are sent on are averaged again; near the end they are the belief. Where links break and messages are exact, the
    joint solution of the own first-order condition and of the neighbours' reactions is followed.

    A *source* is a neighbour with a fresher copy of a component. :meth:`inputs` is the whole law, from top to bottom;
    ``docs/mathematics.md`` explains it.

    Args:
        layout: the layout of the environment, with the interface ``physical``.
        without: the rules among :data:`RULES` that are switched off, to measure what they bring.

    Raises:
        LayoutError: for another interface.
        ValueError: for an unknown rule.
    """

    needs: ClassVar[tuple[str, ...]] = ("own_estimate",)

    def __init__(self, layout: ObservationLayout, without: Collection[str] = ()) -> None:
        super().__init__(layout)
        if unknown := set(without) - set(RULES):
            raise ValueError(f"unknown rule {min(unknown)!r}; choose from {', '.join(RULES)}")
        self.without = tuple(without)
        none, own = np.zeros((1, 1)), np.zeros((1, layout.dimension))
        self.start = ObserverRelayMemory(
            steps=none,
            own=initial_own_memory(layout),
            contacts=messaging.initial_contacts(layout),
            filters=messaging.initial_filters(layout),
            damping=Damping(none + 1, none, none, own, none, np.zeros((1, max(layout.action_dims)))),
            doubt=none,
            broke=none,
            planes=reactions.initial_planes(layout) if layout.dimension <= LARGEST_ROW else (),
            reckoned=own,
        )

    def inputs(  # noqa: PLR0915 - the whole law
        self, observation: Observation, memory: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        layout, was, without = self.layout, self.unpack(memory), self.without
        is_own, owners = layout.own_mask[observation.player], layout.neighbour_components[observation.player]
        estimate, steps = observation.own_estimate, was.steps
        scale, none, relative = largest(estimate), np.zeros_like(estimate), observation.relative_estimates

        # What the neighbours say, and beneath noise or rounding, what they mean.
        messages = messaging.read_messages(observation, was.contacts.live, was.filters.last)
        filters, damage = messaging.measure_damage(messages, was.filters, steps, owners, scale)
        tells = (was.broke == 0) & ("rounding" not in without)  # a dither's mean needs links that last
        damage = Damage(damage.noise * ("noise" not in without), damage.step * tells)
        deviation, is_damaged = damage.deviation[:, :, None], damage.deviation > 0
        meant, variance = relative, np.ones_like(relative)
        if is_damaged.any():
            filtered = messaging.filter_messages(messages, was.filters, filters, damage)
            plain = filters, (messages.content, variance)
            filters, (means, variance) = select_rows(is_damaged, filtered, plain)
            meant = np.where(is_damaged[:, :, None], means - estimate[:, None], relative)
        variance = np.where(is_damaged[:, :, None], variance * deviation**2, 1.0)

        # Whom to copy: neighbours with fresher copies, and a little those that are right about the own strategy.
        drifted = np.where(is_own, 0.0, was.own.asked)
        news = _NEWS * np.sqrt(2) * damage.noise[:, :, None]
        sources, contacts = messaging.find_sources(observation, was.contacts, steps > 0, drifted, owners, news)
        live = messages.live[:, :, None] & ~is_own[:, None]
        sources &= live
        gross = np.where(is_damaged, damage.deviation**2 + (_GROSS * scale) ** 2, 0.0)[:, :, None]
        trust = 1.0 if "trust" in without else _trust(meant, variance, gross, is_own, owners)
        doubtful = is_damaged & (np.where(sources, trust, 0.0).max(axis=1) < _DOUBTFUL) & sources.any(axis=1)
        # Neighbours whose messages never change are no sources; their mean is better than the start.
        is_silent = np.isinf(filters.width) & (filters.age >= reactions.START).any(axis=1, keepdims=True)
        doubtful |= is_silent & ~sources.any(axis=1)
        shares = np.where(sources, 1.0, _OTHERS * (live & doubtful[:, None])) * trust
        copy = _mean(shares, relative)
        belief = _mean(shares / variance, meant)

        # The others' estimates: copies, slower within the noise, and the belief at the end.
        far = np.minimum(np.abs(relative), np.abs(was.filters.last - estimate[:, None])) > _NEAR * deviation
        is_far = (far & sources & (filters.age >= 2)[:, :, None]).any(axis=1)
        contact = np.where(sources, filters.age[:, :, None], 0.0).max(axis=1)
        is_slow = (damage.noise > 0) & ~is_far & (contact != 1) & ("restraint" not in without)
        copy = np.where(is_slow, _HALF, 1.0) * copy
        left = layout.largest_clock[1] - observation.transformed
        closes = (left <= np.maximum(_CLOSING, 1.5 * observation.theta)) & ("statement" not in without)
        drift = np.where(is_damaged & closes, belief, copy)
        aim = np.where(closes | (damage.step > 0), belief, copy)

        # The own strategy: a best response to them, damped where responses of all players at once do not settle.
        broke = np.maximum(was.broke, (messages.was_live & ~messages.live).any(axis=1, keepdims=True))
        own = observe_own_side(observation, was.own, steps, layout, broke > 0)
        rests = own.is_probe | is_own
        drift, aim = np.where(rests, 0.0, drift), np.where(rests, 0.0, aim)
        response = with_own(none, reactions.damp_response(own, was.damping, was.own.gradient, aim), own.blocks)
        doubt = self._doubt(own, was.doubt, steps)
        loose = reactions.is_loose(own, steps, layout.dimension) & ("damping" not in without)
        damping = reactions.update_damping(
            was.damping, loose, response, own.gradient - was.own.gradient, steps, damage.noise, doubt, scale
        )
        planned = drift + response

        # What exact neighbours will do: planes of their reactions, solved with the own condition where links break.
        here = reactions.reckon_estimate(estimate, was.reckoned, steps)
        planes = was.planes
        if isinstance(planes, Planes) and not is_damaged.all() and "reactions" not in without:
            learned = reactions.learn_planes(observation, messages, planes, steps, here, layout)
            planes = select_rows(~is_damaged, learned, planes)
            is_free = ~own.held.any(axis=1, keepdims=True)  # planes bend at bounds
            solves = ~is_damaged & (broke > 0) & (steps >= reactions.START) & is_free
            if solves.any():
                point, counts = reactions.solve_jointly(
                    observation.player, planes, here, here + planned, own, doubt, layout
                )
                planned = np.where(solves & counts, point - here, planned)

        # Rounded messages tell the own strategy between two multiples if it is dithered.
        shakes = is_own & ~(left <= np.maximum(_CLOSING / 2, 1.5 * observation.theta))
        displacement = planned + np.where(shakes, damage.step, 0.0) * messaging.dither(steps)
        sent = clip_to_reach(displacement, observation, layout)
        moved = (sent / step_length(observation)).astype(np.float32) * observation.theta
        last = own.remember(observation, displacement, layout)
        fresh = ObserverRelayMemory(steps + 1, last, contacts, filters, damping, doubt, broke, planes, here + moved)
        return per_step(displacement, observation), self.pack(fresh)

    def _doubt(self, own: OwnSide, was: FloatArray, steps: FloatArray) -> FloatArray:
        """Return the recent error of predictions of the own gradient, as a displacement, shape (R, 1)."""
        block = own_block(own.model.rows, own_places(own.blocks, own.model, self.layout.dimension))
        curvature = np.abs(block.diagonal(axis1=1, axis2=2)).min(axis=1, keepdims=True)
        error = np.where(curvature > 0, own.error / np.where(curvature > 0, curvature, 1.0), 0.0)
        return np.where(steps <= reactions.START, 0.0, np.maximum(_FADE * was, error))


def _mean(weights: FloatArray, values: FloatArray) -> FloatArray:
    """Return Σ_j w_j v_j / Σ_j w_j, (R, D, n) to (R, n), and 0 where that is 0/0."""
    total = fold(np.add, weights, axis=1)
    return fold(np.add, weights * values, axis=1) / np.where(total > 0, total, 1.0)


def _trust(
    meant: FloatArray, variance: FloatArray, floor: FloatArray, is_own: BoolArray, owners: BoolArray
) -> FloatArray:
    """Return weights of neighbours by their errors about the own strategy, 1 for what they own, shape (R, D, n).

    The square of the share of noise, of variance ``floor`` (R, 1, 1), in noise and error together: who is wrong about
    the own strategy by more than noise may be wrong about others, and a liar is wrong by far. ``meant`` (R, D, n) are
    relative to the own estimates. Where messages are exact, all weights are 1.
    """
    error = np.where(is_own[:, None], meant**2 - _LIE**2 * variance, 0.0).max(axis=2, keepdims=True)
    share = floor / np.where(floor > 0, floor + np.maximum(error, 0.0), 1.0)
    return np.where(owners | (floor == 0), 1.0, share**2)
