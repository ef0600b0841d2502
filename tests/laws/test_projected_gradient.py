"""Bianchi & Grammatico's projected pseudo-gradient with consensus: its equation, and its theorem where it holds."""

import numpy as np
import pytest
from affine_games import SOAK, affine_scenario, loop_start, random_affine, run
from worlds import BLOCKS, BLOCKS_SWITCHING, world_and_encoder

from ptne_env import FactorySpec, get_scenario, laws, theory

ENERGY = get_scenario("energy", start="random")


@pytest.mark.parametrize("scenario", [ENERGY, BLOCKS, BLOCKS_SWITCHING], ids=lambda scenario: scenario.name)
def test_projected_gradient_is_its_equation_every_two_steps(scenario):
    world, encoder = world_and_encoder(scenario)
    law = laws.ProjectedGradient(encoder.layout, step=0.2, mixing=0.25)
    states = run(world, encoder, law, loop_start(world), steps=60)[..., 0]
    game, modes = world.game, world.modes
    for k in range(0, 58, 2):
        mixed = states[k] @ (np.eye(game.num_players) - 0.25 * world.topology.graphs[modes[k]].laplacian)
        expected = mixed.copy()
        gradients = game.own_gradients(mixed[:, :, None])[:, 0]
        for component, owner in enumerate(game.owners):
            expected[component, owner] -= 0.2 * gradients[component]
        assert states[k + 2] == pytest.approx(expected, abs=1e-5 * np.abs(states[k]).max())


@pytest.mark.parametrize("seed", range(20 if SOAK else 4))
def test_projected_gradient_contracts_over_time_varying_graphs(seed):
    """‖𝐱 − 1⊗x*‖ shrinks by √λ_max(M_α) at least in every iteration where the condition holds, on every graph."""
    generator = np.random.default_rng(seed)
    matrix, offset, first = random_affine(generator, 4)
    graphs = tuple(
        FactorySpec.of("ptne_env.world.graphs:Graph", adjacency=adjacency)
        for adjacency in (first, random_affine(generator, 4)[2])
    )
    topology = FactorySpec.of("topology:periodic", graphs=graphs, dwells=(0.3, 0.7), clock="transformed")
    world, encoder = world_and_encoder(affine_scenario(matrix, offset, topology, input_limit=1e5))
    constants = theory.problem_constants(world)
    h = 0.5 / constants.largest_degree
    candidates = (laws.ProjectedGradient(encoder.layout, step, h) for step in np.geomspace(0.5, 1e-4, 40))
    law = next(law for law in candidates if theory.condition(law, constants).holds)
    rate = np.sqrt(theory.condition(law, constants).value)
    states = run(world, encoder, law, loop_start(world))[..., 0]
    distances = np.linalg.norm(states - world.game.nash_equilibrium[:, None], axis=(1, 2))[::2]
    assert len(set(world.modes[::2])) == 2
    assert np.all(distances[1:] <= rate * distances[:-1] * (1 + 1e-5))
    assert distances[-1] < 0.99 * distances[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"step": 0.0}, "step must be a finite number above 0"),
        ({"mixing": -1.0}, "mixing must be a finite number above 0"),
    ],
)
def test_parameters_out_of_range_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        laws.ProjectedGradient(world_and_encoder("energy")[1].layout, **arguments)
