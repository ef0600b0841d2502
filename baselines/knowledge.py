"""The worth of knowledge: policies with the same best response that differ in knowledge alone, track by track.

Run it with ``python baselines/knowledge.py``; ``knowledge.md`` beside this file is its output.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from common import Jobs, Ray, interval, table

from ptne_env import FactorySpec, PolicySpec
from ptne_env.evaluation import POLICIES, Suite, Track, Workers, get_suite, run_suite
from ptne_env.evaluation.metrics import share
from ptne_env.evaluation.statistics import estimate
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.files import write_atomically

HERE = Path(__file__).parent

LINKS, REMEMBERED = "own links", "own links, memory"
UNION, UNION_REMEMBERED, SCHEDULE = "union", "union, memory", "schedule"
CODED_LINKS, CODED = "own links, coded", "union, coded"
GRADIENT_REMEMBERED, GRADIENT_UNION, GRADIENT_SCHEDULE = "own links, memory ", "union ", "schedule "


_INTRODUCTION = (
    "Written by `python baselines/knowledge.py`; do not edit. {episodes} test episodes per track and seed, {seeds} "
    "seeds; means with 95 % intervals over the episodes of all seeds. `docs/knowledge.md` says what the entries are."
)


def _known(name: str, policy: str) -> PolicySpec:
    return PolicySpec(name, POLICIES[policy].policy, POLICIES[policy].interface)


BEST_RESPONSE = {
    LINKS: _known(LINKS, "link-relay"),
    REMEMBERED: _known(REMEMBERED, "contact-relay"),
    UNION: _known(UNION, "relay"),
    UNION_REMEMBERED: _known(UNION_REMEMBERED, "route-relay"),
    SCHEDULE: _known(SCHEDULE, "freshest-relay"),
    CODED_LINKS: PolicySpec(CODED_LINKS, FactorySpec.of("ptne_env.field.laws:LinkBroadcast")),
    CODED: _known(CODED, "identify-and-broadcast"),
}
"""Entries with the best response of ``relay`` to an identified model. They differ in knowledge alone."""

GRADIENT = {
    GRADIENT_REMEMBERED: _known(GRADIENT_REMEMBERED, "routed-unknown"),
    GRADIENT_UNION: _known(GRADIENT_UNION, "routed"),
    GRADIENT_SCHEDULE: _known(GRADIENT_SCHEDULE, "freshest"),
}
"""Entries with the gradient step of ``routed``. They need no model of the game."""

GAINS = {
    "memory, of own links": (REMEMBERED, LINKS),
    "union, no memory": (UNION, LINKS),
    "union, with memory": (UNION_REMEMBERED, REMEMBERED),
    "schedule, over union with memory": (SCHEDULE, UNION_REMEMBERED),
    "code, own links": (CODED_LINKS, LINKS),
    "code, union": (CODED, UNION),
}
"""Two entries that differ in one kind of knowledge each."""


def tracks() -> tuple[Track, ...]:
    """Tracks of ptne-v1, those on fixed graphs with fewer steps: otherwise all entries reach 12 digits there."""
    suite = get_suite("ptne-v1")
    cycle = FactorySpec.of("ptne_env.world.graphs:cycle", players=5)

    def track(name: str, base: str, change: str, **changes: Any) -> Track:
        return Track(name, suite.track(base).scenario.replace(name=name, **changes), change)

    def links(dwell: float, clock: str) -> dict[str, Any]:
        topology = FactorySpec.of(
            "ptne_env.world.switching:random_edges", graph=cycle, probability=0.5, dwells=dwell, clock=clock
        )
        return {"topology": topology}

    return (
        track("fixed", "nominal", "the 5-cycle, 20 steps", steps=20),
        track("drawn", "unseen-graphs", "a random graph per episode, 40 steps", steps=40),
        track("periodic-physical", "switching-physical", "four disconnected graphs in turn, every 0.1 s"),
        track("periodic-transformed", "switching-transformed", "the same, every 0.25 of transformed time"),
        track("markov", "markov", "one of these graphs at random, every 0.1 of transformed time"),
        track(
            "random-physical", "nominal", "each link of the 5-cycle up or down, every 0.1 s", **links(0.1, "physical")
        ),
        track(
            "random-transformed",
            "nominal",
            "the same, every 0.25 of transformed time",
            **links(0.25, "transformed"),
        ),
        track("noise", "noise", "the 5-cycle, messages with noise of standard deviation 0.05"),
        track("delay", "delay", "the 5-cycle, messages of 1 to 7 steps ago, 100 steps", steps=100),
        track("burst-loss", "burst-loss", "the 5-cycle, a third of messages lost in bursts, 100 steps", steps=100),
        track("large-50", "large-50", "50 players of degree 4, 60 steps", steps=60),
    )


def measured(entries: dict[str, PolicySpec], episodes: int, seeds: int, workers: Workers) -> dict[str, dict[str, Any]]:
    """The samples of all seeds by metric, shape (seeds × episodes,), by entry and track."""
    suite = Suite("knowledge", tracks(), episodes, is_comparison=True)
    found: dict[str, dict[str, Any]] = {}
    for seed in range(seeds):
        results = run_suite(suite, entries.values(), seed=seed, workers=workers)
        if results.failures:
            raise RuntimeError(f"an entry failed: {results.failures}")
        for (track, entry), samples in results.samples.items():
            for metric in ("digits", "log_error_area", "unexplained_share"):
                found.setdefault(entry, {}).setdefault(track, {}).setdefault(metric, []).append(samples[metric].ravel())
    return {
        entry: {
            track: {metric: np.concatenate(parts) for metric, parts in metrics.items()} for track, metrics in of.items()
        }
        for entry, of in found.items()
    }


def _cell(samples: FloatArray | None, *, unit: bool = False) -> str:
    if samples is None:
        return "n/a"
    summary = estimate([samples[None]])
    return share(summary.mean) if unit else interval(summary)


def _table(names: list[str], found: dict[str, dict[str, Any]], metric: str, *, unit: bool = False) -> list[str]:
    rows = [
        [track.name, *(_cell(found[name].get(track.name, {}).get(metric), unit=unit) for name in names)]
        for track in tracks()
    ]
    return table(["track", *(name.strip() for name in names)], rows, texts=("track",))


def _gains(found: dict[str, dict[str, Any]]) -> list[str]:
    rows = []
    for track in tracks():
        row = [track.name]
        for more, less in GAINS.values():
            a, b = (found[name].get(track.name, {}).get("digits") for name in (more, less))
            row.append(_cell(None if a is None or b is None else a - b))
        rows.append(row)
    return table(["track", *GAINS], rows, texts=("track",))


def main(
    episodes: Annotated[int, typer.Option(min=2, help="Episodes per track and seed.")] = 200,
    seeds: Annotated[int, typer.Option(min=1, help="Seeds of the episodes.")] = 2,
    jobs: Jobs = 2,
    ray: Ray = None,
) -> None:
    """Run all entries on all tracks, and write the tables."""
    found = measured(BEST_RESPONSE | GRADIENT, episodes, seeds, Workers(jobs, ray))
    lines = [
        "# Tables of knowledge",
        "",
        _INTRODUCTION.format(episodes=episodes, seeds=seeds),
        "",
        *table(["track", "scenario"], [[track.name, track.change] for track in tracks()], texts=("track", "scenario")),
        "",
        "## Digits gained by each kind of knowledge",
        "",
        "Differences of two entries with the same best response, paired by episode.",
        "",
        *_gains(found),
        "",
        "## Digits, best response from an identified model",
        "",
        *_table(list(BEST_RESPONSE), found, "digits"),
        "",
        "## Digits, gradient step",
        "",
        *_table(list(GRADIENT), found, "digits"),
        "",
        "## Mean log10 error over the episode, best response",
        "",
        *_table(list(BEST_RESPONSE), found, "log_error_area"),
        "",
        "## Unexplained share of the moves of estimates, best response",
        "",
        *_table(list(BEST_RESPONSE), found, "unexplained_share", unit=True),
    ]
    text = "\n".join(lines) + "\n"
    write_atomically(HERE / "knowledge.md", text)
    typer.echo(text)


if __name__ == "__main__":
    typer.run(main)
