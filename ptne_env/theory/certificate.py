"""Certificates: all predictions about a law on a scenario, before anything runs."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from numbers import Real
from typing import Any, TypeAlias

import numpy as np

from ptne_env import laws
from ptne_env.laws import CorollaryOne, FixedGain, Law, Static
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import Interface
from ptne_env.shared.arrays import FloatArray, require_count, require_non_negative
from ptne_env.shared.names import unknown_name
from ptne_env.shared.parts import FactorySpec
from ptne_env.theory.assumptions import AssumptionCheck, LemmaCheck, check_assumptions, check_lemma
from ptne_env.theory.closed_loop import NoClosedLoopError, gain_growth, input_decay_rate
from ptne_env.theory.conditions import Condition, condition, problem_constants
from ptne_env.theory.constants import MonotonicityConstants, guaranteed_rate, monotonicity_constants
from ptne_env.theory.delay import delay_bound, delay_margin, delays_tried, is_stable_for_every_delay
from ptne_env.theory.sampled import (
    LoopClock,
    SampledLoop,
    distance,
    dominant_mode,
    noise_distance,
    play,
    sampled_loop,
    start_error,
)
from ptne_env.world.channel import AdditiveNoise, Chain, Channel, Delay
from ptne_env.world.scenario import Scenario
from ptne_env.world.switching import SwitchingTopology
from ptne_env.world.world import SHORTFALL_WARNING, World

LawSource: TypeAlias = FactorySpec | Callable[..., Law] | Law
"""A law, or a factory spec or a callable that builds it from a layout."""

_LARGEST_DIGITS = 308.0
"""Digits are clipped to ± this number, so that a certificate holds no infinity."""


@dataclass(frozen=True)
class FrozenGains:
    """The loop of a law with gains that adapt, at the gains κ_ij of one instant.

    Attributes:
        instant: ``"start"`` or ``"deadline"``.
        smallest: smallest κ_ij on a link.
        largest: largest κ_ij on a link.
        rate: r at these gains.
        largest_stable_step: at these gains; ``None`` when no step is stable.
    """

    instant: str
    smallest: float
    largest: float
    rate: float
    largest_stable_step: float | None


@dataclass(frozen=True)
class NoisePrediction:
    """Additive noise on every component of every message, independent per directed link and step.

    Attributes:
        gain: root mean square of the estimate distance at T that noise of standard deviation 1 causes; it is
            proportional. ``None`` where it overflows.
        std: the noise's standard deviation.
        digits: −log10 of the root mean square distance at T under that noise; ``None`` when F is not affine.
    """

    gain: float | None
    std: float
    digits: float | None


@dataclass(frozen=True)
class DelayPrediction:
    """Every message arrives a constant number of steps late.

    Attributes:
        margin: largest delay d for which 0..d all leave the loop stable at the scenario's largest step, up to
            ``tried``; ``None`` where the graph switches or the loop is unstable without delay.
        tried: largest delay that was tried.
        for_every_delay: whether a sufficient condition shows that every delay leaves the loop stable.
        bound: a sufficient bound in steps, of first order; ``None`` as the margin.
        steps: the delay of the prediction.
        digits: ``digits_sampled`` under that delay; ``None`` when F is not affine or gains adapt.
        digits_are_exact: whether an episode under that delay has these digits: all that ``digits_are_exact`` of the
            certificate asks for holds, apart from the delay, and the loop is shown to be stable under it.
    """

    margin: int | None
    tried: int
    for_every_delay: bool
    bound: float | None
    steps: int
    digits: float | None
    digits_are_exact: bool


@dataclass(frozen=True)
class Certificate:
    """All predictions about a law on a scenario; see :func:`certify` and docs/theory.md.

    Numbers of the closed loop are ``None`` for a law that has none, and ``notes`` gives the reason. The loop is
    *linear* when F is affine and no box confines the strategies.

    Attributes:
        scenario: name.
        law: class and arguments.
        kappa: κ of the law; ``None`` for a law without one.
        lemma: whether λ is a time transformation.
        assumptions: the paper's Assumptions 1–4.
        constants: ε and ι.
        algebraic_connectivity: smallest λ2 over the modes of the topology.
        condition: the condition of the law's own theorem on the scenario, sufficient for convergence and sometimes
            necessary; ``None`` for a law without a theorem.
        guaranteed_rate: λ_min(O/2) of the proof of Theorem 1, a lower bound of the rate; ``None`` unless the paper's
            gain condition holds for the static law or Corollary 1, on a fixed graph, in a linear loop.
        guaranteed_digits: a lower bound of ``digits_sampled``, from the same constants and the distance of the start
            alone; ``None`` likewise.
        clock: ``"effective"``, or ``"physical"`` for a law that undoes the time gain.
        rate: r with which the error decays like e^{−r s} as t → T (e^{−r t} on the physical clock); 0 or less when it
            does not vanish.
        rate_is_exact: whether the loop is linear and the topology not random; otherwise the rate is that of the
            linearisation at x*, or estimated from one draw of the topology.
        frozen_gains: of a law whose gains adapt, at t = 0 and, where the loop is linear, at T; ``rate``, noise and
            delay use the last.
        sampled_rate: rate of the slowest mode of the sampled loop over the second half of the steps to T, per unit of
            the loop's own time; ``None`` where the graph switches, gains adapt, the loop is not linear, or there are
            more than 600 estimates.
        dominant_share: share of that mode when this half begins; from 0.95 on, a real one dominates. ``None`` likewise.
        effective_time: τ_K = s_end + c t_K, the sum of the steps Θ_k.
        digits_from_rate: r (cT + s_end)/ln 10, the digits of the estimate error that the rate alone promises (r T/ln 10
            on the physical clock).
        digits_sampled: digits that the sampled loop, the product of (I − Θ_k M_k), has from the scenario's start over
            perfect links: −log10 ‖**x** − 1⊗x*‖/(√N ‖x*‖); ``None`` when the loop is not linear.
        digits_are_exact: whether an episode has these digits, up to 12 of them: ``step_margin``, with the hold phase,
            is above 1, the start asks for no input above the limit, and the scenario has no faulty links, disturbance,
            sensor or clocks that disagree. Otherwise they are those of exact arithmetic without limits and
            faults, and ``notes`` gives the reason. The same holds of ``digits_after_hold`` and
            ``worst_digits_gained``.
        digits_after_hold: the same after the hold phase; ``None`` also where there is none.
        worst_digits_gained: −log10 ‖Π (I − Θ_k M_k)‖₂, the digits gained by T from the worst start; ``None`` when the
            loop is not linear, gains adapt, or there are more than 600 estimates.
        largest_step: the largest step of the scenario to T, Θ_k (Δt_k on the physical clock).
        largest_stable_step: the step beyond which explicit steps on some mode's M amplify an error; ``None`` when no
            step is stable. For a law that reads its step: ``step_margin`` times the largest.
        step_margin: largest_stable_step / largest_step, above 1 when the steps are short enough; ``None`` likewise. For
            a law that reads its step, the smallest over the steps, each with the law as it acts there.
        input_rate: the rate at which u decays; it exceeds ``rate`` where u vanishes and the error does not.
        velocity_bounded: whether g(t) u stays bounded as t → T: ``input_rate`` ≥ 1 for the paper's λ. ``None`` where
            it is not decided, for a law that reads its step.
        energy_finite: whether ∫‖g u‖² dt is finite: ``input_rate`` > 1/2 for the paper's λ. ``None`` likewise.
        noise: effect of noise on messages; ``None`` with more than 600 estimates.
        delay: effect of late messages.
        shortfall: 1 − t_K/T, how far short of the deadline the last step ends, as a fraction of T.
        notes: limits of these numbers, in sentences.
    """

    scenario: str
    law: str
    kappa: float | None
    lemma: LemmaCheck
    assumptions: tuple[AssumptionCheck, ...]
    constants: MonotonicityConstants
    algebraic_connectivity: float
    condition: Condition | None
    effective_time: float
    shortfall: float
    notes: tuple[str, ...]
    guaranteed_rate: float | None = None
    guaranteed_digits: float | None = None
    clock: LoopClock | None = None
    rate: float | None = None
    rate_is_exact: bool = False
    frozen_gains: tuple[FrozenGains, ...] = ()
    sampled_rate: float | None = None
    dominant_share: float | None = None
    digits_from_rate: float | None = None
    digits_sampled: float | None = None
    digits_are_exact: bool = False
    digits_after_hold: float | None = None
    worst_digits_gained: float | None = None
    largest_step: float | None = None
    largest_stable_step: float | None = None
    step_margin: float | None = None
    input_rate: float | None = None
    velocity_bounded: bool | None = None
    energy_finite: bool | None = None
    noise: NoisePrediction | None = None
    delay: DelayPrediction | None = None

    def to_dict(self) -> dict[str, Any]:
        """A JSON object; a missing value is null, and no number is NaN or infinite."""
        data = dataclasses.asdict(self)
        data["constants"]["iota"] = self.constants.iota
        for name in ("assumptions", "frozen_gains", "notes"):
            data[name] = list(data[name])
        for name in ("value", "bound"):
            if self.condition is not None and not math.isfinite(data["condition"][name]):
                data["condition"][name] = None
        return data


def certify(
    scenario: Scenario,
    kappa: float = 2.0,
    *,
    law: Any = None,
    noise_std: float | None = None,
    delay_steps: int | None = None,
    delay_limit: int = 10,
) -> Certificate:
    """All predictions of the theory about a law on ``scenario``.

    Args:
        scenario: the experiment; a random start, topology or game contributes one draw, the first two with seed 0.
        kappa: κ ≥ 0 of the static law, which is certified when ``law`` is left out.
        law: builds a law from the layout, such as ``FactorySpec.of("ptne_env.laws:Grounded", kappa=4.0)``; also a
            class or function, ``"module:object"``, the name of a class in ``ptne_env.laws``, a
            :class:`~ptne_env.PolicySpec`, or the law itself. Numbers of the closed loop need a law that is linear in
            gradient and differences, possibly with gains that adapt.
        noise_std: σ ≥ 0 of additive noise on every component of every message; the channel's if left out.
        delay_steps: delay of every message in steps; the channel's constant delay if left out.
        delay_limit: largest delay that is tried for the margin.

    Raises:
        TypeError: when ``scenario`` is no :class:`~ptne_env.world.scenario.Scenario`, such as its name, ``kappa`` is a law,
            or ``law`` is none of the above.
        ValueError: when a number is negative, a name is unknown, or the spec does not build a law that can act on the
            scenario.
    """
    if not isinstance(scenario, Scenario):
        raise TypeError(
            f"certify needs a Scenario, got the {type(scenario).__name__} {scenario!r}; "
            "ptne_env.get_scenario returns the scenario of a name"
        )
    if not isinstance(kappa, Real):
        raise TypeError(f"the second argument of certify is the number kappa, got {kappa!r}; write law=…")
    source = _law_source(FactorySpec.of(Static, kappa=require_non_negative("kappa", kappa)) if law is None else law)
    world = World(scenario)
    faults = _ChannelFaults.of(world.channel)
    std = require_non_negative("noise_std", faults.noise_std if noise_std is None else noise_std)
    lag = require_count("delay_steps", faults.delay_steps if delay_steps is None else delay_steps, 0)
    require_count("delay_limit", delay_limit, 0)
    built = build_law(source, world)
    constants = monotonicity_constants(world.game)
    problem = problem_constants(world, constants)
    own_kappa = getattr(built, "kappa", None)
    certificate = Certificate(
        scenario=scenario.name,
        law=_describe(source),
        kappa=None if own_kappa is None else float(own_kappa),
        lemma=check_lemma(world.clock.transformation),
        assumptions=check_assumptions(world.game, world.topology, constants),
        constants=constants,
        algebraic_connectivity=problem.connectivity,
        condition=condition(built, problem),
        effective_time=world.clock.effective_time,
        shortfall=world.clock.shortfall,
        notes=(),
    )
    scenario_notes = tuple(_scenario_notes(world, faults))
    try:
        loop = sampled_loop(world, built)
    except NoClosedLoopError as error:
        unknown = [name for name, size in (("noise", std), ("delay", lag)) if size]
        fault_notes = [f"no prediction includes {' and '.join(unknown)} of messages"] if unknown else []
        notes = (f"{error}: no rates, digits or margins", *scenario_notes, *fault_notes)
        return dataclasses.replace(certificate, notes=notes)
    prediction = _Prediction.of(world, built, loop)
    return dataclasses.replace(
        certificate,
        notes=(*prediction.notes(), *scenario_notes, *_row_notes(faults)),
        **prediction.fields(),
        **_guarantee(certificate, prediction),
        noise=prediction.noise(std),
        delay=prediction.delay(lag, delay_limit),
    )


def _law_source(law: Any) -> LawSource:
    """A spec, a callable or a law of all that :func:`certify` takes."""
    source = getattr(law, "policy", law)  # of a PolicySpec, which this layer cannot import
    if isinstance(source, str):
        classes = {name: value for name, value in vars(laws).items() if isinstance(value, type) and value is not Law}
        known = [name for name, value in classes.items() if issubclass(value, Law)]
        if ":" not in source and source not in known:
            raise ValueError(
                f"{unknown_name('law', source, known, 'module:object')}; for a law with the name and the parameters of "
                f"'ptne list', law=ptne_env.evaluation.get_policy_spec({source!r})"
            )
        return FactorySpec.of(source if ":" in source else f"{laws.__name__}:{source}")
    if not isinstance(source, FactorySpec | Law) and not callable(source):
        raise TypeError(f"law is a class, function, law, name, FactorySpec or PolicySpec of one policy, got {source!r}")
    return source


def build_law(law: LawSource, world: World) -> Law:
    """The law, built for the layout of ``world`` under the law's own interface.

    Args:
        law: a law's class, or a spec that builds a law; called with the layout. A spec that loads a policy without
            sizes from a file builds it under the interface in the file. Or a law, which is returned.
        world: the scenario, built.

    Raises:
        ValueError: when the law cannot act in the world, or the spec builds something else.
    """
    if isinstance(law, Law):
        if law.layout != make_encoder(world, law.layout.interface).layout:
            raise ValueError(f"this {type(law).__name__} was built for the layout of another scenario: give its class")
        return law
    target = law.resolve() if isinstance(law, FactorySpec) else law
    layout = make_encoder(world, getattr(target, "interface", Interface())).layout
    built = law.build(layout=layout) if isinstance(law, FactorySpec) else law(layout)
    if not isinstance(built, Law):
        raise ValueError(f"{law!r} built a {type(built).__name__}; the theory is about a ptne_env.laws.Law")
    return built


def channel_noise(channel: Channel) -> float:
    """Standard deviation of the additive noise that a channel puts on every component of every message."""
    return _ChannelFaults.of(channel).noise_std


@dataclass(frozen=True)
class _ChannelFaults:
    """The faults of a channel that are predicted, and the kinds of the others."""

    noise_std: float
    delay_steps: int
    others: tuple[str, ...]

    @classmethod
    def of(cls, channel: Channel) -> _ChannelFaults:
        variance, delay, others = 0.0, 0, []
        for stage in channel.stages if isinstance(channel, Chain) else (channel,):
            if isinstance(stage, AdditiveNoise):
                variance += stage.std**2
            elif isinstance(stage, Delay) and stage.steps == stage.longest:
                delay += stage.steps
            elif not stage.is_perfect:
                others.append(type(stage).__name__)
        return cls(math.sqrt(variance), delay, tuple(others))


@dataclass(frozen=True)
class _Prediction:
    """The closed loop in a world, from its start: the part of a certificate that needs a loop.

    ``loops`` are those at frozen gains by instant, ``path`` the errors at every instant where the loop is linear.
    """

    world: World
    law: Law
    loops: Mapping[str, SampledLoop]
    memories: Mapping[str, Any]
    start: FloatArray
    path: FloatArray | None = None
    peak_input: float = 0.0

    @classmethod
    def of(cls, world: World, law: Law, loop: SampledLoop) -> _Prediction:
        game, steps = world.game, world.clock.steps
        estimates = world.start.draw(game.num_players, game.dimension, np.random.default_rng(0))
        start, loops = start_error(estimates, game), {"start": loop}
        memories = {"start": law.initial_memory(game.num_players)}
        if game.has_bounds or not game.is_affine:
            return cls(world, law, loops, memories, start)
        if not law.has_memory:
            path = loop.errors(start)
            finite = path[np.isfinite(path).all(axis=1)][: steps + 1]
            inputs = np.diff(finite, axis=0) / world.clock.theta[: len(finite) - 1, None]
            return cls(world, law, loops, memories, start, path, float(np.abs(inputs).max()))
        episode = play(law, world, estimates)
        if episode.memory is not None:
            memories["deadline"] = episode.memory
            loops["deadline"] = sampled_loop(world, law, episode.memory)
        return cls(world, law, loops, memories, start, episode.errors, episode.peak_input)

    @property
    def loop(self) -> SampledLoop:
        """At the gains at T where they are known."""
        return self.loops.get("deadline", self.loops["start"])

    @property
    def has_one_recursion(self) -> bool:
        """Whether the path is that of ``loop``: linear, and no gain adapts."""
        return self.path is not None and not self.law.has_memory

    @cached_property
    def margin(self) -> float | None:
        """The smallest step margin to T over the instants at which gains are frozen."""
        return _smallest(loop.step_margin() for loop in self.loops.values())

    @cached_property
    def margin_to_the_end(self) -> float | None:
        """The same with the hold phase."""
        if not self.world.clock.hold_steps:
            return self.margin
        return _smallest(loop.step_margin(hold=True) for loop in self.loops.values())

    @property
    def amplifies(self) -> bool:
        """Whether some step is so long that it amplifies an error, and with it what float32 rounds."""
        if self.margin_to_the_end is None:
            return any(loop.matrix.any() for loop in self.loop.loops)  # a law that never moves amplifies nothing
        return self.margin_to_the_end <= 1

    @property
    def saturates(self) -> bool:
        """Whether the start asks for an input above the limit."""
        return self.peak_input > self.world.scenario.input_limit

    @property
    def would_be_exact(self) -> bool:
        """Whether an episode has the digits of the path, if no message were late."""
        world, faults = self.world, _ChannelFaults.of(self.world.channel)
        calm = world.disturbance is None and world.sensor is None
        disturbed = not calm or any(world.scenario.clock_shifts)
        faulty = disturbed or faults.noise_std > 0 or bool(faults.others)
        return self.path is not None and not (self.amplifies or self.saturates or faulty)

    @property
    def digits_are_exact(self) -> bool:
        """Whether an episode has the digits of the path."""
        return self.would_be_exact and _ChannelFaults.of(self.world.channel).delay_steps == 0

    def digits(self, errors: FloatArray) -> float:
        return _digits(distance(errors, self.world.game))

    def fields(self) -> dict[str, Any]:
        """The fields of a certificate that hold numbers of the loop."""
        loop, path, scenario = self.loop, self.path, self.world.scenario
        topology, clock = self.world.topology, self.world.clock
        rate, effective = loop.rate(self.world), loop.clock == "effective"
        matrices = [each.matrix for each in loop.per_mode]
        is_rate_of_input = topology.is_fixed or not effective
        input_rate = rate if is_rate_of_input else input_decay_rate(matrices, topology, scenario.deadline)
        growth = gain_growth(clock.transformation)
        time_left = scenario.deadline * scenario.gain + scenario.s_end if effective else scenario.deadline
        largest_step = float(loop.steps[: clock.steps].max())
        margin = self.margin
        products = self.has_one_recursion and not loop.is_large
        mode = dominant_mode(loop, self.start, clock.steps // 2, clock.steps) if products else None
        return {
            "clock": loop.clock,
            "rate": rate,
            "rate_is_exact": path is not None and not topology.is_random,
            "frozen_gains": tuple(self._frozen_gains()) if self.law.has_memory else (),
            "sampled_rate": None if mode is None else mode.rate,
            "dominant_share": None if mode is None else mode.share,
            "digits_from_rate": rate * time_left / math.log(10),
            "digits_sampled": None if path is None else self.digits(path[clock.steps]),
            "digits_are_exact": self.digits_are_exact,
            "digits_after_hold": self.digits(path[-1]) if path is not None and clock.hold_steps else None,
            "worst_digits_gained": _worst_digits(loop) if products else None,
            "largest_step": largest_step,
            "largest_stable_step": None if margin is None else margin * largest_step,
            "step_margin": margin,
            "input_rate": input_rate,
            "velocity_bounded": None if loop.reads_step else not effective or input_rate >= growth,
            "energy_finite": None if loop.reads_step else not effective or input_rate > growth / 2,
        }

    def noise(self, std: float) -> NoisePrediction | None:
        if self.loop.is_large:
            return None
        game = self.world.game
        spread = noise_distance(self.loop.noise_covariance(), game)
        gain = spread if math.isfinite(spread) else None
        if self.path is None:
            return NoisePrediction(gain, std, None)
        added = 0.0 if std == 0 else math.inf if gain is None else std * gain
        mean = float(distance(self.path[self.world.clock.steps], game))
        return NoisePrediction(gain, std, _digits(math.hypot(mean, added)))

    def delay(self, steps: int, limit: int) -> DelayPrediction:
        loop, digits = self.loop, None
        if self.has_one_recursion:
            digits = self.digits(loop.errors(self.start, steps)[loop.deadline_step])
        if not self.world.topology.is_fixed:
            exact = steps == 0 and self.would_be_exact
            return DelayPrediction(None, 0, False, None, steps, digits, exact)  # noqa: FBT003 - in order
        longest = int(loop.steps[: loop.deadline_step].argmax())
        step, slowest = float(loop.steps[longest]), loop.loops[int(loop.index[longest])]
        bound, margin = delay_bound(slowest, step), delay_margin(slowest, step, limit)
        always = is_stable_for_every_delay(slowest, step)
        return DelayPrediction(
            margin=margin,
            tried=delays_tried(slowest, limit),
            for_every_delay=always,
            bound=None if bound is None else bound / step,
            steps=steps,
            digits=digits,
            digits_are_exact=self.would_be_exact and (always or (margin is not None and steps <= margin)),
        )

    def notes(self) -> Iterator[str]:
        """Limits of these numbers."""
        world, game, path = self.world, self.world.game, self.path
        if not game.is_affine:
            yield "F is not affine: rate, largest stable step, noise and delay are those of the linearisation at x*"
        if game.has_bounds:
            held = int(game.held_at_equilibrium.sum())
            yield (
                f"a box confines the strategies and holds {held} of {game.dimension} components at x*; the theorems "
                "are for strategies without bounds, and the numbers are those near x*, of the components that move"
            )
        if self.law.has_memory and "deadline" not in self.loops:
            yield "the gains adapt: rate, noise and delay use the gains at the start, frozen"
        elif self.law.has_memory:
            yield (
                "the gains adapt: the digits are those of the whole recursion; rate, noise and delay use the gains at "
                "T, frozen, which noise would raise further"
            )
        if path is not None and not np.isfinite(path[world.clock.steps]).all():
            yield "the sampled loop diverges from this start before T: the steps are too long for the law"
        yield from self._size_notes()
        if self.loop.reads_step:
            yield (
                "the law reads the length of its step: the rate is that of its last step, the margin that of the worst "
                "of its steps, with the law as it acts there; whether g(t) u stays bounded is not decided"
            )
        yield from _topology_notes(world.topology, self.loop.clock)
        if self.saturates:
            yield (
                f"the start asks for |u| = {self.peak_input:.4g}, above the input limit, which the prediction ignores"
            )
        if world.start.is_random and path is not None:
            yield "the start is random: the sampled digits are those of one draw, with seed 0"

    def _size_notes(self) -> Iterator[str]:
        """Limits that follow from the length of the steps and the number of estimates."""
        if self.path is not None and self.amplifies:
            longest = self.margin_to_the_end
            size = "no step is stable" if longest is None else f"{1 / longest:.3g} times the largest stable step"
            phase = " of the hold phase" if self.margin is not None and self.margin > 1 else ""
            yield (
                f"the largest step{phase} amplifies errors ({size}), also those of the rounding to float32: digits and "
                "noise are those of exact arithmetic, and an episode may have others"
            )
        if self.loop.is_large:
            tried = delays_tried(self.loop.per_mode[0], sys.maxsize)
            yield (
                f"{len(self.start)} estimates are too many for products of all steps: the rate of the sampled loop, "
                f"the worst start and noise are left out, and delays are tried up to {tried} steps"
            )

    def _frozen_gains(self) -> Iterator[FrozenGains]:
        for instant, loop in self.loops.items():
            gains = np.asarray(self.law.gains(self.memories[instant]))
            margin = loop.step_margin()
            largest = float(loop.steps[: loop.deadline_step].max())
            yield FrozenGains(
                instant=instant,
                smallest=float(gains.min()),
                largest=float(gains.max()),
                rate=loop.rate(self.world),
                largest_stable_step=None if margin is None else margin * largest,
            )


def _guarantee(certificate: Certificate, prediction: _Prediction) -> dict[str, Any]:
    """The bounds of the proof of Theorem 1: ‖I − hM‖² ≤ 1 − 2 h λ_min(O/2) + h² ‖M‖² in every step."""
    law, topology, constants = prediction.law, prediction.world.topology, certificate.constants
    is_static = type(law) in (Static, FixedGain, CorollaryOne)
    if not (is_static and topology.is_fixed and prediction.path is not None):
        return {}
    kappa, gradient_gain = law.kappa, getattr(law, "gradient_gain", 1.0)  # type: ignore[attr-defined]  # of those three
    connectivity = certificate.algebraic_connectivity
    rate = guaranteed_rate(constants, connectivity, topology.num_players, kappa, gradient_gain)
    if rate <= 0:
        return {}
    largest = float(np.linalg.eigvalsh(topology.graphs[0].laplacian)[-1])
    norm = gradient_gain * constants.iota_estimates + kappa * largest
    steps = prediction.loop.steps[: prediction.loop.deadline_step]
    gained = -np.log10(1 - 2 * steps * rate + (steps * norm) ** 2).sum() / 2
    return {"guaranteed_rate": rate, "guaranteed_digits": prediction.digits(prediction.start) + float(gained)}


def _topology_notes(topology: SwitchingTopology, clock: LoopClock) -> Iterator[str]:
    if topology.is_fixed:
        return
    switches = math.isfinite(topology.mean_dwell)
    loop_follows = (clock == "effective") == (topology.clock == "transformed")
    if topology.is_random:
        yield "the topology is random: the sampled digits are those of one draw, with seed 0"
        if not switches:
            yield "the rate is the smallest over the modes, of which an episode draws one"
        elif loop_follows:
            yield "the rate is estimated from one draw of 2000 dwells"
        elif clock == "effective":
            yield "the rate is the smallest over the modes, as any of them may be the last before T"
    if switches and clock == "effective":
        yield "the topology switches: the rate is that of the limit t → T and says little about the time before"
    if switches:
        yield (
            "the topology switches: the largest stable step is the smallest over the modes, which does not prove that "
            "their products are stable"
        )


def _scenario_notes(world: World, faults: _ChannelFaults) -> Iterator[str]:
    scenario, topology = world.scenario, world.topology
    if world.has_random_game:
        yield "the scenario draws games: the numbers are those of the typical game"
    if not topology.is_fixed and topology.clock == "physical" and not topology.is_random:
        switches = topology.switches(0.0, scenario.deadline).size
        yield (
            f"the topology dwells in t: it switches {switches} times before T and its last graph is then frozen, so "
            "Assumption 2 fails in the transformed time of the proof (docs/errata.md, 2)"
        )
    if faults.others:
        yield f"no prediction includes the channel's {', '.join(faults.others)}"
    disturbance = None if world.disturbance is None else scenario.disturbance
    parts = {"disturbance": disturbance, "sensor": scenario.sensor}
    for name, part in parts.items():
        if part is not None:
            yield f"no prediction includes the {name} {part.target.rpartition(':')[2]}"
    if any(scenario.clock_shifts):
        yield "the players' clocks disagree; the predictions are for clocks that are right"
    if world.clock.shortfall > SHORTFALL_WARNING:
        yield f"the last step ends {world.clock.shortfall:.2%} of T short of the deadline; raise s_end to come closer"


def _row_notes(faults: _ChannelFaults) -> Iterator[str]:
    if faults.noise_std or faults.delay_steps:
        yield "only the rows of noise and delay include the channel's noise and constant delay, each on its own"


def _smallest(margins: Iterable[float | None]) -> float | None:
    """The smallest; ``None`` when one of them is ``None``."""
    found = list(margins)
    return None if None in found else min(margin for margin in found if margin is not None)


def _describe(law: LawSource) -> str:
    if not isinstance(law, FactorySpec):
        return str(getattr(law, "__name__", type(law).__name__))
    given = law.to_dict()["arguments"]
    arguments = ", ".join(f"{name}={value}" for name, value in given.items())
    return f"{law.target.rpartition(':')[2]}({arguments})"


def _digits(distances: Any) -> float:
    """−log10 of a distance, within the range of float64."""
    value = float(distances)
    if not math.isfinite(value):
        return -_LARGEST_DIGITS
    return float(np.clip(-math.log10(max(value, 1e-308)), -_LARGEST_DIGITS, _LARGEST_DIGITS))


def _worst_digits(loop: SampledLoop) -> float:
    transition = loop.transition()
    return _digits(np.linalg.norm(transition, 2) if np.all(np.isfinite(transition)) else math.inf)
