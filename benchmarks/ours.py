"""Our contenders, the parts of a step, and law rollouts."""

from __future__ import annotations

import math
import tracemalloc
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np

from benchmarks.peers import MissingPeerError, iter_forever
from benchmarks.timing import Contender, Plan, seconds_per_call
from ptne_env import laws, parallel_env
from ptne_env.envs.vector import VectorParallelEnv
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.rollout import rollout
from ptne_env.perception.encoder import Encoder, make_encoder
from ptne_env.perception.observation import Interface, InterfaceKind
from ptne_env.shared.arrays import Float32Array
from ptne_env.world import dynamics, fused
from ptne_env.world.catalogue import get_scenario
from ptne_env.world.dynamics import State
from ptne_env.world.rewards import Reward
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import World

StepPath = Literal["compiled", "numpy"]

_BATCHES = 16
"""Random joint actions, drawn before the clock runs, and as many of the opposite sign: their mean is 0, so estimates
diffuse, as with fresh draws, and do not drift."""


def actions(bound: float, shape: tuple[int, ...]) -> Iterator[Float32Array]:
    """Endless random actions from the whole box."""
    generator = np.random.default_rng(0)
    half = [generator.uniform(-bound, bound, shape).astype(np.float32) for _ in range(_BATCHES)]
    endless: Iterator[Float32Array] = iter_forever([*half, *(-batch for batch in half)])
    return endless


def use(path: StepPath) -> None:
    """Make all steps compiled where that is possible, or all by numpy."""
    fused.PATIENCE = 0.0 if path == "compiled" else math.inf


def by(path: StepPath, contender: Contender) -> Contender:
    """The contender with compiled steps, or with those of numpy and a name that says so."""
    name = contender.name if path == "compiled" else f"{contender.name}, numpy"
    return replace(contender, name=name, prepare=partial(use, path))


def single(interface: InterfaceKind) -> Contender:
    """One PettingZoo environment of the scenario ``energy``."""
    env = parallel_env("energy", interface=interface)
    env.reset(seed=0)
    agents = env.possible_agents
    tables = actions(env.layout.action_bound, (len(agents), env.layout.action_size))
    turn = iter_forever([dict(zip(agents, next(tables), strict=True)) for _ in range(256)])

    def step() -> None:
        if not env.agents:
            env.reset()
        env.step(next(turn))

    return Contender(f"ptne_env, {interface}", len(agents), step)


def dictionaries() -> Contender:
    """The five dictionaries that a step returns, built from given values: the cost of the API alone."""
    env = parallel_env("energy")
    agents, size = env.possible_agents, env.layout.size
    values, clipped = [0.0] * len(agents), [np.int64(0)] * len(agents)
    told = [np.float64(0)] * len(agents)

    def step() -> object:
        infos: dict[str, dict[str, Any]] = {
            agent: {
                "diverged": np.False_,
                "clipped": clipped[index],
                "is_success": np.False_,
                "reward_digits": told[index],
            }
            for index, agent in enumerate(agents)
        }
        return (
            dict(zip(agents, np.empty((len(agents), size), dtype=np.float32), strict=True)),
            dict(zip(agents, values, strict=True)),
            dict.fromkeys(agents, False),
            dict.fromkeys(agents, False),
            infos,
        )

    return Contender("five dictionaries alone", len(agents), step)


def vector(interface: InterfaceKind, num_envs: int, scenario: str | Scenario = "energy") -> Contender:
    """The vector environment; finished episodes are reset."""
    env = VectorParallelEnv(scenario, num_envs, interface=interface)
    env.reset(seed=0)
    turn = actions(env.layout.action_bound, (num_envs, env.num_players, env.layout.action_size))

    def step() -> None:
        outcome = env.step(next(turn))
        over = outcome.terminated | outcome.truncated
        if over.any():
            env.reset(mask=over)

    return Contender(f"ptne_env, {interface}", num_envs * env.num_players, step)


def slots(interface: InterfaceKind, num_envs: int) -> Contender:
    """The Stable-Baselines3 ``VecEnv``.

    Raises:
        MissingPeerError: when Stable-Baselines3 is not installed.
    """
    try:
        from ptne_env.envs.sb3 import PlayerVecEnv
    except ImportError as error:
        raise MissingPeerError(f"the adapter of Stable-Baselines3 is left out: {error}") from error
    env = PlayerVecEnv("energy", num_envs, interface=interface, seed=0)
    env.reset()
    turn = actions(env.layout.action_bound, (env.num_envs, env.layout.action_size))
    return Contender(f"ptne_env, {interface}", env.num_envs, lambda: env.step(next(turn)))


def tensordicts(interface: InterfaceKind, num_envs: int, *, is_wrapped: bool = False) -> Contender:
    """TorchRL's batched environment, or as many environments in series, each through its wrapper of PettingZoo.

    Raises:
        MissingPeerError: when TorchRL is not installed.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the wrapper asks for an older PettingZoo
        try:
            from torchrl.envs import PettingZooWrapper, SerialEnv

            from ptne_env.envs.torchrl import TorchRLEnv
        except ImportError as error:
            raise MissingPeerError(f"TorchRL is left out: {error}; to compare with it: pip install torchrl") from error
        env = (
            SerialEnv(num_envs, lambda: PettingZooWrapper(parallel_env("energy", interface=interface)))
            if is_wrapped
            else TorchRLEnv("energy", num_envs, interface=interface)
        )
        following = env.reset()
    pool = [env.full_action_spec.rand() for _ in range(_BATCHES)]
    turn, agents = iter_forever(pool), pool[0]["player", "action"].shape[:-1].numel()

    def step() -> None:
        nonlocal following
        _, following = env.step_and_maybe_reset(following.update(next(turn)))

    name = "TorchRL's PettingZooWrapper" if is_wrapped else f"ptne_env, {interface}"
    return Contender(name, agents, step)


def parts(interface: InterfaceKind, num_envs: int, plan: Plan, scenario: str | Scenario = "energy") -> dict[str, float]:
    """Microseconds of each part of a step of ``num_envs`` environments; each part runs alone, in a warm cache."""
    world, encoder, reward, state = _world(interface, num_envs, scenario)
    reward.reset(state)
    encoder.observe(state)
    layout = encoder.layout
    turn = actions(layout.action_bound, (num_envs, layout.num_players, layout.action_size))
    played = next(turn)
    inputs = encoder.decode(played, state)
    after = dynamics.step(world, state, inputs)
    calls: dict[str, Callable[[], object]] = {
        "decode actions": lambda: encoder.decode(played, state),
        "transition": lambda: dynamics.step(world, state, inputs),
        "reward": lambda: reward.total(reward.step(after)),
        "observe": lambda: encoder.observe(after),
    }
    if fused.kernels() is not None and fused.qualifies(encoder, num_envs):
        compiled, out = fused.FusedStep(encoder, num_envs), encoder.observe(state)
        compiled.move(state, played, out)
        calls["all but the reward, compiled"] = lambda: compiled.move(None, next(turn), out)
    return {name: 1e6 * seconds_per_call(call, plan) for name, call in calls.items()}


def _world(interface: InterfaceKind, num_envs: int, scenario: str | Scenario) -> tuple[World, Encoder, Reward, State]:
    world = World(get_scenario(scenario))
    state = EpisodeSet(num_envs).initial_state(world)
    return world, make_encoder(world, Interface(interface)), Reward(world), state


def memory(interface: InterfaceKind, num_envs: int, scenario: str | Scenario = "energy") -> dict[str, float]:
    """Bytes per environment of a vector environment: held between steps, and at the peak of a step."""
    layout = VectorParallelEnv(scenario, 1, interface=interface).layout  # also builds the shared tables
    played = np.zeros((num_envs, layout.num_players, layout.action_size), dtype=np.float32)
    tracemalloc.start()
    try:
        env = VectorParallelEnv(scenario, num_envs, interface=interface)
        env.reset(seed=0)
        env.step(played)
        held = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        env.step(played)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    return {"held": held / num_envs, "peak": peak / num_envs}


def law_rollouts(plan: Plan) -> list[Contender]:
    """Rollouts of laws over episodes of ``random-energy``: environment, law and metrics together."""
    episodes = 10 if plan.quick else 1000
    world = World(get_scenario("random-energy"))
    start = EpisodeSet(episodes).initial_state(world)
    encoder = make_encoder(world, Interface("physical"))
    agent_steps = episodes * world.game.num_players * world.clock.total_steps
    policies = {"static": laws.Static(encoder.layout), "adaptive": laws.Adaptive(encoder.layout)}
    return [
        Contender(f"{name} law, {episodes} episodes", agent_steps, partial(rollout, policy, encoder, start))
        for name, policy in policies.items()
    ]
