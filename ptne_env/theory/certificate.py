"""What can be promised beforehand about a law on a scenario: everything of this package in one object."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ptne_env.arrays import FloatArray, require_count, require_non_negative
from ptne_env.dynamics import Dynamics
from ptne_env.interface import Interface, Layout, Port
from ptne_env.laws import CorollaryOne, Law, Static
from ptne_env.parts import Part
from ptne_env.scenario import SHORTFALL_WARNING, Scenario
from ptne_env.theory.assumptions import AssumptionCheck, LemmaCheck, check_assumptions, check_lemma, connectivity
from ptne_env.theory.closed_loop import (
    Loop,
    gain_growth,
    input_decay_rate,
    largest_stable_step,
)
from ptne_env.theory.constants import MonotonicityConstants, gain_bound, guaranteed_rate, monotonicity_constants
from ptne_env.theory.sampled import (
    LoopClock,
    SampledLoop,
    delay_bound,
    delay_margin,
    distance,
    dominant_mode,
    is_stable_for_every_delay,
    noise_distance,
    play,
    sampled_loop,
    start_error,
)

_LARGEST_DIGITS = 308.0
"""Digits are kept within ±this, so that a certificate holds no infinity."""


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
        std: standard deviation asked about.
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
        steps: delay asked about.
        digits: ``digits_sampled`` under that delay; ``None`` when F is not affine or gains adapt.
    """

    margin: int | None
    tried: int
    for_every_delay: bool
    bound: float | None
    steps: int
    digits: float | None


@dataclass(frozen=True)
class Certificate:
    """What can be said about a law on a scenario before anything runs; see :func:`certify` and docs/theory.md.

    Attributes:
        scenario: name.
        law: what acts, with its arguments.
        kappa: κ of the law; ``None`` for a law without one.
        lemma: whether λ is a time transformation.
        assumptions: the paper's Assumptions 1–4.
        constants: ε and ι.
        algebraic_connectivity: smallest λ2 over the modes of the signal.
        gain_bound: (ι²/ε + ι)/λ2 times the gradient gain; ``None`` when no gain satisfies the condition, or the law
            has no such condition.
        gain_condition_holds: whether κ exceeds it (sufficient for convergence, not necessary); ``None`` for a law
            without this condition.
        guaranteed_rate: λ_min(O) of the proof of Theorem 1, which the rate is not below; ``None`` unless the gain
            condition holds on a fixed graph, with exact constants.
        guaranteed_digits: what ``digits_sampled`` is not below, from the same constants and the distance of the start
            alone; ``None`` likewise.
        clock: ``"effective"``, or ``"physical"`` for a law that undoes the time gain.
        rate: r with which the error decays like e^{−r s} as t → T (e^{−r t} on the physical clock); 0 or less when it
            does not vanish.
        rate_is_exact: whether F is affine; otherwise the rate is that of the linearisation at x*.
        frozen_gains: of a law whose gains adapt, at t = 0 and, where F is affine, at T; the last is what ``rate``, the
            noise and the delay are about.
        sampled_rate: rate of the slowest mode of the sampled loop over the second half of the steps to T, per unit of
            the loop's own time; ``None`` where the graph switches, gains adapt or F is not affine.
        dominant_share: share of that mode when this half begins; from 0.95 on, a real one dominates. ``None`` likewise.
        effective_time: τ_K = s_end + c t_K, the sum of the steps Θ_k.
        digits_from_rate: r (cT + s_end)/ln 10, the digits of the estimate error that the rate alone promises (r T/ln 10
            on the physical clock).
        digits_sampled: digits that the sampled loop, the product of (I − Θ_k M_k), has from the scenario's start:
            −log10 ‖**x** − 1⊗x*‖/(√N ‖x*‖); ``None`` when F is not affine.
        digits_after_hold: the same after the hold phase; ``None`` also where there is none.
        worst_digits_gained: −log10 ‖Π (I − Θ_k M_k)‖₂, the digits gained by T from the worst start; ``None`` when F is
            not affine, or gains adapt.
        largest_step: the largest step of the scenario to T, Θ_k (Δt_k on the physical clock).
        largest_stable_step: the step beyond which explicit steps on some mode's M amplify an error; ``None`` when no
            step is stable.
        step_margin: largest_stable_step / largest_step, above 1 when the steps are short enough; ``None`` likewise.
        input_rate: the rate at which u decays; it exceeds ``rate`` where u vanishes and the error does not.
        velocity_bounded: whether g(t) u stays bounded as t → T: ``input_rate`` ≥ 1 for the paper's λ.
        energy_finite: whether ∫‖g u‖² dt is finite: ``input_rate`` > 1/2 for the paper's λ.
        noise: what noise on messages does.
        delay: what late messages do.
        shortfall: 1 − t_K/T, how far short of the deadline the last step ends, as a fraction of T.
        notes: what else a reader must know.
    """

    scenario: str
    law: str
    kappa: float | None
    lemma: LemmaCheck
    assumptions: tuple[AssumptionCheck, ...]
    constants: MonotonicityConstants
    algebraic_connectivity: float
    gain_bound: float | None
    gain_condition_holds: bool | None
    guaranteed_rate: float | None
    guaranteed_digits: float | None
    clock: LoopClock
    rate: float
    rate_is_exact: bool
    frozen_gains: tuple[FrozenGains, ...]
    sampled_rate: float | None
    dominant_share: float | None
    effective_time: float
    digits_from_rate: float
    digits_sampled: float | None
    digits_after_hold: float | None
    worst_digits_gained: float | None
    largest_step: float
    largest_stable_step: float | None
    step_margin: float | None
    input_rate: float
    velocity_bounded: bool
    energy_finite: bool
    noise: NoisePrediction
    delay: DelayPrediction
    shortfall: float
    notes: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """A JSON object; what does not exist is null, and no number is NaN or infinite."""
        data = dataclasses.asdict(self)
        data["constants"]["iota"] = self.constants.iota
        for name in ("assumptions", "frozen_gains", "notes"):
            data[name] = list(data[name])
        return data


def scenario_layout(scenario: Scenario) -> Layout:
    """The layout for which a law is built that acts on ``scenario`` through the interface ``physical``."""
    return Port(Dynamics(scenario), Interface()).layout


def certify(
    scenario: Scenario,
    kappa: float = 2.0,
    *,
    law: Part | None = None,
    noise_std: float = 0.0,
    delay_steps: int = 0,
    delay_limit: int = 10,
) -> Certificate:
    """Everything that the theory says about a law on ``scenario``.

    Args:
        scenario: the experiment; a random start is drawn once, with seed 0.
        kappa: κ ≥ 0 of the static law, which is certified when ``law`` is left out.
        law: builds a law from the layout, such as ``Part.of("ptne_env.laws:Grounded", kappa=4.0)``: any law that is
            linear in gradient and differences, and one whose gains adapt.
        noise_std: σ ≥ 0 of additive noise on every component of every message, whose effect is predicted.
        delay_steps: delay of every message in steps, whose effect is predicted.
        delay_limit: largest delay that is tried for the margin.

    Raises:
        ValueError: when a number is negative, the part does not build a law, or it has no closed-loop matrix.
    """
    require_count("delay_steps", delay_steps, 0)
    part = law or Part.of("ptne_env.laws:Static", kappa=require_non_negative("kappa", kappa))
    built = part.build(layout=scenario_layout(scenario))
    if not isinstance(built, Law):
        raise ValueError(f"{part.target!r} built a {type(built).__name__}; certificates are of a ptne_env.laws.Law")
    game, signal, clock = scenario.built_game, scenario.built_signal, scenario.built_clock
    estimates = scenario.built_start.draw(game.num_players, game.dimension, np.random.default_rng(0))
    error = start_error(estimates, game)
    episode = play(built, Dynamics(scenario), estimates) if game.is_affine else None

    loops = {"start": sampled_loop(scenario, built)}
    adapts = built.has_memory
    if adapts and episode is not None and np.all(np.isfinite(episode.memory)):
        loops["deadline"] = sampled_loop(scenario, built, episode.memory)
    loop = loops.get("deadline", loops["start"])
    path = None if episode is None else episode.errors if adapts else loop.errors(error)
    mode = None if adapts or path is None else dominant_mode(loop, error, clock.steps // 2, clock.steps)
    matrices = [each.matrix for each in loop.per_mode]
    growth = gain_growth(clock.transformation)
    rate = loop.rate(scenario)
    input_rate = input_decay_rate(matrices, signal, scenario.deadline) if loop.clock == "effective" else rate
    largest_step = float(loop.steps[: clock.steps].max())
    stable_step = _smallest([largest_stable_step(one.matrix) for each in loops.values() for one in each.loops])
    constants = monotonicity_constants(game)
    smallest = min(connectivity(graph) for graph in signal.graphs)
    condition = _GainCondition.of(built, constants, smallest, scenario)
    time_left = scenario.deadline * scenario.gain + scenario.s_end if loop.clock == "effective" else scenario.deadline
    return Certificate(
        scenario=scenario.name,
        law=_describe(part),
        kappa=condition.kappa,
        lemma=check_lemma(clock.transformation),
        assumptions=check_assumptions(game, signal, constants),
        constants=constants,
        algebraic_connectivity=smallest,
        gain_bound=condition.bound,
        gain_condition_holds=condition.holds,
        guaranteed_rate=condition.rate,
        guaranteed_digits=condition.digits(loop, float(distance(error, game))),
        clock=loop.clock,
        rate=rate,
        rate_is_exact=game.is_affine,
        frozen_gains=tuple(
            _frozen(instant, each, None if instant == "start" or episode is None else episode.memory, built, scenario)
            for instant, each in loops.items()
            if adapts
        ),
        sampled_rate=None if mode is None else mode.rate,
        dominant_share=None if mode is None else mode.share,
        effective_time=clock.effective_time,
        digits_from_rate=rate * time_left / math.log(10),
        digits_sampled=None if path is None else _digits(distance(path[clock.steps], game)),
        digits_after_hold=_digits(distance(path[-1], game)) if path is not None and clock.hold_steps else None,
        worst_digits_gained=None if adapts or path is None else _worst_digits(loop),
        largest_step=largest_step,
        largest_stable_step=stable_step,
        step_margin=None if stable_step is None else stable_step / largest_step,
        input_rate=input_rate,
        velocity_bounded=loop.clock == "physical" or input_rate >= growth,
        energy_finite=loop.clock == "physical" or input_rate > growth / 2,
        noise=_noise(loop, noise_std, None if path is None else path[clock.steps], scenario),
        delay=_delay(loop, delay_steps, delay_limit, None if adapts or path is None else error, scenario),
        shortfall=clock.shortfall,
        notes=tuple(_notes(scenario, rate, condition, 0.0 if episode is None else episode.peak_input, adapts=adapts)),
    )


@dataclass(frozen=True)
class _GainCondition:
    """Theorem 1's condition on one law, and what its proof promises.

    ``bound`` and ``holds`` as in :class:`Certificate`; ``rate`` is λ_min(O), and ``norm`` a bound of ‖M‖₂ from the
    constants; both ``None`` where the proof does not apply.
    """

    kappa: float | None
    bound: float | None
    holds: bool | None
    rate: float | None
    norm: float | None

    @classmethod
    def of(cls, law: Law, constants: MonotonicityConstants, smallest: float, scenario: Scenario) -> _GainCondition:
        if not isinstance(law, (Static, CorollaryOne)):
            kappa = getattr(law, "kappa", None)
            return cls(None if kappa is None else float(kappa), None, None, None, None)
        gradient_gain = law.gradient_gain if isinstance(law, Static) else 1.0
        bound = gain_bound(constants, smallest, gradient_gain)
        holds = bound is not None and law.kappa > bound
        signal = scenario.built_signal
        if not (holds and signal.is_fixed and constants.exact):
            return cls(law.kappa, bound, holds, None, None)
        rate = guaranteed_rate(constants, smallest, signal.num_players, law.kappa, gradient_gain)
        largest = float(np.linalg.eigvalsh(signal.graphs[0].laplacian)[-1])
        return cls(law.kappa, bound, holds, rate, gradient_gain * constants.iota_estimates + law.kappa * largest)

    def digits(self, loop: SampledLoop, start_distance: float) -> float | None:
        """Digits at T from ‖I − hM‖² ≤ 1 − 2 h λ_min(O) + h² ‖M‖² in every step."""
        if self.rate is None or self.norm is None:
            return None
        steps = loop.steps[: loop.deadline_step]
        factors = 1 - 2 * steps * self.rate + steps**2 * self.norm**2
        return float(_digits(start_distance) - np.log10(factors).sum() / 2)


def _frozen(instant: str, loop: SampledLoop, memory: Any, law: Law, scenario: Scenario) -> FrozenGains:
    gains = np.asarray(law.initial_memory(scenario.built_game.num_players) if memory is None else memory)
    neighbours = np.array(law.layout.neighbours)
    links = gains[neighbours != np.arange(len(neighbours))[:, None]]
    return FrozenGains(
        instant=instant,
        smallest=float(links.min()),
        largest=float(links.max()),
        rate=loop.rate(scenario),
        largest_stable_step=_smallest([largest_stable_step(each.matrix) for each in loop.loops]),
    )


def _noise(loop: SampledLoop, std: float, error: FloatArray | None, scenario: Scenario) -> NoisePrediction:
    game = scenario.built_game
    require_non_negative("noise_std", std)
    gain: float | None = noise_distance(loop.noise_covariance(), game)
    gain = gain if gain is not None and math.isfinite(gain) else None
    if error is None:
        return NoisePrediction(gain, float(std), None)
    added = 0.0 if std == 0 else math.inf if gain is None else std * gain
    return NoisePrediction(gain, float(std), _digits(math.hypot(float(distance(error, game)), added)))


def _delay(loop: SampledLoop, steps: int, limit: int, start: FloatArray | None, scenario: Scenario) -> DelayPrediction:
    game, signal = scenario.built_game, scenario.built_signal
    require_count("delay_limit", limit, 0)
    digits = None
    if start is not None:
        digits = _digits(distance(loop.errors(start, steps)[loop.deadline_step], game))
    if not signal.is_fixed:
        return DelayPrediction(None, 0, for_every_delay=False, bound=None, steps=steps, digits=digits)
    step = float(loop.steps[: loop.deadline_step].max())
    slowest: Loop = loop.loops[int(loop.index[int(loop.steps[: loop.deadline_step].argmax())])]
    bound = delay_bound(slowest, step)
    return DelayPrediction(
        margin=delay_margin(slowest, step, limit),
        tried=limit,
        for_every_delay=is_stable_for_every_delay(slowest, step),
        bound=None if bound is None else bound / step,
        steps=steps,
        digits=digits,
    )


def _notes(
    scenario: Scenario, rate: float, condition: _GainCondition, peak_input: float, *, adapts: bool
) -> Iterator[str]:
    game = scenario.built_game
    if not game.is_affine:
        yield "F is not affine: rate, largest stable step, noise and delay are those of the linearisation at x*"
    if scenario.has_random_game:
        yield "the scenario draws games: the numbers are those of the typical one"
    if adapts:
        yield (
            "the gains adapt: the digits are those of the whole recursion; rate, noise and delay are about the gains "
            "at T, frozen, which noise would drive up further"
            if game.is_affine
            else "the gains adapt: rate, noise and delay are about the gains at the start, frozen"
        )
    yield from _signal_notes(scenario)
    if condition.bound is not None and not condition.holds and rate > 0:
        yield "κ violates the gain condition, which is sufficient only: the rate shows convergence"
    if peak_input > scenario.input_limit:
        yield f"the start asks for |u| = {peak_input:.4g}, above the input limit, which the prediction ignores"
    if scenario.built_start.is_random:
        yield "the start is random: the sampled digits are those of one draw, with seed 0"
    if scenario.built_clock.shortfall > SHORTFALL_WARNING:
        short = f"{scenario.built_clock.shortfall:.2%}"
        yield f"the last step ends {short} of T short of the deadline; raise s_end to come closer"


def _signal_notes(scenario: Scenario) -> Iterator[str]:
    signal = scenario.built_signal
    if not signal.is_fixed and signal.clock == "physical":
        switches = signal.switches(0.0, scenario.deadline).size
        yield (
            f"the signal dwells in t: it switches {switches} times before T and its last graph is then frozen, so "
            "Assumption 2 fails in the transformed time in which the proof lives (docs/errata.md, 2)"
        )
    if not signal.is_fixed:
        yield (
            "the signal switches: the rate is what remains as t → T and says little about the time before, and the "
            "largest stable step is the smallest over the modes, which does not prove that their products are stable"
        )


def _describe(part: Part) -> str:
    arguments = ", ".join(f"{name}={value}" for name, value in part.to_dict()["arguments"].items())
    return f"{part.target.rpartition(':')[2]}({arguments})"


def _digits(distances: Any) -> float:
    """−log10 of a distance, kept within what float64 tells."""
    value = float(distances)
    if not math.isfinite(value):
        return -_LARGEST_DIGITS
    return float(np.clip(-math.log10(max(value, 1e-308)), -_LARGEST_DIGITS, _LARGEST_DIGITS))


def _worst_digits(loop: SampledLoop) -> float:
    transition = loop.transition()
    return _digits(np.linalg.norm(transition, 2) if np.all(np.isfinite(transition)) else math.inf)


def _smallest(values: Sequence[float | None]) -> float | None:
    """The smallest, or ``None`` where one is missing."""
    known = [value for value in values if value is not None]
    return min(known) if known and len(known) == len(values) else None
