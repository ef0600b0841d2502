"""The audit of decisions: each row of a batch is decided from that row and its own memory alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ptne_env.arrays import Float32Array, IntArray
from ptne_env.policy import Policy, PolicyError

EPISODES = 16
"""Most episodes from which a witness gets rows, unless the audit is thorough."""

WITNESSES = 8
"""Most witnesses of a thorough audit."""


class Witness:
    """A second, fresh policy that receives a sample of the rows and must decide the same, bit for bit.

    It runs in lockstep with the policy that is measured, and gets no row of a teammate. So decisions that depend on
    the observations of other players, or on anything else that the rows of a batch share, differ.

    Args:
        policy: a fresh policy; of foreign code, in a fresh process.
        rows: indices of the rows of the batch that it receives, in its own order.
        player: to which all rows belong, if ``policy`` was built from what this player knows alone.
    """

    def __init__(self, policy: Policy, rows: IntArray, player: int | None = None) -> None:
        self._policy, self._rows, self._player = policy, rows, player
        self._memory: Any = None
        self._starts = np.ones(len(rows), dtype=np.bool_)

    def compare(self, observations: Float32Array, actions: npt.NDArray[Any]) -> None:
        """Let the witness decide, and compare.

        Args:
            observations: of the whole batch, shape (R, size).
            actions: of the policy that is measured, shape (R, action size).

        Raises:
            PolicyError: when a decision differs.
        """
        again, self._memory = self._policy.predict(
            observations[self._rows], self._memory, self._starts, deterministic=True
        )
        self._starts = np.zeros_like(self._starts)
        if not np.array_equal(np.asarray(again), actions[self._rows]):
            raise PolicyError(
                "its decisions are not row-wise: with other rows in the batch it decides differently. A decision may "
                "depend on the player's own observation and memory alone, and must repeat bit for bit"
                if self._player is None
                else f"its decisions for player {self._player} are not row-wise, or use links of other players: with "
                "the rows and the neighbours of this player alone it decides differently. A decision may depend on "
                "the player's own observation, memory and row of layout.neighbours alone, and must repeat bit for "
                "bit; a policy that uses other links declares graph_knowledge='union'"
            )


def sample_rows(episodes: int, players: int, *, thorough: bool, by_player: bool = False) -> list[IntArray]:
    """The rows of each witness, chosen afresh: no policy can know them.

    Args:
        episodes: of the batch, whose row e · players + p is player p of episode e.
        players: number of players for which the policy decides.
        thorough: whether there are as many witnesses as players, up to :data:`WITNESSES`, which get different players
            of every episode, and not one witness with a random player of each of some episodes.
        by_player: whether all rows of a witness belong to the same player.
    """
    generator = np.random.default_rng()
    chosen = generator.permutation(episodes)
    if not thorough:
        chosen = chosen[:EPISODES]
        return [chosen * players + generator.integers(players, size=1 if by_player else len(chosen))]
    order = generator.permutation(players)  # consecutive episodes go on where the one before ends
    first = np.arange(episodes) * (0 if by_player else min(players, WITNESSES))
    return [chosen * players + order[(first + witness) % players] for witness in range(min(players, WITNESSES))]
