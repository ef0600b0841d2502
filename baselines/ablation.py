"""What each rule of observer-relay brings: ``python baselines/ablation.py [EPISODES]`` writes ``ablation.md``.

Mean digits over the scored tracks of the suite and over the worlds of the robustness set, on validation episodes, with
every rule, and the change where one rule is off; and the track or world that loses most. Intervals are of 95 %, of the
difference between paired episodes.
"""

import sys
from pathlib import Path

import numpy as np

from ptne_env import FactorySpec, PolicySpec
from ptne_env.evaluation import evaluate
from ptne_env.laws.observer_relay import RULES
from ptne_env.suites import Suite, get_suite
from ptne_env.suites.robustness import robustness

EPISODES = 4


def spec(rule: str | None) -> PolicySpec:
    """The law without a rule."""
    without = {"without": [rule]} if rule else {}
    return PolicySpec(f"no {rule}" if rule else "all", FactorySpec.of("law:observer-relay", **without))


def rows(suite: Suite, episodes: int) -> list[str]:
    """A row of the table per rule, of a suite."""
    tracks = [track for track in suite.tracks if track.scored]
    specs = [spec(None), *map(spec, RULES)]
    samples = evaluate(specs, tracks, episodes=episodes, split="validation").samples
    names = list(dict.fromkeys(track for track, _ in samples))
    whole = {name: samples[name, "all"]["digits"].ravel() for name in names}
    found = [f"| {suite.name} | all | {np.mean([digits.mean() for digits in whole.values()]):.2f} | |"]
    for rule in RULES:
        change = {name: samples[name, f"no {rule}"]["digits"].ravel() - whole[name] for name in names}
        variance = sum(each.var(ddof=1) / each.size for each in change.values())
        mean, half = np.mean([each.mean() for each in change.values()]), 1.96 * np.sqrt(variance) / len(names)
        most = min(change, key=lambda name: change[name].mean())
        found.append(
            f"| {suite.name} | without {rule} | {mean:+.2f} ± {half:.2f} | {most} {change[most].mean():+.2f} |"
        )
    return found


def main(episodes: int = EPISODES) -> None:
    """Write the table beside this file, and print it."""
    lines = [
        __doc__.split("\n\n", 1)[1],
        "| set | observer-relay | digits | loses most |",
        "| --- | --- | ---: | --- |",
    ]
    for suite in (get_suite("ptne-v1"), robustness(1)):
        lines += rows(suite, episodes)
        print("\n".join(lines), flush=True)
    title = "# What each rule of observer-relay brings\n\n"
    command = f"`python baselines/ablation.py {episodes}` writes this page. "
    Path(__file__).with_suffix(".md").write_text(title + command + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
