"""The observer relay: the contact relay, with observers of noise, rounding, liars, pushes and neighbours' reactions."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import numpy as np

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
from ptne_env.field.laws.contact_relay import (
    SPREAD,
    LastMove,
    Own,
    Unrest,
    copy_weight,
    fresher_copies,
    no_move,
    no_unrest,
    own_side,
)
from ptne_env.field.laws.contacts import (
    Contacts,
    Messages,
    contradictions,
    copies,
    heard_messages,
    no_contacts,
    noise_level,
)
from ptne_env.field.laws.estimators import (
    NO_DAMAGE,
    Damage,
    Damping,
    Push,
    Samples,
    belief,
    damage,
    dither,
    mature,
    observed_push,
    sampled,
    settled,
    settling,
    without_liars,
)
from ptne_env.field.laws.memory import Memory, rows_in, taken_rows, with_rows
from ptne_env.field.laws.reactions import (
    Condition,
    Planes,
    Reactions,
    joint_solution,
    learned_planes,
    no_planes,
    reckoned_estimate,
)
from ptne_env.laws.base import Law, per_step, step_length
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, require_positive


class State(NamedTuple):
    """What a player of :class:`ObserverRelay` remembers from step to step.

    Attributes:
        steps: number of steps so far, shape (1,).
        own: its last move, and its model of its own gradient.
        contacts: with its neighbours.
        contradicted: steps for which a neighbour has contradicted, shape (D, n).
        messages: of the step before, shape (D, n).
        noise: σ_i, the smallest change of messages, shape (1,).
        unrest: of messages, for the weight of copies.
        damage: noise and rounding.
        samples: of messages that carry noise or are rounded.
        damping: of responses.
        doubt: the recent error of predictions of the own gradient, as a displacement, shape (1,).
        broke: whether a link of the player ever broke, shape (1,).
        planes: its neighbours' reactions; empty in games with more than 32 components.
        push: what moves its strategy beside its inputs.
        sent: the displacement that its inputs make, shape (n,).
        reckoned: its estimates by dead reckoning, in float64, shape (n,).
        transformed: s by its clock, shape (1,).
        theta: Θ of the last step, shape (1,).
        dt: Δt of the last step, shape (1,).
    """

    steps: FloatArray
    own: LastMove
    contacts: Contacts
    contradicted: FloatArray
    messages: FloatArray
    noise: FloatArray
    unrest: Unrest
    damage: Damage
    samples: Samples
    damping: Damping
    doubt: FloatArray
    broke: FloatArray
    planes: Planes | tuple[()]
    push: Push
    sent: FloatArray
    reckoned: FloatArray
    transformed: FloatArray
    theta: FloatArray
    dt: FloatArray


class ObserverRelay(Law):
    """:class:`~ptne_env.field.laws.ContactRelay` with observers of noise, rounding, liars, pushes and reactions.

    Where messages carry noise or are rounded, raw copies travel, and a private mean of messages, the *belief*, is
    stated near the end; where messages are rounded, the own strategy responds to it, and is dithered. Observed pushes
    are compensated. Where links break, the joint solution of the own first-order condition and of the neighbours'
    reactions is followed as soon as it is trusted. Where the own gradient was not predicted, as in games that are not
    affine, a short gradient step is added: best responses are short while the model changes.

    :meth:`inputs` is the whole law, from top to bottom.

    Args:
        layout: of the environment, interface ``physical``.
        patience: as for :class:`~ptne_env.field.laws.ContactRelay`.
        forgetting: as for :class:`~ptne_env.field.laws.ContactRelay`.

    Raises:
        ValueError: for a patience or forgetting that is not positive, or another interface.
    """

    needs: ClassVar[tuple[str, ...]] = ("own_estimate",)

    def __init__(self, layout: ObservationLayout, patience: float = 30.0, forgetting: float = 2.0) -> None:
        super().__init__(layout)
        self.patience = require_positive("patience", patience)
        self.forgetting = require_positive("forgetting", forgetting)
        self._memory: Memory[Any] = Memory(start_of_episode(layout))

    def initial_memory(self, rows: int) -> FloatArray:
        """Nothing identified, heard or observed; shape (R, size)."""
        return self._memory.initial(rows)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        layout, was = self.layout, self._memory.unpack(memory)
        is_own, owners = layout.own_mask[observation.player], layout.neighbour_components[observation.player]
        estimate, steps = observation.own_estimate, was.steps
        scale, none = largest(estimate), np.zeros_like(estimate)

        # What the neighbours say, and how far it can be trusted.
        messages = heard_messages(observation, was.contacts.live, was.messages)
        broke = np.maximum(was.broke, (messages.was_live & ~messages.live).any(axis=1, keepdims=True))
        noise = noise_level(messages, was.noise, steps, owners | is_own[:, None])
        harm, is_noisy, is_rounded = damage(observation, messages, was.damage, noise, steps)
        is_uneasy = is_noisy | is_rounded
        samples, means = self._sampled(messages, was.samples, estimate, is_own, is_uneasy, is_rounded)

        # Whom to copy: neighbours with fresher copies, or who contradict them for long, but no liars.
        sources, met = fresher_copies(observation, was.contacts, was.own.asked, steps, noise, layout)
        drifted = np.where(is_own, 0.0, was.own.asked)
        contradicted = contradictions(observation, messages, was.contradicted, drifted, sources, is_own)
        is_met = (owners & (was.contacts.heard > 0)[:, :, None]).any(axis=1)
        is_plain = (was.broke == 0) & (was.damage.noisy == 0)
        convinces = (contradicted >= C.convincing) & (is_plain & ~is_met)[:, None]
        sources = np.where(convinces.any(axis=1)[:, None], convinces, sources)
        met = met._replace(source=sources.astype(np.float64))
        others = messages.live[:, :, None] & ~is_own[:, None]
        sources = without_liars(sources & others, others, owners, was.samples.lies)
        copy = np.where(is_own, 0.0, copies(observation, sources))

        # The own side: a model of the own gradient, and how strongly to respond.
        own = own_side(observation, was.own, steps, layout)
        block = own_block(own.model.rows, own_places(own.blocks, own.model, layout.dimension))
        curvature = np.maximum(np.abs(block.diagonal(axis1=1, axis2=2)), C.smallest_curvature)
        error = own.error / curvature.min(axis=1, keepdims=True)
        doubt = np.where(steps <= C.start, 0.0, np.maximum(C.fade * was.doubt, error))
        tempered = settling(own, was.damping, was.own.gradient, steps, layout.dimension)
        weight, unrest = copy_weight(messages, was.unrest, copy, self.patience, self.forgetting)
        weight = np.where(own.is_probe, 0.0, weight)
        response = with_own(none, tempered.response(own, weight * copy), own.blocks)
        damping = settled(was.damping, tempered.is_loose, response, steps, noise, scale, doubt)

        # What the neighbours will do: planes of their reactions, solved together with the own condition.
        here = reckoned_estimate(estimate, was.reckoned, steps)
        planned = here + weight * copy + response
        planes, joint = self._reactions(observation, messages, was, own, here, planned, doubt, ~is_uneasy, broke)

        # What moves the own strategy beside the own inputs.
        held = with_own(none, own.held.astype(np.float64), own.blocks) > 0
        residual = np.where(is_own & ~held & (steps > 0), own.moved - was.sent, 0.0)
        push = observed_push(was.push, residual, was.dt, scale)

        # The others' estimates: copies, slower where messages are noisy, or the belief near the end.
        calm = C.patience + np.maximum(unrest.steps - C.delay, 0.0)
        slower = np.where(tempered.factor < 1, 1.0, np.maximum(C.patience / calm, C.floor) ** 2)
        weight = np.where(is_noisy, slower, np.where(is_rounded, 1.0, weight))
        drift = np.minimum(weight + C.kept * broke, 1.0) * copy
        from_sources = belief(sources.astype(np.float64), samples, means, estimate)
        is_settled = is_rounded | (np.abs(from_sources - estimate) <= C.settled * noise)
        beside = C.beside * mature(samples.count, sources, is_own, was.samples.lies)
        believed = belief(np.maximum(sources, beside), samples, means, estimate + drift) - estimate
        closes = self._closes(observation, was, is_rounded)
        stated = np.where(is_uneasy & closes & is_settled, believed, drift)

        # The own strategy: a best response to them, or to the belief, dithered where messages are rounded.
        aim = np.where(is_own, 0.0, np.where(is_rounded | (is_noisy & closes), believed, drift))
        response = with_own(none, tempered.response(own, aim), own.blocks)
        descent = own.failed & ~is_uneasy & (broke == 0)
        tick = np.where(is_rounded & ~closes & (harm.width < UNLIMITED), harm.width, 0.0)
        strategy = response - descent / SPREAD * observation.gradient + tick * dither(steps)

        mixed = np.where(is_own, strategy, stated)
        mixed = np.where(joint.is_trusted, joint.point - here, mixed)
        displacement = np.where(is_own, mixed - push.velocity * observation.dt, mixed)
        sent = within_reach(displacement, observation, layout)
        rounded_inputs = (sent / step_length(observation)).astype(np.float32)
        fresh = State(
            steps=steps + 1,
            own=own.remembered(observation, mixed, layout),
            contacts=met,
            contradicted=contradicted,
            messages=messages.content,
            noise=noise,
            unrest=unrest,
            damage=harm,
            samples=samples,
            damping=damping,
            doubt=doubt,
            broke=broke,
            planes=planes,
            push=push,
            sent=sent,
            reckoned=here + rounded_inputs * observation.theta,
            transformed=observation.transformed,
            theta=observation.theta,
            dt=observation.dt,
        )
        return per_step(displacement, observation), self._memory.pack(fresh)

    def _sampled(
        self,
        messages: Messages,
        was: Samples,
        estimate: FloatArray,
        is_own: BoolArray,
        is_uneasy: BoolArray,
        is_rounded: BoolArray,
    ) -> tuple[Samples, FloatArray]:
        """:func:`~ptne_env.field.laws.estimators.sampled` where messages do not come to rest; else no sample counts."""
        samples, means = was._replace(count=np.where(is_uneasy[:, :, None], was.count, 0.0)), was.mean
        if not is_uneasy.any():
            return samples, means
        rows = rows_in(is_uneasy[:, 0])
        found = sampled(
            taken_rows(messages, rows), taken_rows(samples, rows), estimate[rows], is_own[rows], is_rounded[rows]
        )
        return with_rows((samples, means), rows, found)

    def _reactions(
        self,
        observation: Observation,
        messages: Messages,
        was: State,
        own: Own,
        here: FloatArray,
        planned: FloatArray,
        doubt: FloatArray,
        is_calm: BoolArray,
        broke: FloatArray,
    ) -> tuple[Planes | tuple[()], Reactions]:
        """The neighbours' planes where messages are exact, and the joint solution where links broke, else ``planned``."""
        planes, joint = was.planes, Reactions(planned, np.zeros_like(doubt), np.zeros_like(own.failed))
        if not (isinstance(planes, Planes) and is_calm.any()):
            return planes, joint
        rows = rows_in(is_calm[:, 0])
        part, said, before = (taken_rows(record, rows) for record in (observation, messages, planes))
        learned = learned_planes(part, said, before, was.steps[rows], here[rows], self.layout)
        planes = with_rows(planes, rows, learned)
        solves = is_calm & (broke > 0)
        if solves.any():
            rows = rows_in(solves[:, 0])
            condition = taken_rows(Condition(own.model.rows, own.gradient, own.blocks, doubt), rows)
            known, player = taken_rows(planes, rows), observation.player[rows]
            found = joint_solution(player, known, was.steps[rows], here[rows], planned[rows], condition, self.layout)
            joint = with_rows(joint, rows, found)
        return planes, joint

    def _closes(self, observation: Observation, was: State, is_rounded: BoolArray) -> BoolArray:
        """Whether the end of the episode is near: little transformed time is left, or one step; shape (R, 1)."""
        # Δs_k = Θ_k − c Δt_k of the coming step, with c = (Θ − Δs)/Δt of the last one; 0 in the first.
        gain = (was.theta - (observation.transformed - was.transformed)) / np.where(was.dt > 0, was.dt, 1.0)
        coming = np.where(was.dt > 0, np.maximum(observation.theta - gain * observation.dt, 0.0), 0.0)
        left = self.layout.largest_clock[1] - observation.transformed
        ending = np.where(is_rounded, C.closing_rounded, C.closing)
        return np.asarray(left <= np.maximum(ending, 1.5 * coming))  # half a step more against rounding


def start_of_episode(layout: ObservationLayout) -> State:
    """The state of one player at the start of an episode."""
    none, links, own = np.zeros((1, 1)), np.zeros((1, layout.slots)), np.zeros((1, layout.dimension))
    slots = np.zeros((1, layout.slots, layout.dimension))
    return State(
        steps=none,
        own=no_move(layout),
        contacts=no_contacts(layout),
        contradicted=slots,
        messages=slots,
        noise=none,
        unrest=no_unrest(),
        damage=NO_DAMAGE,
        samples=Samples(slots, slots, slots, slots, slots, slots, links),
        damping=Damping(none + 1, none, none),
        doubt=none,
        broke=none,
        planes=no_planes(layout) if layout.dimension <= LARGEST_ROW else (),
        push=Push(own, none),
        sent=own,
        reckoned=own,
        transformed=none,
        theta=none,
        dt=none,
    )
