"""Export of policies to ONNX files that :func:`ptne_env.learn.load` reads.

The graphs are written node by node: a policy here is a few affine maps and tanh, and torch's exporters need three more
packages for it and change with every release.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import onnx
import stable_baselines3
import torch
from onnx import helper, numpy_helper
from stable_baselines3.common.torch_layers import FlattenExtractor
from torch import nn

from ptne_env._version import __version__
from ptne_env.learn import Metadata
from ptne_env.learn.learned import sealed
from ptne_env.learn.training.features import Products
from ptne_env.perception.observation import ObservationLayout
from ptne_env.shared.arrays import Float32Array

if TYPE_CHECKING:
    from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

_OPSET, _IR = 17, 8


def to_onnx(
    model: OnPolicyAlgorithm, layout: ObservationLayout, *, scenarios: tuple[str, ...], seed: int, digits: float
) -> bytes:
    """The deterministic actor as an ONNX file: observations (R, size) float32 to clipped mean actions, float32.

    Args:
        model: PPO or A2C with an ``MlpPolicy`` of tanh units on a flat observation.
        layout: of the environments it was trained in.
        scenarios: it was trained on, for the metadata.
        seed: of training, for the metadata.
        digits: on the validation episodes, for the metadata.

    Raises:
        ValueError: when the actor holds a layer other than these.
    """
    policy = model.policy
    layers = [*policy.mlp_extractor.policy_net, policy.action_net]
    nodes, initializers, last = _features(policy.features_extractor)
    for index, layer in enumerate(layers):
        output = f"hidden_{index}"
        if isinstance(layer, nn.Linear):
            for name, tensor in (("weight", layer.weight), ("bias", layer.bias)):
                initializers.append(numpy_helper.from_array(_array(tensor), f"{name}_{index}"))
            inputs = [last, f"weight_{index}", f"bias_{index}"]
            nodes.append(helper.make_node("Gemm", inputs, [output], transB=1))
        elif isinstance(layer, nn.Tanh):
            nodes.append(helper.make_node("Tanh", [last], [output]))
        else:
            raise _unknown(layer)
        last = output
    bound = layout.action_space().high[0]  # to which Stable-Baselines3 clips
    initializers += [numpy_helper.from_array(value, name) for name, value in (("low", -bound), ("high", bound))]
    nodes.append(helper.make_node("Clip", [last, "low", "high"], ["action"]))
    graph = helper.make_graph(
        nodes,
        "policy",
        [_value("observation", "rows", layout.size)],
        [_value("action", "rows", layout.action_size)],
        initializers,
    )
    return _content(
        graph,
        Metadata(
            interface=layout.interface,
            action_dims=layout.action_dims,
            slots=layout.slots,
            scenarios=scenarios,
            steps=int(model.num_timesteps),
            seed=seed,
            digits=digits,
            versions=_versions(),
        ),
    )


def _array(tensor: torch.Tensor) -> Float32Array:
    return tensor.detach().cpu().numpy().astype(np.float32)


def _value(name: str, *shape: int | str) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape)


def _versions() -> dict[str, str]:
    """Versions of the libraries that train and export."""
    return {
        "ptne_env": __version__,
        "stable_baselines3": stable_baselines3.__version__,
        "torch": torch.__version__,
        "numpy": np.__version__,
    }


def _content(graph: onnx.GraphProto, metadata: Metadata) -> bytes:
    """The file of a graph, after ONNX's own check."""
    exported = helper.make_model(graph, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR)
    onnx.checker.check_model(exported)
    return sealed(exported, metadata)


def _features(extractor: nn.Module) -> tuple[list[onnx.NodeProto], list[onnx.TensorProto], str]:
    """Nodes and constants that turn the observation into features, and the features' name."""
    if isinstance(extractor, FlattenExtractor):
        return [], [], "observation"
    if not isinstance(extractor, Products):
        raise _unknown(extractor)
    constants = {
        "factors": np.array(extractor.factors, dtype=np.int64)[:, None],
        "gates": np.array(extractor.gates, dtype=np.int64)[None],
        "flat": np.array([0, len(extractor.factors) * len(extractor.gates)], dtype=np.int64),
    }
    nodes = [
        helper.make_node("Gather", ["observation", "factors"], ["factor"], axis=1),
        helper.make_node("Gather", ["observation", "gates"], ["gate"], axis=1),
        helper.make_node("Mul", ["factor", "gate"], ["product"]),
        helper.make_node("Reshape", ["product", "flat"], ["products"]),
        helper.make_node("Concat", ["observation", "products"], ["features"], axis=1),
    ]
    return nodes, [numpy_helper.from_array(value, name) for name, value in constants.items()], "features"


def _unknown(layer: nn.Module) -> ValueError:
    return ValueError(f"only affine maps, tanh and Products can be exported, the actor holds a {type(layer).__name__}")
