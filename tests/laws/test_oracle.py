import pytest
from worlds import BLOCKS, world_and_encoder

from ptne_env import evaluate, laws


@pytest.mark.parametrize("kind", ["physical", "scaled"])
def test_oracle_needs_the_interface_full(kind):
    with pytest.raises(ValueError, match=f"Oracle reads relative_equilibrium, which the layout of .*{kind}.* lacks"):
        laws.Oracle(world_and_encoder("energy", kind=kind)[1].layout)


@pytest.mark.parametrize("scenario", ["random-energy", "cournot", BLOCKS, "weakly-monotone"], ids=str)
def test_oracle_reaches_the_equilibrium_to_twelve_digits(scenario):
    found = evaluate("oracle", scenario, episodes=3).samples
    (samples,) = found.values()
    assert samples["digits"].tolist() == [[12.0] * 3]
