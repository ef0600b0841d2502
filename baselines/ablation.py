"""What each rule of observer-relay brings: ``python -m baselines.ablation [EPISODES]`` writes ``ablation.md``.

Mean digits over the scored tracks of the suite and over the worlds of the robustness set, on validation episodes, with
every rule, and the change where one rule is off; and the track or world that loses most. Intervals are of 95 %, of the
difference between paired episodes.
"""

import sys
from pathlib import Path

import numpy as np

from baselines.published import markdown
from ptne_env import FactorySpec, PolicySpec
from ptne_env.evaluation import evaluate
from ptne_env.laws.observer_relay import RULES
from ptne_env.shared.files import write_atomically
from ptne_env.suites import Suite, get_suite
from ptne_env.suites.robustness import robustness

EPISODES = 4


def spec(rule: str | None) -> PolicySpec:
    """The law without a rule."""
    without = {"without": [rule]} if rule else {}
    return PolicySpec(f"no {rule}" if rule else "all", FactorySpec.of("law:observer-relay", **without))


def rows(suite: Suite, episodes: int) -> list[list[str]]:
    """A row of the table per rule, of a suite."""
    tracks = [track for track in suite.tracks if track.scored]
    specs = [spec(None), *map(spec, RULES)]
    samples = evaluate(specs, tracks, episodes=episodes, split="validation").samples
    names = list(dict.fromkeys(track for track, _ in samples))
    whole = {name: samples[name, "all"]["digits"].ravel() for name in names}
    table = [[suite.name, "all", f"{np.mean([digits.mean() for digits in whole.values()]):.2f}", ""]]
    for rule in RULES:
        change = {name: samples[name, f"no {rule}"]["digits"].ravel() - whole[name] for name in names}
        variance = sum(each.var(ddof=1) / each.size for each in change.values())
        mean, half = np.mean([each.mean() for each in change.values()]), 1.96 * np.sqrt(variance) / len(names)
        most = min(change, key=lambda name: change[name].mean())
        table.append([suite.name, f"without {rule}", f"{mean:+.2f} ± {half:.2f}", f"{most} {change[most].mean():+.2f}"])
    return table


def main(episodes: int = EPISODES) -> None:
    """Write the table beside this file, and print it."""
    table = [row for suite in (get_suite("ptne-v1"), robustness(1)) for row in rows(suite, episodes)]
    command, explanation = f"`python -m baselines.ablation {episodes}` writes this page.", __doc__.split("\n\n", 1)[1]
    numbers = markdown(["set", "observer-relay", "digits", "loses most"], table)
    text = f"# What each rule of observer-relay brings\n\n{command} {explanation}\n{numbers}\n"
    print(text)
    write_atomically(Path(__file__).with_suffix(".md"), text)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
