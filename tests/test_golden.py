"""Published environments behave as they did when they were published; see golden.py."""

import gymnasium
import pytest
from golden import DATA, WAYS, difference, load, main, trajectory

import ptne_env

GOLDEN = load()


def test_every_registered_environment_is_held():
    registered = {name.removeprefix("ptne/") for name in gymnasium.registry if name.startswith("ptne/")}
    assert {name.replace("-joint-v", "-v") for name in registered} == set(GOLDEN)
    assert all(set(entry) == set(WAYS) for entry in GOLDEN.values())


@pytest.mark.parametrize("environment_id", sorted(GOLDEN))
def test_the_environment_does_what_it_did_when_it_was_published(environment_id):
    for way, kept in GOLDEN[environment_id].items():
        assert difference(kept, trajectory(environment_id, way)) == "", way


@pytest.mark.parametrize("change", [{"gain": 20.000001}, {"deadline": 1.2000001}, {"steps": 401}, {"slots": 3}])
def test_a_small_change_of_an_environment_is_seen(change, monkeypatch):
    build = ptne_env.parallel_env
    monkeypatch.setattr(ptne_env, "parallel_env", lambda scenario, **fields: build(scenario, **fields, **change))
    assert difference(GOLDEN["energy-v0"]["physical"], trajectory("energy-v0", "physical"))


def test_what_is_kept_is_never_written_over(monkeypatch, tmp_path, capsys):
    kept = DATA.read_text(encoding="utf-8")
    path = tmp_path / "golden.json"
    path.write_text(kept.replace('"length": "400"', '"length": "399"', 1), encoding="utf-8")
    changed = path.read_bytes()
    monkeypatch.setattr("golden.DATA", path)
    monkeypatch.setattr(ptne_env, "CATALOGUE", {"energy": ptne_env.CATALOGUE["energy"]})
    assert main() == 1
    assert path.read_bytes() == changed
    assert "energy-v0, physical: length is off by 1" in capsys.readouterr().out
