"""The residual coder: the relay among players who say in code what the channel would drown."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np

from ptne_env.laws.base import RecordLaw, per_step
from ptne_env.laws.relay import Relay
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray

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
    alone: FloatArray  # the step from which the player follows relay, infinite while it talks, shape (R, 1)
    error: FloatArray  # the largest error of plain messages so far, -1 while none is known, shape (R, 1)
    sent: FloatArray  # the estimates that the last input asked for, shape (R, n)
    meant: FloatArray  # z, the estimates as they are meant, shape (R, n)
    gradient: FloatArray  # the own gradient there, shape (R, n)
    live: FloatArray  # whether both messages of the round have arrived, shape (R, D)
    plain: FloatArray  # the plain message of the round, shape (R, D, n)
    heard: FloatArray  # what the last round told, shape (R, D, n)
    relay: FloatArray  # the memory of relay, shape (R, size)


class ResidualCoder(RecordLaw):
    """A relay among players who tell each other small digits in code, which makes them large.

    A round has two steps. In the first the estimates are z, in the second A (z mod g), which fills the range: who knows
    z to g/2 then knows it A times as well as the channel says it. After the round relay moves z by what was
    told. The sign of code, which alternates over places and rounds, shows that it is code, and which A. A player uses
    the large A where the errors that it hears are small. Otherwise z rests for three rounds with A, A² and A³.

    Only estimates of others carry code: the own strategy is z, and is told in the place of another component, in every
    cycle of rounds another one. In the first rounds z rests. A player gives up for good, and follows relay,
    where messages are exact or too wrong, a neighbour tells no code, or its inputs do not reach; its neighbours follow.

    Args:
        layout: the layout of the environment, with the interface ``physical``.

    Raises:
        LayoutError: for another interface.
    """

    needs: ClassVar[tuple[str, ...]] = ("own_estimate",)

    def __init__(self, layout: ObservationLayout) -> None:
        super().__init__(layout)
        _, self.end, step, first = layout.largest_clock
        self.relay, dims = Relay(layout), max(layout.action_dims)
        self.most = _FILL * min(layout.message_range, layout.action_bound * step / 2)
        self.centre, self.span = self.most * (1 + _GAP) / 2, self.most * (1 - _GAP)
        cycle = 2 * _LEVELS
        self.begin = cycle * ((layout.dimension + 2 * dims + 6) // cycle + 1)
        talks = first * _FEWEST * self.begin <= 1 and 2 * dims <= layout.dimension
        none, estimates = np.zeros((1, 1)), np.zeros((1, layout.dimension))
        messages = np.zeros((1, layout.slots, layout.dimension))
        self.start = CoderMemory(
            steps=none,
            alone=none + (np.inf if talks else 0.0),
            error=none - 1,
            sent=estimates,
            meant=estimates,
            gradient=estimates,
            live=messages[:, :, 0],
            plain=messages,
            heard=messages,
            relay=self.relay.initial_memory(1),
        )

    def inputs(self, observation: Observation, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        was, estimate = self.unpack(memory), observation.own_estimate
        talks, opens, rounds = np.isinf(was.alone), was.steps % 2 == 0, was.steps // 2
        content, arrives = estimate[:, None] + observation.relative_estimates, observation.weights > 0
        now = was._replace(
            meant=np.where(opens, estimate, was.meant),
            gradient=np.where(opens, observation.gradient, was.gradient),
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
        difference = np.where(now.live[:, :, None] > 0, told - now.meant[:, None], 0.0)
        relayed, relay = self.relay.inputs(
            observation._replace(
                own_estimate=np.where(moves, now.meant, estimate),
                relative_estimates=np.where(moves[:, :, None], difference, observation.relative_estimates),
                weights=np.where(moves, observation.weights * now.live, observation.weights),
                gradient=np.where(moves, now.gradient, observation.gradient),
            ),
            was.relay,
        )
        meant = now.meant + np.where(moves, relayed * observation.theta, 0.0)
        codes = talks & opens & (self.end - observation.transformed > 1.5 * observation.theta)
        sent = np.where(codes, self._encode(observation.player, now, rounds), meant)
        inputs = np.where(follows, relayed, per_step(sent - estimate, observation))
        relay = np.where(follows | moves, relay, was.relay)
        fresh = now._replace(steps=was.steps + 1, alone=alone, sent=sent, meant=meant, relay=relay)
        return inputs, self.pack(fresh)

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
