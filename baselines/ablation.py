"""What each rule of observer-relay brings: ``python -m baselines.ablation [EPISODES]`` writes ``ablation.md``.

Mean digits over the scored tracks of the suite and over the worlds of the robustness set, on validation episodes, with
every rule, and the change where one rule is off; and the track or world that loses most. Intervals are of 95 %, of the
difference between paired episodes.
"""

import sys
from pathlib import Path
from statistics import fmean

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
    results = evaluate(specs, tracks, episodes=episodes, split="validation")
    names = [track.name for track in tracks]
    digits = fmean(results.samples[name, "all"]["digits"].mean() for name in names)
    table = [[suite.name, "all", f"{digits:.2f}", ""]]
    for policy in list(results.policies)[1:]:
        change = "{mean:+.2f} [{low:+.2f}, {high:+.2f}]".format(**vars(results.difference(policy, "all")))
        changes = {name: results.difference(policy, "all", name).mean for name in names}
        most = min(names, key=lambda name: changes[name])
        table.append([suite.name, policy.replace("no ", "without "), change, f"{most} {changes[most]:+.2f}"])
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
