import pytest

from baselines import reproduce
from baselines.paper.experiments import Experiments


@pytest.fixture(scope="session")
def built(build_once, tmp_path_factory):
    """The paper's runs, and a reproduction from them."""

    def build():
        experiments = Experiments()
        out = tmp_path_factory.mktemp("reproduction") / "new" / "folder"
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(reproduce, "Experiments", lambda: experiments)
            return experiments, reproduce.reproduce(out)

    return build_once("paper", build)


@pytest.fixture(scope="session")
def experiments(built):
    """The paper's runs."""
    return built[0]


@pytest.fixture(scope="session")
def reproduction(built):
    """A reproduction."""
    return built[1]


@pytest.fixture(scope="session")
def claims(reproduction):
    """All claims and errata by name."""
    return {claim.name: claim for claim in reproduction.claims}
