"""``ptne compare`` and ``ptne check``: run policies on scenarios or on the tracks of a suite, and check results."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Annotated

import typer

from ptne_env import learn as learned
from ptne_env.bench import report
from ptne_env.cli import options
from ptne_env.cli.app import ExitCode, app
from ptne_env.cli.console import STDOUT, check_writable, console, json_text, progress, say, write_json
from ptne_env.evaluation import (
    POLICIES,
    Results,
    Suite,
    default_policies,
    get_policy_spec,
    get_suite,
    run_suite,
    suite_policies,
)
from ptne_env.evaluation.check import check as run_check
from ptne_env.evaluation.check import foreign_code as foreign_code_of_results
from ptne_env.evaluation.marl_eval import marl_eval_json
from ptne_env.evaluation.policy_specs import foreign_code
from ptne_env.evaluation.suite import COMPARED_EPISODES, SUITES, comparison, foreign_suites, world_names
from ptne_env.evaluation.traces import scenes
from ptne_env.evaluation.workers import Workers
from ptne_env.shared.files import write_atomically
from ptne_env.shared.names import unknown_name
from ptne_env.world.catalogue import CATALOGUE

_FILES = ("results.json", "results.csv", "marl-eval.json")
_HOLD_STEPS = 25

_REPORT_SHARE = 25
"""The part of the bar, in percent, that belongs to the episodes of the report."""


def _complete_track(context: typer.Context) -> list[str]:
    suite: str = context.params.get("suite") or ""
    return [track.name for track in get_suite(suite).tracks] if suite in SUITES else world_names()


def _tracks_of(suite: str | None, names: list[str]) -> tuple[str | None, list[str]]:
    """The suite that the names belong to, ``None`` for scenarios, and the names without it."""
    suites = {name.rpartition("/")[0] or suite for name in names} or {suite}
    if len(suites) > 1 or suite not in (None, *suites):
        raise ValueError(
            f"a comparison is of scenarios, or of the tracks of one suite; got {', '.join(map(repr, names))}"
            + f" and --suite {suite}" * (suite is not None)
        )
    return suites.pop(), [name.rpartition("/")[2] for name in names]


def _require_scenario(name: str) -> None:
    if name in (*POLICIES, *learned.shipped()):
        raise ValueError(f"{name!r} is a policy, no scenario: write --policy {name}")
    if name not in CATALOGUE and ":" not in name:
        raise ValueError(unknown_name("scenario", name, world_names()))


@app.command()
def compare(
    scenario: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENARIO]...",
            help="Scenarios by name or 'module:object', or tracks of one suite, such as ptne-v1/delay; with --suite "
            "the names of tracks. All if left out. See 'ptne list'.",
            autocompletion=_complete_track,
        ),
    ] = None,
    *,
    suite: Annotated[
        str | None,
        typer.Option(
            help="Run the tracks of a suite, such as ptne-v1, instead of scenarios; 'module:object' runs code of that "
            "module.",
            autocompletion=lambda: list(SUITES),
        ),
    ] = None,
    track: Annotated[
        list[str] | None,
        typer.Option(
            "--scenario",
            "--track",
            help="The same as SCENARIO; repeat for several.",
            autocompletion=_complete_track,
        ),
    ] = None,
    policy: Annotated[
        list[str] | None,
        typer.Option(
            help="A policy by name, an .onnx file, a Stable-Baselines3 .zip, 'module:object' that is called with the "
            "layout and returns something with predict(), or 'name=pattern' for the files of several training seeds; "
            "separate several by commas, or repeat. A .zip and a 'module:object' run their own code. If left out: the "
            "paper's laws, two strong ones, and learned policies on scenarios that they were trained on; with --suite, "
            "all laws and all learned policies.",
            autocompletion=options.complete_policy,
        ),
    ] = None,
    episodes: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Test episodes per scenario or track, the same for every policy.",
            show_default=f"{COMPARED_EPISODES}, or the suite's own number",
        ),
    ] = None,
    seed: options.Seed = 0,
    hold_steps: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Steps after the deadline, for 'digits after hold'; a suite has its own.",
            show_default=str(_HOLD_STEPS),
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder of results.json, results.csv, marl-eval.json (the format of these tools), report.html and the "
            "finished jobs, from which an interrupted run goes on. With '--json -' nothing is written unless it is "
            "given.",
            show_default="results/comparison, or results/SUITE",
        ),
    ] = None,
    details: Annotated[
        bool,
        typer.Option("--details", help="Print all tables too: every metric of every policy on every track."),
    ] = False,
    with_report: Annotated[bool, typer.Option("--report/--no-report", help="Write the page report.html.")] = True,
    rerun: Annotated[
        bool,
        typer.Option(
            "--rerun",
            help="Compute every job again, also stored ones. Needed for policies whose sources cannot be hashed.",
        ),
    ] = False,
    jobs: options.Jobs = -1,
    ray: options.Ray = None,
    json: options.Json = None,
    trust: options.Trust = False,
) -> None:
    """Run policies on scenarios and print how close they come to the equilibrium by the deadline.

    The output is one table and three sentences; the page report.html, and --details, have all metrics.

    Every policy is run from the same seeded episodes. Intervals are 95 % intervals of the mean over episodes and
    training seeds.

    With --suite, run the tracks of a frozen benchmark, with scores and ranks; see docs/protocol.md.
    """
    suite, places = _tracks_of(suite, [*(scenario or ()), *(track or ())])
    names = [name for given in policy or () for name in given.split(",") if name]
    trust = options.trusted(
        [*foreign_suites(suite, *places), *(code for name in names for code in foreign_code(name))], trust=trust
    )
    chosen, tracks = _chosen(suite, places, episodes, hold_steps)
    folder = out or (None if json == STDOUT else Path("results") / chosen.name)
    files = {} if folder is None else {name: folder / name for name in _FILES}
    page = None if folder is None or not with_report else folder / "report.html"
    check_writable(json, page, *files.values())
    named = [get_policy_spec(name, trust=trust) for name in names]
    policies = named or (suite_policies() if suite else default_policies())
    workers = Workers(jobs, ray)
    jobs_share = 100 if page is None else 100 - _REPORT_SHARE
    with progress(f"{chosen.name}: making the jobs") as advance:
        results = run_suite(
            suite or chosen,
            policies,
            tracks=tracks,
            episodes=episodes,
            seed=seed,
            folder=folder,
            rerun=rerun,
            workers=workers,
            progress=lambda job, done, total: advance(round(jobs_share * done / total), 100, job),
        )
        advance(jobs_share, description="statistics")
        text = results.to_json()
        write_json(json, text)
        if folder is not None:
            write_atomically(files["results.json"], text + "\n")
            write_atomically(files["results.csv"], results.to_csv())
            write_atomically(files["marl-eval.json"], marl_eval_json(results) + "\n")
        if page is not None:
            finished = itertools.count(1)
            drawn = scenes(
                results,
                workers=workers,
                progress=lambda name, total: advance(
                    jobs_share + round((100 - jobs_share) * next(finished) / total), description=f"report: {name}"
                ),
            )
            write_atomically(page, report.page(results, drawn, names))
    _show(results, files, page, details=details)
    if results.failures:
        raise typer.Exit(ExitCode.FAILED)


def _chosen(
    suite: str | None, places: list[str], episodes: int | None, hold_steps: int | None
) -> tuple[Suite, list[str] | None]:
    """The suite of a comparison or of that name, and the names of its tracks to run; all without places."""
    if suite is not None:
        if hold_steps is not None:
            raise ValueError("a suite fixes the steps after the deadline: leave out --hold-steps")
        return get_suite(suite), places or None
    for name in places:
        _require_scenario(name)
    held = _HOLD_STEPS if hold_steps is None else hold_steps
    return comparison(places or CATALOGUE, episodes=episodes or COMPARED_EPISODES, hold_steps=held), None


def _show(results: Results, files: Mapping[str, Path], page: Path | None, *, details: bool) -> None:
    """Print the answer, after all tables if wanted, and the places of files and page."""
    screen = console()
    if details:
        screen.print(report.result_tables(results, screen.width))
    screen.print(report.answer_tables(results, screen.width))
    for (place, name), reason in results.failures.items():
        say(f"Failed: {name} on {place}: {reason}")
    if files:
        say(f"Results written to {', '.join(map(str, files.values()))}")
    if page is not None:
        say(f"Report written to {page}: open it in a browser")
    if not details:
        say("All metrics of all policies: the same command with --details")


@app.command()
def check(
    results: Annotated[
        Path, typer.Argument(help="The file results.json of a comparison or suite, its folder, or an archive .tar.xz.")
    ],
    *,
    sample: Annotated[int, typer.Option(min=1, help="Number of jobs to run again.")] = 5,
    tolerance: Annotated[
        float, typer.Option(min=0.0, help="Largest |new − old|/(1 + |old|) of a number that counts as the same.")
    ] = 0.0,
    trust: options.Trust = False,
    json: options.Json = None,
) -> None:
    """Rebuild all tables of published results from the stored jobs, and run a random sample of the jobs again.

    Each of these jobs runs on the published episodes, where every number must repeat, and on as many fresh episodes,
    where the score must not be worse than chance allows.

    The exit code is 0 when everything agrees, 1 when something differs, and 3 when nothing differs but the files of
    some policies are missing, so that their jobs cannot run again.
    """
    check_writable(json)
    trust = options.trusted(foreign_code_of_results(results), trust=trust)
    with progress("checking") as advance:
        outcome = run_check(
            results,
            sample=sample,
            tolerance=tolerance,
            trust=trust,
            progress=lambda job, total: advance(total=total, description=job),
        )
    rows = [
        {
            "track": repetition.job.track.name,
            "policy": repetition.job.policy.name,
            "training_seed": repetition.job.training_seed,
            "difference": repetition.difference if isfinite(repetition.difference) else None,
            "failure": repetition.failure,
            "published": repetition.published,
            "fresh": repetition.fresh,
            "probability": repetition.probability,
            "passes": repetition.passes(tolerance),
        }
        for repetition in outcome.repetitions
    ]
    found = {"differences": outcome.differences, "missing": outcome.missing, "left_out": outcome.left_out, "jobs": rows}
    write_json(json, json_text(found))
    console().print(report.check_tables(outcome, tolerance))
    if not outcome.passes(tolerance):
        raise typer.Exit(ExitCode.FILE if outcome.agrees(tolerance) else ExitCode.FAILED)
