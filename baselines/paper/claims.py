"""The paper's claims, each decided by a measurement.

The verdict is computed: ``holds`` when the measurement meets a condition, otherwise ``fails``; ``finding`` gives the
deciding numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, TypeAlias

import numpy as np
from scipy import integrate, linalg

from baselines.paper.continuous import Run, prescribed_timeline, simulate
from baselines.paper.experiments import DEADLINE, GAIN, KAPPA, S_END, Experiments
from ptne_env.shared.arrays import FloatArray
from ptne_env.theory import LemmaViolationError, check_time_transformation, closed_loop_matrix, spectral_abscissa
from ptne_env.world.clock import Exponential, HyperbolicTangent, Rational
from ptne_env.world.graphs import complete, cycle, path, star
from ptne_env.world.switching import paper_topology

VANISHED = 1e-6
"""An error at s = 60 below this counts as vanishing at T."""


@dataclass(frozen=True)
class Claim:
    """A claim and its measured verdict.

    Attributes:
        name: short, as in the paper or in docs/errata.md.
        statement: the claim.
        verdict: ``"holds"`` or ``"fails"``.
        finding: the measurement in one sentence.
    """

    name: str
    statement: str
    verdict: Literal["holds", "fails"]
    finding: str

    @property
    def word(self) -> str:
        """The verdict for readers: an erratum is confirmed or not, a claim of the paper holds or fails."""
        if not self.name.startswith("Erratum"):
            return self.verdict
        return "confirmed" if self.verdict == "holds" else "not confirmed"


Check: TypeAlias = Callable[[Experiments], Iterator[Claim]]
"""A measurement that decides some claims."""


def decided(name: str, statement: str, met: bool, finding: str) -> Claim:  # noqa: FBT001
    """The claim, which holds if the condition on its measurement is ``met``."""
    return Claim(name, statement, "holds" if met else "fails", finding)


def lemma_1(experiments: Experiments) -> Iterator[Claim]:
    """Lemma 1, for the paper's λ and two others: the conditions, and ψ(s) = ξ(t) on independent integrations."""
    instants = np.linspace(0.0, 5.0, 26)
    matrix = experiments.loop_matrix(KAPPA)
    initial = (experiments.start - experiments.energy.nash_equilibrium).ravel()
    mismatches, violated = {}, []
    for kind in (Exponential, Rational, HyperbolicTangent):
        transformation = kind(DEADLINE)
        try:
            check_time_transformation(transformation)
        except LemmaViolationError as violation:
            violated.append(str(violation))
        in_t = _solve(lambda t, tf=transformation: tf.gain(t, GAIN), matrix, initial, transformation.time(instants))
        in_s = _solve(lambda s, tf=transformation: 1 + GAIN * tf.derivative(s), matrix, initial, instants)
        in_tau = linalg.expm(-matrix * transformation.effective_time(instants, GAIN)[:, None, None]) @ initial
        size = np.linalg.norm(in_tau, axis=1)
        largest = max(np.max(np.linalg.norm(other - in_tau, axis=1) / size) for other in (in_t, in_s))
        mismatches[kind.__name__] = float(largest)
    mismatch = max(mismatches.values())
    yield decided(
        "Lemma 1",
        "a λ with (7a)–(7c) turns the loop in t into the loop in s with ψ(s) = ξ(λ(s))",
        not violated and mismatch <= 1e-8,
        f"conditions {'violated' if violated else 'hold'}; largest relative mismatch {mismatch:.1e}",
    )


def proposition_1(experiments: Experiments) -> Iterator[Claim]:
    """Proposition 1: the closed loop rests only where all estimates are the equilibrium."""
    game = experiments.energy
    # The field is affine, f(x) = f(0) − M x, so its zeros solve M x = f(0); x* is not used.
    offset = np.zeros((5, 5))
    offset[game.owners, np.arange(5)] = -game.own_gradients(np.zeros((5, 5, 1)))[:, 0]
    distances, smallest = {}, {}
    for graph_kind in (cycle, path, star, complete):
        matrix = closed_loop_matrix(game, graph_kind(5), KAPPA)
        rest = np.linalg.solve(matrix, offset.ravel()).reshape(5, 5)
        distances[graph_kind.__name__] = float(np.abs(rest - game.nash_equilibrium).max())
        smallest[graph_kind.__name__] = float(np.linalg.svd(matrix, compute_uv=False)[-1])
    disconnected = closed_loop_matrix(game, paper_topology().graphs[0], KAPPA)
    kernel = disconnected.shape[0] - int(np.linalg.matrix_rank(disconnected))
    farthest = max(distances.values())
    yield decided(
        "Proposition 1",
        "on a connected graph the only equilibrium of the loop is 1⊗x*",
        min(smallest.values()) > 1e-6 and farthest <= 1e-10,
        f"farthest rest point {farthest:.1e} from x*; a disconnected mode has {kernel} directions of rest points",
    )


def theorem_1(experiments: Experiments) -> Iterator[Claim]:
    """Theorem 1: above the gain condition the estimates reach x* at T; Corollary 1 likewise without the time gain."""
    bound = experiments.gain_bound
    kappa = 1.05 * bound
    matrix = experiments.loop_matrix(kappa)
    rate, dissipation = spectral_abscissa(matrix), float(np.linalg.eigvalsh((matrix + matrix.T) / 2)[0])
    timeline = prescribed_timeline(experiments.ring, experiments.transformation, GAIN, s_end=60.0)
    run = simulate(experiments.energy, experiments.ring, experiments.start, timeline, initial_gain=kappa)
    at_deadline = float(run.estimate_distance[-1])
    yield decided(
        "Theorem 1",
        "the static law reaches x* at T from any start if κ > (ι²/ε + ι)/λ2",
        at_deadline <= VANISHED and dissipation > 0 and rate > 0,
        f"κ = {kappa:.3f}: error {at_deadline:.1e} at s = 60, r = {rate:.3f}, λ_min(sym M) = {dissipation:.3f}",
    )
    corollary = experiments.corollary_one
    rate = -slope(corollary.timeline.t, corollary.estimate_distance, 10.0, 30.0)
    abscissa = spectral_abscissa(experiments.loop_matrix(10.0))
    yield decided(
        "Corollary 1",
        "without the time gain the same law converges exponentially",
        bound < 10.0 and abscissa > 0 and abs(rate - abscissa) <= 0.01 * abscissa,
        f"κ = 10 > {bound:.3f}: measured rate {rate:.4f}/s, spectral abscissa {abscissa:.4f}/s",
    )


def theorem_2(experiments: Experiments) -> Iterator[Claim]:
    """Theorem 2: the equilibrium is held and u is bounded; whether u is C¹, and the plant's input g u, near T."""
    run = experiments.static
    k = run.timeline.deadline_index
    distance = run.estimate_distance
    inputs = np.linalg.norm(run.errors.reshape(len(distance), -1) @ experiments.loop_matrix(KAPPA).T, axis=1)
    held, input_held, peak = float(distance[k:].max()), float(inputs[k:].max()), float(inputs[: k + 1].max())
    exponents = near_deadline(experiments, KAPPA)
    conditioned = near_deadline(experiments, 1.05 * experiments.gain_bound)
    yield decided(
        "Theorem 2, hold",
        "the equilibrium is maintained and u stays zero from T on",
        held <= min(VANISHED, distance[k]) and input_held <= min(VANISHED, inputs[k]),
        f"largest error after T {held:.1e}, largest ‖u‖ {input_held:.1e}",
    )
    yield decided(
        "Theorem 2, boundedness of u",
        "u is uniformly bounded",
        peak <= inputs[0] * (1 + 1e-9) and exponents["input"] > 0,
        f"largest ‖u‖ {peak:.4g} at t = 0; ‖u‖ ~ (T−t)^{exponents['input']:.3f}",
    )
    bounded = "the input of Problem 1, which is the velocity g(t) u, is bounded"
    for name, statement, symbol, quantity in (
        ("smoothness of u", "u is C¹ on [0, ∞)", "du/dt", "input_derivative"),
        ("boundedness of the plant's input", bounded, "g u", "velocity"),
    ):
        yield decided(
            f"Theorem 2, {name}",
            statement,
            exponents[quantity] >= -1e-3,
            f"‖{symbol}‖ ~ (T−t)^{exponents[quantity]:.3f}; above the gain condition (T−t)^{conditioned[quantity]:.3f}",
        )


def theorem_3(experiments: Experiments) -> Iterator[Claim]:
    """Theorem 3: the adaptive law reaches x* at T, and its gains grow monotonically to finite values."""
    yield _adaptive_claim(
        "Theorem 3",
        "without global knowledge the adaptive law reaches x* at T; κ_ij increases and settles",
        experiments.adaptive,
    )


def theorem_4(experiments: Experiments) -> Iterator[Claim]:
    """Theorem 4: the same over jointly connected switching graphs, with the topology dwelling in t and in s."""
    statement = "over jointly connected switching graphs the adaptive law reaches x* at T; κ_ij increases and settles"
    runs = {
        "dwelling in t (as stated)": experiments.switching["physical"],
        "dwelling in s, Example 1": experiments.switching["transformed"],
        "dwelling in s, another game": experiments.counterexamples["five players"],
    }
    for name, run in runs.items():
        dwell, unit = run.topology.mode_dwells[0], "s in t" if run.topology.clock == "physical" else "in s"
        yield _adaptive_claim(f"Theorem 4, {name}", f"{statement}; the topology dwells {dwell:g} {unit}", run)


CLAIMS: tuple[Check, ...] = (lemma_1, proposition_1, theorem_1, theorem_2, theorem_3, theorem_4)
"""The checks of the paper's claims, in its order."""


def near_deadline(experiments: Experiments, kappa: float) -> dict[str, float]:
    """Exponents of (T−t) in ‖u‖, ‖du/dt‖ and ‖g u‖ on s ∈ [15, 30], and the growth rate of the energy in s."""
    run, matrix = experiments.exact_approach(kappa, s_end=30.0, samples=601), experiments.loop_matrix(kappa)
    error, s = run.errors.reshape(len(run.errors), -1), run.timeline.s
    slope_s = experiments.transformation.derivative(s)
    gain = GAIN + 1 / slope_s  # T − t itself is not representable this close to T
    u = np.linalg.norm(error @ matrix.T, axis=1)
    du = gain * np.linalg.norm(error @ (matrix @ matrix).T, axis=1)
    # T − t = T e^{−s}, so an exponent of (T−t) is minus a slope in s.
    return {
        "input": -slope(s, u, 15.0, 30.0),
        "input_derivative": -slope(s, du, 15.0, 30.0),
        "velocity": -slope(s, gain * u, 15.0, 30.0),
        "energy": slope(s, (gain * u) ** 2 * slope_s, 15.0, 30.0),
    }


def slope(x: FloatArray, values: FloatArray, low: float, high: float) -> float:
    """Least-squares slope of ln values over x in [low, high]."""
    chosen = (x >= low) & (x <= high)
    return float(np.polynomial.Polynomial.fit(x[chosen], np.log(values[chosen]), 1).convert().coef[1])


def _adaptive_claim(name: str, statement: str, run: Run) -> Claim:
    k = run.timeline.deadline_index
    s, distance, gains = run.timeline.s[: k + 1], run.estimate_distance[: k + 1], run.gains
    at_deadline, smallest_growth = float(distance[-1]), float(np.diff(gains, axis=0).min())
    end = "T" if s[-1] >= S_END else f"s = {s[-1]:g}"
    change = float(np.max((gains[k] - gains[np.searchsorted(s, s[-1] / 2)]) / gains[k]))
    return decided(
        name,
        statement,
        at_deadline <= VANISHED and smallest_growth >= 0 and change <= 1e-3,
        f"error {at_deadline:.1e} at {end}; κ_ij {'never decreases' if smallest_growth >= 0 else 'decreases'}, "
        f"ends between {gains[k].min():.2f} and {gains[k].max():.2f}, last change {100 * change:.2g} %",
    )


def _solve(
    factor: Callable[..., FloatArray], matrix: FloatArray, initial: FloatArray, instants: FloatArray
) -> FloatArray:
    """The solution of de/dz = −factor(z) M e at some instants z."""
    states = [initial]
    for span in pairwise(instants):  # interpolation within a step is less accurate than its end is
        accuracy = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14}
        solution = integrate.solve_ivp(lambda z, e: -factor(z) * (matrix @ e), span, states[-1], **accuracy)
        states.append(solution.y[:, -1])
    return np.array(states)
