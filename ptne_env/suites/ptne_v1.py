"""The suite ptne-v1, whose tracks each change one thing of a base."""

from __future__ import annotations

from typing import Any

from ptne_env.evaluation.tracks import Suite, Track
from ptne_env.shared.parts import FactorySpec
from ptne_env.world.catalogue import get_scenario

part = FactorySpec.of

RANGE = 100.0
"""Range R of messages, 3 to 5 times the largest start (20) or equilibrium of an energy game (33)."""


def _noisy(std: float, *stages: FactorySpec) -> FactorySpec:
    """Return a channel of stages, the last of which is noise."""
    noise = part("channel:noise", std=std)
    return part("channel:chain", stages=[*stages, noise]) if stages else noise


def _graphs(players: int, probability: float) -> FactorySpec:
    """Return 100 connected random graphs with this probability of each link, one of which every episode draws."""
    return part("topology:random-graphs", players=players, probability=probability)


LINKS = ((0, 1), (1, 2), (2, 3), (3, 4), (4, 0), (0, 2), (0, 3))
"""Links that go up and down at random: the 5-cycle and two chords."""

BASE = get_scenario("random-energy").replace(
    topology=_graphs(5, 0.4), slots=4, channel=_noisy(0.001), message_range=RANGE, steps=300
)
"""Random energy games of five players, each on its own random graph, with noise on messages."""


def _track(name: str, change: str, *, episodes: int | None = None, scored: bool = True, **changes: Any) -> Track:
    return Track(name, BASE.replace(name=name, **changes), change, None, episodes, scored)


TRACKS = (
    _track(
        "nominal",
        "The base without noise and range: a check that a policy works at all.",
        scored=False,
        channel="perfect",
        message_range=None,
    ),
    _track(
        "switching-physical",
        "The paper's four graphs in turn, each disconnected, for 0.1 s of physical time.",
        topology=part("topology:paper", dwell=0.1, clock="physical"),
    ),
    _track(
        "switching-transformed",
        "Links go up and down at random, every 0.1 to 0.4 of transformed time; noise is 0.3.",
        topology=part(
            "topology:random-edges",
            graph=part("topology:edges", players=5, edges=LINKS),
            probability=0.4,
            dwells=(0.1, 0.4),
            modes=64,
            clock="transformed",
        ),
        channel=_noisy(0.3),
    ),
    _track(
        "rounding",
        "Messages are rounded to multiples of 0.5: a check of code, without which nobody gets beyond the resolution.",
        scored=False,
        channel=part("channel:rounding", width=0.5),
    ),
    _track(
        "liar",
        "One player adds a constant of up to 20 to all that it says of other players.",
        channel=_noisy(0.001, part("channel:liar", size=20.0)),
    ),
    _track(
        "short-deadline",
        "A tenth of the time in 30 steps, and inputs up to 5: the way alone takes most of the time. Some messages are "
        "far off.",
        deadline=0.12,
        steps=30,
        input_limit=5.0,
        channel=_noisy(0.001, part("channel:heavy-tails", scale=0.6)),
    ),
    _track(
        "curved",
        "Random games whose prices saturate, so that curvature is up to 20 times as large near some strategies.",
        game=part("game:random-saturating", bend=20.0),
    ),
    _track(
        "rotation",
        "Random affine games that rotate faster than they contract: best responses drift apart; noise is 0.2.",
        game=part("game:random-affine", epsilon=0.3, asymmetry=4.0),
        channel=_noisy(0.2),
    ),
    _track(
        "rates",
        "Five users choose their data rates; prices of links rise faster than loads, and some messages are far off.",
        game="rate-control",
        start=part("start:uniform", low=0.0, high=4.0),
        channel=_noisy(0.001, part("channel:heavy-tails", scale=0.3)),
        message_range=0.2 * RANGE,  # rates are up to 5
    ),
    _track(
        "uneven-box",
        "Affine games of players with 1, 2, 3, 1 and 2 components in a box, who are pushed about; noise is 0.03.",
        game=part("game:random-affine", action_dim=(1, 2, 3, 1, 2), low=-5.0, high=5.0, asymmetry=8.0),
        disturbance=part("disturbance:uniform", bound=50.0),
        channel=_noisy(0.03),
    ),
    _track(
        "coupled",
        "Four constraints that five players share, priced by a sixth: a variational generalised Nash equilibrium.",
        game=part("game:coupled", game=part("game:random-energy", players=5), lines=4),
        topology=_graphs(6, 0.4),
        slots=5,
        message_range=1.5 * RANGE,  # prices are up to 45
    ),
    _track(
        "long-way",
        "A ring of 40 players: news of the farthest player need twenty steps.",
        game=part("game:random-energy", players=40, coupling=(0.00625, 0.0375)),
        topology=part("topology:cycle", players=40),
        slots=None,
        gain=5.0,
        episodes=20,
    ),
    _track(
        "market-118",
        "The 54 generators of the IEEE 118-bus case sell power at a price that falls with the total.",
        game="market-118",
        topology=part("topology:market-118"),
        start=part("start:uniform", low=0.0, high=100.0),  # the smallest capacity is 100 MW
        input_limit=20_000.0,
        channel=_noisy(0.01),
        message_range=15 * RANGE,  # outputs are up to 470 MW
        slots=None,
        gain=2.0,
        steps=200,
        episodes=10,
    ),
)

SUITE = Suite("ptne-v1", TRACKS, episodes=60)
