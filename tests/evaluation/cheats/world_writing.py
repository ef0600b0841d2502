"""World writing: a policy that finds the state of the world in the process, and writes the equilibrium into it."""

import numpy as np

from cheats.base import Cheat
from cheats.stack_frames import state_in_frames


class WorldWriting(Cheat):
    """Sets the estimates of the state to the equilibrium, and asks for no movement."""

    def goals(self, seen, memory, episode_start):
        """Goals where it found the state; no memory."""
        state = state_in_frames()
        if state is None:
            return np.full_like(seen.own_estimate, np.nan), None
        state.estimates.flags.writeable = True
        state.estimates[...] = state.game.nash_equilibria[:, None]
        return seen.own_estimate, None
