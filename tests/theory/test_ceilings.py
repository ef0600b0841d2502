"""Ceilings against policies that know everything, which come close to them and never get above them."""

import numpy as np
import pytest

from ptne_env import FactorySpec, get_scenario
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.laws import Static
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import Interface
from ptne_env.theory import ceilings
from ptne_env.world import dynamics
from ptne_env.world.distances import digits, estimate_distance
from ptne_env.world.dynamics import initial_state
from ptne_env.world.world import World

EPISODES = EpisodeSet(300)
ENERGY = get_scenario("random-energy")


def world_of(**changes):
    return World(ENERGY.replace(**changes))


def at_equilibrium(world, episodes=EPISODES):
    """The start, with all estimates at x*."""
    start = episodes.initial_state(world)
    estimates = np.repeat(start.game.nash_equilibria[:, None], world.game.num_players, axis=1)
    return initial_state(world, estimates, start.game, start.randomness)


def measured(state):
    return digits(estimate_distance(state.estimates, state.game))


def test_a_policy_at_full_speed_reaches_exactly_the_ceiling_of_limited_inputs():
    world = world_of(input_limit=0.8, steps=100)
    start = state = EPISODES.initial_state(world)
    for step in range(world.clock.steps):
        error = state.game.nash_equilibria[:, None] - state.estimates
        state = dynamics.step(world, state, np.clip(error / world.theta[step], -0.8, 0.8))
    bound = ceilings.reach_digits(world, start, world.clock.steps)
    assert 0.9 < np.isfinite(bound).mean() <= 1
    np.testing.assert_allclose(measured(state), np.minimum(bound, 12), rtol=1e-9)


def test_an_input_limit_that_lets_all_estimates_arrive_is_no_ceiling():
    world = world_of()
    assert np.isinf(ceilings.reach_digits(world, EPISODES.initial_state(world), world.clock.steps)).all()


def test_the_nearest_of_several_equilibria_bounds_the_reach():
    world = world_of(game=FactorySpec.of("ptne_env.field.games:RandomCoordination"), input_limit=1e-9)
    start = EPISODES.initial_state(world)
    np.testing.assert_allclose(ceilings.reach_digits(world, start, 400), measured(start), rtol=1e-6)


def test_a_policy_at_the_equilibrium_has_the_digits_of_the_last_push():
    pushes = FactorySpec.of("ptne_env.world.disturbances:UniformDisturbance", bound=3.0, dwell=1)
    world = world_of(disturbance=pushes)
    state = at_equilibrium(world)
    found = measured(dynamics.step(world, state, np.zeros_like(state.estimates)))
    assert found.mean() == pytest.approx(ceilings.push_digits(world, state, 1).mean(), abs=0.02)


@pytest.mark.parametrize(("dwell", "instant", "is_bound"), [(1, 5, True), (5, 6, True), (5, 5, False), (5, 7, False)])
def test_a_push_that_was_drawn_in_an_earlier_step_is_no_ceiling(dwell, instant, is_bound):
    pushes = FactorySpec.of("ptne_env.world.disturbances:UniformDisturbance", bound=3.0, dwell=dwell)
    world = world_of(disturbance=pushes)
    bound = ceilings.push_digits(world, EPISODES.initial_state(world), instant)
    assert np.isfinite(bound).all() == is_bound


def test_pushes_after_the_deadline_are_no_ceiling_at_the_deadline():
    arguments = {"bound": 3.0, "dwell": 1, "after_deadline_only": True}
    pushes = FactorySpec.of("ptne_env.world.disturbances:UniformDisturbance", **arguments)
    world = world_of(disturbance=pushes, hold_steps=5)
    state = EPISODES.initial_state(world)
    assert np.isinf(ceilings.push_digits(world, state, world.clock.steps)).all()
    assert np.isfinite(ceilings.push_digits(world, state, world.clock.total_steps)).all()


def test_static_teammates_at_the_equilibrium_have_the_digits_of_their_last_noise():
    noise = FactorySpec.of("ptne_env.world.channel:AdditiveNoise", std=0.05)
    graphs = FactorySpec.of("ptne_env.world.switching:random_graphs", players=5, probability=0.5)
    world = world_of(channel=noise, topology=graphs)
    state, encoder = at_equilibrium(world), make_encoder(world, Interface())
    law = Static(encoder.layout, kappa=3.0)
    observations = encoder.observe(state)
    actions = law.predict(observations.reshape(-1, encoder.layout.size))[0].reshape(*observations.shape[:2], -1)
    actions[:, [0, 2, 4]] = 0.0
    found = measured(dynamics.step(world, state, encoder.inputs(actions, state)))
    bound = ceilings.teammate_digits(world, state, 1, (1, 3), 3.0)
    assert found.mean() == pytest.approx(bound.mean(), abs=0.02)
    assert np.isinf(ceilings.teammate_digits(world_of(), state, 1, (1, 3), 3.0)).all()


def test_the_best_estimate_from_noisy_gradients_stays_at_the_ceiling_of_sensors():
    std, readings = 0.5, 100
    world = world_of(sensor=FactorySpec.of("ptne_env.world.sensor:GradientNoise", std=std))
    state = EPISODES.initial_state(world)
    game, noise = state.game, np.random.default_rng(1).normal(size=(5, 300)) * std / np.sqrt(readings)
    inverse = np.linalg.inv(np.moveaxis(game.jacobian(game.nash_equilibria), 2, 0))
    estimate = game.nash_equilibria + np.einsum("bij,jb->ib", inverse, noise)
    found = digits(estimate_distance(np.repeat(estimate[:, None], 5, axis=1), game))
    bound = ceilings.sensor_digits(world, state, readings).mean()
    assert bound - 0.04 < found.mean() < bound + 0.02
    assert np.isinf(ceilings.sensor_digits(world_of(), state, readings)).all()


@pytest.mark.parametrize("topology", ["ptne_env.world.switching:paper_topology", "path"])
def test_a_private_number_moves_an_estimate_in_the_step_after_its_news_arrive(topology):
    path = FactorySpec.of("ptne_env.world.graphs:path", players=5)
    fixed = FactorySpec.of("ptne_env.world.switching:fixed", graph=path)
    world = world_of(topology=fixed if topology == "path" else FactorySpec.of(topology), steps=80)
    start = EpisodeSet(1).initial_state(world)
    encoder = make_encoder(world, Interface())
    law, paths = Static(encoder.layout), []
    targets = start.game.target + 5 * np.eye(5)[:, :, None].repeat(1, axis=2)
    for target in [start.game.target, *targets]:
        game = type(start.game)(start.game.curvature, target, start.game.coupling)
        state, estimates = initial_state(world, start.estimates, game), []
        for _ in range(60):
            actions = law.predict(encoder.observe(state).reshape(5, -1))[0]
            state = dynamics.step(world, state, encoder.inputs(actions[None], state))
            estimates.append(state.estimates[:, :, 0])
        paths.append(np.array(estimates))
    moved = np.any(np.array(paths[1:]) != paths[0], axis=2)  # owner, instant, hearer
    assert moved.any(axis=1).all()
    np.testing.assert_array_equal(moved.argmax(axis=1), ceilings.news_steps(world, start)[0])


def test_a_policy_that_knows_all_that_it_can_stays_below_the_ceiling_of_missing_news():
    path = FactorySpec.of("ptne_env.world.graphs:path", players=5)
    world = world_of(topology=FactorySpec.of("ptne_env.world.switching:fixed", graph=path))
    state = EPISODES.initial_state(world)
    bound = ceilings.news_digits(world, state, 4)
    assert np.isfinite(bound).all()
    assert np.isinf(ceilings.news_digits(world, state, 5)).all()
    # Player 4 misses b_0 alone, and player 0 misses b_4 alone: both assume the middle of its range.
    estimates = np.repeat(state.game.nash_equilibria[:, None], 5, axis=1)
    for hearer, owner in ((4, 0), (0, 4)):
        target = state.game.target.copy()
        target[owner] = 20.0
        game = type(state.game)(state.game.curvature, target, state.game.coupling)
        estimates[:, hearer] = game.nash_equilibria
    found = digits(estimate_distance(estimates, state.game))
    assert bound.mean() - 0.6 < found.mean() < bound.mean()


def test_messages_carry_more_bits_than_ceilings_need():
    noise = FactorySpec.of("ptne_env.world.channel:AdditiveNoise", std=0.05).build()
    levels = FactorySpec.of("ptne_env.world.channel:UniformQuantiser", width=0.5).build()
    assert ceilings.message_bits(noise) == pytest.approx(np.log2(1e7), abs=1e-6)
    assert ceilings.message_bits(levels) == pytest.approx(np.log2(2e6 + 1))
    chain = FactorySpec.of("ptne_env.world.channel:perfect").build()
    assert ceilings.message_bits(chain) == 32


def test_the_ceiling_names_the_bounds_that_hold_somewhere():
    world = world_of(input_limit=0.8)
    state = EPISODES.initial_state(world)
    assert set(ceilings.ceiling(world, state, 400)) == {"reach"}
    assert ceilings.ceiling(world_of(), EPISODES.initial_state(world_of()), 400) == {}
    with pytest.raises(ValueError, match="kappa"):
        ceilings.ceiling(world, state, 400, teammates=(1,), kappa=-1.0)
