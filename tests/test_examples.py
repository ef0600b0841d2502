"""The examples run as their docstrings describe and print the lines that examples/README.md quotes."""

import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from processes import run_python

import ptne_env

FOLDER = Path(__file__).parents[1] / "examples"
EXAMPLES = sorted(FOLDER.glob("*.py"))
PRINTED = dict(
    re.findall(r"^\| \[(\w+\.py)\]\(\1\) \|.*\| `([^`]+)` \|$", (FOLDER / "README.md").read_text("utf-8"), re.MULTILINE)
)
"""The line of each example's output that the README quotes."""


def test_readme_lists_every_example():
    assert set(PRINTED) == {path.name for path in EXAMPLES}


def test_averages_of_noisy_messages_obey_their_bound():
    """Players state and believe any averages; variances are sums of squared weights of the noises of all messages."""
    example, steps, players = runpy.run_path(str(FOLDER / "noisy_averages.py")), 60, 5
    links = [(player, player + side) for player in range(1, players) for side in (-1, 1)]
    noises = np.eye(len(links) * steps).reshape(len(links), steps, -1)

    def variances(stated, believed):
        heard = {link: [] for link in links}
        statements = {0: 0 * noises[0, 0], players: 0 * noises[0, 0]}  # those of the owner have no error
        for step in range(steps):
            for number, (player, neighbour) in enumerate(links):
                if neighbour in statements:
                    heard[player, neighbour].append(statements[neighbour] + noises[number, step])
            told = {player: (heard[player, player - 1], heard[player, player + 1]) for player in range(1, players)}
            statements |= {player: stated(player, *both) for player, both in told.items() if any(both)}
        return [steps * (believed(player, *both) ** 2).sum() for player, both in told.items()]

    def anything(_, *both):
        return generator.dirichlet([0.5] * len(both[0] + both[1])) @ (both[0] + both[1])

    def copy(player, before, after):
        return before[-1] if player <= players // 2 else after[-1]

    def best(player, before, after):
        share = {1: 1.0, 2: 0.6, 3: 0.4, 4: 0.0}[player]
        return share * np.mean(before, axis=0) + (1 - share) * np.mean(after, axis=0)

    for seed in range(5):
        generator = np.random.default_rng(seed)
        assert (np.array(variances(anything, anything)) >= example["BOUND"]).all()
    found = variances(copy, best)
    assert (np.array(found) >= example["BOUND"]).all()
    np.testing.assert_allclose(found, example["SIMPLE"], rtol=0.05)


def test_in_one_file_is_the_library_bit_for_bit():
    env = ptne_env.parallel_env("energy-switching-transformed")
    observations, _ = env.reset(seed=0)
    law = ptne_env.laws.Static(env.layout, kappa=2.0)
    trajectory = [env.estimates]
    while env.agents:
        actions, _ = law.predict(np.stack(list(observations.values())))
        observations, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
        trajectory.append(env.estimates)
    example = runpy.run_path(str(FOLDER / "in_one_file.py"))
    np.testing.assert_array_equal(example["play"](), trajectory)
    t, s, steps = example["clock"]()
    clock = env.world.clock
    np.testing.assert_array_equal([t[:-1], s[:-1], steps], [clock.t[:-1], clock.s[:-1], clock.theta[:-1]])
    np.testing.assert_allclose(example["NASH_EQUILIBRIUM"], env.nash_equilibrium, rtol=1e-14)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example_prints_the_line_that_the_readme_quotes(example, tmp_path):
    done = run_python("-W", "error", example, folder=tmp_path)
    assert done.stderr == ""
    assert PRINTED[example.name] in " ".join(done.stdout.split())
    if example.stem == "train_sb3":  # the digits of a trained network differ slightly between machines
        before, after = map(float, re.findall(r"(-?\d+\.\d+)", done.stdout)[:2])
        assert before < 0.5
        assert after > 3.0


def test_own_parts_are_imported_by_module_and_object_in_worker_processes(tmp_path):
    """A game, a graph, a channel, a law and a track outside the library."""
    command = ["-m", "ptne_env.cli", "compare", "--suite", "own_parts:suite", "--policy", "own_parts:HeavyBall"]
    settings = ["--trust", "--episodes", "3", "--jobs", "2", "--out", "out"]
    run_python("-W", "error", *command, *settings, folder=tmp_path, modules=[FOLDER])
    data = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    contest, clipped = (track["scenario"] for track in data["suite"]["tracks"])
    assert contest["game"]["target"] == "own_parts:BeautyContest"
    assert contest["topology"]["target"] == "own_parts:wheel"
    assert clipped["channel"]["target"] == "own_parts:Clipped"
    digits = {(row["track"], row["policy"]): row["mean"] for row in data["records"] if row["metric"] == "digits"}
    for track in ("contest", "clipped"):
        assert digits[track, "zero-input"] < digits[track, "own_parts:HeavyBall"] < digits[track, "oracle"]
    assert digits["clipped", "static"] < digits["contest", "static"] - 0.5  # the channel bites
