"""Run the examples of this folder, each in a virtual environment of its framework, because their pins conflict.

An example is ``<framework>_<idea>.py``, and ``requirements/<framework>.txt`` lists its packages. A run writes the rows
of its frameworks into the tables of docs/ecosystem.md; those of other frameworks stay.

Run it with: make ecosystem
or: python examples/ecosystem/run.py --only torchrl
"""

import argparse
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from time import monotonic
from typing import Any

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
PAGE = ROOT / "docs" / "ecosystem.md"
HOME = ROOT / ".ecosystem"
BEGIN, END = "<!-- written by make ecosystem -->", "<!-- end -->"
EXTRA_VERSIONS = ("gymnasium", "pettingzoo", "torch", "tensordict", "torchrl", "numpy")
"""Packages whose versions the table shows besides those in the requirements, if they are installed."""

Row = dict[str, Any]


class FailedError(Exception):
    """A command ended with another exit code than 0; the message is the end of its output."""


def call(command: Sequence[str | Path], timeout: float = 3600) -> str:
    """Run a command and return its output.

    Raises:
        FailedError: when it fails, cannot be started, or takes longer than ``timeout`` seconds.
    """
    # The networks are small: threads would wait for each other. RLlib keeps agents in sets, whose order is hashed.
    environment = {"OMP_NUM_THREADS": "1", "PYTHONHASHSEED": "0", **os.environ}
    environment.pop("PYTHONPATH", None)
    try:
        done = subprocess.run(  # noqa: S603 - our own examples, and pip
            [str(part) for part in command],
            capture_output=True, text=True, encoding="utf-8", errors="replace", check=False, timeout=timeout,
            env=environment,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise FailedError(str(error)) from error
    if done.returncode:
        lines = (done.stdout + done.stderr).splitlines()
        raise FailedError("\n".join([*lines[-20:], f"exit code {done.returncode}"]))
    return done.stdout


def requirements(framework: str) -> Path:
    """The list of the framework's packages."""
    return FOLDER / "requirements" / f"{framework}.txt"


def frameworks() -> list[str]:
    """The names of all frameworks."""
    return sorted(path.stem for path in (FOLDER / "requirements").glob("*.txt"))


def prepare(framework: str, home: Path) -> Path:
    """The interpreter of the framework's virtual environment, which is made or updated when its requirements change.

    Raises:
        FailedError: when an installation fails.
    """
    venv = home / framework
    python, stamp = venv / "bin" / "python", venv / "installed.txt"
    wanted = requirements(framework).read_text(encoding="utf-8") + (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    if not stamp.exists() or stamp.read_text(encoding="utf-8") != wanted:
        call([sys.executable, "-m", "venv", venv])
        call([python, "-m", "pip", "install", "--quiet", "--requirement", requirements(framework), "--editable", ROOT])
        stamp.write_text(wanted, encoding="utf-8")
    return python


def versions(framework: str, python: Path) -> dict[str, str]:
    """The installed versions of the packages in the requirements and in :data:`EXTRA_VERSIONS`."""
    packages = json.loads(call([python, "-m", "pip", "list", "--format=json"]))
    installed = {each["name"].lower().replace("_", "-"): each["version"].split("+")[0] for each in packages}
    lines = requirements(framework).read_text(encoding="utf-8").splitlines()
    named = [line.split("=")[0].split("[")[0].split()[0] for line in lines]
    also = [name for name in EXTRA_VERSIONS if name in installed and name not in named]
    return {name: installed[name] for name in [*named, *also]}


def run(example: Path, python: Path) -> list[Row]:
    """The example's report, one row per line of JSON, with the seconds of the run.

    Raises:
        FailedError: when it fails or reports nothing.
    """
    began = monotonic()
    printed = call([python, example])
    seconds = monotonic() - began
    rows = [json.loads(line) for line in printed.splitlines() if line.startswith('{"what"')]
    if not rows:
        raise FailedError("it reported nothing; it printed:\n" + "\n".join(printed.splitlines()[-20:]))
    return [{**row, "example": example.stem, "seconds": seconds} for row in rows]


def version_lines(found_versions: dict[str, dict[str, str]]) -> list[str]:
    """Rows of the table of versions."""
    return [
        f"| `{framework}` | {', '.join(f'{name} {version}' for name, version in found.items())} |"
        for framework, found in found_versions.items()
    ]


def result_lines(rows: Sequence[Row]) -> list[str]:
    """Rows of the table of results."""

    def number(value: float | None) -> str:
        return "–" if value is None else f"{value:.2f}"

    def rate(value: float | None) -> str:
        return "–" if value is None else f"{float(f'{value:.2g}'):,.0f}"

    lines = []
    for row in rows:
        link = f"[{row['example']}](../examples/ecosystem/{row['example']}.py)" + (
            f", {row['what']}" if row["what"] else ""
        )
        training = f"{number(row['before'])} | {number(row['after'])}"
        measured = f"{training} | {rate(row['speed'])} | {row['seconds']:.0f}"
        lines.append(f"| {link} | {row['law']:.6f} | {row['difference']:.0e} | {measured} |")
    return lines


def update(page: Path, rows: Sequence[Row], found_versions: dict[str, dict[str, str]]) -> None:
    """Write the rows of some frameworks into the tables between the marks of the page, in the frameworks' order.

    Rows of other frameworks stay, if the frameworks still exist.

    Raises:
        ValueError: when the page has no marks.
    """
    before, begin, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    present, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{page} needs the marks {BEGIN} and {END}")
    lines: dict[str, list[list[str]]] = {framework: [[], []] for framework in frameworks()}
    for line in present.splitlines():
        if found := re.match(r"\| (?:`(\w+)`|\[([^_\]]+)_)", line):
            framework = found[1] or found[2]
            if framework in lines and framework not in found_versions:
                lines[framework][0 if found[1] else 1].append(line)
    for framework, versions_of in found_versions.items():
        own = [row for row in rows if row["example"].startswith(f"{framework}_")]
        lines[framework] = [version_lines({framework: versions_of}), result_lines(own)]
    text = "\n".join([
        f"Python {platform.python_version()} on {os.cpu_count()} cores of {platform.machine()}.",
        "",
        "| Environment | Versions |",
        "| --- | --- |",
        *(line for versions_of, _ in lines.values() for line in versions_of),
        "",
        "| Example | The law gains | Largest difference | Digits before | and after training | Steps/s | Seconds |",
        "| --- | --- | --- | --- | --- | ---: | --- |",
        *(line for _, results in lines.values() for line in results),
    ])  # fmt: skip
    page.write_text(f"{before}{BEGIN}\n\n{text}\n\n{END}{after}", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, or 1 after a failure."""
    parser = argparse.ArgumentParser(
        description="Run the examples of every framework and write their rows in docs/ecosystem.md."
    )
    parser.add_argument("--only", nargs="+", choices=frameworks(), help="these frameworks; other rows of the page stay")
    parser.add_argument("--home", type=Path, default=HOME, help="where the virtual environments are kept")
    chosen = parser.parse_args(arguments)
    rows: list[Row] = []
    found_versions: dict[str, dict[str, str]] = {}
    failed = []
    for framework in chosen.only or frameworks():
        step, began = "installation", monotonic()
        try:
            python = prepare(framework, chosen.home)
            found_versions[framework] = versions(framework, python)
            print(f"{framework}: ready after {monotonic() - began:.0f} s", flush=True)
            for example in sorted(FOLDER.glob(f"{framework}_*.py")):
                step = example.stem
                for row in run(example, python):
                    rows.append(row)
                    print(json.dumps(row), flush=True)
        except FailedError as error:
            failed.append(framework)
            print(f"{framework}: {step} failed\n{error}", file=sys.stderr, flush=True)
    if failed:
        print(f"failed: {', '.join(failed)}; the page stays as it is", file=sys.stderr)
        return 1
    update(PAGE, rows, found_versions)
    print(f"the tables are in {PAGE}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
