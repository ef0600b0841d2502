"""``ptne render``: write one episode to a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ptne_env.cli import options
from ptne_env.cli.app import app
from ptne_env.cli.console import check_writable, progress, say
from ptne_env.evaluation import get_policy_spec
from ptne_env.report.video import FORMATS, MOST_PICTURES, save_episode


@app.command()
def render(
    scenario: options.ScenarioArgument,
    policy: options.PolicyArgument,
    *,
    out: Annotated[Path, typer.Option(help=f"The file: {', '.join(f'{FORMATS[name]} ({name})' for name in FORMATS)}.")],
    changes: options.SetOption = None,
    seed: options.SeedOption = 0,
    pictures: Annotated[
        int, typer.Option(min=2, max=MOST_PICTURES, help="Number of pictures in a video; a page shows every step.")
    ] = 100,
    trust: options.TrustOption = False,
) -> None:
    """Write one test episode as a video, a page, a figure or data: strategies, estimates and distances over time."""
    check_writable(out)
    trust = options.require_trust(options.foreign_names(scenario, policy), trust=trust)
    world, spec = options.read_scenario(scenario, changes, trust=trust), get_policy_spec(policy, trust=trust)
    with progress(f"{scenario}: {policy}") as advance:
        save_episode(world, spec, out, seed=seed, pictures=pictures, progress=advance)
    say(f"Episode written to {out}")
