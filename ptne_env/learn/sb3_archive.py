"""Models of Stable-Baselines3 as policies. Loading an archive (.zip) executes code in it: load only trusted files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from ptne_env.perception.fields import LOG_SCALE_UNIT, SMALLEST_SCALE
from ptne_env.perception.observation import Interface, LayoutError, ObservationLayout
from ptne_env.perception.policy import NetworkPolicy, Policy, PolicyFileError
from ptne_env.shared.files import require_file


def load_archive(path: str, layout: ObservationLayout | None = None) -> NetworkPolicy:
    """Load the policy network of a model of any algorithm of Stable-Baselines3. This executes code in the file.

    Torch is set to one thread, so that the same bits come out in every run. The interface is recognised by the spaces.
    The policy must be able to act with a ``layout``, if one is given.

    Raises:
        FileNotFoundError: when there is no such file.
        PolicyFileError: when the file is no archive of Stable-Baselines3, or its model is of other environments.
        LayoutError: when the policy was made for another layout, or was trained on normalised observations, whose
            statistics no archive has.
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
    _require_raw(observations, data.get("_last_obs"))
    # The only entry of an observation that goes down to this number is the logarithm of the scale.
    is_scaled = np.isclose(observations.low, math.log10(SMALLEST_SCALE) / LOG_SCALE_UNIT).any()
    interface = Interface("scaled" if is_scaled else "physical")
    made_for = {"interface": interface, "size": len(observations.low), "action_size": len(actions.low)}
    policy = NetworkPolicy(network.predict, made_for, Path(path).stem)
    if layout is None:
        return policy
    require_one_observation(layout, observations, actions)
    return policy.with_layout(layout)


def as_trained(model: Any) -> Policy:
    """Return a policy that plays a model as it was trained, with the statistics of its ``VecNormalize``.

    Anything that is no model of Stable-Baselines3 is returned as it is.

    Raises:
        LayoutError: when the model was trained on normalised observations, and has no statistics of them.
    """
    if (normaliser := getattr(model, "get_vec_normalize_env", lambda: None)()) is not None:
        return NetworkPolicy(lambda rows, *others: model.predict(normaliser.normalize_obs(rows), *others))
    _require_raw(getattr(model, "observation_space", None), getattr(model, "_last_obs", None))
    policy: Policy = model
    return policy


def require_one_observation(layout: ObservationLayout, observations: Any, actions: Any) -> None:
    """Check by the spaces of a model that it was not trained on several observations at once.

    Raises:
        LayoutError: when it was.
    """
    size, of_all = getattr(observations, "shape", (0,))[0], (layout.num_players * layout.action_size,)
    # JointEnv is recognised by its actions, because its interface may be another.
    if size != layout.size and (getattr(actions, "shape", None) == of_all or (size and size % layout.size == 0)):
        raise LayoutError(
            "it was trained on several observations at once, those of all players (JointEnv) or of several steps "
            "(VecFrameStack), and a player has one: train one policy for every player, on "
            "PlayerVecEnv without a stack; what it needs of the past is the state of its predict"
        )


def _require_raw(space: Any, last: Any) -> None:
    """Refuse a model whose last observations in training, if it has any, are outside of its space of observations."""
    if last is None or not isinstance(space, spaces.Box) or not ((last < space.low) | (last > space.high)).any():
        return
    raise LayoutError(
        "it was trained on observations that a wrapper changed, such as VecNormalize, whose statistics the model does "
        "not have; load it with them, and give the model: PPO.load('model.zip', env=VecNormalize.load('statistics.pkl'"
        ", PlayerVecEnv('random-energy')))"
    )
