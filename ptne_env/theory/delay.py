"""Stability of a sampled loop whose messages arrive late: exact margins and sufficient bounds."""

from __future__ import annotations

import numpy as np
from scipy import optimize

from ptne_env.shared.arrays import require_count
from ptne_env.theory.closed_loop import Loop

_LARGEST_SYSTEM = 1200
"""Delays are tried while the augmented matrix has no more rows than this: its eigenvalues take seconds beyond."""

_LARGEST_RESOLVENT = 150
"""The small-gain bound on delays is found for at most this many estimates, for the same reason."""


def delayed_radius(loop: Loop, step: float, delay: int) -> float:
    """Spectral radius of the loop when every message is ``delay`` steps late; below 1 it is stable.

    Of the augmented matrix of e_{k+1} = (I − h local) e_k − h message e_{k−d} on (e_k, …, e_{k−d}).

    Raises:
        ValueError: when the delay is negative.
    """
    size, blocks = len(loop.local), require_count("delay", delay, 0) + 1
    augmented = np.eye(size * blocks, k=-size)
    augmented[:size, :size] = np.eye(size) - step * loop.local
    augmented[:size, -size:] -= step * loop.message
    return float(np.abs(np.linalg.eigvals(augmented)).max())


def delay_margin(loop: Loop, step: float, limit: int = 20) -> int | None:
    """The largest d for which every delay of 0..d steps leaves the loop stable, up to a limit.

    Args:
        loop: of one graph.
        step: h.
        limit: largest delay to try; less is tried where the augmented matrix would be too large.

    Returns:
        d, at most ``limit``; ``None`` where the loop is unstable without delay.
    """
    tried = delays_tried(loop, limit)
    margin = next((d - 1 for d in range(tried + 1) if delayed_radius(loop, step, d) >= 1), tried)
    return None if margin < 0 else margin


def delays_tried(loop: Loop, limit: int) -> int:
    """The largest delay that :func:`delay_margin` tries: ``limit``, or less where the augmented matrix is too large."""
    return max(0, min(limit, _LARGEST_SYSTEM // len(loop.local) - 1))


def is_stable_for_every_delay(loop: Loop, step: float) -> bool:
    """Whether ρ(|I − h local| + h |message|) < 1 (absolute values by entry), which suffices for every delay.

    The entries of |e| are then below those of a positive system that shrinks, for all delays, and also when they change
    from message to message. Sufficient only.
    """
    positive = np.abs(np.eye(len(loop.local)) - step * loop.local) + step * np.abs(loop.message)
    return bool(np.abs(np.linalg.eigvals(positive)).max() < 1)


def delay_bound(loop: Loop, step: float) -> float | None:
    """A bound on h d below which the loop is stable with every message d steps late; first order in h d, sufficient.

    With A = I − hM and G = ``message`` a late message subtracts h G (1 − z^{−d}) from z I − A, and |1 − z^{−d}| ≤
    d |z − 1| on |z| = 1. So no eigenvalue crosses the unit circle while h d ρ((z − 1)(z I − A)^{−1} G) < 1 all along
    it (small gain). For small h the largest ρ is about that of G: h d < 1/(κ ρ(adjacency)) for the static law.

    Returns:
        1/max_z ρ, over a grid of angles, refined; ``None`` where the loop is unstable without delay, no message
        matters, or there are more than 150 estimates.
    """
    identity = np.eye(len(loop.local))
    transition = identity - step * loop.matrix
    if len(identity) > _LARGEST_RESOLVENT or np.abs(np.linalg.eigvals(transition)).max() >= 1:
        return None

    def gain(angle: float) -> float:
        z = np.exp(1j * angle)
        product = (z - 1) * np.linalg.solve(z * identity - transition, loop.message)
        return float(np.abs(np.linalg.eigvals(product)).max())

    # Peaks are where an eigenvalue of A comes near the circle; the best of the grid is refined between its neighbours.
    angles = np.unique([*np.geomspace(1e-3, np.pi, 96), *np.abs(np.angle(np.linalg.eigvals(transition)))])
    gains = [gain(angle) for angle in angles[angles > 0]]
    best, ends = int(np.argmax(gains)), np.pad(angles[angles > 0], 1, mode="edge")
    between = (ends[best], ends[best + 2])
    refined = optimize.minimize_scalar(lambda angle: -gain(angle), bounds=between, method="bounded")
    largest = max(gains[best], -float(refined.fun))
    return 1 / largest if largest > 0 else None
