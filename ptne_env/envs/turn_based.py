"""PettingZoo's turn-based (AEC) form of the environment: players act one after the other on the same observation."""

from __future__ import annotations

from typing import Any

from pettingzoo import AECEnv
from pettingzoo.utils.conversions import parallel_to_aec_wrapper
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from ptne_env.envs.parallel import parallel_env
from ptne_env.world.scenario import Scenario


def aec_env(scenario: str | Scenario = "energy", **arguments: Any) -> AECEnv:
    """The turn-based form of a scenario, with PettingZoo's check of the order of calls.

    Args:
        scenario: a name of the catalogue or a scenario.
        **arguments: of :func:`ptne_env.parallel_env`.

    Raises:
        TypeError, ValueError: as :func:`ptne_env.parallel_env`.
    """
    return OrderEnforcingWrapper(parallel_to_aec_wrapper(parallel_env(scenario, **arguments)))
