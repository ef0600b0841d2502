"""Policies that declare the knowledge of own links and use the links of other players."""

from __future__ import annotations

import numpy as np

from ptne_env import laws
from ptne_env.perception.observation import LayoutError


class CountsLinks(laws.Grounded):
    """A gain that depends on the number of all links."""

    def __init__(self, layout):
        rows = np.array(layout.neighbours)
        super().__init__(layout, kappa=float((rows != np.arange(len(rows))[:, None]).sum()) / len(rows))


class NeedsLinks(laws.Grounded):
    """A policy that refuses to act where another player has no links."""

    def __init__(self, layout):
        super().__init__(layout)
        if any(set(row) == {player} for player, row in enumerate(layout.neighbours)):
            raise LayoutError("a player has no neighbours")
