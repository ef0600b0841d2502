"""The suite ptne-v1: tracks that each change one thing of the base."""

from __future__ import annotations

from typing import Any

from ptne_env.evaluation.tracks import Teammates, Track
from ptne_env.shared.parts import FactorySpec
from ptne_env.world.catalogue import get_scenario

part = FactorySpec.of

RANGE = 100.0
"""R of every track, 3 to 5 times the largest start or equilibrium: starts are U(−20, 20), equilibria within ±33."""


def _noisy(std: float, *stages: FactorySpec) -> FactorySpec:
    """A channel of stages, the last of which is noise."""
    noise = part("channel:noise", std=std)
    return part("channel:chain", stages=[*stages, noise]) if stages else noise


def _graphs(players: int, probability: float) -> FactorySpec:
    """Every episode draws one of 100 connected random graphs, in which each pair is linked with a probability."""
    return part("topology:random-graphs", players=players, probability=probability)


def _switching(shortest: float, longest: float, clock: str) -> FactorySpec:
    """Every link of a graph of seven links is up with probability 0.4, drawn again after every dwell."""
    edges = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0), (0, 2), (0, 3)]
    graph = part("topology:edges", players=5, edges=edges)
    return part(
        "topology:random-edges", graph=graph, probability=0.4, dwells=(shortest, longest), modes=64, clock=clock
    )


BASE = get_scenario("random-energy").replace(
    topology=_graphs(5, 0.4), slots=4, channel=_noisy(0.001), message_range=RANGE, steps=300
)
"""Random energy games of five players, each on a graph of its own; messages carry noise."""


def _track(
    name: str,
    change: str,
    *,
    teammates: Teammates | None = None,
    episodes: int | None = None,
    scored: bool = True,
    **changes: Any,
) -> Track:
    return Track(name, BASE.replace(name=name, **changes), change, teammates, episodes, scored)


TRACKS = (
    _track(
        "nominal",
        "The sanity track: the 5-cycle, and messages without noise.",
        scored=False,
        channel="perfect",
        message_range=None,
    ),
    _track("base", "Base."),
    _track(
        "switching-physical",
        "Links go up and down at random, every 0.05 to 0.15 s of physical time.",
        topology=_switching(0.05, 0.15, "physical"),
    ),
    _track(
        "switching-transformed",
        "Links go up and down at random, every 0.1 to 0.4 of transformed time.",
        topology=_switching(0.1, 0.4, "transformed"),
    ),
    _track(
        "rough-links",
        "Messages travel for 1 to 7 steps, a third of them is lost in bursts, and the rest carries noise 0.05.",
        channel=_noisy(
            0.05, part("channel:delay", steps=1, longest=7), part("channel:bursts", to_bad=0.05, to_good=0.1)
        ),
    ),
    _track("rounding", "Messages are rounded to multiples of 0.5.", channel=part("channel:rounding", width=0.5)),
    _track(
        "liar",
        "One player adds a constant of up to 1 to all that it says of other players.",
        channel=_noisy(0.001, part("channel:liar", size=1.0)),
    ),
    _track(
        "short-deadline",
        "A tenth of the time in a tenth of the steps, and inputs are limited: T = 0.12, 30 steps.",
        deadline=0.12,
        steps=30,
        input_limit=20.0,
    ),
    _track(
        "strangers",
        "Players 2 and 4 of 5 follow the paper's static law.",
        teammates=Teammates(part("law:static", kappa=2.0), (1, 3)),
    ),
    _track(
        "monotone",
        "Random affine games that are monotone and not strongly monotone.",
        game=part("game:random-affine", epsilon=0.0),
    ),
    _track("curved", "Prices saturate with a strong bend.", game=part("game:random-saturating", bend=20.0)),
    _track(
        "uneven-box",
        "Random affine games of players with 1, 2, 3, 1 and 2 components in a box.",
        game=part("game:random-affine", action_dim=(1, 2, 3, 1, 2), low=-5.0, high=5.0),
    ),
    _track(
        "coupled",
        "Two shared constraints, priced by a sixth player: a variational generalised Nash equilibrium.",
        game=part("game:coupled", game=part("game:random-energy", players=5), lines=2),
        topology=_graphs(6, 0.4),
        slots=5,
    ),
    _track(
        "crowd-50",
        "50 players on a sparse graph.",
        game=part("game:random-energy", players=50, coupling=(0.005, 0.03)),
        topology=part("topology:circulant", players=50, offsets=(1, 7)),
        slots=None,
        gain=5.0,
        steps=200,
        episodes=10,
    ),
)
