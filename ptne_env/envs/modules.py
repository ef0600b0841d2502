"""PettingZoo's way to offer an environment: a module with ``env``, ``raw_env`` and ``parallel_env``."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeAlias

from pettingzoo import AECEnv
from pettingzoo.utils.conversions import parallel_to_aec_wrapper
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from ptne_env.envs.parallel import NashSeekingEnv, parallel_env

TurnBasedEnv: TypeAlias = AECEnv


class EnvironmentModule(NamedTuple):
    """The three constructors of a PettingZoo module; each takes the arguments of :func:`ptne_env.parallel_env`."""

    env: Callable[..., TurnBasedEnv]
    raw_env: Callable[..., TurnBasedEnv]
    parallel_env: Callable[..., NashSeekingEnv]


def environment_module(scenario: str) -> EnvironmentModule:
    """The constructors for a scenario of the catalogue."""
    return EnvironmentModule(partial(env, scenario), partial(raw_env, scenario), partial(parallel_env, scenario))


def raw_env(scenario: str, **arguments: Any) -> TurnBasedEnv:
    """The turn-based (AEC) form: players act one after the other on the same observation."""
    return parallel_to_aec_wrapper(parallel_env(scenario, **arguments))


def env(scenario: str, **arguments: Any) -> TurnBasedEnv:
    """The turn-based (AEC) form, with PettingZoo's check of the order of calls."""
    return OrderEnforcingWrapper(raw_env(scenario, **arguments))
