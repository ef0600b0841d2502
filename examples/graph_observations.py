"""Turn observations into a graph of messages, as a graph network reads them, with the help of ``env.layout``.

A node is a player with its own entries, and an edge is a message x^j − x^i with its weight a_ij. The paper's static law
is one round of message passing on this graph.

Run it with: python examples/graph_observations.py
"""

import numpy as np

import ptne_env

KAPPA = 2.0


def build_graph(layout: ptne_env.ObservationLayout, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the nodes, the edges, and the live links (sender, receiver) of all players' observations, (N, size)."""
    nodes = np.concatenate([layout.select(rows, name) for name in ("own_gradient", "clock", "player")], axis=1)
    weights = layout.select(rows, "weights")
    messages = layout.select(rows, "relative_estimates").reshape(*weights.shape, layout.dimension)
    receivers, slots = np.nonzero(weights)  # a link that is down has weight 0
    edges = np.concatenate([messages[receivers, slots], weights[receivers, slots][:, None]], axis=1)
    return nodes, edges, np.stack([np.array(layout.neighbours)[receivers, slots], receivers], axis=1)


def static_law(layout: ptne_env.ObservationLayout, rows: np.ndarray) -> np.ndarray:
    """Return u^i = κ Σ_j a_ij (x^j − x^i) − gradient by message passing, where every player has one component."""
    nodes, edges, links = build_graph(layout, rows)
    inputs = np.zeros((layout.num_players, layout.dimension), dtype=np.float32)
    np.add.at(inputs, links[:, 1], KAPPA * edges[:, -1:] * edges[:, :-1])
    return inputs - np.diag(nodes[:, 0])


def main() -> None:
    """Play an episode over switching graphs, and print the error at the deadline."""
    env = ptne_env.parallel_env("energy-switching-transformed", interface="physical")
    observations, _ = env.reset(seed=0)
    up = set()
    while env.agents:
        rows = np.stack(list(observations.values()))
        up.add(len(build_graph(env.layout, rows)[1]))
        observations, *_ = env.step(dict(zip(env.agents, static_law(env.layout, rows), strict=True)))
    error = np.linalg.norm(env.strategies - env.nash_equilibrium) / np.linalg.norm(env.nash_equilibrium)
    print(f"messages per step: {sorted(up)}, relative error at the deadline: {error:.1e}")


if __name__ == "__main__":
    main()
