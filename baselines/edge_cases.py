"""Two suites: edge cases at which strong laws fell, and graphs whose links carry messages in one direction."""

from __future__ import annotations

import numpy as np

from ptne_env import get_scenario
from ptne_env.evaluation.tracks import Track
from ptne_env.games import EnergyGame
from ptne_env.shared.parts import FactorySpec
from ptne_env.suites import Suite
from ptne_env.world.graphs import Graph
from ptne_env.world.scenario import Scenario

part = FactorySpec.of
ENERGY = get_scenario("random-energy")


def _start(largest: float) -> Scenario:
    return ENERGY.replace(start=part("start:uniform", low=-largest, high=largest))


def random_graph(players: int, seed: int) -> Graph:
    """A random graph that is strongly connected, in which a player hears about three others, weighted 2 in all."""
    generator = np.random.default_rng(seed)
    while True:
        linked = generator.random((players, players)) < 3 / (players - 1)
        weights = linked * generator.uniform(0.5, 1.5, linked.shape) * (1 - np.eye(players))
        if weights.any(axis=1).all() and Graph(weights).is_connected:
            return Graph(2 * weights / weights.sum(axis=1, keepdims=True))


def _on(graph: Graph) -> Scenario:
    return ENERGY.replace(game=part("game:random-energy", players=graph.num_players), topology=graph)


def _suite(name: str, worlds: dict[str, Scenario]) -> Suite:
    tracks = [Track(label, world.replace(name=label), f"{label}.") for label, world in worlds.items()]
    return Suite(name, tuple(tracks), episodes=20)


EDGE_CASES = {
    "starts ±0.01": _start(0.01),
    "starts ±1e-4": _start(1e-4),
    "starts ±1e-6": _start(1e-6),
    "starts ±1e-12": _start(1e-12),
    "starts at 0": ENERGY.replace(start=part("start:fixed", estimates=np.zeros((5, 5)))),
    "starts at x*": get_scenario("energy", start=part("start:fixed", estimates=[EnergyGame().nash_equilibrium] * 5)),
    "x* = 0": get_scenario("energy", game=part("game:energy", target=[0.0] * 5, base_price=0.0)),
    "rotation": get_scenario("random-affine").replace(
        game=part("game:random-affine", epsilon=0.1, asymmetry=10.0), channel=part("channel:noise", std=0.001)
    ),
}
"""Random energy games on a ring, but for the last three; messages are exact, but for the last."""

GRAPH, NOISE = random_graph(20, seed=0), part("channel:noise", std=0.1)
DIRECTED_GRAPHS = {
    "ring of 5, directed": _on(Graph(2 * np.roll(np.eye(5), 1, axis=0))),
    "20 players": _on(Graph((GRAPH.adjacency + GRAPH.adjacency.T) / 2)),
    "20 players, directed": _on(GRAPH),
    "20 players, directed, noise": _on(GRAPH).replace(channel=NOISE),
}
"""Random energy games; "20 players" has every link of the directed graph in both directions."""

SUITES = _suite("edge-cases", EDGE_CASES), _suite("directed-graphs", DIRECTED_GRAPHS)
