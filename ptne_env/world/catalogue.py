"""The catalogue: named scenarios. All start at random; ``start="paper"`` is the paper's start of its two examples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ptne_env.shared.names import unknown_name
from ptne_env.shared.parts import FactorySpec, make, names_of, target_of
from ptne_env.world.scenario import Scenario

_SCENARIOS: dict[str, tuple[Scenario, str]] = {}


def _add(name: str, game: FactorySpec | str, topology: FactorySpec, description: str, **fields: Any) -> None:
    _SCENARIOS[name] = Scenario(name=name, **{"game": game, "topology": topology, **fields}), description


def _between(low: float, high: float) -> FactorySpec:
    return FactorySpec.of("start:uniform", low=low, high=high)


_RING = FactorySpec.of("topology:cycle", players=5)
_PHYSICAL = FactorySpec.of("topology:paper", dwell=0.1, clock="physical")
_TRANSFORMED = FactorySpec.of("topology:paper", dwell=0.25, clock="transformed")
_RANDOM_ENERGY = FactorySpec.of("game:random-energy", players=5)
_CORRECTED = FactorySpec.of("game:non-quadratic", variant="corrected")
_PRINTED = FactorySpec.of("game:non-quadratic", variant="printed")
_HVAC = FactorySpec.of("game:energy", target=(50.0, 55.0, 60.0, 65.0, 70.0), coupling=0.04, base_price=5.0)
# fmt: off
# The paper's examples.
_add("energy", "energy", _RING,
       "The paper's first example: five buildings buy electricity at a price that rises with the total; a fixed ring.")
_add("energy-switching", "energy", _PHYSICAL,
       "The energy game on links that change every 0.1 s; at no time do they connect all players.")
_add("energy-switching-transformed", "energy", _TRANSFORMED,
       "The energy game on links that change faster and faster before the deadline: every 0.25 of transformed time.")
_add("non-quadratic", _CORRECTED, _RING,
       "The paper's second example, whose costs are not quadratic, with a misprint corrected; a fixed ring.")
_add("non-quadratic-switching", _CORRECTED, _PHYSICAL,
       "The corrected second example on links that change every 0.1 s.")
_add("non-quadratic-printed", _PRINTED, _RING,
       "The second example as it is printed, whose equilibrium is not the printed one.")
# Families of games, for training and evaluation.
_add("random-energy", _RANDOM_ENERGY, _RING,
       "Another energy game in every episode, for training; a fixed ring.", s_end=6.0)
_add("random-energy-switching", _RANDOM_ENERGY, _PHYSICAL,
       "Another energy game in every episode, on links that change every 0.1 s.", s_end=6.0)
_add("random-energy-switching-transformed", _RANDOM_ENERGY, _TRANSFORMED,
       "Another energy game in every episode, on links that change faster and faster before the deadline.", s_end=6.0)
# Games of the field.
_add("hvac-ye-hu", _HVAC, _RING,
       "Ye and Hu's energy game: five buildings choose the power of heating, ventilation and air conditioning.",
       start=_between(0.0, 100.0))
_add("cournot", "cournot", _RING,
       "Five firms choose the amounts that they sell in several markets, at most their capacities.",
       start=_between(0.0, 6.0))
_add("oligopoly", "oligopoly", FactorySpec.of("topology:cycle", players=4),
       "Four firms choose prices; customers share their demand among them.", start=_between(20.0, 60.0))
_add("robots", "robots", _RING,
       "Five robots in the plane stay near their posts and near each other.", start=_between(-10.0, 10.0))
_add("ev-charging", "ev-charging", _RING,
       "Five electric vehicles choose when to charge; the price of an interval rises with its load.",
       start=_between(0.0, 2.0))
_add("rate-control", "rate-control", _RING,
       "Five users of a network choose their data rates; the price of a link rises with its load.",
       start=_between(0.0, 4.0))
_add("random-affine", FactorySpec.of("game:random-affine", players=5), _RING,
       "A strongly monotone game with random linear gradients, another one in every episode.")
_add("weakly-monotone", "weakly-monotone", _RING,
       "A leader and four followers in a game that is monotone, but not strongly, as the theorems need it.")
# fmt: on

CATALOGUE: Mapping[str, Scenario] = {name: scenario for name, (scenario, _) in _SCENARIOS.items()}
"""The named scenarios, in the order of tables."""

DESCRIPTIONS: Mapping[str, str] = {name: sentence for name, (_, sentence) in _SCENARIOS.items()}
"""One sentence about each named scenario."""


def get_scenario(
    scenario: str | Scenario | Mapping[str, Any], *, players: int | None = None, **overrides: Any
) -> Scenario:
    """Return a scenario by its name, or as it is, with some fields changed.

    >>> get_scenario("energy", start="random")

    Args:
        scenario: a name of the catalogue, the name of a track, such as ``"ptne-v1/rounding"``, a ``"module:object"``
            that is a scenario or a function that makes one, a scenario, or the JSON object of one.
        players: N of its game and of its topology, where both have the parameter ``players``, as ``random-energy`` on
            a cycle has.
        **overrides: the fields that change.

    Raises:
        TypeError: for anything but a name or a scenario.
        ValueError: for an unknown name or field, for a track in which some players follow a fixed policy, or for
            another number of ``players`` where a part has a fixed size.
    """
    if isinstance(scenario, str):
        scenario = CATALOGUE.get(scenario) or _find_scenario(scenario)
    if isinstance(scenario, Mapping):
        scenario = Scenario.from_dict(scenario)
    if not isinstance(scenario, Scenario):  # an environment, for example
        kind = type(scenario).__name__
        raise TypeError(f"a scenario is a name or a Scenario, such as env.scenario of an environment; got a {kind}")
    scenario = scenario.replace(**overrides)
    return scenario if players is None else _resize(scenario, players, overrides)


def _find_scenario(name: str) -> Scenario:
    """Return the scenario of a track, by the names of its suite and its own, or of a ``"module:object"``."""
    suite, track = split_track(name)
    if not suite and ":" not in name:
        raise ValueError(unknown_name("scenario", name, scenario_names()))
    made = make(target_of("suite", suite) if suite else name)
    found = made.scenario(track) if suite and hasattr(made, "scenario") else made
    if not isinstance(found, Scenario):
        is_suite = hasattr(found, "tracks")
        advice = f": name a track, as '{name}/TRACK', or play it with run_suite or 'ptne compare --suite {name}'"
        raise ValueError(f"{name!r} is a {type(found).__name__}, not a Scenario" + advice * is_suite)
    return found


def split_track(name: str) -> tuple[str, str]:
    """Return the two names of a track, such as ``"ptne-v1/liar"``; the first is empty where the name has no slash."""
    suite, _, track = name.rpartition("/")
    if suite == "ptne":
        scenario = track.removesuffix("-v0").removesuffix("-joint")
        raise ValueError(f"{name!r} is an id of registries; the scenario is {scenario!r}")
    return suite, track


def scenario_names() -> list[str]:
    """Return all names of scenarios: those of the catalogue, and of the tracks of published suites."""
    tracks = [f"{suite}/{track.name}" for suite in names_of("suite") for track in make(f"suite:{suite}").tracks]
    return [*CATALOGUE, *tracks]


def _resize(scenario: Scenario, players: int, overrides: Mapping[str, Any]) -> Scenario:
    """Return a scenario with other numbers of players in its game and topology, except where ``overrides`` has them."""
    parts: dict[str, FactorySpec] = {
        name: getattr(scenario, name) for name in ("game", "topology") if name not in overrides
    }
    fixed = [name for name, part in parts.items() if "players" not in dict(part.arguments)]
    if fixed:
        sized = {"game": "game:random-energy", "topology": "topology:cycle"}
        raise ValueError(
            f"{scenario.name!r} has a {' and a '.join(fixed)} of fixed size: beside players={players}, pass another, "
            "such as " + ", ".join(f"{name}=FactorySpec.of({sized[name]!r}, players={players})" for name in fixed)
        )
    resized = {
        name: FactorySpec.of(part.target, **{**dict(part.arguments), "players": players})
        for name, part in parts.items()
    }
    return scenario.replace(**resized)
