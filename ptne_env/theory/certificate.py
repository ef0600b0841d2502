"""Certificates, which say what theory predicts about a law on a scenario before anything runs."""

from __future__ import annotations

import dataclasses
import math
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ptne_env.evaluation.metrics import number
from ptne_env.evaluation.policy_spec import PolicySpec, get_policy_spec
from ptne_env.laws import Adaptive, Grounded, Law, Static
from ptne_env.perception.encoder import Encoder
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.parts import FactorySpec
from ptne_env.theory.assumptions import AssumptionCheck, check_assumptions
from ptne_env.theory.closed_loop import (
    LoopClock,
    NoClosedLoopError,
    SampledLoop,
    decay_rate,
    distance,
    follows,
    gain_growth,
    largest_stable_step,
    sampled_loop,
)
from ptne_env.theory.conditions import Condition, condition
from ptne_env.theory.constants import last_modes, problem_constants
from ptne_env.world import distances
from ptne_env.world.catalogue import get_scenario
from ptne_env.world.channels import Chain
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import RANGE_LIMIT, SHORTFALL_WARNING, World


@dataclass(frozen=True)
class Certificate:
    """The predictions of theory about a law on a scenario; see :func:`certify` and docs/theory.md.

    Numbers of the closed loop are ``None`` for a law that has none, and ``notes`` gives the reason. The loop is
    *linear* when F is affine and no box confines the strategies.

    Attributes:
        scenario: the name of the scenario.
        law: the law and its arguments, as :func:`~ptne_env.evaluation.get_policy_spec` takes them.
        assumptions: Lemma 1 and Assumptions 1–4 of the paper, each with the number that decides it.
        condition: the condition of the law's theorem, sufficient for convergence; ``None`` without a theorem.
        clock: ``"effective"``, or ``"physical"`` for a law that undoes the time gain.
        rate: r, with which the error decays like e^{−r τ} as t → T, τ = s + c t (e^{−r t} on the physical clock); 0 or
            less when it does not vanish; ``None`` for a random topology. Where the loop is not linear, it is the rate
            of the linearisation at x*; where gains adapt, that of the gains at the start.
        digits: −log10 ‖**x** − 1⊗x*‖/(√N ‖x*‖) at T, which the sampled loop, the product of (I − h_k M_k), reaches from
            the scenario's start over perfect links; ``None`` where the loop is not linear or gains adapt.
        digits_are_exact: whether every episode has these digits, up to 12 of them: nothing is random, nothing disturbs,
            rounding does not show, and no input, estimate or message reaches its limit. Otherwise ``notes`` gives the
            reasons.
        largest_step: the largest step before T: Θ_k, or Δt_k on the physical clock.
        largest_stable_step: the step beyond which explicit steps on some mode's M amplify an error; ``None`` when no
            step is stable, as a note says, or all are.
        shortfall: 1 − t_K/T, how far short of the deadline the last step ends, as a fraction of T.
        notes: sentences about the limits of these numbers, and what the errata say about them.
    """

    scenario: str
    law: str
    assumptions: tuple[AssumptionCheck, ...]
    condition: Condition | None
    shortfall: float
    notes: tuple[str, ...] = ()
    clock: LoopClock | None = None
    rate: float | None = None
    digits: float | None = None
    digits_are_exact: bool = False
    largest_step: float | None = None
    largest_stable_step: float | None = None

    def __str__(self) -> str:
        """Return a table of the assumptions, the predictions and the notes, in 80 columns."""
        decay, step = ("τ), τ = s + c t", "Θ") if self.clock == "effective" else ("t)", "Δt")
        exactness = "exact" if self.digits_are_exact else "not exact, see the notes"
        stable = number(self.largest_stable_step)
        rows = {check.name: str(check) for check in self.assumptions}
        rows["condition"] = str(self.condition or "of no theorem")
        if self.clock is not None:
            rows["rate r"] = f"{number(self.rate)}, error ~ e^(−r {decay}"
            rows["digits at T"] = f"{number(self.digits)} ({exactness})"
            rows["largest step"] = f"{step} = {number(self.largest_step)}, the largest stable one {stable}"
        rows["shortfall"] = f"1 − t_K/T = {self.shortfall:.3%}"
        lines = (textwrap.fill(f"{name:14}{text}", 80, subsequent_indent=14 * " ") for name, text in rows.items())
        notes = (textwrap.fill(f"Note: {note}", 80) for note in self.notes)
        return "\n".join([f"{self.scenario}: {self.law}", "", *lines, *notes])

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON object, in which a missing value is null and no number is NaN or infinite."""
        data = dataclasses.asdict(self)
        data["assumptions"], data["notes"] = list(data["assumptions"]), list(data["notes"])
        for name in ("value", "bound"):
            if self.condition is not None and not math.isfinite(data["condition"][name]):
                data["condition"][name] = None
        return data


def certify(scenario: str | Scenario, law: str | FactorySpec | PolicySpec | type[Law] = Static) -> Certificate:
    """Predict what a law does on a scenario, and check the assumptions of its theorem.

    Args:
        scenario: a scenario, or its name, as for :func:`ptne_env.get_scenario`. Of a random start or topology one draw
            counts, with seed 0; of random games, a typical one.
        law: the law, as :func:`~ptne_env.evaluation.get_policy_spec` takes it. A closed loop has a law that is linear
            in gradient and differences, possibly with gains that adapt.

    Raises:
        TypeError: when ``scenario`` is something else.
        ValueError: for an unknown scenario, or when ``law`` does not build a law that can act on the scenario.
        PolicyError: when the constructor of the law fails.
    """
    scenario, spec = get_scenario(scenario), get_policy_spec(law)
    world = World(scenario)
    built, constants = build_law(spec, world), problem_constants(world)
    certificate = Certificate(
        scenario=scenario.name,
        law=str(spec.policy) if isinstance(spec.policy, FactorySpec) else spec.name,
        assumptions=check_assumptions(world, constants),
        condition=condition(built, constants),
        shortfall=world.clock.shortfall,
    )
    try:
        loop = sampled_loop(world, built)
    except NoClosedLoopError as error:
        notes = (f"{error}: no rate, no digits and no largest step", *_scenario_notes(world, built))
        return dataclasses.replace(certificate, notes=notes)
    prediction = _Prediction(world, built, loop)
    return dataclasses.replace(
        certificate,
        clock=loop.clock,
        rate=prediction.rate,
        digits=prediction.digits,
        digits_are_exact=prediction.is_linear and not (world.is_random or _faults(world) or prediction.deviations),
        largest_step=prediction.largest_step,
        largest_stable_step=None if prediction.largest_stable_step == math.inf else prediction.largest_stable_step,
        notes=(*prediction.notes(), *_scenario_notes(world, built, covers_range=prediction.is_linear)),
    )


def build_law(law: str | FactorySpec | PolicySpec | type[Law], world: World) -> Law:
    """Build a law, named as for :func:`certify`, for the layout of ``world`` under its own interface.

    Raises:
        ValueError: when the law cannot act in the world, or the result is no law.
    """
    spec = get_policy_spec(law)
    built = None if spec.files else spec.build(Encoder(world, spec.interface).layout)
    if not isinstance(built, Law):
        kind = type(built).__name__ if built else "learned policy"
        raise ValueError(f"{spec.name!r} is no law, but a {kind}: for a certificate subclass ptne_env.laws.Law")
    return built


def _faults(world: World) -> list[str]:
    """Return what disturbs an episode and enters no number."""
    channel = world.channel
    stages = channel.stages if isinstance(channel, Chain) else (channel,)
    if world.message_range < math.inf:
        stages = stages[1:]  # the first one is the range, which has a note of its own
    faults = [f"the channel's {type(stage).__name__}" for stage in stages if not stage.is_perfect]
    if world.disturbance is not None:
        faults.append(f"the disturbance {type(world.disturbance).__name__}")
    return faults


class _Prediction:
    """The predictions that follow from a closed loop in a world and its start."""

    def __init__(self, world: World, law: Law, loop: SampledLoop) -> None:
        self.world, self.law, self.loop = world, law, loop
        game, topology, stable = world.game, world.topology, [largest_stable_step(each) for each in loop.matrices]
        self.largest_step = float(loop.steps.max())
        self.largest_stable_step = None if None in stable else min(filter(None, stable))
        self.rate: float | None = None
        if not topology.is_random:
            self.rate = decay_rate(loop.matrices, topology, world.scenario.deadline, loop.clock)
        self.is_linear = game.is_affine and game.box is None and not law.has_memory
        self.digits: float | None = None
        self.deviations: tuple[str, ...] = ()
        if self.is_linear:
            estimates = world.start.draw(game.num_players, game.dimension, np.random.default_rng(0))
            errors = loop.errors((estimates.T - game.nash_equilibrium).ravel())
            # A certificate holds no infinity.
            self.digits = float(-np.log10(np.clip(distance(errors[-1], game), 1e-308, 1e308)))
            self.deviations = tuple(self._find_deviations(errors))

    def _find_deviations(self, errors: FloatArray) -> Iterator[str]:
        """Yield why an episode may have other digits than the linear loop, apart from what disturbs it."""
        world, layout, game = self.world, self.law.layout, self.world.game
        path = errors[np.isfinite(errors).all(axis=1)]
        inputs = np.diff(path, axis=0) / world.clock.theta[: len(path) - 1, None]
        estimates = path.reshape(-1, game.num_players, game.dimension).T + game.nash_equilibria[:, None]
        reach, peak = float(np.abs(estimates).max()), float(np.abs(inputs).max(initial=0.0))
        if len(path) < len(errors):
            yield "the sampled loop diverges from this start before T: the steps are too long for the law"
        elif self._is_rounded(path):
            yield "rounding shows at T: the digits are those of exact arithmetic, and an episode may have others"
        if max(reach, np.abs(game.own_gradients(estimates)).max()) > RANGE_LIMIT:
            yield f"an estimate or a gradient leaves ±{RANGE_LIMIT:g} on the way, where an episode ends"
        if peak > layout.input_limit:
            yield f"the start asks for |u| = {peak:.4g}, above the input limit, which the digits ignore"
        if layout.is_scaled:
            yield "the law acts through 'scaled', whose actions have a box of their own, which the digits ignore"
        elif not follows(self.law, world, self.loop, path[: world.clock.steps]):
            yield "the law is not linear for errors of the size of the start, which the digits ignore"
        if reach > world.message_range:
            yield f"messages of up to {reach:.4g} leave the range of links; the digits ignore that they are clipped"
        if world.start.is_random:
            yield "the start is random: the digits are those of one draw, with seed 0"
        if world.topology.is_random:
            yield "the topology is random: no rate, and digits of one draw, with seed 0"

    def _is_rounded(self, path: FloatArray) -> bool:
        """Return whether rounding may change the digits at T, as it does where it adds to every step more than it can.

        A loop that damps the error of the start fast, and other errors slowly, ends where rounding leaves it.
        """
        generator = np.random.default_rng(0)
        ends = np.array([path[-1], *(self.loop.errors(path[0], generator)[-1] for _ in range(4))])
        return not np.ptp(distances.digits(distance(ends, self.world.game))) <= 5e-4  # also where they overflow

    def notes(self) -> Iterator[str]:
        """Return the limits of these numbers."""
        topology, rate = self.world.topology, self.rate
        if self.law.has_memory:
            yield "the gains adapt: rate and largest stable step are those of the gains at the start; no digits"
        elif not self.is_linear:
            yield (
                "F is not affine, or a box confines the strategies: rate and largest stable step are those of the "
                "linearisation at x*, of the components that no bound holds; no digits"
            )
        yield from self.deviations
        if self.largest_stable_step is None:
            yield "every step amplifies some errors, as M of a mode has an eigenvalue with Re μ ≤ 0 that is not 0"
        elif self.largest_step >= self.largest_stable_step:
            yield "the largest step amplifies errors: it is longer than the largest stable one"
        if not topology.is_fixed and not topology.is_random:
            yield (
                "the topology switches: the rate is that of the limit t → T, and the largest stable step the smallest "
                "over the modes, which does not prove that their products are stable"
            )
        growth = gain_growth(self.world.clock.transformation)
        if self.loop.clock == "effective" and rate is not None and 0 < rate < growth and not self.law.has_memory:
            energy = "; the control energy is infinite" if rate <= growth / 2 else ""
            yield f"the velocity g(t) u grows without bound as t → T, for r < {growth:.2g}{energy} (docs/errata.md, 3)"


def _scenario_notes(world: World, law: Law, *, covers_range: bool = False) -> Iterator[str]:
    """Return the limits that hold with and without a loop."""
    scenario, topology = world.scenario, world.topology
    if world.has_random_game:
        yield "the scenario draws games: the numbers are those of the typical game"
    if any(graph.is_directed for graph in topology.graphs):
        yield (
            "links are directed: the paper's theorems do not cover this scenario, as they are for undirected graphs "
            "(Assumption 1); a condition that holds has a proof of its own (docs/mathematics.md)"
        )
    if not topology.is_fixed and topology.clock == "physical" and not topology.is_random:
        switches = topology.switches(0.0, scenario.deadline).size
        frozen = topology.graphs[last_modes(topology, scenario.deadline)[0]]
        failing = " and disconnected, so the graphs, jointly connected in t, are not in s, in which the proofs are"
        yield (
            f"the topology dwells in t: it switches {switches} times before T and its last graph is then frozen"
            f"{failing * (not frozen.is_connected)} (docs/errata.md, 2)"
        )
    elif isinstance(law, Grounded | Static | Adaptive) and not all(graph.is_connected for graph in topology.graphs):
        known = (
            "the law converges for a small enough δ if F is strongly monotone and the graphs that act within every "
            "window of some length are connected together (He and Huang, 2022, by its abstract)"
            if isinstance(law, Grounded)
            else "nothing is proven of the paper's laws, which converge in Example 1 and diverge in other games that "
            "satisfy all assumptions (docs/errata.md, 2)"
        )
        yield f"a mode is disconnected: {known}"
    for fault in _faults(world):
        yield f"no number includes {fault}"
    if world.message_range < math.inf and not covers_range:
        yield "no number includes the range of links, to which messages are clipped"
    if world.clock.shortfall > SHORTFALL_WARNING:
        yield f"the last step ends {world.clock.shortfall:.2%} of T short of the deadline; raise s_end to come closer"
