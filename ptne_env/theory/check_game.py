"""Checks of a game's gradients and of Assumption 3 of the paper, on sampled points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from ptne_env.games.base import Game
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray

_RADII = np.array([1e2, 1e3, 1e4])


@dataclass(frozen=True)
class GameReport:
    """Result of :func:`check_game`, on sampled points.

    Attributes:
        gradient_error: largest |own-gradient − numerical derivative of J_i| / (1 + |derivative|).
        strictly_convex: per player, whether every sampled chord of J_i in its own strategy lies above J_i.
        radially_unbounded: per player, whether J_i grew along every sampled ray of its own strategy; true where the box
            is bounded, as a minimiser exists then.
    """

    gradient_error: float
    strictly_convex: tuple[bool, ...]
    radially_unbounded: tuple[bool, ...]

    @property
    def gradients_agree(self) -> bool:
        """Whether the own-gradients are the derivatives of the costs, to 1e-6."""
        return self.gradient_error <= 1e-6

    @property
    def assumption_3_holds(self) -> bool:
        """Whether every cost was strictly convex and radially unbounded in its own strategy on all samples."""
        return all(self.strictly_convex) and all(self.radially_unbounded)


def check_game(game: Game, *, samples: int = 64, radius: float = 5.0, seed: int = 0) -> GameReport:
    """Compare own-gradients with numerical differentiation; test convexity and growth of each J_i in x_i.

    Sampling can refute an assumption but not prove it. All samples lie in the game's box. For Assumption 4 see
    :func:`~ptne_env.theory.monotonicity_constants`.

    Args:
        game: the game to check.
        samples: number of random joint strategies.
        radius: components are drawn from U(−radius, radius); with two bounds from the whole interval, with one bound
            from an interval of length 2 radius at it.
        seed: of the draws.

    Raises:
        ValueError: when costs or own gradients of many environments cannot be computed, or have another shape.
    """
    if not isinstance(game, Game):
        raise TypeError(f"check_game needs a Game, such as env.world.game, got a {type(game).__name__}")
    generator = np.random.default_rng(seed)
    points = _points(game, radius, generator.uniform(-radius, radius, (game.dimension, samples)))
    estimates = np.repeat(points[:, None], game.num_players, axis=1)
    _require_shape(game.costs, points, "(n, B)", (game.num_players, samples), "(N, B)")
    _require_shape(game.own_gradients, estimates, "(n, N, B)", points.shape, "(n, B)")
    numerical = _gradients(game, points)
    error = float(np.max(np.abs(game.pseudo_gradient(points) - numerical) / (1 + np.abs(numerical))))

    convex, unbounded = [], []
    for player in range(game.num_players):
        block = game.owners == player
        direction = generator.normal(size=(game.action_dims[player], samples))
        direction /= np.linalg.norm(direction, axis=0)
        convex.append(_strictly_convex(game, points, player, block, direction))
        unbounded.append(_radially_unbounded(game, points, player, block, direction))
    return GameReport(error, tuple(convex), tuple(unbounded))


def _require_shape(
    method: Callable[[FloatArray], FloatArray], given: FloatArray, axes: str, expected: tuple[int, ...], wanted: str
) -> None:
    """Check that a method of a game takes many environments at once; ``ValueError`` where it does not."""
    rule = f"{method.__qualname__} maps {axes} = {given.shape} to {wanted} = {expected}, environments B last"
    try:
        found = np.shape(method(given))
    except (TypeError, ValueError, LookupError) as error:
        raise ValueError(f"{rule}; it raised {type(error).__name__}: {error}") from error
    if found != expected:
        raise ValueError(f"{rule}; it returned the shape {found}")


def _points(game: Game, radius: float, drawn: FloatArray) -> FloatArray:
    """Points drawn from [−radius, radius] moved into the game's box."""
    if game.low is None or game.high is None:
        return drawn
    low = np.where(np.isfinite(game.low), game.low, np.where(np.isfinite(game.high), game.high - 2 * radius, -radius))
    high = np.where(np.isfinite(game.high), game.high, low + 2 * radius)
    return low + (high - low) * (drawn + radius) / (2 * radius)


def _gradients(game: Game, points: FloatArray) -> FloatArray:
    """∂J_i/∂x_i at points (n, samples), by numerical differentiation of the costs; same shape."""
    low, high = (np.full((game.dimension, 1), bound) for bound in (-np.inf, np.inf))
    if game.low is not None and game.high is not None:
        low, high = game.low[:, :1], game.high[:, :1]
    # A cost need not be defined outside the box, so derivatives there are taken on the wider side.
    side = np.where(high - points >= points - low, 1, -1)
    components, samples = np.indices(points.shape)

    def costs(values: FloatArray, component: IntArray, sample: IntArray) -> FloatArray:
        component, sample = (np.broadcast_to(index, values.shape).ravel() for index in (component, sample))
        moved, columns = points[:, sample], np.arange(values.size)
        moved[component, columns] = values.ravel()
        return game.costs(moved)[game.owners[component], columns].reshape(values.shape)

    return np.asarray(
        scipy.differentiate.derivative(
            costs,
            points,
            args=(components, samples),
            initial_step=np.minimum(0.5, (high - low) / 8),
            step_direction=np.where(np.isfinite(low) | np.isfinite(high), side, 0),
        ).df
    )


def _cost_on_ray(
    game: Game, points: FloatArray, player: int, block: BoolArray, direction: FloatArray, distance: float
) -> FloatArray:
    moved = points.copy()
    moved[block] = points[block] + distance * direction
    with np.errstate(over="ignore"):  # an exponential cost may overflow to +inf, which is growth
        return game.costs(moved)[player]


def _strictly_convex(game: Game, points: FloatArray, player: int, block: BoolArray, direction: FloatArray) -> bool:
    if game.has_bounds:  # between two points of the box
        direction = (np.roll(points[block], 1, axis=1) - points[block]) / 2
        points = points.copy()
        points[block] += direction
    low, middle, high = (_cost_on_ray(game, points, player, block, direction, step) for step in (-1.0, 0.0, 1.0))
    return bool(np.all(low + high - 2 * middle > 1e-9 * (1 + np.abs(middle))))


def _radially_unbounded(game: Game, points: FloatArray, player: int, block: BoolArray, direction: FloatArray) -> bool:
    grows = True
    for sign in (-1.0, 1.0):
        ray = sign * direction
        if game.low is not None and game.high is not None:  # only in unbounded directions
            ray = np.where(np.where(ray < 0, game.low[block], game.high[block]) * np.sign(ray) == np.inf, ray, 0.0)
            ray = ray / np.maximum(np.linalg.norm(ray, axis=0), 1e-300)
        leaves = np.any(ray != 0, axis=0)
        costs = [_cost_on_ray(game, points, player, block, ray, radius)[leaves] for radius in _RADII]
        grows &= all(bool(np.all(far >= near)) for near, far in pairwise(costs))
        grows &= bool(np.all(costs[-1] > _cost_on_ray(game, points, player, block, ray, 0.0)[leaves]))
    return grows
