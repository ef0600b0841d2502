"""Ye & Hu's laws. The texts could not be read: the theorems are tested."""

import numpy as np
import pytest
from affine_games import loop_start, run
from worlds import BLOCKS, make_env, play, stack, world_and_encoder

from ptne_env import get_scenario, laws, theory
from ptne_env.world import dynamics


def test_twelve_digits_survive_float32_observations_and_actions():
    env = make_env("energy")
    states, steps = play(env, laws.Grounded(env.layout, kappa=2.0))
    equilibrium = env.nash_equilibrium
    scale = np.linalg.norm(equilibrium)
    assert np.linalg.norm(env.strategies - equilibrium) / scale < 1e-12
    assert np.linalg.norm(states[-1] - equilibrium) / (np.sqrt(5) * scale) < 1e-12
    assert all(action.dtype == np.float32 for action in steps[0][0].values())


def grounded_errors(estimates, adjacency, owners):
    """ξ^i_c = Σ_k a_ik (x^i_c − x^k_c) + a_ij (x^i_c − x^j_c) with j the owner of c; players are columns."""
    result = np.zeros_like(estimates)
    for c, j in enumerate(owners):
        for i in range(len(adjacency)):
            result[c, i] = adjacency[i] @ (estimates[c, i] - estimates[c])
            result[c, i] += adjacency[i, j] * (estimates[c, i] - estimates[c, j])
    return result


@pytest.mark.parametrize("scenario", [get_scenario("energy", start="random"), BLOCKS], ids=lambda world: world.name)
def test_adaptive_grounded_law_is_its_equation(scenario):
    world, encoder = world_and_encoder(scenario)
    law = laws.AdaptiveGrounded(encoder.layout, gamma=0.003, initial_gain=0.2)
    states = run(world, encoder, law, loop_start(world), steps=40)[..., 0]
    game, adjacency = world.game, world.topology.graphs[0].adjacency
    gains = np.full(states.shape[1:], 0.2)
    for k in range(40):
        theta, errors = world.clock.theta[k], grounded_errors(states[k], adjacency, game.owners)
        inputs = -gains * errors
        gradients = game.own_gradients(states[k][:, :, None])[:, 0]
        for component, owner in enumerate(game.owners):
            inputs[component, owner] = -gradients[component]
        assert states[k + 1] == pytest.approx(states[k] + theta * inputs, abs=2e-4)
        gains = gains + theta * 0.003 * errors**2


def test_gains_of_ye_and_hu_grow_until_the_network_converges():
    """The theorem of the node-based law: global convergence from gains of zero, which stay bounded."""
    scenario = get_scenario("energy", start="random", steps=4000, s_end=20.0, gain=60.0)
    world, encoder = world_and_encoder(scenario)
    law = laws.AdaptiveGrounded(encoder.layout, gamma=0.005, initial_gain=0.0)
    assert theory.condition(law, theory.problem_constants(world)).holds
    state, memory, history = loop_start(world), None, []
    for _ in range(world.clock.steps):
        actions, memory = law.predict(encoder.observe(state)[0], state=memory)
        state = dynamics.step(world, state, encoder.decode(actions[None], state))
        history.append(memory)
    history = np.array(history)
    assert np.all(np.diff(history, axis=0) >= 0)
    others = ~np.eye(5, dtype=bool)
    assert history[-1][others].min() > 0.01
    assert history[-1] == pytest.approx(history[3000], rel=1e-3)
    target = np.tile(world.game.nash_equilibrium, 5)
    assert np.linalg.norm(stack(state.estimates) - target) < 1e-3 * np.linalg.norm(target)
