"""What every published environment did when it was published: ``python tests/golden.py`` adds those that are missing.

One short trajectory per environment and way to act, from actions of a seeded generator, kept in
``tests/data/golden.json``. An entry is never written over: behaviour of a ``-v0`` environment does not change, a
correction is a ``-v1`` beside it. Numbers have twelve digits and are compared to a relative 1e-9, because compilers and
versions of NumPy round differently; observations are float32 and compared to 1e-6.
"""

import json
import sys
from pathlib import Path

import numpy as np

import ptne_env
from ptne_env.files import write_atomically

DATA = Path(__file__).parent / "data" / "golden.json"

WAYS = {
    "physical": ({}, 2.0),
    "local": ({"interface": "local", "max_cycles": 300}, 0.2),
    "gains": ({"interface": "local", "action_mode": "gains", "hold_steps": 5}, 0.3),
}
"""Ways to act: arguments of the environment, and the half-width of the random actions.

Random inputs show the game, the clock and the switching; random gains close the loop around the paper's law.
"""

SEED = 20260101
INSTANTS = (1, 2, 5, 20, 100, 250)
"""Steps after which strategies are kept; those after the last step are, too."""


def trajectory(environment_id, way):
    """What an environment does: numbers in a line of text, by what they are."""
    arguments, width = WAYS[way]
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
    parts = {
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
    return {name: " ".join(f"{number:.12g}" for number in np.ravel(values)) for name, values in parts.items()}


def difference(kept, found):
    """What is different, by name and amount; empty where two trajectories agree."""
    if kept.keys() != found.keys():
        return f"the parts are {sorted(kept)} and {sorted(found)}"
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
    """The kept trajectories, by environment and way to act."""
    return json.loads(DATA.read_text(encoding="utf-8")) if DATA.exists() else {}


def main():
    """Add what is missing; say what is different and leave it."""
    kept = load()
    changed = False
    for scenario in ptne_env.CATALOGUE:
        entry = kept.setdefault(f"{scenario}-v0", {})
        for way in WAYS:
            found = trajectory(f"{scenario}-v0", way)
            if way not in entry:
                entry[way] = found
                print(f"{scenario}-v0, {way}: added")
            elif reason := difference(entry[way], found):
                changed = True
                print(f"{scenario}-v0, {way}: {reason}; the entry stays, publish the change as a new version")
    write_atomically(DATA, json.dumps(kept, indent=0) + "\n")
    return int(changed)


if __name__ == "__main__":
    sys.exit(main())
