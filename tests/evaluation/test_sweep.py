"""Phase diagrams: measured digits are the predicted ones, and boundaries separate the regions."""

import json

import numpy as np
import pytest
from matplotlib import image

from ptne_env.bench.report import save_diagram
from ptne_env.evaluation import sweep
from ptne_env.evaluation.sweep import CEILING, FLOOR, SWEEPS, run_sweep
from ptne_env.evaluation.workers import Workers


@pytest.fixture(scope="module")
def diagrams():
    return {name: run_sweep(name, points=6, episodes=3, seed=1) for name in SWEEPS}


@pytest.mark.parametrize(("name", "tolerance"), [("gain-step", 1e-4), ("noise-horizon", 0.25), ("dwell-gain", 1e-4)])
def test_measured_digits_are_the_predicted_ones(diagrams, name, tolerance):
    diagram = diagrams[name]
    assert diagram.difference < tolerance  # of noise the root mean square is predicted, and three draws are measured
    measured = diagram.grid("measured")
    assert np.nanmax(measured) - np.nanmin(measured) > 3
    assert FLOOR <= np.nanmin(measured) <= np.nanmax(measured) <= CEILING


def test_largest_stable_step_separates_settling_from_growth(diagrams):
    diagram = diagrams["gain-step"]
    line = diagram.boundaries[0]
    digits = diagram.grid("measured")
    for column, kappa in enumerate(diagram.x.values):
        stable = np.interp(np.log(kappa), np.log(line.x), line.y)
        for row, step in enumerate(diagram.y.values):
            if step < 0.8 * stable:
                assert digits[row, column] > 0
            if step > 1.5 * stable:
                assert digits[row, column] == FLOOR


def test_noise_costs_digits_beyond_its_boundary_alone(diagrams):
    diagram = diagrams["noise-horizon"]
    digits, (line,) = diagram.grid("measured"), diagram.boundaries
    for row, horizon in enumerate(diagram.y.values):
        level = np.interp(horizon, line.y, line.x)
        for column, std in enumerate(diagram.x.values):
            lost = digits[row, 0] - digits[row, column]
            if std < level / 30:
                assert abs(lost) < 0.05
            if std > 30 * level:
                assert lost > 1


def test_gain_does_not_make_up_for_a_long_dwell(diagrams):
    diagram = diagrams["dwell-gain"]
    digits = diagram.grid("measured")
    stable = np.array(diagram.y.values) < diagram.boundaries[-1].y[0]
    assert np.nanmax(digits[stable][:, 0]) > 4
    assert digits[:, np.array(diagram.x.values) > diagram.boundaries[0].x[0]].max() < 1


def test_point_without_a_scenario_has_no_number(diagrams):
    diagram = diagrams["dwell-gain"]
    assert diagram.measured[0][0] is None  # dwells of 10 ms are shorter than a step at c = 1
    assert diagram.predicted[0][0] is None


def test_results_do_not_depend_on_the_number_of_processes():
    one, two = (run_sweep("noise-horizon", points=2, episodes=2, seed=1, workers=Workers(jobs)) for jobs in (1, 2))
    assert one == two


class Counted(sweep._Point):
    """Points that note when they are measured."""

    measured = 0

    def measure(self):
        Counted.measured += 1
        return super().measure()


@pytest.fixture
def counted(monkeypatch):
    monkeypatch.setattr(Counted, "measured", 0)
    monkeypatch.setattr(sweep, "_Point", Counted)
    return Counted


def test_an_interrupted_sweep_goes_on_where_it_was(tmp_path, counted):
    def stop(done, total):
        if done == 3:
            raise KeyboardInterrupt

    arguments = {"name": "dwell-gain", "points": 2, "episodes": 2, "folder": tmp_path}
    with pytest.raises(KeyboardInterrupt):
        run_sweep(**arguments, progress=stop)
    assert counted.measured == 3
    done = run_sweep(**arguments)
    assert counted.measured == 4
    assert done == run_sweep(**arguments | {"folder": None})


def test_a_point_is_measured_again_after_damage_and_after_any_change(tmp_path, counted, monkeypatch):
    arguments = {"name": "noise-horizon", "points": 2, "episodes": 2, "folder": tmp_path}
    run_sweep(**arguments)
    path = next((tmp_path / "points").iterdir())
    path.write_bytes(path.read_bytes()[:-2])
    run_sweep(**arguments)
    assert counted.measured == 5
    for change in ({"seed": 1}, {"episodes": 1}, {"name": "gain-step"}):
        before = counted.measured
        run_sweep(**arguments | change)
        assert counted.measured == before + 4
    monkeypatch.setattr(sweep, "versions", lambda: {"ptne_env": "another"})
    before = counted.measured
    run_sweep(**arguments)
    assert counted.measured == before + 4


def test_numbers_and_picture_are_written(diagrams, tmp_path):
    diagram = diagrams["noise-horizon"]
    data = json.loads(diagram.to_json())
    assert np.array_equal(np.array(data["measured"]), diagram.grid("measured"))
    save_diagram(diagram, tmp_path / "new" / "diagram.png")
    picture = image.imread(tmp_path / "new" / "diagram.png")
    assert len(np.unique(picture.reshape(-1, picture.shape[2]), axis=0)) > 50


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        ({"name": "gain"}, "unknown diagram 'gain'; did you mean 'gain-step'"),
        ({"name": "xyz"}, "unknown diagram 'xyz'; choose from gain-step"),
        ({"points": 1}, "points"),
        ({"episodes": 0}, "episodes"),
    ],
)
def test_wrong_arguments_raise(arguments, phrase):
    with pytest.raises(ValueError, match=phrase):
        run_sweep(**{"name": "gain-step", **arguments})
