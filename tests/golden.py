"""Golden trajectories of the published environments: ``python tests/golden.py`` adds the missing ones.

``tests/data/golden.json`` keeps one short trajectory per environment and action mode, from actions of a seeded
generator. A trajectory is never replaced: the behaviour of a ``-v0`` environment does not change, a correction is a
``-v1`` beside it. Numbers have twelve digits and are compared to a relative 1e-9, because compilers and versions of
NumPy round differently; observations are float32 and compared to 1e-6.
"""

import json
import sys
from pathlib import Path

import numpy as np

import ptne_env
from ptne_env.shared.files import write_atomically

DATA = Path(__file__).parent / "data" / "golden.json"

MODES = {"physical": ({"interface": "physical"}, 2.0)}
"""Interfaces: arguments of the environment, and the half-width of the random actions."""

SEED = 20260101
INSTANTS = (1, 2, 5, 20, 100, 250)
"""Steps after which strategies are kept, in addition to the last step."""


def trajectory(environment_id, mode):
    """The trajectory of an environment: lines of numbers by name."""
    arguments, width = MODES[mode]
    env = ptne_env.parallel_env(environment_id.removesuffix("-v0"), **arguments)
    generator = np.random.default_rng(SEED)
    observations, _ = env.reset(seed=SEED)
    first = observations["player_1"]
    strategies, estimates, returns, length = [env.strategies], env.estimates, 0.0, 0
    while env.agents:
        drawn = generator.random((len(env.agents), env.layout.action_size)) * (2 * width) - width
        observations, rewards, terminations, _, infos = env.step(dict(zip(env.agents, drawn.astype("f4"), strict=True)))
        returns, length = returns + np.array(list(rewards.values())), length + 1
        if length in INSTANTS:
            strategies.append(env.strategies)
    ending = terminations["player_0"], infos["player_0"]["diverged"], infos["player_0"]["is_success"]
    lines = {
        "length": length,
        "terminated, diverged, success": ending,
        "nash_equilibrium": env.nash_equilibrium,
        "first_estimates": estimates,
        "strategies": [*strategies, env.strategies],
        "last_estimates": env.estimates,
        "returns": returns,
        "first_observation": first,
        "last_observation": observations["player_1"],
    }
    return {name: " ".join(f"{number:.12g}" for number in np.ravel(values)) for name, values in lines.items()}


def difference(kept, found):
    """Name and amount of the first difference of two trajectories, or an empty text."""
    if kept.keys() != found.keys():
        return f"the names are {sorted(kept)} and {sorted(found)}"
    for name, values in kept.items():
        tolerance = 1e-6 if name.endswith("observation") else 1e-9
        old, new = np.array(values.split(), dtype=float), np.array(found[name].split(), dtype=float)
        if old.shape != new.shape:
            return f"{name} has {new.size} entries instead of {old.size}"
        off = float(np.abs(new - old).max())
        if not off <= tolerance * max(1.0, float(np.abs(old).max())):
            return f"{name} is off by {off:.3g}"
    return ""


def load():
    """The kept trajectories, by environment and action mode."""
    return json.loads(DATA.read_text(encoding="utf-8")) if DATA.exists() else {}


def main():
    """Add missing trajectories; print differences and leave them."""
    kept = load()
    changed = False
    for scenario in ptne_env.CATALOGUE:
        modes = kept.setdefault(f"{scenario}-v0", {})
        for mode in MODES:
            found = trajectory(f"{scenario}-v0", mode)
            if mode not in modes:
                modes[mode] = found
                print(f"{scenario}-v0, {mode}: added")
            elif reason := difference(modes[mode], found):
                changed = True
                print(f"{scenario}-v0, {mode}: {reason}; the golden trajectory stays: publish a new version")
    write_atomically(DATA, json.dumps(kept, indent=0) + "\n")
    return int(changed)


if __name__ == "__main__":
    sys.exit(main())
