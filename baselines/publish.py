"""Run all policies on catalogue, suite and random worlds, and write every published table.

``python baselines/publish.py`` runs them on the catalogue, on ptne-v1, and on the random worlds of two seeds: those of
seed 1 were seen while laws were designed, those of seed 2 were not.

It writes ``results.csv`` beside this file, and from it every table of README, docs and baselines that stands between
``<!-- table NAME -->`` and ``<!-- end -->``. Finished jobs are kept in the folder ``--out`` and not run again.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from statistics import fmean
from typing import get_args

from ptne_env import CATALOGUE, evaluate
from ptne_env.evaluation import COMPARED, ENTERED, POLICIES, Results
from ptne_env.evaluation.metrics import number
from ptne_env.execution import Runner, Workers
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.fields import FIELDS, InterfaceKind
from ptne_env.shared.files import write_atomically
from ptne_env.suites import leaderboard, run_suite
from ptne_env.suites.robustness import robustness
from ptne_env.world.world import World

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "baselines" / "results.csv"
ALGORITHMS = ROOT / "baselines" / "marl.json"
METRICS = ("digits", "mean_regret", "digits_cvar", "settling_time", "settled_share", "diverged_share")
"""The metrics in the file."""

HEADLINE = ("static", "grounded", "contact-relay", "observer-relay", "residual-coder")
LEARNED = ("ppo-ptne-v1", "recurrent-random-worlds")
SHOWN = (*HEADLINE[:2], "routed-unknown", *HEADLINE[2:], *LEARNED)
"""The policies of the short tables of the suite, before the oracle."""

SHOWN_ON_WORLDS = ("static", "grounded", "proximal-best-response", "routed-unknown", "contact-relay", "observer-relay")
"""The policies of the tables of random worlds."""

WORLDS = {"robustness": robustness(1), "robustness-2": robustness(2)}
"""The random worlds: seen and fresh."""

NEAR = 0.5
"""Digits by which a policy may miss the best one and is near."""

SHOWN_ON_SCENARIOS = ("static", "grounded", "routed-unknown", "observer-relay", "ppo-random-energy", "oracle")
"""The policies of the short table of the catalogue."""

ALL = "all"
"""The track of scores, which are over all tracks."""

Row = dict[str, str]


def rows_of(results: Results) -> Iterable[Row]:
    """The rows of ``results.csv``: the chosen metrics, and scores and ranks of a suite."""
    for record in results.records:
        if record["metric"] in METRICS and record["mean"] is not None:
            numbers = {key: f"{record[key]:.7g}" for key in ("mean", "low", "high")}
            yield {"suite": results.name, **{key: str(value) for key, value in record.items()}, **numbers}
    for row in leaderboard(results) or ():
        common = {"suite": results.name, "track": ALL, "policy": row.policy}
        for metric, found in (("score", row.score), ("mean_regret", row.mean_regret)):
            yield {**common, "metric": metric, **{key: f"{getattr(found, key):.7g}" for key in ("mean", "low", "high")}}
        if row.mean_rank is not None:
            yield {**common, "metric": "rank", "mean": f"{row.mean_rank:.7g}"}


class Published:
    """The rows of ``results.csv``."""

    def __init__(self, rows: Sequence[Row]) -> None:
        self.rows = rows
        self._cells = {(row["suite"], row["track"], row["policy"], row["metric"]): row for row in rows}

    def names(self, key: str, suite: str) -> list[str]:
        """The tracks or policies of a suite, in the order of the file."""
        return list(dict.fromkeys(row[key] for row in self.rows if row["suite"] == suite and row["track"] != ALL))

    def cell(self, suite: str, track: str, policy: str, metric: str = "digits") -> Row | None:
        """A number on a track, or over all (:data:`ALL`)."""
        return self._cells.get((suite, track, policy, metric))

    def ranked(self, suite: str, track: str) -> list[str]:
        """The policies that act on a track, the best first: by digits to two decimals, then by mean regret."""

        def key(policy: str) -> tuple[float, float]:
            regret = self.cell(suite, track, policy, "mean_regret")
            return -round(float(found[policy]["mean"]), 2), math.inf if regret is None else float(regret["mean"])

        cells = {policy: self.cell(suite, track, policy) for policy in self.names("policy", suite)}
        found = {policy: cell for policy, cell in cells.items() if cell is not None}
        return sorted(found, key=key)


def plain(row: Row | None) -> str:
    """The mean; a dash where there is none."""
    return "–" if row is None else f"{float(row['mean']):.2f}"


def with_interval(row: Row | None) -> str:
    """The mean with its 95 % interval."""
    if row is None:
        return "–"
    mean, low, high = (f"{float(row[key]):.2f}" for key in ("mean", "low", "high"))
    return mean if low == high else f"{mean} [{low}, {high}]"


def markdown(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table whose first column is text."""
    return "\n".join(
        f"| {' | '.join(cells)} |" for cells in (headings, ["---", *["---:"] * (len(headings) - 1)], *rows)
    )


def regret(row: Row | None) -> str:
    """A mean regret with three significant digits; a dash where there is none."""
    return "–" if row is None else number(float(row["mean"]))


def by_track(found: Published, suite: str, policies: Sequence[str]) -> str:
    """A row per track and a column per policy; of a suite also the scores and mean regrets over all scored tracks."""
    rows = [
        [track, *(plain(found.cell(suite, track, policy)) for policy in policies)]
        for track in found.names("track", suite)
    ]
    if found.cell(suite, ALL, policies[0], "score") is not None:
        rows.append(["**score**", *(plain(found.cell(suite, ALL, policy, "score")) for policy in policies)])
        rows.append(["mean regret", *(regret(found.cell(suite, ALL, policy, "mean_regret")) for policy in policies)])
    return markdown([suite.replace("comparison", "scenario"), *policies], rows)


def best_law(found: Published, suite: str, track: str, without: str = "") -> tuple[str, Row]:
    """The best law of a track, perhaps but one, and its digits."""
    metric = "score" if track == ALL else "digits"
    laws = [name for name in found.names("policy", suite) if POLICIES[name].is_law and name != without]
    cells = {name: found.cell(suite, track, name, metric) for name in laws}
    rows = {name: cell for name, cell in cells.items() if cell is not None}
    return max(rows.items(), key=lambda item: float(item[1]["mean"]))


def best_standard(found: Published, track: str) -> str:
    """The best policy of a standard algorithm: the shipped PPO, or on some tracks those of ``marl.json``."""
    row = found.cell("ptne-v1", track, "ppo-ptne-v1", "score" if track == ALL else "digits")
    digits = {} if row is None else {"ppo": float(row["mean"])}
    trained = json.loads(ALGORITHMS.read_text(encoding="utf-8"))["runs"]["ptne-v1"]
    for name, runs in trained.get(track, {}).items():
        mean = fmean(fmean(run["absolute_metrics"]["digits"]) for run in runs.values())
        digits[name] = max(mean, digits.get(name, mean))
    name = max(digits, key=lambda name: digits[name], default="")
    return f"{digits[name]:.2f} {name}" if name else "–"


def headline(found: Published) -> str:
    """The paper's law, the best law, the best standard algorithm and the recurrent network on each track of ptne-v1."""
    rows = []
    for track in (*found.names("track", "ptne-v1"), ALL):
        name, best = best_law(found, "ptne-v1", track)
        ours = [found.cell("ptne-v1", track, policy, best["metric"]) for policy in ("static", LEARNED[1])]
        cells = [plain(ours[0]), f"{plain(best)} {name}", best_standard(found, track), plain(ours[1])]
        rows.append(["**score**" if track == ALL else track, *cells])
    return markdown(
        ["track", "the paper's law", "best law", "best standard algorithm", "trained through the world"], rows
    )


def overall(found: Published) -> str:
    """Scores, mean regrets and ranks of all policies on ptne-v1."""
    rows = [
        [
            row["policy"],
            with_interval(row),
            regret(found.cell("ptne-v1", ALL, row["policy"], "mean_regret")),
            plain(found.cell("ptne-v1", ALL, row["policy"], "rank")),
        ]
        for row in found.rows
        if (row["suite"], row["metric"]) == ("ptne-v1", "score")
    ]
    return markdown(["policy", "score", "mean regret", "mean rank"], rows)


def best_on(found: Published, suite: str, world: str) -> tuple[str, float]:
    """The policy with the most digits on a random world, oracles apart, and its digits."""
    cells = {name: found.cell(suite, world, name) for name in found.names("policy", suite) if name != "oracle"}
    digits = {name: float(cell["mean"]) for name, cell in cells.items() if cell is not None}
    return max(digits.items(), key=lambda item: item[1])


def fails(found: Published, suite: str, world: str, policy: str) -> bool:
    """Whether a policy is worse than the paper's law by more than both intervals, or diverges more often."""
    cells = [
        {metric: found.cell(suite, world, name, metric) for metric in ("digits", "diverged_share")}
        for name in (policy, "static")
    ]
    own, law = ({metric: cell for metric, cell in each.items() if cell is not None} for each in cells)
    is_worse = float(own["digits"]["high"]) < float(law["digits"]["low"])
    return is_worse or float(own["diverged_share"]["mean"]) > float(law["diverged_share"]["mean"])


def sturdy(found: Published, suite: str) -> str:
    """How far each policy stays behind the best one of each random world, the least worst shortfall first."""
    rows = []
    for policy in found.names("policy", suite):
        behind, failures = [], 0
        for world in found.names("track", suite):
            cell = found.cell(suite, world, policy)
            if cell is not None and policy != "oracle":
                behind.append(best_on(found, suite, world)[1] - float(cell["mean"]))
                failures += fails(found, suite, world, policy)
        if behind:
            near = sum(shortfall <= NEAR for shortfall in behind)
            mean, worst = sum(behind) / len(behind), max(behind)
            rows.append((mean, [policy, f"{near} of {len(behind)}", f"{mean:.2f}", f"{worst:.2f}", str(failures)]))
    headings = ["policy", f"within {NEAR} of the best", "mean shortfall", "worst shortfall", "failures"]
    return markdown(headings, [row for _, row in sorted(rows)])


def worlds(found: Published, suite: str) -> str:
    """A row per random world: its description, the digits of some policies, and the best policy."""
    rows = []
    for track in WORLDS[suite].tracks:
        name, digits = best_on(found, suite, track.name)
        shown = [plain(found.cell(suite, track.name, policy)) for policy in SHOWN_ON_WORLDS]
        rows.append([f"{track.name}: {track.change}", *shown, f"{name} {digits:.2f}"])
    return markdown(["world", *SHOWN_ON_WORLDS, "best"], rows)


def every(found: Published, suite: str) -> str:
    """All policies on every track, the best first: digits with intervals, and mean regrets."""
    rows = [
        [
            track,
            policy,
            with_interval(found.cell(suite, track, policy)),
            regret(found.cell(suite, track, policy, "mean_regret")),
        ]
        for track in found.names("track", suite)
        for policy in found.ranked(suite, track)
    ]
    return markdown([suite.replace("comparison", "scenario"), "policy", "digits", "mean regret"], rows)


def fields(_: Published) -> str:
    """The fields of the observation, and where they are under each kind of interface, in ``energy``."""
    kinds = get_args(InterfaceKind)
    slices = [Encoder(World(CATALOGUE["energy"]), kind).layout.slices for kind in kinds]
    rows = [["Slice", "Size", *(f"`{kind}`" for kind in kinds), "Content"], ["---"] * (len(kinds) + 3)]
    for name, field in FIELDS.items():
        places = [f"{part[name].start}:{part[name].stop}" if name in part else "–" for part in slices]
        rows.append([f"`{name}`", field.size, *places, field.content])
    return "\n".join(f"| {' | '.join(cells)} |" for cells in rows)


TABLES: dict[str, Callable[[Published], str]] = {
    "fields": fields,
    "headline": headline,
    "ptne-v1": lambda found: by_track(found, "ptne-v1", [*SHOWN, "oracle"]),
    "ptne-v1-overall": overall,
    "ptne-v1-tracks": lambda found: every(found, "ptne-v1"),
    "robustness": lambda found: sturdy(found, "robustness"),
    "robustness-fresh": lambda found: sturdy(found, "robustness-2"),
    "robustness-worlds": lambda found: worlds(found, "robustness"),
    "robustness-fresh-worlds": lambda found: worlds(found, "robustness-2"),
    "catalogue": lambda found: by_track(found, "comparison", SHOWN_ON_SCENARIOS),
    "catalogue-all": lambda found: every(found, "comparison"),
}
"""The tables by name."""


def filled(text: str, found: Published) -> str:
    """A document with its tables.

    Raises:
        KeyError: for a table of an unknown name.
    """
    return re.sub(
        r"(<!-- table ([\w-]+) -->\n).*?(<!-- end -->)",
        lambda match: f"{match[1]}{TABLES[match[2]](found)}\n{match[3]}",
        text,
        flags=re.DOTALL,
    )


def documents() -> list[Path]:
    """The documents with tables."""
    return [ROOT / "README.md", *sorted(ROOT.glob("docs/*.md")), *sorted(ROOT.glob("baselines/*.md"))]


def read() -> Published:
    """The published numbers."""
    with RESULTS.open(encoding="utf-8", newline="") as file:
        return Published(list(csv.DictReader(file)))


def run(out: Path, episodes: int | None, workers: Workers) -> None:
    """Run everything that is not stored, and write ``results.csv``."""

    def show(job: str, done: int, total: int) -> None:
        print(f"{done / total:7.1%}  {job}", flush=True)

    runner = Runner(out, workers, show)
    compared = evaluate(COMPARED, CATALOGUE, episodes=episodes or 100, run=runner)
    entered = [POLICIES[name] for name in ENTERED]
    suite = run_suite("ptne-v1", entered, episodes=episodes, run=runner)
    drawn = [run_suite(each, entered, episodes=episodes, run=runner) for each in WORLDS.values()]
    rows = [row for each in (compared, suite, *drawn) for row in rows_of(each)]
    columns = ["suite", "track", "policy", "metric", "mean", "low", "high", "episodes"]
    lines = [columns, *([row.get(key, "") for key in columns] for row in rows)]
    write_atomically(RESULTS, "".join(f"{','.join(line)}\n" for line in lines))
    write_atomically(out / "results.json", suite.to_json())


def main() -> None:
    """Run, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "published")
    parser.add_argument("--episodes", type=int, help="the suite's own number, and 100 of a scenario, if left out")
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument("--tables", action="store_true", help="write the tables of results.csv alone")
    given = parser.parse_args()
    if not given.tables:
        run(given.out, given.episodes, Workers(given.jobs))
    found = read()
    for document in documents():
        write_atomically(document, filled(document.read_text(encoding="utf-8"), found))


if __name__ == "__main__":
    main()
