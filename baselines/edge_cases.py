"""Edge cases at which strong laws fell: starts at and near 0, a start at the equilibrium, and rotation."""

from __future__ import annotations

import numpy as np

from ptne_env import get_scenario
from ptne_env.evaluation.tracks import Track
from ptne_env.games import EnergyGame
from ptne_env.shared.parts import FactorySpec
from ptne_env.suites import Suite
from ptne_env.world.scenario import Scenario

part = FactorySpec.of
ENERGY = get_scenario("random-energy")


def _start(largest: float) -> Scenario:
    return ENERGY.replace(start=part("start:uniform", low=-largest, high=largest))


WORLDS = {
    "starts ±0.01": _start(0.01),
    "starts ±1e-4": _start(1e-4),
    "starts ±1e-6": _start(1e-6),
    "starts ±1e-12": _start(1e-12),
    "starts at 0": ENERGY.replace(start=part("start:fixed", estimates=np.zeros((5, 5)))),
    "starts at x*": get_scenario("energy", start=part("start:fixed", estimates=[EnergyGame().nash_equilibrium] * 5)),
    "x* = 0": get_scenario("energy", game=part("game:energy", target=[0.0] * 5, base_price=0.0)),
    "rotation": get_scenario("random-affine").replace(
        game=part("game:random-affine", epsilon=0.1, asymmetry=10.0), channel=part("channel:noise", std=0.001)
    ),
}
"""Random energy games on a ring, but for the last three; messages are exact, but for the last."""

SUITE = Suite(
    "edge-cases", tuple(Track(name, world.replace(name=name), f"{name}.") for name, world in WORLDS.items()), 20
)
