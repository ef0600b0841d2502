"""Policy files for tests, with their networks written by hand."""

import numpy as np
from onnx import TensorProto, helper, numpy_helper

from ptne_env import Interface
from ptne_env.learn import Metadata
from ptne_env.learn.onnx_policy import seal

OBSERVATION = 24
"""Length of an observation of ``random-energy`` in the interface ``scaled``."""


def metadata(**changes):
    values = {
        "interface": Interface("scaled"),
        "action_dims": (1,) * 5,
        "slots": 2,
        "training": {"scenario": "random-energy", "seed": 0},
    }
    return Metadata(**values | changes)


def network(nodes, weights, *, size=OBSERVATION, actions=5, rows="rows"):
    """A network from ``observation`` to ``action``; weights are arrays by name, or tensors."""
    tensors = [
        value if isinstance(value, TensorProto) else numpy_helper.from_array(value, name)
        for name, value in weights.items()
    ]
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, [rows, size])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [rows, actions])],
        tensors,
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)


def first_entries(size=OBSERVATION, actions=5, **changes):
    """A network that returns the first entries of its observations."""
    weights = {name: np.array([value]) for name, value in (("start", 0), ("end", actions), ("axis", 1))}
    nodes = [helper.make_node("Slice", ["observation", *weights], ["action"])]
    return network(nodes, weights, size=size, actions=actions, **changes)


def write(path, model=None, **changes):
    """A policy file with a network, :func:`first_entries` if left out, and changed metadata."""
    path.write_bytes(seal(model or first_entries(), metadata(**changes)))
    return path
