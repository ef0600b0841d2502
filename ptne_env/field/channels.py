"""More channels: a bias of each link, noise with heavy tails, and noise that starts late.

The notation is that of :mod:`ptne_env.world.channel`.
"""

# ruff: noqa: ARG002 - a stage may ignore arguments of the interface

from __future__ import annotations

from dataclasses import replace

from ptne_env.shared.arrays import array_namespace, require_count, require_non_negative
from ptne_env.shared.counter_random import special_functions
from ptne_env.world.channel import AdditiveNoise, Channel, LinkRandomness, Memory, Messages, Transmitted


class Bias(Channel):
    """Every directed link adds an offset of its own to each component: y = v + b, the same b in all steps.

    Args:
        bound: β ≥ 0, in the units of the strategies; b ~ U(−β, β), drawn per episode.

    Raises:
        ValueError: when the bound is negative or not finite.
    """

    def __init__(self, bound: float) -> None:
        self.bound = require_non_negative("bound", bound)

    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        """Messages plus the offsets, which are drawn in the first step."""
        if memory:
            (offsets,) = memory
        else:  # the distribution function of a normal number is uniform
            normal = randomness.normals()
            offsets = self.bound * (2 * special_functions(normal).ndtr(normal) - 1)
        return replace(messages, values=messages.values + offsets), (offsets,)


class HeavyTails(Channel):
    """Noise with heavy tails on each message: y = v + σ ζ, where ζ has Student's t-distribution of two degrees.

    Its variance is infinite: one of 20 numbers is larger than 4.3, one of a million larger than 1000. With Φ the
    distribution function of ξ, ζ = (Φ(ξ) − Φ(−ξ)) / √(2 Φ(ξ) Φ(−ξ)).

    Args:
        scale: σ ≥ 0, in the units of the strategies.

    Raises:
        ValueError: when σ is negative or not finite.
    """

    def __init__(self, scale: float) -> None:
        self.scale = require_non_negative("scale", scale)

    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        """Messages plus noise."""
        normal = randomness.normals()
        ndtr = special_functions(normal).ndtr
        below, above = ndtr(normal), ndtr(-normal)
        noise = self.scale * (below - above) / array_namespace(normal).sqrt(2 * below * above)
        return replace(messages, values=messages.values + noise), ()


class LateNoise(AdditiveNoise):
    """Noise that starts late: y = v before a step, and y = v + σ ξ from it on.

    Args:
        std: σ ≥ 0, in the units of the strategies.
        step: of the first noise.

    Raises:
        ValueError: when σ is negative or not finite, or the step is not a whole number of at least 0.
    """

    def __init__(self, std: float, step: int) -> None:
        super().__init__(std)
        self.step = require_count("step", step, 0)

    def transmit(self, messages: Messages, memory: Memory | None, randomness: LinkRandomness) -> Transmitted:
        """Messages, later plus noise."""
        xp = array_namespace(messages.values)
        elapsed = memory[0] if memory else xp.zeros(messages.live.shape[-1])
        noisy, _ = super().transmit(messages, None, randomness)
        return replace(messages, values=xp.where(elapsed < self.step, messages.values, noisy.values)), (elapsed + 1,)
