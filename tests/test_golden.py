"""Published environments follow their golden trajectories; see golden.py."""

import gymnasium
import pytest
from golden import DATA, MODES, difference, load, main, trajectory

import ptne_env

GOLDEN = load()


def test_every_registered_environment_has_golden_trajectories():
    registered = {name.removeprefix("ptne/") for name in gymnasium.registry if name.startswith("ptne/")}
    assert {name.replace("-joint-v", "-v") for name in registered} == set(GOLDEN)
    assert all(set(modes) == set(MODES) for modes in GOLDEN.values())


@pytest.mark.parametrize("environment_id", sorted(GOLDEN))
def test_environment_follows_its_golden_trajectories(environment_id):
    for mode, kept in GOLDEN[environment_id].items():
        assert difference(kept, trajectory(environment_id, mode)) == "", mode


@pytest.mark.parametrize("change", [{"gain": 20.000001}, {"deadline": 1.2000001}, {"steps": 401}, {"slots": 3}])
def test_a_small_change_of_an_environment_is_a_difference(change, monkeypatch):
    build = ptne_env.parallel_env
    monkeypatch.setattr(ptne_env, "parallel_env", lambda scenario, **fields: build(scenario, **fields, **change))
    assert difference(GOLDEN["energy-v0"]["physical"], trajectory("energy-v0", "physical"))


def test_a_golden_trajectory_is_never_replaced(monkeypatch, tmp_path, capsys):
    kept = DATA.read_text(encoding="utf-8")
    path = tmp_path / "golden.json"
    path.write_text(kept.replace('"length": "400"', '"length": "399"', 1), encoding="utf-8")
    changed = path.read_bytes()
    monkeypatch.setattr("golden.DATA", path)
    monkeypatch.setattr(ptne_env, "CATALOGUE", {"energy": ptne_env.CATALOGUE["energy"]})
    assert main() == 1
    assert path.read_bytes() == changed
    assert "energy-v0, physical: length is off by 1" in capsys.readouterr().out
