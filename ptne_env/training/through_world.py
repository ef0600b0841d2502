"""Training through the world: a recurrent policy learns by gradients of its digits that flow through the dynamics.

Back-propagation through windows of the JAX world; states and memories go on from window to window (truncated
back-propagation, analytic policy gradients). The policy so far is the checkpoint.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from itertools import repeat
from pathlib import Path
from time import monotonic
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from optax.contrib import MuonDimensionNumbers, muon

import ptne_env.jax
from ptne_env.evaluation.tracks import Track, find_track
from ptne_env.learn import load
from ptne_env.learn.layers import Weights
from ptne_env.learn.npz_policy import seal
from ptne_env.learn.recurrent import RecurrentPolicy, initial_memory, initial_weights, read, run_network
from ptne_env.shared.arrays import require_count, require_positive, require_probability, without_gradient
from ptne_env.shared.files import write_atomically
from ptne_env.training.configuration import POLICY, RunSummary, read_finished_run, write_record
from ptne_env.training.curve import write_learning_curve
from ptne_env.training.team import Team
from ptne_env.world import distances


@dataclass(frozen=True)
class Settings:
    """The definition of a run.

    Attributes:
        scenario: the name of the world in which the network trains, as for ``ptne train``; a name for several worlds.
        updates: the number of updates of the weights.
        groups: the number of groups into which the worlds are dealt, again and again at random. An update follows the
            mean slope in the worlds of one group.
        cells: environments of a world times its players times its components, which is what an update costs.
        window: the number of steps between updates. Gradients end there; states and memories go on.
        shrink: the factor by which the gradient with respect to the state shrinks per step.
        memory_shrink: the factor for the gradient with respect to what players remember.
        rate: the learning rate at the start; it falls to a fiftieth, along a cosine.
        hidden: the number of units of the network per component.
        slot_hidden: the number of units per component of each neighbour.
        seed: the seed of weights and episodes.

    Raises:
        ValueError: naming the value that has a wrong type or is out of its range.
    """

    scenario: str
    updates: int = 800
    groups: int = 1
    cells: int = 1600
    window: int = 40
    shrink: float = 0.99
    memory_shrink: float = 0.9
    rate: float = 4e-3
    hidden: int = 32
    slot_hidden: int = 16
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("updates", "groups", "cells", "window", "hidden", "slot_hidden"):
            require_count(name, getattr(self, name), 1)
        require_count("seed", self.seed, 0)
        require_positive("rate", self.rate)
        for name in ("shrink", "memory_shrink"):
            require_probability(name, getattr(self, name))


class Lesson:
    """A world in which a network trains, with episodes that go on from update to update, each in another phase.

    Args:
        track: the world, with a :class:`Team`.
        settings: the definition of the run.
        key: the key that draws the episodes.
    """

    def __init__(self, track: Track, settings: Settings, key: Any) -> None:
        self._settings = settings
        self.world = ptne_env.jax.JaxWorld(track.scenario, interface="physical", pool=256)
        layout = self.world.layout
        self.envs = max(2, round(settings.cells / (layout.num_players * layout.dimension)))
        self.agent_steps = settings.window * self.envs * layout.num_players
        self._player = np.repeat(np.arange(layout.num_players), self.envs)
        self._windows = self.world.numpy.clock.total_steps // settings.window
        self._count, self._key = 0, key
        self._team = Team(track, self.world)
        weights = initial_weights(np.random.default_rng(0), settings.hidden, settings.slot_hidden)
        memory = initial_memory(weights, layout.slots, layout.dimension, len(self._player), jnp)
        self._carry = self.world.reset(key, self.envs), memory
        self._compiled_advance = jax.jit(self._advance, donate_argnums=(1,))

    def slope(self, weights: Weights) -> tuple[Weights, float]:
        """Play a window; return the slope of its loss and the digits of the episodes that ended, NaN if none did."""
        forced = np.zeros(self.envs, dtype=bool)
        if self._count < self._windows:  # so that episodes are in all phases
            first, last = (each * self.envs // self._windows for each in (self._count, self._count + 1))
            forced[first:last] = self._count > 0
        self._count += 1
        key = jax.random.fold_in(self._key, self._count)
        slope, self._carry, ended = self._compiled_advance(weights, self._carry, key, forced)
        return slope, float(ended)

    def digits(self) -> float:
        """Return the mean digits of the episodes that go on."""
        return float(self.world.digits(self._carry[0]).mean())

    def _advance(self, weights: Weights, carry: Any, key: Any, forced: Any) -> Any:
        world = self.world
        (_, carry), slope = jax.value_and_grad(self._loss, has_aux=True)(weights, carry)
        state, memory = carry
        over = world.is_over(state)
        ended = jnp.where(over, world.digits(state), 0.0).sum() / over.sum()
        state = world.restarted(key, state._replace(diverged=state.diverged | forced))
        starts = jnp.tile(over | forced, world.layout.num_players)
        memory = jax.tree.map(lambda leaf: jnp.where(starts, 0.0, leaf), memory)
        return slope, (state, memory), ended

    def _loss(self, weights: Weights, carry: Any) -> Any:
        """Return the mean over a window of the logarithm of the distance to the equilibrium."""
        # A gradient computes each step again instead of storing its numbers, which is faster.
        again = jax.checkpoint(lambda carry, _: self._step(weights, carry), prevent_cse=False)
        carry, logarithms = jax.lax.scan(again, carry, length=self._settings.window)
        return logarithms.mean(), carry

    def _step(self, weights: Weights, carry: Any) -> Any:
        state, memory = carry
        world, layout = self.world, self.world.layout
        seen = read(layout, world.observe(state).reshape(layout.size, -1), self._player)
        shrink, shrink_memory = self._settings.shrink, self._settings.memory_shrink
        share = 1 / len(self._player)  # of a player of an environment in the loss
        memory = memory | {name: _damp(memory[name], shrink_memory, share) for name in ("hidden", "slot_hidden")}
        inputs, memory, _ = run_network(weights, layout, seen, memory)
        inputs = inputs.reshape(*state.estimates.shape).astype(jnp.float64)
        state = world.step(state, self._team.complete(state, inputs))
        # The loss of a step has a slope of the order of one over the distance.
        distance = jnp.sqrt(distances.player_squares(state.estimates, state.game).sum(0))
        bound = without_gradient(1 / (self.envs * jnp.maximum(distance, distances.FLOOR)))
        estimates, own_gradients = (_damp(each, shrink, bound) for each in (state.estimates, state.own_gradients))
        state = state._replace(estimates=estimates, own_gradients=own_gradients)
        if state.received is not None:
            messages = _damp(state.received.messages, shrink, bound)
            state = state._replace(received=state.received._replace(messages=messages))
        logarithms = -distances.digits(distances.player_distances(state.estimates, state.game))
        is_out = state.diverged | self._team.is_teammate[:, None]
        return (state, memory), jnp.where(is_out, 0.0, logarithms).mean()


@jax.custom_vjp  # type: ignore[untyped-decorator]  # of JAX
def _damp(array: Any, factor: Any, bound: Any) -> Any:  # noqa: ARG001 - of its gradient
    """Return the same array, but cut the norm of its gradient to a bound per environment, and multiply it by a factor.

    Gradients through a window explode in some environments, whose directions would otherwise drown those of the others.
    """
    return array


def _damp_gradient(kept: Any, gradient: Any) -> Any:
    factor, bound = kept
    norm = jnp.sqrt((gradient.astype(jnp.float64) ** 2).sum(tuple(range(gradient.ndim - 1))))
    scale = factor * jnp.minimum(1.0, bound / jnp.maximum(norm, 1e-300))
    return jnp.where(jnp.isfinite(norm), gradient * scale, 0.0).astype(gradient.dtype), None, None


_damp.defvjp(lambda array, factor, bound: (array, (factor, bound)), _damp_gradient)


def train(
    settings: Settings,
    out: Path,
    progress: Callable[[int, int, float], None] | None = None,
    tracks: Sequence[Track] = (),
) -> RunSummary:
    """Train, and export; resume an interrupted run.

    The policy has the mean of the weights of the best twentieth of the run, by the digits of its episodes, because
    training may lose later what it has reached. Every minute the policy so far is written; a resumed run goes on from
    it with other episodes and a fresh optimiser. A finished run is not repeated. 64-bit numbers of JAX are switched on.

    Args:
        settings: the definition of the run.
        out: the folder for all files of the run; made if missing.
        progress: a function to call after every update with the number of updates, their total, and the digits of the
            last tenth.
        tracks: the worlds of the training, two at a time; the scenario of the settings if left out.

    Raises:
        ValueError: for an unknown scenario, or when ``out`` holds a run with other settings or a damaged one.
    """
    if (ended := read_finished_run(settings, out)) is not None:
        return ended
    jax.config.update("jax_enable_x64", True)  # noqa: FBT003 - of JAX
    began = saved = monotonic()
    tracks = tracks or [find_track(settings.scenario)]
    weights = initial_weights(np.random.default_rng(settings.seed), settings.hidden, settings.slot_hidden)
    resumed_at, steps, reached = 0, 0, -math.inf
    if (out / POLICY).exists():
        before = load(out / POLICY)
        if not isinstance(before, RecurrentPolicy):
            raise ValueError(f"{out / POLICY} is no policy of such a run; remove it to start again")
        weights, so_far = before.weights, before.training
        resumed_at, steps, reached = so_far["done"], so_far["agent_steps"], so_far["digits"]
    best = mean = weights = jax.tree.map(jnp.asarray, weights)
    rate = optax.cosine_decay_schedule(settings.rate, settings.updates, 0.02)
    optimiser = _make_optimiser(lambda count: rate(count + resumed_at))
    memory, curve = optimiser.init(weights), np.zeros((0, 2))
    key = jax.random.fold_in(jax.random.key(settings.seed), resumed_at)
    lessons = [Lesson(track, settings, jax.random.fold_in(key, i)) for i, track in enumerate(tracks)]
    write_record(out / "configuration.json", settings)
    judged = 0  # updates of the curve
    rng, groups = np.random.default_rng((settings.seed, resumed_at)), list[Any]()
    with ThreadPoolExecutor(2) as side_by_side:
        for done in range(resumed_at + 1, settings.updates + 1):
            groups = groups or np.array_split(rng.permutation(len(lessons)), min(settings.groups, len(lessons)))
            group = [lessons[index] for index in groups.pop()]
            slopes, digits = zip(*side_by_side.map(Lesson.slope, group, repeat(weights)), strict=True)
            # A mean of late weights has up to a digit more than the last ones.
            memory, weights, mean = _update(optimiser, slopes, memory, weights, mean, 20 / (done - resumed_at + 19))
            steps += sum(lesson.agent_steps for lesson in group)
            if np.isfinite(digits).any():
                curve = np.append(curve, [[steps, np.nanmean(digits)]], axis=0)
            if progress is not None:
                progress(done, settings.updates, _late_digits(curve))
            if len(curve) > judged and (done % math.ceil(settings.updates / 20) == 0 or done == settings.updates):
                recent, judged = float(curve[judged:, 1].mean()), len(curve)
                best, reached = (mean, recent) if recent >= reached else (best, reached)
            if monotonic() - saved > 60 or done == settings.updates:
                worlds = [track.name for track in tracks]
                training = {"done": done, "agent_steps": steps, "digits": reached, "worlds": worlds}
                write_atomically(out / POLICY, seal(best if judged else mean, asdict(settings) | training))
                saved = monotonic()
    if not len(curve):  # no episode has ended
        curve = np.array([[steps, lessons[0].digits()]])
    parts = [part for part in np.array_split(curve, 20) if len(part)]
    write_learning_curve(out, [part[:, 0].mean() for part in parts], [part[:, 1:].mean(0) for part in parts])
    summary = RunSummary(steps, resumed_at, monotonic() - began, _late_digits(curve))
    write_record(out / "summary.json", summary)
    return summary


def _make_optimiser(rate: Callable[[Any], Any]) -> Any:
    """Make the optimiser: Muon for stacks of matrices, and Adam, at a fifth of the rate, for all other weights."""

    def stacks(weights: Weights) -> Any:
        of_stack = MuonDimensionNumbers(reduction_axis=2, output_axis=1)
        return jax.tree.map(lambda each: of_stack if each.ndim == 3 else None, weights)

    return muon(
        rate, consistent_rms=0.2, muon_weight_dimension_numbers=stacks, adam_learning_rate=lambda count: rate(count) / 5
    )


@partial(jax.jit, static_argnums=0)
def _update(optimiser: Any, slopes: Any, memory: Any, weights: Weights, mean: Weights, share: float) -> Any:
    """Take a step along the mean slope; return the optimiser's memory, the weights and their running mean."""
    # Steps along slopes of single worlds undo each other.
    slope = jax.tree.map(lambda *each: sum(each) / len(slopes), *map(_clip, slopes))
    change, memory = optimiser.update(slope, memory, weights)
    weights = optax.apply_updates(weights, change)
    return memory, weights, jax.tree.map(lambda old, new: old + share * (new - old), mean, weights)


def _clip(slope: Weights) -> Weights:
    """Shorten a slope to norm 1 if it is longer; one that is not finite becomes 0."""
    norm = jnp.sqrt(sum(jnp.vdot(leaf, leaf) for leaf in jax.tree.leaves(slope)))
    return jax.tree.map(lambda leaf: jnp.where(jnp.isfinite(norm), leaf / jnp.maximum(norm, 1.0), 0.0), slope)


def _late_digits(curve: Any) -> float:
    return float(curve[-max(1, len(curve) // 10) :, 1].mean()) if len(curve) else -math.inf
