"""The catalogue: the named scenarios. All start at random; ``start="paper"`` is the paper's start of its two examples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ptne_env.shared.names import unknown_name
from ptne_env.shared.parts import FactorySpec
from ptne_env.world.scenario import UNIFORM_START, Scenario


def _game(name: str, **arguments: Any) -> FactorySpec:
    return FactorySpec.of(f"game:{name}", **arguments)


def _cycle(players: int) -> FactorySpec:
    return FactorySpec.of("topology:cycle", players=players)


def _between(low: float, high: float) -> FactorySpec:
    return FactorySpec.of("start:uniform", low=low, high=high)


_RING = _cycle(players=5)
_PHYSICAL = FactorySpec.of("topology:paper", dwell=0.1, clock="physical")
_TRANSFORMED = FactorySpec.of("topology:paper", dwell=0.25, clock="transformed")
_ENERGY = _game("energy")
_RANDOM_ENERGY = _game("random-energy", players=5)
_CORRECTED = _game("non-quadratic", variant="corrected")
_PRINTED = _game("non-quadratic", variant="printed")
_HVAC = _game("energy", target=(50.0, 55.0, 60.0, 65.0, 70.0), coupling=0.04, base_price=5.0)
_TAME = 10.0
"""Random inputs of this size stay in range in the non-quadratic game; those of 1000 leave it in three steps."""

_SCENARIOS = (
    # The paper's examples.
    (
        Scenario(name="energy", game=_ENERGY, topology=_RING, start=UNIFORM_START),
        "The paper's first example: five buildings buy electricity at a price that rises with the total; a fixed ring.",
    ),
    (
        Scenario(name="energy-switching", game=_ENERGY, topology=_PHYSICAL, start=UNIFORM_START),
        "The energy game on links that change every 0.1 s; at no time do they connect all players.",
    ),
    (
        Scenario(name="energy-switching-transformed", game=_ENERGY, topology=_TRANSFORMED, start=UNIFORM_START),
        "The energy game on links that change faster and faster before the deadline: every 0.25 of transformed time.",
    ),
    (
        Scenario(name="non-quadratic", game=_CORRECTED, topology=_RING, start=UNIFORM_START, action_limit=_TAME),
        "The paper's second example, whose costs are not quadratic, with a misprint corrected; a fixed ring.",
    ),
    (
        Scenario(
            name="non-quadratic-switching", game=_CORRECTED, topology=_PHYSICAL, start=UNIFORM_START, action_limit=_TAME
        ),
        "The corrected second example on links that change every 0.1 s.",
    ),
    (
        Scenario(name="non-quadratic-printed", game=_PRINTED, topology=_RING, start=UNIFORM_START, action_limit=_TAME),
        "The second example as it is printed, whose equilibrium is not the printed one.",
    ),
    # Families of games, for training and evaluation.
    (
        Scenario(name="random-energy", game=_RANDOM_ENERGY, topology=_RING, start=UNIFORM_START, s_end=6.0),
        "Another energy game in every episode, for training; a fixed ring.",
    ),
    (
        Scenario(
            name="random-energy-switching", game=_RANDOM_ENERGY, topology=_PHYSICAL, start=UNIFORM_START, s_end=6.0
        ),
        "Another energy game in every episode, on links that change every 0.1 s.",
    ),
    (
        Scenario(
            name="random-energy-switching-transformed",
            game=_RANDOM_ENERGY,
            topology=_TRANSFORMED,
            start=UNIFORM_START,
            s_end=6.0,
        ),
        "Another energy game in every episode, on links that change faster and faster before the deadline.",
    ),
    # Games of the field.
    (
        Scenario(name="hvac-ye-hu", game=_HVAC, topology=_RING, start=_between(0.0, 100.0)),
        "Ye and Hu's energy game: five buildings choose the power of heating, ventilation and air conditioning.",
    ),
    (
        Scenario(name="cournot", game=_game("cournot"), topology=_RING, start=_between(0.0, 6.0)),
        "Five firms choose the amounts that they sell in several markets, at most their capacities.",
    ),
    (
        Scenario(name="oligopoly", game=_game("oligopoly"), topology=_cycle(players=4), start=_between(20.0, 60.0)),
        "Four firms choose prices; customers share their demand among them.",
    ),
    (
        Scenario(name="robots", game=_game("robots"), topology=_RING, start=_between(-10.0, 10.0)),
        "Five robots in the plane stay near their posts and near each other.",
    ),
    (
        Scenario(name="ev-charging", game=_game("ev-charging"), topology=_RING, start=_between(0.0, 2.0)),
        "Five electric vehicles choose when to charge; the price of an interval rises with its load.",
    ),
    (
        Scenario(name="rate-control", game=_game("rate-control"), topology=_RING, start=_between(0.0, 4.0)),
        "Five users of a network choose their data rates; the price of a link rises with its load.",
    ),
    (
        Scenario(name="random-affine", game=_game("random-affine", players=5), topology=_RING, start=UNIFORM_START),
        "A strongly monotone game with random linear gradients, another one in every episode.",
    ),
    (
        Scenario(name="weakly-monotone", game=_game("weakly-monotone"), topology=_RING, start=UNIFORM_START),
        "A leader and four followers in a game that is monotone, but not strongly, as the theorems need it.",
    ),
)

CATALOGUE: Mapping[str, Scenario] = {scenario.name: scenario for scenario, _ in _SCENARIOS}
"""The named scenarios, in the order of tables."""

DESCRIPTIONS: Mapping[str, str] = {scenario.name: sentence for scenario, sentence in _SCENARIOS}
"""One sentence about each named scenario."""


def get_scenario(scenario: str | Scenario, **overrides: Any) -> Scenario:
    """A scenario by name (or as it is), with some fields changed: ``get_scenario("energy", start="random")``.

    Raises:
        TypeError: for anything but a name or a scenario.
        ValueError: for an unknown name or field.
    """
    if isinstance(scenario, str):
        if scenario not in CATALOGUE:
            suite, separator, track = scenario.partition("/")
            if separator:
                raise ValueError(
                    f"{scenario!r} is no scenario; if it is the track of a suite, give "
                    f"ptne_env.evaluation.get_suite({suite!r}).track({track!r}).scenario"
                )
            raise ValueError(unknown_name("scenario", scenario, CATALOGUE))
        scenario = CATALOGUE[scenario]
    if not isinstance(scenario, Scenario):  # an environment, for example
        given = type(scenario).__name__
        raise TypeError(f"a scenario is a name or a Scenario, such as env.scenario of an environment; got a {given}")
    return scenario.replace(**overrides)
