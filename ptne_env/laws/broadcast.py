"""Identify and broadcast: estimates that carry coded equations, and then residuals. A coded law, not an honest one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ptne_env.arrays import BoolArray, FloatArray, require_probability
from ptne_env.laws.base import per_step
from ptne_env.laws.relay import UNLIMITED, Relay, relay_displacement
from ptne_env.observation import Observation, ObservationLayout

_CHECKS = 2
"""Checksums after the n coefficients and the constant of an equation."""

_UNIT = 64.0
"""Strategies per unit of a sent constant, so that estimates that carry code stay small: they move exactly."""

_MISMATCH = 2e-4
"""Largest error of a checksum, relative to 1 + the largest entry; float32 messages stay far below."""

_PATIENCE = 4
"""Equations sent in vain, after which a player that received none gives up the code."""

_STILL = 1e-5
"""A message that changed by less than this, relative to half the largest own estimate, is the one before."""

_FINISH = 0.99
"""Share of the deadline at which the code ends."""

LARGEST_CODE = 24
"""Largest n for which equations are sent: a neighbour needs n + 3 steps for them, a player n² numbers."""


def with_checksums(equations: FloatArray) -> FloatArray:
    """Equations (..., n + 1) with two checksums, Σ_l e_l and Σ_l (l + 1)/(n + 1) e_l: shape (..., n + 3)."""
    places = np.arange(1.0, equations.shape[-1] + 1) / equations.shape[-1]
    sums = [np.add.reduce(equations, axis=-1), np.add.reduce(equations * places, axis=-1)]
    return np.concatenate([equations, np.stack(sums, axis=-1)], axis=-1)


def is_intact(codes: FloatArray) -> BoolArray:
    """Whether codes (..., n, n + 3) are equations that were sent, shape (..., n): checksums, and 1 on the diagonal."""
    n = codes.shape[-2]
    error = np.abs(with_checksums(codes[..., : n + 1]) - codes).max(axis=-1)
    diagonal = np.abs(np.einsum("...cc->...c", codes[..., :n]) - 1)
    return (error <= _MISMATCH * (1 + np.abs(codes).max(axis=-1))) & (diagonal <= _MISMATCH)


def own_equations(
    rows: FloatArray, gradient: FloatArray, estimate: FloatArray, layout: ObservationLayout, player: np.ndarray
) -> tuple[FloatArray, BoolArray]:
    """The own equations G_ii⁻¹ (G x − b) = 0 in the places of the own components, (R, n, n + 1), and their existence.

    An equation is its n coefficients and its constant; that of an own component has the coefficients of a unit vector
    in the own block. They exist where G_ii is certainly regular, shape (R,).
    """
    dimension, blocks = layout.dimension, layout.own_components[player]
    padded, safe = blocks == dimension, np.minimum(blocks, dimension - 1)
    own = np.take_along_axis(rows, safe[:, None, :], axis=2)
    own = np.where(padded[:, :, None] | padded[:, None, :], np.eye(blocks.shape[1]), own)
    sizes = np.linalg.svd(own, compute_uv=False)
    exist = sizes[:, -1] > 1e-6 * np.maximum(sizes[:, 0], 1e-6)
    constant = np.einsum("rmn,rn->rm", rows, estimate) - gradient
    system = np.concatenate([rows, constant[:, :, None] / _UNIT], axis=2)
    solved = np.linalg.solve(np.where(exist[:, None, None], own, np.eye(blocks.shape[1])), system)
    result = np.zeros((len(rows), dimension + 1, dimension + 1))
    np.put_along_axis(result, blocks[:, :, None], solved, axis=1)
    return result[:, :dimension], exist


def solution(equations: FloatArray, residuals: FloatArray) -> FloatArray:
    """Δ with E Δ = −ρ, of equations (R, n, n + 1) and residuals ρ (R, n)."""
    inverse = np.linalg.pinv(equations[:, :, :-1])
    return -np.einsum("rab,rb->ra", inverse, residuals)


class IdentifyAndBroadcast(Relay):
    """Identification of the own equations, their broadcast through the estimates, and a broadcast of the residuals.

    The estimates are no beliefs but carry code, so tables show this law apart from honest ones. All players count the
    same steps k.

    1. For n + 3 steps a player moves its estimates, one component after the other, and so identifies its own rows
       of dF and from them its own equations, normalised to E_c x = e_c with E_cc = 1, for each own component c.
    2. Then its estimates of component c carry entry k mod (n + 3) of the equation of c, 0 where it is unknown: n
       coefficients, the constant and two checksums. Everybody repeats what it knows. An equation counts as known if
       its checksums agree.
    3. From ``switch`` T on, a player that knows all equations moves to their solution, which is as exact as float32
       messages, and from then on alternates a step at rest with a payload step. At rest its own gradient is the
       residual of its own equations to float32's *relative* accuracy. The payload step displaces the estimates of each
       component c of which it knows the residual ρ_c at its own place by κ + ρ_c, and the next step takes that back. A
       neighbour at the distance δ reads off ρ_c − E_c δ, the residual at its own place; if it knows all residuals,
       it moves by the solution of E Δ = −ρ.
    4. From 0.99 T on, everybody acts as :class:`~ptne_env.laws.relay.Relay`.

    Messages that are noisy, rounded, late or from players that act otherwise fail the checksums. A player that received
    no equation in the time of four acts as :class:`~ptne_env.laws.relay.Relay` from then on; so does from ``switch`` T
    on a player that does not know all equations, and from the start every player whose game is not affine or has more
    than 24 components.

    Args:
        layout: of the environment, interface ``physical``.
        spread: as for :class:`~ptne_env.laws.relay.Relay`.
        switch: share of the deadline after which residuals are sent and not equations, in [0, 1].

    Raises:
        ValueError: for a parameter out of range, or another interface.
    """

    def __init__(self, layout: ObservationLayout, spread: float = 10.0, switch: float = 0.65) -> None:
        self.switch = require_probability("switch", switch)
        super().__init__(layout, spread)
        self.is_coded = layout.dimension <= LARGEST_CODE

    def _shapes(self) -> dict[str, tuple[int, ...]]:
        n, slots = self.layout.dimension, self.layout.slots
        if n > LARGEST_CODE:
            return super()._shapes()
        return super()._shapes() | {
            "time": (1,),
            "is_relay": (1,),  # whether the player has given up the code
            "codes": (n, n + 1 + _CHECKS),  # as they come in, one entry per step
            "equations": (n, n + 1),
            "knows": (n,),  # whose equations
            "silence": (1,),  # steps with a live link, while no equation was received
            "arrived": (1,),
            "target": (n,),
            "residuals": (n,),
            "has": (n,),  # whose residuals
            "payload": (n,),
            "at_rest": (slots, n),
            "at_rest_live": (slots,),
        }

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        parts = self._parts.split(memory)
        displacement, fresh = relay_displacement(observation, parts, self.layout, self._nearer, self.spread)
        if self.is_coded:
            coded, own_parts = self._coded(observation, parts, fresh)
            fresh |= own_parts
            is_relay = own_parts["is_relay"] > 0
            displacement = np.where(is_relay, displacement, coded)
            reach = self.layout.action_bound * observation.theta
            blocks = self.layout.own_components[observation.player]
            asked = np.concatenate([np.clip(displacement, -reach, reach), np.zeros_like(reach)], axis=1)
            fresh["asked"] = np.take_along_axis(asked, blocks, axis=1)
            calm = {"least": UNLIMITED, "mark": UNLIMITED, "restless": 0.0}  # codes are no noise
            fresh |= {name: np.where(is_relay, fresh[name], value) for name, value in calm.items()}
        return per_step(displacement, observation), self._parts.join(fresh)

    def _coded(
        self, observation: Observation, parts: Mapping[str, FloatArray], relay: Mapping[str, FloatArray]
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        """The displacements (R, n) while the code is used, and the parts of the memory that belong to it."""
        layout, n = self.layout, self.layout.dimension
        estimate, step = observation.own_estimate, parts["steps"]
        is_own = layout.own_mask[observation.player]
        live = observation.weights > 0
        first, width = n + 3, n + 1 + _CHECKS
        elapsed = parts["time"] / layout.deadline

        # 1. Identification.
        scale = np.maximum(np.abs(estimate).max(axis=1, keepdims=True), 1.0) / 2
        away = np.where(estimate > 0, -scale, scale)
        pattern = np.where((np.arange(n) + step) % 2 == 0, away, -away / 2)
        probe = np.where(step < n, np.where(np.arange(n) == step, away, 0.0), pattern)
        is_relay = (parts["is_relay"] > 0) | ((step > n) & (step <= first) & (relay["failed"] > 0))

        own_gradient = relay["gradient"]
        equations, exist = own_equations(relay["rows"], own_gradient, estimate, layout, observation.player)
        learns = step == first
        is_relay |= learns & ~exist[:, None]
        mine = (learns & is_own)[:, :, None]
        equations = np.where(mine, equations, parts["equations"])
        knows = np.where(learns & is_own, 1.0, parts["knows"])

        # 2. Equations.
        place = (step - 1 - first) % width
        messages = np.where(live[:, :, None], relay["messages"], 0.0)
        loudest = np.abs(messages).argmax(axis=1)[:, None]
        heard = np.take_along_axis(messages, loudest, axis=1)[:, 0]
        listens = (step > first) & (elapsed < self.switch)
        here = listens[:, :, None] & (np.arange(width) == place[:, :, None])
        codes = np.where(here, heard[:, :, None], parts["codes"])
        arrived_now = is_intact(codes) & listens & (knows == 0)
        equations = np.where(arrived_now[:, :, None], codes[:, :, : n + 1], equations)
        knows = np.where(arrived_now, 1.0, knows)
        none = (np.where(is_own, 0.0, knows) == 0).all(axis=1, keepdims=True)
        silence = np.where(none, parts["silence"] + (listens & live.any(axis=1, keepdims=True)), 0.0)
        is_relay |= silence > _PATIENCE * width
        moved = np.abs(messages - parts["messages"]).max(axis=2)
        both = live & (parts["live"] > 0)
        repeats = both & (moved <= _STILL * scale)
        is_relay |= listens & (place == n) & repeats.any(axis=1, keepdims=True)
        sent = with_checksums(equations)
        entry = np.take_along_axis(sent, ((step - first) % width).astype(np.int64)[:, :, None] % width, axis=2)[:, :, 0]
        code = np.where(knows > 0, entry, 0.0) - estimate

        # 3. Residuals.
        resolves = elapsed >= self.switch
        ends = elapsed >= _FINISH
        complete = (knows > 0).all(axis=1, keepdims=True)
        is_relay |= (resolves & ~complete) | (ends & (parts["payload"] == 0).all(axis=1, keepdims=True))
        starts = resolves & complete & (parts["target"] == 0).all(axis=1, keepdims=True)
        target = parts["target"]
        if starts.any():
            rows = np.flatnonzero(starts)
            target = target.copy()
            target[rows] = solution(equations[rows], -_UNIT * equations[rows, :, -1])
        residual, more = self._resolve(observation, parts, equations, target, own_gradient, relay["rows"], ends)
        displacement = np.where(step < first, probe, np.where(resolves, residual, code))
        return displacement, {
            "time": parts["time"] + observation.dt,
            "is_relay": is_relay.astype(np.float64),
            "codes": codes,
            "equations": equations,
            "knows": knows,
            "silence": silence,
            "target": target,
            **more,
        }

    def _resolve(self, observation, parts, equations, target, own_gradient, rows, ends):
        layout, n = self.layout, self.layout.dimension
        estimate, step = observation.own_estimate, parts["steps"]
        live = observation.weights > 0
        is_own = layout.own_mask[observation.player]
        size = np.maximum(np.abs(target).max(axis=1, keepdims=True), 1e-300)
        flag = np.exp2(np.floor(np.log2(size)) - 16)
        active = (target != 0).any(axis=1, keepdims=True)
        close = np.abs(estimate - target).max(axis=1, keepdims=True) <= 1e-5 * size
        settled = parts["arrived"] > 0
        arrived = active & (settled | close)
        is_rest = (step % 2 == 0) & arrived
        is_payload = (step % 2 == 1) & settled & (parts["payload"] != 0).any(axis=1, keepdims=True)

        # At rest: the own residuals, E_c x − e_c = G_ii⁻¹ ∂J_i/∂x_i.
        blocks = layout.own_components[observation.player]
        padded, safe = blocks == n, np.minimum(blocks, n - 1)
        own = np.take_along_axis(rows, safe[:, None, :], axis=2)
        own = np.where(padded[:, :, None] | padded[:, None, :], np.eye(blocks.shape[1]), own)
        measured = np.einsum("rab,rb->ra", np.linalg.pinv(own), own_gradient)
        place = np.zeros((len(rows), n + 1))
        np.put_along_axis(place, blocks, measured, axis=1)
        measured = place[:, :n]
        residuals = np.where(is_rest & is_own, measured, parts["residuals"])
        has = np.where(is_rest & is_own, 1.0, parts["has"])
        relative = observation.relative_estimates
        at_rest = np.where(is_rest[:, :, None], relative, parts["at_rest"])
        at_rest_live = np.where(is_rest, live, parts["at_rest_live"])
        payload = np.where((has > 0) & (np.abs(residuals) < flag / 2), flag + residuals, 0.0)
        payload = np.where(is_rest & ~ends, payload, 0.0)

        # Payload: what the neighbours know.
        sent = relative - parts["at_rest"] + parts["payload"][:, None]
        limit = flag[:, :, None]
        is_flag = np.abs(sent - limit) < limit / 2
        is_none = np.abs(sent) < 1e-3 * limit
        speaks = live & (parts["at_rest_live"] > 0) & (is_flag | is_none).all(axis=2) & is_payload
        offered = is_flag & speaks[:, :, None]
        drift = np.einsum("rcm,rdm->rdc", equations[:, :, :n], parts["at_rest"])
        offers = sent - limit - drift
        nearer = self._nearer[observation.player]
        wanted = offered & (nearer | (has == 0)[:, None]) & ~is_own[:, None]
        rank = np.where(wanted, 1 + nearer, 0)
        chosen = rank.argmax(axis=1)[:, None]
        gets = rank.any(axis=1)
        residuals = np.where(gets, np.take_along_axis(offers, chosen, axis=1)[:, 0], residuals)
        has = np.where(gets, 1.0, has)
        corrects = is_payload & (has > 0).all(axis=1, keepdims=True)
        correction = np.zeros_like(target)
        if corrects.any():
            chosen_rows = np.flatnonzero(corrects)
            correction[chosen_rows] = solution(equations[chosen_rows], residuals[chosen_rows])
            residuals = residuals + np.einsum("rcm,rm->rc", equations[:, :, :n], correction)
        displacement = np.where(arrived, payload, target - estimate)
        displacement = np.where(is_payload, correction - parts["payload"], displacement)
        return displacement, {
            "arrived": arrived.astype(np.float64),
            "residuals": residuals,
            "has": has,
            "payload": payload,
            "at_rest": at_rest,
            "at_rest_live": at_rest_live,
        }
