"""Policy files for tests, with their networks written by hand."""

import io
import json

import numpy as np

from ptne_env import Interface
from ptne_env.learn import Metadata, npz_policy, recurrent

OBSERVATION = 24
"""Length of an observation of ``random-energy`` in the interface ``scaled``."""

RECURRENT = recurrent.initial_weights(np.random.default_rng(0), hidden=6, slot_hidden=4)
"""Weights for worlds of any size."""


def layered(size=OBSERVATION, units=6, actions=5):
    """Weights with one hidden layer."""
    rng = np.random.default_rng(0)
    shapes = {"layer_0": (units, size), "layer_0_bias": (units, 1), "out": (actions, units), "out_bias": (actions, 1)}
    return {name: 0.1 * rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}


def metadata(**changes):
    values = {
        "interface": Interface("scaled"),
        "action_dims": (1,) * 5,
        "slots": 2,
        "training": {"scenario": "random-energy", "seed": 0},
    }
    return Metadata(**values | changes)


def write(path, weights=None, **changes):
    """A policy file with weights, :func:`layered` if left out, and changed metadata."""
    path.write_bytes(npz_policy.seal(weights or layered(), metadata(**changes)))
    return path


def pack(weights, version=6, **described):
    """The content of a file whose SHA-256 is right, whatever it holds; ``described`` is one value by its kind."""
    ((kind, value),) = described.items()
    description = {"version": version, "sha256": npz_policy._compute_digest(weights, value), kind: value}
    return pack_text(weights, json.dumps(description))


def pack_text(weights, text):
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **weights, metadata=np.frombuffer(text.encode(), dtype=np.uint8))
    return buffer.getvalue()
