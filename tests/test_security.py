"""SECURITY.md says what loading a file can do; here it is done."""

import json
import pickle
from pathlib import Path

import pytest

from ptne_env import FactorySpec, PolicySpec, Scenario, get_scenario
from ptne_env.experiments.benchmark import Participant, check, get_participant, run_suite
from ptne_env.experiments.leaderboard import leaderboard
from ptne_env.experiments.suite import Suite, Track, content_hash, find_scenario

TEXT = (Path(__file__).parents[1] / "SECURITY.md").read_text(encoding="utf-8")
CALLED = []


def mark(**arguments):
    """What a stranger's file might call."""
    CALLED.append(arguments)
    return arguments


class Mark:
    """What a stranger's pickle might call."""

    def __reduce__(self):
        return mark_pickle, ()


def mark_pickle():
    CALLED.append("unpickled")


@pytest.fixture(autouse=True)
def nothing_called():
    CALLED.clear()


def test_a_scenario_calls_what_it_names_with_the_arguments_it_gives():
    data = get_scenario("energy").to_dict()
    data["game"] = {"target": "test_security:mark", "arguments": {"word": "called"}}
    with pytest.raises(ValueError, match="built a dict where game needs a Game"):
        Scenario.from_dict(data)
    assert CALLED == [{"word": "called"}]
    assert "calls what it names" in TEXT


def test_a_configuration_may_name_a_suite_which_is_imported_and_called():
    with pytest.raises(ValueError, match="is a dict, not a Suite"):
        find_scenario("test_security:mark/track")
    assert CALLED == [{}]
    assert "a training configuration, `.toml`" in TEXT


def test_results_are_data_until_they_are_checked(tmp_path):
    suite = Suite("small", 1, (Track("ring", get_scenario("energy", steps=60, deadline=0.1), "The base."),), episodes=1)
    run = run_suite(suite, ["static"], tmp_path)
    data = leaderboard(run).to_dict()
    stranger = Participant("static", (PolicySpec("static", FactorySpec.of("test_security:mark", word="called")),))
    data["participants"] = [stranger.to_dict()]
    data["cells"] = [cell for cell in data["cells"] if cell["participant"] == "static"]
    signed = {key: value for key, value in data.items() if key not in ("checksum", "timings")}
    data["checksum"] = content_hash(signed)  # which anybody can make
    (tmp_path / "results.json").write_text(json.dumps(data), encoding="utf-8")
    run_suite(suite, ["static"], tmp_path)  # finds its cells and does nothing else
    assert not CALLED
    check(tmp_path, suite=suite)
    assert [call["word"] for call in CALLED] == ["called"]


def test_an_archive_is_not_opened_unless_it_is_trusted(tmp_path):
    path = tmp_path / "model.zip"
    path.write_bytes(pickle.dumps(Mark()))
    with pytest.raises(ValueError, match="executes code that is stored in it"):
        get_participant(str(path))
    assert not CALLED
