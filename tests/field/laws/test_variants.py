"""Locally implicit steps and the capped gain. Both are ours; their theorems are in their docstrings."""

import numpy as np
import pytest
from affine_games import SOAK, affine_scenario, loop_start, random_affine, run
from sample_laws import condition_on
from worlds import fixed_part, loop_matrix, stack, world_and_encoder

from ptne_env import get_scenario, laws, theory
from ptne_env.field import laws as field_laws
from ptne_env.theory.conditions import implicit_diagonal

STEPS = 10.0 ** np.linspace(-3, 7, 101)


def radius(matrix, diagonal, theta):
    return np.abs(np.linalg.eigvals(np.eye(len(matrix)) - matrix / (1 / theta + diagonal)[:, None])).max()


def build(scenario, **arguments):
    world, encoder = world_and_encoder(scenario)
    return world, field_laws.LocallyImplicit(encoder.layout, **arguments)


def loop_and_diagonal(world, law):
    """M and the diagonal of D."""
    graph = world.topology.graphs[0]
    return loop_matrix(world.game, graph.adjacency, law.kappa), implicit_diagonal(law, world.game.owners, graph)


@pytest.mark.parametrize("seed", range(30 if SOAK else 8))
def test_implicit_law_is_stable_for_every_step_where_its_condition_holds(seed):
    """The theorem of :class:`LocallyImplicit`, on random games that are not symmetric."""
    matrix, offset, adjacency = random_affine(np.random.default_rng(seed), 3 + seed % 4)
    scenario = affine_scenario(matrix, offset, fixed_part(adjacency))
    kappa = 1.01 * condition_on(scenario, laws.FixedGain).bound
    world, law = build(scenario, kappa=kappa, curvature=2 * np.linalg.norm(matrix, 2))
    assert theory.condition(law, theory.problem_constants(world)).holds
    loop, diagonal = loop_and_diagonal(world, law)
    for theta in STEPS:
        weight = np.sqrt(1 / theta + diagonal)
        contraction = np.eye(len(loop)) - loop / weight[:, None] / weight
        assert np.linalg.norm(contraction, 2) < 1  # in the norm of 1/Θ + D
    assert max(radius(loop, 0 * diagonal, theta) for theta in STEPS) > 1e6  # where explicit steps explode


def test_implicit_condition_says_no_where_some_step_is_unstable():
    """With m far below the own curvature the law does diverge, and the condition does not hold."""
    world, law = build("energy", curvature=0.1)
    assert not theory.condition(law, theory.problem_constants(world)).holds
    loop, diagonal = loop_and_diagonal(world, law)
    assert max(radius(loop, diagonal, theta) for theta in STEPS) > 1.05


@pytest.mark.parametrize("steps", [400, 40, 8, 2])
def test_implicit_law_in_the_environment_is_the_product_of_its_steps(steps):
    scenario = get_scenario("energy", start="random", steps=steps, input_limit=1e6)
    world, encoder = world_and_encoder(scenario)
    law, start = field_laws.LocallyImplicit(encoder.layout), loop_start(world)
    assert theory.condition(law, theory.problem_constants(world)).holds
    states = run(world, encoder, law, start)
    loop, diagonal = loop_and_diagonal(world, law)
    target = np.tile(world.game.nash_equilibrium, 5)
    error = stack(start.estimates) - target
    size = np.linalg.norm(error)
    for theta in world.clock.theta[:steps]:
        error = error - (loop @ error) / (1 / theta + diagonal)
    assert stack(states[-1]) - target == pytest.approx(error, abs=1e-6 * size)
    assert np.linalg.norm(error) < size


def test_coarse_steps_blow_the_static_law_up_and_not_the_implicit_one():
    world, encoder = world_and_encoder(get_scenario("energy", start="random", steps=40))
    start = loop_start(world)
    target = world.game.nash_equilibrium[:, None, None]
    distance = {
        law: np.linalg.norm(run(world, encoder, law(encoder.layout), start)[-1] - target)
        for law in (laws.Static, field_laws.LocallyImplicit)
    }
    assert distance[laws.Static] > 1e3
    assert distance[field_laws.LocallyImplicit] < 0.15 * np.linalg.norm(start.estimates - target)


def test_implicit_law_is_the_static_law_for_short_steps():
    world, encoder = world_and_encoder(get_scenario("energy", start="random", steps=100_000))
    observations = encoder.observe(loop_start(world))[0]
    implicit, _ = field_laws.LocallyImplicit(encoder.layout).predict(observations)
    static, _ = laws.Static(encoder.layout).predict(observations)
    assert implicit == pytest.approx(static, rel=3e-3)
    assert not np.array_equal(implicit, static)


def test_implicit_consensus_alone_is_stable_for_every_sequence_of_steps():
    generator = np.random.default_rng(0)
    for _ in range(20):
        adjacency = random_affine(generator, 6)[2]
        degree = adjacency.sum(axis=1)
        laplacian = np.diag(degree) - adjacency
        x = generator.normal(size=6)
        for theta in 10.0 ** generator.uniform(-2, 6, 50):
            moved = x - (laplacian @ x) / (1 / theta + degree)
            assert moved @ laplacian @ moved <= (x @ laplacian @ x) * (1 + 1e-9) + 1e-12
            x = moved


@pytest.mark.parametrize("cap", [1.0, 50.0, 1e6])
def test_capped_gain_is_the_static_law_in_the_time_that_the_cap_leaves(cap):
    scenario = get_scenario("energy", start="random")
    world, encoder = world_and_encoder(scenario)
    start, clock = loop_start(world), world.clock
    states = run(world, encoder, field_laws.CappedGain(encoder.layout, largest_gain=cap), start)
    loop = loop_matrix(world.game, world.topology.graphs[0].adjacency, 2.0)
    target = np.tile(world.game.nash_equilibrium, 5)
    error = stack(start.estimates) - target
    size = np.linalg.norm(error)
    for theta, dt in zip(clock.theta[: clock.steps], clock.dt[: clock.steps], strict=True):
        error = error - min(theta, cap * dt) * (loop @ error)
    assert stack(states[-1]) - target == pytest.approx(error, abs=2e-6 * size)


def test_capped_gain_lies_between_corollary_one_and_the_static_law():
    world, encoder = world_and_encoder("energy")
    observations = encoder.observe(loop_start(world))[0]
    for cap, law in {1.0: laws.CorollaryOne(encoder.layout, 2.0), 1e12: laws.Static(encoder.layout, 2.0)}.items():
        actions, _ = field_laws.CappedGain(encoder.layout, 2.0, cap).predict(observations)
        assert actions == pytest.approx(law.predict(observations)[0], rel=1e-6)


def test_capped_velocity_is_bounded_where_the_static_one_grows():
    """Erratum 3: at r < 1 the velocity g(t) u of the static law is unbounded as t → T."""
    world, encoder = world_and_encoder(get_scenario("energy", start="random", s_end=20.0, steps=1000))
    start, dt = loop_start(world), world.clock.dt[:1000, None, None, None]
    static = np.abs(np.diff(run(world, encoder, laws.Static(encoder.layout), start), axis=0) / dt)
    capped = np.abs(np.diff(run(world, encoder, field_laws.CappedGain(encoder.layout, 2.0, 100.0), start), axis=0) / dt)
    assert static[-1].max() > 100 * static[500].max()
    assert capped[-1].max() <= capped[500].max()


def test_capped_gain_asks_for_a_cap_above_c():
    scenario = get_scenario("energy")
    low = condition_on(scenario, field_laws.CappedGain, kappa=10.0, largest_gain=19.0)
    assert (low.value, low.bound, low.holds) == (19.0, 20.0, False)
    assert condition_on(scenario, field_laws.CappedGain, kappa=10.0, largest_gain=21.0).holds


@pytest.mark.parametrize(
    ("law", "arguments", "message"),
    [
        (field_laws.LocallyImplicit, {"damping": 0.5}, "damping must be at least 1"),
        (field_laws.LocallyImplicit, {"curvature": 0.0}, "curvature must be a finite number above 0"),
        (field_laws.CappedGain, {"largest_gain": 0.0}, "largest_gain .* must be a finite number above 0"),
    ],
)
def test_variants_refuse_parameters_out_of_range(law, arguments, message):
    with pytest.raises(ValueError, match=message):
        law(world_and_encoder("energy")[1].layout, **arguments)


def test_capped_gain_does_not_act_through_gains():
    with pytest.raises(ValueError, match="CappedGain needs action_mode='input'"):
        field_laws.CappedGain(world_and_encoder("energy", action_mode="gains")[1].layout)
