"""Each prediction against the sampled environment, on random strongly monotone affine games and connected graphs."""

import contextlib
from dataclasses import dataclass
from itertools import product

import numpy as np
import pytest
from affine_games import SOAK
from random_affine import random_case
from sample_laws import Damped, spec_of
from scipy import linalg

from ptne_env import FactorySpec, get_scenario, theory
from ptne_env.theory.delay import delay_bound, delay_margin, delayed_radius, is_stable_for_every_delay
from ptne_env.theory.sampled import DominantMode, dominant_mode, play

LAWS = ["Grounded", "CorollaryOne", "Static", "Static", "Static"]
SCENARIOS = 200 if SOAK else 30
ROUNDING = 1e-14
"""Relative distance that rounding of estimates of the size of x* leaves; the environment cannot be closer."""


@dataclass
class Record:
    case: object
    loop: theory.SampledLoop
    predicted: np.ndarray  # distances at every instant
    measured: np.ndarray
    mode: DominantMode | None
    diverged: bool

    @property
    def window(self):
        return slice(self.loop.deadline_step // 2, self.loop.deadline_step + 1)

    @property
    def slope(self):
        times = np.concatenate([[0.0], np.cumsum(self.loop.steps)])
        return -np.polyfit(times[self.window], np.log(self.measured[self.window]), 1)[0]

    @property
    def one_mode_dominates(self):
        return self.mode is not None and self.mode.share >= 0.95


@pytest.fixture(scope="module")
def records():
    result = []
    for seed in range(SCENARIOS):
        case = random_case(seed, LAWS[seed % len(LAWS)])
        played, loop, steps = case.play(), case.loop, case.scenario.steps
        for column, start in enumerate(case.start_errors()):
            result.append(
                Record(
                    case,
                    loop,
                    theory.distance(loop.errors(start), case.game),
                    played["estimate_distance"][:, column],
                    dominant_mode(loop, start, steps // 2, steps),
                    bool(played.diverged[column]),
                )
            )
    return result


def test_product_of_steps_is_the_environment(records):
    assert not any(record.diverged for record in records)
    for record in records:
        np.testing.assert_allclose(record.measured[-1], record.predicted[-1], rtol=1e-6, atol=ROUNDING)
        # On the way, float32 rounding of the early error may exceed the late error.
        np.testing.assert_allclose(record.measured, record.predicted, rtol=1e-6, atol=1e-7 * record.measured[0])
    digits = [-np.log10(record.measured[-1]) for record in records]
    assert min(digits) < 1
    assert max(digits) > 8


def test_without_float32_between_them_they_agree_to_rounding(records):
    for record in records[::4]:
        measured, _ = record.case.play_in_float64()
        np.testing.assert_allclose(measured[:, 0], record.predicted, rtol=1e-9, atol=ROUNDING)


def test_rate_is_the_slope_of_the_log_error_where_one_mode_dominates(records):
    dominated = [record for record in records if record.one_mode_dominates and record.predicted[-1] > 1e4 * ROUNDING]
    assert len(dominated) >= SCENARIOS / 2
    short = 0
    for record in dominated:
        assert record.slope == pytest.approx(record.mode.rate, rel=0.05)
        # The spectral abscissa r is the rate of ever shorter steps; that of steps h is −ln(1 − h r)/h ≈ r + h r²/2.
        rate, step = record.loop.rate(record.case.world), record.loop.steps[record.window.start]
        assert record.slope == pytest.approx(rate, rel=0.05 + step * rate / 2)
        short += step * rate < 0.05
        assert step * rate >= 0.05 or record.slope == pytest.approx(rate, rel=0.05)
    assert short >= SCENARIOS * 0.4


def test_without_a_dominant_mode_the_slope_may_be_another(records):
    others = [record for record in records if record.mode is not None and not record.one_mode_dominates]
    assert max(abs(record.slope / record.mode.rate - 1) for record in others) > 0.2


def test_no_start_does_worse_than_the_worst_case(records):
    for record in records[::2]:
        worst = np.linalg.norm(record.loop.transition(), 2)
        assert record.measured[-1] <= worst * record.measured[0] * (1 + 1e-6) + ROUNDING


def test_worst_case_is_attained(records):
    record = records[20]
    case, game = record.case, record.case.game
    direction = np.linalg.svd(record.loop.transition())[2][0].reshape(game.num_players, game.dimension).T
    start = game.nash_equilibrium[:, None] + 10 * direction
    measured = case.play_over_channel(start[:, :, None])[:, 0]
    assert measured[-1] / measured[0] == pytest.approx(np.linalg.norm(record.loop.transition(), 2), rel=1e-5)


@pytest.mark.parametrize("law", ["Static", "Grounded", "CorollaryOne"])
@pytest.mark.parametrize("seed", range(8 if SOAK else 3))
def test_largest_stable_step_separates_settling_from_growth(seed, law):
    fields = {"spacing": "physical" if law == "CorollaryOne" else "effective", "gain": 5.0, "input_limit": 1e30}
    fields |= {"deadline": 10.0, "s_end": 5.0}
    stable = random_case(1000 + seed, law, margin=(1.02, 1.03), **fields)
    growing = random_case(1000 + seed, law, margin=(0.6, 0.7), **fields)
    for case, grows in ((stable, False), (growing, True)):
        loop = case.loop
        matrix, step = loop.loops[0].matrix, float(loop.steps.max())
        assert (step > theory.largest_stable_step(matrix)) is grows
        # Until the episode ends, it shows in the part that the steps amplify or shrink most.
        left = np.linalg.eig(matrix.T)[1][:, np.abs(1 - step * np.linalg.eigvals(matrix.T)).argmax()]
        measured = case.play_over_channel(case.starts[:, :, :1], follow=left)[:, 0]
        assert bool(measured[-1] > measured[0]) is grows


def test_velocity_is_bounded_where_the_rate_says_so():
    """Near T the velocity goes like e^{(1 − r) s}, measured over the last 1.5 units of s where one mode is alone."""
    seen = {True: 0, False: 0}
    slow = {"epsilon": (0.5, 2.0), "players": (3, 4)}
    fast = {"epsilon": (9.0, 15.0), "players": (3, 3), "kappa": (2, 4)}
    for seed in range(500, 516 if SOAK else 508):
        fields = {"spread": (0.1, 1.0), "skew": 0.3, **(slow if seed % 2 else fast)}
        case = random_case(seed, margin=(2.5, 4.0), spacing="effective", gain=0.0, s_end=7.0, **fields)
        certificate = theory.certify(case.scenario, law=case.spec, delay_limit=0)
        clock, loop = case.world.clock, case.loop
        first = int(np.searchsorted(clock.s, 5.5))
        mode = dominant_mode(loop, case.start_errors()[1], first, clock.steps)
        if abs(certificate.input_rate - 1) < 0.1 or mode.share < 0.95:
            continue
        velocities = case.play_in_float64()[1][first : clock.steps, 1]
        slope = np.polyfit(clock.s[first : clock.steps], np.log(velocities), 1)[0]
        assert slope == pytest.approx(1 - mode.rate, abs=0.05 * (1 + mode.rate))
        assert bool(slope < 0) is certificate.velocity_bounded
        seen[certificate.velocity_bounded] += 1
    assert min(seen.values()) >= 3, seen


@pytest.mark.parametrize("kind", ["fixed", "physical", "transformed"])
@pytest.mark.parametrize("seed", [711, 718, *range(700, 706 if SOAK else 700)])
def test_digits_of_a_certificate_are_those_of_the_environment(seed, kind):
    """At the deadline and after the hold phase."""
    case = random_case(seed, margin=(3.0, 6.0), spacing="effective", gain=10.0, s_end=6.0, hold_steps=12)
    if kind != "fixed":
        case.switch(kind)
    case.starts[:, :, 0] = certificate_start(case)
    certificate = theory.certify(case.scenario, law=case.spec, delay_limit=0)
    digits = -np.log10(case.play()["estimate_distance"][:, 0])
    assert certificate.digits_sampled == pytest.approx(digits[case.scenario.steps], abs=1e-5)
    assert certificate.digits_after_hold == pytest.approx(digits[-1], abs=1e-5)


def certificate_start(case):
    """The estimates from which a certificate starts."""
    return case.world.start.draw(case.game.num_players, case.game.dimension, np.random.default_rng(0))


def test_guarantees_of_the_gain_condition_hold_on_every_start():
    fields = {"spacing": "effective", "players": (3, 4), "epsilon": (2.0, 3.0), "spread": (0.1, 0.4), "skew": 0.3}
    informative = 0
    for seed in range(40 if SOAK else 16):
        case = random_case(seed, s_end=5.0, gain=0.0, **fields)
        game, graph, scenario = case.game, case.world.topology.graphs[0], case.scenario
        certifies = seed % 4 == 0  # on a complete graph, where the bound is not vacuous
        if certifies:
            complete = FactorySpec.of("ptne_env.world.graphs:complete", players=game.num_players)
            scenario = scenario.replace(topology=FactorySpec.of("ptne_env.world.switching:fixed", graph=complete))
            graph = complete.build()
        constants, connectivity = theory.monotonicity_constants(game), graph.algebraic_connectivity
        bound = theory.gain_bound(constants, connectivity)
        rates = [
            theory.guaranteed_rate(constants, connectivity, game.num_players, factor * bound)
            for factor in (0.999, 1.001, 1.5)
        ]
        assert rates[0] < 0 < rates[1] < rates[2]  # the gain condition is exactly that the proof's matrix is positive
        matrix = theory.closed_loop_matrix(game, graph, 1.5 * bound)
        assert rates[2] <= np.linalg.eigvalsh((matrix + matrix.T) / 2)[0]
        assert rates[2] <= theory.spectral_abscissa(matrix)
        if certifies:
            step = min(rates[2] / np.linalg.norm(matrix, 2) ** 2, theory.largest_stable_step(matrix) / 2)
            steps = int(case.world.clock.effective_time / step) + 1
            certificate = theory.certify(scenario.replace(steps=min(steps, 4000)), 1.5 * bound, delay_limit=0)
            assert certificate.condition.holds
            assert certificate.guaranteed_rate == rates[2]
            assert certificate.guaranteed_digits <= certificate.digits_sampled
            start = theory.start_error(certificate_start(case), game)
            informative += certificate.guaranteed_digits > -np.log10(theory.distance(start, game))
    assert informative >= 3


# --- noise --------------------------------------------------------------------------------------------------------


NOISY = {"effective": "Static", "transformed": "Grounded", "physical": "CorollaryOne"}


@pytest.mark.parametrize(("spacing", "law"), [*product(NOISY, NOISY.values())] if SOAK else [*NOISY.items()])
def test_noise_covariance_is_the_measured_one(spacing, law):
    seed = {"effective": 3, "transformed": 11, "physical": 6}[spacing]
    case = random_case(seed, law, spacing=spacing, gain=1.0, s_end=2.5)
    game, loop, batch, std = case.game, case.loop, 400, 0.3
    rest = np.repeat(game.nash_equilibrium[:, None, None], game.num_players, axis=1)
    squared = case.play_over_channel(np.repeat(rest, batch, axis=2), noise_std=std)[-1] ** 2
    predicted = theory.noise_distance(loop.noise_covariance(std), game) ** 2
    error = squared.std() / np.sqrt(batch)
    assert error < 0.12 * predicted
    assert abs(squared.mean() - predicted) < 4 * error


def test_noise_only_adds_to_the_mean_error():
    case = random_case(14, spacing="effective", gain=5.0)
    game, loop = case.game, case.loop
    start, batch, std = case.starts[:, :, :1], 400, 0.3
    squared = case.play_over_channel(np.repeat(start, batch, axis=2), noise_std=std)[-1] ** 2
    clean = theory.distance(loop.errors(case.start_errors()[0])[-1], game)
    predicted = clean**2 + theory.noise_distance(loop.noise_covariance(std), game) ** 2
    assert abs(squared.mean() - predicted) < 4 * squared.std() / np.sqrt(batch)


def test_covariance_settles_at_the_solution_of_the_lyapunov_equation():
    """P = (I − hM) P (I − hM)ᵀ + h² σ² W, with W the covariance of the input under noise of variance 1."""
    case = random_case(5, spacing="effective", gain=200.0)
    loop, step = case.loop.loops[0], case.loop.steps[0]
    transition = np.eye(len(loop.matrix)) - step * loop.matrix
    stationary = linalg.solve_discrete_lyapunov(transition, (0.1 * step) ** 2 * loop.noise)
    np.testing.assert_allclose(case.loop.noise_covariance(0.1), stationary, rtol=1e-6, atol=1e-6 * stationary.max())


# --- delay --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", ["Static", "Grounded", "CorollaryOne"])
@pytest.mark.parametrize("delay", [1, 2, 7])
def test_delayed_recursion_is_the_environment(delay, law):
    for seed in (1, 5, 8) if SOAK else (1,):
        case = random_case(seed, law, spacing="effective", gain=4.0)
        loop, game = case.loop, case.game
        measured = case.play_over_channel(case.starts, delay=delay)
        for column, start in enumerate(case.start_errors()):
            predicted = theory.distance(loop.errors(start, delay), game)
            np.testing.assert_allclose(measured[:, column], predicted, rtol=1e-6, atol=ROUNDING)


def random_loops(count):
    """Loops of games in which players pursue each other so much that messages matter."""
    for seed in range(300, 300 + count):
        with contextlib.suppress(ValueError):  # those that no step stabilises
            case = random_case(seed, margin=(1.05, 4.0), players=(3, 4), skew=12.0, spacing="effective", gain=5.0)
            loop = case.loop
            yield loop.loops[0], loop.steps[: loop.deadline_step].max()


def test_delay_bounds_are_never_violated():
    shown = {"bound": 0, "every": 0, "unstable": 0}
    for loop, step in random_loops(30):
        radii = [delayed_radius(loop, step, delay) for delay in range(5)]
        assert radii[0] == pytest.approx(np.abs(np.linalg.eigvals(np.eye(len(loop.matrix)) - step * loop.matrix)).max())
        bound = delay_bound(loop, step)
        for delay, radius in enumerate(radii):
            if step * delay < bound:
                assert radius < 1
                shown["bound"] += delay > 0
            if is_stable_for_every_delay(loop, step):
                assert radius < 1
                shown["every"] += 1
            shown["unstable"] += radius > 1
        margin = delay_margin(loop, step, 4)
        assert margin == next((delay for delay, radius in enumerate(radii) if radius >= 1), 5) - 1
    assert all(shown.values()), shown


def test_delay_bound_is_exact_for_one_link_that_is_all_delay():
    # e' = −e(τ − δ) in short steps: stable up to δ = π/2, and small gain promises 1 (|1 − e^{−iωδ}| ≤ ωδ, ω = 1).
    loop, step = theory.Loop(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1))), 1e-2
    assert delay_bound(loop, step) == pytest.approx(1.0, rel=0.02)
    assert delayed_radius(loop, step, 150) < 1 < delayed_radius(loop, step, 160)
    assert delay_margin(loop, step, 200) in range(155, 158)
    assert delay_margin(loop, 3.0) is None
    assert delay_bound(loop, 3.0) is None
    assert delay_bound(theory.Loop(np.eye(2), np.zeros((2, 2)), np.zeros((2, 2))), 0.1) is None


# --- laws ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [2, 9, 17])
def test_law_loop_of_the_static_law_is_the_closed_loop_matrix(seed):
    case = random_case(seed)
    game, graph = case.game, case.world.topology.graphs[0]
    loop = theory.law_loop(case.law, game, graph)
    gain = case.law.gradient_gain
    expected = gain * theory.closed_loop_matrix(game, graph, case.law.kappa / gain)
    np.testing.assert_allclose(loop.matrix, expected, atol=1e-12)
    size, n = game.num_players, game.dimension
    np.testing.assert_allclose(loop.message, -case.law.kappa * np.kron(graph.adjacency, np.eye(n)), atol=1e-12)
    squares = case.law.kappa**2 * (graph.adjacency**2).sum(axis=1)
    np.testing.assert_allclose(loop.noise, np.kron(np.diag(squares), np.eye(n)), atol=1e-10)
    assert loop.local.shape == (size * n, size * n)


def test_law_loop_of_the_grounded_law_is_its_equation():
    case = random_case(2, "Grounded")
    game, graph, kappa = case.game, case.world.topology.graphs[0], case.law.kappa
    n, players, a = game.dimension, game.num_players, graph.adjacency
    error = np.random.default_rng(0).normal(size=(players, n))
    expected = np.zeros((players, n))
    for i in range(players):
        for component, owner in enumerate(game.owners):
            if owner == i:
                expected[i, component] = game.matrix[component] @ error[i]
            else:
                expected[i, component] = kappa * (
                    sum(a[i, k] * (error[i, component] - error[k, component]) for k in range(players))
                    + a[i, owner] * (error[i, component] - error[owner, component])
                )
    np.testing.assert_allclose(theory.law_loop(case.law, game, graph).matrix @ error.ravel(), expected.ravel())


def test_law_loop_at_frozen_gains_is_the_static_law_on_the_weighted_graph():
    case = random_case(4, "Adaptive")
    game, graph = case.game, case.world.topology.graphs[0]
    gains = np.random.default_rng(1).uniform(0.5, 2.0, graph.adjacency.shape)
    gains = gains + gains.T
    neighbours = np.array(case.law.layout.neighbours)
    memory = gains[np.arange(len(neighbours))[:, None], neighbours]
    weighted = type(graph)(gains * graph.adjacency)
    np.testing.assert_allclose(
        theory.law_loop(case.law, game, graph, memory).matrix,
        theory.closed_loop_matrix(game, weighted, 1.0),
        atol=1e-12,
    )


@pytest.mark.parametrize("seed", range(4 if SOAK else 2))
def test_recursion_of_the_adaptive_law_is_the_environment(seed):
    case = random_case(seed, "Adaptive", spacing="effective", gain=5.0)
    measured = case.play()["estimate_distance"]
    for column in range(2):
        played = play(case.law, case.world, case.starts[:, :, column])
        predicted = theory.distance(played.errors, case.game)
        np.testing.assert_allclose(measured[:, column], predicted, rtol=1e-6, atol=ROUNDING)
        assert np.all(played.memory >= 0.5)


def test_a_certificate_notes_a_diverging_loop_and_overflows_nowhere():
    certificate = theory.certify(get_scenario("random-energy", steps=150), law=spec_of("Adaptive"))
    assert certificate.digits_sampled < -100
    assert any("diverges" in note for note in certificate.notes)
    assert [gains.instant for gains in certificate.frozen_gains] == ["start"]


def test_a_law_that_reads_its_step_has_a_loop_for_every_step():
    case = random_case(3, "Static", spacing="effective", gain=3.0)
    case.law = Damped(case.encoder.layout, kappa=1.5)
    loop, measured = case.loop, case.play()["estimate_distance"]
    assert len(loop.loops) > 1
    for column, start in enumerate(case.start_errors()):
        predicted = theory.distance(loop.errors(start), case.game)
        np.testing.assert_allclose(measured[:, column], predicted, rtol=1e-6, atol=ROUNDING)


@pytest.mark.parametrize(
    ("target", "phrase"),
    [
        ("ptne_env.laws:CentralisedOracle", "is an oracle"),
        ("ptne_env.field.laws:ProjectedGradient", "remembers more than gains"),
        ("sample_laws:Sign", "not linear"),
    ],
)
def test_a_law_without_closed_loop_gets_no_numbers_of_a_loop(target, phrase):
    certificate = theory.certify(get_scenario("energy"), law=FactorySpec.of(target))
    assert phrase in certificate.notes[0]
    assert (certificate.rate, certificate.digits_sampled, certificate.noise, certificate.delay) == (None,) * 4
    assert len(certificate.assumptions) == 4


def test_a_policy_that_is_no_law_is_refused():
    with pytest.raises(ValueError, match="the theory is about"):
        theory.certify(get_scenario("energy"), law=spec_of("RandomPolicy"))
