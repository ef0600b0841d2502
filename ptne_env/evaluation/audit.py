"""The audit of decisions, which must follow from a row of a batch and its own memory alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ptne_env.perception.observation import ObservationLayout
from ptne_env.perception.policy import Policy, PolicyError, RunningPolicy
from ptne_env.shared.arrays import Float32Array, IntArray

NOT_ROW_WISE = (
    "its decisions are not row-wise: with other rows in the batch it decides differently. A decision may depend on the "
    "player's own observation and memory alone, and must repeat bit for bit, except for rounding that depends on the "
    "number of rows"
)
"""The reason of a failure where the witness received other rows and decided differently."""

DOES_NOT_REPEAT = (
    "it does not repeat: a second one that is built afresh decides differently at the same observations. Switch a "
    "network to evaluation (.eval()), take random numbers from a generator that the policy seeds itself, and keep "
    "memory in the state that predict returns"
)
"""The reason where the witness received the same batch."""

USES_OTHER_LINKS = (
    "it uses links of other players: with the neighbours of one player alone it decides differently for that player. "
    "A decision may depend on the player's own row of layout.neighbours alone"
)
"""The reason where the witness was built from the knowledge of one player, and the other witnesses agreed."""

OWN_LINKS_EPISODES = 16
"""The most episodes of a witness that was built from the knowledge of one player."""


class AuditError(PolicyError):
    """A witness decided differently."""


class Witness:
    """A second policy that receives a sample of the rows, and must make the same decisions bit for bit.

    It runs in lockstep with the policy that is measured, and gets no row of a teammate. So decisions that depend on
    the observations of other players, or on anything else that the rows of a batch share, differ.

    Args:
        policy: a fresh policy.
        rows: indices of the rows of the batch that it receives, in its own order.
        reason: the reason of the failure when a decision differs.
        fills: whether it receives a batch of full size, with the rows in their places and copies of them in all others.
            Libraries of linear algebra round a row otherwise in a batch of another size, and in another place.
    """

    def __init__(self, policy: Policy, rows: IntArray, reason: str = NOT_ROW_WISE, *, fills: bool = False) -> None:
        self._policy, self._rows, self._reason, self._fills = RunningPolicy(policy), rows, reason, fills

    def compare(self, observations: Float32Array, actions: npt.NDArray[Any]) -> None:
        """Raise ``AuditError`` where a decision differs from ``actions``, those of the policy that is measured."""
        shown = rows = self._rows
        places: Any = slice(None)
        if self._fills:
            shown, places = np.resize(rows, len(observations)), rows
            shown[rows] = rows
        again = self._policy.decide(observations[shown])
        if not np.array_equal(np.asarray(again)[places], actions[rows]):
            raise AuditError(self._reason)


def sample_rows(episodes: int, players: int) -> IntArray:
    """Draw the rows of a witness, which no policy can know: one player of every episode, and all of them equally often.

    Row e · players + p is player p of episode e, and players are those for which the policy decides.
    """
    generator = np.random.default_rng()
    shuffled, order = generator.permutation(episodes), generator.permutation(players)
    return shuffled * players + order[np.arange(episodes) % players]


def rows_of_one(episodes: int, players: int) -> tuple[int, IntArray]:
    """Draw one of ``players`` for which the policy decides; return its place among them, and some of its rows."""
    generator = np.random.default_rng()
    place = int(generator.integers(players))
    return place, generator.permutation(episodes)[:OWN_LINKS_EPISODES] * players + place


def with_links_of(layout: ObservationLayout, player: int) -> ObservationLayout:
    """Return a layout that knows the neighbours of one player alone; the slots of all others are padded."""
    rows = tuple(row if index == player else (index,) * layout.slots for index, row in enumerate(layout.neighbours))
    return replace(layout, neighbours=rows)
