"""Laws that weigh what players know: estimation gathers evidence, gates say how far to follow it.

Estimation is fixed: an identified model of the own gradient (:func:`~ptne_env.field.laws.relay.own_side`), fresher copies
(:func:`~ptne_env.field.laws.contacts.contacts`), private means (:mod:`~ptne_env.field.laws.averages`), pushes
(:mod:`~ptne_env.field.laws.pushes`) and the neighbours' reactions (:mod:`~ptne_env.field.laws.reactions`). Each of them proposes a
displacement, and the gates mix the proposals, per component and per neighbour slot. Nothing depends on the number of
players, components or slots, and nothing on a player's index.

The gates of :class:`ObserverRelay` are written by hand; those of
:class:`~ptne_env.learn.size_free.SizeFreePolicy` are answers of a network. Other laws are points among them:
Static, Grounded, Routed and the relays each have gates that give their displacements (tests show it).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ptne_env.field.laws.averages import (
    START,
    Averages,
    Unrest,
    average_parts,
    averages,
    dither,
    lies,
    mature,
    unrest,
    without_liars,
)
from ptne_env.field.laws.best_response import (
    LARGEST_ROW,
    UNLIMITED,
    largest,
    own_block,
    own_entries,
    own_places,
    with_own,
    within_reach,
)
from ptne_env.field.laws.contacts import contradictions
from ptne_env.field.laws.drifting import drift_parts, drifting, initial_timed_covariance, is_surprised, tracked
from ptne_env.field.laws.pushes import observed_push, push_parts
from ptne_env.field.laws.reactions import (
    Condition,
    Reactions,
    initial_covariance,
    joint_solution,
    learned_planes,
    reaction_parts,
    reckoned_estimate,
)
from ptne_env.field.laws.relay import SPREAD, ContactRelay, Own, copy_weight, own_memory, own_side
from ptne_env.field.laws.routed import totals
from ptne_env.field.laws.settling import PARTS as SETTLING_PARTS
from ptne_env.field.laws.settling import Settling, settle, settling
from ptne_env.laws.base import Law, per_step, step_length
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import Array, BoolArray, FloatArray, IntArray, fold

_CLOSING = (0.5, 1.0)
"""The last transformed time before the end of an episode, in which private means are stated: of rounded messages, whose
mean lives on the dither that then stops, and of all others."""

_SETTLED = 20.0
"""A private belief farther from the own estimate than this many times σ_i has not settled."""

_PATIENCE, _DELAY, _FLOOR = 2.0, 30.0, 0.3
"""Noisy copies have the weight max(2/(2 + steps without rest beyond 30), 0.3)²."""

_KEPT = 0.07
"""The weight that copies keep where links break, which evolution of a policy without sizes found."""

_CONVINCING = 20
"""Steps after which a neighbour that contradicts becomes the source."""

_FADE = 0.7
"""The share of the recent error of predictions that is left after a step."""

_SMALLEST_CURVATURE = 1e-3
"""Own curvatures below this count as this, where an error of the own gradient becomes a displacement."""


class SlotEvidence(NamedTuple):
    """Evidence on each message about a component, shapes (R, D, n). Distances are in natural units.

    Attributes:
        live: whether the link is live.
        owner: whether the neighbour owns the component.
        source: whether its copy is fresher, as far as contacts show.
        nearer: 0.
        age: steps since its last message.
        contact: steps of the present contact, 0 where the link is not live.
        relative: x^j − x^i.
        change: of its message from step to step, absolute; 0 where there was none.
        samples: number of its messages in the private mean.
        deviation: its message minus the private mean of its messages, absolute.
        spread: standard deviation of its messages.
        mature: whether its mean counts beside those of sources, :func:`~ptne_env.field.laws.averages.mature`.
        lies: steps in which its statements about the own strategy were far off, less the others.
    """

    live: FloatArray
    owner: FloatArray
    source: FloatArray
    nearer: FloatArray
    age: FloatArray
    contact: FloatArray
    relative: FloatArray
    change: FloatArray
    samples: FloatArray
    deviation: FloatArray
    spread: FloatArray
    mature: FloatArray
    lies: FloatArray


class CellEvidence(NamedTuple):
    """Evidence on each component of a player's estimates, shapes (R, n). Distances are in natural units.

    Attributes:
        own: whether the component is the player's own.
        turn: whether an own component may move; in the first m steps they move one after the other.
        probing: whether these first m steps last, in which the others' estimates rest.
        steps: number of steps so far.
        elapsed: t/T by the player's clock.
        closing: whether the end is near by that clock, at most 1 in s, or 0.5 with rounded messages, or at most one
            step; also after it.
        theta: Θ_k of the coming step.
        scale: the largest own estimate, absolute.
        sources: number of live sources.
        weight: of a copy, :func:`~ptne_env.field.laws.relay.copy_weight`: below 1 where messages do not come to rest, and 0
            in the first m steps.
        restless: steps in which messages have not come to rest.
        damping: of the best response, 1 where responses settle.
        gradient: the own gradient, absolute, 0 for components of others.
        response: the best response to plain copies, absolute, 0 for components of others.
        failed: whether the last prediction of the own gradient failed.
        held: whether a bound holds an own component.
        noise: the smallest change of messages.
        noisy: whether messages carry noise.
        width: the step of rounding, where messages are rounded.
        rounded: whether messages are rounded.
        belief: the private belief minus the own estimate, absolute.
        settled: whether the belief has settled: it is at most 20 σ_i away, or messages are rounded.
        broke: whether a link of the player ever broke.
        correction: joint solution minus plain next estimate, absolute.
        doubt: the largest recent error of the planes in it.
        trusted: whether the joint solution counts.
        push: displacement by the observed push in the coming step, absolute.
        push_steps: steps since the push last changed.
        drifting: whether the game drifts.
    """

    own: FloatArray
    turn: FloatArray
    probing: FloatArray
    steps: FloatArray
    elapsed: FloatArray
    closing: FloatArray
    theta: FloatArray
    scale: FloatArray
    sources: FloatArray
    weight: FloatArray
    restless: FloatArray
    damping: FloatArray
    gradient: FloatArray
    response: FloatArray
    failed: FloatArray
    held: FloatArray
    noise: FloatArray
    noisy: FloatArray
    width: FloatArray
    rounded: FloatArray
    belief: FloatArray
    settled: FloatArray
    broke: FloatArray
    correction: FloatArray
    doubt: FloatArray
    trusted: FloatArray
    push: FloatArray
    push_steps: FloatArray
    drifting: FloatArray


class SlotGates(NamedTuple):
    """Trust in each message about a component, shapes (R, D, n), or broadcast to it.

    Attributes:
        copy: share of the neighbour in the copy, ≥ 0; shares are divided by their sum over live slots.
        mean: share of its private mean in the private belief, ≥ 0, beside samples and variances.
        diffusion: gain κ_j ≥ 0 of Θ_k a_ij (x^j − x^i).
    """

    copy: FloatArray
    mean: FloatArray
    diffusion: FloatArray


class CellGates(NamedTuple):
    """How far each component follows each proposal, shapes (R, n), or broadcast to it.

    Attributes:
        copies: share of the copy, in [0, 1]; components of others.
        track: share of the tracking filter in place of the copy, in [0, 1]; components of others.
        belief: share of the private belief to which the own strategy responds, in [0, 1].
        stated: share of the private belief in the stated estimate, in [0, 1]; components of others.
        flow: gain g ≥ 0 of −Θ_k ∂J_i; own components.
        step: η ≥ 0 of −η ∂J_i; own components.
        response: share of the best response, in [0, 1]; own components.
        joint: share of the joint solution, in [0, 1].
        push: share of the observed push that is compensated, in [0, 1]; own components.
        dither: amplitude of the dither, in steps of rounding, ≥ 0; own components.
    """

    copies: FloatArray
    track: FloatArray
    belief: FloatArray
    stated: FloatArray
    flow: FloatArray
    step: FloatArray
    response: FloatArray
    joint: FloatArray
    push: FloatArray
    dither: FloatArray


class GatedLaw(ContactRelay):
    """Proposals of the estimators, mixed by gates; see :mod:`ptne_env.field.laws.gated`.

    A subclass implements :meth:`gates`. The displacement of a component c of another player is

        Δ_c = (1 − j) [(1 − s) ((1 − f) w Σ_d p_d (x^d_c − x^i_c) + f y_c) + s (b_c − x^i_c)
              + Θ Σ_d κ_d a_id (x^d_c − x^i_c)] + j (z_c − x^i_c)

    with the gates ``copies`` w, ``track`` f, ``stated`` s, ``joint`` j, ``copy`` p_d (divided by their sum) and
    ``diffusion`` κ_d, the displacement y of the tracking filter, the private belief b and the joint solution z. That of
    an own component is

        Δ_c = (1 − j) [ρ r_c − (g Θ + η) ∂J_c + Θ Σ_d κ_d a_id (x^d_c − x^i_c) + δ q φ] + j (z_c − x^i_c) − π v_c Δt

    with the gates ``response`` ρ, ``flow`` g, ``step`` η, ``dither`` δ and ``push`` π, the best response r to the
    displacements of the others, or to the private belief as far as ``belief`` says, the step of rounding q, φ of
    :func:`~ptne_env.field.laws.averages.dither`, and the push v.

    Args:
        layout: of the environment, interface ``physical``.
        patience: as for :class:`~ptne_env.field.laws.relay.ContactRelay`.
        forgetting: as for :class:`~ptne_env.field.laws.relay.ContactRelay`.
    """

    def __init__(self, layout: ObservationLayout, patience: float = 30.0, forgetting: float = 2.0) -> None:
        self._has_rows = layout.dimension <= LARGEST_ROW
        super().__init__(layout, patience, forgetting)

    def sources(
        self, observation: Observation, memory: Mapping[str, FloatArray]
    ) -> tuple[BoolArray, dict[str, FloatArray]]:
        """As those of :class:`~ptne_env.field.laws.relay.ContactRelay`, and neighbours that contradict them for long."""
        sources, fresh = super().sources(observation, memory)
        drift, is_own = memory["asked"], self.layout.own_mask[observation.player]
        steps = contradictions(observation, memory, np.where(is_own, 0.0, drift), sources, is_own)
        met = (self.layout.neighbour_components[observation.player] & (memory["heard"] > 0)[:, :, None]).any(axis=1)
        is_fixed = (memory["broke"] == 0) & (memory["noisy"] == 0)
        convinces = (steps >= _CONVINCING) & (is_fixed & ~met)[:, None]
        sources = np.where(convinces.any(axis=1)[:, None], convinces, sources)
        return sources, fresh | {"contradicted": steps, "source": sources.astype(np.float64)}

    @abstractmethod
    def gates(self, cells: CellEvidence, slots: SlotEvidence) -> tuple[CellGates, SlotGates]:
        """The gates of R players, from evidence on their components and messages; row by row."""

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        layout, slots = self.layout, (self.layout.slots,)
        parts: dict[str, tuple[int, ...]] = dict.fromkeys(("age", "contact"), slots)
        parts |= {"contradicted": (layout.slots, layout.dimension)}
        parts |= {"transformed": (1,), "theta": (1,), "broke": (1,), "doubt": (1,), "reckoned": (layout.dimension,)}
        parts |= (
            SETTLING_PARTS
            | average_parts(layout)
            | push_parts(layout)
            | (reaction_parts(layout) | drift_parts(layout) if self._has_rows else {})
        )
        return super()._shapes() | parts

    def initial_memory(self, rows: int) -> FloatArray:
        """As that of :class:`~ptne_env.field.laws.relay.ContactRelay`, and nothing estimated; shape (R, size)."""
        parts = self._parts.split(super().initial_memory(rows))
        parts["width"][...] = parts["level"][...] = UNLIMITED
        parts["damping"][...] = 1.0
        if self._has_rows:
            parts["plane_covariance"][...] = initial_covariance(self.layout)
            parts["timed_covariance"][...] = initial_timed_covariance(self.layout)
        return self._parts.join(parts)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.follow(observation, memory, *self.judged(observation, memory))

    def judged(self, observation: Observation, memory: FloatArray) -> tuple[Estimates, CellGates, SlotGates]:
        """What R players find out, with the changed parts of their memory, and the gates that they follow."""
        found, cells, slots = self.perceive(observation, memory)
        return found, *self.gates(cells, slots)

    def perceive(self, observation: Observation, memory: FloatArray) -> tuple[Estimates, CellEvidence, SlotEvidence]:
        """The first half of a decision: what R players find out, and the evidence that their gates see."""
        parts = self._parts.split(memory)
        found = self._estimates(observation, parts)
        return found, *evidence(observation, parts, found, self.layout)

    def follow(
        self, observation: Observation, memory: FloatArray, found: Estimates, gates: CellGates, slot_gates: SlotGates
    ) -> tuple[FloatArray, FloatArray]:
        """The second half of a decision: the inputs of R players, and their memory, as :meth:`inputs` answers them."""
        parts = self._parts.split(memory)
        planned = self.mixed(observation, parts, found, gates, slot_gates)
        push = found.memory["push"] * observation.dt
        displacement = np.where(found.is_own, planned - gates.push * push, planned)
        fresh = parts | found.memory | own_memory(found.plain, observation, parts, planned, self.layout)
        fresh |= {"transformed": observation.transformed, "theta": observation.theta}
        fresh["sent"] = within_reach(displacement, observation, self.layout)
        inputs = (fresh["sent"] / step_length(observation)).astype(np.float32)
        fresh["reckoned"] = found.here + inputs * observation.theta
        return per_step(displacement, observation), self._parts.join(fresh)

    def _estimates(self, observation: Observation, memory: Mapping[str, FloatArray]) -> Estimates:
        """All that fixed estimation finds out in this step."""
        plain, is_own = own_side(observation, memory, self.layout), self.layout.own_mask[observation.player]
        own, pull, is_drifting, motion = self._motion(observation, memory, plain)
        sources, fresh = self.sources(observation, memory)
        fresh = fresh | motion
        live = observation.weights > 0
        neighbours = live[:, :, None] & ~is_own[:, None]
        owners = self.layout.neighbour_components[observation.player]
        sources = without_liars(sources & neighbours, neighbours, owners, memory["lies"])
        total, count = totals(observation, sources)
        mean = np.where(is_own, 0.0, total / np.maximum(count, 1))
        weight, heard = copy_weight(observation, memory, mean, self.averaging)
        drift = np.where(own.is_probe, 0.0, weight * mean)
        track = np.zeros_like(drift)
        if is_drifting.any():
            track, motion = tracked(observation, memory, np.where(own.is_probe, 0.0, mean), is_drifting)
            fresh = fresh | motion
        block = own_block(own.model.rows, own_places(own.blocks, own.model, drift.shape[1]))
        curvature = np.maximum(np.abs(block.diagonal(axis1=1, axis2=2)), _SMALLEST_CURVATURE)
        error = own.error / curvature.min(axis=1, keepdims=True)
        doubt = np.where(memory["steps"] <= START, 0.0, np.maximum(_FADE * memory["doubt"], error))
        tempered = settling(own, memory, self.layout.dimension)
        tempered = tempered._replace(expected=tempered.expected + pull)
        response = with_own(np.zeros_like(drift), tempered.response(own, drift), own.blocks)
        here = reckoned_estimate(observation, memory)
        fresh = fresh | heard | settle(observation, memory, tempered, response, fresh["noise"], doubt)
        fresh["doubt"] = doubt
        fresh |= {
            "age": np.where(live, 0.0, memory["age"] + 1),
            "contact": np.where(live, memory["contact"] + 1, 0.0),
            "broke": np.maximum(memory["broke"], ((memory["live"] > 0) & ~live).any(axis=1, keepdims=True)),
        }

        restless, means, changed = self._averages(observation, memory, is_own, fresh["noise"])
        fresh |= changed
        calm = ~(restless.is_noisy | restless.is_rounded)[:, 0]
        before = {**memory, "broke": fresh["broke"]}
        joint, changed = self._reactions(observation, before, own, here, here + drift + response, doubt, calm)
        fresh |= changed

        held = with_own(np.zeros_like(drift), own.held.astype(np.float64), own.blocks) > 0
        residual = np.where(is_own & ~held & (memory["steps"] > 0), own.moved - memory["sent"], 0.0)
        fresh |= observed_push(observation, memory, residual)
        return Estimates(
            plain=plain._replace(radius=own.radius, failed=own.failed),
            own=own,
            is_own=is_own,
            sources=sources,
            weight=weight,
            drift=drift,
            is_drifting=is_drifting,
            track=track,
            settling=tempered,
            response=response,
            held=held,
            here=here,
            unrest=restless,
            means=means,
            joint=joint,
            memory=fresh,
        )

    def _averages(
        self, observation: Observation, memory: Mapping[str, FloatArray], is_own: BoolArray, noise: FloatArray
    ) -> tuple[Unrest, Averages, dict[str, FloatArray]]:
        """Noise and rounding, the private means, and the changed parts of the memory."""
        restless = unrest(observation, memory, noise)
        uneasy = restless.is_noisy | restless.is_rounded
        changed = {name: getattr(restless, name) for name in ("width", "level", "since")}
        changed["noisy"] = restless.is_noisy.astype(np.float64)
        changed["samples"] = np.where(uneasy[:, :, None], memory["samples"], 0.0)
        means = Averages(memory["mean"], changed["samples"], memory["variance"])
        if uneasy.any():
            rows = _rows(uneasy[:, 0])
            part = _Part(memory, rows)
            found, news = averages(_taken(observation, rows), part, restless.is_rounded[rows])
            news["lies"] = lies(found, part, observation.own_estimate[rows], is_own[rows])
            changed |= {name: _with_rows(changed.get(name, memory[name]), rows, each) for name, each in news.items()}
            means = _replaced(means, rows, found)
        return restless, means, changed

    def _reactions(
        self,
        observation: Observation,
        memory: Mapping[str, FloatArray],
        own: Own,
        here: FloatArray,
        planned: FloatArray,
        doubt: FloatArray,
        calm: BoolArray,
    ) -> tuple[Reactions, dict[str, FloatArray]]:
        """The joint solution, which is ``planned`` without one, and the changed parts of the memory."""
        joint = Reactions(planned, np.zeros_like(doubt), np.zeros_like(own.failed))
        if not (self._has_rows and calm.any()):
            return joint, {}
        rows = _rows(calm)
        news = learned_planes(_taken(observation, rows), _Part(memory, rows), self.layout, here[rows])
        changed = {name: _with_rows(memory[name], rows, part) for name, part in news.items()}
        if (solving := calm & (memory["broke"][:, 0] > 0)).any():
            rows = _rows(solving)
            condition = Condition(own.model.rows[rows], own.gradient[rows], own.blocks[rows], doubt[rows])
            planes = _Part({**memory, **changed}, rows)
            found = joint_solution(observation.player[rows], planes, self.layout, here[rows], planned[rows], condition)
            joint = _replaced(joint, rows, found)
        return joint, changed

    def _motion(
        self, observation: Observation, memory: Mapping[str, FloatArray], own: Own
    ) -> tuple[Own, FloatArray, BoolArray, dict[str, FloatArray]]:
        """The own side, its pull and whether the game drifts, and the changed parts of the memory."""
        pull, is_drifting = np.zeros_like(own.gradient), np.zeros_like(own.failed)
        if not self._has_rows:
            return own, pull, is_drifting, {}
        surprised = is_surprised(own, memory)[:, 0]
        parts = {name: memory[name] for name in drift_parts(self.layout)}
        changed = parts | {"pull": pull, "first_dt": np.where(memory["steps"] == 0, observation.dt, parts["first_dt"])}
        if surprised.any():
            rows = _rows(surprised)
            motion, found = drifting(_taken(observation, rows), _Part(memory, rows), _taken(own, rows))
            changed |= {name: _with_rows(changed[name], rows, part) for name, part in found.items()}
            pull, is_drifting = _with_rows(pull, rows, motion.pull), _with_rows(is_drifting, rows, motion.is_drifting)
            if is_drifting.any():
                own = _replaced(own, rows, motion.own)
        return own, pull, is_drifting, changed

    def mixed(
        self,
        observation: Observation,
        memory: Mapping[str, FloatArray],
        found: Estimates,
        gates: CellGates,
        slot_gates: SlotGates,
    ) -> FloatArray:
        """The mixed proposals without the compensation of pushes, in natural units, shape (R, n).

        Args:
            observation: of R players.
            memory: the number of ``steps``, shape (R, 1).
            found: estimates of this step.
            gates: of components.
            slot_gates: of slots.
        """
        is_own, own, estimate = found.is_own, found.own, observation.own_estimate
        live = (observation.weights > 0)[:, :, None]
        relative = observation.relative_estimates
        shares = np.where(live, slot_gates.copy, 0.0)
        total = fold(np.add, shares, axis=1)
        copy = fold(np.add, shares * relative, axis=1) / np.where(total > 0, total, 1.0)
        gains = slot_gates.diffusion * observation.weights[:, :, None]
        diffusion = observation.theta * fold(np.add, np.broadcast_to(gains, relative.shape) * relative, axis=1)

        drift = np.where(is_own, 0.0, (1.0 - gates.track) * gates.copies * copy + gates.track * found.track)
        belief = found.means.belief(slot_gates.mean, estimate + drift) - estimate
        aim = np.where(is_own, 0.0, (1.0 - gates.belief) * drift + gates.belief * belief)
        response = with_own(np.zeros_like(drift), found.settling.response(own, aim), own.blocks)
        descent = (gates.flow * observation.theta + gates.step) * observation.gradient
        width = np.where(found.unrest.width < UNLIMITED, found.unrest.width, 0.0)
        shake = gates.dither * width * dither(memory["steps"])
        mixed = np.where(
            is_own,
            gates.response * response - descent + shake,
            (1.0 - gates.stated) * drift + gates.stated * belief,
        )
        mixed = mixed + diffusion
        return (1.0 - gates.joint) * mixed + gates.joint * (found.joint.point - found.here)

    def at_rest(self, observation: Observation, memory: FloatArray) -> tuple[FrozenGates, FrozenGates]:
        """The law with the gates, sources and model of this step, which it then keeps; without and with extrapolation.

        Args:
            observation: of all N players in order, at rest.
            memory: of all N players.
        """
        judged, steps = self.judged(observation, memory), self._parts.split(memory)["steps"]
        plain, ahead = (FrozenGates(self, steps, *judged, extrapolates=each) for each in (False, True))
        return plain, ahead


class FrozenGates(Law):
    """A :class:`GatedLaw` whose gates, sources and model rest: linear in gradient and differences, without memory.

    Its loop is the linearisation of the gated law at rest, on a graph whose links never broke. Trust regions, probes
    and the drift of the game are left out, as at rest. Players that expect their gradient to go on changing
    (:mod:`~ptne_env.field.laws.settling`) respond to twice the present gradient minus the last: without ``extrapolates``
    they respond to the present gradient once, with it twice.

    Args:
        law: whose displacement it is.
        steps: number of steps so far, shape (N, 1).
        found: estimates of the N players in order.
        gates: of components.
        slot_gates: of slots.
        extrapolates: whether they respond to twice the present gradient.
    """

    def __init__(
        self,
        law: GatedLaw,
        steps: FloatArray,
        found: Estimates,
        gates: CellGates,
        slot_gates: SlotGates,
        *,
        extrapolates: bool = False,
    ) -> None:
        super().__init__(law.layout)
        self._law, self._steps, self._found, self._gates, self._slot_gates = law, steps, found, gates, slot_gates
        self._extrapolates = extrapolates

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        player = observation.player
        found, gates, slot_gates = (_taken(part, player) for part in (self._found, self._gates, self._slot_gates))
        everywhere = np.full((len(player), 1), UNLIMITED)
        own = found.own._replace(
            gradient=own_entries(observation.gradient, found.own.blocks), radius=everywhere, turn=everywhere > 0
        )
        is_ahead = found.settling.is_optimistic & self._extrapolates
        settled = found.settling._replace(expected=np.where(is_ahead, own.gradient, 0.0))
        total, count = totals(observation, found.sources)
        drift = np.where(found.is_own, 0.0, found.weight * total / np.maximum(count, 1))
        point = found.here + with_own(drift, settled.response(own, drift), own.blocks)
        found = found._replace(own=own, settling=settled, joint=found.joint._replace(point=point))
        steps = {"steps": self._steps[player]}
        displacement = self._law.mixed(observation, steps, found, gates, slot_gates)
        return per_step(displacement, observation), memory


class Estimates(NamedTuple):
    """All that fixed estimation found out in a step, for R players.

    Attributes:
        plain: the own side with the model that takes the game for fixed.
        own: the own side.
        is_own: own components, shape (R, n).
        sources: live neighbours with fresher copies, shape (R, D, n).
        weight: of a copy, shape (R, 1).
        drift: the plain displacement of the others' estimates, shape (R, n).
        is_drifting: whether the game drifts, shape (R, 1).
        track: displacements of the others' estimates by the tracking filter, shape (R, n).
        settling: the damping of best responses.
        response: the own strategy's best response to it, 0 for components of others, shape (R, n).
        held: own components that a bound holds, shape (R, n).
        here: the own estimates by dead reckoning, shape (R, n).
        unrest: noise and rounding of messages.
        means: private means.
        joint: the joint solution.
        memory: changed parts of the memory.
    """

    plain: Own
    own: Own
    is_own: BoolArray
    sources: BoolArray
    weight: FloatArray
    drift: FloatArray
    is_drifting: BoolArray
    track: FloatArray
    settling: Settling
    response: FloatArray
    held: BoolArray
    here: FloatArray
    unrest: Unrest
    means: Averages
    joint: Reactions
    memory: dict[str, FloatArray]


def evidence(
    observation: Observation,
    memory: Mapping[str, FloatArray],
    found: Estimates,
    layout: ObservationLayout,
) -> tuple[CellEvidence, SlotEvidence]:
    """The evidence of R players.

    Args:
        observation: of R players.
        memory: before this step, by name.
        found: estimates of this step.
        layout: of the observations.
    """
    player, own, estimate = observation.player, found.own, observation.own_estimate
    live, fresh = observation.weights > 0, found.memory
    both = (live & (memory["live"] > 0))[:, :, None]
    owner = layout.neighbour_components[player].astype(np.float64)
    slots = SlotEvidence(
        live=live[:, :, None].astype(np.float64),
        owner=owner,
        source=found.sources.astype(np.float64),
        nearer=np.zeros((1, 1, 1)),
        age=fresh["age"][:, :, None],
        contact=fresh["contact"][:, :, None],
        relative=observation.relative_estimates,
        change=np.where(both, np.abs(fresh["messages"] - memory["messages"]), 0.0),
        samples=found.means.samples,
        deviation=np.where(live[:, :, None], np.abs(fresh["messages"] - found.means.mean), 0.0),
        spread=np.sqrt(found.means.variance),
        mature=mature(found.means, found.sources, found.is_own, memory["lies"]).astype(np.float64),
        lies=memory["lies"][:, :, None],
    )
    rest = found.means.belief(slots.source, estimate)
    left = layout.largest_clock[1] - observation.transformed
    last_step = 1.5 * _coming_step(observation, memory)  # half a step more against rounding
    blank = np.zeros_like(estimate)
    cells = CellEvidence(
        own=found.is_own.astype(np.float64),
        turn=with_own(blank, own.turn.astype(np.float64), own.blocks),
        probing=own.is_probe.astype(np.float64),
        steps=memory["steps"],
        elapsed=observation.elapsed,
        closing=(left <= np.maximum(np.where(found.unrest.is_rounded, *_CLOSING), last_step)).astype(np.float64),
        theta=observation.theta,
        scale=largest(estimate),
        sources=fold(np.add, found.sources.astype(np.float64), axis=1),
        weight=np.where(own.is_probe, 0.0, found.weight),
        restless=fresh["restless"],
        damping=found.settling.damping,
        gradient=np.abs(observation.gradient),
        response=np.abs(found.response),
        failed=own.failed.astype(np.float64),
        held=found.held.astype(np.float64),
        noise=fresh["noise"],
        noisy=found.unrest.is_noisy.astype(np.float64),
        width=found.unrest.width,
        rounded=found.unrest.is_rounded.astype(np.float64),
        belief=np.abs(rest - estimate),
        settled=(found.unrest.is_rounded | (np.abs(rest - estimate) <= _SETTLED * fresh["noise"])).astype(np.float64),
        broke=fresh["broke"],
        correction=np.abs(found.joint.point - found.here - found.drift - found.response),
        doubt=found.joint.error,
        trusted=found.joint.is_trusted.astype(np.float64),
        push=np.abs(fresh["push"]) * observation.dt,
        push_steps=fresh["push_steps"],
        drifting=found.is_drifting.astype(np.float64),
    )
    return cells, slots


def _coming_step(observation: Observation, memory: Mapping[str, FloatArray]) -> FloatArray:
    """Δs_k = Θ_k − c Δt_k of the coming step, with c = (Θ − Δs)/Δt of the last step, 0 in the first; shape (R, 1)."""
    dt, last = memory["dt"], observation.transformed - memory["transformed"]
    gain = (memory["theta"] - last) / np.where(dt > 0, dt, 1.0)
    return np.where(dt > 0, np.maximum(observation.theta - gain * observation.dt, 0.0), 0.0)


def observed_weight(cells: CellEvidence) -> FloatArray:
    """The weight of copies where noise and rounding are observed, shape (R, 1) or (R, n); else ``cells.weight``."""
    calm = _PATIENCE + np.maximum(cells.restless - _DELAY, 0.0)
    filtered = np.where(cells.damping < 1, 1.0, np.maximum(_PATIENCE / calm, _FLOOR) ** 2)
    return np.where(cells.noisy > 0, filtered, np.where(cells.rounded > 0, 1.0, cells.weight))


class ObserverRelay(GatedLaw):
    """:class:`~ptne_env.field.laws.relay.ContactRelay` with observers of noise, rounding, pushes and reactions.

    Where messages carry noise or are rounded, raw copies travel, and the private belief is stated near the end; where
    messages are rounded, the own strategy responds to it, and is dithered. Observed pushes are compensated. Where the
    game drifts, a tracking filter takes the place of copies, unless links break. Where links break, the joint solution
    is followed as soon as it is trusted. Where the own gradient was not predicted, as in games that are not affine, a
    short gradient step is added: best responses are short while the model changes.
    """

    def gates(self, cells: CellEvidence, slots: SlotEvidence) -> tuple[CellGates, SlotGates]:
        return observer_gates(cells, slots)


def observer_gates(cells: CellEvidence, slots: SlotEvidence) -> tuple[CellGates, SlotGates]:
    """The gates of :class:`ObserverRelay`, of R players."""
    uneasy, rests = np.maximum(cells.noisy, cells.rounded), 1.0 - cells.drifting
    zero = np.zeros_like(cells.scale)
    mine = CellGates(
        copies=np.minimum(observed_weight(cells) + _KEPT * cells.broke, 1.0),
        track=cells.drifting * (1.0 - cells.broke),
        belief=rests * np.maximum(cells.rounded, cells.noisy * cells.closing),
        stated=rests * uneasy * cells.closing * cells.settled,
        flow=zero,
        step=cells.failed * (1.0 - np.maximum(uneasy, cells.broke)) / SPREAD,
        response=cells.turn,
        joint=cells.trusted,
        push=cells.own,
        dither=cells.rounded * (1.0 - cells.closing),
    )
    return mine, SlotGates(
        copy=slots.source, mean=np.maximum(slots.source, 0.5 * slots.mature), diffusion=zero[:, None]
    )


def _rows(mask: BoolArray) -> IntArray | slice:
    """The rows in a mask (R,) as an index; of all rows, one that copies nothing."""
    return slice(None) if mask.all() else np.flatnonzero(mask)


class _Part(dict[str, FloatArray]):
    """Some rows of a memory. Each part is taken when it is read first, because most are not read."""

    def __init__(self, memory: Mapping[str, FloatArray], rows: IntArray | slice) -> None:
        self._memory, self._rows = memory, rows

    def __missing__(self, name: str) -> FloatArray:
        part = self[name] = self._memory[name][self._rows]
        return part


def _taken(part: Any, rows: IntArray | slice) -> Any:
    """The rows of every array in nested tuples; dictionaries are left out."""
    if isinstance(part, tuple):
        return part._make(_taken(each, rows) for each in part)  # type: ignore[attr-defined]  # all are NamedTuples
    return part if isinstance(part, dict) else part[rows]


def _replaced(old: Any, rows: IntArray | slice, fresh: Any) -> Any:
    """Nested tuples of arrays with ``fresh`` in ``rows``, the inverse of :func:`_taken`."""
    if isinstance(old, tuple):
        return old._make(_replaced(before, rows, after) for before, after in zip(old, fresh, strict=True))  # type: ignore[attr-defined]
    return _with_rows(old, rows, fresh)


def _with_rows(array: Array, rows: IntArray | slice, fresh: Array) -> Array:
    if isinstance(rows, slice):  # all of them
        return fresh
    result = array.copy()
    result[rows] = fresh
    return result
