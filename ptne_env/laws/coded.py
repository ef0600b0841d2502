"""Code as a transport: a wrapper whose players say in code what the channel would drown, around any policy."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import numpy as np

from ptne_env.laws.base import per_step
from ptne_env.perception.observation import Interface, LayoutError, ObservationLayout
from ptne_env.perception.policy import RowPolicy
from ptne_env.shared.arrays import BoolArray, Float32Array, FloatArray, IntArray

_FILL, _GAP = 0.95, 0.1
"""Share of the reach that code fills, and share of that below which there is no code, so that its sign is clear."""

_COARSE, _FINE, _LEVELS = 14.5, 1000.5, 3
"""The two amplifications, and the powers of the first that take turns."""

_FITS, _SURE = 0.45, 0.15
"""Share of a width up to which code may contradict plain messages, and errors up to which the larger gain is used."""

_EXACT, _MISSED = 1e-6, 0.01
"""Shares of the reach: errors that are those of float32, and distances by which inputs do not reach."""

_FEWEST = 5.0
"""Fewest steps for which code pays, in units of the first rounds."""

_WAIT, _ALL = 4, 12
"""Steps after which the neighbours of a player have given up, too, and steps after the first rounds for all of them."""


class CoderMemory(NamedTuple):
    """What R players remember from step to step."""

    steps: FloatArray  # number of steps so far, shape (R, 1)
    alone: FloatArray  # the step from which the player sends no code, infinite while it does, shape (R, 1)
    error: FloatArray  # the largest error of plain messages so far, -1 while none is known, shape (R, 1)
    sent: FloatArray  # the estimates that the last input asked for, shape (R, n)
    meant: FloatArray  # z, the estimates as they are meant, shape (R, n)
    gradient: FloatArray  # the own gradient there, shape (R, m)
    live: FloatArray  # whether both messages of the round have arrived, shape (R, D)
    plain: FloatArray  # the plain message of the round, shape (R, D, n)
    heard: FloatArray  # what the last round told, shape (R, D, n)
    has_acted: FloatArray  # whether the wrapped policy has decided before, shape (R, 1)


class Coded(RowPolicy):
    """A policy whose players tell each other small digits in code, which makes them large.

    A round has two steps. In the first the estimates are z, in the second A (z mod g), which fills the range: who knows
    z to g/2 then knows it A times as well as the channel says it. After the round the wrapped policy decides from what
    was told, and moves z. The sign of code, which alternates over places and rounds, shows that it is code, and which
    A. A player uses the large A where the errors that it hears are small. Otherwise z rests for three rounds with A, A²
    and A³.

    Only estimates of others carry code: the own strategy is z, and is told in the place of another component, in every
    cycle of rounds another one. In the first rounds z rests. A player gives up code for good, and follows the wrapped
    policy in every step, where messages are exact or too wrong, a neighbour tells no code, or its inputs do not reach;
    its neighbours follow.

    Messages are then no estimates, so tables mark such a policy, and rank it apart.

    Args:
        layout: the layout of the environment, with the interface ``physical``.
        policy: the policy to wrap, a law or a network that acts through ``physical``, or what builds it from a layout.

    Raises:
        LayoutError: for another interface, of the layout or of the policy.
    """

    interface: ClassVar[Interface] = Interface("physical")
    sends_code: ClassVar[bool] = True

    def __init__(self, layout: ObservationLayout, policy: Any) -> None:
        if isinstance(policy, type) or not hasattr(policy, "predict"):
            policy = policy(layout)
        for interface in (layout.interface, getattr(policy, "interface", None) or self.interface):
            if interface != self.interface:
                raise LayoutError(f"code needs a policy and a layout of {self.interface}, got {interface}")
        self.layout, self.made_for = layout, {"size": layout.size}
        self.policy: RowPolicy = policy.with_layout(layout)
        _, self.end, step, first = layout.largest_clock
        dims = max(layout.action_dims)
        self.most = _FILL * min(layout.message_range, layout.action_bound * step / 2)
        self.centre, self.span = self.most * (1 + _GAP) / 2, self.most * (1 - _GAP)
        cycle = 2 * _LEVELS
        self.begin = cycle * ((layout.dimension + 2 * dims + 6) // cycle + 1)
        self.talks = first * _FEWEST * self.begin <= 1 and 2 * dims <= layout.dimension

    def _start(self, rows: int) -> CoderMemory:
        """Return the memory of players at the start of an episode."""
        none, estimates = np.zeros((rows, 1)), np.zeros((rows, self.layout.dimension))
        messages = np.zeros((rows, self.layout.slots, self.layout.dimension))
        alone, gradient = none + (np.inf if self.talks else 0.0), np.zeros((rows, max(self.layout.action_dims)))
        slots = messages[:, :, 0]
        return CoderMemory(none, alone, none - 1, estimates, estimates, gradient, slots, messages, messages, none)

    def decide(self, rows: Float32Array, memory: Any, starts: BoolArray, *, deterministic: bool) -> tuple[Any, Any]:
        observation = self.layout.read(rows)
        was, inner = (self._start(len(rows)), None) if memory is None else memory
        if starts.any():
            was = self.select_rows(starts, self._start(len(rows)), was)
        estimate, gradient = observation.own_estimate, self.layout.select(rows, "own_gradient")
        talks, opens, rounds = np.isinf(was.alone), was.steps % 2 == 0, was.steps // 2
        content, arrives = estimate[:, None] + observation.relative_estimates, observation.weights > 0
        now = was._replace(
            meant=np.where(opens, estimate, was.meant),
            gradient=np.where(opens, gradient, was.gradient),
            live=np.where(opens, arrives, arrives * was.live),
            plain=np.where(opens[:, :, None], content, was.plain),
        )
        told, error, understands = self._decode(observation.player, now, rounds, content)
        ends, error = talks & ~opens, np.maximum(was.error, error)
        is_exact = (error >= 0) & (error < _EXACT * self.most)
        missed = np.abs(estimate - was.sent).max(axis=1, keepdims=True) > _MISSED * self.most
        fails = ends & (is_exact | missed | ~understands)
        alone = np.where(fails, np.maximum(was.steps + _WAIT, self.begin + _ALL), was.alone)
        now = now._replace(error=np.where(ends, error, was.error), heard=np.where(ends[:, :, None], told, was.heard))

        follows = was.steps >= was.alone
        moves = ends & ~fails & (was.steps >= self.begin) & (self._is_fine(now) | (rounds % _LEVELS == _LEVELS - 1))
        acts, moved = (follows | moves)[:, 0], np.zeros_like(estimate)
        if acts.any():
            difference = np.where(now.live[:, :, None] > 0, told - now.meant[:, None], 0.0)
            meant = {
                "own_estimate": now.meant,
                "own_gradient": now.gradient,
                "relative_estimates": difference.reshape(len(rows), -1),
                "weights": observation.weights * now.live,
            }
            seen = rows.copy()
            for name, values in meant.items():
                part = self.layout.slices[name]
                seen[:, part] = np.where(moves, values, seen[:, part])
            actions, after = self.policy.predict(seen, inner, was.has_acted[:, 0] == 0, deterministic)
            inner = after if inner is None else self.policy.select_rows(acts, after, inner)
            moved = np.where(acts[:, None], actions * observation.theta, 0.0)
        intended = now.meant + np.where(moves, moved, 0.0)
        codes = talks & opens & (self.end - observation.transformed > 1.5 * observation.theta)
        sent = np.where(codes, self._encode(observation.player, now, rounds), intended)
        displacement = np.where(follows, moved, sent - estimate)
        fresh = now._replace(
            steps=was.steps + 1,
            alone=alone,
            sent=sent,
            meant=intended,
            has_acted=np.maximum(was.has_acted, acts[:, None]),
        )
        return self.layout.write(per_step(displacement, observation), observation), (fresh, inner)

    def _places(self, players: IntArray, rounds: FloatArray, is_fine: BoolArray) -> IntArray:
        """Return the component that each place of code tells, -1 at own places; (...) and (..., 1) to (..., n)."""
        own, dims = self.layout.own_mask[players], np.array(self.layout.action_dims)[players][..., None]
        others = np.maximum((~own).sum(axis=-1, keepdims=True), 1)
        turns = np.where(is_fine, rounds, rounds // _LEVELS).astype(np.int64)
        turn = (np.cumsum(~own, axis=-1) - 1 - turns) % others
        told = np.where(turn < dims, np.argmax(own, axis=-1)[..., None] + turn, np.arange(self.layout.dimension))
        return np.where(own, -1, told)

    def _is_fine(self, now: CoderMemory) -> BoolArray:
        """Return whether errors allow the larger amplification, shape (R, 1)."""
        return (now.error <= _SURE * self.span / _FINE) & ((now.error >= 0) | (now.steps >= self.begin))

    def _scale(self, rounds: FloatArray, is_fine: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the sign of code at each place, its amplification, and the width of what it tells."""
        gain = np.where(is_fine, _FINE, _COARSE ** (1 + rounds % _LEVELS))
        return 1.0 - 2.0 * ((np.arange(self.layout.dimension) + rounds + is_fine) % 2), gain, self.span / gain

    def _encode(self, player: IntArray, now: CoderMemory, rounds: FloatArray) -> FloatArray:
        """Return the estimates that tell z in code, shape (R, n)."""
        is_fine = self._is_fine(now)
        places, (sign, gain, width) = self._places(player, rounds, is_fine), self._scale(rounds, is_fine)
        told = np.take_along_axis(now.meant, np.maximum(places, 0), axis=1)
        return np.where(places >= 0, sign * (self.centre + gain * _fold(told, width)), now.meant)

    def _decode(
        self, player: IntArray, now: CoderMemory, rounds: FloatArray, code: FloatArray
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return what a round told (R, D, n), the largest error of plain messages, and whether all was code (R, 1)."""
        slots, rounds = np.array(self.layout.neighbours)[player], rounds[:, :, None]
        least = np.where(self.layout.own_mask[slots], -np.inf, _GAP * self.most / 2)
        signed = self._scale(rounds, np.zeros_like(rounds, dtype=np.bool_))[0] * code
        is_coarse, is_fine = ((sign * signed > least).min(axis=2, keepdims=True) for sign in (1, -1))
        places, (sign, gain, width) = self._places(slots, rounds, is_fine), self._scale(rounds, is_fine)
        widest = self.span / np.where(is_fine, _FINE, _COARSE)
        place = np.full((*places.shape[:2], places.shape[2] + 1), -1)  # one more, into which own places fall
        np.put_along_axis(place, places % place.shape[2], np.arange(places.shape[2])[None, None], axis=2)
        place = place[:, :, :-1]
        residual = np.take_along_axis((sign * code - self.centre) / gain, np.maximum(place, 0), axis=2)
        is_near = np.abs(now.heard - now.plain) <= _FITS * widest
        base = np.where(is_near & (width < widest), now.heard, now.plain)
        heard = base + _fold(residual - base, width)
        is_still = np.abs(heard - now.heard) <= 2 * now.error[:, :, None] / gain
        heard = np.where(is_still, now.heard, heard)  # what moves no more than errors do rests
        error, is_first = np.abs(heard - now.plain), width == widest
        knows, owners = (now.live[:, :, None] > 0) & (is_coarse | is_fine), self.layout.neighbour_components[player]
        fits = error <= _FITS * widest
        known = np.where(place >= 0, np.where(fits, heard, now.plain), np.where(is_near, now.heard, now.plain))
        fails = (now.live[:, :, None] > 0) & ~(is_fine | (is_coarse & (fits | ~owners | ~is_first)))
        largest = np.where(knows & owners & is_first, error, -1.0).max(axis=(1, 2))[:, None]
        return np.where(knows, known, now.plain), largest, ~fails.any(axis=(1, 2))[:, None]


def _fold(values: FloatArray, width: FloatArray) -> FloatArray:
    """Return the values less the nearest multiple of a width, within ±width/2."""
    return values - width * np.round(values / width)
