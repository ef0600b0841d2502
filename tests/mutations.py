"""Breaks the library on purpose, one fact at a time: the nearest test file must notice. ``python tests/mutations.py``.

Each mutation replaces one text in a copy of the library and runs one test file against the copy. A test file that
stays green misses the mutation, and the command ends with an error.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]

LIMIT_SECONDS = 60
"""Longest time in which the nearest test file has to notice."""


class Mutation(NamedTuple):
    """A replacement of one text in one file, and the test file that must notice it."""

    fact: str
    file: str
    before: str
    after: str
    tests: str


MUTATIONS = (
    Mutation(
        "sign of the consensus term",
        "laws/base.py",
        'return np.einsum("rd,rdn->rn", weights, relative_estimates)',
        'return -np.einsum("rd,rdn->rn", weights, relative_estimates)',
        "laws/test_static.py",
    ),
    Mutation(
        "order of neighbour slots",
        "world/world.py",
        "self.neighbours[: others.size, player] = others",
        "self.neighbours[: others.size, player] = others[::-1]",
        "perception/test_encoder.py",
    ),
    Mutation(
        "constant gain in the length of a step",
        "world/clock.py",
        "theta = np.diff(s) + self.gain * dt",
        "theta = np.diff(s)",
        "world/test_clock.py",
    ),
    Mutation(
        "graph at the start of a step",
        "world/dynamics.py",
        "else world.modes[shared_step(state)]",
        "else world.modes[world.next_step[shared_step(state)]]",
        "world/test_dynamics.py",
    ),
    Mutation(
        "projection into the box",
        "world/dynamics.py",
        "    _project_strategies(estimates, state.game)\n",
        "",
        "world/test_dynamics.py",
    ),
    Mutation(
        "number of steps of a delay",
        "world/channel.py",
        "arrives = past_lags[age] == age",
        "arrives = past_lags[age] == age + 1",
        "world/test_channel.py",
    ),
    Mutation(
        "order of the reward's difference",
        "world/rewards.py",
        "return self._digits - digits_before",
        "return digits_before - self._digits",
        "world/test_rewards.py",
    ),
    Mutation(
        "termination at the deadline",
        "envs/simulation.py",
        "return StepResult(total, terms, terminated, truncated,",
        "return StepResult(total, terms, truncated, terminated,",
        "envs/test_parallel.py",
    ),
    Mutation(
        "floor of distances",
        "world/distances.py",
        "FLOOR = 1e-12",
        "FLOOR = 1e-11",
        "world/test_distances.py",
    ),
    Mutation(
        "axis of an interval",
        "evaluation/statistics.py",
        "by_seed = np.mean([np.nanmean(track, axis=1) for track in found], axis=0)",
        "by_seed = np.mean([np.nanmean(track, axis=0) for track in found], axis=0)",
        "evaluation/test_statistics.py",
    ),
    Mutation(
        "quantile of an interval",
        "evaluation/statistics.py",
        "(1 + CONFIDENCE) / 2",
        "CONFIDENCE",
        "evaluation/test_statistics.py",
    ),
    Mutation(
        "degrees of freedom of a variance",
        "evaluation/statistics.py",
        "values.var(ddof=1)",
        "values.var(ddof=0)",
        "evaluation/test_statistics.py",
    ),
    Mutation(
        "rows of the audit",
        "evaluation/audit.py",
        "np.array_equal(np.asarray(again), actions[self._rows])",
        "np.array_equal(np.asarray(again), np.asarray(again))",
        "evaluation/test_audit.py",
    ),
    Mutation(
        "a table of the verification",
        "bench/verification.py",
        "        differences = list(_differences_of_tables(results, data))",
        "        differences = []",
        "bench/test_verification.py",
    ),
    Mutation(
        "a constant of the game",
        "games/energy.py",
        "coupling: npt.ArrayLike = 0.1",
        "coupling: npt.ArrayLike = 0.1 * (1 + 1e-7)",
        "games/test_energy.py",
    ),
    Mutation(
        "rate of a certificate",
        "theory/certificate.py",
        "return decay_rate(loop.matrices,",
        "return 2 * decay_rate(loop.matrices,",
        "theory/test_certificate.py",
    ),
)


def outcome(mutation, folder):
    """Seconds until the test file noticed, or ``None`` where it stayed green.

    Args:
        mutation: to make.
        folder: empty, for the copy of the library.
    """
    library = Path(folder) / "ptne_env"
    shutil.copytree(ROOT / "ptne_env", library, ignore=shutil.ignore_patterns("__pycache__"))
    file = library / mutation.file
    text = file.read_text(encoding="utf-8")
    if text.count(mutation.before) != 1:
        raise SystemExit(
            f"{mutation.fact}: {mutation.file} holds {text.count(mutation.before)} times {mutation.before!r}"
        )
    file.write_text(text.replace(mutation.before, mutation.after), encoding="utf-8")
    options = ["-x", "-q", "-p", "no:cacheprovider"]
    command = [sys.executable, "-P", "-m", "pytest", *options, str(ROOT / "tests" / mutation.tests)]
    started = time.perf_counter()
    finished = subprocess.run(  # noqa: S603 - of this interpreter
        command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(folder)}, capture_output=True, text=True, check=False
    )
    if finished.returncode not in (0, 1):
        raise SystemExit(
            f"{mutation.fact}: {mutation.tests} did not run\n{finished.stdout[-2000:]}{finished.stderr[-2000:]}"
        )
    return time.perf_counter() - started if finished.returncode else None


def main():
    """Make all mutations, or those whose fact holds the first argument; the exit status is 1 when one was missed."""
    wanted = sys.argv[1] if len(sys.argv) > 1 else ""
    missed = 0
    for mutation in MUTATIONS:
        if wanted not in mutation.fact:
            continue
        with tempfile.TemporaryDirectory() as folder:
            seconds = outcome(mutation, folder)
        in_time = seconds is not None and seconds <= LIMIT_SECONDS
        missed += not in_time
        word = "missed" if seconds is None else f"noticed in {seconds:.0f} s"
        print(f"{mutation.fact:40} {mutation.tests:40} {word}", flush=True)
    print(f"{missed} missed")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
