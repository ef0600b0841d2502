"""Files of an episode: GIF, player and trajectories."""

import re
import signal
from contextlib import suppress

import numpy as np
import pytest
from PIL import Image, ImageSequence

from ptne_env import get_scenario, record
from ptne_env.evaluation import get_policy_spec
from ptne_env.report.video import save_episode


@pytest.fixture
def world():
    return get_scenario("energy-switching", steps=250, hold_steps=10)


def test_gif_shows_the_episode_and_holds_its_last_picture(world, tmp_path):
    seen, static = [], get_policy_spec("static")
    save_episode(world, static, tmp_path / "run.gif", pictures=4, progress=lambda *count: seen.append(count))
    assert seen == [(world.name, drawn, 4) for drawn in (1, 2, 3, 4)]
    with Image.open(tmp_path / "run.gif") as image:
        assert image.n_frames == 4
        pictures = [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(image)]
        assert image.info["duration"] == 2000
    inked = [int((picture < 250).any(axis=2).sum()) for picture in pictures]
    assert inked[0] < inked[1]
    assert not np.array_equal(pictures[1], pictures[3])


def test_an_interrupt_that_matplotlib_loses_ends_the_video(world, tmp_path):
    def loses(*_):
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)

    ignored = signal.signal(signal.SIGINT, signal.default_int_handler)  # as tests in the background do
    with pytest.raises(KeyboardInterrupt):
        save_episode(world, get_policy_spec("static"), tmp_path / "run.gif", pictures=2, progress=loses)
    signal.signal(signal.SIGINT, ignored)
    assert not list(tmp_path.iterdir())


def test_html_has_the_player_alone(world, tmp_path):
    save_episode(world, get_policy_spec("static"), tmp_path / "run.html")
    text = (tmp_path / "run.html").read_text(encoding="utf-8")
    assert re.findall(r'<script type="text/plain" id="(.*?)"', text) == ["scene-0-data"]
    assert len(text) < 1e5


def test_other_suffix_or_too_many_pictures_raise_before_anything_runs(world, tmp_path):
    with pytest.raises(ValueError, match=r"ends in \.gif, \.html, .* or \.png, got 'run\.avi'"):
        save_episode(world, get_policy_spec("static"), tmp_path / "run.avi")
    with pytest.raises(ValueError, match="at most 500 pictures, got 9999999"):
        save_episode(world, get_policy_spec("static"), tmp_path / "run.gif", pictures=9999999)


def test_other_files_hold_the_trajectories_of_record(world, tmp_path):
    save_episode(world, get_policy_spec("static"), tmp_path / "run.npz", seed=3)
    run = record("static", world, seed=3)
    np.testing.assert_array_equal(np.load(tmp_path / "run.npz")["estimates"], run.estimates)
