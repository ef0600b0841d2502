"""Adapters, without physics, to PettingZoo, Gymnasium and Stable-Baselines3."""

from ptne_env.envs.parallel import NashSeekingEnv as NashSeekingEnv
from ptne_env.envs.parallel import parallel_env as parallel_env
from ptne_env.envs.vector import VectorBuffers as VectorBuffers
from ptne_env.envs.vector import VectorParallelEnv as VectorParallelEnv
from ptne_env.envs.vector import VectorStep as VectorStep
