"""Prescribed-time Nash-equilibrium seeking as a multi-agent environment, with the analytical laws beside it.

>>> import ptne_env
>>> env = ptne_env.parallel_env("energy")
>>> observations, infos = env.reset(seed=7)
"""

from typing import TYPE_CHECKING

from ptne_env._version import __version__ as __version__
from ptne_env.envs.registration import register_environments

if TYPE_CHECKING:
    from ptne_env import laws as laws
    from ptne_env.envs.parallel import NashSeekingEnv as NashSeekingEnv
    from ptne_env.envs.parallel import parallel_env as parallel_env
    from ptne_env.envs.vector import VectorParallelEnv as VectorParallelEnv
    from ptne_env.evaluation import PolicySpec as PolicySpec
    from ptne_env.evaluation import Results as Results
    from ptne_env.evaluation import evaluate as evaluate
    from ptne_env.perception.observation import Interface as Interface
    from ptne_env.perception.observation import ObservationLayout as ObservationLayout
    from ptne_env.perception.policy import Policy as Policy
    from ptne_env.shared.parts import FactorySpec as FactorySpec
    from ptne_env.world.catalogue import CATALOGUE as CATALOGUE
    from ptne_env.world.catalogue import get_scenario as get_scenario
    from ptne_env.world.scenario import Scenario as Scenario
else:
    # Each name is imported when it is first asked for (PEP 562): together they take long.
    _HOMES = {
        "CATALOGUE": "world.catalogue",
        "PolicySpec": "evaluation",
        "Interface": "perception.observation",
        "ObservationLayout": "perception.observation",
        "NashSeekingEnv": "envs.parallel",
        "FactorySpec": "shared.parts",
        "Policy": "perception.policy",
        "Results": "evaluation",
        "Scenario": "world.scenario",
        "VectorParallelEnv": "envs.vector",
        "evaluate": "evaluation",
        "get_scenario": "world.catalogue",
        "laws": "laws",
        "parallel_env": "envs.parallel",
    }
    __all__ = list(_HOMES)

    def __getattr__(name: str) -> object:
        from importlib import import_module, util

        if not name.startswith("_") and util.find_spec(f"{__name__}.{name}"):
            value = import_module(f"{__name__}.{name}")
        elif name in _HOMES:
            value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})


register_environments()
