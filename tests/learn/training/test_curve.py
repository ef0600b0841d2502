"""The learning curve of a run: its file, its resumption, and its picture."""

import math

import numpy as np
import pytest
from matplotlib import image

from ptne_env.learn.training.curve import LearningCurve, Run, draw


def test_reports_are_kept_in_the_folder_of_the_run(tmp_path):
    curve = LearningCurve(tmp_path / "run")
    assert not (tmp_path / "run").exists()
    for done, digits in ((10, -1.5), (20, 0.25), (30, 2.0)):
        curve.add(done, digits)
    assert (tmp_path / "run" / "curve.csv").read_text() == "done,digits\n10,-1.5\n20,0.25\n30,2.0\n"
    assert LearningCurve(tmp_path / "run").points == {10: -1.5, 20: 0.25, 30: 2.0}


def test_a_resumed_run_replaces_the_reports_after_its_checkpoint(tmp_path):
    first = LearningCurve(tmp_path)
    for done in (10, 20, 30, 40):
        first.add(done, 1.0)
    resumed = LearningCurve(tmp_path)
    resumed.add(30, 2.0)
    assert resumed.points == LearningCurve(tmp_path).points == {10: 1.0, 20: 1.0, 30: 2.0}


def test_a_stage_without_episodes_leaves_no_report(tmp_path):
    LearningCurve(tmp_path).add(1, math.nan)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "content", ["steps,reward\n1,2\n", "done,digits\n1,two\n", "done,digits\n1\n", "done,digits\nx,1\n"]
)
def test_another_file_in_the_place_of_the_curve_is_refused_by_name(content, tmp_path):
    path = tmp_path / "curve.csv"
    path.write_text(content)
    with pytest.raises(ValueError, match=r"curve\.csv is no learning curve: .*; remove it, and"):
        LearningCurve(tmp_path)
    assert path.read_text() == content


def test_the_picture_shows_every_seed_their_mean_and_the_exported_policies(tmp_path):
    runs = {f"seed {seed}": Run({1000: 0.0, 2000: 1.0 + seed, 3000: 3.0}, 4.0 + seed) for seed in range(3)}
    sizes = {}
    for count in (1, 3):
        path = tmp_path / f"{count}.png"
        draw(dict(list(runs.items())[:count]), path, title="Training", unit="agent-steps")
        picture = image.imread(path)
        assert picture.shape[:2] == (600, 960)
        colours = np.unique((255 * picture[..., :3]).astype(int).reshape(-1, 3), axis=0)
        sizes[count] = [tuple(colour) in set(map(tuple, colours)) for colour in ((0, 114, 178), (0, 158, 115))]
    assert sizes == {1: [True, False], 3: [True, True]}  # the colours of seeds 0 and 2
