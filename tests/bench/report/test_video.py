"""Videos of an episode: GIF, MP4 and the player."""

import os
import re
import shutil
import subprocess

import numpy as np
import pytest
from PIL import Image

from ptne_env import get_scenario
from ptne_env.bench.report import save_video
from ptne_env.bench.report.video import PER_SECOND
from ptne_env.evaluation import get_policy_spec


@pytest.fixture
def world():
    return get_scenario("energy-switching", steps=250, hold_steps=10)


def test_gif_shows_the_episode_and_holds_its_last_picture(world, tmp_path):
    seen = []
    save_video(
        world, get_policy_spec("static"), tmp_path / "run.gif", pictures=4, progress=lambda *count: seen.append(count)
    )
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]
    with Image.open(tmp_path / "run.gif") as image:
        assert image.n_frames == 4
        pictures = []
        for index in range(4):
            image.seek(index)
            pictures.append(np.asarray(image.convert("RGB")))
        assert image.info["duration"] == 2000
    inked = [int((picture < 250).any(axis=2).sum()) for picture in pictures]
    assert inked[0] < inked[1]
    assert not np.array_equal(pictures[1], pictures[3])


def test_html_has_the_player_alone(world, tmp_path):
    save_video(world, get_policy_spec("static"), tmp_path / "run.html")
    text = (tmp_path / "run.html").read_text(encoding="utf-8")
    assert re.findall(r'<script type="text/plain" id="(.*?)"', text) == ["scene-0-data"]
    assert len(text) < 1e6  # no Plotly


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg in the PATH: apt-get install ffmpeg")
def test_mp4_has_all_pictures_and_holds_the_last(world, tmp_path):
    save_video(world, get_policy_spec("static"), tmp_path / "run.mp4", pictures=3)
    assert (tmp_path / "run.mp4").read_bytes()[4:8] == b"ftyp"
    command = ["ffmpeg", "-i", "run.mp4", "%02d.png"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)  # noqa: S603 - a fixed command
    assert len(list(tmp_path.glob("*.png"))) == 3 + 2 * PER_SECOND
    assert {path.name for path in tmp_path.iterdir() if path.suffix != ".png"} == {"run.mp4"}


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg in the PATH: apt-get install ffmpeg")
def test_failing_ffmpeg_leaves_the_old_file(world, tmp_path, monkeypatch):
    (tmp_path / "ffmpeg").write_text("#!/bin/sh\ncat > /dev/null; echo broken >&2; exit 1\n")
    (tmp_path / "ffmpeg").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    (tmp_path / "run.mp4").write_bytes(b"old")
    with pytest.raises(OSError, match="ffmpeg failed: broken"):
        save_video(world, get_policy_spec("static"), tmp_path / "run.mp4", pictures=2)
    assert (tmp_path / "run.mp4").read_bytes() == b"old"


def test_mp4_without_ffmpeg_raises_with_the_remedy(world, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FileNotFoundError, match="needs the program ffmpeg"):
        save_video(world, get_policy_spec("static"), tmp_path / "run.mp4", pictures=2)


def test_other_suffix_raises_before_anything_runs(world, tmp_path):
    with pytest.raises(ValueError, match=r"written to \.gif, \.mp4, \.html, got 'run\.avi'"):
        save_video(world, get_policy_spec("static"), tmp_path / "run.avi")
