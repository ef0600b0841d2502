"""Scenes: what a page shows of the episodes of a few policies in one world, instant by instant."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Iterable
from dataclasses import dataclass
from gzip import compress
from typing import Any

import numpy as np

from ptne_env.envs.rendering import MOST_ESTIMATES
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.policy_spec import PolicySpec
from ptne_env.evaluation.tracks import Track
from ptne_env.evaluation.trajectories import QUANTILES, play
from ptne_env.shared.arrays import FloatArray


@dataclass(frozen=True)
class Scene:
    """The first episode of policies in a world, and their errors in all episodes.

    Attributes:
        policies: the names of the policies.
        episodes: the number of episodes behind the errors.
        packed: the numbers for charts and the player as JSON, gzip and base64, which the browser unpacks when it shows
            them.
    """

    policies: tuple[str, ...]
    episodes: int
    packed: str


def make_scene(track: Track, episodes: EpisodeSet, policies: Iterable[PolicySpec]) -> Scene:
    """Run policies, each with its first training seed, from the same starts; ``ValueError`` for one that cannot act.

    Numbers that do not exist are ``null``. The others are as exact as a picture shows them, because the digits of noise
    would be most of the page: two significant digits of errors, and strategies and estimates in steps of a hundredth of
    their range at the start, or finer.
    """
    runs = {spec.name: play(track, spec, episodes, kept=1) for spec in policies}
    world, start = track.world, episodes.initial_state(track.world)
    clock, equilibrium = world.clock, start.game.nash_equilibria[:, 0]
    starts = np.concatenate([equilibrium, *(run.strategies[0, :, 0] for run in runs.values())])
    decimals = 2 - int(np.floor(np.log10(np.ptp(starts) or 1.0)))
    union = world.topology.union
    links, hears = np.array(union.edges, dtype=np.int64).reshape(-1, 2), union.adjacency > 0
    randomness = start.randomness
    modes = world.modes if randomness is None or randomness.modes is None else randomness.modes[:, 0]
    both_ways = [graph.adjacency + graph.adjacency.T for graph in world.topology.graphs]
    live = [both_ways[int(mode)][links[:, 0], links[:, 1]] > 0 for mode in modes]
    switches = [0, *(1 + np.flatnonzero((np.diff(live, axis=0)).any(axis=1)))]
    content = {
        "t": clock.t.round(6).tolist(),
        "s": clock.s.round(6).tolist(),
        "gain": _round_digits(clock.transformation.gain(clock.t, clock.gain), 3),
        "deadline": clock.steps,
        "players": world.game.num_players,
        "owners": world.game.owners.tolist(),
        "equilibrium": equilibrium.round(6).tolist(),
        # From a sender to a receiver, and whether that is the only way.
        "links": [[*((j, i) if hears[i, j] else (i, j)), int(hears[i, j] != hears[j, i])] for i, j in links.tolist()],
        "live": [[int(frame), np.flatnonzero(live[frame]).tolist()] for frame in switches],
        "traces": {},
    }
    for name, run in runs.items():
        errors = np.quantile(run.errors, QUANTILES, axis=1)
        inputs = run.inputs[:, world.game.owners, np.arange(len(equilibrium)), 0].T
        estimates = run.estimates[..., 0].T
        content["traces"][name] = {
            "error": _round_digits(run.errors[:, 0], 2),
            "errors": _round_digits(errors if episodes.count > 1 else errors[1:2], 2),
            "strategies": _round_decimals(run.strategies[..., 0].T, decimals),
            "estimates": _round_decimals(estimates, decimals) if estimates[..., 0].size <= MOST_ESTIMATES else [],
            "inputs": _round_decimals(inputs, 2),
        }
    text = json.dumps(content, ensure_ascii=False, separators=(",", ":"))
    packed = b64encode(compress(text.encode(), mtime=0)).decode("ascii")
    return Scene(tuple(runs), episodes.count, packed)


def _round_decimals(values: FloatArray, decimals: int) -> Any:
    """Return numbers with so many decimals as nested lists."""
    return _round_digits(values.round(decimals) + 0.0, 9)  # no -0.0


def _round_digits(values: FloatArray, digits: int) -> Any:
    """Return numbers with so many significant digits as nested lists."""
    if values.ndim > 1:
        return [_round_digits(row, digits) for row in values]
    return [float(f"{value:.{digits}g}") if np.isfinite(value) else None for value in values]
