"""An episode as a film: the pictures of ``env.render()``, or the player of the report page."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ptne_env.arrays import FloatArray, require_count
from ptne_env.dynamics import State
from ptne_env.encoder import make_encoder
from ptne_env.envs.rendering import Renderer
from ptne_env.experiments.episodes import draw_start
from ptne_env.experiments.policy_specs import PolicySpec
from ptne_env.experiments.rollout import rollout
from ptne_env.experiments.traces import scene
from ptne_env.files import write_atomically
from ptne_env.report.page import render_episode
from ptne_env.scenario import Scenario
from ptne_env.world import World

FORMATS = (".gif", ".mp4", ".html")
"""Endings of files that films are written to."""

PER_SECOND = 20
"""Pictures per second."""

_LAST = 2 * PER_SECOND
"""The last picture stays for this many."""


def film(
    scenario: Scenario,
    entry: PolicySpec,
    path: Path,
    *,
    seed: int = 0,
    pictures: int = 100,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Run the first episode of the bank and write it as a film.

    Args:
        scenario: the world.
        entry: the policy.
        path: of the film: ``.gif``, ``.mp4`` (which needs the program ffmpeg) or ``.html`` (the player of the report).
        seed: of the bank.
        pictures: how many a film has, or instants a page, evenly spaced in steps.
        progress: called with the number of pictures that are drawn and of all.

    Raises:
        ValueError: for another ending, or a policy that cannot act in the scenario.
        ImportError: when a library is missing, naming the extra to install.
        OSError: when the file cannot be written, or ffmpeg is missing.
    """
    ending = path.suffix.lower()
    if ending not in FORMATS:
        raise ValueError(f"a film is written to {', '.join(FORMATS)}, got {path.name!r}")
    require_count("pictures", pictures, 2)
    world = World(scenario)
    start = draw_start(world, 1, seed)
    if ending == ".html":
        seen = scene(world, start, {entry.name: entry}, frames=pictures)
        write_atomically(path, render_episode(scenario.name, seen))
        return
    write = _gif if ending == ".gif" else _mp4
    write(path, _pictures(world, entry, start, pictures, progress))


def _pictures(
    world: World, entry: PolicySpec, start: State, count: int, progress: Callable[[int, int], None] | None
) -> Iterator[npt.NDArray[np.uint8]]:
    encoder = make_encoder(world, entry.interface)
    states: list[State] = []

    def keep(state: State, _: FloatArray | None) -> None:
        states.append(state)

    rollout(entry.build(encoder.layout), encoder, start, watch=keep)
    wanted = set(np.linspace(0, len(states) - 1, count).round().astype(int).tolist())
    renderer = Renderer(world, "rgb_array", f"{world.scenario.name}: {entry.name}")
    renderer.foresee(states)
    done = 0
    for step, state in enumerate(states):
        if step == 0:
            renderer.reset(state)
        else:
            renderer.record(state)
        if step in wanted:
            picture = renderer.draw()
            done += 1
            if progress is not None:
                progress(done, len(wanted))
            if picture is not None:
                yield picture


def _gif(path: Path, pictures: Iterator[npt.NDArray[np.uint8]]) -> None:
    try:
        from PIL import Image
    except ImportError as error:
        raise ImportError('films need Pillow: pip install "ptne-env[bench]"') from error

    # One palette for all, so that nothing flickers: that of the last picture, which has every colour.
    images = [Image.fromarray(picture) for picture in pictures]
    palette = images[-1].quantize(colors=256)
    images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    milliseconds = 1000 // PER_SECOND
    durations = [milliseconds] * (len(images) - 1) + [milliseconds * _LAST]
    buffer = io.BytesIO()
    images[0].save(buffer, "GIF", save_all=True, append_images=images[1:], duration=durations, loop=0)
    write_atomically(path, buffer.getvalue())


def _mp4(path: Path, pictures: Iterator[npt.NDArray[np.uint8]]) -> None:
    import shutil
    import subprocess
    import tempfile

    program = shutil.which("ffmpeg")
    if program is None:
        raise FileNotFoundError("an .mp4 needs the program ffmpeg in the PATH: install it, or write a .gif or .html")
    frames = list(pictures)
    height, width, _ = frames[0].shape
    frames += [frames[-1]] * _LAST
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "film.mp4"
        source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(PER_SECOND), "-i", "-"]
        outcome = subprocess.run(  # noqa: S603 - the program that was found, with arguments of our own
            [program, "-loglevel", "error", *source, "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(target)],
            input=b"".join(frame.tobytes() for frame in frames),
            capture_output=True,
            check=False,
        )
        if outcome.returncode:
            raise OSError(f"ffmpeg failed: {outcome.stderr.decode(errors='replace').strip()}")
        write_atomically(path, target.read_bytes())
