"""Prescribed-time Nash-equilibrium seeking as a multi-agent environment, with the analytical laws beside it.

>>> import ptne_env
>>> env = ptne_env.parallel_env("energy")
>>> observations, infos = env.reset(seed=7)
"""

from typing import TYPE_CHECKING

from ptne_env._version import __version__ as __version__
from ptne_env.envs import register_environments

if TYPE_CHECKING:
    from ptne_env import laws as laws
    from ptne_env.envs.parallel import NashSeekingEnv as NashSeekingEnv
    from ptne_env.envs.parallel import parallel_env as parallel_env
    from ptne_env.envs.vector import VectorParallelEnv as VectorParallelEnv
    from ptne_env.evaluation import PolicySpec as PolicySpec
    from ptne_env.evaluation import Results as Results
    from ptne_env.evaluation import Trajectories as Trajectories
    from ptne_env.evaluation import evaluate as evaluate
    from ptne_env.evaluation import record as record
    from ptne_env.perception.observation import Interface as Interface
    from ptne_env.perception.observation import ObservationLayout as ObservationLayout
    from ptne_env.perception.policy import Policy as Policy
    from ptne_env.shared.parts import FactorySpec as FactorySpec
    from ptne_env.world.catalogue import CATALOGUE as CATALOGUE
    from ptne_env.world.catalogue import get_scenario as get_scenario
    from ptne_env.world.scenario import Scenario as Scenario
else:
    # A name is imported when it is first asked for (PEP 562), because together they take long.
    _HOMES = {
        "laws": "laws",
        "envs.parallel": "NashSeekingEnv parallel_env",
        "envs.vector": "VectorParallelEnv",
        "evaluation": "PolicySpec Results Trajectories evaluate record",
        "perception.observation": "Interface ObservationLayout",
        "perception.policy": "Policy",
        "shared.parts": "FactorySpec",
        "world.catalogue": "CATALOGUE get_scenario",
        "world.scenario": "Scenario",
    }
    __all__ = [name for names in _HOMES.values() for name in names.split()]

    def __getattr__(name: str) -> object:
        from importlib import import_module, util

        if not name.startswith("_") and util.find_spec(f"{__name__}.{name}"):
            return import_module(f"{__name__}.{name}")
        for module, names in _HOMES.items():
            if name in names.split():
                globals()[name] = value = getattr(import_module(f"{__name__}.{module}"), name)
                return value
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        return sorted([*__all__, "__version__"])


register_environments()
