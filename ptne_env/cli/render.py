"""``ptne render``: one episode as a video or a page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ptne_env.cli import options
from ptne_env.cli.app import Command, app
from ptne_env.cli.console import check_writable, progress, say
from ptne_env.evaluation import get_policy_spec
from ptne_env.report.video import MOST_PICTURES, save_video


@app.command(cls=Command)
def render(
    scenario: options.World,
    policy: options.Policy,
    *,
    out: Annotated[
        Path,
        typer.Option(help="The file: a video, .gif, or a page with the episode to play, .html."),
    ],
    changes: options.Changes = None,
    seed: options.Seed = 0,
    pictures: Annotated[
        int, typer.Option(min=2, max=MOST_PICTURES, help="Pictures of a video; a page shows every step.")
    ] = 100,
    trust: options.Trust = False,
) -> None:
    """Write one test episode as a video or a page: strategies, estimates, distances and live links over time."""
    check_writable(out)
    trust = options.trusted(options.foreign_names(scenario, policy), trust=trust)
    chosen, spec = options.changed(scenario, changes, trust=trust), get_policy_spec(policy, trust=trust)
    with progress(f"{scenario}: {policy}") as advance:
        save_video(chosen, spec, out, seed=seed, pictures=pictures, progress=advance)
    say(f"Episode written to {out}")
