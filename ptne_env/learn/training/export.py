"""Export of policies of Stable-Baselines3 to ONNX files that :func:`ptne_env.learn.load` reads."""

from __future__ import annotations

import io
import warnings
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import onnx
import stable_baselines3
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

from ptne_env._version import __version__
from ptne_env.learn.learned import Metadata, sealed
from ptne_env.perception.observation import ObservationLayout

if TYPE_CHECKING:
    from gymnasium import spaces
    from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm


def to_onnx(model: OnPolicyAlgorithm, layout: ObservationLayout, **training: Any) -> bytes:
    """The deterministic actor as an ONNX file: observations (R, size) float32 to clipped mean actions, float32.

    Args:
        model: PPO or A2C with an ``MlpPolicy`` on a flat observation.
        layout: of the environments it was trained in.
        **training: how it was trained, for the metadata.
    """
    content = io.BytesIO()
    with warnings.catch_warnings():
        # The other exporter of torch needs a further package and takes half a minute.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            _Actor(model.policy).eval(),
            (torch.zeros(2, layout.size),),
            content,  # type: ignore[arg-type]  # this exporter takes open files
            input_names=["observation"],
            output_names=["action"],
            dynamic_axes={"observation": {0: "rows"}, "action": {0: "rows"}},
            dynamo=False,
        )
    training |= {"ptne_env": __version__}
    training |= {library.__name__: library.__version__ for library in (stable_baselines3, torch, np)}
    metadata = Metadata(
        interface=layout.interface, action_dims=layout.action_dims, slots=layout.slots, training=training
    )
    return sealed(onnx.load_from_string(content.getvalue()), metadata)


class _Actor(nn.Module):
    """What ``predict`` of a model does: its mean action, clipped to the action box."""

    def __init__(self, policy: ActorCriticPolicy) -> None:
        super().__init__()
        self.policy = policy
        box = cast("spaces.Box", policy.action_space)
        self.low, self.high = torch.as_tensor(box.low), torch.as_tensor(box.high)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        features = self.policy.extract_features(observations, self.policy.pi_features_extractor)
        actions: torch.Tensor = self.policy.action_net(
            self.policy.mlp_extractor.forward_actor(cast("torch.Tensor", features))
        )
        return torch.maximum(torch.minimum(actions, self.high), self.low)
