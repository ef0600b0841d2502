"""The sampled loop e_{k+1} = (I − h_k M_k) e_k: the error of an episode step by step, with noise and with delay.

For games with affine F this is the environment itself, up to rounding to float32 at the interface, while no input
saturates. Vectors are in the paper's player-major stacking, as in :mod:`ptne_env.theory.closed_loop`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from ptne_env.games import Game
from ptne_env.laws import Law
from ptne_env.perception.observation import Observation
from ptne_env.shared.arrays import FloatArray, IntArray, require_count, require_non_negative
from ptne_env.theory.closed_loop import (
    Loop,
    NoClosedLoopError,
    blank_observation,
    decay_rate,
    decay_rate_in_time,
    inputs_of,
    largest_stable_step,
    law_loop,
)
from ptne_env.world.world import World

LoopClock: TypeAlias = Literal["effective", "physical"]

_OVERFLOW = 1e150
"""A loop whose error exceeds this has diverged; its squares would overflow."""

LARGEST_PRODUCT = 600
"""Products of matrices over all steps are for at most this many estimates: they take minutes beyond."""

_LARGEST_LOOPS = 70_000_000
"""Number of entries that the loops of a law that reads its step may have together: about 2 GB."""


@dataclass(frozen=True)
class SampledLoop:
    """The steps of an episode.

    Attributes:
        loops: the distinct loops.
        per_mode: the loop of every mode of the topology, in order; that of the last step to T for a law that reads its
            step.
        index: position in ``loops`` of the loop of each step, shape (K+H,).
        steps: h_k, by which each step advances, shape (K+H,): Θ_k, or Δt_k for a law without the time gain.
        clock: ``"effective"`` or ``"physical"``, the time in which the law's own loop is dx = −M x.
        deadline_step: K.
    """

    loops: tuple[Loop, ...]
    per_mode: tuple[Loop, ...]
    index: IntArray
    steps: FloatArray
    clock: LoopClock
    deadline_step: int

    @property
    def is_large(self) -> bool:
        """Whether products of matrices over all steps would take minutes, so that certificates leave them out."""
        return len(self.loops[0].matrix) > LARGEST_PRODUCT

    @property
    def reads_step(self) -> bool:
        """Whether the law reads the length of its step, so that every step has a loop of its own."""
        return len(self.loops) > len(self.per_mode)

    def step_margin(self, *, hold: bool = False) -> float | None:
        """Factor by which the steps to T may grow, at constant M, until they amplify some error.

        The smallest over the modes against the longest step; for a law that reads its step, the smallest over the
        steps. ``None`` when some M amplifies errors in every step.

        Args:
            hold: count the steps of the hold phase too.
        """
        stable = [largest_stable_step(loop.matrix) for loop in self.loops]
        if any(step is None for step in stable):
            return None
        last = len(self.steps) if hold else self.deadline_step
        limits, steps = np.array(stable, dtype=np.float64), self.steps[:last]
        if self.reads_step:
            return float((limits[self.index[:last]] / steps).min())
        return float(limits.min() / steps.max())

    def rate(self, world: World) -> float:
        """Its :func:`~ptne_env.theory.closed_loop.decay_rate`, or the rate in t for a law without the time gain."""
        matrices = [loop.matrix for loop in self.per_mode]
        if self.clock == "effective":
            return decay_rate(matrices, world.topology, world.scenario.deadline)
        return decay_rate_in_time(matrices, world.topology)

    def errors(self, start: FloatArray, delay: int = 0) -> FloatArray:
        """The error **x** − 1⊗x* at every instant.

        Args:
            start: initial error, shape (Nn,).
            delay: d ≥ 0 steps that every message is late; until it arrives, the message of the start is held.

        Returns:
            Shape (K+H+1, Nn); not finite from where a diverging loop leaves the range of float64.

        Raises:
            ValueError: when the delay is negative.
        """
        require_count("delay", delay, 0)
        matrices = [loop.matrix for loop in self.loops]
        result = np.full((self.steps.size + 1, len(start)), np.inf)
        result[0] = start
        for k, (mode, step) in enumerate(zip(self.index, self.steps, strict=True)):
            if delay:
                sent = result[max(k - delay, 0)]
                change = self.loops[mode].local @ result[k] + self.loops[mode].message @ sent
            else:
                change = matrices[mode] @ result[k]
            result[k + 1] = result[k] - step * change
            if not np.all(np.abs(result[k + 1]) < _OVERFLOW):
                result[k + 1] = np.inf
                break
        return result

    def transition(self) -> FloatArray:
        """Φ = Π (I − h_k M_k) over the K steps to T, shape (Nn, Nn); not finite where it overflows."""
        matrices, steps = [loop.matrix for loop in self.loops], self.deadline_step
        result = np.eye(len(matrices[0]))
        for mode, step in zip(self.index[:steps], self.steps[:steps], strict=True):
            result = result - step * (matrices[mode] @ result)
            if not np.all(np.abs(result) < _OVERFLOW):
                return np.full_like(result, np.inf)
        return result

    def noise_covariance(self, noise_std: float = 1.0) -> FloatArray:
        """Covariance of the error at T that additive noise on every message causes; the mean follows :meth:`errors`.

        P = Σ h_k² σ² Ψ_k W_k Ψ_kᵀ with Ψ_k the product of the steps after k to T, and W_k the covariance of u for noise
        of variance 1: exact for affine F and a law at constant gains. The sum runs from the last step backwards. The
        recursion P_{k+1} = (I − h_k M_k) P_k (I − h_k M_k)ᵀ + h_k² σ² W_k has the same result, but rounding makes its
        variances negative where early steps amplify an error and later steps damp it.

        Args:
            noise_std: σ of the noise on each component of each message, independent per directed link and step.

        Returns:
            Shape (Nn, Nn); not finite where it overflows.

        Raises:
            ValueError: when σ is negative.
        """
        variance = require_non_negative("noise_std", noise_std) ** 2
        steps = self.deadline_step
        matrices = [loop.matrix for loop in self.loops]
        after = np.eye(len(matrices[0]))
        result = np.zeros_like(after)
        for mode, step in zip(self.index[:steps][::-1], self.steps[:steps][::-1], strict=True):
            result += step**2 * variance * (after @ self.loops[mode].noise) @ after.T
            after = after - step * (after @ matrices[mode])
            if not (np.all(np.abs(result) < _OVERFLOW) and np.all(np.abs(after) < _OVERFLOW)):
                return np.full_like(result, np.inf)
        return result


def sampled_loop(world: World, law: Law, memory: Any = None) -> SampledLoop:
    """The steps that ``law`` takes in ``world``; in a world of random games, on its typical game.

    Args:
        world: the scenario, built.
        law: built for the world's layout; see :func:`~ptne_env.theory.closed_loop.law_loop` for the laws that have a
            loop.
        memory: the law's, frozen; one row per player.

    Raises:
        NoClosedLoopError: as :func:`~ptne_env.theory.closed_loop.law_loop`, and for a law that reads its step, so that
            every step has a loop of its own, when these would take more than about 2 GB.
        ValueError: as :func:`~ptne_env.theory.closed_loop.law_loop`.
    """
    clock, graphs = world.clock, world.topology.graphs
    modes = schedule(world)
    theta, dt = clock.theta[: clock.total_steps], clock.dt[: clock.total_steps]

    def loop(mode: int, theta: float = 1.0, dt: float = 1.0) -> Loop:
        return law_loop(law, world.game, graphs[mode], memory, theta=theta, dt=dt)

    loops = tuple(loop(mode) for mode in range(len(graphs)))
    # Beside the steps of the episode, a step that is longer in τ and a step that is longer in t.
    thetas, dts = np.append(theta, [2 * theta[0], theta[0]]), np.append(dt, [dt[0], 2 * dt[0]])
    responses = _responses(law, thetas, dts, memory)
    if _is_constant(responses):
        return SampledLoop(loops, loops, modes, theta, "effective", clock.steps)
    if _is_constant(responses * (thetas / dts)[:, None]):
        return SampledLoop(loops, loops, modes, dt, "physical", clock.steps)
    # A law that reads its step in another way has a loop of its own in every step.
    kinds, index = np.unique(np.stack([modes, theta, dt]), axis=1, return_inverse=True)
    if kinds.shape[1] * loops[0].matrix.size > _LARGEST_LOOPS:
        raise NoClosedLoopError(
            f"{type(law).__name__} reads its step and so has {kinds.shape[1]} loops, too many for "
            f"{len(loops[0].matrix)} estimates"
        )
    loops = tuple(loop(int(mode), float(theta), float(dt)) for mode, theta, dt in kinds.T)
    last = clock.steps - 1
    per_mode = tuple(loop(mode, float(theta[last]), float(dt[last])) for mode in range(len(graphs)))
    return SampledLoop(loops, per_mode, np.asarray(index).reshape(-1), theta, "effective", clock.steps)


def _responses(law: Law, theta: FloatArray, dt: FloatArray, memory: Any) -> FloatArray:
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
    return inputs_of(law, observation, memory).reshape(steps, -1)


def _is_constant(responses: FloatArray) -> bool:
    return bool(np.ptp(responses, axis=0).max() <= 1e-9 * (1 + np.abs(responses).max()))


def schedule(world: World) -> IntArray:
    """The mode that acts in each step, shape (K+H,); of a random topology one draw, with seed 0."""
    topology, clock = world.topology, world.clock
    instants = clock.topology_times[topology.clock][: clock.total_steps]
    return topology.draw(instants, [np.random.default_rng(0)]).modes[:, 0]


def start_error(estimates: FloatArray, game: Game) -> FloatArray:
    """**x** − 1⊗x* of estimates (n, N) or (n, N, B) in player-major order, shape (Nn,) or (Nn, B)."""
    errors = (estimates.T - game.nash_equilibrium).T.swapaxes(0, 1)
    return errors.reshape(-1, *errors.shape[2:])


def distance(errors: FloatArray, game: Game) -> FloatArray:
    """‖**x** − 1⊗x*‖/(√N ‖x*‖) of errors (..., Nn), shape (...)."""
    return np.linalg.norm(errors, axis=-1) / (math.sqrt(game.num_players) * float(game.equilibrium_scale[0]))


def noise_distance(covariance: FloatArray, game: Game) -> float:
    """Root of the mean squared estimate distance of an error with this covariance and mean 0."""
    return math.sqrt(float(np.trace(covariance)) / game.num_players) / float(game.equilibrium_scale[0])


class DominantMode(NamedTuple):
    """The slowest mode of a sampled loop over a window of steps.

    A mode of M with eigenvalue μ shrinks by Π |1 − h_k μ| over the window: its rate there is −Σ ln|1 − h_k μ| / Σ h_k.
    When the window opens the error is the part in the slowest mode and the rest; the spectral gap and the start
    decide how large the rest is, and within the window it only becomes smaller.

    Attributes:
        rate: of the slowest mode, per unit of the loop's time.
        share: ‖part‖/(‖part‖ + ‖rest‖) when the window opens, 0 to 1. A complex mode has a conjugate of the same size,
            so a share near 1 belongs to a real one, and the log error then falls along a line.
    """

    rate: float
    share: float


def dominant_mode(sampled: SampledLoop, start: FloatArray, first: int, last: int) -> DominantMode | None:
    """The slowest mode over the steps ``first``..``last`` − 1, for a loop that stays the same.

    Args:
        sampled: the steps of an episode.
        start: initial error, shape (Nn,).
        first: step at which the window opens.
        last: instant at which it closes.

    Returns:
        ``None`` where the graph switches, the eigenvectors do not span the space to rounding, or M is singular.
    """
    if len(sampled.loops) != 1:
        return None
    eigenvalues, vectors = np.linalg.eig(sampled.loops[0].matrix.astype(np.complex128))
    if np.linalg.cond(vectors) > 1e10 or not np.all(eigenvalues):
        return None
    tiny = np.finfo(np.float64).tiny  # a mode that a step annihilates has no logarithm
    growth = np.log(1 - sampled.steps[:last, None] * eigenvalues + tiny)
    rates = -growth[first:].real.sum(axis=0) / sampled.steps[first:last].sum()
    slowest = int(rates.argmin())
    opening = growth[:first].sum(axis=0)
    parts = vectors * np.linalg.solve(vectors, start) * np.exp(opening - opening.real.max())
    part = float(np.linalg.norm(parts[:, slowest]))
    rest = float(np.linalg.norm(np.delete(parts, slowest, axis=1).sum(axis=1)))
    return DominantMode(rate=float(rates[slowest]), share=part / (part + rest))


@dataclass(frozen=True)
class Play:
    """An episode of a law in float64.

    Attributes:
        errors: **x** − 1⊗x* at every instant, shape (K+H+1, Nn); not finite from where it diverges.
        peak_input: largest |u| on the way to T.
        memory: the law's at T, or where the episode ended before, one row per player; ``None`` where it has diverged.
    """

    errors: FloatArray
    peak_input: float
    memory: Any


def observed(law: Law, world: World, estimates: FloatArray, k: int, mode: int) -> Observation:
    """Observations of all players in float64 over perfect links: gradients, estimates, weights and steps.

    Args:
        law: built for the layout of ``world``.
        world: the world; of random games, the typical game is played.
        estimates: row i is x^i, shape (N, n).
        k: the step.
        mode: the active graph.
    """
    game, clock, layout, players = world.game, world.clock, law.layout, world.game.num_players
    weights = world.mode_weights[:, :, mode].T
    gradient = game.own_gradients(estimates.T[:, :, None])[:, 0]
    differences = estimates[np.array(layout.neighbours)] - estimates[:, None]
    return blank_observation(layout, np.arange(players))._replace(
        gradient=np.where(layout.own_mask, gradient, 0.0),
        relative_estimates=differences * (weights > 0)[:, :, None],
        weights=weights,
        theta=np.full((players, 1), clock.theta[k]),
        dt=np.full((players, 1), clock.dt[k]),
        own_estimate=estimates,
    )


def play(law: Law, world: World, estimates: FloatArray, closest: float = 0.0) -> Play:
    """Run a law, linear or not, in float64, over perfect links and without limits or bounds.

    It is the recursion of a law whose gains adapt. The law observes gradients, relative and own estimates, weights and
    steps, and of a random topology one draw; in a world of random games, of the typical game.

    Args:
        law: built for the layout of ``world``.
        world: the world.
        estimates: initial, shape (n, N).
        closest: relative distance to x* below which the episode ends; the errors afterwards are not finite.
    """
    game, clock = world.game, world.clock
    n, players, modes = game.dimension, game.num_players, schedule(world)
    errors = np.full((clock.total_steps + 1, players * n), np.inf)
    errors[0] = start_error(estimates, game)
    current, memory = estimates.T.copy(), law.initial_memory(players)
    peak, memory_at_deadline = 0.0, None
    for k in range(clock.total_steps):
        observation = observed(law, world, current, k, int(modes[k]))
        inputs, memory = law.inputs(observation, memory)
        current = current + clock.theta[k] * inputs
        if k < clock.steps:
            peak, memory_at_deadline = max(peak, float(np.abs(inputs).max())), memory
        if not np.all(np.abs(current) < _OVERFLOW):
            memory_at_deadline = None if k < clock.steps else memory_at_deadline
            break
        errors[k + 1] = start_error(current.T, game)
        if distance(errors[k + 1], game) < closest:
            break
    return Play(errors, peak, memory_at_deadline)
