import pytest

from ptne_env.paper import Experiments, reproduce, run_checks


@pytest.fixture(scope="session")
def experiments():
    """The paper's runs, integrated once for all tests."""
    return Experiments()


@pytest.fixture(scope="session")
def claims(experiments):
    """Every claim by name."""
    return {claim.name: claim for claim in run_checks(experiments)}


@pytest.fixture(scope="session")
def reproduction(tmp_path_factory):
    """One whole reproduction, and what it told about its progress."""
    told = []
    out = tmp_path_factory.mktemp("reproduction") / "deep" / "er"
    return reproduce(out, progress=lambda done, total, what: told.append((done, total, what))), told
