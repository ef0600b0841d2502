"""Policies in Stable-Baselines3 archives (.zip). Loading an archive executes code in it: load only trusted files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from ptne_env.perception.fields import LOG_SCALE_UNIT, SMALLEST_SCALE
from ptne_env.perception.observation import Interface, ObservationLayout
from ptne_env.perception.policy import NetworkPolicy, PolicyFileError
from ptne_env.shared.files import require_file


def load_archive(path: str, layout: ObservationLayout | None = None) -> NetworkPolicy:
    """Load the policy network of a model of any algorithm of Stable-Baselines3. This executes code in the file.

    Torch is set to one thread, so that the same bits come out in every run. The interface is recognised by the spaces.

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
    observations, actions = network.observation_space, network.action_space
    if not all(isinstance(space, spaces.Box) and len(space.shape) == 1 for space in (observations, actions)):
        raise PolicyFileError(f"{path} was not trained on one player's observations and actions of ptne_env")
    # The only entry of an observation that goes down to this number is the logarithm of the scale.
    is_scaled = np.isclose(observations.low, math.log10(SMALLEST_SCALE) / LOG_SCALE_UNIT).any()
    interface = Interface("scaled" if is_scaled else "physical")
    made_for = {"interface": interface, "size": len(observations.low), "action_size": len(actions.low)}
    policy = NetworkPolicy(network.predict, made_for, Path(path).stem)
    return policy if layout is None else policy.with_layout(layout)
