"""PettingZoo's turn-based (AEC) form of the environment: players act one after the other on the same observation."""

from __future__ import annotations

from typing import Any

from pettingzoo.utils.conversions import parallel_to_aec_wrapper
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from ptne_env.envs.parallel import parallel_env
from ptne_env.envs.simulation import Duplicable
from ptne_env.world.scenario import Scenario


class TurnBasedEnv(Duplicable, OrderEnforcingWrapper):
    """The turn-based form, with PettingZoo's check of the order of calls. Make one with :func:`aec_env`."""


def aec_env(scenario: str | Scenario = "energy", **arguments: Any) -> TurnBasedEnv:
    """The turn-based form of a scenario.

    Args:
        scenario: a name of the catalogue or a scenario.
        **arguments: of :func:`ptne_env.parallel_env`.

    Raises:
        TypeError, ValueError: as :func:`ptne_env.parallel_env`.
    """
    return TurnBasedEnv(parallel_to_aec_wrapper(parallel_env(scenario, **arguments)))
