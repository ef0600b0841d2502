"""Row mixing in an ONNX file: plain nodes that reshape the rows to (episodes, players, size) and mix the players."""

import numpy as np
from extras import need_sb3

from cheats.base import STEP
from ptne_env.learn import Metadata

onnx = need_sb3("onnx")
helper, numpy_helper = onnx.helper, onnx.numpy_helper


def row_mixing_file(layout):
    """The bytes of a policy file for players with one component each, in a layout of the kind ``physical``.

    It is the graph of ``cheats.row_mixing:RowMixing``.
    """
    players, low, high = layout.num_players, -layout.action_bound, layout.action_bound
    theta = layout.slices["clock"].start + 2
    columns = {
        "gradient": layout.slices["own_gradient"],
        "estimates": layout.slices["own_estimate"],
        "theta": slice(theta, theta + 1),
    }
    eye = np.eye(players, dtype=np.float32)
    constants = {
        **{name: np.arange(part.start, part.stop) for name, part in columns.items()},
        "by_episode": np.array([-1, players, players]),
        "by_player": np.array([-1, 1, players]),
        "by_row": np.array([-1, players]),
        "last": np.array([2]),
        "players": np.array([players]),
        "no_pads": np.array([0, 0]),
        "no_pad": np.array([0]),
        "eye": eye,
        "rate": STEP * eye,
        "smallest": np.float32(1e-9),
        "low": np.float32(low),
        "high": np.float32(high),
    }
    nodes = [
        # zeros at the end, up to a whole number of episodes
        helper.make_node("Shape", ["observation"], ["rows"], start=0, end=1),
        helper.make_node("Neg", ["rows"], ["negative"]),
        helper.make_node("Mod", ["negative", "players"], ["missing"]),
        helper.make_node("Concat", ["no_pads", "missing", "no_pad"], ["pads"], axis=0),
        helper.make_node("Pad", ["observation", "pads"], ["padded"]),
        *(helper.make_node("Gather", ["padded", name], [f"{name}_seen"], axis=1) for name in columns),
        helper.make_node("Reshape", ["estimates_seen", "by_episode"], ["of_players"]),
        helper.make_node("Mul", ["of_players", "eye"], ["own"]),
        helper.make_node("ReduceSum", ["own", "last"], ["strategies"], keepdims=0),
        helper.make_node("Reshape", ["strategies", "by_player"], ["joint"]),  # the rows are mixed here
        helper.make_node("Sub", ["joint", "of_players"], ["difference"]),
        helper.make_node("Reshape", ["gradient_seen", "column"], ["gradients"]),
        helper.make_node("Mul", ["gradients", "rate"], ["descent"]),
        helper.make_node("Sub", ["difference", "descent"], ["moves"]),
        helper.make_node("Reshape", ["moves", "by_row"], ["displacement"]),
        helper.make_node("Max", ["theta_seen", "smallest"], ["step"]),
        helper.make_node("Div", ["displacement", "step"], ["input"]),
        helper.make_node("Clip", ["input", "low", "high"], ["clipped"]),
        helper.make_node("Slice", ["clipped", "no_pad", "rows", "no_pad"], ["action"]),
    ]
    constants["column"] = np.array([-1, players, 1])
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("observation", onnx.TensorProto.FLOAT, ["rows", layout.size])],
        [helper.make_tensor_value_info("action", onnx.TensorProto.FLOAT, ["rows", layout.action_size])],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    metadata = Metadata(
        interface=layout.interface,
        action_dims=layout.action_dims,
        slots=layout.slots,
        scenarios=(),
        steps=0,
        seed=0,
        digits=0.0,
        versions={},
    )
    helper.set_model_props(model, {"ptne_env": metadata.to_json()})
    onnx.checker.check_model(model)
    return model.SerializeToString()
