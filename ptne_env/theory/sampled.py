"""The sampled loop e_{k+1} = (I − h_k M_k) e_k: the error of an episode, step by step.

For games with affine F this is the environment itself, up to rounding to float32 at the interface, while no input
saturates. Vectors are in the paper's player-major stacking, as in :mod:`ptne_env.theory.closed_loop`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ptne_env.games import Game
from ptne_env.laws import Law
from ptne_env.shared.arrays import FloatArray, IntArray
from ptne_env.theory.closed_loop import (
    LoopClock,
    NoClosedLoopError,
    blank_observation,
    inputs_of,
    largest_stable_step,
    law_matrix,
)
from ptne_env.world.world import World

_OVERFLOW = 1e150
"""A loop whose error exceeds this has diverged; its squares would overflow."""


@dataclass(frozen=True)
class SampledLoop:
    """The steps of an episode to T.

    Attributes:
        matrices: M of every mode of the topology, in order, shape (Nn, Nn) each.
        modes: the mode that acts in each step, shape (K,); of a random topology one draw, with seed 0.
        steps: h_k, by which each step advances, shape (K,): Θ_k, or Δt_k for a law without the time gain.
        clock: ``"effective"`` or ``"physical"``.
    """

    matrices: tuple[FloatArray, ...]
    modes: IntArray
    steps: FloatArray
    clock: LoopClock

    @property
    def largest_step(self) -> float:
        """The largest h_k."""
        return float(self.steps.max())

    @property
    def largest_stable_step(self) -> float | None:
        """The smallest over the modes; ``None`` where every step on some mode amplifies an error.

        It does not prove that products of the steps of several modes are stable.
        """
        stable = [largest_stable_step(matrix) for matrix in self.matrices]
        return None if None in stable else min(step for step in stable if step is not None)

    def errors(self, start: FloatArray) -> FloatArray:
        """The error **x** − 1⊗x* at every instant.

        Args:
            start: initial error, shape (Nn,).

        Returns:
            Shape (K+1, Nn); not finite from where a diverging loop leaves the range of float64.
        """
        result = np.full((self.steps.size + 1, len(start)), np.inf)
        result[0] = start
        for k, (mode, step) in enumerate(zip(self.modes, self.steps, strict=True)):
            result[k + 1] = result[k] - step * (self.matrices[mode] @ result[k])
            if not np.all(np.abs(result[k + 1]) < _OVERFLOW):
                result[k + 1] = np.inf
                break
        return result


def sampled_loop(world: World, law: Law) -> SampledLoop:
    """The steps that ``law`` takes in ``world``; in a world of random games, on its typical game.

    Args:
        world: the scenario, built.
        law: built for the world's layout; see :func:`~ptne_env.theory.closed_loop.law_matrix` for the laws that have a
            loop.

    Raises:
        NoClosedLoopError: as :func:`~ptne_env.theory.closed_loop.law_matrix`, and for a law that reads the length of
            its step for more than to undo the time gain.
    """
    clock, topology = world.clock, world.topology
    matrices = tuple(law_matrix(law, world.game, graph) for graph in topology.graphs)
    theta, dt = clock.theta[: clock.steps], clock.dt[: clock.steps]
    # The first and the last step, a step that is longer in τ, and one that is longer in t.
    thetas, dts = np.array([theta[0], theta[-1], 2 * theta[0], theta[0]]), np.array([dt[0], dt[-1], dt[0], 2 * dt[0]])
    responses = _responses(law, thetas, dts)
    instants = clock.topology_times[topology.clock][: clock.steps]
    modes = topology.draw(instants, [np.random.default_rng(0)]).modes[:, 0]
    if _is_constant(responses):
        return SampledLoop(matrices, modes, theta, "effective")
    if _is_constant(responses * (thetas / dts)[:, None]):
        return SampledLoop(matrices, modes, dt, "physical")
    raise NoClosedLoopError(f"{type(law).__name__} reads the length of its step, so it has another loop in every step")


def _responses(law: Law, theta: FloatArray, dt: FloatArray) -> FloatArray:
    """Inputs of all players for the same gradients and differences in steps of other lengths, one row per step."""
    layout, generator = law.layout, np.random.default_rng(0)
    players, steps = layout.num_players, len(theta)
    blank = blank_observation(layout, np.tile(np.arange(players), steps))

    def drawn(*shape: int) -> FloatArray:
        return np.tile(generator.uniform(0.5, 1.5, (players, *shape)), (steps, *(1,) * len(shape)))

    observation = blank._replace(
        gradient=np.where(layout.own_mask[blank.player], drawn(layout.dimension), 0.0),
        relative_estimates=drawn(layout.slots, layout.dimension),
        weights=drawn(layout.slots),
        own_estimate=drawn(layout.dimension),
        theta=np.repeat(theta, players)[:, None],
        dt=np.repeat(dt, players)[:, None],
    )
    return inputs_of(law, observation).reshape(steps, -1)


def _is_constant(responses: FloatArray) -> bool:
    return bool(np.ptp(responses, axis=0).max() <= 1e-9 * (1 + np.abs(responses).max()))


def start_error(estimates: FloatArray, game: Game) -> FloatArray:
    """**x** − 1⊗x* of estimates (n, N) or (n, N, B) in player-major order, shape (Nn,) or (Nn, B)."""
    errors = (estimates.T - game.nash_equilibrium).T.swapaxes(0, 1)
    return errors.reshape(-1, *errors.shape[2:])


def distance(errors: FloatArray, game: Game) -> FloatArray:
    """‖**x** − 1⊗x*‖/(√N ‖x*‖) of errors (..., Nn), shape (...)."""
    return np.linalg.norm(errors, axis=-1) / (math.sqrt(game.num_players) * float(game.equilibrium_scale[0]))
