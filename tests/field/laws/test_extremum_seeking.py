"""Frihauf, Krstić & Başar's extremum seeking.

Beyond its abstract the paper's text could not be read: the tests show its theorem for quadratic games (convergence of
the averaged loop to within the probing's size, by averaging) under the law's conditions.
"""

from itertools import pairwise

import numpy as np
import pytest
from affine_games import SOAK, affine_scenario, loop_start, run
from sample_laws import condition_on
from scipy import linalg
from worlds import begin, fixed_part, make_env, world_and_encoder

from ptne_env import Interface, get_scenario
from ptne_env.field import laws as field_laws
from ptne_env.world import dynamics

MATRIX = np.array([[2.0, 0.5, -0.4], [0.3, 1.5, 0.6], [-0.5, 0.2, 1.8]])
OFFSET = np.array([1.0, -2.0, 0.5])
PATH = np.array([[0.0, 1, 0], [1, 0, 1], [0, 1, 0]])


def probing_world(steps, **fields):
    scenario = affine_scenario(MATRIX, OFFSET, fixed_part(PATH), steps=steps, **fields)
    return scenario, *world_and_encoder(scenario, own_payoff=True)


def mean_strategies(world, law, states):
    """x̂ = x − μ at every instant, (K+1, n)."""
    tau = np.concatenate([[0.0], np.cumsum(world.clock.theta[: world.clock.steps])])
    return states[:, range(3), range(3), 0] - law.amplitude * np.sin(tau[:, None] * law.frequencies), tau


def test_faster_probing_follows_the_averaged_loop_more_closely():
    """dx̂/dτ = −(k a²/2) F(x̂), with a deviation that shrinks like 1/ω: the averaging theorem."""
    deviations = []
    for frequency in (10.0, 40.0, 160.0) if SOAK else (10.0, 40.0):
        scenario, world, encoder = probing_world(int(800 * frequency / 10))
        arguments = {"amplitude": 0.4, "gain": 1.0, "frequency": frequency, "washout": 0.0}
        assert condition_on(scenario, field_laws.ExtremumSeeking, **arguments).holds
        law = field_laws.ExtremumSeeking(encoder.layout, **arguments)
        states = run(world, encoder, law, loop_start(world, size=2.0))
        means, tau = mean_strategies(world, law, states)
        target = world.game.nash_equilibrium
        rate = 1.0 * 0.4**2 / 2
        decay = np.stack([linalg.expm(-rate * MATRIX * time) for time in tau[::100]])
        averaged = target + decay @ (means[0] - target)
        deviations.append(np.abs(means[::100] - averaged).max())
        assert np.abs(means[-1] - target).max() < 3 * deviations[-1] + np.abs(averaged[-1] - target).max()
    assert all(slower > 3 * faster for slower, faster in pairwise(deviations))  # 4 in the limit
    assert deviations[-1] < 0.4 / frequency * 4


def test_strategies_end_within_the_probing_of_the_equilibrium():
    _, world, encoder = probing_world(4000)
    law = field_laws.ExtremumSeeking(encoder.layout, amplitude=0.3, gain=4.0, frequency=40.0, washout=2.0)
    states = run(world, encoder, law, loop_start(world, size=2.0))
    strategies = states[-400:, range(3), range(3), 0]
    target = world.game.nash_equilibrium
    assert np.abs(strategies - target).max() < 0.3 + 0.05
    assert np.abs(strategies.mean(axis=0) - target).max() < 0.03
    assert np.abs(strategies[0] - target).max() > 0.05  # it goes on probing


def test_it_reads_neither_gradients_nor_estimates_for_its_strategies():
    _, world, encoder = probing_world(4000)
    observations = encoder.observe(loop_start(world))[0]
    law = field_laws.ExtremumSeeking(encoder.layout)
    actions, memory = law.predict(observations)
    blind = observations.copy()
    for name in ("own_gradient", "own_estimate", "relative_estimates", "weights"):
        encoder.layout.select(blind, name)[...] = 7.0
    blind_actions, blind_memory = law.predict(blind)
    assert np.array_equal(actions.diagonal(), blind_actions.diagonal())
    assert np.array_equal(memory, blind_memory)


def test_frequencies_satisfy_the_conditions_of_the_paper():
    frequencies = field_laws.ExtremumSeeking(world_and_encoder("energy", own_payoff=True)[1].layout).frequencies
    assert np.all((frequencies > 9) & (frequencies < 18))
    for i, first in enumerate(frequencies):
        for j, second in enumerate(frequencies):
            assert abs(2 * first - second) > 0.1
            if i != j:
                assert abs(first - second) > 0.1
                assert np.abs(frequencies - (first + second)).min() > 0.1


def test_conditions_of_extremum_seeking():
    scenario = probing_world(400)[0]
    found = condition_on(scenario, field_laws.ExtremumSeeking)
    assert found.value == pytest.approx(min(2 - 0.9, 1.5 - 0.9, 1.8 - 0.7))
    assert found.holds
    fast = condition_on(scenario, field_laws.ExtremumSeeking, frequency=30.0)
    assert "4 ω Θ < π" in fast.name
    assert not fast.holds
    weak = affine_scenario(MATRIX - np.diag([1.5, 0, 0]), OFFSET, fixed_part(PATH))
    assert condition_on(weak, field_laws.ExtremumSeeking).value == pytest.approx(0.5 - 0.9)


def test_default_gains_improve_the_energy_game_by_a_digit():
    world, encoder = world_and_encoder(get_scenario("energy", start="random"), own_payoff=True)
    states = run(world, encoder, field_laws.ExtremumSeeking(encoder.layout), loop_start(world))
    error = np.linalg.norm(states[:, range(5), range(5), 0] - world.game.nash_equilibrium, axis=1)
    assert error[-1] < 0.1 * error[0]


def test_it_refuses_a_layout_without_payoffs():
    with pytest.raises(ValueError, match=r"ExtremumSeeking reads own_payoff, which the layout .* own_payoff=True"):
        field_laws.ExtremumSeeking(world_and_encoder("energy")[1].layout)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"amplitude": 0.0}, "amplitude must be a finite number above 0"),
        ({"gain": -1.0}, "gain must be a finite number above 0"),
        ({"frequency": 0.0}, "frequency must be a finite number above 0"),
        ({"washout": -1.0}, "washout must be a finite number of at least 0"),
    ],
)
def test_extremum_seeking_refuses_parameters_out_of_range(arguments, message):
    with pytest.raises(ValueError, match=message):
        field_laws.ExtremumSeeking(world_and_encoder("energy", own_payoff=True)[1].layout, **arguments)


@pytest.mark.parametrize("kind", ["physical", "local", "full"])
@pytest.mark.parametrize("scenario", ["energy", "random-energy", "non-quadratic"])
def test_own_payoff_is_a_last_slice_with_the_cost_at_the_real_strategies(scenario, kind):
    plain = world_and_encoder(scenario, kind=kind)[1]
    world, encoder = world_and_encoder(scenario, kind=kind, own_payoff=True)
    state = begin(world, range(3))
    seen, without = encoder.observe(state), plain.observe(begin(plain.world, range(3)))
    assert encoder.layout.slices["own_payoff"] == slice(plain.layout.size, plain.layout.size + 1)
    assert np.array_equal(seen[..., :-1], without)
    expected = state.game.costs(dynamics.strategies(world, state)).T
    assert np.array_equal(encoder.layout.select(seen, "own_payoff")[..., 0], expected.astype(np.float32))
    assert np.array_equal(encoder.layout.read(seen[0]).own_payoff[:, 0], expected.astype(np.float32)[0])
    assert encoder.layout.observation_space().contains(seen[0, 0])


def test_payoffs_are_left_out_unless_asked_for():
    assert not Interface().own_payoff
    assert "own_payoff" not in world_and_encoder("energy")[1].layout.slices
    env = make_env("energy", own_payoff=True)
    observations, _ = env.reset(seed=0)
    rows = np.stack(list(observations.values()))
    assert np.array_equal(
        env.layout.select(rows, "own_payoff")[:, 0],
        env.world.game.costs(env.strategies[:, None])[:, 0].astype(np.float32),
    )
