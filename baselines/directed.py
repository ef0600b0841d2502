"""Which laws serve on directed graphs: ``python -m baselines.directed`` prints the table of docs/findings.md.

It plays ``random-energy`` on the directed ring of 5 players, and on random graphs of 10 and of 20 players that are
strongly connected, in which a player hears about three others, with weights that differ and are 2 in all, as on the
5-cycle. Beside them stand the same graphs with every link in both directions, (A + Aᵀ)/2, and the directed ones with
noise on every message. Means are over all graphs and episodes.
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np

from baselines.published import markdown
from ptne_env import get_scenario
from ptne_env.evaluation import PolicySpec, evaluate, get_policy_spec
from ptne_env.laws import Static
from ptne_env.laws.static import static_inputs
from ptne_env.perception.observation import Observation, ObservationLayout
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.parts import FactorySpec
from ptne_env.world.graphs import Graph

NOISE = FactorySpec.of("channel:noise", std=0.1)

LAWS = ("static", "adaptive", "grounded", "projected-gradient", "fixed-time", "routed-unknown", "relay")


class Balanced(Static):
    """The static law with own gradients over N q_i, where q > 0, qᵀ L = 0 and Σ q_i = 1, so that all weigh the same.

    Y. Tang, P. Yi, Y. Zhang and D. Liu (arXiv:2005.10495) let players estimate the left eigenvector; here it is known.
    """

    def __init__(self, layout: ObservationLayout, graph: Graph) -> None:
        super().__init__(layout)
        left = np.abs(np.linalg.svd(graph.laplacian.T)[2][-1])
        self.weights = left.mean() / left

    def inputs(self, observation: Observation, memory: None) -> tuple[FloatArray, None]:
        """Return the inputs; see :class:`~ptne_env.laws.Law`."""
        return static_inputs(observation, self.kappa, self.weights[observation.player][:, None]), memory


def ring(players: int) -> Graph:
    """Return the directed ring in which player i hears player i−1 with weight 2."""
    return Graph(2 * np.roll(np.eye(players), 1, axis=0))


def random_graph(players: int, seed: int) -> Graph:
    """Return a random graph that is strongly connected, with Σ_j a_ij = 2 for every player."""
    generator = np.random.default_rng(seed)
    while True:
        linked = generator.random((players, players)) < 3 / (players - 1)
        weights = linked * generator.uniform(0.5, 1.5, linked.shape) * (1 - np.eye(players))
        if weights.any(axis=1).all() and Graph(weights).is_connected:
            return Graph(2 * weights / weights.sum(axis=1, keepdims=True))


def both_ways(graph: Graph) -> Graph:
    """Return the graph with the mean of its weights in both directions."""
    return Graph((graph.adjacency + graph.adjacency.T) / 2)


def mean_digits(graph: Graph, channel: FactorySpec, episodes: int) -> list[float]:
    """Return the mean digits of the laws at T on a graph, those of the balanced law first."""
    game = FactorySpec.of("game:random-energy", players=graph.num_players)
    scenario = get_scenario("random-energy", name="directed", game=game, topology=graph, channel=channel)
    balanced = PolicySpec("balanced", partial(Balanced, graph=graph), Static.interface)
    results = evaluate([balanced, *map(get_policy_spec, LAWS)], scenario, episodes=episodes)
    return [results.samples["directed", name]["digits"].mean() for name in ("balanced", *LAWS)]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--episodes", type=int, default=10, help="per graph")
    parser.add_argument("--graphs", type=int, default=3, help="random graphs of each size")
    arguments = parser.parse_args()
    perfect = FactorySpec.of("channel:perfect")
    groups = {"ring of 5": [ring(5)]}
    groups |= {
        f"random, {players}": [random_graph(players, seed) for seed in range(arguments.graphs)] for players in (10, 20)
    }
    table = []
    for name, graphs in groups.items():
        undirected = [both_ways(graph) for graph in graphs]
        rows = ("undirected", undirected, perfect), ("directed", graphs, perfect), ("directed, noise", graphs, NOISE)
        for kind, played, channel in rows:
            connectivity = np.mean([graph.algebraic_connectivity for graph in played])
            digits = np.mean([mean_digits(graph, channel, arguments.episodes) for graph in played], axis=0)
            table.append([f"{name}, {kind}", *(f"{number:.2f}" for number in (connectivity, *digits))])
    print(markdown(["Graph", "λ", *(f"`{name}`" for name in ("balanced", *LAWS))], table))


if __name__ == "__main__":
    main()
