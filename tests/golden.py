"""Golden trajectories, which force ``PHYSICS`` up when behaviour changes: ``python tests/golden.py`` writes them.

``tests/data/golden.json`` holds the PHYSICS that it was made with; numbers of the first 100 steps of every scenario of
the catalogue, and of worlds with faults, under open-loop actions; and digits at the deadline of the static law, which
contracts. Numbers are compared to a relative 1e-9, because processors and versions of numpy round differently;
observations, which are float32, to 1e-5; digits to 0.01.
"""

import json
import sys
from pathlib import Path

import numpy as np
from worlds import BLOCKS_SWITCHING, FAULTY, begin, channel_part

import ptne_env
from ptne_env import FactorySpec, Interface, laws
from ptne_env.perception.encoder import Encoder
from ptne_env.shared.files import write_atomically
from ptne_env.world import distances, dynamics
from ptne_env.world.dynamics import PHYSICS
from ptne_env.world.rewards import Reward
from ptne_env.world.world import World

DATA = Path(__file__).parent / "data" / "golden.json"

SCENARIOS = {
    **ptne_env.CATALOGUE,
    "from the paper's start": ptne_env.get_scenario("energy", start="paper"),
    "faulty": FAULTY,
    "blocks": BLOCKS_SWITCHING,
    "liar": ptne_env.get_scenario(
        "random-energy",
        channel=channel_part("Lying", size=1.0),
        topology=FactorySpec.of("topology:random-graphs", players=5, probability=0.5),
    ),
}
CONTRACTIVE = ["energy", "random-energy", "hvac-ye-hu", "random-affine", "robots"]
"""Scenarios whose ends are compared; on switching graphs the law amplifies rounding."""

INSTANTS = (1, 2, 5, 20, 50, 100)
SEED = 20260101
WIDTHS = {"physical": 5.0, "scaled": 0.5}
"""Half-widths of the random actions."""

CASES = [f"{name}, {kind}" for name in SCENARIOS for kind in WIDTHS]
NUMBERS = ("estimates", "own gradients", "return", "observations")
TOLERANCES = dict(zip(NUMBERS, (1e-9, 1e-9, 1e-9, 1e-5), strict=True))


def mixture(array):
    """One number that depends on every entry, about as large as the largest."""
    flat = np.asarray(array, dtype=np.float64).ravel()
    weights = np.random.default_rng(flat.size).uniform(0.5, 1.5, flat.size)
    return float(np.sqrt(weights @ flat**2) + weights[::-1] @ flat / flat.size)


def trajectory(scenario, kind):
    """Four numbers at each of the instants, by name, under random actions of two environments."""
    world = World(scenario)
    encoder, reward = Encoder(world, Interface(kind)), Reward(world)
    state, generator = begin(world, [SEED, SEED + 1]), np.random.default_rng(SEED)
    reward.reset(state)
    found, total = {name: [] for name in NUMBERS}, 0.0
    for k in range(1, min(INSTANTS[-1], world.clock.total_steps) + 1):
        observations = encoder.observe(state)
        drawn = WIDTHS[kind] * generator.uniform(-1, 1, (2, world.game.num_players, encoder.layout.action_size))
        state = dynamics.step(world, state, encoder.decode(drawn.astype(np.float32), state))
        total = total + reward.total(reward.step(state))
        if k in INSTANTS:
            values = mixture(state.estimates), mixture(state.own_gradients), mixture(total), mixture(observations)
            for name, value in zip(NUMBERS, values, strict=True):
                found[name].append(value)
    return {name: " ".join(f"{value:.12g}" for value in values) for name, values in found.items()}


def end(scenario):
    """The digits of the static law at the deadline, of one episode."""
    world = World(scenario)
    encoder, state = Encoder(world, laws.Static.interface), begin(world, [SEED])
    law = laws.Static(encoder.layout)
    for _ in range(world.clock.steps):
        state = dynamics.step(world, state, encoder.decode(law.predict(encoder.observe(state)[0])[0][None], state))
    return round(distances.digits(distances.estimate_distance(state.estimates, state.game)).item(), 4)


def difference(kept, found):
    """The first difference of two trajectories, or an empty text."""
    for name, tolerance in TOLERANCES.items():
        old, new = (np.array(values[name].split(), dtype=float) for values in (kept, found))
        if old.shape != new.shape or not np.all(np.abs(new - old) <= tolerance * np.maximum(np.abs(old), 1.0)):
            return f"{name} are {found[name]} instead of {kept[name]}"
    return ""


def measured():
    """The content of the file, made anew."""
    cases = {
        f"{name}, {kind}": trajectory(SCENARIOS[name], kind) for name, kind in (case.rsplit(", ", 1) for case in CASES)
    }
    return {"physics": PHYSICS, "trajectories": cases, "ends": {name: end(SCENARIOS[name]) for name in CONTRACTIVE}}


def changes(kept, found):
    """What differs between two contents, apart from scenarios that one of them lacks."""
    both = kept["trajectories"].keys() & found["trajectories"].keys()
    result = {case: difference(kept["trajectories"][case], found["trajectories"][case]) for case in sorted(both)}
    for name in kept["ends"].keys() & found["ends"].keys():
        if abs(kept["ends"][name] - found["ends"][name]) > 0.01:
            result[name] = f"the digits are {found['ends'][name]} instead of {kept['ends'][name]}"
    return {case: reason for case, reason in result.items() if reason}


def load():
    """The content of the file."""
    return json.loads(DATA.read_text(encoding="utf-8"))


def main():
    """Write the file, unless behaviour has changed and PHYSICS has not."""
    found = measured()
    if DATA.exists() and load()["physics"] == PHYSICS and (reasons := changes(load(), found)):
        print(f"behaviour changed: raise PHYSICS in ptne_env/world/dynamics.py to {PHYSICS + 1}, and run this again:")
        print(*(f"{case}: {reason}" for case, reason in reasons.items()), sep="\n")
        return 1
    write_atomically(DATA, json.dumps(found, indent=0) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
