"""The sampled loop e_{k+1} = (I − h_k M_k) e_k: what an episode does, step by step, with noise and with delay.

For games with affine F this is the environment itself, up to rounding to float32 at the interface, while no input
saturates. Vectors are in the paper's player-major stacking, as in :mod:`ptne_env.theory.closed_loop`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import scipy

from ptne_env.arrays import FloatArray, IntArray, require_count, require_non_negative
from ptne_env.games import Game
from ptne_env.laws import Law
from ptne_env.scenario import Scenario
from ptne_env.theory.closed_loop import (
    Loop,
    blank_reading,
    decay_rate,
    decay_rate_in_time,
    largest_stable_step,
    law_loop,
)
from ptne_env.world import World

LoopClock: TypeAlias = Literal["effective", "physical"]

_OVERFLOW = 1e150
"""A loop whose error passes this has diverged beyond doubt; its squares would overflow."""

_LARGEST_SYSTEM = 1200
"""Delays are tried while the augmented matrix has no more rows than this: its eigenvalues take seconds beyond."""

_LARGEST_RESOLVENT = 150
"""The small-gain bound on delays is found for at most this many estimates, for the same reason."""


@dataclass(frozen=True)
class SampledLoop:
    """The steps of an episode.

    Attributes:
        loops: the distinct loops.
        per_mode: the loop of every mode of the topology, in order; as it is in the last step to T, should it depend on
            the step.
        index: which of them acts in each step, shape (K+H,).
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
    def looks_at_step(self) -> bool:
        """Whether the law is another one in every step."""
        return len(self.loops) > len(self.per_mode)

    def step_margin(self) -> float | None:
        """How much longer the steps to T may be, at constant M, until they amplify some error.

        The smallest over the modes against the longest step; where the law looks at its step, the smallest over the
        steps. ``None`` when some M amplifies errors in every step.
        """
        stable = [largest_stable_step(loop.matrix) for loop in self.loops]
        if any(step is None for step in stable):
            return None
        limits, steps = np.array(stable, dtype=np.float64), self.steps[: self.deadline_step]
        if self.looks_at_step:
            return float((limits[self.index[: self.deadline_step]] / steps).min())
        return float(limits.min() / steps.max())

    def rate(self, scenario: Scenario) -> float:
        """Its :func:`~ptne_env.theory.closed_loop.decay_rate`, or the one in t for a law without the time gain."""
        matrices = [loop.matrix for loop in self.per_mode]
        if self.clock == "effective":
            return decay_rate(matrices, World(scenario).topology, scenario.deadline)
        return decay_rate_in_time(matrices, World(scenario).topology)

    def errors(self, start: FloatArray, delay: int = 0) -> FloatArray:
        """The error **x** − 1⊗x* at every instant.

        Args:
            start: initial error, shape (Nn,).
            delay: d ≥ 0 steps that every message is late; until it arrives, what was sent at the start is held.

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

    def transition(self, steps: int | None = None) -> FloatArray:
        """Φ = Π (I − h_k M_k) over the first ``steps`` steps (K if left out); not finite where it overflows."""
        matrices = [loop.matrix for loop in self.loops]
        result = np.eye(len(matrices[0]))
        for mode, step in zip(self.index[:steps], self.steps[:steps], strict=True):
            result = result - step * (matrices[mode] @ result)
            if not np.all(np.abs(result) < _OVERFLOW):
                return np.full_like(result, np.inf)
        return result

    def noise_covariance(self, noise_std: float = 1.0, steps: int | None = None) -> FloatArray:
        """Covariance of the error at T that additive noise on every message causes; the mean follows :meth:`errors`.

        P_{k+1} = (I − h_k M_k) P_k (I − h_k M_k)ᵀ + h_k² σ² W_k from P_0 = 0, with W_k the covariance of u for noise of
        variance 1: exact for affine F and a law at constant gains.

        Args:
            noise_std: σ of the noise on each component of each message, independent per directed link and step.
            steps: how many steps; K if left out.

        Returns:
            Shape (Nn, Nn); not finite where it overflows.

        Raises:
            ValueError: when σ is negative.
        """
        variance = require_non_negative("noise_std", noise_std) ** 2
        steps = self.deadline_step if steps is None else steps
        matrices = [loop.matrix for loop in self.loops]
        result = np.zeros_like(matrices[0])
        for mode, step in zip(self.index[:steps], self.steps[:steps], strict=True):
            half = result - step * (matrices[mode] @ result)
            result = half - step * (half @ matrices[mode].T) + step**2 * variance * self.loops[mode].noise
            if not np.all(np.abs(result) < _OVERFLOW):
                return np.full_like(result, np.inf)
        return result


@dataclass(frozen=True)
class DominantMode:
    """The slowest mode of a sampled loop over a window of steps, and whether it is alone.

    A mode of M with eigenvalue μ shrinks by Π |1 − h_k μ| over the window: its rate there is −Σ ln|1 − h_k μ| / Σ h_k.
    When the window opens the error is one part in the slowest mode and the rest; both the spectral gap and the start
    decide how large the rest is, and within the window it only becomes smaller.

    Attributes:
        rate: of the slowest mode, per unit of the loop's time.
        gap: by how much faster the next mode is.
        share: ‖part‖/(‖part‖ + ‖rest‖) when the window opens, 0 to 1.
        is_alone: whether the share is at least 0.95 and the mode real, so that the log error falls along a line.
    """

    rate: float
    gap: float
    share: float
    is_alone: bool


def sampled_loop(scenario: Scenario, law: Law, memory: Any = None, game: Game | None = None) -> SampledLoop:
    """The steps that ``law`` takes on ``scenario``.

    Args:
        scenario: the experiment.
        law: built for the scenario's layout; see :func:`~ptne_env.theory.closed_loop.law_loop` for what it may be.
        memory: the law's, frozen; one row per player.
        game: what is played, where the scenario draws games; its typical game if left out.

    Raises:
        ValueError: as :func:`~ptne_env.theory.closed_loop.law_loop`.
    """
    game, topology, clock = game or World(scenario).game, World(scenario).topology, World(scenario).clock
    modes = schedule(scenario)
    theta, dt = clock.theta[: clock.total_steps], clock.dt[: clock.total_steps]

    def probe(mode: int, theta: float = 1.0, dt: float = 1.0) -> Loop:
        return law_loop(law, game, topology.graphs[mode], memory, theta=theta, dt=dt)

    loops = tuple(probe(mode) for mode in range(len(topology.graphs)))
    # Beside the steps that there are, one that is longer in τ and one that is longer in t.
    thetas, dts = np.append(theta, [2 * theta[0], theta[0]]), np.append(dt, [dt[0], 2 * dt[0]])
    answers = _answers(law, thetas, dts, memory)
    if _is_constant(answers):
        return SampledLoop(loops, loops, modes, theta, "effective", clock.steps)
    if _is_constant(answers * (thetas / dts)[:, None]):
        return SampledLoop(loops, loops, modes, dt, "physical", clock.steps)
    # A law that looks at its step in another way has a loop of its own in every step.
    kinds, index = np.unique(np.stack([modes, theta, dt]), axis=1, return_inverse=True)
    loops = tuple(probe(int(mode), float(one), float(other)) for mode, one, other in kinds.T)
    last = clock.steps - 1
    per_mode = tuple(probe(mode, float(theta[last]), float(dt[last])) for mode in range(len(topology.graphs)))
    return SampledLoop(loops, per_mode, np.asarray(index).reshape(-1), theta, "effective", clock.steps)


def _answers(law: Law, theta: FloatArray, dt: FloatArray, memory: Any) -> FloatArray:
    """What all players do with the same gradients and differences in steps of other lengths, one row per step."""
    layout, generator = law.layout, np.random.default_rng(0)
    players, steps = layout.num_players, len(theta)
    blank = blank_reading(layout, np.tile(np.arange(players), steps))

    def shown(*shape: int) -> FloatArray:
        return np.tile(generator.uniform(0.5, 1.5, (players, *shape)), (steps, *(1,) * len(shape)))

    reading = blank._replace(
        gradient=np.where(layout.own_mask[blank.player], shown(layout.dimension), 0.0),
        relative_estimates=shown(layout.slots, layout.dimension),
        weights=shown(layout.slots),
        own_estimate=shown(layout.dimension),
        theta=np.repeat(theta, players)[:, None],
        dt=np.repeat(dt, players)[:, None],
    )
    return law.inputs(reading, None if memory is None else np.asarray(memory)[blank.player])[0].reshape(steps, -1)


def _is_constant(answers: FloatArray) -> bool:
    return bool(np.ptp(answers, axis=0).max() <= 1e-9 * (1 + np.abs(answers).max()))


def schedule(scenario: Scenario) -> IntArray:
    """The mode that acts in each step, shape (K+H,); of a random topology one draw, with seed 0."""
    topology, clock = World(scenario).topology, World(scenario).clock
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


def stationary_noise_covariance(
    loop: Loop, step: float, noise_std: float = 1.0, *, first_order: bool = False
) -> FloatArray | None:
    """Covariance at which a loop with equal steps settles under additive noise on every message.

    Exactly, P = (I − hM) P (I − hM)ᵀ + h² σ² W (the discrete Lyapunov equation); to first order in h,
    M P + P Mᵀ = h σ² W, so the floor of the distance grows like σ √h.

    Args:
        loop: of a connected graph.
        step: h.
        noise_std: σ of the noise on each component of each message.
        first_order: solve the second equation instead of the first.

    Returns:
        Shape (Nn, Nn), or ``None`` where the loop is not stable.

    Raises:
        ValueError: when σ is negative.
    """
    variance = require_non_negative("noise_std", noise_std) ** 2
    matrix = loop.matrix
    if np.linalg.eigvals(matrix).real.min() <= 0:
        return None
    if first_order:
        return np.asarray(scipy.linalg.solve_continuous_lyapunov(matrix, step * variance * loop.noise))
    transition = np.eye(len(matrix)) - step * matrix
    if np.abs(np.linalg.eigvals(transition)).max() >= 1:
        return None
    return np.asarray(scipy.linalg.solve_discrete_lyapunov(transition, step**2 * variance * loop.noise))


def delayed_radius(loop: Loop, step: float, delay: int) -> float:
    """Spectral radius of the loop when every message is ``delay`` steps late; below 1 it is stable.

    Of the augmented matrix of e_{k+1} = (I − h local) e_k − h message e_{k−d} on (e_k, …, e_{k−d}).

    Raises:
        ValueError: when the delay is negative.
    """
    size, blocks = len(loop.local), require_count("delay", delay, 0) + 1
    augmented = np.eye(size * blocks, k=-size)
    augmented[:size, :size] = np.eye(size) - step * loop.local
    augmented[:size, -size:] -= step * loop.message
    return float(np.abs(np.linalg.eigvals(augmented)).max())


def delay_margin(loop: Loop, step: float, limit: int = 20) -> int | None:
    """The largest d for which every delay of 0..d steps leaves the loop stable, as far as it was tried.

    Args:
        loop: of one graph.
        step: h.
        limit: largest delay to try; less is tried where the augmented matrix would be too large.

    Returns:
        d, at most ``limit``; ``None`` where the loop is unstable without delay.
    """
    tried = delays_tried(loop, limit)
    unstable = (d for d in range(tried + 1) if delayed_radius(loop, step, d) >= 1)
    return (next(unstable, tried + 1) - 1) if delayed_radius(loop, step, 0) < 1 else None


def delays_tried(loop: Loop, limit: int) -> int:
    """How far :func:`delay_margin` tries: to ``limit``, or as far as the augmented matrix is not too large."""
    return max(0, min(limit, _LARGEST_SYSTEM // len(loop.local) - 1))


def is_stable_for_every_delay(loop: Loop, step: float) -> bool:
    """Whether ρ(|I − h local| + h |message|) < 1 (absolute values by entry), which suffices for every delay.

    The entries of |e| are then below those of a positive system that shrinks, whatever the delays are, and also when
    they change from message to message. Sufficient only.
    """
    positive = np.abs(np.eye(len(loop.local)) - step * loop.local) + step * np.abs(loop.message)
    return bool(np.abs(np.linalg.eigvals(positive)).max() < 1)


def delay_bound(loop: Loop, step: float) -> float | None:
    """A bound on h d below which the loop is stable with every message d steps late; first order in h d, sufficient.

    With A = I − hM a late message subtracts h message (1 − z^{−d}) from z I − A, and |1 − z^{−d}| ≤ d |z − 1| on
    |z| = 1. So no eigenvalue crosses the unit circle while h d ρ((z − 1)(z I − A)^{−1} message) < 1 all along it (small
    gain). For small h the largest ρ is about that of ``message`` itself: h d < 1/(κ ρ(adjacency)) for the static law.

    Returns:
        1/max_z ρ, over a grid of angles, refined; ``None`` where the loop is unstable without delay, no message
        matters, or there are more than 150 estimates.
    """
    identity = np.eye(len(loop.local))
    transition = identity - step * loop.matrix
    if len(identity) > _LARGEST_RESOLVENT or np.abs(np.linalg.eigvals(transition)).max() >= 1:
        return None

    def gain(angle: float) -> float:
        z = np.exp(1j * angle)
        product = (z - 1) * np.linalg.solve(z * identity - transition, loop.message)
        return float(np.abs(np.linalg.eigvals(product)).max())

    # Peaks are where an eigenvalue of A comes near the circle; the best of the grid is refined between its neighbours.
    angles = np.unique([*np.geomspace(1e-3, np.pi, 96), *np.abs(np.angle(np.linalg.eigvals(transition)))])
    gains = [gain(angle) for angle in angles[angles > 0]]
    best, ends = int(np.argmax(gains)), np.pad(angles[angles > 0], 1, mode="edge")
    between = (ends[best], ends[best + 2])
    refined = scipy.optimize.minimize_scalar(lambda angle: -gain(angle), bounds=between, method="bounded")
    largest = max(gains[best], -float(refined.fun))
    return 1 / largest if largest > 0 else None


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
    share = part / (part + rest)
    others = np.delete(rates, slowest)
    is_real = abs(eigenvalues[slowest].imag) <= 1e-9 * abs(eigenvalues[slowest])
    return DominantMode(
        rate=float(rates[slowest]),
        gap=float(others.min() - rates[slowest]),
        share=share,
        is_alone=bool(share >= 0.95 and is_real),
    )


@dataclass(frozen=True)
class Play:
    """An episode of a law in float64.

    Attributes:
        errors: **x** − 1⊗x* at every instant, shape (K+H+1, Nn); not finite from where it diverges.
        peak_input: largest |u| on the way to T.
        memory: the law's at T, one row per player; ``None`` where the episode has diverged by then.
    """

    errors: FloatArray
    peak_input: float
    memory: Any


def play(law: Law, world: World, estimates: FloatArray, game: Game | None = None) -> Play:
    """Run a law, linear or not, in float64, over perfect links and without limits or bounds.

    It is the recursion of a law whose gains adapt. What is shown are gradients, relative and own estimates, weights and
    steps, and of a random topology one draw.

    Args:
        law: built for the layout of ``world``.
        world: the world.
        estimates: initial, shape (n, N).
        game: what is played, where the scenario draws games; its typical game if left out.
    """
    game, clock, layout = game or world.game, world.clock, law.layout
    n, players = game.dimension, game.num_players
    neighbours = np.array(layout.neighbours)
    blank = blank_reading(layout, np.arange(players))
    modes, own = schedule(world.scenario), layout.own_mask
    errors = np.full((clock.total_steps + 1, players * n), np.inf)
    errors[0] = start_error(estimates, game)
    current, memory, peak, memory_at_deadline = estimates.T.copy(), None, 0.0, None
    for k in range(clock.total_steps):
        weights = world.mode_weights[:, :, modes[k]].T
        gradient = game.own_gradients(current.T[:, :, None])[:, 0]
        reading = blank._replace(
            gradient=np.where(own, gradient, 0.0),
            relative_estimates=(current[neighbours] - current[:, None]) * (weights > 0)[:, :, None],
            weights=weights,
            theta=np.full((players, 1), clock.theta[k]),
            dt=np.full((players, 1), clock.dt[k]),
            own_estimate=current,
        )
        inputs, memory = law.inputs(reading, memory)
        current = current + clock.theta[k] * inputs
        if k < clock.steps:
            peak, memory_at_deadline = max(peak, float(np.abs(inputs).max())), memory
        if not np.all(np.abs(current) < _OVERFLOW):
            memory_at_deadline = None if k < clock.steps else memory_at_deadline
            break
        errors[k + 1] = start_error(current.T, game)
    return Play(errors, peak, memory_at_deadline)
