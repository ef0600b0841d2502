"""The observer relay: the contact relay, with observers of noise, rounding, liars, pushes and neighbours' reactions."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import numpy as np

from ptne_env.field.laws import estimators, reactions
from ptne_env.field.laws.best_response import (
    LARGEST_ROW,
    UNLIMITED,
    largest,
    own_block,
    own_places,
    with_own,
    within_reach,
)
from ptne_env.field.laws.constants import C
from ptne_env.field.laws.contact_relay import SPREAD, Own, Relayed, copy_weight, heard, nothing_relayed, own_side
from ptne_env.field.laws.contacts import contradictions, copies
from ptne_env.field.laws.memory import Memory, chosen
from ptne_env.laws.base import Law, per_step, step_length
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray


class State(NamedTuple):
    """What R players remember from step to step."""

    relay: Relayed  # as the contact relay
    contradicted: FloatArray  # steps for which a neighbour has contradicted, shape (R, D, n)
    damage: estimators.Damage  # noise and rounding of messages
    samples: estimators.Samples  # of messages that carry noise or are rounded
    damping: estimators.Damping  # of responses
    doubt: FloatArray  # the recent error of predictions of the own gradient, as a displacement, shape (R, 1)
    broke: FloatArray  # whether a link of the player ever broke, shape (R, 1)
    planes: reactions.Planes | tuple[()]  # the neighbours' reactions; empty in games with more than 32 components
    push: estimators.Push  # what moves the own strategy beside the own inputs
    sent: FloatArray  # the displacement that the last inputs make, shape (R, n)
    reckoned: FloatArray  # the own estimates by dead reckoning, in float64, shape (R, n)
    transformed: FloatArray  # s by the player's clock, shape (R, 1)
    theta: FloatArray  # Θ of the last step, shape (R, 1)
    dt: FloatArray  # Δt of the last step, shape (R, 1)


def start_of_episode(layout: ObservationLayout) -> State:
    """The state of one player at the start of an episode."""
    none, own = np.zeros((1, 1)), np.zeros((1, layout.dimension))
    slots, links = np.zeros((1, layout.slots, layout.dimension)), np.zeros((1, layout.slots))
    return State(
        relay=nothing_relayed(layout),
        contradicted=slots,
        damage=estimators.Damage(none + UNLIMITED, none + UNLIMITED, none, none),
        samples=estimators.Samples(slots, slots, slots, slots, slots, slots, links),
        damping=estimators.Damping(none + 1, none, none),
        doubt=none,
        broke=none,
        planes=reactions.no_planes(layout) if layout.dimension <= LARGEST_ROW else (),
        push=estimators.Push(own, none),
        sent=own,
        reckoned=own,
        transformed=none,
        theta=none,
        dt=none,
    )


class ObserverRelay(Law):
    """:class:`~ptne_env.field.laws.ContactRelay` with observers of noise, rounding, liars, pushes and reactions.

    Where messages carry noise or are rounded, raw copies travel, and a private mean of messages, the *belief*, is
    stated near the end; where messages are rounded, the own strategy responds to it, and is dithered. Observed pushes
    are compensated. Where links break, the joint solution of the own first-order condition and of the neighbours'
    reactions is followed as soon as it is trusted. Where the own gradient was not predicted, as in games that are not
    affine, a short gradient step is added: best responses are short while the model changes.

    A *source* is a neighbour whose copy of a component is copied; a *liar* states strategies of others falsely; a
    *push* moves the own strategy beside the inputs; a *plane* is the linear best response of a neighbour, learned from
    its messages. ``C`` holds the constants. :meth:`inputs` is the whole law, from top to bottom;
    ``docs/mathematics.md`` explains it.

    Args:
        layout: of the environment, interface ``physical``.

    Raises:
        LayoutError: for another interface.
    """

    needs: ClassVar[tuple[str, ...]] = ("own_estimate",)

    def __init__(self, layout: ObservationLayout) -> None:
        super().__init__(layout)
        self._memory: Memory[Any] = Memory(start_of_episode(layout))

    def initial_memory(self, rows: int) -> FloatArray:
        """Nothing identified, heard or observed; shape (R, size)."""
        return self._memory.initial(rows)

    def inputs(  # noqa: PLR0915 - the whole law
        self, observation: Observation, memory: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        layout, was = self.layout, self._memory.unpack(memory)
        is_own, owners = layout.own_mask[observation.player], layout.neighbour_components[observation.player]
        estimate, steps = observation.own_estimate, was.relay.steps
        scale, none = largest(estimate), np.zeros_like(estimate)

        # What the neighbours say: exact, noisy or rounded.
        messages, noise, sources, met = heard(observation, was.relay, layout)
        broke = np.maximum(was.broke, (messages.was_live & ~messages.live).any(axis=1, keepdims=True))
        damage, is_noisy, is_rounded = estimators.damage(messages, was.damage, noise, steps, scale)
        is_uneasy = is_noisy | is_rounded
        samples = was.samples._replace(number=np.where(is_uneasy[:, :, None], was.samples.number, 0.0))
        means = samples.mean
        if is_uneasy.any():
            found = estimators.sampled(messages, samples, estimate, is_own, is_rounded)
            samples, means = chosen(is_uneasy, found, (samples, means))

        # Whom to copy: those with fresher copies, or who contradict these for long, but no liars.
        drifted = np.where(is_own, 0.0, was.relay.own.asked)
        contradicted = contradictions(observation, messages, was.contradicted, drifted, sources, is_own)
        is_met = (owners & (was.relay.contacts.heard > 0)[:, :, None]).any(axis=1)
        is_plain = (was.broke == 0) & (was.damage.noisy == 0)
        convinces = (contradicted >= C.convincing) & (is_plain & ~is_met)[:, None]
        sources = np.where(convinces.any(axis=1)[:, None], convinces, sources)
        met = met._replace(source=sources.astype(np.float64))
        others = messages.live[:, :, None] & ~is_own[:, None]
        sources = estimators.without_liars(sources & others, others, owners, was.samples.lies)
        copy = np.where(is_own, 0.0, copies(observation, sources))

        # How to respond: a model of the own gradient, damped where responses of all players at once do not settle.
        own = own_side(observation, was.relay.own, steps, layout)
        doubt = self._doubt(own, was.doubt, steps)
        tempered = estimators.tempered(own, was.damping, was.relay.own.gradient, steps, layout.dimension)
        weight, unrest = copy_weight(messages, was.relay.unrest, copy, C.copy_patience, C.copy_forgetting)
        weight = np.where(own.is_probe, 0.0, weight)
        response = with_own(none, tempered.response(own, weight * copy), own.blocks)
        damping = estimators.damped(was.damping, tempered.is_loose, response, steps, noise, scale, doubt)

        # What exact neighbours will do: planes of their reactions, solved with the own condition where links break.
        here = reactions.reckoned_estimate(estimate, was.reckoned, steps)
        planes, joint = was.planes, here + weight * copy + response
        is_trusted = np.zeros_like(is_uneasy)
        if isinstance(planes, reactions.Planes) and not is_uneasy.all():
            learned = reactions.learned_planes(observation, messages, planes, steps, here, layout)
            planes = chosen(~is_uneasy, learned, planes)
            solves = ~is_uneasy & (broke > 0) & (steps >= C.start)
            if solves.any():
                joint, counts = reactions.joint_solution(observation.player, planes, here, joint, own, doubt, layout)
                is_trusted = solves & counts

        # What moves the own strategy beside the own inputs.
        is_held = with_own(none, own.held.astype(np.float64), own.blocks) > 0
        residual = np.where(is_own & ~is_held & (steps > 0), own.moved - was.sent, 0.0)
        push = estimators.observed_push(was.push, residual, was.dt, scale)

        # The others' estimates: copies, slower where messages are noisy, or the belief near the end.
        calm = C.patience + np.maximum(unrest.steps - C.delay, 0.0)
        slower = np.where(tempered.factor < 1, 1.0, np.maximum(C.patience / calm, C.floor) ** 2)
        weight = np.where(is_noisy, slower, np.where(is_rounded, 1.0, weight))
        drift = np.minimum(weight + C.kept * broke, 1.0) * copy
        from_sources = estimators.belief(sources.astype(np.float64), samples, means, estimate)
        is_settled = is_rounded | (np.abs(from_sources - estimate) <= C.settled * noise)
        beside = C.beside * estimators.mature(samples.number, sources, is_own, was.samples.lies)
        belief = estimators.belief(np.maximum(sources, beside), samples, means, estimate + drift) - estimate
        closes = self._closes(observation, was, is_rounded)
        stated = np.where(is_uneasy & closes & is_settled, belief, drift)

        # The own strategy: a best response to them, or to the belief, dithered where messages are rounded.
        aim = np.where(is_own, 0.0, np.where(is_rounded | (is_noisy & closes), belief, drift))
        response = with_own(none, tempered.response(own, aim), own.blocks)
        descends = own.failed & ~is_uneasy & (broke == 0)
        tick = np.where(is_rounded & ~closes & (damage.width < UNLIMITED), damage.width, 0.0)
        strategy = response - descends / SPREAD * observation.gradient + tick * estimators.dither(steps)

        planned = np.where(is_trusted, joint - here, np.where(is_own, strategy, stated))
        displacement = np.where(is_own, planned - push.velocity * observation.dt, planned)
        sent = within_reach(displacement, observation, layout)
        inputs = (sent / step_length(observation)).astype(np.float32)
        last = own.remembered(observation, planned, layout)
        fresh = State(
            relay=Relayed(steps + 1, last, met, messages.content, noise, unrest),
            contradicted=contradicted,
            damage=damage,
            samples=samples,
            damping=damping,
            doubt=doubt,
            broke=broke,
            planes=planes,
            push=push,
            sent=sent,
            reckoned=here + inputs * observation.theta,
            transformed=observation.transformed,
            theta=observation.theta,
            dt=observation.dt,
        )
        return per_step(displacement, observation), self._memory.pack(fresh)

    def _doubt(self, own: Own, was: FloatArray, steps: FloatArray) -> FloatArray:
        """The recent error of predictions of the own gradient, as a displacement, shape (R, 1)."""
        block = own_block(own.model.rows, own_places(own.blocks, own.model, self.layout.dimension))
        curvature = np.maximum(np.abs(block.diagonal(axis1=1, axis2=2)), C.smallest_curvature)
        error = own.error / curvature.min(axis=1, keepdims=True)
        return np.where(steps <= C.start, 0.0, np.maximum(C.fade * was, error))

    def _closes(self, observation: Observation, was: State, is_rounded: BoolArray) -> BoolArray:
        """Whether the end of the episode is near: little transformed time is left, or one step; shape (R, 1)."""
        # Δs_k = Θ_k − c Δt_k of the coming step, with c, the constant part of the gain, = (Θ − Δs)/Δt of
        # the last one; 0 in the first step.
        gain = (was.theta - (observation.transformed - was.transformed)) / np.where(was.dt > 0, was.dt, 1.0)
        coming = np.where(was.dt > 0, np.maximum(observation.theta - gain * observation.dt, 0.0), 0.0)
        left = self.layout.largest_clock[1] - observation.transformed
        ending = np.where(is_rounded, C.closing_rounded, C.closing)
        return np.asarray(left <= np.maximum(ending, 1.5 * coming))  # half a step more against rounding
