"""Faults of the players' own devices: sizes and statistics of their draws, true quantities beside them."""

import math

import numpy as np
import pytest
from scipy import stats
from worlds import begin

from ptne_env import FactorySpec, get_scenario
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import Interface
from ptne_env.world.faults import GradientNoise
from ptne_env.world.world import RANGE_LIMIT, World

FALSE_ALARM = 1e-6


def noisy(**arguments):
    return FactorySpec.of("sensor:noise", **arguments)


def pushes(**arguments):
    return FactorySpec.of("disturbance:uniform", **arguments)


def read(sensor, gradients, steps=50, seed=0):
    """Readings of the gradients (n,) in each step of 200 episodes, shape (steps, n, 200)."""
    keys = np.random.default_rng(seed).integers(0, 2**64, 200, dtype=np.uint64)
    table = np.repeat(np.array(gradients)[:, None], 200, axis=1)
    return np.array([sensor.read(table, keys, np.full(200, k)) for k in range(steps)])


def test_noise_is_normal_and_independent():
    gradients = np.array([0.0, 5.0, -40.0])
    noise = (read(GradientNoise(std=0.3), gradients) - gradients[:, None]) / 0.3
    assert stats.kstest(noise.ravel(), "norm").pvalue > FALSE_ALARM
    for axis in range(3):  # neighbours along steps, components and episodes are uncorrelated
        first, second = np.delete(noise, 0, axis), np.delete(noise, -1, axis)
        limit = stats.norm.isf(FALSE_ALARM / 2) / math.sqrt(first.size)
        assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < limit


def test_rounding_alone_is_exact_and_draws_nothing():
    sensor = GradientNoise(width=0.5)
    assert not sensor.is_random
    assert read(sensor, [0.2, 0.3, -7.6], steps=1)[0, :, 0].tolist() == [0.0, 0.5, -7.5]
    assert not World(get_scenario("energy", start="paper", sensor=noisy(width=0.5))).is_random


@pytest.mark.parametrize(
    ("field", "part", "message"),
    [
        ("sensor", noisy(std=-1), "std"),
        ("sensor", noisy(width=-0.1), "width"),
        ("sensor", pushes(bound=1.0), "where a Sensor is needed"),
        ("disturbance", pushes(bound=math.inf), "bound"),
        ("disturbance", pushes(bound=1.0, dwell=0), "dwell"),
        ("disturbance", noisy(), "where a Disturbance is needed"),
    ],
)
def test_invalid_faults_are_refused(field, part, message):
    with pytest.raises(ValueError, match=message):
        World(get_scenario("energy", **{field: part}))


def test_laws_see_the_sensor_and_oracles_see_the_truth():
    world = World(get_scenario("energy", sensor=noisy(std=2.0)))
    state = begin(world, [3])
    truth = world.game.own_gradients(state.estimates)
    assert np.abs(state.own_gradients - truth).min() > 1e-3
    oracle = make_encoder(world, Interface("full"))
    seen, select = oracle.observe(state)[0], oracle.layout.select
    np.testing.assert_allclose(select(seen, "own_gradient"), state.own_gradients, rtol=1e-6)
    exact = world.game.nash_equilibrium - state.estimates[:, :, 0].T
    np.testing.assert_allclose(select(seen, "relative_equilibrium"), exact, rtol=1e-6)


def test_readings_stay_within_the_range():
    state = begin(World(get_scenario("energy", sensor=noisy(std=1e9))), [0])
    assert np.abs(state.own_gradients).max() == RANGE_LIMIT
    assert not state.any_diverged


def test_a_sensor_draws_numbers_of_its_own():
    scenario = get_scenario(
        "random-energy-switching", channel=FactorySpec.of("channel:noise", std=0.1), disturbance=pushes(bound=1.0)
    )
    first, second = (begin(World(scenario.replace(sensor=sensor)), range(3)) for sensor in (None, noisy(std=1.0)))
    assert np.array_equal(first.estimates, second.estimates)
    assert np.array_equal(first.received.messages, second.received.messages)
    names = ("channel_keys", "disturbance_keys", "sensor_keys")
    for name in (*names, "modes"):
        assert np.array_equal(getattr(first.randomness, name), getattr(second.randomness, name))
    assert len(np.unique([getattr(second.randomness, name) for name in names])) == 9
