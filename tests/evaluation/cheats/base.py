"""The common part of the cheats: a policy that moves estimates to goals, and follows an honest law without goals."""

from abc import ABC, abstractmethod

import numpy as np

from ptne_env.laws import Grounded
from ptne_env.laws.base import per_step

STEP = 0.3
"""Of a gradient step x − STEP · F(x), which converges for all random energy games."""


class Cheat(ABC):
    """Goals of all estimates where the cheat knows them, and the law ``grounded`` elsewhere.

    Args:
        layout: of the kind ``physical``.
    """

    def __init__(self, layout):
        self.layout = layout
        self.law = Grounded(layout)

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        """Actions for observations (R, size), and the memory of :meth:`goals`."""
        seen = self.layout.read(observation)
        goals, memory = self.goals(seen, state, episode_start)
        honest, _ = self.law.inputs(seen, None)
        moves = per_step(goals - seen.own_estimate, seen)
        return self.layout.write(np.where(np.isnan(goals), honest, moves), seen), memory

    @abstractmethod
    def goals(self, seen, memory, episode_start):
        """Goals of the estimates, shape (R, n), NaN where there are none, and the memory for the next step."""


def repeated(equilibria, rows):
    """Equilibria (n, B) as goals (R, n) of rows that stand together by episode."""
    return np.repeat(equilibria.T, rows // equilibria.shape[1], axis=0)


def stepped(own, joint, seen):
    """Joint strategies (R, n) as goals, the component ``own`` (R,) of each row after a gradient step."""
    goals, rows = joint.copy(), np.arange(len(joint))
    goals[rows, own] = seen.own_estimate[rows, own] - STEP * seen.gradient[rows, own]
    return goals
