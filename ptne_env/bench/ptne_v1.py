"""The suite ptne-v1: twenty tracks that each change one thing of the base."""

from __future__ import annotations

from typing import Any

from ptne_env.evaluation.tracks import Teammates, Track
from ptne_env.shared.parts import FactorySpec
from ptne_env.world.catalogue import get_scenario

part = FactorySpec.of

BASE = get_scenario("random-energy")

PAIRS = ([(0, 1), (2, 3)], [(1, 2), (3, 4)], [(2, 3), (4, 0)], [(3, 4), (0, 1)])
"""The links of the four graphs of the Markov chain, which are the paper's modes."""


def _track(name: str, change: str, *, metric: str = "digits", episodes: int | None = None, **changes: Any) -> Track:
    return Track(name, BASE.replace(name=name, **changes), change, metric, episodes=episodes)


def _many(players: int, stride: int) -> dict[str, Any]:
    """Players on a circulant graph of degree 4, their total coupling that of five."""
    graph = part("topology:circulant", players=players, offsets=(1, stride))
    coupling = (0.25 / players, 1.5 / players)
    return {
        "game": part("game:random-energy", players=players, coupling=coupling),
        "topology": graph,
    }


TRACKS = (
    _track("nominal", "The base: random energy games of five players on the 5-cycle, T = 1.2, c = 20."),
    _track(
        "switching-physical",
        "The graph switches between four disconnected ones, every 0.1 s of physical time.",
        topology=get_scenario("random-energy-switching").topology,
    ),
    _track(
        "switching-transformed",
        "The graph switches between four disconnected ones, every 0.25 of transformed time.",
        topology=get_scenario("random-energy-switching-transformed").topology,
    ),
    _track(
        "markov",
        "Every 0.1 of transformed time one of the same four graphs is drawn, independently of the one before.",
        topology=part(
            "topology:markov",
            graphs=[part("topology:edges", players=5, edges=edges) for edges in PAIRS],
            transition=[[0.25] * 4] * 4,
            dwells=0.1,
            clock="transformed",
        ),
    ),
    _track(
        "noise",
        "Messages carry Gaussian noise of standard deviation 0.05.",
        channel=part("channel:noise", std=0.05),
    ),
    _track(
        "delay",
        "Messages travel for 1 to 7 steps, drawn each, and may overtake each other.",
        channel=part("channel:delay", steps=1, longest=7),
    ),
    _track(
        "burst-loss",
        "A third of the messages is lost, in bursts of 10 steps on average; receivers hold the last one.",
        channel=part("channel:bursts", to_bad=0.05, to_good=0.1),
    ),
    _track("quantised", "Messages are rounded to multiples of 0.1.", channel=part("channel:rounding", width=0.1)),
    _track("saturated", "Inputs are limited to 2, which binds in the first half of an episode.", input_limit=2.0),
    _track("coarse-step", "150 steps to the deadline instead of 400.", steps=150),
    _track("large-20", "20 players, on a circulant graph of degree 4; total coupling as in the base.", **_many(20, 4)),
    _track(
        "large-50",
        "50 players, on a circulant graph of degree 4; total coupling as in the base.",
        episodes=40,  # they take half of the time of all tracks
        **_many(50, 7),
    ),
    _track(
        "unseen-graphs",
        "Every episode draws one of 100 connected random graphs, in which half of all pairs are linked; 4 slots.",
        topology=part("topology:random-graphs", players=5, probability=0.5, modes=100, seed=0),
        slots=4,
    ),
    _track(
        "non-quadratic",
        "The paper's Example 2, whose pseudo-gradient is not Lipschitz.",
        game=part("game:non-quadratic", variant="corrected"),
    ),
    _track(
        "weakly-monotone",
        "A game whose pseudo-gradient is monotone but not strongly monotone.",
        game=part("game:weakly-monotone"),
    ),
    _track(
        "wrong-clock", "The players' clocks are up to 0.2 s fast or slow.", clock_shifts=(-0.2, 0.1, 0.0, 0.2, -0.1)
    ),
    _track("short-deadline", "A quarter of the time: T = 0.3 at the same c.", deadline=0.3),
    _track(
        "hold",
        "100 steps follow the deadline, in which the strategies are pushed by U(−1, 1) per second.",
        metric="digits_after_hold",
        hold_steps=100,
        disturbance=part("disturbance:uniform", bound=1.0, dwell=25, after_deadline_only=True),
    ),
    Track(
        "mixed-team",
        BASE.replace(name="mixed-team"),
        "Players 2 and 4 of 5 follow the paper's static law, beside every policy.",
        teammates=Teammates(part("law:static", kappa=2.0), (1, 3)),
    ),
    _track(
        "robots",
        "Five robots in the plane keep posts and connectivity: two components per player.",
        game=part("game:robots"),
    ),
)
