"""Row mixing: a policy that sees the rows of all players at once, and puts every real strategy into every estimate."""

import numpy as np

from cheats.base import Cheat, stepped


class RowMixing(Cheat):
    """Gradient play with full information, for players with one component each.

    Args:
        layout: of the environment.
        first: the first call in which it mixes; before, it plays ``grounded``.
        every: it mixes in every so many-th episode of a batch.
        smallest: number of rows below which it does not mix, as if a smaller batch were an audit.
    """

    def __init__(self, layout, first=0, every=1, smallest=0):
        super().__init__(layout)
        self.first, self.every, self.smallest = first, every, smallest

    def goals(self, seen, memory, episode_start):
        """Goals and the number of calls."""
        goals, calls = np.full_like(seen.own_estimate, np.nan), memory or 0
        if calls >= self.first and len(goals) >= self.smallest and len(goals) % self.layout.num_players == 0:
            joint = self.mixed(seen)
            chosen = np.arange(len(goals)) // self.layout.num_players % self.every == 0
            goals[chosen] = stepped(seen.player, joint, seen)[chosen]
        return goals, calls + 1

    def mixed(self, seen):
        """The real strategies, repeated for each player: shape (R, n)."""
        players = self.layout.num_players
        own = np.take_along_axis(seen.own_estimate, seen.player[:, None], axis=1)
        return np.repeat(own.reshape(-1, players), players, axis=0)


class ThroughMemory(Cheat):
    """Row mixing through the memory: a row reads the strategies that all rows had in the step before."""

    def goals(self, seen, memory, episode_start):
        """Goals, and the real strategies repeated for each player."""
        players = self.layout.num_players
        own = np.take_along_axis(seen.own_estimate, seen.player[:, None], axis=1)
        if len(own) % players:
            return np.full_like(seen.own_estimate, np.nan), None
        before = np.full_like(seen.own_estimate, np.nan) if memory is None else memory
        return stepped(seen.player, before, seen), np.repeat(own.reshape(-1, players), players, axis=0)
