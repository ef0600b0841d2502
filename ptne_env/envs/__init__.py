"""Adapters, without physics, to PettingZoo, Gymnasium, Stable-Baselines3, TorchRL, BenchMARL and PufferLib."""

from ptne_env.envs.parallel import NashSeekingEnv as NashSeekingEnv
from ptne_env.envs.parallel import parallel_env as parallel_env
from ptne_env.envs.vector import VectorBuffers as VectorBuffers
from ptne_env.envs.vector import VectorParallelEnv as VectorParallelEnv
from ptne_env.envs.vector import VectorStep as VectorStep
