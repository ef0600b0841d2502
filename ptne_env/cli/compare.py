"""``ptne compare``: run policies on scenarios or on the tracks of a suite."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from ptne_env.cli import options
from ptne_env.cli.app import ExitCode, app
from ptne_env.cli.console import STDOUT, check_writable, console, progress, say, this_command, write_json
from ptne_env.evaluation import COMPARED, ENTERED, POLICIES, PolicySpec, Results, evaluate, get_policy_spec
from ptne_env.evaluation.tracks import EPISODES, get_suite
from ptne_env.execution import Runner, Workers
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.observation import LayoutError
from ptne_env.perception.policy import PolicyError
from ptne_env.report.page import results_page
from ptne_env.report.terminal import answer_tables, result_tables
from ptne_env.shared.files import write_atomically
from ptne_env.shared.parts import FactorySpec, is_part, names_of
from ptne_env.suites import run_suite
from ptne_env.world.catalogue import get_scenario, scenario_names
from ptne_env.world.world import World

SUITE = "ptne-v1"
"""The suite that is run where neither a suite nor a scenario is named."""


def _complete_policy(incomplete: str) -> list[str]:
    """Return the names of policies, also after a comma."""
    done, comma, _ = incomplete.rpartition(",")
    return [f"{done}{comma}{name}" for name in POLICIES]


@app.command()
def compare(
    scenario: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SCENARIO",
            help="Scenarios by name or 'module:object', or tracks of one suite, such as ptne-v1/liar; with --suite "
            "the names of tracks, or all of its tracks if left out. See 'ptne list'.",
            autocompletion=scenario_names,
        ),
    ] = None,
    *,
    suite: Annotated[
        str | None,
        typer.Option(
            help="Run the tracks of a suite instead of scenarios; 'module:object' runs code of that module.",
            show_default=f"{SUITE}, where no scenario is named",
            autocompletion=lambda: names_of("suite"),
        ),
    ] = None,
    policy: Annotated[
        list[str] | None,
        typer.Option(
            help="A policy by name, as static or static(kappa=4), an .npz file, a Stable-Baselines3 .zip, a "
            "'module:object' that is called with the layout and returns something with predict(), or 'name=pattern' "
            "for the files of several training seeds. Separate policies by commas, or repeat the option. If left out: "
            "every policy that 'ptne list' shows but those in code; on scenarios, the paper's laws, references, the "
            "strongest laws and learned policies.",
            autocompletion=_complete_policy,
        ),
    ] = None,
    changes: options.SetOption = None,
    episodes: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Number of test episodes per scenario or track, the same for every policy.",
            show_default=f"{EPISODES}, or the suite's own number",
        ),
    ] = None,
    seed: options.SeedOption = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for results.json, results.csv, report.html and the finished jobs, from which an interrupted "
            "run goes on. With '--json -' files are written only if a folder is named.",
            show_default="results/SUITE, or results/comparison",
        ),
    ] = None,
    details: Annotated[bool, typer.Option("--details", help="Also print the tables of all metrics.")] = False,
    with_report: Annotated[bool, typer.Option("--report/--no-report", help="Write the page report.html.")] = True,
    jobs: Annotated[int, typer.Option(help="Number of tasks at a time; -1 for one per core.")] = -1,
    ray: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Run the tasks on a Ray cluster: auto, local, or HOST:6379.")
    ] = None,
    json: options.JsonOption = None,
    trust: options.TrustOption = False,
) -> None:
    """Run policies on a suite or on scenarios, and print how close they come to the equilibrium by the deadline.

    The output is one table, one or two sentences and the path of a page, which has all metrics, the error over time and
    a player of an episode.

    Every policy is run from the same seeded episodes. Intervals are 95 % intervals of the mean over episodes and
    training seeds.
    """
    suite, places = _split_names(suite, scenario or [])
    names = options.split_policies(policy or ())
    if policy and not names:
        raise ValueError("--policy names no policy: leave it out for the usual ones; 'ptne list policies' shows all")
    trust = options.require_trust(options.foreign_names(suite, *places, *names), trust=trust)
    title = "comparison" if suite is None else get_suite(suite).name
    folder = out or (None if json == STDOUT else Path("results") / title)
    files = [] if folder is None else [folder / "results.json", folder / "results.csv"]
    page = None if folder is None or not with_report else folder / "report.html"
    check_writable(json, page, *files)
    policies = [get_policy_spec(name, trust=trust) for name in names]
    _check_arguments(policies)
    run = _choose_run(suite, places, changes, policies, episodes, trust=trust)
    workers = Workers(jobs, ray)
    if files and files[0].exists():
        say(f"The results will replace earlier ones in {folder}; another --out keeps both")
    with progress(f"{title}: making the jobs") as advance:
        results = run(seed=seed, run=Runner(folder, workers, advance))
    if not results.samples:
        say("\n".join(f"{name} on {place} {reason}" for (place, name), reason in results.reasons.items()))
        raise typer.Exit(ExitCode.FAILED)
    text = results.to_json()
    write_json(json, text)
    if folder is not None:
        write_atomically(files[0], text + "\n")
        write_atomically(files[1], results.to_csv())
    if page is not None:
        with progress("figures of the page") as advance:
            write_atomically(page, results_page(results, this_command(), workers, advance))
    screen = console()
    if details:
        screen.print(result_tables(results, screen.width))
    screen.print(answer_tables(results, screen.width, whole=details))
    if files:
        say(f"Results written to {files[0]} and {files[1]}")
    if page is not None:
        say(f"Report written to {page}: open it in a browser")
    if results.failures:
        raise typer.Exit(ExitCode.FAILED)


def _check_arguments(policies: list[PolicySpec]) -> None:
    """Raise a ``ValueError`` for a shipped law whose arguments are out of range, which would fail on every track."""
    world = World(get_scenario("energy"))
    for spec in policies:
        if isinstance(spec.policy, FactorySpec) and is_part(spec.policy.target) and not spec.files:
            try:
                spec.build(Encoder(world, spec.interface).layout)
            except LayoutError:
                continue  # it may fit other worlds
            except PolicyError as error:
                raise ValueError(f"{spec.name}: {error}") from error


def _split_names(suite: str | None, names: list[str]) -> tuple[str | None, list[str]]:
    """Return the suite that the names belong to, ``None`` for scenarios, and the names without it."""
    if not names:
        return suite or SUITE, []
    published = names_of("suite")
    suites = {name if name in published else name.rpartition("/")[0] or suite for name in names}
    if len(suites) > 1 or suite not in (None, *suites):
        raise ValueError(
            f"a comparison is of scenarios, or of the tracks of one suite; got {', '.join(map(repr, names))}"
            + f" and --suite {suite}" * (suite is not None)
        )
    return suites.pop(), [name.rpartition("/")[2] for name in names if name not in published]


def _choose_run(
    suite: str | None,
    places: list[str],
    changes: list[str] | None,
    policies: list[PolicySpec],
    episodes: int | None,
    *,
    trust: bool,
) -> Callable[..., Results]:
    """Return what runs the tracks of a suite (all without places), or scenarios; it takes ``seed`` and ``run``."""
    if suite is not None:
        if changes:
            raise ValueError("--set changes scenarios; the tracks of a suite are as they are")
        entries = policies or [POLICIES[name] for name in ENTERED]
        return partial(run_suite, suite, entries, tracks=places or None, episodes=episodes)
    for name in places:
        if name in POLICIES:
            raise ValueError(f"{name!r} is a policy, not a scenario: write --policy {name}")
    scenarios = [options.read_scenario(name, changes, trust=trust) for name in places]
    return partial(evaluate, policies or COMPARED, scenarios, episodes=episodes)
