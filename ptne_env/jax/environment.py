"""The world as pure functions: draws, transition, observations, inputs and rewards of B environments at once."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from traceback import extract_tb
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ptne_env.evaluation.episodes import episode_seed
from ptne_env.jax.records import columns, game_sampler, uniforms
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.fields import InterfaceKind
from ptne_env.perception.observation import INPUT_PER_ACTION, Interface
from ptne_env.shared import counter_random
from ptne_env.shared.arrays import require_count
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import distances, dynamics
from ptne_env.world.catalogue import get_scenario
from ptne_env.world.dynamics import State
from ptne_env.world.rewards import Reward, RewardChoice, measure_distances
from ptne_env.world.scenario import Scenario
from ptne_env.world.starts import UniformStart
from ptne_env.world.world import EpisodeRandomness, World


class JaxWorld:
    """B environments of a scenario as pure functions, which JAX compiles, maps, differentiates and scans.

    All arrays have environments last, also observations and actions: a state's estimates are (n, N, B). Nothing here
    keeps a state, so a world may be closed over by compiled functions.

    Args:
        scenario: a name, as for :func:`ptne_env.get_scenario`, or a scenario.
        interface: of :meth:`observe` and :meth:`inputs`.
        dtype: of observations. With float64 digits are differentiated to full precision; players see float32.
        pool: number of games, schedules of graphs and starts that numpy draws beforehand, where JAX cannot; a reset
            chooses among them.
        seed: draws them: trainings of different seeds share none.
        **changes: fields of the scenario to change.

    Attributes:
        numpy: the world that this one is the twin of.
        layout: of observations and actions, as for every policy.
        dtype: as given.

    Raises:
        RuntimeError: when JAX's 64-bit numbers are switched off.
        ValueError: for a scenario that cannot be built.
    """

    def __init__(
        self,
        scenario: str | Scenario = "energy",
        *,
        interface: InterfaceKind | Interface = "scaled",
        dtype: Any = jnp.float32,
        pool: int = 4096,
        seed: int = 0,
        **changes: Any,
    ) -> None:
        require_x64()
        self.numpy, self.dtype = World(get_scenario(scenario, **changes)), dtype
        self._encoder = Encoder(self.numpy, interface)
        self.layout = self._encoder.layout
        self._world = copy.copy(self.numpy)
        # Tables that a step looks up by numbers that JAX knows only when it runs.
        for name in ("mode_weights", "modes", "time_since_switch", "next_step", "is_last_step"):
            setattr(self._world, name, jnp.asarray(getattr(self._world, name)))
        self._world.clock = copy.copy(self._world.clock)
        for name in ("theta", "dt"):
            setattr(self._world.clock, name, jnp.asarray(getattr(self._world.clock, name)))
        episodes = range(require_count("pool", pool, 1))
        streams = [RandomStreams.from_seed(episode_seed(seed, episode, "train")) for episode in episodes]
        self._draw_games = game_sampler(self.numpy, streams)
        self._parts = [each if callable(each) else jnp.asarray(each) for _, each in self._encoder.parts]
        start, self._starts = self.numpy.start, None
        if not isinstance(start, UniformStart):  # a reset chooses among these, (n, N, P)
            self._starts = jnp.asarray(self.numpy.draw_estimates(streams if start.is_random else streams[:1]))
        self._schedules = self._drawn_schedules(streams)

    @partial(jax.jit, static_argnums=(0, 2))
    def reset(self, key: jax.Array, num_envs: int = 1) -> State:
        """The state at t = 0 of new episodes. That of an environment is the same for any number of them."""
        require_x64()
        require_count("num_envs", num_envs, 1)
        seed = jax.random.bits(key, (1,), jnp.uint64)
        of_episode = counter_random.words(seed, jnp.arange(num_envs, dtype=jnp.uint64))
        keys = [counter_random.child_keys(of_episode, purpose) for purpose in range(5)]
        game, start = self._draw_games(keys[0]), self.numpy.start
        if isinstance(start, UniformStart):
            unit = uniforms(keys[1], self.layout.dimension * self.layout.num_players)
            low, high = start.bounds[..., None]
            estimates = low + (high - low) * unit.reshape(self.layout.dimension, -1, num_envs)
        else:
            estimates = columns(self._starts, keys[1])
        randomness = None
        if self.numpy.has_episode_randomness:
            schedule = (None, None) if self._schedules is None else columns(self._schedules, keys[2])
            randomness = EpisodeRandomness(*schedule, *keys[3:])
        with self._naming_parts():
            return dynamics.begin(self._world, estimates, game, randomness)

    def state(self, state: State) -> State:
        """A state of the numpy world, with the same game and draws."""
        require_x64()
        return jax.tree.map(jnp.asarray, state)

    @partial(jax.jit, static_argnums=0)
    def step(self, state: State, inputs: jax.Array) -> State:
        """The next state: x_{k+1} = x_k + Θ_k u_k with all parts of the world. Inputs u_k are (n, N, B).

        An environment that leaves the range, or is given an input that is not finite, has diverged: it stays where it
        is, and no gradient passes through it. Raises ``ValueError`` for inputs of another shape.
        """
        _require_shape("inputs", inputs, state.estimates.shape)
        with self._naming_parts():
            return dynamics.step(self._world, state, inputs)

    def is_over(self, state: State) -> jax.Array:
        """Whether each episode has reached its end or diverged, shape (B,)."""
        return dynamics.is_over(self._world, state)

    @partial(jax.jit, static_argnums=0)
    def restarted(self, key: jax.Array, state: State) -> State:
        """The state, with a new episode in place of each that is over; costs nothing while none is."""
        over = self.is_over(state)

        def restart(state: State) -> State:
            fresh = self.reset(key, over.size)
            return jax.tree.map(lambda old, new: jnp.where(over, new, old), state, fresh)

        return jax.lax.cond(over.any(), restart, lambda state: state, state)

    @partial(jax.jit, static_argnums=0)
    def observe(self, state: State) -> jax.Array:
        """The observations of all players in the world's interface, shape (size, N, B)."""
        if self._world.topology.is_random or state.received is not None:
            return self._observed(state)
        # Tables are read once where all environments are at the same step, as usual: reading per environment costs more
        # than all else.
        is_together = (state.step == state.step[0]).all()
        return jax.lax.cond(
            is_together, lambda state: self._observed(state._replace(step=state.step[:1])), self._observed, state
        )

    def _observed(self, state: State) -> jax.Array:
        view, shape = self._encoder.look(self._world, state), state.estimates.shape[1:]
        parts = (
            part(view) if callable(part) else part if part.shape[2] == 1 else part[:, :, state.step]
            for part in self._parts
        )
        return jnp.concatenate([jnp.broadcast_to(part.astype(self.dtype), (len(part), *shape)) for part in parts])

    def inputs(self, state: State, actions: jax.Array) -> jax.Array:
        """The inputs within the input limit that actions (n, N, B) in the world's interface ask for, (n, N, B).

        Raises ``ValueError`` for actions of another shape.
        """
        layout, bound = self.layout, self.layout.action_bound
        _require_shape("actions", actions, state.estimates.shape)
        actions = jnp.clip(actions.astype(self.dtype), -bound, bound).astype(jnp.float64)
        if not layout.is_scaled:
            return actions
        wanted: Any = actions * (INPUT_PER_ACTION * self._encoder.look(self._world, state).scale)
        in_order = wanted[layout.ego_place.T, np.arange(layout.num_players)]
        return jnp.clip(in_order, -layout.input_limit, layout.input_limit)

    def rewards(self, before: State, after: State, reward: RewardChoice = "digits") -> jax.Array:
        """The rewards of the step from one state to the next, shape (N, B); see :mod:`ptne_env.world.rewards`.

        An episode that diverges in the step is charged for all that remain, and no more afterwards.
        """
        judge = Reward(self._world, reward)
        with self._naming_parts():
            judge.reset(before)
            return judge.total(judge.step(after))

    def digits(self, state: State) -> jax.Array:
        """The digits of each episode, −log10 of the relative distance of all its estimates, shape (B,)."""
        return distances.digits(distances.over_players(measure_distances(state)))

    def _drawn_schedules(self, streams: list[RandomStreams]) -> tuple[jax.Array, jax.Array] | None:
        """Modes and times since the switch of schedules from which a reset chooses, (K+H+1, P) each, or (1, P)."""
        if not self.numpy.topology.is_random:
            return None
        drawn = self.numpy.draw_randomness(streams)
        assert drawn is not None and drawn.modes is not None and drawn.time_since_switch is not None  # noqa: S101, PT018 - for mypy
        # Beyond the last row JAX looks up the last one: enough for graphs that are drawn once per episode.
        rows = 1 if (drawn.modes == drawn.modes[0]).all() and not drawn.time_since_switch.any() else len(drawn.modes)
        return jnp.asarray(drawn.modes[:rows]), jnp.asarray(drawn.time_since_switch[:rows])

    @contextmanager
    def _naming_parts(self) -> Iterator[None]:
        """Errors of parts that compute with numpy alone say so; those of this library compute with both."""
        try:
            yield
        except (jax.errors.JAXTypeError, jax.errors.JAXIndexError, TypeError) as error:
            frames = [frame for frame in extract_tb(error.__traceback__) if "/jax/_src/" not in frame.filename]
            raise ValueError(
                f"scenario {self.numpy.scenario.name!r} has a part that computes with numpy alone, and not with the "
                f"library of its arrays, xp = array_namespace(x): {type(error).__name__} in {frames[-1].filename}, "
                f"line {frames[-1].lineno}"
            ) from error


def _require_shape(name: str, array: Any, shape: tuple[int, ...]) -> None:
    """Raise ``ValueError`` for an array of another shape, as JAX would read beyond the ends of one without a word."""
    if np.shape(array) != shape:
        raise ValueError(f"{name} have the shape (n, N, B) = {shape}, got {np.shape(array)}")


def require_x64() -> None:
    """Raise ``RuntimeError`` unless JAX computes in float64, as the dynamics need it; the setting is never changed."""
    if not jax.config.jax_enable_x64:
        raise RuntimeError(
            "the dynamics are float64, and JAX's 64-bit numbers are off: call "
            'jax.config.update("jax_enable_x64", True) first, or set the variable JAX_ENABLE_X64=1'
        )
