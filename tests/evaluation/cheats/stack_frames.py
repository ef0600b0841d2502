"""Stack frames: policies that find the state of the world in the process, and read the equilibrium from its game."""

import gc
import sys

import numpy as np

from cheats.base import Cheat, repeated
from ptne_env.world.dynamics import State


def state_in_frames():
    """The first state in the local variables of the callers; ``None`` without one."""
    frame = sys._getframe(1)
    while frame is not None:
        for value in frame.f_locals.values():
            if isinstance(value, State):
                return value
        frame = frame.f_back
    return None


def state_in_memory(rows):
    """A state of which the rows can be, among all objects of the process; ``None`` without one."""
    states = [found for found in gc.get_objects() if isinstance(found, State)]
    return next((state for state in reversed(states) if rows % state.estimates.shape[2] == 0), None)


class StackFrames(Cheat):
    """Jumps to the equilibrium that it reads from the callers' variables."""

    def find(self, rows):
        """The state."""
        return state_in_frames()

    def goals(self, seen, memory, episode_start):
        """The equilibrium; no memory."""
        state = self.find(len(seen.player))
        if state is None:
            return np.full_like(seen.own_estimate, np.nan), None
        return repeated(state.game.nash_equilibria, len(seen.player)), None


class Objects(StackFrames):
    """Jumps to the equilibrium that it reads from the objects that Python keeps for its garbage collector."""

    def find(self, rows):
        """The state."""
        return state_in_memory(rows)
