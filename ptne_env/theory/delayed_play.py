"""Gradient play and best responses with late messages: the loop of routed laws, and a bound for every delay."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import shortest_path

from ptne_env.shared.arrays import FloatArray, IntArray
from ptne_env.theory.constants import ZERO
from ptne_env.world.graphs import Graph


def hop_delays(graph: Graph, owners: IntArray) -> IntArray:
    """d_cb: the hop count between the owners of the components c and b, shape (n, n).

    Args:
        graph: connected.
        owners: the player that owns each component, shape (n,).
    """
    hops = shortest_path(graph.adjacency, unweighted=True)
    return hops[np.ix_(owners, owners)].astype(np.int64)


def delayed_play_radius(jacobian: FloatArray, delays: IntArray, step: float) -> float:
    """Spectral radius of e_c(k+1) = e_c(k) − η Σ_b dF_cb e_b(k − d_cb).

    It is the loop of :class:`~ptne_env.field.laws.RoutedUnknown` on a fixed graph after the first steps, where no bound
    becomes or ceases to be active: below 1 exactly where the law settles. The estimates of the other players are late
    copies, which add zeros to the eigenvalues.

    Args:
        jacobian: dF, shape (n, n).
        delays: d_cb, shape (n, n).
        step: η.
    """
    n, longest = len(jacobian), int(delays.max())
    matrix = np.eye(n * (longest + 1), k=-n)  # of (e(k), e(k−1), …)
    matrix[:n, :n] = np.eye(n)
    for delay in range(longest + 1):
        matrix[:n, delay * n : (delay + 1) * n] -= step * np.where(delays == delay, jacobian, 0.0)
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def coupling_radius(jacobian: FloatArray, owners: IntArray) -> float:
    """ρ(B) with B_ij = ‖G_ii⁻¹ G_ij‖ for i ≠ j, G = dF; below 1, best-response play settles for every delay.

    With v > 0 the Perron vector, B v ≤ ρ v: best responses to copies with errors ‖e_j‖ ≤ r v_j, however late, have
    errors ‖e_i‖ ≤ ρ r v_i. As soon as all older copies are gone, all errors are within the smaller box, and so on: the
    errors vanish for delays that change and differ, as long as every copy is renewed again and again (D. P. Bertsekas
    and J. N. Tsitsiklis, "Parallel and Distributed Computation", 1989, Section 6.2). With an owner per component, so do
    those of gradient play with steps η dF_cc ≤ 1.

    Args:
        jacobian: dF, shape (n, n).
        owners: the player of each component, shape (n,).

    Returns:
        The radius; infinite where some G_ii is singular, so that no best response exists.
    """
    blocks = [np.flatnonzero(owners == player) for player in range(int(owners.max()) + 1)]
    coupling = np.zeros((len(blocks), len(blocks)))
    for i, own in enumerate(blocks):
        square = jacobian[np.ix_(own, own)]
        if np.linalg.svd(square, compute_uv=False)[-1] <= ZERO * np.linalg.norm(jacobian):
            return np.inf
        response = np.linalg.solve(square, jacobian[own])
        for j, other in enumerate(blocks):
            coupling[i, j] = 0.0 if i == j else np.linalg.norm(response[:, other], 2)
    return float(np.abs(np.linalg.eigvals(coupling)).max())
