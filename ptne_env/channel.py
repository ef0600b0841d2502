"""What happens to a message on the way? Noise, delay, loss, quantisation and asymmetry, link by link.

In every step the sender j puts its estimate x^j on each of its live links. A channel turns the sequence of these
messages into what the receiver i hears: in every step a value per component, whether anything is heard at all, and the
weight a_ij that it gives to it. Observations hold (what was received) − x^i and these weights, and nothing else of x^j.

A channel is one stage or a :class:`Chain` of stages, each fed with what comes out of the one before. Below, v is what a
stage is fed on a link (i, j) in step k, y what it puts out, σ a parameter, ξ ~ N(0, 1) and U ~ U(0, 1) independent over
episodes, stages, steps, directed links and (for noise) components. Before the start a stage was fed what it is fed at
the start, and its receivers hold that.

Random numbers are hashes of an episode's key and of what they are for (:mod:`ptne_env.counter_random`), so they are the same
whatever a policy does and however many environments there are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from ptne_env import counter_random
from ptne_env.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    replaced,
    require_count,
    require_non_negative,
    require_positive,
)
from ptne_env.counter_random import CounterArray

Gap: TypeAlias = Literal["hold", "drop"]
"""What a receiver does when nothing comes: ``hold`` the last message received, or ``drop`` the link for the step."""

Target: TypeAlias = Literal["message", "difference"]
"""What is quantised: the ``message`` x^j, or the ``difference`` x^j − x^i that the receiver measures."""

Memory: TypeAlias = tuple[Any, ...]
"""What a channel remembers: arrays with environments last, and tuples of them."""


@dataclass(frozen=True)
class Messages:
    """What is on the links in one step. Neighbour slots first and environments last; never changed.

    Attributes:
        values: per slot, component and receiver, shape (D, n, N, B).
        live: whether the receiver hears anything on the link, shape (D, N, B).
        weights: a_ij, shape (D, N, B).
        own: the receivers' own estimates x^i, shape (n, N, B).
    """

    values: FloatArray
    live: BoolArray
    weights: FloatArray
    own: FloatArray


class LinkNoise:
    """The random numbers of one stage in one step, each a function of what it is for.

    Args:
        keys: one per environment, shape (B,).
        step: index of the step, shape (B,).
        senders: player in each neighbour slot, shape (D, N).
        dimension: n.
    """

    def __init__(self, keys: CounterArray, step: IntArray, senders: IntArray, dimension: int) -> None:
        self._keys = keys
        self._step = step
        self._senders = senders
        self._dimension = dimension

    def stage(self, index: int) -> LinkNoise:
        """The link_noise of stage ``index`` of a chain, independent of all others."""
        return LinkNoise(counter_random.child_keys(self._keys, index), self._step, self._senders, self._dimension)

    def uniforms(self, purpose: int = 0) -> FloatArray:
        """U(0, 1) per directed link, shape (D, N, B); another ``purpose`` gives other numbers."""
        return counter_random.uniforms(self._base(purpose), self._links()[:, :, None])

    def normals(self, purpose: int = 0) -> FloatArray:
        """N(0, 1) per component and directed link, shape (D, n, N, B); another ``purpose`` gives other numbers."""
        components = np.arange(self._dimension, dtype=np.uint64)
        numbers = self._links()[:, None, :] * np.uint64(self._dimension) + components[:, None]
        return counter_random.normals(self._base(purpose), numbers[..., None])

    def _links(self) -> CounterArray:
        """The number i N + j of each link, which is the same in every slot; shape (D, N)."""
        players = self._senders.shape[1]
        return (np.arange(players) * players + self._senders).astype(np.uint64)

    def _base(self, purpose: int) -> CounterArray:
        """A key per environment for this purpose and step, shape (B,)."""
        return counter_random.words(counter_random.child_keys(self._keys, purpose), self._step.astype(np.uint64))


class Channel(ABC):
    """What happens to messages: a map from what is on the links to what is received, with a memory.

    Attributes:
        is_perfect: whether everything is heard as it was sent.
        is_random: whether two episodes differ.
        largest_weight_factor: what a weight is at most multiplied with.
    """

    is_perfect: bool = False
    is_random: bool = True
    largest_weight_factor: float = 1.0

    @abstractmethod
    def transmit(self, messages: Messages, memory: Memory | None, link_noise: LinkNoise) -> tuple[Messages, Memory]:
        """What comes out in a step, and what the channel remembers of it.

        Args:
            messages: what is put in.
            memory: what :meth:`transmit` returned in the step before; ``None`` in the first one.
            link_noise: the random numbers of the step.
        """


class Chain(Channel):
    """One stage after the other; without any, the perfect channel.

    Args:
        stages: channels, the one that messages enter first in front; chains among them count as their stages.
    """

    def __init__(self, stages: Sequence[Channel] = ()) -> None:
        self.stages: tuple[Channel, ...] = ()
        for stage in stages:
            if not isinstance(stage, Channel):
                raise ValueError(f"the stages of a chain are channels, got a {type(stage).__name__}")
            self.stages += stage.stages if isinstance(stage, Chain) else (stage,)
        self.is_perfect = all(stage.is_perfect for stage in self.stages)
        self.is_random = any(stage.is_random for stage in self.stages)
        self.largest_weight_factor = float(np.prod([stage.largest_weight_factor for stage in self.stages]))

    def transmit(self, messages: Messages, memory: Memory | None, link_noise: LinkNoise) -> tuple[Messages, Memory]:
        """What comes out of the last stage."""
        remembered = []
        for index, stage in enumerate(self.stages):
            before = None if memory is None else memory[index]
            messages, after = stage.transmit(messages, before, link_noise.stage(index))
            remembered.append(after)
        return messages, tuple(remembered)


def perfect() -> Channel:
    """The channel that does nothing: y = v."""
    return Chain()


class AdditiveNoise(Channel):
    """Noise on each message: y = v + σ ξ, ξ per component.

    Args:
        std: σ ≥ 0, in the units of the strategies.
    """

    def __init__(self, std: float) -> None:
        self.std = require_non_negative("std", std)

    def transmit(self, messages: Messages, memory: Memory | None, link_noise: LinkNoise) -> tuple[Messages, Memory]:  # noqa: ARG002 - nothing is remembered
        """Messages with noise."""
        noise = link_noise.normals()
        noise *= self.std
        noise += messages.values
        return replace(messages, values=noise), ()


class MultiplicativeNoise(Channel):
    """Noise in proportion to the relative measurement: y − x^i = (v − x^i)(1 + σ ξ), ξ per component.

    Args:
        std: σ ≥ 0, without a unit.
    """

    def __init__(self, std: float) -> None:
        self.std = require_non_negative("std", std)

    def transmit(self, messages: Messages, memory: Memory | None, link_noise: LinkNoise) -> tuple[Messages, Memory]:  # noqa: ARG002 - nothing is remembered
        """Messages with noise."""
        noise = link_noise.normals()
        noise *= self.std
        noise *= messages.values - messages.own
        noise += messages.values
        return replace(messages, values=noise), ()


class Delay(Channel):
    """Messages that travel for some steps, possibly overtaking each other; the receiver holds what arrived last.

    The message sent in step k arrives in step k + d, d drawn per message uniformly from ``steps``..``longest``. Of
    those that arrive in the same step the one sent last counts. Where d is constant, y_k = v_{k−d}. A link that
    carries nothing in a step, being down or dropped by a stage before, sends nothing, and what arrived earlier is
    held.

    Args:
        steps: the shortest delay, ≥ 0.
        longest: the longest delay; ``steps`` where it is left out, and the delay is constant.

    Raises:
        ValueError: when a delay is no whole number of at least 0, or the longest is shorter than the shortest.
    """

    def __init__(self, steps: int, longest: int | None = None) -> None:
        self.steps = require_count("steps", steps, 0)
        self.longest = require_count("longest", steps if longest is None else longest, self.steps)
        self.is_random = self.longest > self.steps

    def transmit(self, messages: Messages, memory: Memory | None, link_noise: LinkNoise) -> tuple[Messages, Memory]:
        """What arrived last."""
        lags = np.full(messages.live.shape, self.steps)
        if self.is_random:
            lags += (link_noise.uniforms() * (self.longest - self.steps + 1)).astype(np.int64)
        lags[~messages.live] = -1  # never arrives
        if memory is None:
            held, received = messages.values, messages.live
            past, past_lags = (messages.values,) * self.longest, (np.full_like(lags, -1),) * self.longest
        else:
            held, received, past, past_lags = memory
        # Newest first: entry d was sent d steps ago. Tuples of arrays that nobody changes shift for free.
        past, past_lags = (messages.values, *past), (lags, *past_lags)
        held, received = held.copy(), received.copy()
        for age in range(self.longest, self.steps - 1, -1):
            arrives = past_lags[age] == age
            np.copyto(held, past[age], where=arrives[:, None])
            received |= arrives
        last = self.longest
        return replace(messages, values=held, live=received), (held, received, past[:last], past_lags[:last])


class _Losing(Channel):
    """What the channels that lose messages share: what the receiver does then."""

    def __init__(self, gap: Gap) -> None:
        if gap not in get_args(Gap):
            raise ValueError(f"gap is one of {', '.join(map(repr, get_args(Gap)))}, got {gap!r}")
        self.gap: Gap = gap

    def _lose(self, messages: Messages, lost: BoolArray, memory: Memory | None) -> tuple[Messages, Memory]:
        if self.gap == "drop":
            return replace(messages, live=messages.live & ~lost), ()
        held, received = (messages.values, messages.live) if memory is None else memory
        arrives = messages.live & ~lost
        held = np.where(arrives[:, None], messages.values, held)
        received = received | arrives
        return replace(messages, values=held, live=np.where(lost, received, messages.live)), (held, received)


class Loss(_Losing):
    """Messages are lost independently: where U < p, y is the last message received (``hold``) or a_ij = 0 (``drop``).

    Args:
        probability: p in [0, 1].
        gap: ``"hold"`` or ``"drop"``.

    Raises:
        ValueError: when p is no probability, or the gap is unknown.
    """

    def __init__(self, probability: float, gap: Gap = "hold") -> None:
        super().__init__(gap)
        self.probability = _require_probability("probability", probability)

    def transmit(self, messages: Messages, memory: Memory | None, link_noise: LinkNoise) -> tuple[Messages, Memory]:
        """What is not lost."""
        return self._lose(messages, link_noise.uniforms() < self.probability, memory or None)


class BurstLoss(_Losing):
    """Losses in bursts: the chain of Gilbert (1960) and Elliott (1963), one per directed link.

    In every step a good link turns bad with probability p and a bad one good with probability r; then a message is lost
    with probability ``loss_bad`` on a bad and ``loss_good`` on a good link. At the start a link is bad with the
    stationary probability p/(p + r). A burst lasts 1/r steps on average.

    Args:
        to_bad: p in (0, 1].
        to_good: r in (0, 1].
        loss_bad: in [0, 1].
        loss_good: in [0, 1].
        gap: as for :class:`Loss`.

    Raises:
        ValueError: when a number is no probability, p or r is 0, or the gap is unknown.
    """

    def __init__(
        self, to_bad: float, to_good: float, loss_bad: float = 1.0, loss_good: float = 0.0, gap: Gap = "hold"
    ) -> None:
        super().__init__(gap)
        self.to_bad = _require_probability("to_bad", require_positive("to_bad", to_bad))
        self.to_good = _require_probability("to_good", require_positive("to_good", to_good))
        self.loss_bad = _require_probability("loss_bad", loss_bad)
        self.loss_good = _require_probability("loss_good", loss_good)

    def transmit(self, messages: Messages, memory: Memory | None, link_noise: LinkNoise) -> tuple[Messages, Memory]:
        """What is not lost."""
        turn = link_noise.uniforms()
        if memory is None:
            bad = turn < self.to_bad / (self.to_bad + self.to_good)
        else:
            bad = np.where(memory[0], turn >= self.to_good, turn < self.to_bad)
        lost = link_noise.uniforms(purpose=1) < np.where(bad, self.loss_bad, self.loss_good)
        received, held = self._lose(messages, lost, (memory and memory[1]) or None)
        return received, (bad, held)


class _Quantiser(Channel):
    """What quantisers share: of what they take the levels."""

    is_random = False

    def __init__(self, target: Target) -> None:
        if target not in get_args(Target):
            raise ValueError(f"target is one of {', '.join(map(repr, get_args(Target)))}, got {target!r}")
        self.target: Target = target

    def transmit(self, messages: Messages, memory: Memory | None, link_noise: LinkNoise) -> tuple[Messages, Memory]:  # noqa: ARG002 - neither is needed
        """Messages on levels."""
        if self.target == "message":
            return replace(messages, values=self._level(messages.values)), ()
        return replace(messages, values=messages.own + self._level(messages.values - messages.own)), ()

    @abstractmethod
    def _level(self, values: FloatArray) -> FloatArray:
        """The level of each value."""


class UniformQuantiser(_Quantiser):
    """Levels that are evenly spaced: q(z) = Δ round(z/Δ), so |q(z) − z| ≤ Δ/2; y = q(v), or y − x^i = q(v − x^i).

    Args:
        width: Δ > 0, in the units of the strategies.
        target: z is the ``"message"`` v or the ``"difference"`` v − x^i.

    Raises:
        ValueError: when the width is not positive, or the target is unknown.
    """

    def __init__(self, width: float, target: Target = "message") -> None:
        super().__init__(target)
        self.width = require_positive("width", width)

    def _level(self, values: FloatArray) -> FloatArray:
        return np.rint(values / self.width) * self.width


class LogarithmicQuantiser(_Quantiser):
    """Levels ±ρ^m, m whole, and 0: |q(z) − z| ≤ δ|z| with δ = (1 − ρ)/(1 + ρ) (Elia & Mitter 2001, Fu & Xie 2005).

    For z > 0, q(z) = ρ^m with m = ⌊ln(z (1 − δ))/ln ρ⌋, that is ρ^m/(1 + δ) < z ≤ ρ^m/(1 − δ); q(−z) = −q(z) and
    q(0) = 0. y = q(v), or y − x^i = q(v − x^i).

    Args:
        ratio: ρ in (0, 1); close to 1 is fine.
        target: z is the ``"message"`` v or the ``"difference"`` v − x^i.

    Raises:
        ValueError: when the ratio is not in (0, 1), or the target is unknown.
    """

    def __init__(self, ratio: float, target: Target = "message") -> None:
        super().__init__(target)
        self.ratio = require_positive("ratio", ratio)
        if self.ratio >= 1:
            raise ValueError(f"ratio must be a number between 0 and 1, got {ratio!r}")

    def _level(self, values: FloatArray) -> FloatArray:
        sizes = np.abs(values)
        some = sizes >= np.finfo(np.float64).tiny  # what is smaller has no logarithm worth the name, and is 0
        logarithm = np.log(np.where(some, sizes, 1.0) * (2 * self.ratio / (1 + self.ratio)))
        levels = np.exp(np.floor(logarithm / np.log(self.ratio)) * np.log(self.ratio))
        return np.copysign(levels * some, values)


class AsymmetricLinks(Channel):
    """Links that are trusted differently in the two directions: a_ij becomes w_ij a_ij, w_ij ~ U(low, high).

    Drawn per episode and direction, and constant over the episode.

    Args:
        low: ≥ 0.
        high: > low.

    Raises:
        ValueError: when the range is empty or negative.
    """

    def __init__(self, low: float, high: float) -> None:
        self.low, self.high = require_non_negative("low", low), require_positive("high", high)
        if self.low >= self.high:
            raise ValueError(f"AsymmetricLinks needs low < high, got {low!r} and {high!r}")
        self.largest_weight_factor = self.high

    def transmit(self, messages: Messages, memory: Memory | None, link_noise: LinkNoise) -> tuple[Messages, Memory]:
        """Messages with other weights."""
        factors = self.low + (self.high - self.low) * link_noise.uniforms() if memory is None else memory[0]
        return replace(messages, weights=messages.weights * factors), (factors,)


def merged(old: Memory, fresh: Memory, mask: BoolArray) -> Memory:
    """The memory ``old`` with the environments in ``mask`` (B,) replaced by those of ``fresh``, in order."""
    return tuple(
        merged(before, after, mask) if isinstance(before, tuple) else replaced(before, after, mask)
        for before, after in zip(old, fresh, strict=True)
    )


def _require_probability(name: str, value: float) -> float:
    if require_non_negative(name, value) > 1:
        raise ValueError(f"{name} must be a probability, a number between 0 and 1, got {value!r}")
    return float(value)
