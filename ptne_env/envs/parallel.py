"""The PettingZoo environments: one world whose N agents act at once, or one after the other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from numpy.ma import MaskedArray
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils.conversions import parallel_to_aec_wrapper
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from ptne_env.envs.rendering import Renderer
from ptne_env.envs.simulation import Simulation, override_fields, player_encoder, read_estimates, require_options
from ptne_env.perception.encoder import NonFiniteActionError, find_action_fault
from ptne_env.perception.fields import OBSERVATION_BOUND, InterfaceKind
from ptne_env.perception.observation import Interface, ObservationLayout
from ptne_env.shared.arrays import Float32Array, FloatArray, require_count
from ptne_env.world import dynamics
from ptne_env.world.dynamics import State
from ptne_env.world.rewards import RewardChoice
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import World

AgentInfo = dict[str, Any]

_SINGLE = np.dtype(np.float32)


class NashSeekingEnv(ParallelEnv[str, Float32Array, Float32Array]):
    """N players of a noncooperative game that must reach its Nash equilibrium by a deadline.

    Agents are ``player_0`` … ``player_{N-1}`` and live until the episode ends. It is ``terminated`` after K steps to
    the deadline and the hold phase, because time is observed, and when an estimate or own gradient leaves ±5e5
    (``info["diverged"]``). It is ``truncated`` only when ``max_cycles`` cuts it earlier.

    Each agent's info holds the same numpy scalars after a reset and after every step: ``diverged``, ``clipped`` (the
    number of entries of its action beyond the limits), ``is_success`` (whether the relative distance of all estimates
    is now at most 0.5 %) and each reward term, unweighted, such as ``reward_digits``.

    Args:
        scenario: the name of a scenario or track (``ptne list`` shows them), or a scenario.
        interface: ``"scaled"`` or ``"physical"``, or the interface of a policy, such as ``laws.Static.interface``; see
            :class:`~ptne_env.perception.observation.ObservationLayout`.
        reward: the name of a reward term (``digits``, ``tracking``, ``payoff``, ``regret``), or weights by name; or a
            function of (before, after, world), a :data:`~ptne_env.world.rewards.RewardFunction`.
        max_cycles: the number of steps after which the episode is truncated.
        render_mode: ``None``, ``"human"`` or ``"rgb_array"``.
        **overrides: fields of the scenario to change, such as ``start="paper"``, ``hold_steps=50`` or
            ``deadline=2.0``, and ``players``, as in :func:`~ptne_env.world.catalogue.get_scenario`.

    Attributes:
        scenario: the physics.
        world: the world that was built from the scenario.
        layout: the layout of observations and actions, from which laws and learned policies are built.
        render_mode: the render mode.
        state_space: the space of :meth:`state`, a float32 Box.
        np_random: a generator for wrappers, seeded by :meth:`reset`; no draw from it changes an episode.

    Raises:
        TypeError: for an unknown keyword, naming similar ones, or all.
        ValueError: for an unknown name, or an invalid value; the message says what is expected.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "ptne_v0",
        "render_modes": ["human", "rgb_array"],
        "is_parallelizable": True,
        "render_fps": 30,
    }

    def __init__(
        self,
        scenario: str | Scenario = "energy",
        *,
        interface: InterfaceKind | Interface = "scaled",
        reward: RewardChoice = "digits",
        max_cycles: int | None = None,
        render_mode: str | None = None,
        **overrides: Any,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            modes = ", ".join(self.metadata["render_modes"])
            raise ValueError(f"unknown render_mode {render_mode!r}; choose None or one of {modes}")
        self.scenario = override_fields(scenario, overrides, NashSeekingEnv)
        name = f"ptne_{self.scenario.name.replace('-', '_')}_v0"
        self.metadata = {**type(self).metadata, "name": name}  # type: ignore[misc]  # PettingZoo reads the name from each instance
        self.render_mode = render_mode
        self.world = World(self.scenario)
        encoder = player_encoder(self.world, interface)
        self.layout: ObservationLayout = encoder.layout
        self._simulation = Simulation(encoder, reward=reward, max_cycles=max_cycles)
        self.possible_agents = [f"player_{index}" for index in range(self.world.game.num_players)]
        self.agents: list[str] = []
        self.observation_spaces = {agent: self.layout.observation_space() for agent in self.possible_agents}
        self.action_spaces = {agent: self.layout.action_space() for agent in self.possible_agents}
        n, players = self.world.game.dimension, len(self.possible_agents)
        self.state_space = spaces.Box(
            -OBSERVATION_BOUND, OBSERVATION_BOUND, (players * (n + players) + 4,), dtype=np.float32
        )
        self._renderer = Renderer(self.world, render_mode) if render_mode else None
        self._actions_shape = (1, players, self.layout.action_size)
        self._table: tuple[Float32Array, list[Float32Array]] | None = None
        self.np_random = np.random.default_rng()

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the table of observations, whose rows, which are views, would become separate arrays in a copy."""
        return {**self.__dict__, "_table": None}

    @property
    def max_cycles(self) -> int | None:
        """The number of steps after which the episode is truncated, or ``None``; may be set at any time."""
        return self._simulation.max_cycles

    @max_cycles.setter
    def max_cycles(self, value: int | None) -> None:
        self._simulation.max_cycles = None if value is None else require_count("max_cycles", value, 1)

    def observation_space(self, agent: str) -> spaces.Box:
        """Return the agent's own Box, the same object on every call."""
        return self._find_space(self.observation_spaces, agent)

    def action_space(self, agent: str) -> spaces.Box:
        """Return the agent's own Box, the same object on every call."""
        return self._find_space(self.action_spaces, agent)

    def _find_space(self, spaces_by_agent: Mapping[str, spaces.Box], agent: str) -> spaces.Box:
        if agent not in spaces_by_agent:
            raise KeyError(f"unknown agent {agent!r}: agents are player_0 to {self.possible_agents[-1]}")
        return spaces_by_agent[agent]

    @property
    def strategies(self) -> FloatArray:
        """The strategies x now, shape (n,), float64."""
        return dynamics.strategies(self._simulation.current)[:, 0]

    @property
    def estimates(self) -> FloatArray:
        """The estimates of all players now, shape (N, n), float64, row i being x^i."""
        return self._simulation.current.estimates[:, :, 0].T.copy()

    @property
    def nash_equilibrium(self) -> FloatArray:
        """The equilibrium x* of the game that is played, shape (n,), float64.

        Raises:
            RuntimeError: before the first reset, where the scenario draws games.
        """
        return self._simulation.nash_equilibria[:, 0].copy()

    @property
    def time(self) -> float:
        """The time t now, in seconds."""
        return float(self.world.clock.t[self._simulation.current.step[0]])

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Float32Array], dict[str, AgentInfo]]:
        """Start an episode.

        Args:
            seed: the seed of all random draws from here on, and of :attr:`np_random`; ``None`` continues the generators
                of the last seed.
            options: ``{"estimates": table}`` starts from these estimates, shape (N, n), row i being x^i(0), in place of
                drawn ones. The key ``options`` of PettingZoo's conformance tests is ignored.

        Raises:
            TypeError: when the options are not a dictionary.
            ValueError: for an invalid seed, an unknown option, or estimates of the wrong shape or out of range.
        """
        table = require_options(options, "estimates").get("estimates")
        estimates = None if table is None else read_estimates(self.layout, 1, table)
        self._simulation.begin(self._simulation.draw([seed], estimates=estimates))
        if seed is not None:
            self.np_random = np.random.default_rng(seed)
        self.agents = self.possible_agents.copy()
        if self._renderer is not None:
            self._renderer.reset(self._simulation.current)
        first = {"diverged": np.False_, "clipped": np.int64(0), "is_success": self._simulation.is_success()[0]}
        first |= dict.fromkeys(self._simulation.reward_names, np.float64(0))
        # Copies, because a view gives its policy the observations of all players, in the attribute ``base``.
        rows = map(np.ndarray.copy, self._simulation.observe()[0])
        observations = dict(zip(self.agents, rows, strict=True))
        return observations, {agent: first.copy() for agent in self.agents}

    def step(
        self, actions: dict[str, Float32Array]
    ) -> tuple[dict[str, Float32Array], dict[str, float], dict[str, bool], dict[str, bool], dict[str, AgentInfo]]:
        """Hold all players' inputs for one step.

        Args:
            actions: an action per live agent, finite numbers of shape (action size,). Entries beyond the limits are
                clipped and counted in ``info["clipped"]``.

        Returns:
            Observations, rewards, terminations, truncations and infos by agent; five empty dictionaries if there are no
            actions after the end of an episode.

        Raises:
            RuntimeError: before the first reset, and for actions after the end of an episode.
            ValueError: when an agent is missing or unknown, or an action has a wrong shape or dtype, is masked or not
                finite; the state stays as it was.
        """
        agents = self.agents
        if not agents:
            if self._simulation.state is None or actions != {}:
                raise RuntimeError("no episode is running: call reset() before step()")
            return {}, {}, {}, {}, {}
        if self._table is None:  # making the views of its rows takes time
            table = np.empty((1, len(agents), self.layout.size), dtype=np.float32)
            self._table = table, list(table[0])
        table, rows = self._table
        try:
            outcome = self._simulation.step(self._stack(actions), table)
        except NonFiniteActionError:
            raise self._action_error(actions) from None
        diverged, is_success = outcome.diverged[0], outcome.is_success[0]
        name, *others = self._simulation.reward_names
        values, *terms = outcome.terms.values()
        observations, infos = dict[str, Float32Array](), dict[str, AgentInfo]()
        for agent, row, count, value in zip(agents, rows, outcome.clipped[0], values.ravel(), strict=True):
            observations[agent] = row.copy()
            infos[agent] = {"diverged": diverged, "clipped": count, "is_success": is_success, name: value}
        for name, values in zip(others, terms, strict=True):
            for info, value in zip(infos.values(), values.ravel(), strict=True):
                info[name] = value
        rewards = dict(zip(agents, outcome.rewards.ravel().tolist(), strict=True))
        terminated, truncated = outcome.terminated.item(), outcome.truncated.item()
        if terminated or truncated:
            self.agents = []
        if self._renderer is not None:
            self._renderer.record(self._simulation.current)
        return observations, rewards, dict.fromkeys(agents, terminated), dict.fromkeys(agents, truncated), infos

    def state(self) -> Float32Array:
        """Return a global view for centralised critics: all estimates by player, the active adjacency, and the clock.

        Returns:
            A float32 vector of length N n + N² + 4, in which the clock is (t/T, s, Θ_k, Δt_k/T).
        """
        state, clock = self._simulation.current, self.world.clock
        step = int(state.step[0])
        adjacency = self.world.topology.graphs[int(dynamics.active_mode(self.world, state)[0])].adjacency
        times = [clock.t[step] / clock.deadline, clock.s[step], clock.theta[step], clock.dt[step] / clock.deadline]
        return np.concatenate([state.estimates[:, :, 0].T.ravel(), adjacency.ravel(), times]).astype(np.float32)

    def get_state(self) -> State:
        """Return the state now, a batch of one, for :func:`ptne_env.world.dynamics.step` and :meth:`set_state`.

        Its arrays are its own.

        Raises:
            RuntimeError: before the first reset.
        """
        return dynamics.copy(self._simulation.current)

    def set_state(self, state: State) -> None:
        """Continue the episode from a state, a batch of one of the same world; its game may be another one.

        So ``env.set_state(env.get_state()._replace(game=game))`` changes the game between two steps. The random
        generators stay as they are, so the next reset draws as if this had not been called.

        Raises:
            ValueError: for a state of another world or of several environments; the state stays as it was.
        """
        self._simulation.set_state(state)
        state = self._simulation.current
        self.agents = [] if dynamics.is_over(self.world, state)[0] else self.possible_agents.copy()
        if self._renderer is not None:
            self._renderer.reset(state)

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Return a picture of the episode so far, (height, width, 3) uint8; the mode ``human`` shows it in a window.

        Raises:
            RuntimeError: without a render mode, or before the first reset.
            ImportError: when matplotlib is missing, naming the extra to install.
        """
        if self._renderer is None:
            raise RuntimeError("to render, create the environment with render_mode='rgb_array' or 'human'")
        self._simulation.current  # noqa: B018 - raises before the first reset
        return self._renderer.draw()

    def close(self) -> None:
        """Close the window, if one is open."""
        if self._renderer is not None:
            self._renderer.close()

    def _stack(self, actions: Mapping[str, Any]) -> npt.NDArray[np.floating]:
        """Return all actions in the order of the agents, shape (1, N, action size)."""
        try:
            rows = [actions[agent] for agent in self.agents]
            stacked = np.array(rows)[None]
        except (KeyError, IndexError, TypeError, ValueError):
            raise self._action_error(actions) from None
        if stacked.shape != self._actions_shape or len(actions) != len(rows):
            raise self._action_error(actions)
        for row in rows:
            if type(row) is np.ndarray and row.dtype is _SINGLE:  # nearly always, and dtypes are one object
                continue
            array = np.asanyarray(row)
            if array.dtype.kind not in "fiu" or isinstance(array, MaskedArray):
                raise self._action_error(actions)
        return stacked if stacked.dtype.kind == "f" else stacked.astype(np.float64)

    def _action_error(self, actions: Mapping[str, Any]) -> ValueError:
        """Return an error that names what is wrong with actions, agent by agent."""
        if not isinstance(actions, Mapping):
            return ValueError(f"step() needs a dictionary with one action per agent, got a {type(actions).__name__}")
        missing = [agent for agent in self.agents if agent not in actions]
        unknown = [agent for agent in actions if agent not in self.agents]
        if missing or unknown:
            return ValueError(
                f"step() needs one action per live agent; missing: {', '.join(missing) or 'none'}; unknown: "
                f"{', '.join(map(str, unknown)) or 'none'}; live: {', '.join(self.agents)}"
            )
        faults = {agent: find_action_fault(actions[agent], self._actions_shape[2:]) for agent in self.agents}
        texts = [f"the action of {agent} {fault}" for agent, fault in faults.items() if fault]
        return ValueError("; ".join(texts[:3]) + f"; and {len(texts) - 3} more players" * (len(texts) > 3))


parallel_env = NashSeekingEnv
"""PettingZoo's name for the function that makes a ParallelEnv."""


def aec_env(scenario: str | Scenario = "energy", **arguments: Any) -> AECEnv:
    """Return PettingZoo's turn-based (AEC) form, in which players act one after the other on the same observation.

    The order of calls is checked. Arguments and errors are those of :func:`ptne_env.parallel_env`.
    """
    return OrderEnforcingWrapper(_TurnBasedEnv(parallel_env(scenario, **arguments)))


class _TurnBasedEnv(parallel_to_aec_wrapper):
    """PettingZoo's conversion, which keeps actions until the last player has acted; here each is checked at once."""

    def step(self, action: Any) -> None:
        agent = self.agent_selection
        is_alive = not (self.terminations[agent] or self.truncations[agent])
        if is_alive and (fault := find_action_fault(action, self.action_space(agent).shape)):
            raise ValueError(f"the action of {agent} {fault}")
        super().step(action)
