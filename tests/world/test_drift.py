"""Drifts: the paths, the equilibrium of the drifting game, distances, rewards, metrics and saved states."""

import numpy as np
import pytest
from scipy import integrate
from worlds import begin, make_env

import ptne_env
from ptne_env import FactorySpec, get_scenario, laws, theory
from ptne_env.evaluation.metrics import METRICS
from ptne_env.evaluation.rollout import rollout
from ptne_env.field.games import RateControl
from ptne_env.games import EnergyGame, MovedGame
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import Interface
from ptne_env.world import distances, dynamics
from ptne_env.world.drift import ConstantVelocity, Sinusoid
from ptne_env.world.rewards import Reward
from ptne_env.world.world import World

VELOCITY = FactorySpec.of("ptne_env.world.drift:ConstantVelocity", speed=2.0)
KEYS = np.arange(4000, dtype=np.uint64)


def drifting(name="random-energy", drift=VELOCITY, **fields):
    return get_scenario(name, drift=drift, **{"steps": 60, **fields})


def test_constant_velocity_starts_and_ends_on_time():
    drift = ConstantVelocity(speed=2.0, start=0.5, end=0.8)
    early, half, late = (drift.offset(KEYS, np.full(KEYS.size, t), 3) for t in (0.5, 0.65, 5.0))
    assert not early.any()
    np.testing.assert_allclose(late, 2 * half, rtol=1e-12)
    velocity = late / 0.3
    assert -2 < velocity.min() < -1.99
    assert 1.99 < velocity.max() < 2
    assert np.abs(velocity.mean(axis=1)).max() < 6 * (2 / np.sqrt(3)) / np.sqrt(KEYS.size)
    assert np.abs(np.corrcoef(velocity) - np.eye(3)).max() < 6 / np.sqrt(KEYS.size)


def test_sinusoid_returns_after_each_period():
    drift = Sinusoid(amplitude=3.0, period=0.4)
    at = [drift.offset(KEYS, np.full(KEYS.size, t), 2) for t in (0.0, 0.1, 0.2, 0.3)]
    assert not at[0].any()
    assert 2.99 < np.abs(at[1]).max() < 3
    np.testing.assert_allclose(at[3], -at[1], rtol=1e-12)
    assert np.abs(at[2]).max() < 1e-14


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        (ConstantVelocity, {"speed": 0.0}),
        (ConstantVelocity, {"speed": 1.0, "start": -1.0}),
        (ConstantVelocity, {"speed": 1.0, "start": 2.0, "end": 2.0}),
        (Sinusoid, {"amplitude": -1.0, "period": 1.0}),
        (Sinusoid, {"amplitude": 1.0, "period": 0.0}),
    ],
)
def test_invalid_drifts_are_refused(kind, arguments):
    with pytest.raises(ValueError, match="speed|start|amplitude|period"):
        kind(**arguments)


@pytest.mark.parametrize("name", ["random-energy", "non-quadratic"])
def test_the_equilibrium_moves_with_the_game(name):
    world = World(drifting(name, start="random"))
    state = begin(world, range(3))
    still = np.broadcast_to(state.game.game.nash_equilibria, (5, 3))
    assert np.array_equal(state.game.nash_equilibria, still)
    for _ in range(25):
        state = dynamics.step(world, state, np.zeros_like(state.estimates))
    offset = world.drift.offset(state.randomness.drift_keys, world.clock.t[state.step], 5)
    assert np.abs(offset).min() > 0
    np.testing.assert_allclose(state.game.nash_equilibria, still + offset)
    np.testing.assert_allclose(state.game.pseudo_gradient(state.game.nash_equilibria), 0, atol=1e-8)
    at_rest = np.repeat(state.game.nash_equilibria[:, None], 5, axis=1)
    assert distances.estimate_distance(at_rest, state.game).max() == 0
    np.testing.assert_array_equal(state.game.equilibrium_scale, state.game.game.equilibrium_scale)
    np.testing.assert_allclose(state.own_gradients, state.game.game.own_gradients(state.estimates - offset[:, None]))


def test_a_moved_game_has_the_costs_and_best_responses_of_its_original():
    original = EnergyGame()
    offset, x = np.arange(5.0)[:, None], np.random.default_rng(0).normal(size=(5, 1))
    moved = MovedGame(original, offset)
    np.testing.assert_array_equal(moved.costs(x + offset), original.costs((x + offset) - offset))
    np.testing.assert_allclose(moved.best_response(x + offset), original.best_response(x) + offset)
    np.testing.assert_allclose(moved.regrets(x + offset), original.regrets(x), rtol=1e-9)
    np.testing.assert_array_equal(moved.jacobian(x), original.jacobian(x))
    assert moved.regrets(moved.nash_equilibria).max() < 1e-9
    with pytest.raises(TypeError, match="merges with moved games"):
        moved.merged(original, np.array([True]))


def test_a_game_with_a_box_does_not_drift():
    with pytest.raises(ValueError, match="RateControl has a box, and only games without bounds can drift"):
        World(drifting("energy", game="ptne_env.field.games:RateControl"))
    with pytest.raises(ValueError, match="has a box and cannot move"):
        MovedGame(RateControl(), np.zeros((5, 1)))


def test_rewards_measure_the_distance_to_the_moving_equilibrium():
    world = World(drifting())
    state = begin(world, range(2))
    reward = Reward(world, {"digits": 1.0, "tracking": 1.0})
    reward.reset(state)
    later = dynamics.step(world, state, np.zeros_like(state.estimates))
    terms = reward.step(later)
    now = distances.player_distances(later.estimates, later.game)
    np.testing.assert_allclose(terms["tracking"], -now)
    before = distances.player_distances(state.estimates, state.game)
    np.testing.assert_allclose(terms["digits"], np.log10(before / now), rtol=1e-9)
    assert np.abs(terms["digits"]).min() > 0  # nothing moved but the game


def test_a_saved_state_continues_the_drift():
    env = make_env("random-energy", steps=20, drift=VELOCITY)
    env.reset(seed=4)
    rest = {agent: np.zeros(env.action_space(agent).shape, dtype=np.float32) for agent in env.agents}
    for _ in range(5):
        env.step(rest)
    saved = env.get_state()
    env.step(rest)
    expected = env.nash_equilibrium
    env.set_state(saved)
    env.step(rest)
    assert np.array_equal(env.nash_equilibrium, expected)


def test_a_state_of_a_game_at_rest_is_refused():
    moving, resting = World(drifting()), World(get_scenario("random-energy", steps=60))
    noisy = World(get_scenario("random-energy", steps=60, sensor="ptne_env.world.sensor:GradientNoise"))
    for world, other in ((moving, resting), (resting, moving), (noisy, moving)):
        with pytest.raises(ValueError, match="of another world: its drift"):
            dynamics.require_state(world, begin(other, [0]), 1)


@pytest.mark.parametrize("hold_steps", [0, 20])
def test_tracking_digits_are_the_mean_distance_over_the_second_half(hold_steps):
    world = World(drifting(hold_steps=hold_steps))
    encoder = make_encoder(world, Interface("physical"))
    played = rollout(laws.Static(encoder.layout), encoder, begin(world, range(4)))
    clock, distance = world.clock, played["estimate_distance"]
    kept = clock.t >= (clock.deadline - 1e-12 if hold_steps else clock.deadline / 2)
    if hold_steps:
        kept = np.arange(clock.t.size) >= clock.steps
    span = clock.t[kept][-1] - clock.t[kept][0]
    expected = -np.log10(integrate.trapezoid(distance[kept], clock.t[kept], axis=0) / span)
    np.testing.assert_allclose(METRICS["tracking_digits"].value(played), expected)
    at_rest = World(get_scenario("random-energy", steps=60))
    encoder = make_encoder(at_rest, Interface("physical"))
    still = rollout(laws.Static(encoder.layout), encoder, begin(at_rest, range(4)))
    assert np.isnan(METRICS["tracking_digits"].value(still)).all()


def test_digits_count_from_the_equilibrium_at_the_deadline():
    world = World(drifting(start="random"))
    encoder = make_encoder(world, Interface("physical"))
    last = []
    played = rollout(
        laws.Static(encoder.layout), encoder, begin(world, range(3)), watch=lambda state, _: last.append(state)
    )
    final = last[world.clock.steps]
    offset = world.drift.offset(final.randomness.drift_keys, np.full(3, world.clock.t[world.clock.steps]), 5)
    target = final.game.game.nash_equilibria + offset
    error = np.linalg.norm(final.estimates - target[:, None], axis=(0, 1)) / np.sqrt(5)
    expected = -np.log10(error / np.linalg.norm(final.game.game.nash_equilibria, axis=0))
    np.testing.assert_allclose(METRICS["digits"].value(played), expected)


def test_a_diverged_episode_is_no_nearer_than_one_in_range():
    game = MovedGame(EnergyGame(), np.full((5, 1), 1e5))
    farthest = np.full((5, 5, 1), -dynamics.RANGE_LIMIT)
    assert dynamics.distance_limit(game) >= distances.player_distances(farthest, game).max()


@pytest.mark.parametrize("part", ["sensor", "drift"])
def test_certificates_say_that_they_leave_out_the_part(part):
    spec = {"sensor": FactorySpec.of("ptne_env.world.sensor:GradientNoise", std=0.1), "drift": VELOCITY}[part]
    certificate = theory.certify(get_scenario("energy", **{part: spec}))
    assert certificate.digits_are_exact is False
    assert f"no prediction includes the {part} {spec.target.rpartition(':')[2]}" in certificate.notes
    assert any("at rest" in note for note in certificate.notes) == (part == "drift")


def test_pictures_follow_the_equilibrium():
    pytest.importorskip("matplotlib")
    from ptne_env.envs.rendering import Renderer

    world = World(drifting())
    state = begin(world, [0])
    renderer = Renderer(world, "rgb_array")
    renderer.reset(state)
    targets = [state.game.nash_equilibria[:, 0]]
    for _ in range(5):
        state = dynamics.step(world, state, np.zeros_like(state.estimates))
        renderer.record(state)
        targets.append(state.game.nash_equilibria[:, 0])
    renderer.update()
    shown = np.array([line.get_ydata() for line in renderer._artists.targets])
    np.testing.assert_array_equal(shown, np.transpose(targets))


def test_runs_of_drifting_games_are_reproducible():
    runs = [
        ptne_env.evaluate(["static"], [drifting().replace(name="drifting")], episodes=3, seed=seed, against_laws=False)
        for seed in (1, 1, 2)
    ]
    first, again, other = (run.samples["drifting", "static"]["tracking_digits"] for run in runs)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
