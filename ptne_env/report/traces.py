"""Traces for figures: the error over time in a few episodes, and one episode instant by instant."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.policy_spec import PolicySpec
from ptne_env.evaluation.rollout import rollout
from ptne_env.evaluation.tracks import Track
from ptne_env.perception.encoder import Encoder
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray
from ptne_env.world.dynamics import State

MOST_ESTIMATES = 200
"""Largest number of estimates of all players that a trace keeps, as many as ``env.render()`` draws."""

QUANTILES = (0.1, 0.5, 0.9)
"""The quantiles of the error over episodes: the ends of the band, and the median between them."""


@dataclass(frozen=True)
class Trace:
    """One policy in one world, at the F instants of its episodes.

    Attributes:
        errors: the :data:`QUANTILES` over episodes of the estimate distance, shape (3, F).
        error: the estimate distance in the first episode, shape (F,).
        strategies: x in the first episode, shape (n, F).
        estimates: x^i in column i, in the first episode, shape (n, N, F); ``None`` where n N is above
            :data:`MOST_ESTIMATES`.
        inputs: the inputs of the strategies in the first episode, held from each instant; NaN at the last. Shape
            (n, F).
    """

    errors: FloatArray
    error: FloatArray
    strategies: FloatArray
    estimates: FloatArray | None
    inputs: FloatArray


@dataclass(frozen=True)
class Scene:
    """A world, its first episode, and the traces of policies there.

    Attributes:
        t: time in seconds, shape (F,).
        s: transformed time, which ends at the deadline, shape (F,).
        gain: g(t) in 1/s, shape (F,).
        deadline_frame: the index of the instant T.
        owners: the player that owns each component, shape (n,).
        equilibrium: x* in the first episode, shape (n,).
        links: the pairs of players that are ever neighbours, shape (L, 2).
        live: whether each link is up in the first episode, in one direction at least, shape (L, F).
        episodes: the number of episodes behind the errors.
        traces: the traces by name of the policy.
    """

    t: FloatArray
    s: FloatArray
    gain: FloatArray
    deadline_frame: int
    owners: IntArray
    equilibrium: FloatArray
    links: IntArray
    live: BoolArray
    episodes: int
    traces: Mapping[str, Trace]


def make_scene(track: Track, episodes: EpisodeSet, policies: Iterable[PolicySpec]) -> Scene:
    """Run policies, each with its first training seed, from the same starts; ``ValueError`` for one that cannot act."""
    world = track.world
    clock, start = world.clock, episodes.initial_state(world)
    links = np.array(world.topology.union.edges, dtype=np.int64).reshape(-1, 2)
    randomness = start.randomness
    modes = world.modes if randomness is None or randomness.modes is None else randomness.modes[:, 0]
    both_ways = [graph.adjacency + graph.adjacency.T for graph in world.topology.graphs]
    live = np.array([both_ways[int(mode)][links[:, 0], links[:, 1]] > 0 for mode in modes])
    return Scene(
        t=clock.t,
        s=clock.s,
        gain=clock.transformation.gain(clock.t, clock.gain),
        deadline_frame=clock.steps,
        owners=world.game.owners,
        equilibrium=start.game.nash_equilibria[:, 0],
        links=links,
        live=live.T,
        episodes=episodes.count,
        traces={spec.name: _trace_policy(track, start, spec) for spec in policies},
    )


def _trace_policy(track: Track, start: State, spec: PolicySpec) -> Trace:
    encoder = Encoder(track.world, spec.interface)
    owners = track.world.game.owners
    own = (np.arange(len(owners)), owners)
    estimates: list[FloatArray] = []
    inputs: list[FloatArray] = []

    def watch(state: State, held: FloatArray | None) -> None:
        estimates.append(state.estimates[:, :, 0].copy())
        inputs.append(np.full(len(owners), np.nan) if held is None else held[:, :, 0][own])

    team = None if track.teammates is None else track.teammates.join(track.world)
    distance = rollout(spec.build(encoder.layout), encoder, start, team, watch)["estimate_distance"]
    every = np.stack(estimates, axis=-1)
    return Trace(
        errors=np.quantile(distance, QUANTILES, axis=1),
        error=distance[:, 0],
        strategies=every[own],
        estimates=every if every[..., 0].size <= MOST_ESTIMATES else None,
        inputs=np.stack(inputs, axis=-1),
    )
