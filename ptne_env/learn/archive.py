"""Policies in Stable-Baselines3 archives (.zip). Loading an archive executes code in it: load only trusted files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from ptne_env.learn.learned import PolicyFileError, PolicyLayoutError, in_blocks
from ptne_env.perception.observation import LOG_SCALE_UNIT, SMALLEST_SCALE, Interface, ObservationLayout
from ptne_env.shared.arrays import BoolArray, Float32Array
from ptne_env.shared.files import require_file


class ArchivePolicy:
    """The policy network of a saved model of any algorithm of Stable-Baselines3.

    :func:`load_archive` makes one.

    Attributes:
        interface: of the policy, recognised by its spaces.
    """

    def __init__(self, path: Path, network: Any) -> None:
        self.path = path
        self._network = network
        self.interface = _interface(path, network)

    def require(self, layout: ObservationLayout) -> None:
        """Check that the policy can act in an environment of this layout.

        Raises:
            PolicyLayoutError: naming the differences.
        """
        mine = (*self._network.observation_space.shape, *self._network.action_space.shape)
        if mine != (layout.size, layout.action_size):
            raise PolicyLayoutError(
                f"{self.path.name} has observations and actions of lengths {mine[0]} and {mine[1]}, the environment's "
                f"have {layout.size} and {layout.action_size}"
            )

    def predict(
        self,
        observation: npt.NDArray[np.float32],
        state: Any = None,
        episode_start: BoolArray | None = None,
        deterministic: bool = False,  # noqa: FBT001, FBT002 - Stable-Baselines3's signature
    ) -> tuple[Float32Array, Any]:
        """The network's actions; see :meth:`ptne_env.perception.policy.Policy.predict`."""
        rows = np.atleast_2d(observation)
        actions, state = self._network.predict(
            in_blocks(rows),
            None if state is None else tuple(in_blocks(part, axis=1) for part in state),
            None if episode_start is None else in_blocks(np.atleast_1d(episode_start)),
            deterministic,
        )
        if state is not None:  # of a recurrent network: arrays of shape (layers, rows, units)
            state = tuple(part[:, : len(rows)] for part in state)
        return (actions[0] if np.ndim(observation) == 1 else actions[: len(rows)]), state


def _interface(path: Path, network: Any) -> Interface:
    """The interface of a network's training, recognised by its spaces."""
    observations, actions = network.observation_space, network.action_space
    if not all(isinstance(space, spaces.Box) and len(space.shape) == 1 for space in (observations, actions)):
        raise PolicyFileError(f"{path} was not trained on one player's observations and actions of ptne_env")
    # The only entry of an observation that goes down to this number is the logarithm of the scale.
    is_scaled = np.isclose(observations.low, math.log10(SMALLEST_SCALE) / LOG_SCALE_UNIT).any()
    return Interface("scaled" if is_scaled else "physical")


def load_archive(path: str, layout: ObservationLayout | None = None) -> ArchivePolicy:
    """Load a model that Stable-Baselines3 saved. This executes code that is stored in the file.

    Torch is set to one thread, so that the same bits come out in every run.

    Args:
        path: the archive.
        layout: of the environment in which the policy must be able to act; not checked if left out.

    Raises:
        FileNotFoundError: when there is no such file.
        PolicyFileError: when it is no archive of Stable-Baselines3, or of a model of other environments or another
            layout.
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
    policy = ArchivePolicy(Path(path), network)
    if layout is not None:
        policy.require(layout)
    return policy
