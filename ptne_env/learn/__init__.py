"""Learned policies in files: ``policy_files`` finds and loads them, and each format has a module.

- ``npz_policy``: networks that numpy runs: those of ``layers``, and those of ``recurrent`` for worlds of any size
- ``sb3_archive``: models as Stable-Baselines3 saves them, which execute code when they are loaded
"""

from ptne_env.learn.layers import Metadata as Metadata
from ptne_env.learn.policy_files import load as load
from ptne_env.learn.policy_files import shipped_names as shipped_names
from ptne_env.learn.policy_files import shipped_path as shipped_path
from ptne_env.perception.policy import PolicyFileError as PolicyFileError
