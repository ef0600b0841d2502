"""A parameter sweep on all cores: digits over the consensus gain κ and the number of steps to the deadline.

Every point is a job of a suite: one track per number of steps, one policy per gain. joblib distributes the jobs over
processes, and each result is stored in a file. So a sweep that is interrupted or repeated runs only the missing jobs.

Prints the grid of mean digits (20 episodes per point), and how long the sweep took, new and repeated.

Run it with: python examples/sweep_many_cores.py
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from joblib import cpu_count

import ptne_env
from ptne_env import FactorySpec, get_scenario
from ptne_env.evaluation import Suite, Track, Workers, run_suite

GAINS = (1.0, 2.0, 4.0, 8.0)
STEPS = (100, 200, 400)


def sweep(folder: Path) -> dict[tuple[int, float], float]:
    """Mean digits by number of steps and κ."""
    base = get_scenario("random-energy")
    tracks = [Track(f"K={steps}", base.replace(steps=steps), f"{steps} steps to the deadline.") for steps in STEPS]
    policies = [
        ptne_env.PolicySpec(f"κ={gain:g}", FactorySpec.of("ptne_env.laws:Static", kappa=gain)) for gain in GAINS
    ]
    suite = Suite("gain-steps-v1", tuple(tracks), episodes=20)
    results = run_suite(suite, policies, folder=folder, workers=Workers(-1))
    points = [(steps, gain) for steps in STEPS for gain in GAINS]
    return {(k, gain): results.record(f"K={k}", f"κ={gain:g}", "digits")["mean"] for k, gain in points}


def main() -> None:
    """Sweep twice in the same folder."""
    with TemporaryDirectory() as folder:
        began = perf_counter()
        digits = sweep(Path(folder))
        done = perf_counter()
        sweep(Path(folder))
        again = perf_counter()
    print(f"{'':8}" + "".join(f"{f'κ = {gain:g}':>9}" for gain in GAINS))
    for steps in STEPS:
        print(f"K = {steps:<4}" + "".join(f"{digits[steps, gain]:9.2f}" for gain in GAINS))
    print(f"{done - began:.1f} s on {cpu_count()} cores; {again - done:.1f} s when all results are stored already")


if __name__ == "__main__":
    main()
