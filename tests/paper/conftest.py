import pytest

from ptne_env.paper import Experiments, reproduce


@pytest.fixture(scope="session")
def experiments():
    """The paper's runs, integrated once for all tests."""
    return Experiments()


@pytest.fixture(scope="session")
def reproduction(tmp_path_factory, build_once):
    """One whole reproduction, and the calls of ``progress``."""
    out = tmp_path_factory.mktemp("reproduction") / "deep" / "er"

    def build():
        calls = []
        return reproduce(out, progress=lambda *call: calls.append(call)), calls

    return build_once("reproduction", build)


@pytest.fixture(scope="session")
def claims(reproduction):
    """Every claim by name."""
    return {claim.name: claim for claim in reproduction[0].claims}
