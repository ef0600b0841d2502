import pytest

import ptne_env.paper.reproduction as module
from ptne_env.paper import Experiments, reproduce


@pytest.fixture(scope="session")
def experiments():
    """The paper's runs, shared by all tests."""
    return Experiments()


@pytest.fixture(scope="session")
def reproduction(tmp_path_factory, experiments, build_once):
    """A reproduction, and the reports of its progress."""
    out = tmp_path_factory.mktemp("reproduction") / "new" / "folder"

    def build():
        reports = []
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(module, "Experiments", lambda: experiments)
            return reproduce(out, progress=lambda *report: reports.append(report)), reports

    return build_once("reproduction", build)


@pytest.fixture(scope="session")
def claims(reproduction):
    """All claims and errata by name."""
    return {claim.name: claim for claim in reproduction[0].claims}
