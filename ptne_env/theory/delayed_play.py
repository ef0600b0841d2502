"""Gradient play with delays: the loop of the routed laws, its largest stable step, and a bound for every delay."""

from __future__ import annotations

import numpy as np
import scipy
from scipy.sparse.csgraph import shortest_path

from ptne_env.shared.arrays import FloatArray, IntArray
from ptne_env.world.graphs import Graph

_ACCURACY = 1e-9
"""Relative accuracy of the largest stable step."""


def hop_delays(graph: Graph, owners: IntArray) -> IntArray:
    """d_cb: the hop count between the owners of the components c and b, shape (n, n).

    Args:
        graph: connected.
        owners: the player that owns each component, shape (n,).
    """
    hops = shortest_path(graph.adjacency, unweighted=True)
    return hops[np.ix_(owners, owners)].astype(np.int64)


def delayed_play_matrix(jacobian: FloatArray, delays: IntArray, step: float) -> FloatArray:
    """The matrix of e_c(k+1) = e_c(k) − η Σ_b dF_cb e_b(k − d_cb) on (e(k), e(k−1), …, e(k−D)), D = max d.

    The loop of :class:`~ptne_env.field.laws.RoutedUnknown` on a fixed graph after the first D steps, d_cb being the hop count
    between the owners of the components c and b. The estimates of the other players are late copies: they add zeros
    to the eigenvalues.

    Args:
        jacobian: dF, shape (n, n).
        delays: d_cb, shape (n, n).
        step: η.

    Returns:
        Shape (n (D+1), n (D+1)).
    """
    n, longest = len(jacobian), int(delays.max())
    matrix = np.eye(n * (longest + 1), k=-n)
    matrix[:n, :n] = np.eye(n)
    for delay in range(longest + 1):
        matrix[:n, delay * n : (delay + 1) * n] -= step * np.where(delays == delay, jacobian, 0.0)
    return matrix


def delayed_play_radius(jacobian: FloatArray, delays: IntArray, step: float) -> float:
    """Spectral radius of :func:`delayed_play_matrix`: below 1 exactly where gradient play with these delays settles."""
    return float(np.abs(np.linalg.eigvals(delayed_play_matrix(jacobian, delays, step))).max())


def multi_rate_radius(jacobian: FloatArray, delays: IntArray, steps: FloatArray, leads: FloatArray) -> float:
    """Spectral radius of e_c(k+1) = e_c(k) − η_c [(1 + δ_c) (dF e)_c(k) − δ_c (dF e)_c(k−1)], with delays in dF e.

    The loop of :class:`~ptne_env.field.laws.MultiRate` on a fixed graph after its first steps, where no bound becomes or
    ceases to be active: there, (dF e)_c(k) = Σ_b dF_cb e_b(k − d_cb).

    Args:
        jacobian: dF, shape (n, n).
        delays: d_cb, shape (n, n).
        steps: η_c, shape (n,).
        leads: δ_c, shape (n,).
    """
    n = len(jacobian)
    matrix = delayed_play_matrix((-steps * leads)[:, None] * jacobian, delays + 1, 1.0)
    ahead = delayed_play_matrix((steps * (1 + leads))[:, None] * jacobian, delays, 1.0)[:n]
    ahead[:, :n] -= np.eye(n)
    matrix[:n, : ahead.shape[1]] += ahead
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def largest_delayed_step(jacobian: FloatArray, delays: IntArray) -> float | None:
    """The step η up to which gradient play with delays settles.

    Args:
        jacobian: dF, shape (n, n), with a positive diagonal.
        delays: d_cb, shape (n, n).

    Returns:
        η with the radius 1, where it passes 1 for larger steps; ``None`` where no step above 1e-6/max dF_cc settles.
    """
    stable = 1 / float(jacobian.diagonal().max())
    smallest = 1e-6 * stable
    while delayed_play_radius(jacobian, delays, stable) >= 1:
        stable /= 2
        if stable < smallest:
            return None
    unstable = 2 * stable
    while delayed_play_radius(jacobian, delays, unstable) < 1:
        stable, unstable = unstable, 2 * unstable
    return float(
        scipy.optimize.brentq(
            lambda step: delayed_play_radius(jacobian, delays, step) - 1, stable, unstable, xtol=_ACCURACY * stable
        )
    )


def coupling_radius(jacobian: FloatArray) -> float:
    """ρ(D⁻¹ |dF − D|) with D the diagonal of dF; below 1, gradient play settles for every delay.

    With v > 0 the Perron vector, Σ_{b≠c} |dF_cb| v_b ≤ ρ dF_cc v_c. So where η dF_cc ≤ 1 for all c, a step maps the box
    |e_b| ≤ r v_b of all copies of e_b, however late, to |e_c| ≤ (1 − η (1 − ρ) dF_cc) r v_c. Means of copies stay in
    the box. As soon as all older copies are gone, all errors are within a smaller box, and so on: the errors vanish for
    delays that change and differ, as long as every copy is renewed again and again (D. P. Bertsekas and J. N.
    Tsitsiklis, "Parallel and Distributed Computation", 1989, Section 6.2).

    Args:
        jacobian: dF, shape (n, n); infinite where its diagonal is not positive.
    """
    diagonal = jacobian.diagonal()
    if diagonal.min() <= 0:
        return np.inf
    return float(np.abs(np.linalg.eigvals(np.abs(jacobian / diagonal[:, None]) - np.eye(len(diagonal)))).max())
