import pytest

from ptne_env.paper import Experiments, reproduce


@pytest.fixture(scope="session")
def experiments():
    """The paper's runs, integrated once for all tests."""
    return Experiments()


@pytest.fixture(scope="session")
def reproduction(tmp_path_factory):
    """One whole reproduction, and what it told about its progress."""
    told = []
    out = tmp_path_factory.mktemp("reproduction") / "deep" / "er"
    return reproduce(out, progress=lambda done, total, what: told.append((done, total, what))), told


@pytest.fixture(scope="session")
def claims(reproduction):
    """Every claim by name."""
    return {claim.name: claim for claim in reproduction[0].claims}
