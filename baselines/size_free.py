"""Run every training seed of the policy without sizes on both suites beside the laws; write ``size-free.md``.

Run it with ``python baselines/size_free.py`` after ``python baselines/run.py --configuration generalist``, which
trains. Jobs that are stored already are not run again. On tracks of more than 20 players the shipped seed plays alone,
ten episodes or fewer.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from common import Jobs, Ray, interval, table

from ptne_env import FactorySpec
from ptne_env import learn as policies
from ptne_env.evaluation import PolicySpec, Results, Workers, run_suite
from ptne_env.evaluation.metrics import number
from ptne_env.evaluation.suite import MOST_DIGITS, SUITES, get_suite
from ptne_env.learn import training
from ptne_env.shared.files import write_atomically

HERE = Path(__file__).parent

POLICY = training.SHIPPED

LAWS = ("contact-relay", "observer-relay")
"""Laws beside the policy."""

GUARDED = PolicySpec("guarded", FactorySpec.of("ptne_env.learn:load", path_or_name=POLICY, guarded=True))
"""The shipped seed with its safeguard."""

SEVERAL_SEEDS = 20
"""The largest number of players of tracks that every training seed plays."""

EPISODES = {"ptne-v1": 10}
"""Episodes of the other tracks by suite; the suite's own number where left out."""

_INTRODUCTION = (
    "Written by `python baselines/size_free.py`; do not edit. Digits on the test episodes of both suites (seed 0), "
    "with 95 % intervals: laws, and the policy without sizes with every training seed. `std of seeds` is the standard "
    "deviation of the means of its seeds, and `safeguard` the mean of the digits that the shipped seed gains by its "
    "safeguard, or loses (−). On tracks marked * the shipped seed plays alone, ten episodes or fewer. `best known` is "
    "the best honest entry when ptne-v2 was frozen. The last row is a mean over the tracks: of digits/12 on ptne-v1, "
    "and of digits over the best known on ptne-v2."
)


def page(name: str, several: Results, alone: Results, shipped: int) -> list[str]:
    """The table of a suite, from the results of tracks for every seed, and of those for the shipped one alone."""
    headings = ["track", "best known", *LAWS, POLICY, "std of seeds", "safeguard"]
    rows, shares = [], []
    for track in get_suite(name).tracks:
        results = several if track.name in {each.name for each in several.tracks} else alone
        found = [results.samples[track.name, entry][track.metric] for entry in (*LAWS, POLICY)]
        shares.append([float(each.mean()) / (track.best_known or MOST_DIGITS) for each in found])
        texts = [interval(results.summary(track.name, entry, track.metric)) for entry in (*LAWS, POLICY)]
        unguarded = found[-1][shipped if results is several else 0]
        saved = float((results.samples[track.name, GUARDED.name][track.metric] - unguarded).mean())
        deviation = number(float(found[-1].mean(axis=1).std(ddof=1))) if results is several else ""
        mark, best = "" if results is several else " *", number(track.best_known) if track.best_known else ""
        rows.append([track.name + mark, best, *texts, deviation, f"{saved:z.3f}"])
    rows.append(["mean", "", *map(number, np.mean(shares, axis=0).tolist()), "", ""])
    return [f"## {name}", "", *table(headings, rows, texts=("track",)), ""]


def main(
    runs: Annotated[Path, typer.Option(help="Folder of the training runs.")] = Path("runs"),
    out: Annotated[Path, typer.Option(help="Folder of the results of each suite.")] = Path("results"),
    to: Annotated[Path, typer.Option(help="Folder of the page.")] = HERE,
    jobs: Jobs = 2,
    ray: Ray = None,
) -> None:
    """Run and write."""
    folder, pattern = runs / training.GENERALIST, "seed-*/policy.onnx"
    contents = [path.read_bytes() for path in sorted(folder.glob(pattern))]
    content = (Path(policies.__file__).parent / f"{POLICY}.onnx").read_bytes()
    if content not in contents:
        raise ValueError(f"the shipped {POLICY} is no seed in {folder}: train and ship it with baselines/run.py")
    lines = ["# The policy without sizes", "", _INTRODUCTION, ""]
    for name in SUITES:
        tracks = {track.name: track.world.game.num_players <= SEVERAL_SEEDS for track in get_suite(name).tracks}
        found = [
            run_suite(
                name,
                [*LAWS, policy, GUARDED],
                tracks=[track for track, plays in tracks.items() if plays is is_small],
                episodes=None if is_small else EPISODES.get(name),
                folder=out / name,
                workers=Workers(jobs, ray),
                progress=lambda job, *_: typer.echo(job, err=True),
            )
            for is_small, policy in ((False, POLICY), (True, f"{POLICY}={folder / pattern}"))
        ]
        lines += page(name, found[1], found[0], contents.index(content))
    write_atomically(to / f"{POLICY}.md", "\n".join(lines))


if __name__ == "__main__":
    typer.run(main)
