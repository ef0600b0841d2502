"""The scripts in ``baselines``, which write the published tables."""

import subprocess
import sys
from pathlib import Path

from extras import need_sb3

SCRIPTS = Path(__file__).parents[1] / "baselines"


def test_every_script_imports_only_names_that_exist():
    need_sb3()  # the script that trains imports it
    names = sorted(path.stem for path in SCRIPTS.glob("*.py"))
    assert "knowledge" in names
    subprocess.run([sys.executable, "-c", f"import {', '.join(names)}"], cwd=SCRIPTS, check=True)
