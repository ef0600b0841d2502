"""Export of policies to ONNX files that :func:`ptne_env.learn.load` reads.

The graphs are written node by node: a policy here is a few affine maps and tanh, and torch's exporters need three more
packages for it and change with every release.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import onnx
import stable_baselines3
import torch
from onnx import helper, numpy_helper
from stable_baselines3.common.torch_layers import FlattenExtractor
from torch import nn

from ptne_env._version import __version__
from ptne_env.field.laws.gated import CellGates, SlotGates
from ptne_env.learn import Metadata, SizeFreeFile, SizeFreeMetadata, load, shipped, shipped_path
from ptne_env.learn.learned import SIZE_FREE_INPUTS
from ptne_env.learn.metadata import GATES, Description
from ptne_env.learn.size_free import CELL_FEATURES, SLOT_FEATURES
from ptne_env.learn.training.features import Products
from ptne_env.learn.training.network import GateNetwork
from ptne_env.perception.observation import Interface, ObservationLayout
from ptne_env.shared.arrays import Float32Array
from ptne_env.shared.names import unknown_name

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


def size_free_to_onnx(
    network: GateNetwork, *, interface: Interface, scenarios: tuple[str, ...], steps: int, seed: int, digits: float
) -> bytes:
    """The network of a policy without sizes as an ONNX file: features of cells and messages to gates, not clipped.

    The numbers of cells and slots are left open, so that one file decides in worlds of every size; see
    :data:`ptne_env.learn.size_free.Network`.

    Args:
        network: of the gates.
        interface: of the worlds it was trained in.
        scenarios: names of the worlds it was trained in, for the metadata.
        steps: agent-steps of training, for the metadata.
        seed: of training, for the metadata.
        digits: on the validation episodes, for the metadata.
    """
    constants = {
        name: _array(tensor).T if name.endswith("weight") else _array(tensor)
        for name, tensor in network.state_dict().items()
    }
    constants |= {
        "flat": np.array([-1, len(SLOT_FEATURES)], dtype=np.int64),
        "rest": np.array([-1], dtype=np.int64),
        "live": np.array([SLOT_FEATURES.index("live")], dtype=np.int64),
        "slot_axis": np.array([1], dtype=np.int64),
        "one": np.array(1.0, dtype=np.float32),
    }
    cell, slot = SIZE_FREE_INPUTS

    def affine(layer: str, values: str, result: str) -> onnx.NodeProto:
        terms = [name for name in (f"{layer}.weight", f"{layer}.bias") if name in constants]
        return helper.make_node("Gemm", [values, *terms], [result])

    nodes = [
        helper.make_node("Reshape", [slot, "flat"], ["messages"]),
        affine("encoder", "messages", "encoder_sum"),
        affine("slot_layer", "messages", "layer_sum"),
        affine("slot_skip", "messages", "line"),
        helper.make_node("Shape", [slot], ["counts"], end=2),
        helper.make_node("Concat", ["counts", "rest"], ["by_slot"], axis=0),
        # The mean and the maximum of the encodings over live links.
        helper.make_node("Tanh", ["encoder_sum"], ["encodings"]),
        helper.make_node("Reshape", ["encodings", "by_slot"], ["encoding"]),
        helper.make_node("Gather", [slot, "live"], ["is_live"], axis=2),
        helper.make_node("Mul", ["encoding", "is_live"], ["heard"]),
        helper.make_node("ReduceSum", ["heard", "slot_axis"], ["sum"], keepdims=0),
        helper.make_node("Reshape", ["is_live", "counts"], ["live_links"]),
        helper.make_node("ReduceSum", ["live_links", "slot_axis"], ["links"]),
        helper.make_node("Max", ["links", "one"], ["divisor"]),
        helper.make_node("Div", ["sum", "divisor"], ["mean"]),
        helper.make_node("Add", ["heard", "is_live"], ["shifted"]),
        helper.make_node("ReduceMax", ["shifted"], ["largest"], axes=[1], keepdims=0),
        # The component.
        helper.make_node("Concat", [cell, "mean", "largest"], ["known"], axis=1),
        affine("first", "known", "first_sum"),
        helper.make_node("Tanh", ["first_sum"], ["first_hidden"]),
        affine("second", "first_hidden", "second_sum"),
        helper.make_node("Tanh", ["second_sum"], ["hidden"]),
        affine("cell_head", "hidden", "cell_curve"),
        affine("cell_skip", cell, "cell_line"),
        helper.make_node("Add", ["cell_line", "cell_curve"], ["cell_gates"]),
        # Its messages.
        affine("slot_context", "hidden", "context"),
        helper.make_node("Unsqueeze", ["context", "slot_axis"], ["contexts"]),
        helper.make_node("Reshape", ["layer_sum", "by_slot"], ["layer"]),
        helper.make_node("Add", ["layer", "contexts"], ["joined_sum"]),
        helper.make_node("Tanh", ["joined_sum"], ["joined"]),
        helper.make_node("MatMul", ["joined", "slot_head.weight"], ["slot_curve"]),
        helper.make_node("Reshape", ["line", "by_slot"], ["slot_line"]),
        helper.make_node("Add", ["slot_line", "slot_curve"], ["slot_gates"]),
    ]
    graph = helper.make_graph(
        nodes,
        "gates",
        [
            _value(cell, "cells", len(CELL_FEATURES)),
            _value(slot, "cells", "slots", len(SLOT_FEATURES)),
        ],
        [
            _value("cell_gates", "cells", len(CellGates._fields)),
            _value("slot_gates", "cells", "slots", len(SlotGates._fields)),
        ],
        [numpy_helper.from_array(np.ascontiguousarray(array), name) for name, array in constants.items()],
    )
    return _content(
        graph,
        SizeFreeMetadata(
            interface=interface,
            scenarios=scenarios,
            steps=steps,
            seed=seed,
            digits=digits,
            versions=_versions(),
            cell_features=CELL_FEATURES,
            slot_features=SLOT_FEATURES,
            gates=GATES,
        ),
    )


def size_free_from_onnx(path_or_name: str | Path) -> GateNetwork:
    """The network of a file that :func:`size_free_to_onnx` made, or of a shipped policy by name.

    Raises:
        FileNotFoundError, PolicyFileError: as :func:`ptne_env.learn.load`.
        ValueError: when the policy has sizes, or another network than training makes.
    """
    name = str(path_or_name)
    path = shipped_path(name) or Path(path_or_name)
    if path.suffix != ".onnx":
        raise ValueError(unknown_name("policy without sizes", name, _without_sizes(), "an .onnx file"))
    if not isinstance(load(path), SizeFreeFile):
        raise ValueError(
            f"policy {name!r} has sizes: training goes on only from policies without sizes, such as "
            f"{', '.join(_without_sizes())}"
        )
    graph = onnx.load_from_string(path.read_bytes()).graph
    constants = {each.name: numpy_helper.to_array(each) for each in graph.initializer}
    try:
        network = GateNetwork(len(constants["first.bias"]), len(constants["encoder.bias"]))
        state = {key: torch.from_numpy(np.array(constants[key].T)) for key in network.state_dict()}
        network.load_state_dict(state)
    except (KeyError, TypeError, RuntimeError) as error:
        raise ValueError(
            f"policy {name!r} has another network than those of ptne train: training cannot go on from it"
        ) from error
    return network


def _without_sizes() -> list[str]:
    """The names of the shipped policies without sizes."""
    return [name for name in shipped() if isinstance(load(name), SizeFreeFile)]


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


def _content(graph: onnx.GraphProto, metadata: Description) -> bytes:
    """The file of a graph, after ONNX's own check."""
    exported = helper.make_model(graph, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR)
    helper.set_model_props(exported, {"ptne_env": metadata.to_json()})
    onnx.checker.check_model(exported)
    content: bytes = exported.SerializeToString()
    return content


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
