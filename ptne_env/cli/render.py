"""``ptne render``: write one episode to a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ptne_env.cli import options
from ptne_env.cli.app import app
from ptne_env.cli.console import check_writable, say, this_command
from ptne_env.evaluation import get_policy_spec
from ptne_env.evaluation.trajectories import SUFFIXES, record
from ptne_env.report.page import episode_page
from ptne_env.shared.files import require_suffix, write_atomically

FORMATS = {".html": "a page that plays the episode", **SUFFIXES}
"""What is written of an episode, by the suffix of the file."""


@app.command()
def render(
    scenario: options.ScenarioArgument,
    policy: options.PolicyArgument,
    *,
    out: Annotated[Path, typer.Option(help=f"The file: {', '.join(f'{FORMATS[name]} ({name})' for name in FORMATS)}.")],
    changes: options.SetOption = None,
    seed: options.SeedOption = 0,
    trust: options.TrustOption = False,
) -> None:
    """Write one test episode as a page, a figure or data: strategies, estimates and distances over time."""
    suffix = require_suffix("an episode is", out, FORMATS)
    check_writable(out)
    trust = options.require_trust(options.foreign_names(scenario, policy), trust=trust)
    world, spec = options.read_scenario(scenario, changes, trust=trust), get_policy_spec(policy, trust=trust)
    if suffix == ".html":
        write_atomically(out, episode_page(world, spec, seed=seed, command=this_command()))
    else:
        record(spec, world, seed=seed).save(out)
    say(f"Episode written to {out}")
