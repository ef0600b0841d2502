"""The command line: ``ptne compare | render | certify | sweep | reproduce | train | list``; it calls and prints."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

try:
    import typer
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
    from rich.text import Text
except ImportError as error:  # pragma: no cover - exercised in an environment without the extra
    raise SystemExit('the command line needs an extra: pip install "ptne-env[bench]"') from error

from ptne_env import theory
from ptne_env._version import __version__
from ptne_env.evaluation import Entry, default_entries, evaluate, get_entry, suite_entries
from ptne_env.evaluation.benchmark import check, executes_code, get_participant, run_suite
from ptne_env.evaluation.compare import count_cells
from ptne_env.evaluation.entries import law_part
from ptne_env.evaluation.leaderboard import leaderboard
from ptne_env.evaluation.suite import SUITES, find_scenario, get_suite
from ptne_env.evaluation.sweep import SWEEPS, run_sweep
from ptne_env.evaluation.traces import comparison_scenes, suite_scenes
from ptne_env.files import write_atomically
from ptne_env.report import (
    certificate_tables,
    comparison_report,
    comparison_tables,
    entry_table,
    film,
    leaderboard_tables,
    metric_table,
    render_page,
    repetition_table,
    save_diagram,
    scenario_table,
    suite_report,
    suite_table,
)
from ptne_env.scenario import CATALOGUE

_HOLD_STEPS = 50

_PIPE_WIDTH = 172
"""Width of tables where the output is no terminal, which would otherwise be cut to 80 columns."""

app = typer.Typer(
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    help="Prescribed-time Nash-equilibrium seeking: compare policies with the analytical laws of Feng and Hu's paper, "
    "reproduce the paper, and certify scenarios beforehand.",
)


@dataclass
class _Options:
    """What was said before the command."""

    quiet: bool = False
    debug: bool = False


_options = _Options()


def _console(*, stderr: bool = False) -> Console:
    stream = sys.stderr if stderr else sys.stdout
    return Console(stderr=stderr, width=None if stream.isatty() else _PIPE_WIDTH, quiet=_options.quiet and not stderr)


def _progress(console: Console) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=console, transient=True, disable=_options.quiet or not console.is_terminal)


def _version(value: bool) -> None:  # noqa: FBT001 - typer's callback signature
    if value:
        typer.echo(f"ptne_env {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[  # noqa: ARG001, FBT002 - handled by its callback
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    quiet: Annotated[  # noqa: FBT002 - a flag
        bool, typer.Option("--quiet", "-q", help="Print nothing but errors, and what '--json -' asks for.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show where an error comes from.")] = False,  # noqa: FBT002 - a flag
) -> None:
    """Options of every command."""
    _options.quiet, _options.debug = quiet, debug


@app.command()
def compare(
    *,
    scenario: Annotated[
        list[str] | None,
        typer.Option(help="A scenario by name; repeat for several. All of the catalogue if left out. See 'ptne list'."),
    ] = None,
    policy: Annotated[
        list[str] | None,
        typer.Option(
            help="A policy by name, an .onnx file, or 'module:object' that is called with the layout and returns "
            "something with predict(); repeat for several. If left out: the paper's laws, and the learned policies on "
            "the scenarios they were trained for; with --suite, all laws and all learned policies. With --suite also a "
            "Stable-Baselines3 .zip, or 'name=pattern' for the files of several training seeds."
        ),
    ] = None,
    policies: Annotated[str | None, typer.Option(help="Policies as one list, separated by commas.")] = None,
    episodes: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Held-out episodes per scenario, the same for every policy.",
            show_default="1000, or the suite's own number",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the starts.")] = 0,
    hold_steps: Annotated[
        int, typer.Option(min=0, help="Steps after the deadline, for 'digits after hold'.")
    ] = _HOLD_STEPS,
    json: Annotated[str | None, typer.Option(help="Write everything as JSON to this file; '-' for stdout.")] = None,
    csv: Annotated[Path | None, typer.Option(help="Write the records as CSV to this file.")] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            help="Write the report, a page for a browser, to this file. Left out with '--json -'.",
            show_default="report/index.html in results/, or in the suite's folder",
        ),
    ] = None,
    no_report: Annotated[bool, typer.Option("--no-report", help="Write no report.")] = False,
    suite: Annotated[
        str | None, typer.Option(help="Run the tracks of a suite instead, such as ptne-v1, or 'module:object'.")
    ] = None,
    track: Annotated[
        list[str] | None, typer.Option(help="With --suite: a track by name; repeat for several. All if left out.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="With --suite: folder of the results, where an interrupted run goes on.",
            show_default="results/SUITE",
        ),
    ] = None,
    jobs: Annotated[int, typer.Option(help="With --suite: processes; -1 for one per core.")] = -1,
    repeat: Annotated[
        Path | None,
        typer.Option("--check", help="Run a random sample of the cells of a suite's results again: results.json."),
    ] = None,
    sample: Annotated[int, typer.Option(min=1, help="With --check: how many cells.")] = 5,
    tolerance: Annotated[
        float, typer.Option(min=0.0, help="With --check: largest |new − old|/(1 + |old|) that counts as the same.")
    ] = 0.0,
    trust: Annotated[
        bool, typer.Option("--trust", "--yes", help="Load .zip files, which executes code in them, without asking.")
    ] = False,
) -> None:
    """Run policies on scenarios and print how close they came to the equilibrium by the deadline, and at what cost.

    Every policy meets the same seeded episodes; the paper's own start is a row of its own. Intervals are 95 %
    percentile bootstrap intervals of the mean over episodes. Learned policies are also measured, paired by episode,
    against laws that were tuned on a validation bank.

    With --suite, run the tracks of a frozen benchmark cell by cell; see docs/protocol.md.
    """
    names = [*(policy or ()), *(policies.split(",") if policies else ())]
    if no_report and report is not None:
        raise ValueError("--report and --no-report exclude each other")
    folder = Path("results") if suite is None else out or Path("results") / get_suite(suite).name
    page = None if no_report or (json == "-" and report is None) else report or folder / "report" / "index.html"
    if repeat is not None:
        _check(repeat, sample, tolerance, trust=trust)
    elif suite is not None:
        if scenario or hold_steps != _HOLD_STEPS or csv is not None:
            raise ValueError("a suite fixes what is run: leave out --scenario, --hold-steps and --csv")
        _run_suite(suite, names, track, folder, seed, episodes, jobs, json, page, trust=trust)
    elif track or out is not None:
        raise ValueError("--track and --out are for suites: name one with --suite")
    else:
        chosen = scenario or list(CATALOGUE)
        _compare(names or default_entries(), chosen, episodes or 1000, seed, hold_steps, json, csv, page)


def _compare(
    entries: Sequence[str | Entry],
    scenarios: Sequence[str],
    episodes: int,
    seed: int,
    hold_steps: int,
    json: str | None,
    csv: Path | None,
    page: Path | None,
) -> None:
    with _progress(_console(stderr=True)) as progress:
        task = progress.add_task("comparing", total=count_cells(entries, scenarios))

        def advance(cell: str) -> None:
            progress.update(task, advance=1, description=cell)

        results = evaluate(entries, scenarios, episodes=episodes, seed=seed, hold_steps=hold_steps, progress=advance)
        if csv is not None:
            write_atomically(csv, results.to_csv())
        if json not in (None, "-"):
            write_atomically(Path(json), results.to_json() + "\n")
        if page is not None:
            progress.reset(task, total=len(results.scenarios))
            scenes = comparison_scenes(results, progress=lambda label: advance(f"report: {label}"))
            report = comparison_report(results, scenes, episodes=episodes, hold_steps=hold_steps)
            write_atomically(page, render_page(report))
    if json == "-":
        typer.echo(results.to_json())
        return
    console = _console()
    console.print(comparison_tables(results, console.width))
    _tell_files(console, (json, csv), page)


def _tell_files(console: Console, results: Sequence[str | Path | None], page: Path | None) -> None:
    for path in results:
        if path is not None:
            console.print(Text(f"Results written to {path}"), soft_wrap=True)
    if page is not None:
        console.print(Text(f"Report written to {page}: open it in a browser"), soft_wrap=True)


def _trusted(names: list[str], *, trust: bool) -> bool:
    """Ask whether code in archives may be executed, where that has not been said."""
    archives = [name for name in names if executes_code(name)]
    if trust or not archives:
        return True
    if not sys.stdin.isatty():
        raise ValueError(
            f"loading {', '.join(archives)} executes code that is stored there: say --trust if you trust it"
        )
    return typer.confirm(
        f"Loading {', '.join(archives)} executes code that is stored there. Do you trust it?", abort=True
    )


def _run_suite(
    name: str,
    policies: list[str],
    tracks: list[str] | None,
    folder: Path,
    seed: int,
    episodes: int | None,
    jobs: int,
    json: str | None,
    page: Path | None,
    *,
    trust: bool,
) -> None:
    suite = get_suite(name)
    trusted = _trusted(policies, trust=trust)
    participants = [get_participant(policy, trust=trusted) for policy in policies or suite_entries()]
    with _progress(_console(stderr=True)) as progress:
        task = progress.add_task(suite.name, total=None)

        def advance(cell: str, total: int) -> None:
            progress.update(task, advance=1, total=total, description=cell)

        run = run_suite(
            name, participants, folder, tracks=tracks, seed=seed, episodes=episodes, jobs=jobs, progress=advance
        )
        progress.update(task, description="statistics")
        board = leaderboard(run)
        text = board.to_json()
        write_atomically(folder / "results.json", text + "\n")
        if json not in (None, "-"):
            write_atomically(Path(json), text + "\n")
        if page is not None:
            progress.reset(task, total=len(run.tracks))
            scenes = suite_scenes(run, progress=lambda track: advance(f"report: {track}", len(run.tracks)))
            write_atomically(page, render_page(suite_report(board, scenes, folder=str(folder))))
    if json == "-":
        typer.echo(text)
        return
    console = _console()
    console.print(leaderboard_tables(board, console.width))
    _tell_files(console, (folder / "results.json",), page)


def _check(results: Path, sample: int, tolerance: float, *, trust: bool) -> None:
    with _progress(_console(stderr=True)) as progress:
        task = progress.add_task("repeating", total=None)

        def advance(cell: str, total: int) -> None:
            progress.update(task, advance=1, total=total, description=cell)

        repetitions = check(results, sample=sample, trust=trust, progress=advance)
    _console().print(repetition_table(repetitions, tolerance))
    if any(one.difference > tolerance for one in repetitions):
        raise typer.Exit(1)


@app.command()
def render(
    scenario: Annotated[str, typer.Argument(help="A scenario by name, or a track's, such as ptne-v1/delay.")],
    policy: Annotated[str, typer.Argument(help="A policy by name, an .onnx file, or 'module:object'.")],
    *,
    out: Annotated[
        Path,
        typer.Option(help="The film: .gif, .mp4 (needs ffmpeg), or .html, a page to scrub through. Made if missing."),
    ],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the start, where one is drawn.")] = 0,
    hold_steps: Annotated[
        int | None, typer.Option(min=0, help="Steps after the deadline.", show_default="the scenario's own")
    ] = None,
    pictures: Annotated[int, typer.Option(min=2, help="Pictures of a .gif or .mp4.")] = 100,
) -> None:
    """Write an episode as a film: strategies, estimates, distances and live links over time."""
    world, entry = find_scenario(scenario), get_entry(policy)
    if hold_steps is not None:
        world = world.replace(hold_steps=hold_steps)
    with _progress(_console(stderr=True)) as progress:
        task = progress.add_task(f"{scenario}: {policy}", total=None)

        def advance(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        film(world, entry, out, seed=seed, pictures=pictures, progress=advance)
    _console().print(Text(f"Film written to {out}"), soft_wrap=True)


@app.command()
def certify(
    scenario: Annotated[
        str, typer.Argument(help="A scenario by name, or a track such as ptne-v1/delay; see 'ptne list'.")
    ],
    law: Annotated[
        str,
        typer.Option(
            help="A law by name (static, adaptive, corollary-one, gadjov-pavel, grounded), by its class in "
            "ptne_env.laws (FixedGain, LocallyImplicit, …), or as 'module:object' that is called with the layout."
        ),
    ] = "static",
    kappa: Annotated[
        float | None, typer.Option(help="Consensus gain κ of the law; the law's own if left out (static: 2).")
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Standard deviation σ of additive noise on every message, to be predicted.",
            show_default="the channel's",
        ),
    ] = None,
    delay: Annotated[
        int | None,
        typer.Option(min=0, help="Steps that every message is late, to be predicted.", show_default="the channel's"),
    ] = None,
    hold_steps: Annotated[int, typer.Option(min=0, help="Steps after the deadline, for the digits there.")] = 50,
    json: Annotated[
        str | None, typer.Option(help="Write the certificate as JSON to this file; '-' for stdout.")
    ] = None,
) -> None:
    """Say before anything runs what a law can promise on a scenario.

    Prints the assumptions of the paper with the number that decides each, the gain condition, rates, the digits
    predicted at the deadline, the largest stable step, and what noise and late messages do. docs/theory.md says which
    of them are exact and which are bounds.
    """
    from json import dumps

    chosen = find_scenario(scenario)
    if hold_steps and chosen.gain > 0:
        chosen = chosen.replace(hold_steps=hold_steps)
    certificate = theory.certify(chosen, law=law_part(law, kappa), noise_std=noise, delay_steps=delay)
    text = dumps(certificate.to_dict(), indent=2, allow_nan=False, ensure_ascii=False)
    if json == "-":
        typer.echo(text)
        return
    _console().print(certificate_tables(certificate))
    if json is not None:
        write_atomically(Path(json), text + "\n")
        _console().print(Text(f"Certificate written to {json}"), soft_wrap=True)


@app.command()
def sweep(
    diagram: Annotated[
        list[str] | None, typer.Argument(help=f"Which diagrams: {', '.join(SWEEPS)}. All if left out.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the pictures; made if missing.")] = Path("results/sweep"),
    points: Annotated[int, typer.Option(min=2, help="Points along each axis.")] = 14,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes per point, from random starts.")] = 8,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the starts and of the noise.")] = 0,
    jobs: Annotated[int, typer.Option(help="Processes; -1 for one per core.")] = -1,
    json: Annotated[str | None, typer.Option(help="Write the numbers as JSON to this file; '-' for stdout.")] = None,
) -> None:
    """Draw phase diagrams: digits at the deadline over two parameters, as measured and as predicted.

    gain-step is over κ and the step Θ, noise-horizon over noise and s_end, dwell-gain over dwell time and c. Every
    point is a batch of episodes of the static law in the environment; docs/theory.md explains the lines.
    """
    console, names = _console(), diagram or list(SWEEPS)
    diagrams = []
    with _progress(_console(stderr=True)) as progress:
        for name in names:
            task = progress.add_task(name, total=None)

            def advance(done: int, total: int, task: TaskID = task) -> None:
                progress.update(task, completed=done, total=total)

            diagrams.append(run_sweep(name, points=points, episodes=episodes, seed=seed, jobs=jobs, progress=advance))
    for each in diagrams:
        save_diagram(each, out / f"{each.name}.png")
    text = f"[{', '.join(each.to_json() for each in diagrams)}]"
    if json == "-":
        typer.echo(text)
        return
    for each in diagrams:
        line = f"{each.name}: measured and predicted digits differ by at most {each.difference:.1g}"
        console.print(Text(f"{line}; {out / each.name}.png"), soft_wrap=True)
    if json is not None:
        write_atomically(Path(json), text + "\n")
        console.print(Text(f"Numbers written to {json}"), soft_wrap=True)


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for figures (PNG, SVG) and results.json; made if missing.")] = Path(
        "results/paper"
    ),
) -> None:
    """Reproduce the paper: Table 1, every figure, and a measured verdict on every claim and erratum.

    Simulates the laws in continuous time, with the matrix exponential as the exact reference where the game is affine.
    """
    from ptne_env import paper

    with _progress(_console(stderr=True)) as progress:
        task = progress.add_task("reproducing", total=None)

        def advance(done: int, total: int, what: str) -> None:
            progress.update(task, completed=done, total=total, description=what)

        reproduction = paper.reproduce(out, progress=advance)
    console = _console()
    console.print(*paper.render(reproduction))
    written = f"{len(reproduction.figures)} figures and {reproduction.results.name} written to {out}"
    console.print(Text(written), soft_wrap=True)


@app.command()
def train(
    configuration: Annotated[
        str, typer.Argument(help="A shipped configuration by name (such as random-energy), or a .toml file.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the policy, logs and checkpoints; made if missing.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the network, the sampling and the training games.")] = 0,
    steps: Annotated[int | None, typer.Option(min=1, help="Agent-steps; the configuration's own if left out.")] = None,
) -> None:
    """Train a policy with PPO and export it as policy.onnx.

    An interrupted run goes on from its last checkpoint when the same command is given again.
    """
    try:
        from ptne_env.training import ppo
    except ImportError as error:
        raise ImportError('training needs an extra: pip install "ptne-env[sb3]"') from error

    changes = {"seed": seed} if steps is None else {"seed": seed, "steps": steps}
    arguments = ppo.Arguments.from_toml(configuration, **changes)
    with _progress(_console(stderr=True)) as progress:
        task = progress.add_task("training", total=arguments.steps)

        def advance(done: int, total: int, digits: float) -> None:
            progress.update(task, completed=done, total=total, description=f"training, {digits:.2f} digits gained")

        summary = ppo.train(arguments, out, advance)
    digits = summary["validation_digits"]
    _console().print(Text(f"{digits:.2f} digits on the validation bank; policy.onnx written to {out}"), soft_wrap=True)


@app.command("list")
def list_() -> None:
    """Show what there is: scenarios, policies and metrics."""
    console = _console()
    console.print(scenario_table(), entry_table(), metric_table(), *(suite_table(get_suite(name)) for name in SUITES))


def main() -> None:
    """Run the command line; exit codes are 0 done, 1 failed, 2 wrong usage.

    Modules of the current folder are found too, after everything that is installed.
    """
    sys.path.append(str(Path.cwd()))
    try:
        app()
    except ValueError as error:
        _fail(str(error), 2)
    except (OSError, ImportError) as error:
        _fail(str(error), 1)


def _fail(message: str, code: int) -> None:
    if _options.debug:
        _console(stderr=True).print_exception()
    _console(stderr=True).print(
        Text("Error: ", style="bold red").append(message, style="not bold default"), soft_wrap=True
    )
    raise SystemExit(code)


if __name__ == "__main__":
    main()
