"""Comparable environments of other libraries: MPE2, MPE2 through SuperSuit, VMAS and JaxMARL; each is optional."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.timing import Contender

PLAYERS = 5
"""Agents in every environment."""

EPISODE = 400
"""Steps of an episode, equal for all environments, so that resets have equal weight."""

_POOL = 64
"""Random joint actions, drawn before the clock runs."""


class MissingPeerError(ImportError):
    """A peer is not installed; the message names the command that installs it."""


def _missing(name: str, packages: str, error: ImportError) -> MissingPeerError:
    return MissingPeerError(
        f"{name} is left out: module {error.name!r} is missing; to compare with it: pip install {packages}"
    )


def mpe2() -> Contender:
    """One MPE2 ``simple_spread_v3`` parallel environment with 5 agents and its default (discrete) actions.

    Raises:
        MissingPeerError: when MPE2 is not installed.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            from mpe2 import simple_spread_v3
        except ImportError as error:
            raise _missing("MPE2", "mpe2", error) from error
        env: Any = simple_spread_v3.parallel_env(N=PLAYERS, max_cycles=EPISODE)
        env.reset(seed=0)
    pool = [{agent: int(env.action_space(agent).sample()) for agent in env.possible_agents} for _ in range(_POOL)]
    turn = iter_forever(pool)

    def step() -> None:
        if not env.agents:
            env.reset()
        env.step(next(turn))

    return Contender("MPE2 simple_spread", PLAYERS, step)


def supersuit(num_envs: int) -> Contender:
    """MPE2 ``simple_spread_v3`` as a Stable-Baselines3 vector environment through SuperSuit, in this process.

    Raises:
        MissingPeerError: when MPE2, SuperSuit or Stable-Baselines3 is not installed.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            import stable_baselines3  # noqa: F401 - SuperSuit imports it later, with an unclear error
            import supersuit as wrappers
            from mpe2 import simple_spread_v3
        except ImportError as error:
            raise _missing("MPE2 through SuperSuit", "mpe2 supersuit stable-baselines3 torch", error) from error
        env: Any = simple_spread_v3.parallel_env(N=PLAYERS, max_cycles=EPISODE)
        env = wrappers.pettingzoo_env_to_vec_env_v1(env)
        env = wrappers.concat_vec_envs_v1(env, num_envs, num_cpus=1, base_class="stable_baselines3")
        env.reset()
    slots = num_envs * PLAYERS
    generator = np.random.default_rng(0)
    turn = iter_forever([generator.integers(env.action_space.n, size=slots) for _ in range(_POOL)])
    return Contender("MPE2 through SuperSuit", slots, lambda: env.step(next(turn)))


def vmas(num_envs: int) -> list[Contender]:
    """VMAS ``dispersion`` with 5 agents on the CPU, once with one torch thread and once with two.

    It is never reset, which saves it time.

    Raises:
        MissingPeerError: when VMAS or torch is not installed.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            import torch
            from vmas import make_env
        except ImportError as error:
            raise _missing("VMAS", "vmas torch", error) from error
        env: Any = make_env(
            "dispersion", num_envs=num_envs, device="cpu", continuous_actions=True, n_agents=PLAYERS, seed=0
        )
        env.reset()
    turn = iter_forever([[env.get_random_action(agent) for agent in env.agents] for _ in range(16)])

    def contender(threads: int) -> Contender:
        return Contender(
            f"VMAS dispersion, {threads} thread{'s' * (threads > 1)}",
            num_envs * PLAYERS,
            lambda: env.step(next(turn)),
            prepare=lambda: torch.set_num_threads(threads),
        )

    return [contender(1), contender(2)]


def jaxmarl(num_envs: int, steps: int) -> Contender:
    """JaxMARL's ``MPE_simple_spread_v3`` with 5 agents, some steps in one compiled scan; episodes start again in it.

    Raises:
        MissingPeerError: when JaxMARL is not installed.
    """
    try:
        with contextlib.redirect_stdout(None):
            import jaxmarl as library
    except ImportError as error:
        raise _missing("JaxMARL", "jaxmarl", error) from error
    import jax

    with warnings.catch_warnings(), jax.enable_x64(False):  # noqa: FBT003 - as its users have it
        warnings.simplefilter("ignore")
        env: Any = library.make("MPE_simple_spread_v3", num_agents=PLAYERS)
        key = jax.random.key(0)
        _, first = jax.vmap(env.reset)(jax.random.split(key, num_envs))

    def move(carry: Any, key: Any) -> Any:
        state, seen = carry
        of_actions, of_steps = jax.random.split(key)
        draws = jax.random.randint(of_actions, (PLAYERS, num_envs), 0, 5)
        actions = dict(zip(env.agents, draws, strict=True))
        observed, state, paid, _, _ = jax.vmap(env.step)(jax.random.split(of_steps, num_envs), state, actions)
        return (state, [old + observed[agent] for old, agent in zip(seen, env.agents, strict=True)]), paid

    @jax.jit
    def run(state: Any, key: Any) -> Any:
        observed = jax.vmap(env.get_obs)(state)
        start = state, [observed[agent] for agent in env.agents]
        return jax.lax.scan(move, start, jax.random.split(key, steps))

    def step() -> None:
        with jax.enable_x64(False):  # noqa: FBT003 - as its users have it
            jax.block_until_ready(run(first, key))

    return Contender("JaxMARL simple_spread", num_envs * PLAYERS * steps, step)


def iter_forever(pool: Sequence[Any]) -> Any:
    """Members of ``pool`` in random order, the same in every run."""
    generator = np.random.default_rng(1)
    while True:
        for index in generator.integers(len(pool), size=1024).tolist():
            yield pool[index]
