"""Behaviour is what it was when the golden trajectories were written; see golden.py."""

import golden
import pytest

from ptne_env.world import dynamics

KEPT = golden.load()
ADVICE = (
    f"behaviour has changed: raise PHYSICS in ptne_env/world/dynamics.py to {KEPT['physics'] + 1}, "
    "and run python tests/golden.py"
)


def test_golden_trajectories_are_of_this_physics_and_of_every_scenario():
    assert KEPT["physics"] == dynamics.PHYSICS, "PHYSICS was raised: run python tests/golden.py"
    assert list(KEPT["trajectories"]) == golden.CASES, "a scenario is new, or gone: run python tests/golden.py"


@pytest.mark.parametrize("case", [case for case in golden.CASES if case in KEPT["trajectories"]])
def test_behaviour_is_that_of_the_golden_trajectory(case):
    name, kind = case.rsplit(", ", 1)
    found = golden.difference(KEPT["trajectories"][case], golden.trajectory(golden.SCENARIOS[name], kind))
    assert not found, f"{ADVICE}; {found}"


@pytest.mark.parametrize("name", golden.CONTRACTIVE)
def test_the_static_law_ends_with_the_golden_digits(name):
    assert golden.end(golden.SCENARIOS[name]) == pytest.approx(KEPT["ends"][name], abs=0.01), ADVICE


@pytest.mark.parametrize("change", [{"gain": 20.00001}, {"deadline": 1.200001}, {"steps": 401}])
@pytest.mark.parametrize("kind", ["physical", "scaled"])
def test_a_small_change_of_physics_is_a_difference(change, kind):
    scenario = golden.SCENARIOS["energy"].replace(**change)
    assert golden.difference(KEPT["trajectories"][f"energy, {kind}"], golden.trajectory(scenario, kind))


def test_the_file_is_not_written_where_behaviour_changed_and_physics_did_not(monkeypatch, tmp_path, capsys):
    path = tmp_path / "golden.json"
    path.write_bytes(golden.DATA.read_bytes())
    monkeypatch.setattr(golden, "DATA", path)
    monkeypatch.setattr(golden, "measured", lambda: KEPT | {"ends": KEPT["ends"] | {"energy": 0.0}})
    assert golden.main() == 1
    assert path.read_bytes() == (golden.Path(golden.__file__).parent / "data" / "golden.json").read_bytes()
    assert "raise PHYSICS" in capsys.readouterr().out
    monkeypatch.setattr(golden, "PHYSICS", KEPT["physics"] + 1)
    assert golden.main() == 0
