"""Patching: a policy that replaces a function of the library, so that all policies get twelve digits."""

import numpy as np

from cheats.base import Cheat
from ptne_env.world import distances


def patch():
    """Every distance of the process is 0 from now on."""
    distances.player_distances = lambda estimates, game: np.zeros(estimates.shape[1:])


class Patching(Cheat):
    """Patches when it is built."""

    def __init__(self, layout):
        super().__init__(layout)
        patch()

    def goals(self, seen, memory, episode_start):
        """No goals and no memory."""
        return np.full_like(seen.own_estimate, np.nan), None
