"""The PettingZoo environment: one world, N agents who act at once. The batch of one; the physics is in ``dynamics``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from pettingzoo import ParallelEnv

from ptne_env import distances
from ptne_env.arrays import Float32Array, FloatArray, require_count
from ptne_env.dynamics import Dynamics, State
from ptne_env.envs.rendering import Renderer
from ptne_env.interface import OBSERVATION_BOUND, ActionMode, Interface, InterfaceKind, Layout, Port
from ptne_env.rewards import Reward
from ptne_env.scenario import Scenario, get_scenario
from ptne_env.sources import Sources

AgentInfo = dict[str, Any]


class NashSeekingEnv(ParallelEnv[str, Float32Array, Float32Array]):
    """N players of a noncooperative game who must reach its Nash equilibrium by a deadline.

    Agents are ``player_0`` … ``player_{N-1}`` and live until the episode ends, which is ``terminated`` after K steps to
    the deadline and the hold phase (time is observed), or when an estimate or own gradient leaves ±5e5
    (``info["diverged"]``); ``truncated`` only when ``max_cycles`` cuts earlier.

    After a step each agent's info holds ``diverged``, ``clipped`` (entries of its action outside the box) and
    ``reward_terms`` (unweighted, by name); at the end also ``is_success``, whether the relative distance of all
    estimates is at most 0.5 %.

    Attributes:
        scenario: the physics.
        layout: what observations and actions mean; laws and learned policies are built from it.
        max_cycles: steps after which the episode is truncated, or ``None``.
        render_mode: ``None``, ``"human"`` or ``"rgb_array"``.
        state_space: of :meth:`state`, a float32 Box.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "ptne_v0",
        "render_modes": ["human", "rgb_array"],
        "is_parallelizable": True,
        "render_fps": 30,
    }

    def __init__(
        self,
        scenario: Scenario,
        *,
        interface: Interface,
        reward: str | Mapping[str, float] = "digits",
        max_cycles: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        if interface.kind == "full":
            raise ValueError(
                "the interface 'full' shows what no player can see and is for oracles in evaluations only; choose "
                "'physical' or 'local'"
            )
        if render_mode not in (None, *self.metadata["render_modes"]):
            modes = ", ".join(self.metadata["render_modes"])
            raise ValueError(f"unknown render_mode {render_mode!r}; choose None or one of {modes}")
        self.scenario = scenario
        self.metadata = {**type(self).metadata, "name": f"ptne_{scenario.name.replace('-', '_')}_v0"}  # type: ignore[misc]  # PettingZoo reads the name from each instance
        self.max_cycles = None if max_cycles is None else require_count("max_cycles", max_cycles, 1)
        self.render_mode = render_mode
        self.dynamics = Dynamics(scenario)
        self._port = Port(self.dynamics, interface)
        self._reward = Reward(self.dynamics, reward)
        self.possible_agents = [f"player_{index}" for index in range(self.dynamics.game.num_players)]
        self.agents: list[str] = []
        self.observation_spaces = {agent: self._port.observation_space() for agent in self.possible_agents}
        self.action_spaces = {agent: self._port.action_space() for agent in self.possible_agents}
        n, players = self.dynamics.game.dimension, len(self.possible_agents)
        self.state_space = spaces.Box(
            -OBSERVATION_BOUND, OBSERVATION_BOUND, (players * (n + players) + 4,), dtype=np.float32
        )
        self._sources: Sources | None = None
        self._state: State | None = None
        self._cycles = 0
        self._renderer = Renderer(self.dynamics, render_mode) if render_mode else None

    @property
    def layout(self) -> Layout:
        """What observations and actions mean."""
        return self._port.layout

    def observation_space(self, agent: str) -> spaces.Box:
        """The agent's own Box, the same object on every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Box:
        """The agent's own Box, the same object on every call."""
        return self.action_spaces[agent]

    @property
    def strategies(self) -> FloatArray:
        """The real strategies x now, shape (n,), float64."""
        return self.dynamics.strategies(self._current())[:, 0]

    @property
    def estimates(self) -> FloatArray:
        """Everybody's estimates now, row i being x^i; shape (N, n), float64."""
        return self._current().estimates[:, :, 0].T.copy()

    @property
    def nash_equilibrium(self) -> FloatArray:
        """x*, shape (n,), float64."""
        return self.dynamics.game.nash_equilibrium.copy()

    @property
    def time(self) -> float:
        """t now, in seconds."""
        return float(self.dynamics.clock.t[self._current().step[0]])

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Float32Array], dict[str, AgentInfo]]:
        """Start an episode.

        Args:
            seed: of all random draws from here on; ``None`` goes on with the generators of the last seed.
            options: ``{"estimates": table}`` starts from the given estimates, shape (N, n), row i being x^i(0), and
                draws none. Other keys are ignored.

        Raises:
            ValueError: for an invalid seed, or estimates of the wrong shape or out of range.
        """
        sources = Sources.from_seed(seed) if seed is not None or self._sources is None else self._sources
        if options and options.get("estimates") is not None:
            try:
                table = np.array(options["estimates"], dtype=np.float64)
            except (TypeError, ValueError) as error:
                raise ValueError(f"options['estimates'] must be an (N, n) table of numbers: {error}") from error
            expected = (self.dynamics.game.num_players, self.dynamics.game.dimension)
            if table.shape != expected:
                raise ValueError(f"options['estimates'] has the shape (N, n) = {expected}, got {table.shape}")
            estimates = np.ascontiguousarray(table.T)[:, :, None]
        else:
            estimates = self.dynamics.draw_estimates([sources])
        state = self.dynamics.start(estimates)
        self._sources, self._state, self._cycles = sources, state, 0
        self._reward.reset(state)
        self.agents = self.possible_agents.copy()
        if self._renderer is not None:
            self._renderer.reset(state)
            self._render_human()
        observations = self._port.observe(state)[0]
        return dict(zip(self.agents, observations, strict=True)), {agent: {} for agent in self.agents}

    def step(
        self, actions: dict[str, Float32Array]
    ) -> tuple[dict[str, Float32Array], dict[str, float], dict[str, bool], dict[str, bool], dict[str, AgentInfo]]:
        """Hold everybody's inputs for one step.

        Args:
            actions: one per live agent, finite floats of shape (action size,). Entries outside the box are clipped to
                it and counted in ``info["clipped"]``.

        Raises:
            RuntimeError: before the first reset and after the end of an episode.
            ValueError: when an agent is missing or unknown, or an action has a wrong shape, dtype or is not finite; the
                state stays as it was.
        """
        agents = self.agents
        if not agents:
            raise RuntimeError("no episode is running: call reset() before step()")
        stacked = self._stack(actions)
        before = self._current()
        clipped = self._port.clipped(stacked)[0].tolist()
        state = self.dynamics.step(before, self._port.decode(stacked, before))
        terms = self._reward.step(state)
        rewards = self._reward.total(terms)[:, 0].tolist()
        self._state = state
        self._cycles += 1

        diverged = bool(state.diverged[0])
        terminated = bool(self.dynamics.is_over(state)[0])
        truncated = not terminated and self.max_cycles is not None and self._cycles >= self.max_cycles
        columns = {name: term[:, 0].tolist() for name, term in terms.items()}
        infos: dict[str, AgentInfo] = {
            agent: {
                "diverged": diverged,
                "clipped": clipped[index],
                "reward_terms": {name: column[index] for name, column in columns.items()},
            }
            for index, agent in enumerate(agents)
        }
        if terminated or truncated:
            error = distances.estimate_distance(state.estimates, self.dynamics.game.nash_equilibrium)[0]
            success = not diverged and bool(error <= distances.SUCCESS_DISTANCE)
            for info in infos.values():
                info["is_success"] = success
            self.agents = []
        if self._renderer is not None:
            self._renderer.record(state)
            self._render_human()
        return (
            dict(zip(agents, self._port.observe(state)[0], strict=True)),
            dict(zip(agents, rewards, strict=True)),
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            infos,
        )

    def state(self) -> Float32Array:
        """A global view for centralised critics: all estimates (player by player), the active adjacency, the clock.

        Returns:
            A float32 vector of length N n + N² + 4, the clock being (t/T, s, Θ_k, Δt_k/T).
        """
        state, clock = self._current(), self.dynamics.clock
        step = int(state.step[0])
        adjacency = self.dynamics.signal.graphs[int(state.mode[0])].adjacency
        times = [clock.t[step] / clock.deadline, clock.s[step], clock.theta[step], clock.dt[step] / clock.deadline]
        return np.concatenate([state.estimates[:, :, 0].T.ravel(), adjacency.ravel(), times]).astype(np.float32)

    def render(self) -> npt.NDArray[np.uint8] | None:
        """A picture of the episode so far: (height, width, 3) uint8 in mode ``rgb_array``, a window in ``human``.

        Raises:
            RuntimeError: without a render mode, or before the first reset.
            ImportError: when matplotlib is missing, naming the extra to install.
        """
        if self._renderer is None:
            raise RuntimeError("to render, create the environment with render_mode='rgb_array' or 'human'")
        self._current()
        return self._renderer.draw()

    def close(self) -> None:
        """Close the window, if one is open."""
        if self._renderer is not None:
            self._renderer.close()

    def _render_human(self) -> None:
        if self.render_mode == "human" and self._renderer is not None:
            self._renderer.draw()

    def _current(self) -> State:
        if self._state is None:
            raise RuntimeError("the environment has no state yet: call reset() first")
        return self._state

    def _stack(self, actions: Mapping[str, Any]) -> npt.NDArray[np.floating]:
        """All actions in the order of the agents, shape (1, N, action size)."""
        expected = (self.layout.action_size,)
        if not isinstance(actions, Mapping):
            raise ValueError(f"step() needs a dictionary with one action per agent, got a {type(actions).__name__}")
        if actions.keys() != set(self.agents):
            missing = [agent for agent in self.agents if agent not in actions]
            unknown = [agent for agent in actions if agent not in self.agents]
            raise ValueError(
                f"step() needs one action per live agent; missing: {', '.join(missing) or 'none'}; unknown: "
                f"{', '.join(map(str, unknown)) or 'none'}; live: {', '.join(self.agents)}"
            )
        rows = []
        for agent in self.agents:
            row = np.asarray(actions[agent])
            if row.dtype.kind != "f":
                raise ValueError(f"the action of {agent} has the dtype {row.dtype}; expected float32")
            if row.shape != expected:
                raise ValueError(f"the action of {agent} has the shape {row.shape}; expected {expected}")
            rows.append(row)
        stacked = np.stack(rows)
        if not np.isfinite(stacked).all():
            culprits = [agent for agent, row in zip(self.agents, rows, strict=True) if not np.isfinite(row).all()]
            raise ValueError(f"the action of {', '.join(culprits)} is not finite; expected numbers without NaN or inf")
        return stacked[None]


def parallel_env(
    scenario: str | Scenario = "energy",
    *,
    interface: InterfaceKind = "physical",
    action_mode: ActionMode = "input",
    action_scale: float = 5.0,
    reward: str | Mapping[str, float] = "digits",
    max_cycles: int | None = None,
    render_mode: str | None = None,
    **overrides: Any,
) -> NashSeekingEnv:
    """The PettingZoo ParallelEnv of a scenario.

    Args:
        scenario: a name of the catalogue (``ptne list`` shows them) or a scenario.
        interface: ``"physical"`` or ``"local"``; see :class:`ptne_env.interface.Layout`.
        action_mode: ``"input"`` or ``"gains"``.
        action_scale: under ``local``, an action of 1 is this many times σ_i.
        reward: a term's name (``digits``, ``tracking``, ``payoff``, ``regret``) or weights by name.
        max_cycles: steps after which the episode is truncated.
        render_mode: ``None``, ``"human"`` or ``"rgb_array"``.
        **overrides: fields of the scenario to change, such as ``start="random"``, ``hold_steps=50``, ``deadline=2.0``.

    Raises:
        ValueError: for an unknown name or field, or an invalid value; the message says what is expected.
    """
    return NashSeekingEnv(
        get_scenario(scenario, **overrides),
        interface=Interface(interface, action_mode, action_scale),
        reward=reward,
        max_cycles=max_cycles,
        render_mode=render_mode,
    )
