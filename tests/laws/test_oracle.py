import numpy as np
import pytest
from worlds import BLOCKS, world_and_encoder

from ptne_env import evaluate, get_scenario, laws
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import dynamics


@pytest.mark.parametrize("kind", ["physical", "scaled"])
def test_oracle_needs_the_interface_full(kind):
    with pytest.raises(ValueError, match=f"Oracle is an oracle and needs the interface 'full', got '{kind}'"):
        laws.Oracle(world_and_encoder("energy", kind=kind)[1].layout)


@pytest.mark.parametrize("scenario", ["random-energy", "cournot", BLOCKS, "weakly-monotone"], ids=str)
def test_oracle_reaches_the_equilibrium_to_twelve_digits(scenario):
    found = evaluate("oracle", scenario, episodes=3).samples
    (samples,) = found.values()
    assert samples["digits"].tolist() == [[12.0] * 3]


def test_oracle_obeys_the_input_limit():
    world, encoder = world_and_encoder(get_scenario("energy", input_limit=3.0), kind="full")
    state = dynamics.initial_state(world, world.draw_estimates([RandomStreams.from_seed(1)]))
    actions, _ = laws.Oracle(encoder.layout).predict(encoder.observe(state)[0])
    assert np.abs(actions).max() == 3.0
