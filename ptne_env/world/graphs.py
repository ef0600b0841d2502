"""Communication graphs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any

import networkx as nx
import numpy as np
from scipy.sparse.csgraph import connected_components

from ptne_env.games.market import generators
from ptne_env.shared.arrays import FloatArray, freeze, require_count
from ptne_env.shared.parts import Part, as_tuples


class Graph(Part):
    """A weighted graph on players 0..N−1, undirected or directed.

    Attributes:
        adjacency: a_ij ≥ 0, the weight with which player i hears player j, and 0 where it does not; read-only, of shape
            (N, N), with zero diagonal; any other is a ``ValueError``. The graph is undirected where the matrix is
            symmetric up to rounding. The argument may be whatever :func:`adjacency` takes.
    """

    adjacency: FloatArray

    def __post_init__(self) -> None:
        try:
            matrix = freeze(adjacency(self.adjacency))
        except (TypeError, ValueError) as error:
            raise ValueError(f"an adjacency matrix is an (N, N) table of numbers: {error}") from error
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.shape[0] < 2:
            raise ValueError(f"an adjacency matrix is square with at least 2 players, got the shape {matrix.shape}")
        if not np.all(np.isfinite(matrix)) or matrix.min() < 0:
            raise ValueError("an adjacency matrix has finite weights a_ij ≥ 0")
        if np.any(np.diagonal(matrix)):
            raise ValueError("the graphs of the paper have no self-loops: the adjacency diagonal must be 0")
        is_undirected = np.allclose(matrix, matrix.T, rtol=1e-12, atol=0)
        vars(self)["adjacency"] = freeze(np.maximum(matrix, matrix.T)) if is_undirected else matrix

    @property
    def num_players(self) -> int:
        """N."""
        return self.adjacency.shape[0]

    @cached_property
    def is_directed(self) -> bool:
        """Whether some link carries messages in one direction only, or with another weight in the other one."""
        return not np.array_equal(self.adjacency, self.adjacency.T)

    @cached_property
    def laplacian(self) -> FloatArray:
        """L = diag(Σ_j a_ij) − A, shape (N, N), read-only."""
        return freeze(np.diag(self.adjacency.sum(axis=1)) - self.adjacency)

    @cached_property
    def algebraic_connectivity(self) -> float:
        """λ2(L) of an undirected graph, positive exactly when it is connected.

        In general it is the minimum of eᵀ P L e/‖e‖² over all e with pᵀ e = 0, where P = diag(p), and p > 0 is the left
        eigenvector, pᵀ L = 0, whose largest entry is 1 (docs/mathematics.md); 0 unless the graph is strongly connected.
        """
        if not self.is_connected:
            return 0.0
        left = np.abs(np.linalg.svd(self.laplacian.T)[2][-1])
        left /= left.max()
        form, across = left[:, None] * self.laplacian, np.linalg.svd(left[None])[2][1:]
        return max(0.0, float(np.linalg.eigvalsh(across @ (form + form.T) @ across.T / 2)[0]))

    @cached_property
    def is_connected(self) -> bool:
        """Whether every player hears of every other one: Assumption 1 of the paper, or strong connectivity."""
        return int(connected_components(self.adjacency > 0, connection="strong", return_labels=False)) == 1

    @property
    def largest_degree(self) -> int:
        """The largest number of players that a player hears."""
        return int((self.adjacency > 0).sum(axis=1).max())

    @property
    def edges(self) -> list[tuple[int, int]]:
        """Pairs (i, j) with i < j of which one player hears the other."""
        return [(int(i), int(j)) for i, j in np.argwhere(np.triu(np.maximum(self.adjacency, self.adjacency.T)))]

    def __repr__(self) -> str:
        rows = [
            {j: float(f"{weight:.4g}") for j, weight in enumerate(row) if weight} for row in self.adjacency.tolist()
        ]
        has_weights = not np.isin(self.adjacency, (0, 1)).all()
        if not self.is_directed:
            edges = [(i, j, rows[i][j]) for i, j in self.edges] if has_weights else self.edges
            return f"Graph(players={self.num_players}, edges={edges})"
        heard = ", ".join(f"{i} hears {row if has_weights else list(row)}" for i, row in enumerate(rows))
        return f"Graph(players={self.num_players}, {heard})"


def cycle(players: int) -> Graph:
    """Return the cycle 0-1-…-(N−1)-0, which is a single link for N = 2; N ≥ 2."""
    return as_graph(nx.cycle_graph(require_count("players", players, 2)))


def path(players: int) -> Graph:
    """Return the path 0-1-…-(N−1), N ≥ 2."""
    return as_graph(nx.path_graph(require_count("players", players, 2)))


def star(players: int) -> Graph:
    """Return the graph in which player 0 is linked to every other player, N ≥ 2."""
    return as_graph(nx.star_graph(require_count("players", players, 2) - 1))


def complete(players: int) -> Graph:
    """Return the graph in which all pairs of players are linked, N ≥ 2."""
    return as_graph(nx.complete_graph(require_count("players", players, 2)))


def circulant(players: int, offsets: Sequence[int]) -> Graph:
    """Link each player to those that are one of the ``offsets`` before or behind it on a circle, N ≥ 2."""
    return as_graph(nx.circulant_graph(require_count("players", players, 2), list(offsets)))


def from_edges(players: int, edges: Iterable[Sequence[int]]) -> Graph:
    """Return the graph with weight 1 on each listed pair of players 0..N−1; ``ValueError`` for a player outside."""
    matrix = np.zeros((require_count("players", players, 2),) * 2)
    for edge in edges:
        if len(edge) != 2 or not all(0 <= player < players for player in edge):
            raise ValueError(f"an edge is a pair of players 0..{players - 1}, got {tuple(edge)!r}")
        i, j = edge
        matrix[i, j] = matrix[j, i] = 1
    return Graph(matrix)


def market_118() -> Graph:
    """Return the graph of the 54 generators of the IEEE 118-bus case; see :func:`ptne_env.games.market.generators`."""
    return Graph(generators()["adjacency"])


def as_graph(graph: Any) -> Graph:
    """Return a :class:`Graph` as it is, and make one of what :func:`adjacency` takes."""
    return graph if isinstance(graph, Graph) else Graph(graph)


def adjacency(graph: Any) -> Any:
    """Return the weights a_ij, (N, N), of a graph of networkx, or of a list, an array, a tensor or a sparse matrix.

    Players are the nodes of networkx in the order of their labels, which are numbers, or texts of numbers such as "3".
    The attribute ``weight`` is 1 where it is missing. An edge u → v of a directed graph carries messages from u to v,
    so it is a_vu.

    Raises:
        ValueError: when a label is no number, or two are the same number.
    """
    if not isinstance(graph, nx.Graph):
        return graph if isinstance(graph, np.ndarray) else as_tuples(graph)
    try:
        nodes = {float(label): label for label in graph}
    except (TypeError, ValueError):
        nodes = {}
    if len(nodes) < len(graph) or not np.all(np.isfinite(list(nodes))):
        raise ValueError(
            f"the players of a graph are its nodes in the order of their labels, which must be different numbers, got "
            f"{list(graph)[:5]!r}; networkx.convert_node_labels_to_integers(graph) numbers them in the order in which "
            "they were added"
        )
    return nx.to_numpy_array(graph, nodelist=[nodes[number] for number in sorted(nodes)]).T


def union(graphs: Iterable[Graph]) -> Graph:
    """Return the union graph: every link of any of the graphs, with the largest of its weights."""
    return Graph(np.max([graph.adjacency for graph in graphs], axis=0))
