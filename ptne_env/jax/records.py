"""The records of the library as pytrees: states, draws of episodes, and games; and the draws of games."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ptne_env.games import Game, RandomEnergy
from ptne_env.shared import counter_random
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world.dynamics import State
from ptne_env.world.world import World

_EQUILIBRIA = ("nash_equilibria", "equilibrium_scale")
"""The cached properties of a game that are leaves: numpy computes them, once per game."""

_FIELDS = tuple(name for name in State._fields if name != "any_diverged")


class Games:
    """The games of a world as pytrees, and their draws.

    Where episodes draw games, the leaves of a game are its arrays with one column per episode; all else, such as a box,
    is a constant of the world. A game that all episodes play has no leaves.

    Args:
        world: that draws the games.
        pool: number of games from which episodes draw, where numpy alone can draw them.

    Attributes:
        leaves: names of the arrays; none where all episodes play one game.
    """

    def __init__(self, world: World, pool: int) -> None:
        self._world, self._family = world, world.game_family
        self.leaves: tuple[str, ...] = ()
        _register(type(world.game))
        if world.has_random_game:
            few, many = self._draw(2), self._draw(3)
            computed = {name for name in dir(type(many)) if isinstance(getattr(type(many), name), cached_property)}
            own = {name: value for name, value in vars(many).items() if name not in computed}
            self.leaves = *(name for name in own if _grew(vars(few)[name], own[name])), *_EQUILIBRIA
            self._constants = {name: value for name, value in own.items() if name not in self.leaves}
            is_drawn_here = type(self._family) is RandomEnergy  # a subclass may draw others
            self._pool = None if is_drawn_here else self.converted(self._draw(pool))

    def converted(self, game: Game) -> Game:
        """A game of numpy's, of this world, with arrays of JAX."""
        return self.made({name: jnp.asarray(getattr(game, name)) for name in self.leaves}) if self.leaves else game

    def draw(self, keys: jax.Array) -> Game:
        """The games of episodes with some keys, (B,): new ones of a :class:`RandomEnergy`, else games of the pool."""
        if not self.leaves:
            return self._world.game
        if self._pool is not None or not isinstance(self._family, RandomEnergy):
            return columns(self._pool, keys)
        game = self.made(self._family.parameters(uniforms(keys, 2 * self._family.players + 1)))
        vars(game)["nash_equilibria"] = game._solve_nash_equilibria()  # noqa: SLF001 - without numpy's check
        vars(game)["equilibrium_scale"] = game.equilibrium_scale
        return game

    def _draw(self, count: int) -> Game:
        return self._world.draw_game([RandomStreams.from_seed(seed) for seed in range(count)])

    def made(self, leaves: Mapping[str, Any]) -> Game:
        """The games of some leaves, by name."""
        game: Game = object.__new__(type(self._world.game))
        vars(game).update(self._constants, _games=self, **leaves)
        return game


def uniforms(keys: jax.Array, count: int) -> jax.Array:
    """Independent U(0, 1) of episodes with some keys: (B,) to (count, B)."""
    return counter_random.uniforms(keys, np.arange(count, dtype=np.uint64)[:, None])


def columns(tables: Any, keys: jax.Array) -> Any:
    """Columns of arrays (..., P), chosen at random, one per key and the same of all arrays; (..., B)."""
    size = jax.tree.leaves(tables)[0].shape[-1]
    chosen = (uniforms(keys, 1)[0] * size).astype(np.int64)
    return jax.tree.map(lambda table: table[..., chosen], tables)


def _grew(few: Any, many: Any) -> bool:
    """Whether an array has one column per game, of two and of three games."""
    return isinstance(many, np.ndarray) and many.shape[-1:] == (3,) and few.shape[-1:] == (2,)


def _flat(game: Game) -> tuple[tuple[Any, ...], Any]:
    games: Games | None = vars(game).get("_games")
    return ((), game) if games is None else (tuple(vars(game)[name] for name in games.leaves), games)


def _whole(kept: Games | Game, leaves: Iterable[Any]) -> Game:
    return kept.made(dict(zip(kept.leaves, leaves, strict=True))) if isinstance(kept, Games) else kept


def _register(kind: type[Game]) -> None:
    """Make a class of games a pytree, once."""
    if "_is_pytree" not in vars(kind):
        kind._is_pytree = True  # type: ignore[attr-defined]  # noqa: SLF001
        jax.tree_util.register_pytree_node(kind, _flat, _whole)


jax.tree_util.register_pytree_node(
    State,
    lambda state: (tuple(getattr(state, name) for name in _FIELDS), None),
    lambda _, leaves: State(**dict(zip(_FIELDS, leaves, strict=True)), any_diverged=True),
)
