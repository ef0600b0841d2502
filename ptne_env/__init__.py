"""Prescribed-time Nash-equilibrium seeking as a multi-agent environment, with the analytical laws beside it.

>>> import ptne_env
>>> env = ptne_env.parallel_env("energy")
>>> observations, infos = env.reset(seed=7)
"""

from ptne_env import laws as laws
from ptne_env._version import __version__ as __version__
from ptne_env.envs.parallel import NashSeekingEnv as NashSeekingEnv
from ptne_env.envs.parallel import parallel_env as parallel_env
from ptne_env.envs.registration import register_environments
from ptne_env.envs.vector import VectorParallelEnv as VectorParallelEnv
from ptne_env.evaluation import Entry as Entry
from ptne_env.evaluation import Results as Results
from ptne_env.evaluation import evaluate as evaluate
from ptne_env.interface import Interface as Interface
from ptne_env.interface import Layout as Layout
from ptne_env.parts import Part as Part
from ptne_env.policy import Policy as Policy
from ptne_env.scenario import CATALOGUE as CATALOGUE
from ptne_env.scenario import Scenario as Scenario
from ptne_env.scenario import get_scenario as get_scenario

register_environments()
