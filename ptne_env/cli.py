"""The command line: ``ptne compare | render | certify | sweep | reproduce | train | list``; it calls and prints."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from json import dumps
from math import isfinite, isnan
from pathlib import Path
from typing import Annotated, TypeAlias

try:
    import typer
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
    from rich.table import Column
    from rich.text import Text
except ImportError as error:  # pragma: no cover - exercised in an environment without the extra
    raise SystemExit('the command line needs an extra: pip install "ptne-env[bench]"') from error

from ptne_env import policies as learned
from ptne_env import theory, training
from ptne_env._version import __version__
from ptne_env.catalogue import CATALOGUE
from ptne_env.experiments import (
    COMPARATIVE_METRICS,
    ENTRIES,
    METRICS,
    PolicySpec,
    default_entries,
    evaluate,
    get_policy_spec,
    suite_entries,
)
from ptne_env.experiments.benchmark import check, executes_code, get_participant, run_suite
from ptne_env.experiments.leaderboard import leaderboard
from ptne_env.experiments.policy_specs import law_names, law_part
from ptne_env.experiments.suite import SUITES, find_scenario, get_suite
from ptne_env.experiments.sweep import SWEEPS, run_sweep
from ptne_env.experiments.traces import comparison_scenes, suite_scenes
from ptne_env.experiments.workers import Workers
from ptne_env.files import require_writable, write_atomically
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

_HOLD_STEPS = 50

_INTERRUPTED = 130
"""Exit code after Ctrl-C."""

_PIPE_WIDTH = 172
"""Width of tables where the output is no terminal, which would otherwise be cut to 80 columns."""

app = typer.Typer(
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    help="Prescribed-time Nash-equilibrium seeking: compare policies with the analytical laws of Feng and Hu's paper, "
    "reproduce the paper, and certify scenarios beforehand.",
)


_Jobs = Annotated[int, typer.Option(help="Tasks at a time; -1 for one per core.")]
_Backend = Annotated[str, typer.Option(help="Where they run: 'processes' of this machine, or 'ray', a cluster.")]
_Address = Annotated[
    str | None,
    typer.Option(help="With --backend ray: the cluster, such as auto or HOST:6379.", show_default="RAY_ADDRESS"),
]


@dataclass
class _Options:
    """What holds for the whole run.

    Attributes:
        quiet: whether nothing is printed but errors, and JSON that is asked for.
        debug: whether errors show where they come from.
        stdout: descriptor of the real stdout while it is kept for JSON alone.
    """

    quiet: bool = False
    debug: bool = False
    stdout: int | None = None


_options = _Options()


def _console(*, stderr: bool = False) -> Console:
    stream = sys.stderr if stderr else sys.stdout
    return Console(
        stderr=stderr,
        width=None if stream.isatty() else _PIPE_WIDTH,
        quiet=not stderr and (_options.quiet or _options.stdout is not None),
        color_system=None if os.environ.get("NO_COLOR") else "auto",  # rich alone would still write bold and dim
    )


def _progress() -> Progress:
    columns = (
        TextColumn("{task.description}", table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis")),
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    disable = _options.quiet or not sys.stderr.isatty()
    return Progress(*columns, console=_console(stderr=True), transient=True, expand=True, disable=disable)


def _keep_interrupts_from_workers() -> None:
    """Let Ctrl-C reach this process alone, which then ends its workers, and no traceback of theirs is printed."""
    from joblib import parallel_config

    parallel_config(backend="loky", initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN))


def _keep_stdout(context: typer.Context, value: str | None) -> str | None:
    """With '--json -', send whatever else is printed to stderr, also what other code and processes print."""
    if value == "-" and not context.resilient_parsing:
        _options.stdout = os.dup(1)
        os.dup2(2, 1)
    return value


def _write_json(target: str | None, text: str) -> None:
    if target == "-" and _options.stdout is not None:
        with os.fdopen(_options.stdout, "w", encoding="utf-8", closefd=False) as stdout:
            stdout.write(text + "\n")
    elif target is not None:
        write_atomically(Path(target), text + "\n")


def _require_writable(*targets: str | Path | None) -> None:
    """Fail before the work rather than after it."""
    for target in targets:
        if target not in (None, "-"):
            require_writable(Path(target))


def _json_text(value: object) -> str:
    return dumps(value, indent=2, allow_nan=False, ensure_ascii=False)


def _complete_world() -> list[str]:
    return [*CATALOGUE, *(f"{name}/{track.name}" for name in SUITES for track in get_suite(name).tracks)]


def _complete_policy() -> list[str]:
    return [*ENTRIES, *learned.shipped()]


def _complete_policies(incomplete: str) -> list[str]:
    done, comma, _ = incomplete.rpartition(",")
    return [f"{done}{comma}{name}" for name in _complete_policy()]


def _complete_track(context: typer.Context) -> list[str]:
    asked = context.params.get("suite")
    return [track.name for name in SUITES if asked in (name, None) for track in get_suite(name).tracks]


_Json: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--json",
        callback=_keep_stdout,
        help="Write the results as JSON to this file; '-' for stdout, where nothing else is printed then.",
    ),
]


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
        typer.Option(
            help="A scenario by name; repeat for several. All of the catalogue if left out. See 'ptne list'.",
            autocompletion=lambda: list(CATALOGUE),
        ),
    ] = None,
    policy: Annotated[
        list[str] | None,
        typer.Option(
            help="A policy by name, an .onnx file, or 'module:object' that is called with the layout and returns "
            "something with predict(); repeat for several. If left out: the paper's laws, and the learned policies on "
            "the scenarios they were trained for; with --suite, all laws and all learned policies. With --suite also a "
            "Stable-Baselines3 .zip, or 'name=pattern' for the files of several training seeds.",
            autocompletion=_complete_policy,
        ),
    ] = None,
    policies: Annotated[
        str | None,
        typer.Option(help="Policies as one list, separated by commas.", autocompletion=_complete_policies),
    ] = None,
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
    json: _Json = None,
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
        str | None,
        typer.Option(
            help="Run the tracks of a suite instead, such as ptne-v1, or 'module:object'.",
            autocompletion=lambda: list(SUITES),
        ),
    ] = None,
    track: Annotated[
        list[str] | None,
        typer.Option(
            help="With --suite: a track by name; repeat for several. All if left out.", autocompletion=_complete_track
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="With --suite: folder of the results, where an interrupted run goes on.",
            show_default="results/SUITE",
        ),
    ] = None,
    jobs: _Jobs = -1,
    backend: _Backend = "processes",
    address: _Address = None,
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
    _keep_interrupts_from_workers()
    names = [*(policy or ()), *(policies.split(",") if policies else ())]
    workers = Workers(jobs, backend, address)
    if no_report and report is not None:
        raise ValueError("--report and --no-report exclude each other")
    folder = Path("results") if suite is None else out or Path("results") / get_suite(suite).name
    page = None if no_report or (json == "-" and report is None) else report or folder / "report" / "index.html"
    if repeat is not None:
        _require_writable(json)
        _check(repeat, sample, tolerance, json, trust=trust)
    elif suite is not None:
        if scenario or hold_steps != _HOLD_STEPS or csv is not None:
            raise ValueError("a suite fixes what is run: leave out --scenario, --hold-steps and --csv")
        _require_writable(folder / "results.json", json, page)
        _run_suite(suite, names, track, folder, seed, episodes, workers, json, page, trust=trust)
    elif track or out is not None:
        raise ValueError("--track and --out are for suites: name one with --suite")
    else:
        _require_writable(json, csv, page)
        chosen = scenario or list(CATALOGUE)
        _compare(names or default_entries(), chosen, episodes or 1000, seed, hold_steps, workers, json, csv, page)


def _compare(
    entries: Sequence[str | PolicySpec],
    scenarios: Sequence[str],
    episodes: int,
    seed: int,
    hold_steps: int,
    workers: Workers,
    json: str | None,
    csv: Path | None,
    page: Path | None,
) -> None:
    with _progress() as progress:
        task = progress.add_task("comparing", total=None)

        def advance(cell: str, total: int) -> None:
            progress.update(task, advance=1, total=total, description=cell)

        results = evaluate(
            entries,
            scenarios,
            episodes=episodes,
            seed=seed,
            hold_steps=hold_steps,
            workers=workers,
            progress=advance,
        )
        if csv is not None:
            write_atomically(csv, results.to_csv())
        _write_json(json, results.to_json())
        if page is not None:
            count = len(results.scenarios)
            progress.reset(task, total=count)
            scenes = comparison_scenes(
                results, workers=workers, progress=lambda label: advance(f"report: {label}", count)
            )
            report = comparison_report(results, scenes, episodes=episodes, hold_steps=hold_steps)
            write_atomically(page, render_page(report))
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
    workers: Workers,
    json: str | None,
    page: Path | None,
    *,
    trust: bool,
) -> None:
    suite = get_suite(name)
    trusted = _trusted(policies, trust=trust)
    participants = [get_participant(policy, trust=trusted) for policy in policies or suite_entries()]
    with _progress() as progress:
        task = progress.add_task(suite.name, total=None)

        def advance(cell: str, total: int) -> None:
            progress.update(task, advance=1, total=total, description=cell)

        run = run_suite(
            name, participants, folder, tracks=tracks, seed=seed, episodes=episodes, workers=workers, progress=advance
        )
        progress.update(task, description="statistics")
        board = leaderboard(run)
        text = board.to_json()
        write_atomically(folder / "results.json", text + "\n")
        _write_json(json, text)
        if page is not None:
            progress.reset(task, total=len(run.tracks))
            scenes = suite_scenes(
                run, workers=workers, progress=lambda track: advance(f"report: {track}", len(run.tracks))
            )
            write_atomically(page, render_page(suite_report(board, scenes, folder=str(folder))))
    console = _console()
    console.print(leaderboard_tables(board, console.width))
    _tell_files(console, (folder / "results.json",), page)


def _check(results: Path, sample: int, tolerance: float, json: str | None, *, trust: bool) -> None:
    with _progress() as progress:
        task = progress.add_task("repeating", total=None)

        def advance(cell: str, total: int) -> None:
            progress.update(task, advance=1, total=total, description=cell)

        repetitions = check(results, sample=sample, trust=trust, progress=advance)
    _write_json(
        json,
        _json_text(
            [
                {
                    "track": one.cell.track.name,
                    "policy": one.cell.participant,
                    "run": one.cell.run,
                    "difference": one.difference if isfinite(one.difference) else None,
                    "reproduces": one.difference <= tolerance,
                }
                for one in repetitions
            ]
        ),
    )
    _console().print(repetition_table(repetitions, tolerance))
    if any(one.difference > tolerance for one in repetitions):
        raise typer.Exit(1)


@app.command()
def render(
    scenario: Annotated[
        str,
        typer.Argument(help="A scenario by name, or a track's, such as ptne-v1/delay.", autocompletion=_complete_world),
    ],
    policy: Annotated[
        str,
        typer.Argument(help="A policy by name, an .onnx file, or 'module:object'.", autocompletion=_complete_policy),
    ],
    *,
    out: Annotated[
        Path,
        typer.Option(help="The film: .gif, .mp4 (needs ffmpeg), or .html, a page to scrub through. Made if missing."),
    ],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the start, where one is drawn.")] = 0,
    hold_steps: Annotated[
        int | None, typer.Option(min=0, help="Steps after the deadline.", show_default="the scenario's own")
    ] = None,
    pictures: Annotated[int, typer.Option(min=2, help="Pictures of a film, or instants of a page.")] = 100,
) -> None:
    """Write an episode as a film: strategies, estimates, distances and live links over time."""
    _require_writable(out)
    world, entry = find_scenario(scenario), get_policy_spec(policy)
    if hold_steps is not None:
        world = world.replace(hold_steps=hold_steps)
    with _progress() as progress:
        task = progress.add_task(f"{scenario}: {policy}", total=None)

        def advance(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        film(world, entry, out, seed=seed, pictures=pictures, progress=advance)
    _console().print(Text(f"Film written to {out}"), soft_wrap=True)


@app.command()
def certify(
    scenario: Annotated[
        str,
        typer.Argument(
            help="A scenario by name, or a track such as ptne-v1/delay; see 'ptne list'.",
            autocompletion=_complete_world,
        ),
    ],
    law: Annotated[
        str,
        typer.Option(
            help="A law by name (static, adaptive, corollary-one, gadjov-pavel, grounded), by its class in "
            "ptne_env.laws (FixedGain, LocallyImplicit, …), or as 'module:object' that is called with the layout.",
            autocompletion=law_names,
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
    json: _Json = None,
) -> None:
    """Say before anything runs what a law can promise on a scenario.

    Prints the assumptions of the paper with the number that decides each, the gain condition, rates, the digits
    predicted at the deadline, the largest stable step, and what noise and late messages do. docs/theory.md says which
    of them are exact and which are bounds.
    """
    _require_writable(json)
    chosen = find_scenario(scenario)
    if hold_steps and chosen.gain > 0:
        chosen = chosen.replace(hold_steps=hold_steps)
    certificate = theory.certify(chosen, law=law_part(law, kappa), noise_std=noise, delay_steps=delay)
    _write_json(json, _json_text(certificate.to_dict()))
    _console().print(certificate_tables(certificate))
    if json is not None:
        _console().print(Text(f"Certificate written to {json}"), soft_wrap=True)


@app.command()
def sweep(
    diagram: Annotated[
        list[str] | None,
        typer.Argument(
            help=f"Which diagrams: {', '.join(SWEEPS)}. All if left out.", autocompletion=lambda: list(SWEEPS)
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the pictures; made if missing.")] = Path("results/sweep"),
    points: Annotated[int, typer.Option(min=2, help="Points along each axis.")] = 14,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes per point, from random starts.")] = 8,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the starts and of the noise.")] = 0,
    jobs: _Jobs = -1,
    backend: _Backend = "processes",
    address: _Address = None,
    json: _Json = None,
) -> None:
    """Draw phase diagrams: digits at the deadline over two parameters, as measured and as predicted.

    gain-step is over κ and the step Θ, noise-horizon over noise and s_end, dwell-gain over dwell time and c. Every
    point is a batch of episodes of the static law in the environment; docs/theory.md explains the lines.
    """
    _keep_interrupts_from_workers()
    workers = Workers(jobs, backend, address)
    _require_writable(json, *(out / f"{name}.png" for name in diagram or SWEEPS))
    diagrams = []
    with _progress() as progress:
        for name in diagram or SWEEPS:
            task = progress.add_task(name, total=None)

            def advance(done: int, total: int, task: TaskID = task) -> None:
                progress.update(task, completed=done, total=total)

            diagrams.append(
                run_sweep(name, points=points, episodes=episodes, seed=seed, workers=workers, progress=advance)
            )
    for each in diagrams:
        save_diagram(each, out / f"{each.name}.png")
    _write_json(json, f"[{', '.join(each.to_json() for each in diagrams)}]")
    console = _console()
    for each in diagrams:
        line = f"{each.name}: measured and predicted digits differ by at most {each.difference:.1g}"
        console.print(Text(f"{line}; {out / each.name}.png"), soft_wrap=True)
    if json is not None:
        console.print(Text(f"Numbers written to {json}"), soft_wrap=True)


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for figures, results.json and a page; made if missing.")] = Path(
        "results/paper"
    ),
    json: _Json = None,
) -> None:
    """Reproduce the paper: Table 1, every figure, and a measured verdict on every claim and erratum.

    Simulates the laws in continuous time, with the matrix exponential as the exact reference where the game is affine.
    """
    from ptne_env import paper

    _require_writable(json)
    with _progress() as progress:
        task = progress.add_task("reproducing", total=None)

        def advance(done: int, total: int, what: str) -> None:
            progress.update(task, completed=done, total=total, description=what)

        reproduction = paper.reproduce(out, progress=advance)
    _write_json(json, _json_text(reproduction.to_dict()))
    console = _console()
    console.print(*paper.render(reproduction))
    written = f"{len(reproduction.figures)} figures and {reproduction.results.name} written to {out}"
    console.print(Text(written), soft_wrap=True)
    _tell_files(console, (), reproduction.page)


@app.command()
def train(
    configuration: Annotated[
        str,
        typer.Argument(
            help="A shipped configuration by name (such as random-energy), or a .toml file.",
            autocompletion=training.configurations,
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the policy, logs and checkpoints; made if missing.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the network, the sampling and the training games.")] = 0,
    steps: Annotated[int | None, typer.Option(min=1, help="Agent-steps; the configuration's own if left out.")] = None,
    json: _Json = None,
) -> None:
    """Train a policy with PPO and export it as policy.onnx.

    An interrupted run goes on from its last checkpoint when the same command is given again.
    """
    try:
        from ptne_env.training import ppo
    except ImportError as error:
        raise ImportError('training needs an extra: pip install "ptne-env[sb3]"') from error

    _require_writable(json, out / "policy.onnx")
    changes = {"seed": seed} if steps is None else {"seed": seed, "steps": steps}
    arguments = ppo.Arguments.from_toml(configuration, **changes)
    with _progress() as progress:
        task = progress.add_task("training", total=arguments.steps)

        def advance(done: int, total: int, digits: float) -> None:
            gained = "" if isnan(digits) else f", {digits:.2f} digits gained"
            progress.update(task, completed=done, total=total, description=f"training{gained}")

        summary = ppo.train(arguments, out, advance)
    _write_json(json, _json_text(summary))
    digits = summary["validation_digits"]
    _console().print(Text(f"{digits:.2f} digits on the validation bank; policy.onnx written to {out}"), soft_wrap=True)


@app.command("list")
def list_(json: _Json = None) -> None:
    """Show what there is: scenarios, policies, metrics and suites."""
    _write_json(
        json,
        _json_text(
            {
                "scenarios": {name: scenario.to_dict() for name, scenario in CATALOGUE.items()},
                "policies": {entry.name: entry.to_dict() for entry in suite_entries()},
                "metrics": {**METRICS, **COMPARATIVE_METRICS},
                "suites": {name: get_suite(name).content() for name in SUITES},
            }
        ),
    )
    console = _console()
    console.print(scenario_table(console.width), entry_table(), metric_table())
    console.print(*(suite_table(get_suite(name)) for name in SUITES))


def main() -> None:
    """Run the command line; exit codes are 0 done, 1 failed, 2 wrong usage, 130 interrupted."""
    sys.path.append(str(Path.cwd()))  # so that 'module:object' finds a file of the current folder, after all others
    try:
        app(prog_name="ptne")
    except SystemExit as ended:
        if ended.code == _INTERRUPTED:
            _console(stderr=True).print("Interrupted: files are whole, and suites and training go on where they were")
        raise
    except ValueError as error:
        _fail(str(error), 2)
    except (OSError, ImportError) as error:
        _fail(str(error), 1)
    except Exception as error:  # noqa: BLE001 - whatever it is, a traceback is shown when it is asked for
        told = "\n".join([f"{type(error).__name__}: {error}", *getattr(error, "__notes__", ())])
        _fail(told if _options.debug else f"{told}\n'ptne --debug' before the command shows where it comes from", 1)


def _fail(message: str, code: int) -> None:
    console = _console(stderr=True)
    if _options.debug:
        console.print_exception()
    told = Text("Error: ", style="bold red").append(message, style="not bold default")
    console.print(told, soft_wrap=not console.is_terminal)
    raise SystemExit(code)


if __name__ == "__main__":
    main()
