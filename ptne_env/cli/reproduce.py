"""``ptne reproduce``: the paper's table, figures and claims."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from ptne_env.bench.report.terminal import show
from ptne_env.cli import options
from ptne_env.cli.app import app
from ptne_env.cli.console import check_writable, console, json_text, progress, say, write_json
from ptne_env.shared.files import write_atomically


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for figures, results.json and a page; made if missing.")] = Path(
        "results/paper"
    ),
    json: options.Json = None,
) -> None:
    """Reproduce the paper: Table I, every figure, and a measured verdict on every claim and erratum.

    Simulates the laws in continuous time, with the matrix exponential as the exact reference where the game is affine.
    """
    from ptne_env.bench.report.paper import paper_page, paper_tables  # it takes a second
    from ptne_env.bench.report.reproduction import reproduce as run

    page = out / "index.html"
    check_writable(json, page)
    with progress("reproducing") as advance:
        reproduction = run(out, progress=advance)
    write_atomically(page, paper_page(reproduction, shlex.join(["ptne", "reproduce", "--out", str(out)])))
    write_json(json, json_text(reproduction.to_dict()))
    screen = console()
    for table in paper_tables(reproduction):
        screen.print(show(table, screen.width))
    say(f"{len(reproduction.figures)} figures and {reproduction.results.name} written to {out}")
    say(f"Report written to {page}: open it in a browser")
