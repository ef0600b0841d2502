"""The catalogue: the named scenarios."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ptne_env.factory import FactorySpec
from ptne_env.scenario import PAPER_START, UNIFORM_START, Scenario


def _game(name: str, **arguments: Any) -> FactorySpec:
    return FactorySpec.of(f"ptne_env.games:{name}", **arguments)


def _cycle(players: int) -> FactorySpec:
    graph = FactorySpec.of("ptne_env.graphs:cycle", players=players)
    return FactorySpec.of("ptne_env.switching:fixed", graph=graph)


def _between(low: float, high: float) -> FactorySpec:
    return FactorySpec.of("ptne_env.starts:UniformStart", low=low, high=high)


_RING = _cycle(players=5)
_PHYSICAL = FactorySpec.of("ptne_env.switching:paper_topology", dwell=0.1, clock="physical")
_TRANSFORMED = FactorySpec.of("ptne_env.switching:paper_topology", dwell=0.25, clock="transformed")
_ENERGY = _game("EnergyGame")
_RANDOM_ENERGY = _game("RandomEnergy", players=5)
_CORRECTED = _game("NonQuadraticGame", variant="corrected")
_PRINTED = _game("NonQuadraticGame", variant="printed")
_HVAC = _game("EnergyGame", target=(50.0, 55.0, 60.0, 65.0, 70.0), coupling=0.04, base_price=5.0)
_TAME = 10.0
"""Random inputs of this size stay in range in the non-quadratic game; those of 1000 leave it in three steps."""

_SCENARIOS = (
    # The paper's examples.
    Scenario(name="energy", game=_ENERGY, topology=_RING, start=PAPER_START),
    Scenario(name="energy-switching", game=_ENERGY, topology=_PHYSICAL, start=PAPER_START),
    Scenario(name="energy-switching-transformed", game=_ENERGY, topology=_TRANSFORMED, start=PAPER_START),
    Scenario(name="non-quadratic", game=_CORRECTED, topology=_RING, start=PAPER_START, action_limit=_TAME),
    Scenario(
        name="non-quadratic-switching", game=_CORRECTED, topology=_PHYSICAL, start=PAPER_START, action_limit=_TAME
    ),
    Scenario(name="non-quadratic-printed", game=_PRINTED, topology=_RING, start=PAPER_START, action_limit=_TAME),
    # Families of games, for training and evaluation.
    Scenario(name="random-energy", game=_RANDOM_ENERGY, topology=_RING, start=UNIFORM_START, s_end=6.0),
    Scenario(name="random-energy-switching", game=_RANDOM_ENERGY, topology=_PHYSICAL, start=UNIFORM_START, s_end=6.0),
    Scenario(
        name="random-energy-switching-transformed",
        game=_RANDOM_ENERGY,
        topology=_TRANSFORMED,
        start=UNIFORM_START,
        s_end=6.0,
    ),
    # Games of the field.
    Scenario(name="hvac-ye-hu", game=_HVAC, topology=_RING, start=_between(0.0, 100.0)),
    Scenario(name="cournot", game=_game("NetworkedCournot"), topology=_RING, start=_between(0.0, 6.0)),
    Scenario(name="oligopoly", game=_game("Oligopoly"), topology=_cycle(players=4), start=_between(20.0, 60.0)),
    Scenario(name="robots", game=_game("ConnectivityControl"), topology=_RING, start=_between(-10.0, 10.0)),
    Scenario(name="ev-charging", game=_game("ElectricVehicleCharging"), topology=_RING, start=_between(0.0, 2.0)),
    Scenario(name="rate-control", game=_game("RateControl"), topology=_RING, start=_between(0.0, 4.0)),
    Scenario(name="random-affine", game=_game("RandomAffine", players=5), topology=_RING, start=UNIFORM_START),
    Scenario(name="weakly-monotone", game=_game("WeaklyMonotoneGame"), topology=_RING, start=UNIFORM_START),
)

CATALOGUE: Mapping[str, Scenario] = {scenario.name: scenario for scenario in _SCENARIOS}
"""The named scenarios, in the order of tables."""


def get_scenario(scenario: str | Scenario, **overrides: Any) -> Scenario:
    """A scenario by name (or as it is), with some fields changed: ``get_scenario("energy", start="random")``.

    Raises:
        ValueError: for an unknown name or field.
    """
    if isinstance(scenario, str):
        if scenario not in CATALOGUE:
            raise ValueError(f"unknown scenario {scenario!r}; the catalogue has {', '.join(CATALOGUE)}")
        scenario = CATALOGUE[scenario]
    return scenario.replace(**overrides)
