"""Local rates: the factor by which errors near the equilibrium shrink per step, predicted and in episodes.

Draws games of 3 to 12 players on random connected graphs, runs observer-relay to eight digits, freezes its gates and
its identified model there, and takes the spectral radius of the linearised step. The factor of the episode is the mean
over its second half. Games whose episodes have fewer than eight digits after 400 steps are counted as unfinished.

Prints a line per family: the games, the share of radii below 1, their median, the share of unfinished episodes, and the
median and the 90 % quantile of the difference to the factors of the episodes.

Run it with: python examples/local_rates.py [--games 20]
"""

import argparse

import numpy as np

from ptne_env import FactorySpec, Scenario, theory
from ptne_env.field import laws as field_laws
from ptne_env.games import Game
from ptne_env.theory.sampled import play
from ptne_env.world.world import World

FAMILIES = {"RandomAffine": {"asymmetry": 1.0}, "RandomEnergy": {}}
DIGITS = 8


def drawn(family: str, players: int, seed: int) -> Game:
    """One game of a family."""
    parts = FactorySpec.of(f"ptne_env.games:{family}", players=players, **FAMILIES[family]).build()
    return parts.draw([np.random.default_rng(seed)])


def links(players: int, generator: np.random.Generator) -> list[list[int]]:
    """A random tree and a third of all other links."""
    tree = {(int(generator.integers(i)), i) for i in range(1, players)}
    others = {(i, j) for i in range(players) for j in range(i + 1, players) if generator.random() < 1 / 3}
    return [list(edge) for edge in sorted(tree | others)]


def scenario(family: str, seed: int) -> Scenario:
    """One game of a family on a random connected graph."""
    generator = np.random.default_rng(seed)
    players = int(generator.integers(3, 13))
    graph = FactorySpec.of("ptne_env.world.graphs:from_edges", players=players, edges=links(players, generator))
    return Scenario(
        name="local",
        game=FactorySpec.of("local_rates:drawn", family=family, players=players, seed=seed),
        topology=FactorySpec.of("ptne_env.world.switching:fixed", graph=graph),
        start="random",
    )


def rates(family: str, seed: int) -> tuple[float, float | None]:
    """The local radius, and the factor per step of an episode; ``None`` where it has too few digits."""
    world = World(scenario(family, seed))
    law = theory.build_law(field_laws.ObserverRelay, world)
    radius = theory.local_radius(world, law)
    start = world.start.draw(world.game.num_players, world.game.dimension, np.random.default_rng(0))
    errors = play(law, world, start, 10.0**-DIGITS).errors
    distances = theory.distance(errors[np.isfinite(errors).all(axis=1)], world.game)
    if distances[-1] >= 10.0**-DIGITS:
        return radius, None
    last, half = len(distances) - 1, len(distances) // 2
    return radius, float((distances[last] / distances[half]) ** (1 / (last - half)))


def main(games: int) -> None:
    """Print the table."""
    for family in FAMILIES:
        found = [rates(family, seed) for seed in range(games)]
        radii = np.array([radius for radius, _ in found])
        gaps = np.array([abs(radius - factor) for radius, factor in found if factor is not None])
        middle, largest = np.quantile(gaps, [0.5, 0.9])
        print(
            f"{family:12}  {games} games  below 1: {np.mean(radii < 1):.0%}  median {np.median(radii):.2f}  "
            f"unfinished {1 - len(gaps) / games:.0%}  difference {middle:.3f}, {largest:.3f}"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--games", type=int, default=20)
    main(parser.parse_args().games)
