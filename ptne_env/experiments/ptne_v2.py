"""The suite ptne-v2, whose tracks the best known policies do not saturate. It is not frozen yet."""

from __future__ import annotations

from typing import Any

from ptne_env.catalogue import get_scenario
from ptne_env.experiments.suite import Suite, Teammates, Track
from ptne_env.factory import FactorySpec
from ptne_env.scenario import Scenario

NOISE = 0.001
"""Standard deviation of the link noise of the base, in the units of the strategies."""


def _graphs(players: int, probability: float, modes: int = 100) -> FactorySpec:
    """Every episode draws a connected random graph from a pool."""
    return FactorySpec.of(
        "ptne_env.switching:random_graphs", players=players, probability=probability, modes=modes, seed=2
    )


def _drawn_switching(dwells: tuple[float, float], clock: str) -> FactorySpec:
    """After every dwell, links of the 5-cycle with both diagonals of player 0 are up with probability 0.4."""
    edges = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0), (0, 2), (0, 3)]
    graph = FactorySpec.of("ptne_env.graphs:from_edges", players=5, edges=edges)
    return FactorySpec.of(
        "ptne_env.switching:random_edges", graph=graph, probability=0.4, dwells=dwells, modes=64, seed=2, clock=clock
    )


def _channel(name: str, **arguments: Any) -> FactorySpec:
    return FactorySpec.of(f"ptne_env.channel:{name}", **arguments)


def _noise(std: float) -> FactorySpec:
    return _channel("AdditiveNoise", std=std)


def _chain(*stages: FactorySpec) -> FactorySpec:
    return _channel("Chain", stages=list(stages))


def _game(name: str, **arguments: Any) -> FactorySpec:
    return FactorySpec.of(f"ptne_env.games:{name}", **arguments)


def _energy(players: int) -> FactorySpec:
    """Random energy games whose total coupling is that of five players."""
    return _game("RandomEnergy", players=players, coupling=(0.25 / players, 1.5 / players))


def _many(players: int, steps: int) -> dict[str, Any]:
    """Many players on one random graph of degree 3, with the time for 10 units of effective time."""
    graph = FactorySpec.of("networkx:random_regular_graph", d=3, n=players, seed=2)
    graph = FactorySpec.of("ptne_env.graphs:from_networkx", graph=graph)
    topology = FactorySpec.of("ptne_env.switching:fixed", graph=graph)
    return {"game": _energy(players), "topology": topology, "slots": 3, "gain": 5.0, "s_end": 5.0, "steps": steps}


def base() -> Scenario:
    """Random energy games of five players; every episode draws its graph; messages carry noise."""
    return get_scenario("random-energy").replace(
        name="base", topology=_graphs(5, 0.4), channel=_noise(NOISE), slots=4, steps=300
    )


def ptne_v2() -> Suite:
    """The suite ``ptne-v2``: tracks that each change one thing of a base with drawn graphs and noise on its links."""
    nominal = base()

    def track(name: str, change: str, *, metric: str = "digits", episodes: int | None = None, **changes: Any) -> Track:
        return Track(name, nominal.replace(name=name, **changes), change, metric, episodes=episodes)

    pushes = FactorySpec.of("ptne_env.disturbances:UniformDisturbance", bound=1.0, dwell=1, after_deadline_only=True)
    law = FactorySpec.of("ptne_env.laws:Static", kappa=2.0)
    tracks = (
        track(
            "clean",
            "The sanity track, ranked by time: the 5-cycle and messages without noise.",
            topology=get_scenario("random-energy").topology,
            channel="perfect",
        ),
        track("noise", "Five times the noise: standard deviation 0.05.", channel=_noise(0.05)),
        track(
            "switching-physical",
            "Links go up and down at random, for 0.05 to 0.15 s of physical time.",
            topology=_drawn_switching((0.05, 0.15), "physical"),
        ),
        track(
            "switching-noise",
            "Links go up and down at random, for 0.1 to 0.4 of transformed time, and messages carry noise 0.05.",
            topology=_drawn_switching((0.1, 0.4), "transformed"),
            channel=_noise(0.05),
        ),
        track(
            "rough-links",
            "Messages travel for 1 to 7 steps, a third of them is lost in bursts, and the rest carries noise 0.05.",
            channel=_chain(
                _channel("Delay", steps=1, longest=7), _channel("BurstLoss", to_bad=0.05, to_good=0.1), _noise(0.05)
            ),
        ),
        track("quantised", "Messages are rounded to multiples of 0.5.", channel=_channel("UniformQuantiser", width=0.5)),
        track("tight-input", "Inputs are limited to 2.", input_limit=2.0),
        track("short-deadline", "A tenth of the time: T = 0.12, and 30 steps.", deadline=0.12, steps=30),
        track("weakly-monotone", "A monotone game that is not strongly monotone.", game=_game("WeaklyMonotoneGame")),
        track("sparse-50", "50 players on a random graph of degree 3; 200 steps.", **_many(50, steps=200), episodes=20),
        track("sparse-200", "200 players on a random graph of degree 3; 100 steps.", **_many(200, steps=100), episodes=2),
        track(
            "unseen",
            "A size and graphs that no policy was made for: 9 players, 100 random graphs.",
            game=_energy(9),
            topology=_graphs(9, 0.25),
            slots=8,
        ),
        track(
            "pushes",
            "50 steps follow the deadline, in which every step pushes the strategies by U(−1, 1) per second.",
            metric="digits_after_hold",
            hold_steps=50,
            disturbance=pushes,
        ),
        Track(
            "strangers",
            nominal.replace(name="strangers"),
            "Players 2 and 4 of 5 follow the paper's static law, beside every policy.",
            teammates=Teammates(law, (1, 3)),
        ),
        track(
            "robots",
            "Five robots in the plane keep posts and connectivity: two components per player.",
            game=_game("ConnectivityControl"),
        ),
    )
    return Suite("ptne-v2", tracks)
