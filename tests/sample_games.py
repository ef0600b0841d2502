"""Games for tests: unequal dimensions, numerical solution, or no equilibrium."""

from functools import cached_property

import numpy as np

from ptne_env.games import Game, NoBestResponseError
from ptne_env.shared.arrays import ordered_sum


def generators(seeds):
    """A random generator per seed."""
    return [np.random.default_rng(seed) for seed in seeds]


def times(matrix, vectors):
    """Matrix times vectors, with the same order of additions for any number of columns."""
    return ordered_sum(matrix[:, :, None] * vectors, axis=1)


class AffineBlocks(Game):
    """J_i = ½ x_iᵀ A_ii x_i + x_iᵀ Σ_{j≠i} A_ij x_j + q_iᵀ x_i, so F(x) = A x + q; NE by the base class's solver."""

    is_affine = True

    def block(self, player):
        start = sum(self.action_dims[:player])
        return slice(start, start + self.action_dims[player])

    def costs(self, strategies):
        rows = []
        for player in range(self.num_players):
            block = self.block(player)
            own = strategies[block]
            others = strategies.copy()
            others[block] = 0
            linear = times(self.matrix[block], others) + self.offset[block, None]
            quadratic = times(self.matrix[block, block], own)
            rows.append(ordered_sum(own * (quadratic / 2 + linear)))
        return np.stack(rows)

    def own_gradients(self, estimates):
        own = estimates[:, self.owners]  # column c is the estimate of the owner of component c
        return (self.matrix.T[:, :, None] * own).sum(axis=0) + self.offset[:, None]

    def jacobian(self, strategies):
        return np.repeat(self.matrix[:, :, None], strategies.shape[1], axis=2)

    def best_response(self, strategies):
        response = np.empty_like(strategies)
        for player in range(self.num_players):
            block = self.block(player)
            others = strategies.copy()
            others[block] = 0
            target = -(times(self.matrix[block], others) + self.offset[block, None])
            response[block] = times(np.linalg.inv(self.matrix[block, block]), target)
        return response


class BlockGame(AffineBlocks):
    """Random A and q."""

    action_dims: tuple = (2, 1, 3)
    seed: int = 3

    @cached_property
    def matrix(self):
        return self._numbers[0]

    @cached_property
    def offset(self):
        return self._numbers[1]

    @cached_property
    def _numbers(self):
        generator, n = np.random.default_rng(self.seed), self.dimension
        matrix = generator.uniform(-0.3, 0.3, (n, n))
        for player in range(self.num_players):
            block = self.block(player)
            square = generator.normal(size=(self.action_dims[player],) * 2)
            matrix[block, block] = 2 * np.eye(self.action_dims[player]) + 0.1 * square @ square.T
        return matrix, generator.uniform(-8, 8, n)


class RestingGame(Game):
    """J_i = ½ ‖x_i − p_i‖²: the equilibrium is the point p."""

    is_affine = True

    point: np.ndarray
    players: int

    def __post_init__(self):
        vars(self)["point"] = np.asarray(self.point)
        super().__post_init__()

    @cached_property
    def action_dims(self):
        return (self.point.size - self.players + 1,) + (1,) * (self.players - 1)

    def costs(self, strategies):
        squares = (strategies - self.point[:, None]) ** 2 / 2
        return np.stack([squares[self.owners == player].sum(axis=0) for player in range(self.num_players)])

    def own_gradients(self, estimates):
        return estimates[np.arange(self.dimension), self.owners] - self.point[:, None]

    def best_response(self, strategies):
        return np.repeat(self.point[:, None], strategies.shape[1], axis=1)

    def _solve_nash_equilibria(self):
        return self.point[:, None]


class CubicGame(Game):
    """J_i = x_i³/3 + s x_i with F_i = x_i² + s: no equilibrium for s > 0."""

    shift: float = 1.0
    action_dims = (1, 1)

    def costs(self, strategies):
        return strategies**3 / 3 + self.shift * strategies

    def own_gradients(self, estimates):
        return np.einsum("iib->ib", estimates) ** 2 + self.shift

    def best_response(self, strategies):
        raise NoBestResponseError("a cubic has no minimum")


def crowded_costs(x):
    """Costs of any number of players with one component each; for games from their costs alone."""
    return x**2 / 2 + x.__array_namespace__().sqrt(1 + x**2) + 0.1 * x * ordered_sum(x) - x


def excess(x):
    """A constraint on their total."""
    return [ordered_sum(x) - 0.5]
