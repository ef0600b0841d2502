"""Policies in Stable-Baselines3 archives (.zip). Loading an archive executes code in it: load only trusted files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from ptne_env.perception.fields import LOG_SCALE_UNIT, SMALLEST_SCALE
from ptne_env.perception.observation import Interface, ObservationLayout
from ptne_env.perception.policy import BLOCK, PolicyFileError, RowPolicy
from ptne_env.shared.arrays import BoolArray, Float32Array
from ptne_env.shared.files import require_file


class ArchivePolicy(RowPolicy):
    """The policy network of a model of Stable-Baselines3; its interface is recognised by the spaces.

    Attributes:
        name: the name of the file, without its ending.
        interface: the interface of the policy.
    """

    block = BLOCK

    def __init__(self, name: str, network: Any) -> None:
        self.name, self._network = name, network
        # The only entry of an observation that goes down to this number is the logarithm of the scale.
        is_scaled = np.isclose(network.observation_space.low, math.log10(SMALLEST_SCALE) / LOG_SCALE_UNIT).any()
        self.interface = Interface("scaled" if is_scaled else "physical")

    @property
    def made_for(self) -> Mapping[str, Any]:
        """The interface, and the sizes of observations and actions."""
        observations, actions = self._network.observation_space, self._network.action_space
        return {"interface": self.interface, "size": len(observations.low), "action_size": len(actions.low)}

    def decide(self, rows: Float32Array, memory: Any, starts: BoolArray, *, deterministic: bool) -> tuple[Any, Any]:
        """Return the actions and the memory; see :meth:`ptne_env.perception.policy.RowPolicy.decide`."""
        return self._network.predict(rows, memory, starts, deterministic)


def load_archive(path: str, layout: ObservationLayout | None = None) -> ArchivePolicy:
    """Load the policy network of a model of any algorithm of Stable-Baselines3. This executes code in the file.

    Torch is set to one thread, so that the same bits come out in every run.

    Args:
        path: the archive.
        layout: the layout of the environment in which the policy must be able to act; not checked if left out.

    Raises:
        FileNotFoundError: when there is no such file.
        PolicyFileError: when the file is no archive of Stable-Baselines3, or its model is of other environments.
        LayoutError: when the policy was made for another layout.
        ImportError: when Stable-Baselines3 is not installed.
    """
    try:
        import torch
        from stable_baselines3.common.save_util import load_from_zip_file
    except ImportError as error:
        raise ImportError('Stable-Baselines3 archives need an extra: pip install "ptne-env[sb3]"') from error

    require_file(path)
    torch.set_num_threads(1)
    try:
        stored, parameters, _ = load_from_zip_file(path, device="cpu")
        data: dict[str, Any] = stored or {}
        arguments = dict(data["policy_kwargs"])
        if data.get("use_sde"):
            arguments["use_sde"] = True
        network = data["policy_class"](data["observation_space"], data["action_space"], lambda _: 0.0, **arguments)
        network.load_state_dict(parameters["policy"])
    except Exception as error:  # unpickling foreign bytes may raise anything
        raise PolicyFileError(f"{path} is not an archive of a Stable-Baselines3 model: {error!r}") from error
    network.set_training_mode(mode=False)
    spaces_of_model = (network.observation_space, network.action_space)
    if not all(isinstance(space, spaces.Box) and len(space.shape) == 1 for space in spaces_of_model):
        raise PolicyFileError(f"{path} was not trained on one player's observations and actions of ptne_env")
    policy = ArchivePolicy(Path(path).stem, network)
    return policy if layout is None else policy.with_layout(layout)
