"""Traces for figures: the error against time over a few episodes, and one episode instant by instant."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ptne_env.evaluation.entries import PolicySpec
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.rollout import Member, rollout
from ptne_env.perception.encoder import make_encoder
from ptne_env.shared.arrays import BoolArray, FloatArray, IntArray
from ptne_env.world.dynamics import State
from ptne_env.world.world import World

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
    equilibrium: FloatArray
    links: IntArray
    live: BoolArray
    episodes: int
    traces: Mapping[str, Trace]


def scene(
    world: World,
    episodes: EpisodeSet,
    policies: Iterable[PolicySpec],
    teammates: Callable[[World], Member] | None = None,
) -> Scene:
    """The traces of several policies, each with its first training seed, from the same starts.

    Args:
        world: the world.
        episodes: that are run.
        policies: with different names.
        teammates: makes the teammates of each policy; ``None`` where there are none.

    Raises:
        ValueError: when a policy cannot act in this world.
    """
    clock, start = world.clock, episodes.initial_state(world)
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
        equilibrium=start.game.nash_equilibria[:, 0],
        links=links,
        live=live.T,
        episodes=episodes.count,
        traces={spec.name: _trace(world, start, spec, teammates) for spec in policies},
    )


def _trace(world: World, start: State, spec: PolicySpec, teammates: Callable[[World], Member] | None) -> Trace:
    """The trace of one policy."""
    encoder = make_encoder(world, spec.interface)
    owners = world.game.owners
    own = (np.arange(len(owners)), owners)
    estimates: list[FloatArray] = []
    inputs: list[FloatArray] = []

    def watch(state: State, held: FloatArray | None) -> None:
        estimates.append(state.estimates[:, :, 0].copy())
        inputs.append(np.full(len(owners), np.nan) if held is None else held[:, :, 0][own])

    team = None if teammates is None else teammates(world)
    policy = spec.build(encoder.layout)
    distance = rollout(policy, encoder, start, team, watch)["estimate_distance"]
    every = np.stack(estimates, axis=-1)
    return Trace(
        errors=np.quantile(distance, QUANTILES, axis=1),
        error=distance[:, 0],
        strategies=every[own],
        estimates=every if every[..., 0].size <= MOST_ESTIMATES else None,
        inputs=np.stack(inputs, axis=-1),
    )
