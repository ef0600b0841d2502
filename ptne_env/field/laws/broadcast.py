"""Identify and broadcast: estimates that carry coded equations, and then residuals. A coded law, not an honest one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from ptne_env.field.laws.best_response import UNLIMITED, own_block, with_own, within_reach
from ptne_env.field.laws.relay import Relay, relay_displacement
from ptne_env.laws.base import per_step
from ptne_env.perception.observation import Interface, Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, require_probability

_CHECKS = 2
"""Checksums after the n coefficients and the constant of an equation."""

_UNIT = 64.0
"""Strategies per unit of a sent constant, so that estimates that carry code stay small: they move exactly."""

_MISMATCH = 2e-4
"""Largest error of a checksum, relative to 1 + the largest entry; float32 messages stay far below."""

_SINGULAR = 1e-9
"""Ratio of singular values of an own block below which it counts as singular."""

_SIGN_BITS = 16
"""κ is the solution's largest component, rounded down to a power of two, divided by two to this power."""

_SILENT = 1e-3
"""A payload below this share of κ is 0."""

_PATIENCE = 4
"""Equations sent in vain, after which a player that received none gives up the code."""

_STILL = 1e-5
"""A message that changed by less than this, relative to half the largest own estimate or ½, is the message before."""

_IN_PLACE = 1e-5
"""Distance from the solution, relative to its largest component, within which a player has arrived there."""

_FINISH = 0.9
"""Share of the deadline at which the code ends, early enough for a relay to average noise and to bring late news."""

LARGEST_CODE = 24
"""Largest n for which equations are sent: a neighbour needs n + 3 steps for them, a player n² numbers."""


def with_checksums(equations: FloatArray) -> FloatArray:
    """Equations (..., n + 1) with two checksums, Σ_l cos(l) e_l and Σ_l sin(l) e_l, l from 1: shape (..., n + 3).

    The weights are irrational, so rounded entries do not have rounded checksums.
    """
    angles = np.arange(1.0, equations.shape[-1] + 1)
    sums = [np.add.reduce(equations * weights, axis=-1) for weights in (np.cos(angles), np.sin(angles))]
    return np.concatenate([equations, np.stack(sums, axis=-1)], axis=-1)


def is_intact(codes: FloatArray) -> BoolArray:
    """Whether codes (..., n, n + 3) are equations that were sent, shape (..., n): checksums, and 1 on the diagonal."""
    n = codes.shape[-2]
    error = np.abs(with_checksums(codes[..., : n + 1]) - codes).max(axis=-1)
    diagonal = np.abs(np.einsum("...cc->...c", codes[..., :n]) - 1)
    return (error <= _MISMATCH * (1 + np.abs(codes).max(axis=-1))) & (diagonal <= _MISMATCH)


def own_equations(
    rows: FloatArray, gradient: FloatArray, estimate: FloatArray, blocks: IntArray
) -> tuple[FloatArray, BoolArray]:
    """The own equations G_ii⁻¹ (G x − g) = 0, with g = G x^i − ∂J_i/∂x_i(x^i), and whether G_ii is regular.

    Args:
        rows: G, shape (R, m, n).
        gradient: ∂J_i/∂x_i(x^i), 0 where padded, shape (R, m).
        estimate: x^i, shape (R, n).
        blocks: own components, padded with n, shape (R, m).

    Returns:
        Each equation in the place of its component, 0 elsewhere: n coefficients and the constant in units of 64, shape
        (R, n, n + 1). Whether they exist, shape (R, 1).
    """
    own = own_block(rows, blocks)
    sizes = np.linalg.svd(own, compute_uv=False)
    exist = sizes[:, -1:] > _SINGULAR * sizes[:, :1]
    constant = np.einsum("rmn,rn->rm", rows, estimate) - gradient
    system = np.concatenate([rows, constant[:, :, None] / _UNIT], axis=2)
    solved = np.linalg.solve(np.where(exist[:, :, None], own, np.eye(blocks.shape[1])), system)
    return with_own(np.zeros((len(rows), rows.shape[2], rows.shape[2] + 1)), solved, blocks), exist


def inverses(own: FloatArray) -> FloatArray:
    """Pseudoinverses of own blocks, (R, m, m)."""
    result: FloatArray = np.zeros_like(own)
    if own.shape[1] > 1:
        result[:] = np.linalg.pinv(own)
    else:
        np.divide(1.0, own, out=result, where=own != 0)
    return result


def solution(equations: FloatArray, values: FloatArray, wanted: BoolArray) -> FloatArray:
    """The solutions x of E x = v, least squares if E is singular; 0 where they are not wanted.

    Args:
        equations: E and constants, shape (R, n, n + 1).
        values: v, shape (R, n).
        wanted: shape (R, 1).
    """
    result, rows = np.zeros_like(values), np.flatnonzero(wanted)
    if rows.size:
        result[rows] = np.einsum("rab,rb->ra", np.linalg.pinv(equations[rows, :, :-1]), values[rows])
    return result


def receive(observation: Observation, memory: Mapping[str, FloatArray], place: FloatArray) -> dict[str, FloatArray]:
    """The codes and equations after the messages of this step, phase 2 of :class:`IdentifyAndBroadcast`.

    Of the neighbours' entries for a component the largest counts, since a player sends 0 where it knows nothing.

    Args:
        observation: of R players.
        memory: its parts ``codes``, ``equations`` and ``knows``.
        place: of the entry that messages carry; negative while they carry none, shape (R, 1).
    """
    messages = observation.own_estimate[:, None] + observation.relative_estimates
    messages = np.where((observation.weights > 0)[:, :, None], messages, 0.0)
    loudest = np.abs(messages).argmax(axis=1)[:, None]
    entries = np.take_along_axis(messages, loudest, axis=1)[:, 0]
    codes = memory["codes"]
    codes = np.where(np.arange(codes.shape[2]) == place[:, :, None], entries[:, :, None], codes)
    unknown = (memory["knows"] == 0) & (place >= 0)
    learns, rows = np.zeros_like(unknown), np.flatnonzero(unknown.any(axis=1))
    learns[rows] = is_intact(codes[rows]) & unknown[rows]
    equations = np.where(learns[:, :, None], codes[:, :, :-_CHECKS], memory["equations"])
    return {"codes": codes, "equations": equations, "knows": np.where(learns, 1.0, memory["knows"])}


def resolve(
    observation: Observation,
    memory: Mapping[str, FloatArray],
    residual: FloatArray,
    own: BoolArray,
    nearer: BoolArray,
    ends: BoolArray,
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """The moves of phase 3 of :class:`IdentifyAndBroadcast`: to the solution, then rest and payload in turn.

    Args:
        observation: of R players.
        memory: its parts; with ``target``, the solution of all equations, or 0 where that is not known.
        residual: of the own equations at x^i, 0 elsewhere, shape (R, n).
        own: whether a component is the player's own, shape (R, n).
        nearer: whether a neighbour is nearer to the owner of a component, shape (R, D, n).
        ends: whether no payload is sent any more, shape (R, 1).

    Returns:
        The displacements, shape (R, n), and the changed parts of the memory.
    """
    estimate, relative, target = observation.own_estimate, observation.relative_estimates, memory["target"]
    live, is_even = observation.weights > 0, memory["steps"] % 2 == 0
    coefficients = memory["equations"][:, :, :-1]
    size = np.abs(target).max(axis=1, keepdims=True)
    sign = np.exp2(np.floor(np.log2(np.maximum(size, _SINGULAR))) - _SIGN_BITS)  # κ, the same for all players
    close = np.abs(estimate - target).max(axis=1, keepdims=True) <= _IN_PLACE * size
    arrived = (size > 0) & ((memory["arrived"] > 0) | close)

    # The step before was one of payload; then every component of a neighbour's payload is 0 or κ + ρ_c.
    before = memory["payload"]
    reads = ~is_even & (before != 0).any(axis=1, keepdims=True)
    payloads = relative - memory["at_rest"] + before[:, None]
    is_signed = np.abs(payloads - sign[:, :, None]) < sign[:, :, None] / 2
    is_clean = (is_signed | (np.abs(payloads) < _SILENT * sign[:, :, None])).all(axis=2) & reads
    is_clean &= live & (memory["at_rest_live"] > 0)
    offers = payloads - sign[:, :, None] - np.einsum("rcm,rdm->rdc", coefficients, memory["at_rest"])
    wanted = is_signed & is_clean[:, :, None] & (nearer | (memory["has"] == 0)[:, None]) & ~own[:, None]
    chosen = np.where(wanted, 1 + nearer, 0).argmax(axis=1)[:, None]
    gets = wanted.any(axis=1)
    residuals = np.where(gets, np.take_along_axis(offers, chosen, axis=1)[:, 0], memory["residuals"])
    has = np.where(gets, 1.0, memory["has"])
    correction = solution(memory["equations"], -residuals, reads & (has > 0).all(axis=1, keepdims=True))
    residuals = residuals + np.einsum("rcm,rm->rc", coefficients, correction)

    rests = is_even & arrived
    residuals = np.where(rests & own, residual, residuals)
    has = np.where(rests & own, 1.0, has)
    sends = rests & ~ends & (has > 0) & (np.abs(residuals) < sign / 2)
    payload = np.where(sends, sign + residuals, 0.0)
    displacement = np.where(arrived, payload, target - estimate)
    return np.where(reads, correction - before, displacement), {
        "arrived": arrived.astype(np.float64),
        "residuals": residuals,
        "has": has,
        "payload": payload,
        "at_rest": np.where(rests[:, :, None], relative, memory["at_rest"]),
        "at_rest_live": np.where(rests, live, memory["at_rest_live"]),
    }


class IdentifyAndBroadcast(Relay):
    """Identification of the own equations, their broadcast through the estimates, and a broadcast of the residuals.

    The estimates are no beliefs but carry code, so tables show this law apart from honest laws. All players count the
    same steps k.

    1. For n + 3 steps a player moves its estimates, first one component after the other, and so identifies its own
       rows of dF and from them its own equations, E_c x = e_c with E_cc = 1 for each own component c. If the rows do
       not predict the last three own gradients, the game is not affine.
    2. Then its estimate of component c carries entry k mod (n + 3) of the equation of c, or 0 where it does not know
       it: n coefficients, the constant, two checksums, :func:`receive`. All players repeat the equations that they
       know. A received equation is known as soon as its checksums agree.
    3. From ``switch`` T on, a player that knows all equations moves to their solution, which is as exact as float32
       messages, and then alternates rest and payload, :func:`resolve`. At rest its own gradient shows the
       residuals of its own equations to float32's *relative* accuracy. Then it displaces its estimates of all
       components c of which it knows the residual ρ_c at its own place by κ + ρ_c for one step. A neighbour at
       the distance δ reads ρ_c − E_c δ from that, the residual at its own place. A player that knows all residuals
       moves by the solution of E Δ = −ρ.
    4. From 0.9 T on, all players act as :class:`~ptne_env.field.laws.relay.Relay`.

    Noisy, rounded or late messages, and those of players that follow another law, fail the checksums. A player acts as
    :class:`~ptne_env.field.laws.relay.Relay` for the rest of the episode if a neighbour moves in phase 1 as this law does
    not (which the neighbours of the player see in turn), if its game is not affine, if it has received no
    equation in the time of four, if a message repeats where every code differs from the one before (so the channel
    holds old messages), or if ``switch`` T passes and it lacks an equation. In games of more than 24 components this
    law is :class:`~ptne_env.field.laws.relay.Relay` from the start.

    Args:
        layout: of the environment, interface ``physical``.
        switch: share of the deadline from which on residuals are sent and not equations, in [0, 1].

    Raises:
        LayoutError: for another interface.
        ValueError: for a parameter out of range.
    """

    interface: ClassVar[Interface] = Interface(graph_knowledge="union", estimates="coded")

    def __init__(self, layout: ObservationLayout, switch: float = 0.65) -> None:
        self._sends_code = layout.dimension <= LARGEST_CODE
        super().__init__(layout)
        self.switch = require_probability("switch", switch)

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        if not self._sends_code:
            return super().inputs(observation, memory)
        parts, sources = self._parts.split(memory), self._fixed_sources[observation.player]
        displacement, fresh = relay_displacement(observation, parts, self.layout, sources, self.averaging)
        coded, fresh = self._coded(observation, parts, parts | fresh)
        is_relay = fresh["is_relay"] > 0
        displacement = np.where(is_relay, displacement, coded)
        fresh["asked"] = within_reach(displacement, observation, self.layout)
        calm = {"least": UNLIMITED, "mark": UNLIMITED, "restless": 0.0}  # code is no noise
        fresh |= {name: np.where(is_relay, fresh[name], value) for name, value in calm.items()}
        return per_step(displacement, observation), self._parts.join(fresh)

    def _coded(
        self, observation: Observation, before: Mapping[str, FloatArray], memory: dict[str, FloatArray]
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        """The displacements (R, n) of phases 1 to 3, and the memory.

        Args:
            observation: of R players.
            before: the parts of the memory before this step.
            memory: the same, with the model of this step.
        """
        layout, n, estimate = self.layout, self.layout.dimension, observation.own_estimate
        blocks, own = layout.own_components[observation.player], layout.own_mask[observation.player]
        live, step, elapsed = observation.weights > 0, before["steps"], before["time"] / layout.deadline
        first, width, parity = n + 3, n + 1 + _CHECKS, np.arange(n) % 2
        resolves, ends = elapsed >= self.switch, elapsed >= _FINISH
        listens = (step > first) & ~resolves

        scale = np.maximum(np.abs(estimate).max(axis=1, keepdims=True), 1.0) / 2
        inwards = np.where(estimate > 0, -scale, scale)
        all_at_once = np.where((parity + step) % 2 == 0, inwards, -inwards / 2)
        probe = np.where(step < n, np.where(np.arange(n) == step, inwards, 0.0), all_at_once)

        # Each part of the law is computed while some player needs it, and changes nothing for the others.
        is_ready = step == first
        exist = np.ones_like(is_ready)
        if is_ready.any():
            equations, exist = own_equations(memory["rows"], memory["gradient"], estimate, blocks)
            memory["equations"] = np.where((is_ready & own)[:, :, None], equations, before["equations"])
            memory["knows"] = np.where(is_ready & own, 1.0, before["knows"])
        place = np.where(listens, (step - 1 - first) % width, -1.0)
        if listens.any():
            memory |= receive(observation, memory, place)
        known = memory["knows"] > 0
        complete = known.all(axis=1, keepdims=True)
        move = np.zeros_like(estimate)
        resolved: dict[str, FloatArray] = {}
        if resolves.any():
            starts = resolves & complete & (before["target"] == 0).all(axis=1, keepdims=True)
            target = solution(memory["equations"], _UNIT * memory["equations"][:, :, -1], starts)
            memory["target"] = np.where(starts, target, before["target"])
            gradients = np.einsum("rab,rb->ra", inverses(own_block(memory["rows"], blocks)), memory["gradient"])
            residual = with_own(np.zeros_like(estimate), gradients, blocks)
            move, resolved = resolve(
                observation, memory | {"steps": step}, residual, own, self._fixed_sources[observation.player], ends
            )
        if not resolves.all():
            entry = ((step - first) % width).astype(np.int64)[:, :, None]
            entries = np.take_along_axis(with_checksums(memory["equations"]), entry, axis=2)[:, :, 0]
            move = np.where(resolves, move, np.where(known, entries, 0.0) - estimate)

        alone = (own | ~known).all(axis=1, keepdims=True)
        memory["silence"] = np.where(alone, before["silence"] + (listens & live.any(axis=1, keepdims=True)), 0.0)
        heard, moves = live & (before["live"] > 0), np.abs(memory["messages"] - before["messages"])
        repeats = (heard & (moves.max(axis=2) <= _STILL * scale)).any(axis=1, keepdims=True)
        others = np.where(np.arange(n) == step[:, :, None] - 1, 0.0, moves)
        strangers = (heard & (others.max(axis=2) > _STILL * scale)).any(axis=1, keepdims=True)
        is_relay = (
            (before["is_relay"] > 0)
            | ((step <= n) & strangers)  # in phase 1 a player that follows this law moves one component after the other
            | ((step > n) & (step <= first) & (memory["failed"] > 0))
            | ((step == first) & ~exist)
            | (memory["silence"] > _PATIENCE * width)
            | ((place == n) & repeats)  # the constant follows a coefficient
            | (resolves & ~complete)
            | (ends & (before["payload"] == 0).all(axis=1, keepdims=True))
        )
        memory |= resolved | {"is_relay": is_relay.astype(np.float64), "time": before["time"] + observation.dt}
        return np.where(step < first, probe, move), memory

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        n, slots = self.layout.dimension, self.layout.slots
        code = {
            "time": (1,),  # in seconds
            "is_relay": (1,),
            "codes": (n, n + 1 + _CHECKS),  # as they come in, entry by entry
            "equations": (n, n + 1),
            "knows": (n,),  # which equations
            "silence": (1,),  # steps with a live link, but without an equation
            "target": (n,),
            "arrived": (1,),
            "residuals": (n,),
            "has": (n,),  # which residuals
            "payload": (n,),
            "at_rest": (slots, n),  # relative estimates
            "at_rest_live": (slots,),
        }
        return super()._shapes() | (code if self._sends_code else {})


class LinkBroadcast(IdentifyAndBroadcast):
    """:class:`IdentifyAndBroadcast` of players that know their own links alone."""

    interface: ClassVar[Interface] = Interface(estimates="coded")

    def _known_sources(self) -> BoolArray:
        return self.layout.neighbour_components
