"""Each prediction against the sampled environment, on random strongly monotone affine games and connected graphs."""

import contextlib
from dataclasses import dataclass

import numpy as np
import pytest
from random_affine import random_case

from ptne_env import FactorySpec, get_scenario, theory
from ptne_env.world import World

LAWS = ["Grounded", "CorollaryOne", "Static", "Static", "Static"]
SCENARIOS = 200
ROUNDING = 1e-14
"""What rounding of estimates of the size of x* leaves of a relative distance; the environment cannot be closer."""


@dataclass
class Record:
    case: object
    loop: theory.SampledLoop
    predicted: np.ndarray  # distances at every instant
    measured: np.ndarray
    mode: theory.DominantMode | None
    diverged: bool

    @property
    def window(self):
        return slice(self.loop.deadline_step // 2, self.loop.deadline_step + 1)

    @property
    def slope(self):
        times = np.concatenate([[0.0], np.cumsum(self.loop.steps)])
        return -np.polyfit(times[self.window], np.log(self.measured[self.window]), 1)[0]


@pytest.fixture(scope="module")
def records():
    result = []
    for seed in range(SCENARIOS):
        case = random_case(seed, LAWS[seed % len(LAWS)])
        played, loop = case.play(), theory.sampled_loop(case.scenario, case.law)
        game, steps = World(case.scenario).game, case.scenario.steps
        for column, start in enumerate(case.start_errors()):
            result.append(
                Record(
                    case,
                    loop,
                    theory.distance(loop.errors(start), game),
                    played.estimate_distance[:, column],
                    theory.dominant_mode(loop, start, steps // 2, steps),
                    bool(played.diverged[column]),
                )
            )
    return result


def test_product_of_steps_is_the_environment(records):
    assert not any(record.diverged for record in records)
    for record in records:
        np.testing.assert_allclose(record.measured[-1], record.predicted[-1], rtol=1e-6, atol=ROUNDING)
        # On the way, what float32 rounds of the early error may be more than that of the late error.
        np.testing.assert_allclose(record.measured, record.predicted, rtol=1e-6, atol=1e-7 * record.measured[0])
    digits = [-np.log10(record.measured[-1]) for record in records]
    assert min(digits) < 1
    assert max(digits) > 8


def test_without_float32_between_them_they_agree_to_rounding(records):
    for record in records[::4]:
        measured, _ = record.case.play_in_float64()
        np.testing.assert_allclose(measured[:, 0], record.predicted, rtol=1e-9, atol=ROUNDING)


def test_rate_is_the_slope_of_the_log_error_where_one_mode_dominates(records):
    dominated = [
        record
        for record in records
        if record.mode is not None and record.mode.is_alone and record.predicted[-1] > 1e4 * ROUNDING
    ]
    assert len(dominated) >= 100
    short = 0
    for record in dominated:
        assert record.slope == pytest.approx(record.mode.rate, rel=0.05)
        # The spectral abscissa r is the rate of ever shorter steps; that of steps h is −ln(1 − h r)/h ≈ r + h r²/2.
        rate, step = record.loop.rate(record.case.scenario), record.loop.steps[record.window.start]
        assert record.slope == pytest.approx(rate, rel=0.05 + step * rate / 2)
        short += step * rate < 0.05
        assert step * rate >= 0.05 or record.slope == pytest.approx(rate, rel=0.05)
    assert short >= 80


def test_without_a_dominant_mode_the_slope_may_be_another(records):
    others = [record for record in records if record.mode is not None and not record.mode.is_alone]
    assert max(abs(record.slope / record.mode.rate - 1) for record in others) > 0.2


def test_no_start_does_worse_than_the_worst_case(records):
    for record in records[::2]:
        worst = np.linalg.norm(record.loop.transition(), 2)
        assert record.measured[-1] <= worst * record.measured[0] * (1 + 1e-6) + ROUNDING


def test_worst_case_is_attained(records):
    record = records[20]
    case, game = record.case, World(record.case.scenario).game
    direction = np.linalg.svd(record.loop.transition())[2][0].reshape(game.num_players, game.dimension).T
    start = game.nash_equilibrium[:, None] + 10 * direction
    measured = case.play_over_channel(start[:, :, None])[:, 0]
    assert measured[-1] / measured[0] == pytest.approx(np.linalg.norm(record.loop.transition(), 2), rel=1e-5)


@pytest.mark.parametrize("law", ["Static", "Grounded", "CorollaryOne"])
@pytest.mark.parametrize("seed", range(8))
def test_largest_stable_step_separates_settling_from_growth(seed, law):
    fields = {"spacing": "physical" if law == "CorollaryOne" else "effective", "gain": 5.0, "input_limit": 1e30}
    fields |= {"deadline": 10.0, "s_end": 5.0}
    stable = random_case(1000 + seed, law, margin=(1.02, 1.03), **fields)
    growing = random_case(1000 + seed, law, margin=(0.6, 0.7), **fields)
    for case, grows in ((stable, False), (growing, True)):
        loop = theory.sampled_loop(case.scenario, case.law)
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
    for seed in range(500, 516):
        fields = {"spread": (0.1, 1.0), "skew": 0.3, **(slow if seed % 2 else fast)}
        case = random_case(seed, margin=(2.5, 4.0), spacing="effective", gain=0.0, s_end=7.0, **fields)
        certificate = theory.certify(case.scenario, law=case.part, delay_limit=0)
        clock, loop = World(case.scenario).clock, theory.sampled_loop(case.scenario, case.law)
        first = int(np.searchsorted(clock.s, 5.5))
        mode = theory.dominant_mode(loop, case.start_errors()[1], first, clock.steps)
        if abs(certificate.input_rate - 1) < 0.1 or not mode.is_alone:
            continue
        velocities = case.play_in_float64()[1][first : clock.steps, 1]
        slope = np.polyfit(clock.s[first : clock.steps], np.log(velocities), 1)[0]
        assert slope == pytest.approx(1 - mode.rate, abs=0.05 * (1 + mode.rate))
        assert bool(slope < 0) is certificate.velocity_bounded
        seen[certificate.velocity_bounded] += 1
    assert min(seen.values()) >= 3, seen


@pytest.mark.parametrize("kind", ["fixed", "physical", "transformed"])
@pytest.mark.parametrize("seed", range(700, 706))
def test_digits_of_a_certificate_are_those_of_the_environment_at_the_deadline_and_after_the_hold(seed, kind):
    case = random_case(seed, margin=(3.0, 6.0), spacing="effective", gain=10.0, s_end=6.0, hold_steps=12)
    if kind != "fixed":
        case.switch(kind)
    start = World(case.scenario).start.draw(*case.starts.shape[1::-1], np.random.default_rng(0))
    case.starts[:, :, 0] = start
    certificate = theory.certify(case.scenario, law=case.part, delay_limit=0)
    digits = -np.log10(case.play().estimate_distance[:, 0])
    assert certificate.digits_sampled == pytest.approx(digits[case.scenario.steps], abs=1e-5)
    assert certificate.digits_after_hold == pytest.approx(digits[-1], abs=1e-5)


def test_guarantees_of_the_gain_condition_hold_on_every_start():
    everybody = {
        3: FactorySpec.of("ptne_env.graphs:complete", players=3),
        4: FactorySpec.of("ptne_env.graphs:complete", players=4),
    }
    telling = 0
    for seed in range(40):
        fields = {"spacing": "effective", "players": (3, 4), "epsilon": (2.0, 3.0), "spread": (0.1, 0.4), "skew": 0.3}
        case = random_case(seed, s_end=5.0, gain=0.0, **fields)
        if seed % 4 == 0:  # connected so well that the bound says something
            graph = everybody[World(case.scenario).game.num_players]
            case.scenario = case.scenario.replace(topology=FactorySpec.of("ptne_env.switching:fixed", graph=graph))
        game, graph = World(case.scenario).game, World(case.scenario).topology.graphs[0]
        constants = theory.monotonicity_constants(game)
        bound = theory.gain_bound(constants, graph.algebraic_connectivity)
        rates = [
            theory.guaranteed_rate(constants, graph.algebraic_connectivity, game.num_players, factor * bound)
            for factor in (0.999, 1.001, 1.5)
        ]
        assert rates[0] < 0 < rates[1] < rates[2]  # the gain condition is exactly that the proof's matrix is positive
        matrix = theory.closed_loop_matrix(game, graph, 1.5 * bound)
        assert rates[2] <= np.linalg.eigvalsh((matrix + matrix.T) / 2)[0]
        assert rates[2] <= theory.spectral_abscissa(matrix)
        if seed % 4 == 0:
            step = min(rates[2] / np.linalg.norm(matrix, 2) ** 2, theory.largest_stable_step(matrix) / 2)
            steps = int(World(case.scenario).clock.effective_time / step) + 1
            certificate = theory.certify(case.scenario.replace(steps=min(steps, 4000)), 1.5 * bound, delay_limit=0)
            assert certificate.condition.holds
            assert certificate.guaranteed_rate == rates[2]
            assert certificate.guaranteed_digits <= certificate.digits_sampled
            start = -np.log10(theory.distance(certificate_start(case), game))
            telling += certificate.guaranteed_digits > start
    assert telling >= 3


def certificate_start(case):
    game = World(case.scenario).game
    estimates = World(case.scenario).start.draw(game.num_players, game.dimension, np.random.default_rng(0))
    return theory.start_error(estimates, game)


# --- noise --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", ["Static", "Grounded", "CorollaryOne"])
@pytest.mark.parametrize("spacing", ["effective", "transformed", "physical"])
def test_noise_covariance_is_the_measured_one(spacing, law):
    case = random_case(
        {"effective": 3, "transformed": 11, "physical": 6}[spacing], law, spacing=spacing, gain=1.0, s_end=2.5
    )
    game, loop = World(case.scenario).game, theory.sampled_loop(case.scenario, case.law)
    batch, std = 400, 0.3
    rest = np.repeat(game.nash_equilibrium[:, None, None], game.num_players, axis=1)
    squared = case.play_over_channel(np.repeat(rest, batch, axis=2), noise_std=std)[-1] ** 2
    predicted = theory.noise_distance(loop.noise_covariance(std), game) ** 2
    error = squared.std() / np.sqrt(batch)
    assert error < 0.12 * predicted
    assert abs(squared.mean() - predicted) < 4 * error


def test_noise_only_adds_to_the_mean_error():
    case = random_case(14, spacing="effective", gain=5.0)
    game, loop = World(case.scenario).game, theory.sampled_loop(case.scenario, case.law)
    start, batch, std = case.starts[:, :, :1], 400, 0.3
    squared = case.play_over_channel(np.repeat(start, batch, axis=2), noise_std=std)[-1] ** 2
    clean = theory.distance(loop.errors(case.start_errors()[0])[-1], game)
    predicted = clean**2 + theory.noise_distance(loop.noise_covariance(std), game) ** 2
    assert abs(squared.mean() - predicted) < 4 * squared.std() / np.sqrt(batch)


def test_covariance_settles_at_the_stationary_one_and_its_first_order():
    case = random_case(5, spacing="effective", gain=200.0)
    loop = theory.sampled_loop(case.scenario, case.law)
    step = loop.steps[0]
    stationary = theory.stationary_noise_covariance(loop.loops[0], step, 0.1)
    np.testing.assert_allclose(loop.noise_covariance(0.1), stationary, rtol=1e-6, atol=1e-6 * stationary.max())
    traces = [
        [np.trace(theory.stationary_noise_covariance(loop.loops[0], h, first_order=first)) for first in (False, True)]
        for h in (step / 50, step / 100)
    ]
    errors = [abs(exact / first - 1) for exact, first in traces]
    assert errors[0] < 0.05
    assert errors[1] == pytest.approx(errors[0] / 2, rel=0.1)  # of first order
    assert theory.stationary_noise_covariance(loop.loops[0], 100 * step) is None
    assert theory.stationary_noise_covariance(theory.Loop(*-np.ones((3, 2, 2))), 0.1) is None


# --- delay --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", ["Static", "Grounded", "CorollaryOne"])
@pytest.mark.parametrize("delay", [1, 2, 7])
def test_delayed_recursion_is_the_environment(delay, law):
    for seed in (1, 5, 8):
        case = random_case(seed, law, spacing="effective", gain=4.0)
        loop, game = theory.sampled_loop(case.scenario, case.law), World(case.scenario).game
        measured = case.play_over_channel(case.starts, delay=delay)
        for column, start in enumerate(case.start_errors()):
            predicted = theory.distance(loop.errors(start, delay), game)
            np.testing.assert_allclose(measured[:, column], predicted, rtol=1e-6, atol=ROUNDING)


def random_loops(count):
    """Loops of games in which players pursue each other so much that messages matter."""
    for seed in range(300, 300 + count):
        with contextlib.suppress(ValueError):  # those that no step stabilises
            case = random_case(seed, margin=(1.05, 4.0), players=(3, 4), skew=12.0, spacing="effective", gain=5.0)
            loop = theory.sampled_loop(case.scenario, case.law)
            yield loop.loops[0], loop.steps[: loop.deadline_step].max()


def test_delay_bounds_are_never_violated():
    shown = {"bound": 0, "every": 0, "unstable": 0}
    for loop, step in random_loops(30):
        radii = [theory.delayed_radius(loop, step, delay) for delay in range(5)]
        assert radii[0] == pytest.approx(np.abs(np.linalg.eigvals(np.eye(len(loop.matrix)) - step * loop.matrix)).max())
        bound = theory.delay_bound(loop, step)
        for delay, radius in enumerate(radii):
            if step * delay < bound:
                assert radius < 1
                shown["bound"] += delay > 0
            if theory.is_stable_for_every_delay(loop, step):
                assert radius < 1
                shown["every"] += 1
            shown["unstable"] += radius > 1
        margin = theory.delay_margin(loop, step, 4)
        assert margin == next((delay for delay, radius in enumerate(radii) if radius >= 1), 5) - 1
    assert all(shown.values()), shown


def test_delay_bound_is_exact_for_one_link_that_is_all_delay():
    # e' = −e(τ − δ) in short steps: stable up to δ = π/2, and small gain promises 1 (|1 − e^{−iωδ}| ≤ ωδ, ω = 1).
    loop, step = theory.Loop(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1))), 1e-2
    assert theory.delay_bound(loop, step) == pytest.approx(1.0, rel=0.02)
    assert theory.delayed_radius(loop, step, 150) < 1 < theory.delayed_radius(loop, step, 160)
    assert theory.delay_margin(loop, step, 200) in range(155, 158)
    assert theory.delay_margin(loop, 3.0) is None
    assert theory.delay_bound(loop, 3.0) is None
    assert theory.delay_bound(theory.Loop(np.eye(2), np.zeros((2, 2)), np.zeros((2, 2))), 0.1) is None


# --- laws ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [2, 9, 17])
def test_law_loop_of_the_static_law_is_the_closed_loop_matrix(seed):
    case = random_case(seed)
    game, graph = World(case.scenario).game, World(case.scenario).topology.graphs[0]
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
    game, graph, kappa = World(case.scenario).game, World(case.scenario).topology.graphs[0], case.law.kappa
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


def test_law_loop_at_frozen_gains_is_the_static_law_on_the_graph_weighted_by_them():
    case = random_case(4, "Adaptive")
    game, graph = World(case.scenario).game, World(case.scenario).topology.graphs[0]
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


@pytest.mark.parametrize("seed", range(4))
def test_recursion_of_the_adaptive_law_is_the_environment(seed):
    case = random_case(seed, "Adaptive", spacing="effective", gain=5.0)
    for column in range(2):
        played = theory.play(case.law, case.encoder.world, case.starts[:, :, column])
        measured = case.play().estimate_distance[:, column]
        predicted = theory.distance(played.errors, World(case.scenario).game)
        np.testing.assert_allclose(measured, predicted, rtol=1e-6, atol=ROUNDING)
        assert np.all(played.memory >= 0.5)


def test_a_loop_that_diverges_is_told_so_and_overflows_nowhere():
    scenario = get_scenario("random-energy", steps=150)
    adaptive = FactorySpec.of("ptne_env.laws:Adaptive", gamma=0.01, initial_gain=0.5)
    certificate = theory.certify(scenario, law=adaptive)
    assert certificate.digits_sampled < -100
    assert any("diverges" in note for note in certificate.notes)
    assert [gains.instant for gains in certificate.frozen_gains] == ["start"]


def test_a_law_that_looks_at_its_step_has_a_loop_for_every_step():
    case = random_case(3, "Static", spacing="effective", gain=3.0)
    implicit = FactorySpec.of("sample_laws:Damped", kappa=1.5).build(layout=case.encoder.layout)
    case.law = implicit
    loop = theory.sampled_loop(case.scenario, implicit)
    assert len(loop.loops) > 1
    measured = case.play().estimate_distance
    for column, start in enumerate(case.start_errors()):
        predicted = theory.distance(loop.errors(start), World(case.scenario).game)
        np.testing.assert_allclose(measured[:, column], predicted, rtol=1e-6, atol=ROUNDING)


@pytest.mark.parametrize(
    ("target", "phrase"),
    [
        ("ptne_env.laws:CentralisedOracle", "is an oracle"),
        ("ptne_env.laws:ProjectedGradient", "remembers more than gains"),
        ("sample_laws:Sign", "not linear"),
    ],
)
def test_what_has_no_closed_loop_gets_no_numbers_of_one(target, phrase):
    certificate = theory.certify(get_scenario("energy"), law=FactorySpec.of(target))
    assert phrase in certificate.notes[0]
    assert (certificate.rate, certificate.digits_sampled, certificate.noise, certificate.delay) == (None,) * 4
    assert len(certificate.assumptions) == 4


def test_what_is_no_law_is_refused():
    with pytest.raises(ValueError, match="the theory is about"):
        theory.certify(get_scenario("energy"), law=FactorySpec.of("ptne_env.laws:RandomPolicy"))
