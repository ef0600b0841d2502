"""The suite ptne-v2, which the best known policies do not saturate. Its content is frozen."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ptne_env.evaluation.suite import Suite, Teammates, Track
from ptne_env.shared.parts import FactorySpec
from ptne_env.world.catalogue import get_scenario


def _game(name: str, **arguments: Any) -> FactorySpec:
    return FactorySpec.of(f"ptne_env.games:{name}", **arguments)


def _energy(players: int) -> FactorySpec:
    """Random energy games whose total coupling is that of five players."""
    return _game("RandomEnergy", players=players, coupling=(0.25 / players, 1.5 / players))


def _graphs(players: int, probability: float) -> FactorySpec:
    """Every episode draws one of 100 connected random graphs, in which each pair is linked with a probability."""
    return FactorySpec.of("ptne_env.world.switching:random_graphs", players=players, probability=probability, seed=2)


def _switching(shortest: float, longest: float, clock: str) -> FactorySpec:
    """Every link of a graph of seven links is up with probability 0.4, drawn again after every dwell."""
    edges = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0), (0, 2), (0, 3)]
    graph = FactorySpec.of("ptne_env.world.graphs:from_edges", players=5, edges=edges)
    drawn = {"probability": 0.4, "modes": 64, "seed": 2}
    return FactorySpec.of(
        "ptne_env.world.switching:random_edges", graph=graph, dwells=(shortest, longest), clock=clock, **drawn
    )


def _channel(name: str, **arguments: Any) -> FactorySpec:
    return FactorySpec.of(f"ptne_env.world.channel:{name}", **arguments)


def _noisy(std: float, *stages: FactorySpec) -> FactorySpec:
    """A channel of stages, the last of which is noise."""
    noise = _channel("AdditiveNoise", std=std)
    return _channel("Chain", stages=[*stages, noise]) if stages else noise


NOISE = _noisy(0.001)
"""The channel of the base."""

BASE = get_scenario("random-energy").replace(name="base", topology=_graphs(5, 0.4), slots=4, channel=NOISE, steps=300)
"""Random energy games of five players, each on a graph of its own; messages carry noise."""


_BEST_KNOWN = {
    "clean": 12.00,  # adaptive-grounded
    "switching-physical": 3.89,  # link-relay
    "switching-noise": 2.70,  # relay
    "rough-links": 3.10,  # contact-relay
    "quantised": 2.02,  # routed-unknown
    "one-way": 4.90,  # contact-relay
    "liar": 2.64,  # contact-relay
    "unseen": 4.98,  # contact-relay
    "sensor": 3.32,  # contact-relay
    "tight-input": 4.61,  # contact-relay
    "short-deadline": 4.07,  # contact-relay
    "drift": 2.02,  # contact-relay
    "pushes": 3.04,  # proximal-best-response
    "strangers": 8.63,  # routed-unknown
    "non-affine": 4.40,  # contact-relay
    "weakly-monotone": 2.70,  # relay
    "uneven": 4.61,  # contact-relay
    "robots": 4.17,  # contact-relay
    "coupled": 3.79,  # multi-rate
    "crowd-50": 4.46,  # relay
    "crowd-200": 4.08,  # relay
}
"""Digits of the best honest entry on each track, over the test episodes: the output of ``baselines/best_known.py``."""


def _track(name: str, change: str, *, metric: str = "digits", episodes: int | None = None, **changes: Any) -> Track:
    scenario = BASE.replace(name=name, **changes)
    return Track(name, scenario, change, metric, episodes=episodes, best_known=_BEST_KNOWN[name])


def _fixed(graph: str, **arguments: Any) -> FactorySpec:
    """One graph, which policies may know."""
    graph_spec = FactorySpec.of(f"ptne_env.world.graphs:{graph}", **arguments)
    return FactorySpec.of("ptne_env.world.switching:fixed", graph=graph_spec)


def _crowd(players: int, steps: int, episodes: int) -> dict[str, Any]:
    """Many players on one random graph of degree 3, in few episodes and steps."""
    topology = _fixed("random_regular", players=players, degree=3, seed=2)
    time = {"gain": 5.0, "s_end": 5.0, "steps": steps}
    return {"game": _energy(players), "topology": topology, "slots": None, "episodes": episodes, **time}


def _links() -> tuple[Track, ...]:
    """Tracks with other links."""
    return (
        _track(
            "clean",
            "The sanity track, ranked by time: the 5-cycle, and messages without noise.",
            topology=get_scenario("random-energy").topology,
            slots=None,
            channel="perfect",
        ),
        _track(
            "switching-physical",
            "Links go up and down at random, every 0.05 to 0.15 s of physical time.",
            topology=_switching(0.05, 0.15, "physical"),
        ),
        _track(
            "switching-noise",
            "Links go up and down at random, every 0.1 to 0.4 of transformed time, and messages carry noise 0.05.",
            topology=_switching(0.1, 0.4, "transformed"),
            channel=_noisy(0.05),
        ),
        _track(
            "rough-links",
            "Messages travel for 1 to 7 steps, a third of them is lost in bursts, and the rest carries noise 0.05.",
            channel=_noisy(
                0.05, _channel("Delay", steps=1, longest=7), _channel("BurstLoss", to_bad=0.05, to_good=0.1)
            ),
        ),
        _track(
            "quantised", "Messages are rounded to multiples of 0.5.", channel=_channel("UniformQuantiser", width=0.5)
        ),
        _track(
            "one-way",
            "Half of the links carry messages in one direction only, as far as news still reach all players.",
            channel=_noisy(0.001, _channel("OneWayLinks", share=0.5)),
        ),
        _track(
            "liar",
            "One player adds a constant of up to 1 to all that it says of other players.",
            channel=_noisy(0.001, _channel("Lying", size=1.0)),
        ),
        _track(
            "unseen",
            "Nine players on sparser graphs, a size without a policy of its own.",
            game=_energy(9),
            topology=_graphs(9, 0.25),
            slots=8,
        ),
    )


def _limits() -> tuple[Track, ...]:
    """Tracks with less time, smaller inputs, worse sensors, or unrest."""
    pushes = FactorySpec.of(
        "ptne_env.world.disturbances:UniformDisturbance", bound=5.0, dwell=10, after_deadline_only=True
    )
    return (
        _track(
            "sensor",
            "Own gradients carry noise of standard deviation 0.01, and messages noise of 0.05.",
            sensor=FactorySpec.of("ptne_env.world.sensor:GradientNoise", std=0.01),
            channel=_noisy(0.05),
        ),
        _track("tight-input", "Inputs are limited to 1.8, which leaves little time to spare.", input_limit=1.8),
        _track(
            "short-deadline",
            "A tenth of the time in a tenth of the steps: T = 0.12, 30 steps.",
            deadline=0.12,
            steps=30,
        ),
        _track(
            "drift",
            "The equilibrium swings by up to 5 with a period of 1 s; the mean distance over the second half counts.",
            metric="tracking_digits",
            drift=FactorySpec.of("ptne_env.world.drift:Sinusoid", amplitude=5.0, period=1.0),
        ),
        _track(
            "pushes",
            "In 50 steps after the deadline, strategies are pushed by U(−5, 5) per second, redrawn every 10 steps.",
            metric="digits_after_hold",
            hold_steps=50,
            disturbance=pushes,
        ),
        replace(
            _track(
                "strangers",
                "Players 2 and 4 of 5 follow the paper's static law; messages carry noise 1e-8 only.",
                channel=_noisy(1e-8),
            ),
            teammates=Teammates(FactorySpec.of("ptne_env.laws:Static", kappa=2.0), (1, 3)),
            ceiling=9.89,
        ),
    )


def _games() -> tuple[Track, ...]:
    """Tracks with other games."""
    uneven = (1, 2, 3, 1, 2)
    return (
        _track("non-affine", "Random games with saturating prices, strongly monotone.", game=_game("RandomSaturating")),
        _track(
            "weakly-monotone",
            "Random affine games that are monotone and not strongly monotone.",
            game=_game("RandomAffine", epsilon=0.0),
        ),
        _track(
            "uneven",
            "Random affine games of players with 1, 2, 3, 1 and 2 components.",
            game=_game("RandomAffine", action_dim=uneven),
        ),
        _track(
            "robots",
            "Five robots in the plane keep posts and connectivity: two components per player.",
            game=_game("ConnectivityControl"),
        ),
        _track(
            "coupled",
            "Two shared constraints, priced by a sixth player: a variational generalised Nash equilibrium.",
            game=_game("CoupledConstraint", game=_game("RandomEnergy", players=5), lines=2),
            topology=_fixed("cycle", players=6),
            slots=None,
        ),
        _track("crowd-50", "50 players on a sparse graph: 10 episodes of 200 steps.", **_crowd(50, 200, 10)),
        _track("crowd-200", "200 players on a sparse graph: 2 episodes of 100 steps.", **_crowd(200, 100, 2)),
    )


def ptne_v2() -> Suite:
    """The suite ``ptne-v2``: tracks that each change one thing of :data:`BASE`."""
    tracks = (*_links(), *_limits(), *_games())
    return Suite("ptne-v2", tracks, frozen="595c7d7423ede68977ad0a6b55bb0990555faf284675595d92ce1b464e20369a")
