"""Best-response play, fixed-time seeking, and node gains that need two hops.

The texts of Poveda, Krstić & Başar and of Bianchi & Grammatico could not be read: their theorems are tested under the
laws' conditions.
"""

import numpy as np
import pytest
from affine_games import affine_scenario, loop_start, random_affine, run
from sample_laws import condition_on
from scipy import integrate
from worlds import BLOCKS, fixed_part, stack, world_and_encoder

from ptne_env import Interface, get_scenario, laws, theory
from ptne_env.theory.conditions import settling_bound
from ptne_env.world import dynamics

ORACLES = [laws.BestResponseOracle, laws.FixedTimeOracle, laws.NodeAdaptiveOracle]


def build(scenario, law, **arguments):
    world, _ = world_and_encoder(scenario)
    encoder = world_and_encoder(scenario, kind="full", **dict.fromkeys(law.needs, True))[1]
    assert encoder.interface == law.interface
    return world, encoder, law(encoder.layout, **arguments)


@pytest.mark.parametrize("law", ORACLES)
def test_oracles_are_named_oracles_and_refuse_players_interfaces(law):
    assert law.__name__.endswith("Oracle")
    assert law.needs_full_information
    for kind in ("physical", "local"):
        with pytest.raises(ValueError, match=f"{law.__name__} is an oracle and needs the interface 'full'"):
            law(world_and_encoder("energy", kind=kind)[1].layout)


@pytest.mark.parametrize("law", [laws.BestResponseOracle, laws.NodeAdaptiveOracle])
def test_oracles_name_the_missing_slice(law):
    with pytest.raises(ValueError, match=f"{law.__name__} reads {law.needs[0]}, which the layout of .* lacks"):
        law(world_and_encoder("energy", kind="full")[1].layout)


@pytest.mark.parametrize("name", ["neighbour_errors", "best_response"])
def test_slices_of_oracles_are_not_for_players(name):
    with pytest.raises(ValueError, match=f"{name} is for oracles: it needs the interface 'full', got 'physical'"):
        Interface(**{name: True})


@pytest.mark.parametrize("scenario", [get_scenario("energy", start="random"), BLOCKS], ids=lambda world: world.name)
def test_best_response_play_is_its_equation(scenario):
    world, encoder, law = build(scenario, laws.BestResponseOracle, relaxation=0.7)
    start = loop_start(world)
    states = run(world, encoder, law, start, steps=20)
    x = dynamics.strategies(world, start)
    for state in states[1:]:
        x = x + 0.7 * (world.game.best_response(x) - x)
        assert state[..., 0] == pytest.approx(np.tile(x, (1, state.shape[1])), abs=1e-4)


@pytest.mark.parametrize("seed", range(20))
def test_best_response_play_converges_exactly_where_its_condition_holds(seed):
    """On an affine game x ← BR(x) is linear and converges exactly where its spectral radius is below 1."""
    generator = np.random.default_rng(seed)
    matrix, offset, adjacency = random_affine(generator, 4, coupling=generator.uniform(0.5, 5.0))
    scenario = affine_scenario(matrix, offset, fixed_part(adjacency), start="random", input_limit=1e5, steps=60)
    world, encoder, law = build(scenario, laws.BestResponseOracle)
    states = run(world, encoder, law, loop_start(world))[:, :, 0, 0]
    found = theory.condition(law, theory.problem_constants(world))
    error = np.abs(states - world.game.nash_equilibrium).max(axis=1)
    if found.value < 0.9:
        assert error[-1] < 0.1 * error[1]
    elif found.value > 1.1:
        assert error[-1] > 10 * error[1]
    assert found.holds == (found.value < 1)


def test_the_condition_holds_on_some_of_these_games_and_fails_on_others():
    values = []
    for seed in range(20):
        generator = np.random.default_rng(seed)
        matrix, offset, adjacency = random_affine(generator, 4, coupling=generator.uniform(0.5, 5.0))
        scenario = affine_scenario(matrix, offset, fixed_part(adjacency))
        values.append(condition_on(scenario, laws.BestResponseOracle).value)
    assert sum(value < 0.9 for value in values) > 3
    assert sum(value > 1.1 for value in values) > 3


@pytest.mark.parametrize(("size", "exponents"), [(1.0, (0.5, -0.5)), (1e2, (0.3, -0.8)), (1e4, (0.5, -0.5))])
def test_fixed_time_seeking_settles_within_its_bound_from_every_start(size, exponents):
    """The theorem of Poveda, Krstić & Başar: a settling time that does not depend on the start."""
    near, far = exponents
    scenario = get_scenario("energy", start="random", steps=20_000, gain=1.0, input_limit=1e9)
    world, encoder, law = build(scenario, laws.FixedTimeOracle, near=near, far=far)
    constants = theory.problem_constants(world)
    bound = settling_bound(law, constants.epsilon)
    assert theory.condition(law, constants).holds
    settled = int(np.searchsorted(np.cumsum(world.clock.theta), bound))
    state = loop_start(world, size=size)
    states = run(world, encoder, law, state, steps=settled + 10)[..., 0]
    error = np.linalg.norm(states[:, range(5), range(5)] - world.game.nash_equilibrium, axis=1)
    assert error[settled] < 1e-3
    assert error[int(settled * 0.1)] > 1e-2


def test_fixed_time_bound_exceeds_the_integral_of_its_comparison_equation():
    """dr/dτ = −k ε (r^{1−ξ1} + r^{1−ξ2}) from r = ∞ reaches 0 no later than the bound, and after half of it."""
    law = build("energy", laws.FixedTimeOracle, gain=2.0, near=0.4, far=-0.6)[2]
    r = np.geomspace(1e-12, 1e12, 400_001)
    time = integrate.trapezoid(1 / (2.0 * 1.5 * (r**0.6 + r**1.6)), r)
    assert 0.5 * settling_bound(law, 1.5) < time < settling_bound(law, 1.5)


def test_fixed_time_condition_names_the_failing_part():
    scenario = get_scenario("energy")
    assert condition_on(scenario, laws.FixedTimeOracle).holds
    slow = condition_on(scenario, laws.FixedTimeOracle, gain=0.01)
    assert (slow.name, slow.holds) == ("(1/ξ1 + 1/|ξ2|)/(k ε) < τ_K", False)
    long = condition_on(scenario, laws.FixedTimeOracle, largest_step=1.0)
    assert "limited steps contract" in long.name
    assert not long.holds


def node_inputs(game, laplacian, estimates, gains):
    """−Rᵀ **F**(𝐱) − (L K L ⊗ I) 𝐱, with players as columns."""
    inputs = -estimates @ (laplacian @ np.diag(gains) @ laplacian)
    gradients = game.own_gradients(estimates[:, :, None])[:, 0]
    for component, owner in enumerate(game.owners):
        inputs[component, owner] -= gradients[component]
    return inputs


@pytest.mark.parametrize("scenario", [get_scenario("energy", start="random"), BLOCKS], ids=lambda world: world.name)
def test_node_adaptive_law_is_its_equation(scenario):
    world, encoder, law = build(scenario, laws.NodeAdaptiveOracle, gamma=0.0002, initial_gain=0.3)
    game, laplacian = world.game, world.topology.graphs[0].laplacian
    start = loop_start(world)
    states = run(world, encoder, law, start, steps=40)[..., 0]
    gains = np.full(game.num_players, 0.3)
    for k in range(40):
        expected = states[k] + world.clock.theta[k] * node_inputs(game, laplacian, states[k], gains)
        assert states[k + 1] == pytest.approx(expected, abs=1e-4)
        gains = gains + world.clock.theta[k] * 0.0002 * np.sum((states[k] @ laplacian) ** 2, axis=0)


def test_node_gains_grow_until_the_network_converges():
    """The theorem of Bianchi & Grammatico: convergence from gains of zero, which stay bounded."""
    scenario = get_scenario("energy", start="random", steps=4000, s_end=20.0, gain=60.0)
    world, encoder, law = build(scenario, laws.NodeAdaptiveOracle, gamma=0.001, initial_gain=0.0)
    assert theory.condition(law, theory.problem_constants(world)).holds
    state, memory, history = loop_start(world), None, []
    for _ in range(world.clock.steps):
        actions, memory = law.predict(encoder.observe(state)[0], state=memory)
        state = dynamics.step(world, state, encoder.decode(actions[None], state))
        history.append(memory[:, 0])
    history = np.array(history)
    assert np.all(np.diff(history, axis=0) >= 0)
    assert np.all(history[-1] > 0.05)
    assert history[-1] == pytest.approx(history[3000], rel=1e-4)
    target = np.tile(world.game.nash_equilibrium, 5)
    assert np.linalg.norm(stack(state.estimates) - target) < 1e-3 * np.linalg.norm(target)


@pytest.mark.parametrize(
    ("law", "arguments", "message"),
    [
        (laws.BestResponseOracle, {"relaxation": 1.5}, "relaxation must be at most 1"),
        (laws.FixedTimeOracle, {"near": 1.0}, r"near in \(0, 1\) and far < 0"),
        (laws.FixedTimeOracle, {"far": 0.0}, r"near in \(0, 1\) and far < 0"),
        (laws.FixedTimeOracle, {"largest_step": 0.0}, "largest_step must be a finite number above 0"),
        (laws.NodeAdaptiveOracle, {"gamma": -1.0}, "gamma must be a finite number of at least 0"),
    ],
)
def test_oracles_refuse_parameters_out_of_range(law, arguments, message):
    with pytest.raises(ValueError, match=message):
        build("energy", law, **arguments)


@pytest.mark.parametrize(
    "scenario", [get_scenario("energy-switching", start="random"), BLOCKS], ids=lambda world: world.name
)
def test_slices_of_oracles_hold_errors_and_best_responses(scenario):
    world, encoder = world_and_encoder(scenario, kind="full", neighbour_errors=True, best_response=True)
    plain = world_and_encoder(scenario, kind="full")[1]
    state, game = loop_start(world, batch=3), world.game
    seen = encoder.observe(state)
    assert np.array_equal(seen[..., : plain.layout.size], plain.observe(loop_start(plain.world, batch=3)))
    for b in range(3):
        observation = encoder.layout.read(seen[b])
        estimates = state.estimates[:, :, b]
        laplacian = world.topology.graphs[0].laplacian
        errors = estimates @ laplacian
        strategies = dynamics.strategies(world, state)[:, [b]]
        response = game.best_response(strategies) - strategies
        for i, slots in enumerate(encoder.layout.neighbours):
            for slot, j in enumerate(slots):
                assert observation.neighbour_errors[i, slot] == pytest.approx(errors[:, j], rel=1e-6, abs=1e-4)
            assert observation.best_response[i] == pytest.approx(response[:, 0], rel=1e-6)
