import numpy as np
import pytest
from worlds import BLOCKS, world_and_encoder

from ptne_env import get_scenario, laws
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import dynamics


@pytest.mark.parametrize("kind", ["physical", "scaled"])
def test_oracle_needs_the_interface_full(kind):
    with pytest.raises(
        ValueError, match=f"CentralisedOracle is an oracle and needs the interface 'full', got '{kind}'"
    ):
        laws.CentralisedOracle(world_and_encoder("energy", kind=kind)[1].layout)


@pytest.mark.parametrize("gain", [0.0, -1.0])
def test_oracle_refuses_a_gain_that_is_not_positive(gain):
    with pytest.raises(ValueError, match="gradient_gain must be a finite number above 0"):
        laws.CentralisedOracle(world_and_encoder("energy", kind="full")[1].layout, gradient_gain=gain)


@pytest.mark.parametrize(
    "scenario", [get_scenario("energy", start="random"), BLOCKS], ids=lambda scenario: scenario.name
)
def test_oracle_is_gradient_descent_on_the_shared_strategies(scenario):
    world, encoder = world_and_encoder(scenario, kind="full")
    law = laws.CentralisedOracle(encoder.layout)
    state = dynamics.initial_state(world, world.draw_estimates([RandomStreams.from_seed(1)]))
    x = dynamics.strategies(world, state)
    for k in range(world.clock.steps):
        actions, _ = law.predict(encoder.observe(state)[0])
        state = dynamics.step(world, state, encoder.decode(actions[None], state))
        x = x - world.clock.theta[k] * world.game.pseudo_gradient(x)
        assert np.abs(state.estimates - x[:, None]).max() <= 4e-6 * np.abs(x).max()
    assert dynamics.strategies(world, state)[:, 0] == pytest.approx(world.game.nash_equilibrium, rel=1e-9)


def test_oracle_obeys_the_input_limit():
    world, encoder = world_and_encoder(get_scenario("energy", input_limit=3.0), kind="full")
    state = dynamics.initial_state(world, world.draw_estimates([RandomStreams.from_seed(1)]))
    actions, _ = laws.CentralisedOracle(encoder.layout).predict(encoder.observe(state)[0])
    assert np.abs(actions).max() == 3.0
