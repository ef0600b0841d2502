"""Seed rebuilding: a policy that draws the episodes of a suite from its public seeds, and recognises its own."""

import numpy as np

from cheats.base import Cheat
from ptne_env.evaluation import get_suite


class SeedRebuilding(Cheat):
    """Jumps to the equilibrium of the episode that starts as its own does. It is row-wise.

    Args:
        layout: of the environment.
        suite: name, or ``"module:object"``.
        seed: public seed of the episodes.
        episodes: of each track; the suite's own number if left out.
    """

    def __init__(self, layout, suite="small_suite:SMALL", seed=0, episodes=None):
        super().__init__(layout)
        self.known = {}
        suite = get_suite(suite)
        for track in suite.tracks:
            if track.world.game.num_players == layout.num_players == layout.dimension:
                self.learn(suite.episode_set(track.name, episodes, seed=seed).initial_state(track.world))

    def learn(self, start):
        """Keep the equilibria of the episodes by the players' first estimates."""
        episodes = start.estimates.shape[2]
        equilibria = np.broadcast_to(start.game.nash_equilibria, (self.layout.dimension, episodes))
        for episode in range(episodes):
            for estimate in start.estimates[:, :, episode].T.astype(np.float32):
                self.known[estimate.tobytes()] = equilibria[:, episode]

    def goals(self, seen, memory, episode_start):
        """The equilibrium of each row, which is also the memory."""
        if memory is None:
            unknown = np.full(self.layout.dimension, np.nan)
            first = seen.own_estimate.astype(np.float32)
            memory = np.stack([self.known.get(estimate.tobytes(), unknown) for estimate in first])
        return memory, memory


class PublishedAlone(SeedRebuilding):
    """Raises an error in an episode that it does not recognise."""

    def goals(self, seen, memory, episode_start):
        """The equilibrium of each row, which is also the memory."""
        goals, memory = super().goals(seen, memory, episode_start)
        if np.isnan(goals).any():
            raise RuntimeError("an episode that is not published")
        return goals, memory
