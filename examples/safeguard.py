"""A safeguard: bad policies without sizes in random games, and the law to which their players hand over.

Plays the games of local_rates.py without faults, with and without the safeguard. The gates are those of observer-relay
with one changed, or of a random linear map. Digits end at 12.

Prints a line per policy: the median and the largest local radius without the safeguard (inf where the episode
diverges), the median and the smallest number of digits without it and with it, and the share of players that handed
over.

Run it with: python examples/safeguard.py [--games 1] [--policy size-free]
"""

import argparse
from collections.abc import Mapping
from functools import partial

import numpy as np
from local_rates import FAMILIES, scenario

from ptne_env import ObservationLayout, Scenario, parallel_env, theory
from ptne_env import learn as policies
from ptne_env.field.laws.gated import CellEvidence, CellGates, SlotEvidence, SlotGates, observer_gates
from ptne_env.learn import SizeFreeFile, SizeFreePolicy
from ptne_env.shared.arrays import Float32Array
from ptne_env.world.world import World

DIGITS = 12
BENT = {
    "the law": {},
    "flow 10": {"flow": 10.0},
    "copies 0.1": {"copies": 0.1},
    "response 0": {"response": 0.0},
}
"""Gates of components in place of the law's: the gain of the gradient at its bound, and small shares."""


def random_map(cell: Float32Array, slot: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Gates that are linear in the features with random weights; without dither and joint solutions."""
    generator = np.random.default_rng(0)
    mine = cell @ generator.normal(size=(cell.shape[-1], len(CellGates._fields)))
    mine[:, [CellGates._fields.index(name) for name in ("dither", "joint")]] = 0.0
    theirs = slot @ generator.normal(size=(slot.shape[-1], len(SlotGates._fields)))
    return mine.astype(np.float32), theirs.astype(np.float32)


class Bent(SizeFreePolicy):
    """The gates of observer-relay, some of them replaced."""

    def __init__(self, layout: ObservationLayout, changes: Mapping[str, float], *, guarded: bool) -> None:
        super().__init__(layout, random_map, guarded=guarded)
        self.changes = changes

    def gates(self, cells: CellEvidence, slots: SlotEvidence) -> tuple[CellGates, SlotGates]:
        """The gates of R players."""
        gates, slot_gates = observer_gates(cells, slots)
        return gates._replace(
            **{name: np.full_like(cells.own, gate) for name, gate in self.changes.items()}
        ), slot_gates


def digits(policy: SizeFreePolicy, world: Scenario) -> tuple[float, float]:
    """Digits at the deadline, and the share of players that handed over."""
    env = parallel_env(world)
    observations, _ = env.reset(seed=0)
    memory = None
    while env.agents:
        actions, memory = policy.predict(np.stack(list(observations.values())), memory)
        observations, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
    scale = np.sqrt(len(env.estimates)) * np.linalg.norm(env.nash_equilibrium)
    distance = np.linalg.norm(env.estimates - env.nash_equilibrium) / scale
    return float(min(-np.log10(distance), DIGITS)), float(policy.has_handed_over(memory).mean())


def main(games: int, path: str | None) -> None:
    """Print the table."""
    kinds = {name: partial(Bent, changes=changes) for name, changes in BENT.items()}
    kinds["random"] = partial(SizeFreePolicy, network=random_map)
    if path is not None:
        loaded = policies.load(path)
        if not isinstance(loaded, SizeFreeFile):
            raise SystemExit(f"{path} is not a policy without sizes")
        kinds["the file"] = partial(SizeFreePolicy, network=loaded.network)
    worlds = [scenario(family, seed) for family in FAMILIES for seed in range(games)]
    print("policy           radius           digits  with safeguard  handed over")
    for name, kind in kinds.items():
        rows = []
        for each in worlds:
            world = World(each)
            free, guarded = (theory.build_law(partial(kind, guarded=is_guarded), world) for is_guarded in (False, True))
            with np.errstate(all="ignore"):  # episodes of play have no input limits, and diverge beyond float32
                radius = theory.local_radius(world, free)
            rows.append((radius, digits(free, each)[0], *digits(guarded, each)))
        radii, alone, kept, handed = np.array(rows).T
        print(
            f"{name:12} {np.median(radii):5.2f} {radii.max():5.2f}   {np.median(alone):6.2f} {alone.min():6.2f}  "
            f"{np.median(kept):6.2f} {kept.min():6.2f}    {handed.mean():7.0%}"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--games", type=int, default=1)
    parser.add_argument("--policy", help="a policy without sizes, by name or .onnx file")
    arguments = parser.parse_args()
    main(arguments.games, arguments.policy)
