"""Scenes for figures: the error of policies against time over a few episodes, and one episode instant by instant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ptne_env.bench.workers import Workers
from ptne_env.evaluation.entries import PolicySpec
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.results import Results
from ptne_env.evaluation.rollout import Member, rollout
from ptne_env.evaluation.tracks import Track
from ptne_env.perception.encoder import make_encoder
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, require_count
from ptne_env.world.dynamics import State
from ptne_env.world.world import World

EPISODES = 20
"""Default number of episodes over which errors are shown."""

MOST_ESTIMATES = 200
"""The estimates of all players are kept where they are up to this many numbers, as ``env.render()`` draws them."""

QUANTILES = (0.1, 0.5, 0.9)
"""Of the error over episodes: the band and the median."""


@dataclass(frozen=True)
class Trace:
    """One policy in one world, at every instant F of the episodes.

    Attributes:
        errors: :data:`QUANTILES` over episodes of the estimate distance, shape (3, F).
        error: the estimate distance of the first episode, shape (F,).
        strategies: x of the first episode, shape (n, F).
        estimates: x^i in column i, shape (n, N, F); ``None`` where n N is above :data:`MOST_ESTIMATES`.
        inputs: the inputs of the strategies, held from each instant; NaN at the last. Shape (n, F).
    """

    errors: FloatArray
    error: FloatArray
    strategies: FloatArray
    estimates: FloatArray | None
    inputs: FloatArray


@dataclass(frozen=True)
class Scene:
    """A world, its first episode, and the trace of every policy there.

    Attributes:
        t: seconds at each instant, shape (F,).
        s: transformed time, shape (F,); it ends at the deadline.
        gain: g(t) in 1/s, shape (F,).
        deadline_frame: index of the instant T.
        owners: the player that owns each component, shape (n,).
        in_plane: whether strategies are positions in the plane, which a map shows.
        equilibrium: x* of the first episode, shape (n,).
        links: pairs of players that are ever neighbours, shape (L, 2).
        live: whether each link is up in the first episode, shape (L, F).
        episodes: number of episodes behind the errors.
        traces: by name of the policy.
    """

    t: FloatArray
    s: FloatArray
    gain: FloatArray
    deadline_frame: int
    owners: IntArray
    in_plane: bool
    equilibrium: FloatArray
    links: IntArray
    live: BoolArray
    episodes: int
    traces: dict[str, Trace]

    @property
    def num_players(self) -> int:
        """N."""
        return int(self.owners[-1]) + 1


def scenes(
    results: Results,
    *,
    episodes: int = EPISODES,
    workers: Workers = Workers(),  # noqa: B008 - immutable
    progress: Callable[[str, int], None] | None = None,
) -> dict[str, Scene]:
    """A scene per track of results, from the first of their episodes; of several training seeds, the first.

    Args:
        results: of a comparison or suite.
        episodes: at most as many as the track had.
        workers: run the episodes.
        progress: called with the name of the track and the number of tracks when a track is done.
    """
    require_count("episodes", episodes, 1)
    tasks = []
    for track in results.tracks:
        chosen = results.episode_sets[track.name]
        few = EpisodeSet(min(episodes, chosen.count), chosen.seed, chosen.split, chosen.track)
        tasks.append((track, few, results.policies_on(track.name)))
    found = {}
    for index, made in workers.run(_track_scene, tasks):
        found[index] = made
        if progress is not None:
            progress(results.tracks[index].name, len(tasks))
    return {track.name: found[index] for index, track in enumerate(results.tracks)}


def _track_scene(track: Track, episodes: EpisodeSet, policies: Mapping[str, PolicySpec]) -> Scene:
    teammates = None if track.teammates is None else track.teammates.join
    return scene(track.world, episodes.initial_state(track.world), policies, teammates)


def scene(
    world: World,
    start: State,
    policies: Mapping[str, PolicySpec],
    teammates: Callable[[World], Member] | None = None,
) -> Scene:
    """The traces of several policies from the same start.

    Args:
        world: the world.
        start: of all episodes.
        policies: by name.
        teammates: makes the teammates of each policy; ``None`` where there are none.

    Raises:
        ValueError: when a policy cannot act in this world.
    """
    clock = world.clock
    links = np.array(world.topology.union.edges, dtype=np.int64).reshape(-1, 2)
    randomness = start.randomness
    modes = world.modes if randomness is None or randomness.modes is None else randomness.modes[:, 0]
    live = np.array([world.topology.graphs[mode].adjacency[links[:, 0], links[:, 1]] > 0 for mode in modes])
    return Scene(
        t=clock.t,
        s=clock.s,
        gain=clock.transformation.gain(clock.t, clock.gain),
        deadline_frame=clock.steps,
        owners=world.game.owners,
        in_plane=world.game.in_plane,
        equilibrium=start.game.nash_equilibria[:, 0],
        links=links,
        live=live.T,
        episodes=start.estimates.shape[-1],
        traces={name: _trace(world, start, policy, teammates) for name, policy in policies.items()},
    )


def _trace(
    world: World, start: State, policy: PolicySpec, teammates: Callable[[World], Member] | None
) -> Trace:
    encoder, owners = make_encoder(world, policy.interface), world.game.owners
    components = np.arange(len(owners))
    estimates: list[FloatArray] = []
    inputs: list[FloatArray] = []

    def watch(state: State, held: FloatArray | None) -> None:
        estimates.append(state.estimates[:, :, 0].copy())
        inputs.append(np.full(len(owners), np.nan) if held is None else held[components, owners, 0])

    team = None if teammates is None else teammates(world)
    played = rollout(policy.build(encoder.layout), encoder, start, team, watch, series=["estimate_distance"])
    distance, kept = played["estimate_distance"], np.stack(estimates, axis=-1)
    return Trace(
        np.quantile(distance, QUANTILES, axis=1),
        distance[:, 0],
        kept[components, owners],
        kept if kept[..., 0].size <= MOST_ESTIMATES else None,
        np.stack(inputs, axis=-1),
    )
