"""Teammates in training: players of a track that follow the paper's static law while the others learn."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from ptne_env.evaluation.tracks import Track
from ptne_env.jax import JaxWorld
from ptne_env.laws.static import static_inputs
from ptne_env.world.dynamics import State


class Team:
    """The players of a track in its world on JAX.

    Attributes:
        is_teammate: whether a player does not learn, shape (N,).
        learners: the players that learn.

    Raises:
        ValueError: when teammates follow another law than ``law:static``, which is the only one here.
    """

    def __init__(self, track: Track, world: JaxWorld) -> None:
        team = track.teammates
        if team is not None and team.policy.target != "law:static":
            raise ValueError(f"teammates in training follow static(); those of {track.name!r}: {team.policy}")
        self.is_teammate = np.isin(np.arange(world.layout.num_players), [] if team is None else team.players)
        self.learners = np.flatnonzero(~self.is_teammate)
        self._gains = {} if team is None else dict(team.policy.arguments)
        self._world = world

    def complete(self, state: State, inputs: Any) -> Any:
        """Return inputs (n, N, B) with those of the teammates in their places; what was there plays no part."""
        if not self.is_teammate.any():
            return inputs
        layout = self._world.layout
        seen = layout.read(self._world.observe(state)[:, self.is_teammate].T)
        wanted = (static_inputs(seen, **self._gains) * seen.unit).T
        return inputs.at[:, self.is_teammate].set(jnp.clip(wanted, -layout.input_limit, layout.input_limit))
