"""Ye & Hu's laws. The texts could not be read: the theorems are tested."""

import numpy as np
import pytest
from affine_games import affine_scenario, loop_start, run
from worlds import BLOCKS, fixed_part, make_env, play, stack, world_and_encoder

from ptne_env import FactorySpec, get_scenario, laws, theory
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


def test_small_gradient_gain_converges_where_no_mode_is_connected():
    """The two players of erratum 2, whose link acts in every other dwell, against the multipliers of Floquet."""

    def matrix(delta, kappa, weight):  # of x_1, x_2, and of the estimates of x_2 by player 1 and of x_1 by player 2
        return np.array(
            [
                [-delta, 0, -10 * delta, 0],
                [0, -delta, 0, 10 * delta],
                [0, 2 * kappa * weight, -2 * kappa * weight, 0],
                [2 * kappa * weight, 0, 0, -2 * kappa * weight],
            ]
        )

    modes = tuple(fixed_part(weight * (np.ones((2, 2)) - np.eye(2))) for weight in (0.0, 1.0))
    topology = FactorySpec.of("topology:periodic", graphs=modes, dwells=(0.25, 0.25), clock="transformed")
    times = {"gain": 0.0, "steps": 3000, "s_end": 30.0, "input_limit": 1e9}
    world, encoder = world_and_encoder(affine_scenario([[1.0, 10.0], [-10.0, 1.0]], [0.0, 0.0], topology, **times))
    for delta in (0.06, 1.0):
        law = laws.Grounded(encoder.layout, kappa=20.0, gradient_gain=delta)
        steps = [np.eye(4) + 0.01 * matrix(delta, 20.0, weight) for weight in (0.0, 1.0)]
        period = np.linalg.matrix_power(steps[1], 25) @ np.linalg.matrix_power(steps[0], 25)
        assert (np.abs(np.linalg.eigvals(period)).max() < 1) == (delta < 1)
        states = run(world, encoder, law, loop_start(world), steps=3000 if delta < 1 else 200)[..., 0]
        vectors = states[:, (0, 1, 1, 0), (0, 1, 0, 1)]  # x_1, x_2, x^1_2, x^2_1
        expected = vectors[0]
        for mode in world.modes[: len(states) - 1]:
            expected = steps[mode] @ expected
        assert vectors[-1] == pytest.approx(expected, rel=1e-3, abs=1e-3 * np.abs(expected).max())
        assert (np.linalg.norm(expected) < 0.7 * np.linalg.norm(vectors[0])) == (delta < 1)
