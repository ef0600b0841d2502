"""The time of a law's rollouts, share by share: ``python -m benchmarks.rollouts [--episodes E] [--repeats R]``.

A job of a suite runs here as ``ptne compare`` runs it for a policy of a user, on one thread: world, observation, law,
audit and metrics.
Figures are CPU nanoseconds per agent-step, medians over the repeats.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from time import process_time
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.ours import timed
from ptne_env import laws
from ptne_env.evaluation import get_suite, jobs
from ptne_env.evaluation.audit import Witness
from ptne_env.evaluation.jobs import Job
from ptne_env.evaluation.policy_specs import get_policy_spec
from ptne_env.perception.encoder import Encoder
from ptne_env.world import dynamics

PARTS: dict[str, tuple[tuple[Any, str], ...]] = {
    "start": ((jobs, "_initial_state"),),
    "world": ((dynamics, "step"),),
    "observation": ((Encoder, "observe"),),
    "actions to inputs": ((Encoder, "decode"),),
    "law and audit": ((laws.Law, "predict"),),
    "of it, audit": ((Witness, "compare"),),
    "metrics": ((jobs, "measure"),),
}
"""The functions of each part. What is left are the recorded series and the loop."""

POLICIES = ("static", "adaptive", "grounded", "contact-relay", "observer-relay")


def shares(policy: str, track: str, episodes: int) -> dict[str, float]:
    """CPU nanoseconds per agent-step of each part of a job of ``ptne-v1``, and of the whole.

    Args:
        policy: by name.
        track: of the suite.
        episodes: number of them.
    """
    suite = get_suite("ptne-v1")
    spec = get_policy_spec(policy)
    audited = replace(spec, policy=spec.build)  # as a policy that does not ship with the library
    job = Job(suite.track(track), audited, 0, suite.episode_set(track, episodes))
    spent = {part: [0.0] for part in PARTS}
    with ExitStack() as stack:
        for part, functions in PARTS.items():
            for owner, name in functions:
                stack.enter_context(timed(owner, name, spent[part], process_time))
        began = process_time()
        job.compute()
        total = process_time() - began
    world = job.track.world
    agent_steps = episodes * world.game.num_players * world.clock.total_steps
    found = {part: seconds for part, (seconds,) in spent.items()}
    rest = total - sum(seconds for part, seconds in found.items() if part != "of it, audit")
    return {part: 1e9 * seconds / agent_steps for part, seconds in (found | {"series": rest, "all": total}).items()}


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--track", default="nominal", help="a track of ptne-v1")
    parser.add_argument("--episodes", type=int, default=1000, help="in one batch")
    parser.add_argument("--repeats", type=int, default=5, help="jobs of each law")
    options = parser.parse_args(arguments)
    found = {
        policy: [shares(policy, options.track, options.episodes) for _ in range(options.repeats)] for policy in POLICIES
    }
    parts = list(found[POLICIES[0]][0])
    title = f"CPU nanoseconds per agent-step, {options.episodes} episodes of {options.track}, median of"
    table = Table("law", *parts, title=f"{title} {options.repeats}")
    for policy, repeats in found.items():
        table.add_row(policy, *(f"{np.median([repeat[part] for repeat in repeats]):.0f}" for part in parts))
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
