from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import numpy as np

from ptne_env.field.laws import filters, reactions
from ptne_env.field.laws.best_response import LARGEST_ROW, largest, with_own, within_reach, own_block, own_places
from ptne_env.field.laws.constants import C
from ptne_env.field.laws.contact_relay import LastMove, Own, own_side, SPREAD
from ptne_env.field.laws.contacts import Contacts, contacts, heard_messages, no_contacts, copies
from ptne_env.field.laws.identification import blank
from ptne_env.field.laws.memory import Memory, chosen
from ptne_env.laws.base import Law, per_step, step_length
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray, fold

class State(NamedTuple):
    steps: FloatArray
    own: LastMove
    contacts: Contacts
    filters: filters.Filters
    planes: Any
    doubt: FloatArray
    broke: FloatArray
    reckoned: FloatArray

class NewRelay(Law):
    needs: ClassVar[tuple[str, ...]] = ("own_estimate",)
    label = "new"

    def __init__(self, layout: ObservationLayout, **opt) -> None:
        super().__init__(layout)
        outputs, n, none = max(layout.action_dims), layout.dimension, np.zeros((1, 1))
        self.opt = opt
        model = blank(1, outputs, n if n <= LARGEST_ROW else outputs, SPREAD)
        own = LastMove(model, np.zeros((1, n)), np.zeros((1, outputs)), np.zeros((1, n)), none)
        planes = reactions.no_planes(layout) if n <= LARGEST_ROW else ()
        self._memory: Memory[Any] = Memory(State(none, own, no_contacts(layout), filters.no_filters(layout), planes, none, none, np.zeros((1, n))))

    def initial_memory(self, rows: int) -> FloatArray:
        return self._memory.initial(rows)

    def inputs(self, observation: Observation, memory: FloatArray):
        layout, was, opt = self.layout, self._memory.unpack(memory), self.opt
        is_own, owners = layout.own_mask[observation.player], layout.neighbour_components[observation.player]
        estimate, steps = observation.own_estimate, was.steps
        scale, none = largest(estimate), np.zeros_like(estimate)

        messages = heard_messages(observation, was.contacts.live, was.filters.last)
        seen, width = filters.measured(messages, was.filters, steps, owners, scale)
        noise = np.where((seen.noise > filters._FINE * scale) & (seen.since >= 10), seen.noise, 0.0)
        noise = noise * (not opt.get('exact'))
        deviation = np.maximum(noise, width / np.sqrt(12))
        is_noisy = deviation > 0
        broke = np.maximum(was.broke, (messages.was_live & ~messages.live).any(axis=1, keepdims=True))

        drifted = np.where(is_own, 0.0, was.own.asked)
        threshold = opt.get("threshold", 3) * np.sqrt(2) * noise
        sources, met = contacts(observation, was.contacts, steps > 0, drifted, owners, threshold[:, :, None])

        # content of messages beneath the noise
        values, variance = messages.content, np.ones_like(messages.content)
        if is_noisy.any():
            found = filters.filtered(messages, seen, was.filters.before, was.filters.last, deviation)
            seen, values, variance = chosen(is_noisy, found, (seen, values, variance))
        relative = np.where(is_noisy[:, :, None], values - estimate[:, None], observation.relative_estimates)
        spread = variance * deviation[:, :, None] ** 2
        # errors of neighbours about the own strategy
        excess = np.where(is_own[:, None], relative**2 - 16 * spread, 0.0).max(axis=2, keepdims=True)
        excess = np.where(is_noisy[:, :, None], np.maximum(excess, 0.0), 0.0) * ~owners
        quality = 1 / np.where(is_noisy[:, :, None], spread + excess, 1.0)
        live = messages.live[:, :, None] & ~is_own[:, None]
        weights = np.where(live, np.where(sources, 1.0, opt.get("beside", 0.3) * is_noisy[:, :, None] * (sources & live).any(axis=1)[:, None]), 0.0) * quality
        total = fold(np.add, weights, axis=1)
        copy = fold(np.add, weights * relative, axis=1) / np.where(total > 0, total, 1.0)

        own = own_side(observation, was.own, steps, layout)
        left = layout.largest_clock[1] - observation.transformed
        closes = left <= np.maximum(opt.get("closing", 1.0), 1.5 * observation.theta)
        far = np.minimum(np.abs(observation.relative_estimates), np.abs(was.filters.last - estimate[:, None]))
        is_far = (far > opt.get("far", 3.) * deviation[:, :, None]) & (seen.age >= 2)[:, :, None]
        w = np.where(is_noisy & (width == 0) & ~(is_far & live & sources).any(axis=1), (np.maximum(opt.get("w", .25), 1 / np.maximum(np.where(live & sources, seen.age[:, :, None], 0).max(axis=1), 1)) if opt.get("age", True) else opt.get("w", .25)), 1.0)
        if opt.get("level"):
            quick = np.where(is_noisy[:, :, None], self.quick - estimate[:, None], observation.relative_estimates)
            raw = np.where(live & sources, quick, 0.0).sum(axis=1) / np.maximum((live & sources).sum(axis=1), 1)
        else:
            raw = np.where(live & sources, observation.relative_estimates, 0.0).sum(axis=1) / np.maximum((live & sources).sum(axis=1), 1)
        quick = w * raw
        belief = copy
        aim = np.where(opt.get("aim", False) | closes | (width > 0), belief, quick)
        stated = np.where(is_noisy & closes, belief, quick)
        copy = np.where(own.is_probe | is_own, 0.0, stated)
        aim = np.where(own.is_probe | is_own, 0.0, aim)
        planned = copy + with_own(none, own.response(aim), own.blocks)
        doubt = self._doubt(own, was.doubt, steps)

        here = reactions.reckoned_estimate(estimate, was.reckoned, steps)
        planes = was.planes
        if isinstance(planes, reactions.Planes) and not is_noisy.all():
            learned = reactions.learned_planes(observation, messages, planes, steps, here, layout)
            planes = chosen(~is_noisy, learned, planes)
            solves = ~is_noisy & (broke > 0) & (steps >= C.start)
            if solves.any():
                joint, counts = reactions.joint_solution(observation.player, planes, here, here + planned, own, doubt, layout)
                planned = np.where(solves & counts, joint - here, planned)

        shake = np.where((left <= np.maximum(.5, 1.5 * observation.theta)) | ~is_own, 0.0, width) * filters.dither(steps)
        displacement = planned + shake
        sent = within_reach(displacement, observation, layout)
        inputs = (sent / step_length(observation)).astype(np.float32)
        last = own.remembered(observation, displacement, layout)
        fresh = State(steps + 1, last, met, seen, planes, doubt, broke, here + inputs * observation.theta)
        return per_step(displacement, observation), self._memory.pack(fresh)

    def _doubt(self, own, was, steps):
        block = own_block(own.model.rows, own_places(own.blocks, own.model, self.layout.dimension))
        curvature = np.maximum(np.abs(block.diagonal(axis1=1, axis2=2)), C.smallest_curvature)
        error = own.error / curvature.min(axis=1, keepdims=True)
        return np.where(steps <= C.start, 0.0, np.maximum(C.fade * was, error))
