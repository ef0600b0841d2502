"""Every example runs as its docstring says, and prints what examples/README.md says."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "examples"
EXAMPLES = sorted(FOLDER.glob("*.py"))
PRINTED = dict(
    re.findall(r"^\| \[(\w+\.py)\]\(\1\) \|.*\| `([^`]+)` \|$", (FOLDER / "README.md").read_text("utf-8"), re.MULTILINE)
)
"""Of what each example prints, what the README shows."""


def test_the_readme_lists_every_example():
    assert set(PRINTED) == {path.name for path in EXAMPLES}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs_without_a_warning_and_prints_what_the_readme_shows(example, tmp_path):
    outcome = subprocess.run(  # noqa: S603 - our own example
        [sys.executable, "-W", "error", str(example)],
        capture_output=True,
        text=True,
        encoding="utf-8",
        cwd=tmp_path,
        check=False,
        timeout=300,
    )
    assert outcome.returncode == 0, outcome.stderr
    assert outcome.stderr == ""
    assert PRINTED[example.name] in " ".join(outcome.stdout.split())
    if example.stem == "train_sb3":  # what a network learns differs a little between machines
        before, after = map(float, re.findall(r"(-?\d+\.\d+)", outcome.stdout)[:2])
        assert before < 0.5
        assert after > 3.0


def test_parts_of_ones_own_are_found_by_module_and_object_alone(tmp_path):
    """A game, a graph, a channel, a law and a track of somebody else, in processes of their own."""
    command = ["-m", "ptne_env.cli", "compare", "--suite", "own_parts:suite", "--policy", "own_parts:HeavyBall"]
    paths = os.pathsep.join(filter(None, [str(FOLDER), os.environ.get("PYTHONPATH")]))
    outcome = subprocess.run(  # noqa: S603 - our own command line
        [sys.executable, "-W", "error", *command, "--episodes", "3", "--jobs", "2", "--out", "out"],
        capture_output=True,
        text=True,
        encoding="utf-8",
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": paths},
        check=False,
        timeout=300,
    )
    assert outcome.returncode == 0, outcome.stderr
    data = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    contest, clipped = (track["scenario"] for track in data["suite"]["tracks"])
    assert contest["game"]["target"] == "own_parts:BeautyContest"
    assert contest["topology"]["target"] == "own_parts:wheel"
    assert clipped["channel"]["target"] == "own_parts:Clipped"
    digits = {(row["track"], row["policy"]): row["metrics"]["digits"]["mean"] for row in data["tracks"]}
    for track in ("contest", "clipped"):
        assert digits[track, "null"] < digits[track, "own_parts:HeavyBall"] < digits[track, "oracle"]
    assert digits["clipped", "static"] < digits["contest", "static"] - 0.5  # the channel bites
