"""The named policies: the laws, the references and the networks that ship, each with a sentence for lists.

A new law is its file in :mod:`ptne_env.laws`, its id in :data:`ptne_env.shared.parts.PARTS` and an entry here.
"""

from __future__ import annotations

from ptne_env.learn.policy_files import DATA, TRACK
from ptne_env.shared.parts import FactorySpec

part = FactorySpec.of


_COMPARED = {
    "static": (
        "The paper's static law: down the own cost, and towards the neighbours.",
        part("law:static", kappa=2.0),
    ),
    "adaptive": (
        "The paper's adaptive law: the gain of a link grows as long as its two players disagree.",
        part("law:adaptive", gamma=0.01, initial_gain=0.5),
    ),
    "corollary-one": (
        "The static law without the time gain, with a large κ.",
        part("law:corollary-one", kappa=10.0),
    ),
    "gadjov-pavel": ("Gadjov and Pavel's law: Corollary 1 with κ = 1.", part("law:corollary-one", kappa=1.0)),
    "grounded": (
        "Ye and Hu's law: estimates follow the neighbours, and the own strategy follows the own cost alone.",
        part("law:grounded", kappa=2.0),
    ),
    "zero-input": ("Does nothing: strategies stay at the start.", part("law:zero-input")),
    "random": ("Random inputs.", part("law:random", seed=0)),
    "oracle": ("Moves all estimates to the equilibrium, which players do not know, at once.", part("law:oracle")),
    "routed-unknown": (
        "Copies news of each player from the neighbours that have them first, and takes gradient steps.",
        part("law:routed-unknown", step=0.3),
    ),
    "relay": (
        "Copies news as routed-unknown, and takes best responses by an identified model of the own gradient.",
        part("law:relay"),
    ),
    "recurrent-random-worlds": (
        "A network with memory that was trained through 75 worlds, many like the tracks with other numbers.",
        DATA.spec("recurrent-random-worlds"),
    ),
}
_OTHERS = {
    "ppo": ("A network for each track of ptne-v1, which PPO trained there.", DATA.spec(f"ppo-{TRACK}")),
    "static-tuned": ("The static law with tuned weights.", part("law:static", kappa=2.2, gradient_gain=2.94)),
    "adaptive-grounded": (
        "Ye and Hu's adaptive law: the grounded law, with gains that every player tunes by itself.",
        part("law:adaptive-grounded", gamma=0.0001, initial_gain=3.0),
    ),
    "leader-estimator": (
        "He and Huang's law: the grounded law with slow strategies, for graphs that are jointly connected.",
        part("law:grounded", kappa=2.0, gradient_gain=0.5),
    ),
    "fixed-time": (
        "The grounded law with signed powers of gradients and differences, so that the start does not matter.",
        part("law:fixed-time", kappa=2.0, power=0.5, step=1.0),
    ),
    "projected-gradient": (
        "Bianchi and Grammatico's discrete law: average with the neighbours, then take a gradient step.",
        part("law:projected-gradient", step=0.47, mixing=0.357),
    ),
    "proximal-best-response": (
        "Bianchi, Belgioioso and Grammatico's law: proximal best responses, and averages with neighbours.",
        part("law:proximal-best-response", step=4.0, mixing=0.45),
    ),
}
_CODED = {
    f"coded-{name}": (f"{what}, in code.", part("law:coded", policy=policy))
    for name, what, policy in (
        ("relay", "The relay", _COMPARED["relay"][1]),
        ("network", "The network recurrent-random-worlds", _COMPARED["recurrent-random-worlds"][1]),
    )
}
TABLE = _COMPARED | _OTHERS | _CODED
"""A sentence and the factory spec by name, in the order in which lists show them."""

NO_LAWS = ("zero-input", "random")
"""The policies that seek nothing."""

COMPARED = tuple(_COMPARED)
"""The default policies on scenarios: laws of the paper, references, the strongest laws, learned policies."""

ENTERED = (*_COMPARED, *_OTHERS)
"""The default policies on a suite: all but those in code."""

CODED = tuple(_CODED)
"""The policies that send code. Any policy can wear it, so they are ranked apart, and play where they are named."""
