"""The scripts in ``baselines``, which write the published tables."""

import subprocess
import sys
from pathlib import Path

from extras import need_sb3

SCRIPTS = Path(__file__).parents[1] / "baselines"


def test_every_script_imports_only_names_that_exist():
    need_sb3()  # the scripts that train import it
    names = sorted(path.stem for path in SCRIPTS.glob("*.py"))
    command = [sys.executable, "-c", f"import {', '.join(names)}"]
    subprocess.run(command, cwd=SCRIPTS, check=True)  # noqa: S603 - our own scripts
