"""The effects of loading a file that SECURITY.md names."""

import json
import pickle
from pathlib import Path

import pytest

from ptne_env import FactorySpec, PolicySpec, Scenario, get_scenario
from ptne_env.experiments import Suite, Track, get_policy_spec, run_suite
from ptne_env.experiments.check import check
from ptne_env.experiments.provenance import content_hash
from ptne_env.experiments.suite import find_scenario
from ptne_env.world import World

TEXT = (Path(__file__).parents[1] / "SECURITY.md").read_text(encoding="utf-8")
CALLED = []


def mark(**arguments):
    """A function that a stranger's file might call."""
    CALLED.append(arguments)
    return arguments


class Mark:
    """An object that a stranger's pickle might make."""

    def __reduce__(self):
        return mark_pickle, ()


def mark_pickle():
    CALLED.append("unpickled")


@pytest.fixture(autouse=True)
def nothing_called():
    CALLED.clear()


def test_a_world_calls_the_addresses_of_its_scenario_with_their_arguments():
    data = get_scenario("energy").to_dict()
    data["game"] = {"target": "test_security:mark", "arguments": {"word": "called"}}
    scenario = Scenario.from_dict(data)
    assert not CALLED
    with pytest.raises(ValueError, match="built a dict where a Game or GameFamily is needed"):
        World(scenario)
    assert CALLED == [{"word": "called"}]
    assert "**calls the addresses in it**" in TEXT


def test_a_configuration_may_name_a_suite_which_is_imported_and_called():
    with pytest.raises(ValueError, match="is a dict, not a Suite"):
        find_scenario("test_security:mark/track")
    assert CALLED == [{}]
    assert "a training configuration, `.toml`" in TEXT


def test_results_are_data_until_they_are_checked(tmp_path):
    suite = Suite("small", (Track("ring", get_scenario("energy", steps=60, deadline=0.1), "The base."),), episodes=1)
    data = run_suite(suite, ["static"], folder=tmp_path).to_dict()
    stranger = PolicySpec("static", FactorySpec.of("test_security:mark", word="called"))
    data["policies"] = [stranger.to_dict()]
    data["jobs"] = [job for job in data["jobs"] if job["policy"] == "static"]
    signed = {key: value for key, value in data.items() if key not in ("checksum", "timings")}
    data["checksum"] = content_hash(signed)  # which needs no secret
    (tmp_path / "results.json").write_text(json.dumps(data), encoding="utf-8")
    run_suite(suite, ["static"], folder=tmp_path)  # finds its stored jobs and does nothing else
    assert not CALLED
    with pytest.raises(ValueError, match=r"policy 'static': dict has no predict"):
        check(tmp_path, suite=suite)
    assert [call["word"] for call in CALLED] == ["called"]


def test_an_archive_is_not_opened_unless_it_is_trusted(tmp_path):
    path = tmp_path / "model.zip"
    path.write_bytes(pickle.dumps(Mark()))
    with pytest.raises(ValueError, match="executes code that is stored in it"):
        get_policy_spec(str(path))
    assert not CALLED
