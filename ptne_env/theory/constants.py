"""Constants of a game, strong monotonicity ε and Lipschitz continuity ι, and what else theorems ask of a scenario."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ptne_env.games import Game
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, require_positive
from ptne_env.world.graphs import Graph
from ptne_env.world.switching import SwitchingTopology
from ptne_env.world.world import World

SAMPLES = 256
"""Number of points from which constants that are not exact are computed."""


@dataclass(frozen=True)
class MonotonicityConstants:
    """The constants of Assumption 4.

    Where ``exact`` is false they come from sampled Jacobians: ε is then an upper bound and ι a lower bound of the
    constant on the sampled box, and nothing is known outside it.

    Attributes:
        epsilon: ε, the largest constant for which F is ε-strongly monotone; not positive when F is not.
        iota_strategies: ι_F, the Lipschitz constant of F on R^n.
        iota_estimates: the Lipschitz constant of the stacked **F** on R^{Nn}.
        exact: whether F is affine, so that the numbers are exact and global.
        radius: half-width of the sampled box around x*; ``None`` when exact.
    """

    epsilon: float
    iota_strategies: float
    iota_estimates: float
    exact: bool
    radius: float | None

    @property
    def iota(self) -> float:
        """The larger of the two Lipschitz constants, ι of the paper's eq. (15)."""
        return max(self.iota_strategies, self.iota_estimates)


def monotonicity_constants(game: Game, *, radius: float = 10.0) -> MonotonicityConstants:
    """Return ε and ι of Assumption 4, exactly for affine F and from samples otherwise.

    ε = λ_min of the symmetric part of dF, ι_F = ‖dF‖₂, and for **F** the largest ‖rows of player i in dF‖₂, since
    block i of **F** depends on x^i alone.

    Args:
        game: the game.
        radius: half-width of the box around x* from which points are drawn when F is not affine. They are projected
            into the game's box.

    Raises:
        ValueError: when ``radius`` is not positive.
    """
    require_positive("radius", radius)
    points = game.nash_equilibrium[:, None]
    if not game.is_affine:
        generator = np.random.default_rng(0)
        points = game.project(points + generator.uniform(-radius, radius, (game.dimension, SAMPLES)))
    sampled = np.moveaxis(game.jacobian(points), 2, 0)
    symmetric = (sampled + sampled.transpose(0, 2, 1)) / 2
    blocks = [sampled[:, game.owners == player] for player in range(game.num_players)]
    smallest = float(np.linalg.eigvalsh(symmetric)[:, 0].min())
    return MonotonicityConstants(
        epsilon=0.0 if abs(smallest) <= rounding_error(symmetric) else smallest,
        iota_strategies=_largest_norm(sampled),
        iota_estimates=max(_largest_norm(block) for block in blocks),
        exact=game.is_affine,
        radius=None if game.is_affine else float(radius),
    )


def rounding_error(matrix: FloatArray) -> float:
    """Return the size below which an eigenvalue or singular value counts as 0, for matrices of shape (..., m, m)."""
    return 10 * matrix.shape[-1] * float(np.finfo(np.float64).eps * np.linalg.norm(matrix, axis=(-2, -1)).max())


def gain_bound(constants: MonotonicityConstants, algebraic_connectivity: float) -> float:
    """Return (ι²/ε + ι)/λ2, which κ must exceed in Theorem 1 (eq. (15)); infinite unless ε and λ2 are positive."""
    epsilon, iota = constants.epsilon, constants.iota
    if epsilon <= 0 or algebraic_connectivity <= 0:
        return math.inf
    return (iota**2 / epsilon + iota) / algebraic_connectivity


def jacobian_at_equilibrium(game: Game) -> FloatArray:
    """Return dF(x*), shape (n, n)."""
    return game.jacobian(game.nash_equilibrium[:, None])[:, :, 0]


@dataclass(frozen=True)
class ProblemConstants(MonotonicityConstants):
    """The numbers of a scenario that conditions of theorems use.

    Attributes:
        jacobian: dF, shape (n, n); at x* unless F is affine.
        owners: the player that owns each component, shape (n,).
        graphs: the modes of the topology.
        is_bounded: whether each component has a bound, shape (n,).
        recurring: the graphs whose links act again and again as s → ∞: the union of all modes on the transformed clock,
            each mode that may be the last on the physical clock.
    """

    jacobian: FloatArray
    owners: IntArray
    is_bounded: BoolArray
    graphs: tuple[Graph, ...]
    recurring: tuple[Graph, ...]

    @property
    def num_players(self) -> int:
        """N."""
        return self.graphs[0].num_players

    @property
    def connectivity(self) -> float:
        """The smallest λ2 over the modes; exactly 0 where a mode is disconnected."""
        return min(graph.algebraic_connectivity for graph in self.graphs)

    @property
    def directed_graphs(self) -> int:
        """The number of modes that are directed."""
        return sum(graph.is_directed for graph in self.graphs)

    @property
    def largest_degree(self) -> float:
        """The largest Σ_j a_ij over players and modes."""
        return max(float(graph.laplacian.diagonal().max()) for graph in self.graphs)


def problem_constants(world: World) -> ProblemConstants:
    """Return the constants of a world; of a family of games, those of its representative."""
    game, topology = world.game, world.topology
    recurring = [topology.union]
    if not topology.is_fixed and topology.clock == "physical":  # one mode is the last before T
        recurring = [topology.graphs[mode] for mode in last_modes(topology, world.scenario.deadline)]
    return ProblemConstants(
        **vars(monotonicity_constants(game)),
        jacobian=jacobian_at_equilibrium(game),
        owners=game.owners,
        is_bounded=np.isfinite(np.hstack(game.bounds)).any(axis=1),
        graphs=tuple(topology.graphs),
        recurring=tuple(recurring),
    )


def last_modes(topology: SwitchingTopology, deadline: float) -> Sequence[int]:
    """Return the modes that may act as t → T: of a fixed graph, or of a topology on the physical clock."""
    if topology.is_fixed:
        return (0,)
    if topology.is_random:
        return range(len(topology.graphs))
    last_switch = float(np.max(topology.switches(0.0, deadline), initial=0.0))
    return (int(topology.schedule((last_switch + deadline) / 2).modes),)


def _largest_norm(matrices: FloatArray) -> float:
    return float(np.linalg.svd(matrices, compute_uv=False)[:, 0].max())
