"""States and games as pytrees, and the draws of games."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ptne_env.games import Game, RandomEnergy
from ptne_env.shared import counter_random
from ptne_env.shared.parts import as_tuples
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world.dynamics import State
from ptne_env.world.world import World

_STATE_LEAVES = tuple(name for name in State._fields if name != "any_diverged")


def register_game(kind: type[Game]) -> None:
    """Make a class of games a pytree, once: the leaves of a batch are its parameters and its equilibria.

    A single game, which all episodes play, has no leaves: its numbers are constants of compiled functions.
    """
    leaves = (*kind.parameters, "nash_equilibria", "equilibrium_scale")  # numpy computes these two, once per game
    constants = [field.name for field in fields(kind) if field.name not in leaves]

    def flatten(game: Game) -> tuple[list[Any], Any]:
        if not game.is_batch:
            return [], game
        return [getattr(game, name) for name in leaves], as_tuples([getattr(game, name) for name in constants])

    def unflatten(kept: Any, values: Any) -> Game:
        if isinstance(kept, Game):
            return kept
        game = object.__new__(kind)
        vars(game).update(zip((*constants, *leaves), (*kept, *values), strict=True), is_batch=True)
        return game

    if "_is_pytree" not in vars(kind):
        kind._is_pytree = True  # type: ignore[attr-defined]  # noqa: SLF001
        jax.tree_util.register_pytree_node(kind, flatten, unflatten)


def game_sampler(world: World, streams: Sequence[RandomStreams]) -> Callable[[jax.Array], Game]:
    """Return the function that draws the games of episodes, one per key (B,).

    Where numpy alone can draw them, episodes draw from the games of a pool of streams.
    """
    game, family = world.game, world.game_family
    register_game(type(game))
    if isinstance(family, Game):
        return lambda _: game
    if type(family) is RandomEnergy:  # a subclass may draw others

        def sample(keys: jax.Array) -> Game:
            games = game.with_columns(family.columns(uniforms(keys, 2 * family.players + 1)))
            vars(games)["nash_equilibria"] = games._solve_nash_equilibria()  # noqa: SLF001 - without numpy's check
            return games

        return sample
    table = jax.tree.map(jnp.asarray, world.draw_game(streams))
    return lambda keys: columns(table, keys)


def uniforms(keys: jax.Array, count: int) -> jax.Array:
    """Draw independent U(0, 1) of episodes by their keys, (B,) to (count, B)."""
    return counter_random.uniforms(keys, np.arange(count, dtype=np.uint64)[:, None])


def columns(tables: Any, keys: jax.Array) -> Any:
    """Choose columns of arrays (..., P) at random, one per key and the same of all arrays; (..., B)."""
    size = jax.tree.leaves(tables)[0].shape[-1]
    column = (uniforms(keys, 1)[0] * size).astype(np.int64)
    return jax.tree.map(lambda table: table[..., column], tables)


jax.tree_util.register_pytree_node(
    State,
    lambda state: (tuple(getattr(state, name) for name in _STATE_LEAVES), None),
    lambda _, leaves: State(**dict(zip(_STATE_LEAVES, leaves, strict=True)), any_diverged=True),
)
