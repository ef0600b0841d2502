"""Saturation of suites: the ceilings of tracks, and the tracks that cannot tell good policies from better."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy

from ptne_env.evaluation.leaderboard import ROOM, Leaderboard, Scale
from ptne_env.evaluation.suite import LEADERBOARD_SEED, MOST_DIGITS, Suite
from ptne_env.theory import ceilings


def ceiling_of(
    suite: Suite, track: str, episodes: int | None = None, *, seed: int = LEADERBOARD_SEED
) -> tuple[float, str]:
    """The mean digits that no policy passes on a track, and the reason (:mod:`ptne_env.theory.ceilings`).

    Args:
        suite: of the track.
        track: its name.
        episodes: in place of the suite's number.
        seed: of the episode set.

    Returns:
        The lowest of all bounds, at most 12, and its name; ``"floor"`` where only the floor of distances bounds digits.
        On a track that scores tracking, the floor is the only bound.

    Raises:
        ValueError: for an unknown track.
    """
    found = suite.track(track)
    if found.metric == "tracking_digits":
        return MOST_DIGITS, "floor"
    world, team = found.world, found.teammates
    state = suite.episode_set(track, episodes, seed=seed).initial_state(world)
    instant = world.clock.total_steps if found.metric == "digits_after_hold" else world.clock.steps
    gains = {} if team is None else dict(team.policy.arguments)
    is_static = team is not None and team.policy.target == "ptne_env.laws:Static"
    bounds = ceilings.ceiling(
        world,
        state,
        instant,
        teammates=team.players if team is not None and is_static else (),
        kappa=float(gains.get("kappa", 2.0)),
    )
    means = {name: float(np.minimum(digits, MOST_DIGITS).mean()) for name, digits in bounds.items()}
    means["floor"] = MOST_DIGITS
    reason = min(means, key=means.__getitem__)
    return means[reason], reason


def closed_tracks(scales: Iterable[Scale]) -> dict[str, str]:
    """The tracks that leave less than ``ROOM`` digits above or below the best known honest entry: name and reason."""
    faults = {}
    for scale in scales:
        known = scale.highest - scale.room
        if scale.room < ROOM:
            faults[scale.track] = f"{scale.room:.2f} digits are left above the best known honest entry"
        elif known - scale.zero < ROOM:
            faults[scale.track] = f"the best known honest entry gains {known - scale.zero:.2f} digits"
    return faults


def agreement(first: Leaderboard, second: Leaderboard) -> float:
    """Kendall's τ between the overall rankings of the entries, oracles apart, of two runs of the same policies."""
    scores = [
        {row.policy: row.score.mean for row in board.overall if row.mean_rank is not None} for board in (first, second)
    ]
    return float(scipy.stats.kendalltau(list(scores[0].values()), [scores[1][name] for name in scores[0]]).statistic)
