"""De Persis & Grammatico's averaging integral law. The paper's text could not be read: its theorem is tested."""

import numpy as np
import pytest
from affine_games import affine_scenario, loop_start, run
from sample_laws import condition_on
from worlds import fixed_part, world_and_encoder

from ptne_env import laws, theory
from ptne_env.world import dynamics

# A strongly monotone game (ε = 1) between two players whose estimates a weak link does not hold together.
ROTATION = np.array([[1.0, 6.0], [-6.0, 1.0]])
LINK = np.array([[0.0, 1.0], [1.0, 0.0]])


def rotating(**fields):
    return affine_scenario(ROTATION, np.array([1.0, 2.0]), fixed_part(LINK), **fields)


def test_it_is_the_adaptive_law_from_gains_of_zero():
    world, encoder = world_and_encoder("energy")
    start = loop_start(world)
    mine = run(world, encoder, laws.AveragingIntegral(encoder.layout, gamma=0.02), start)
    assert np.array_equal(mine, run(world, encoder, laws.Adaptive(encoder.layout, 0.02, 0.0), start))


def test_integral_gains_converge_without_a_bound_that_fixed_gains_need():
    """Their theorem: convergence for every connected graph, without λ2 or ι. A small fixed gain diverges here."""
    scenario = rotating(steps=4000, s_end=20.0)
    assert condition_on(scenario, laws.AveragingIntegral).holds
    world, encoder = world_and_encoder(scenario)
    game, graph, small = world.game, world.topology.graphs[0], 0.5
    assert not condition_on(scenario, laws.FixedGain, kappa=small).holds
    assert theory.spectral_abscissa(theory.closed_loop_matrix(game, graph, small)) < 0
    start, target = loop_start(world, size=5.0), game.nash_equilibrium[:, None, None]
    distance = {
        name: [np.linalg.norm(state - target) for state in run(world, encoder, law, start)[[0, -1]]]
        for name, law in {
            "fixed": laws.Static(encoder.layout, small),
            "integral": laws.AveragingIntegral(encoder.layout, gamma=1.0),
        }.items()
    }
    assert distance["fixed"][1] > 10 * distance["fixed"][0]
    assert distance["integral"][1] < 1e-3 * distance["integral"][0]


def test_gains_grow_and_rest():
    scenario = rotating(steps=4000, s_end=20.0)
    world, encoder = world_and_encoder(scenario)
    law, state = laws.AveragingIntegral(encoder.layout, gamma=1.0), loop_start(world, size=5.0)
    memory, history = None, []
    for _ in range(world.clock.steps):
        actions, memory = law.predict(encoder.observe(state)[0], state=memory)
        state = dynamics.step(world, state, encoder.decode(actions[None], state))
        history.append(memory[:, 0])
    history = np.array(history)
    assert np.all(np.diff(history, axis=0) >= 0)
    assert history[:, 0] == pytest.approx(history[:, 1], rel=1e-5)  # k_ij = k_ji without a message
    assert history[-1] == pytest.approx(history[3000], rel=1e-4)
    assert history[-1].min() > 1


def test_condition_asks_for_gains_that_adapt():
    found = condition_on("energy", laws.AveragingIntegral, gamma=0.0)
    assert "γ > 0" in found.name
    assert not found.holds
