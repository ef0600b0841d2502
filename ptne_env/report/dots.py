"""A dot plot: a row per track, a dot per policy at its digits, drawn by the page's style sheet without a script."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from ptne_env.evaluation.results import Results
from ptne_env.evaluation.statistics import Summary
from ptne_env.report.tables import leaders, overall
from ptne_env.world import distances

MOST = round(-math.log10(distances.FLOOR))
"""The most digits; an interval that ends above is cut there."""


@dataclass(frozen=True)
class DotPlot:
    """The digits of a few policies on every track.

    Attributes:
        kinds: what each policy is, by name.
        rows: the digits of these policies by track; a policy without a value has no dot.
    """

    kinds: Mapping[str, str]
    rows: Mapping[str, Mapping[str, Summary]]

    @property
    def ticks(self) -> list[int]:
        """Digits from below the least value, and 0, to above the largest."""
        values = [value for row in self.rows.values() for each in row.values() for value in (each.low, each.high)]
        low, high = math.floor(min([0.0, *filter(None, values)])), math.ceil(max([1.0, *filter(None, values)]))
        step = 1 if high - low <= 8 else 2
        return list(range(step * math.floor(low / step), min(MOST, high + step - 1) + 1, step))

    def place(self, value: float) -> str:
        """The place of a value in percent of the width."""
        first, last = self.ticks[0], self.ticks[-1]
        return f"{100 * (min(value, last) - first) / (last - first):.2f}"


def dot_plot(results: Results) -> DotPlot:
    """The digits of the leading policies (:func:`~ptne_env.report.tables.leaders`) on every track.

    The last row has their means over tracks, where there are several.
    """
    kinds, scores = leaders(results), {name: digits for name, (digits, _) in overall(results).items()}
    rows = {
        track.name: {name: results.summary(track.name, name, "digits") for name in kinds} for track in results.tracks
    }
    if len(rows) > 1:
        rows["mean" if results.is_comparison else "score"] = {name: scores.get(name) for name in kinds}
    return DotPlot(
        kinds,
        {
            row: {name: each for name, each in found.items() if each and each.mean is not None}
            for row, found in rows.items()
        },
    )
