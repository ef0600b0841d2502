"""Run the examples of this folder, each in a virtual environment of its framework, because their pins conflict.

An example is ``<framework>_<idea>.py``, and ``requirements/<framework>.txt`` lists its packages. The environments lie
in ``.ecosystem/`` and are made once.

Prints the date, and for every example the version of the framework, the digits that the law gains through it, their
largest difference to those of ``ptne_env.evaluate``, and the digits before and after training.

Run it with: make ecosystem
or: python examples/ecosystem/run.py torchrl rllib
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]


def call(*command: str | Path) -> str:
    """Run a command and return what it prints; its errors go to the terminal."""
    # The networks are small: threads would wait for each other. RLlib keeps agents in sets, whose order is hashed.
    settings = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=settings).stdout  # noqa: S603 - ours


def python_of(framework: str) -> Path:
    """Return the interpreter of the framework's virtual environment, which is made if it is missing."""
    home = ROOT / ".ecosystem" / framework
    python = home / "bin" / "python"
    if not (home / "complete").exists():
        call(sys.executable, "-m", "venv", "--clear", home)
        requirements = FOLDER / "requirements" / f"{framework}.txt"
        call(python, "-m", "pip", "install", "--quiet", "--requirement", requirements)
        # By a command of its own, which overrides pins of the framework: pip warns of them then.
        call(python, "-m", "pip", "install", "--quiet", "--editable", ROOT)
        (home / "complete").touch()
    return python


def main() -> None:
    """Run the examples of the named frameworks, or of all; one that fails does not stop the others."""
    known = sorted(path.stem for path in (FOLDER / "requirements").glob("*.txt"))
    failed = []
    print(f"{time.strftime('%Y-%m-%d')}, Python {sys.version.split()[0]}", flush=True)
    for framework in sys.argv[1:] or known:
        version = (FOLDER / "requirements" / f"{framework}.txt").read_text("utf-8").split()[0]
        for example in sorted(FOLDER.glob(f"{framework}_*.py")):
            try:
                printed = call(python_of(framework), example)
            except subprocess.CalledProcessError:
                failed.append(example.stem)
                continue
            for row in (json.loads(line) for line in printed.splitlines() if line.startswith('{"what"')):
                trained = "" if row["before"] is None else f", {row['before']:.2f} → {row['after']:.2f} by training"
                difference = f"{row['law']:.4f} digits of the law, difference {row['difference']:.0e}"
                print(f"{version:26} {example.stem:20} {row['what']:17} {difference}{trained}", flush=True)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
