"""Communication channels: range, noise, delay, loss, rounding and falsehood of messages, link by link.

In every step sender j puts its estimate x^j on each of its live links. From the sequence of these messages a channel
determines, for receiver i in every step, a received value per component, whether a message is present at all, and its
weight a_ij. Observations contain (received value) − x^i and these weights, and no other information on x^j.

A channel is one stage or a :class:`Chain` of stages; the output of each stage is the input of the next. Below, v is the
input of a stage on link (i, j) in step k, y its output, σ a parameter, and ξ ~ N(0, 1) and U ~ U(0, 1) are independent
over episodes, stages, steps, directed links and (for noise) components. Before the start, every stage had the input of
the start, and receivers hold that.

Random numbers are hashes of an episode's key and of their purpose (:mod:`ptne_env.shared.counter_random`). They do not
depend on the policy or on the number of environments.
"""

# ruff: noqa: ARG002 - a stage may ignore arguments of the interface

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np

from ptne_env.shared import counter_random
from ptne_env.shared.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    array_namespace,
    is_numpy,
    require_count,
    require_non_negative,
    require_positive,
    require_positive_probability,
    require_probability,
    round_to_integers,
)
from ptne_env.shared.counter_random import CounterArray
from ptne_env.shared.parts import Part, checked

Memory: TypeAlias = tuple[Any, ...]
"""Memory of a channel: arrays with environments last, and tuples of them."""

Transmitted: TypeAlias = "tuple[Messages, Memory]"
"""Messages received in a step, and the memory for the next step."""


@dataclass(frozen=True)
class Messages:
    """The messages on all links in one step. Neighbour slots first, environments last; never changed in place.

    Attributes:
        values: per slot, component and receiver, shape (D, n, N, B).
        live: whether a message is present on the link, shape (D, N, B).
        weights: a_ij, shape (D, N, B).
    """

    values: FloatArray
    live: BoolArray
    weights: FloatArray


class LinkRandomness(NamedTuple):
    """The random numbers of one stage in one step: noise, losses and delays per directed link.

    Attributes:
        keys: one per environment, shape (B,).
        step: index of the step, shape (B,).
        senders: player in each neighbour slot, shape (D, N).
        owners: player that owns each component, shape (n,).
    """

    keys: CounterArray
    step: IntArray
    senders: IntArray
    owners: IntArray

    def stage(self, index: int) -> LinkRandomness:
        """Return the random numbers of stage ``index`` of a chain, which are independent of all others."""
        return self._replace(keys=counter_random.child_keys(self.keys, index))

    def uniforms(self, purpose: int = 0) -> FloatArray:
        """Draw U(0, 1) per directed link, shape (D, N, B); another ``purpose`` gives other numbers."""
        return self._draw(purpose, self._links())

    def component_uniforms(self, purpose: int = 0) -> FloatArray:
        """Draw U(0, 1) per component and directed link, shape (D, n, N, B); see :meth:`uniforms`."""
        components = np.arange(self.owners.size, dtype=np.uint64)
        return self._draw(purpose, self._links()[:, None, :] * np.uint64(self.owners.size) + components[:, None])

    def normals(self, purpose: int = 0) -> FloatArray:
        """Draw N(0, 1) per component and directed link, the quantiles of :meth:`component_uniforms`."""
        return counter_random.normal_quantiles(self.component_uniforms(purpose))

    def episode_uniforms(self, count: int, purpose: int = 0) -> FloatArray:
        """Draw U(0, 1), the same in every step of an episode, shape (count, B); see :meth:`uniforms`."""
        counters = np.arange(count, dtype=np.uint64)[:, None]
        return counter_random.uniforms(counter_random.child_keys(self.keys, purpose), counters)

    def _links(self) -> CounterArray:
        """The number i N + j of each link, which is the same in every slot; shape (D, N)."""
        players = self.senders.shape[1]
        return (np.arange(players) * players + self.senders).astype(np.uint64)

    def _draw(self, purpose: int, counters: CounterArray) -> FloatArray:
        """Draw U(0, 1) for this purpose and step by the counters (D, …) of each slot, shape (D, …, B)."""
        keys = counter_random.words(counter_random.child_keys(self.keys, purpose), self.step.astype(np.uint64))
        if is_numpy(keys):
            return counter_random.uniforms(keys, counters[..., None])
        # A loop over slots, so that XLA computes the keys before it; otherwise it does so anew for every number.
        draws: FloatArray = sys.modules["jax"].lax.map(partial(counter_random.uniforms, keys), counters[..., None])
        return draws


class Channel(Part, ABC):
    """A map, with memory, from messages sent to messages received."""

    is_perfect: ClassVar[bool] = False
    """Whether every message is received as it was sent."""

    is_random: ClassVar[bool] = True
    """Whether two episodes differ."""

    @abstractmethod
    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        """Return the messages received in a step, and the memory for the next step.

        Args:
            messages: the messages sent.
            memory: the memory that :meth:`transmit` returned in the step before; ``None`` in the first step.
            randomness: the random numbers of the step.
        """


def require_messages(channel: Channel, senders: IntArray, owners: IntArray) -> None:
    """Try each stage of a channel in a world whose ``senders`` (D, N) all say 0.

    Raises:
        ValueError: when it does not return messages and a memory, or messages of another shape, or not finite.
    """
    live = np.ones((*senders.shape, 1), dtype=np.bool_)
    sent = Messages(np.zeros((len(senders), len(owners), *live.shape[1:])), live, live.astype(np.float64))
    randomness = LinkRandomness(np.zeros(1, dtype=np.uint64), np.zeros(1, dtype=np.int64), senders, owners)
    for stage in channel.stages if isinstance(channel, Chain) else (channel,):
        rule = f"{type(stage).__name__}.transmit returns (messages, memory), messages being like those that it gets"
        memory: Memory | None = None
        for _ in range(2):
            answer: Any = stage.transmit(sent, memory, randomness)
            if not (isinstance(answer, tuple) and len(answer) == 2 and isinstance(answer[0], Messages)):
                raise ValueError(f"{rule}; it returned a {type(answer).__name__}")
            received, memory = answer
            for name, expected in vars(sent).items():
                found = np.asarray(getattr(received, name))
                if found.shape != expected.shape or not np.isfinite(found).all():
                    fault = f"the shape {found.shape}, not {expected.shape}" * (found.shape != expected.shape)
                    raise ValueError(f"{rule}; its {name} have {fault or 'entries that are not finite'}")


class Chain(Channel):
    """Stages in sequence; the perfect channel if there are none.

    Attributes:
        stages: channels in the order in which messages pass them; a chain among them stands for its stages, and
            anything else is a ``ValueError``.
    """

    stages: Sequence[Channel] = ()

    def __post_init__(self) -> None:
        stages: list[Channel] = []
        for stage in self.stages:
            if not isinstance(stage, Channel):
                raise ValueError(f"the stages of a chain are channels, got a {type(stage).__name__}")
            stages += stage.stages if isinstance(stage, Chain) else [stage]
        vars(self).update(
            stages=tuple(stages),
            is_perfect=all(stage.is_perfect for stage in stages),
            is_random=any(stage.is_random for stage in stages),
        )

    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        remembered = []
        for index, stage in enumerate(self.stages):
            before = None if memory is None else memory[index]
            messages, after = stage.transmit(messages, before, randomness.stage(index))
            remembered.append(after)
        return messages, tuple(remembered)


def perfect() -> Channel:
    """Return the identity: y = v."""
    return Chain()


class Range(Channel):
    """The range of a link: y = min(max(v, −R), R) per component.

    Where what follows is noise or rounding of a fixed size, R bounds the ratio of signal to noise. So a sender that
    plays louder than it has to gains at most the logarithm of R over its strategy.

    Attributes:
        limit: R > 0, in the units of the strategies.
    """

    is_random = False

    limit: float = checked(require_positive)

    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        clip = array_namespace(messages.values).clip
        return replace(messages, values=clip(messages.values, -self.limit, self.limit)), ()


class AdditiveNoise(Channel):
    """Noise on each message: y = v + σ ξ, ξ per component.

    Attributes:
        std: σ ≥ 0, in the units of the strategies.
    """

    std: float = checked(require_non_negative)

    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        noise = randomness.normals()
        noise *= self.std
        noise += messages.values
        return replace(messages, values=noise), ()


class Delay(Channel):
    """Messages arrive some steps later, possibly overtaking each other; the receiver holds the last arrival.

    The message sent in step k arrives in step k + d, with d drawn per message uniformly from ``steps``..``longest``. Of
    messages that arrive in the same step, the one sent last counts. For constant d, y_k = v_{k−d}. A link without a
    message in a step, because it is down or an earlier stage dropped the message, sends nothing; the receiver keeps
    the last arrival.

    Attributes:
        steps: the shortest delay, ≥ 0.
        longest: the longest delay; by default ``steps``, so that the delay is constant.
    """

    steps: int = checked(require_count, 0)
    longest: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        vars(self)["is_random"] = require_count("longest", self._longest, self.steps) > self.steps

    @cached_property
    def _longest(self) -> int:
        return self.steps if self.longest is None else self.longest

    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        xp, longest = array_namespace(messages.values), self._longest
        lags = xp.full(messages.live.shape, self.steps)
        if self.is_random:
            lags += (randomness.uniforms() * (longest - self.steps + 1)).astype(np.int64)
        lags = xp.where(messages.live, lags, -1)  # a message that is not there never arrives
        if memory is None:
            held, received = messages.values, messages.live
            past, past_lags = (messages.values,) * longest, (xp.full_like(lags, -1),) * longest
        else:
            held, received, past, past_lags = memory
        # Newest first: entry d was sent d steps ago. The arrays never change, so shifting the tuples copies nothing.
        past, past_lags = (messages.values, *past), (lags, *past_lags)
        for age in range(longest, self.steps - 1, -1):
            arrives = past_lags[age] == age
            held = xp.where(arrives[:, None], past[age], held)
            received = received | arrives
        return replace(messages, values=held, live=received), (held, received, past[:longest], past_lags[:longest])


class Loss(Channel):
    """Messages are lost independently: where U < p, y is the last message received.

    Attributes:
        probability: p in [0, 1].
    """

    probability: float = checked(require_probability)

    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        return _hold(messages, randomness.uniforms() < self.probability, memory)


class BurstLoss(Channel):
    """Losses in bursts: the chain of Gilbert (1960), one per directed link.

    In every step a good link turns bad with probability p, a bad link turns good with probability r; messages on bad
    links are lost, and y is the last message received. At the start a link is bad with the stationary probability
    p/(p + r). A burst lasts 1/r steps on average.

    Attributes:
        to_bad: p in (0, 1].
        to_good: r in (0, 1].
    """

    to_bad: float = checked(require_positive_probability)
    to_good: float = checked(require_positive_probability)

    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        xp, turn = array_namespace(messages.values), randomness.uniforms()
        if memory is None:
            bad = turn < self.to_bad / (self.to_bad + self.to_good)
        else:
            bad = xp.where(memory[0], turn >= self.to_good, turn < self.to_bad)
        received, held = _hold(messages, bad, None if memory is None else memory[1])
        return received, (bad, held)


def _hold(messages: Messages, lost: BoolArray, memory: Memory | None) -> Transmitted:
    """Put the last message received in the place of each one that is ``lost``, (D, N, B)."""
    xp = array_namespace(messages.values)
    held, received = (messages.values, messages.live) if memory is None else memory
    arrives = messages.live & ~lost
    held = xp.where(arrives[:, None], messages.values, held)
    received = received | arrives
    return replace(messages, values=held, live=xp.where(lost, received, messages.live)), (held, received)


class UniformQuantiser(Channel):
    """Messages are rounded to evenly spaced levels: y = Δ round(v/Δ), so |y − v| ≤ Δ/2.

    Attributes:
        width: Δ > 0, in the units of the strategies.
    """

    is_random = False

    width: float = checked(require_positive)

    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        return replace(messages, values=round_to_integers(messages.values / self.width) * self.width), ()


class Lying(Channel):
    """One player lies: on components that are not its own, it adds a constant offset to the estimates that it sends.

    Liar and offset, U(−size, size) per component, are drawn per episode; the offset is the same for every neighbour.
    The liar sends its own strategy as it is, so the others reach the equilibrium if they do not use its estimates of
    third players.

    Attributes:
        size: > 0, in the units of the strategies.
    """

    size: float = checked(require_positive)

    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        senders, owners = randomness.senders, randomness.owners
        liar = (randomness.episode_uniforms(1) * senders.shape[1]).astype(np.int64)[0]
        offset = self.size * (2 * randomness.episode_uniforms(owners.size, purpose=1) - 1)
        foreign = owners[:, None] != senders[:, None, :]
        lies = foreign[..., None] & (senders[..., None] == liar)[:, None]
        return replace(messages, values=messages.values + lies * offset[:, None]), ()


class Bias(Channel):
    """Every directed link adds an offset of its own to each component: y = v + b, the same b in all steps.

    Attributes:
        bound: β ≥ 0, in the units of the strategies; b ~ U(−β, β), drawn per episode.
    """

    bound: float = checked(require_non_negative)

    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        if memory:
            (offsets,) = memory
        else:
            offsets = self.bound * (2 * randomness.component_uniforms() - 1)
        return replace(messages, values=messages.values + offsets), (offsets,)


class HeavyTails(Channel):
    """Noise with heavy tails on each message: y = v + σ ζ, where ζ has Student's t-distribution of two degrees.

    Its variance is infinite: one of 20 numbers is larger than 4.3, one of a million larger than 1000. By inversion,
    ζ = (2 U − 1) / √(2 U (1 − U)).

    Attributes:
        scale: σ ≥ 0, in the units of the strategies.
    """

    scale: float = checked(require_non_negative)

    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        unit = randomness.component_uniforms()
        noise = self.scale * (2 * unit - 1) / array_namespace(unit).sqrt(2 * unit * (1 - unit))
        return replace(messages, values=messages.values + noise), ()


class LateNoise(AdditiveNoise):
    """Noise that starts late: y = v before a step, and y = v + σ ξ from it on.

    Attributes:
        step: of the first noise.
    """

    step: int = checked(require_count, 0)

    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        noisy, _ = super().transmit(messages, memory, randomness)
        where = array_namespace(noisy.values).where
        return replace(messages, values=where(randomness.step < self.step, messages.values, noisy.values)), ()
