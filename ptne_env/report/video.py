"""Files of an episode: a video of ``env.render()``, the player of the report page, or trajectories."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ptne_env.envs.rendering import Renderer
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.policy_spec import PolicySpec
from ptne_env.evaluation.tracks import Track
from ptne_env.evaluation.trajectories import SUFFIXES, Trajectories, record
from ptne_env.report.page import Page, Section
from ptne_env.report.traces import make_scene
from ptne_env.shared.arrays import require_count
from ptne_env.shared.files import require_suffix, write_atomically
from ptne_env.shared.style import delay_ctrl_c
from ptne_env.world.scenario import Scenario

FORMATS = {".gif": "a video", ".html": "a page that plays the episode", **SUFFIXES}
"""What is written of an episode, by the suffix of the file."""

MOST_PICTURES = 500
"""Largest number of pictures in a video: all of them are in memory until they share a palette, 1.5 MB each."""


def save_episode(
    scenario: Scenario,
    spec: PolicySpec,
    path: Path,
    *,
    seed: int = 0,
    pictures: int = 100,
    progress: Callable[[str, int, int], None] | None = None,
) -> None:
    """Run the first episode of the test split and write it to a file.

    Args:
        scenario: the scenario that is played.
        spec: the policy that plays.
        path: the file, with a suffix of :data:`FORMATS`.
        seed: the seed of the episode, where one is drawn.
        pictures: the number of pictures in a video, evenly spaced in steps.
        progress: called with the name of the scenario, the number of pictures that are drawn, and of all.

    Raises:
        ValueError: for another suffix, fewer than 2 or more than 500 pictures, or a policy that cannot act in the
            scenario.
        ImportError: when a library is missing, naming the extra to install.
        OSError: when the file cannot be written.
    """
    suffix = require_suffix("an episode is", path, FORMATS)
    if require_count("pictures", pictures, 2) > MOST_PICTURES:
        raise ValueError(f"a video has at most {MOST_PICTURES} pictures, got {pictures}")
    if suffix == ".html":
        scenes = {scenario.name: make_scene(Track(scenario.name, scenario, ""), EpisodeSet(1, seed), [spec])}
        player = Section("Episode player", has_player=True)
        write_atomically(path, Page(f"{scenario.name}: {spec.name}", (player,), scenes=scenes).to_html())
        return
    run = record(spec, scenario, seed=seed)
    if suffix == ".gif":
        write_atomically(path, encode_gif(_draw_pictures(run, pictures, progress)))
    else:
        run.save(path)


def _draw_pictures(run: Trajectories, count: int, progress: Callable[[str, int, int], None] | None) -> Iterator[Any]:
    """Yield ``count`` pictures of an episode, uint8 arrays of shape (height, width, 3)."""
    world, start = run.rollout.world, run.episodes.initial_state(run.rollout.world)
    states = [
        start._replace(step=np.array([step]), estimates=estimates.swapaxes(0, 1))
        for step, estimates in enumerate(run.estimates)
    ]
    wanted = np.unique(np.linspace(0, len(states) - 1, count).round().astype(int)).tolist()
    renderer = Renderer(world, "rgb_array", f"{world.scenario.name}: {run.policy}")
    renderer.fix_axes(states)
    renderer.reset(states[0])
    for step, state in enumerate(states):
        picture = None
        with delay_ctrl_c():  # artists of former pictures are forgotten anywhere in it
            if step > 0:
                renderer.record(state)
            if step in wanted:
                picture = renderer.draw()
                if progress is not None:
                    progress(world.scenario.name, 1 + wanted.index(step), len(wanted))
        if picture is not None:
            yield picture


def encode_gif(pictures: Iterator[Any], per_second: int = 20) -> bytes:
    """Return pictures, uint8 of shape (height, width, 3), as a GIF that stays on the last one for two seconds."""
    drawn = list(pictures)  # before Pillow is imported: a missing matplotlib, which brings it, has the clearer message
    from PIL import Image

    # Matplotlib's PillowWriter gives every picture its own palette: colours flicker, and files are ten times larger.
    images = [Image.fromarray(picture) for picture in drawn]
    palette = images[-1].quantize(colors=256)  # the last picture has every colour
    images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    durations = [1000 // per_second] * (len(images) - 1) + [2000]
    buffer = io.BytesIO()
    images[0].save(buffer, "gif", save_all=True, append_images=images[1:], duration=durations, loop=0)
    return buffer.getvalue()
