"""The local rate of laws whose gates follow evidence: the linearisation at rest."""

from __future__ import annotations

import numpy as np

from ptne_env.field.laws.gated import GatedLaw
from ptne_env.theory.closed_loop import law_loop
from ptne_env.theory.sampled import observed, play
from ptne_env.world.world import World

_CLOSEST = 1e-8
"""Relative distance to x* at which gates are taken: nearer to it, changes of messages by rounding count as noise."""


def local_radius(world: World, law: GatedLaw) -> float:
    """The spectral radius of a step at rest, with gates, sources and model as an episode leaves them.

    It is ρ(I − Θ M). Where players extrapolate their gradient, M₁ being the loop without extrapolation and M₂ that in
    which they respond to the present gradient twice, it is that of (e_k, e_{k−1}) under
    e_{k+1} = (I − Θ M₂) e_k + Θ (M₂ − M₁) e_{k−1}.

    Below 1 the equilibrium is locally exponentially stable while these rest: an error near it shrinks by this factor
    per step in the long run. The episode is that of :func:`~ptne_env.theory.sampled.play`, from the scenario's start
    with seed 0, in float64 and over perfect links, until eight digits or the deadline. F is linearised at x*.

    Args:
        world: the world, with a fixed graph; of random games, the typical game.
        law: built for the layout of ``world``.

    Returns:
        The radius; infinite where the episode diverges.

    Raises:
        NoClosedLoopError: where the frozen law is not linear.
        ValueError: for a topology that switches.
    """
    if not world.topology.is_fixed:
        raise ValueError("the local rate is that of a fixed graph, and this topology switches")
    game = world.game
    estimates = world.start.draw(game.num_players, game.dimension, np.random.default_rng(0))
    episode = play(law, world, estimates, _CLOSEST)
    if episode.memory is None:
        return float("inf")
    reached = np.flatnonzero(np.isfinite(episode.errors).all(axis=1))[-1]
    last = int(min(reached, world.clock.steps)) - 1
    rest = episode.errors[last + 1].reshape(game.num_players, -1) + game.nash_equilibrium
    theta, graph = float(world.clock.theta[last]), world.topology.graphs[0]
    frozen = law.at_rest(observed(law, world, rest, last, 0), episode.memory)
    plain, ahead = (law_loop(each, game, graph, theta=theta).matrix for each in frozen)
    step, before = np.eye(len(ahead)) - theta * ahead, theta * (ahead - plain)
    if before.any():
        step = np.block([[step, before], [np.eye(len(ahead)), np.zeros_like(ahead)]])
    return float(np.abs(np.linalg.eigvals(step)).max())
