"""Traces for figures: the error against time over a few episodes, and one episode instant by instant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.policy_specs import PolicySpec
from ptne_env.evaluation.results import Results
from ptne_env.evaluation.rollout import Member, rollout
from ptne_env.evaluation.suite import Track
from ptne_env.evaluation.workers import Workers
from ptne_env.perception.encoder import make_encoder
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray, require_count
from ptne_env.world import dynamics
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
        inputs: the inputs of the strategies, own block by own block, held from each instant; NaN at the last. (n, F).
        consensus_gains: factor of Σ_j a_ij (x^j − x^i) in the inputs of the others' blocks of x^i, by least
            squares; NaN where a player receives nothing that differs from its own estimate. Shape (N, F).
    """

    errors: FloatArray
    error: FloatArray
    strategies: FloatArray
    estimates: FloatArray | None
    inputs: FloatArray
    consensus_gains: FloatArray


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
        equilibrium: x* of the first episode at each instant, shape (n, F).
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
    """A scene per track of results, from the first of their episodes; of a learned policy, its first training seed.

    Args:
        results: of a comparison or another suite.
        episodes: at most as many as the track had.
        workers: run the episodes.
        progress: called with the name of the track and the number of tracks when a track is done.
    """
    require_count("episodes", episodes, 1)
    names = list(results.episodes)
    tasks = [_task(results, track, episodes) for track in results.tracks]

    def report(index: int, _: Scene) -> None:
        if progress is not None:
            progress(names[index], len(names))

    return dict(zip(names, workers.gather(_track_scene, tasks, report), strict=True))


def _task(results: Results, track: Track, episodes: int) -> tuple[Track, EpisodeSet, dict[str, PolicySpec]]:
    count = min(episodes, results.episodes[track.name])
    chosen = results.suite.episode_set(track.name, count, seed=results.seed, split=results.split)
    return track, chosen, results.policies_on(track.name)


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
    traces: dict[str, Trace] = {}
    equilibria = [start.game.nash_equilibria[:, 0]] * clock.t.size
    for name, policy in policies.items():
        twins = (other for other in traces if _acts_as(policies[other], policy))
        if (twin := next(twins, None)) is not None:
            traces[name] = traces[twin]
            continue
        encoder = make_encoder(world, policy.interface)
        watch = _Watch(world)
        team = None if teammates is None else teammates(world)
        with policy.deciding(encoder.layout) as deciding:
            distance = rollout(deciding, encoder, start, team, watch, series=["estimate_distance"])["estimate_distance"]
        errors = np.quantile(distance, QUANTILES, axis=1)
        traces[name] = Trace(errors, distance[:, 0], *watch.arrays())
        equilibria = watch.equilibria
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
        equilibrium=np.stack(equilibria, axis=-1),
        links=links,
        live=live.T,
        episodes=dynamics.batch_size(start),
        traces=traces,
    )


def _acts_as(other: PolicySpec, policy: PolicySpec) -> bool:
    return (other.policy, other.interface) == (policy.policy, policy.interface)


class _Watch:
    """Keeps the first episode of a rollout.

    Attributes:
        equilibria: x* at each instant, shape (n,) each.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._owners = world.game.owners
        self.equilibria: list[FloatArray] = []
        self._strategies: list[FloatArray] = []
        self._estimates: list[FloatArray] = []
        self._inputs: list[FloatArray] = []
        self._gains: list[FloatArray] = []

    def __call__(self, state: State, inputs: FloatArray | None) -> None:
        self.equilibria.append(state.game.nash_equilibria[:, 0])
        estimates = state.estimates[:, :, 0]
        components, players = np.arange(len(self._owners)), np.arange(estimates.shape[1])
        self._strategies.append(estimates[components, self._owners])
        if estimates.size <= MOST_ESTIMATES:
            self._estimates.append(estimates.copy())
        if inputs is None:
            self._inputs.append(np.full(len(components), np.nan))
            self._gains.append(np.full(len(players), np.nan))
            return
        first = inputs[:, :, 0]
        self._inputs.append(first[components, self._owners])
        weights = dynamics.weights(self._world, state)[:, None, :, 0]
        received = (weights * dynamics.relative_estimates(self._world, state)[..., 0]).sum(axis=0)
        received[components, self._owners] = 0  # the gradient acts in the own block
        squares = (received**2).sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            self._gains.append(np.where(squares > 0, (received * first).sum(axis=0) / squares, np.nan))

    def arrays(self) -> tuple[FloatArray, FloatArray | None, FloatArray, FloatArray]:
        """Strategies, estimates, inputs and gains, instants last."""
        estimates = np.stack(self._estimates, axis=-1) if self._estimates else None
        strategies, inputs, gains = (np.stack(kept, axis=-1) for kept in (self._strategies, self._inputs, self._gains))
        return strategies, estimates, inputs, gains
