"""The published suite ptne-v1."""

from __future__ import annotations

from typing import Any

from ptne_env.evaluation.suite import Suite, Teammates, Track
from ptne_env.shared.parts import FactorySpec
from ptne_env.world.catalogue import get_scenario


def ptne_v1() -> Suite:
    """The suite ``ptne-v1``: twenty tracks that each change one thing of the base."""
    base = get_scenario("random-energy")

    def track(name: str, change: str, *, metric: str = "digits", **changes: Any) -> Track:
        return Track(name, base.replace(name=name, **changes), change, metric)

    def many(players: int, stride: int) -> dict[str, Any]:
        """Players on a circulant graph of degree 4, their total coupling that of five."""
        graph = FactorySpec.of("topology:circulant", players=players, offsets=(1, stride))
        coupling = (0.25 / players, 1.5 / players)
        return {
            "game": FactorySpec.of("ptne_env.games:RandomEnergy", players=players, coupling=coupling),
            "topology": FactorySpec.of("ptne_env.world.switching:fixed", graph=graph),
        }

    nominal = track("nominal", "The base: random energy games of five players on the 5-cycle, T = 1.2, c = 20.")
    law = FactorySpec.of("ptne_env.laws:Static", kappa=2.0)
    non_quadratic = FactorySpec.of("ptne_env.games:NonQuadraticGame", variant="corrected")
    pairs = ([(0, 1), (2, 3)], [(1, 2), (3, 4)], [(2, 3), (4, 0)], [(3, 4), (0, 1)])
    modes = [FactorySpec.of("ptne_env.world.graphs:from_edges", players=5, edges=pair) for pair in pairs]
    uniformly = [[0.25] * 4] * 4
    pushes = FactorySpec.of(
        "ptne_env.world.faults:UniformDisturbance", bound=1.0, dwell=25, after_deadline_only=True
    )

    def channel(name: str, **arguments: Any) -> FactorySpec:
        return FactorySpec.of(f"ptne_env.world.channel:{name}", **arguments)

    tracks = (
        nominal,
        track(
            "switching-physical",
            "The graph switches between four disconnected ones, every 0.1 s of physical time.",
            topology=get_scenario("random-energy-switching").topology,
        ),
        track(
            "switching-transformed",
            "The graph switches between four disconnected ones, every 0.25 of transformed time.",
            topology=get_scenario("random-energy-switching-transformed").topology,
        ),
        track(
            "markov",
            "Every 0.1 of transformed time one of the same four graphs is drawn, independently of the one before.",
            topology=FactorySpec.of(
                "topology:markov", graphs=modes, transition=uniformly, dwells=0.1, clock="transformed"
            ),
        ),
        track(
            "noise",
            "Messages carry Gaussian noise of standard deviation 0.05.",
            channel=channel("AdditiveNoise", std=0.05),
        ),
        track(
            "delay",
            "Messages travel for 1 to 7 steps, drawn each, and may overtake each other.",
            channel=channel("Delay", steps=1, longest=7),
        ),
        track(
            "burst-loss",
            "A third of the messages is lost, in bursts of 10 steps on average; receivers hold the last one.",
            channel=channel("BurstLoss", to_bad=0.05, to_good=0.1),
        ),
        track("quantised", "Messages are rounded to multiples of 0.1.", channel=channel("UniformQuantiser", width=0.1)),
        track("saturated", "Inputs are limited to 2, which binds in the first half of an episode.", input_limit=2.0),
        track("coarse-step", "150 steps to the deadline instead of 400.", steps=150),
        track(
            "large-20", "20 players, on a circulant graph of degree 4; total coupling as in the base.", **many(20, 4)
        ),
        track(
            "large-50", "50 players, on a circulant graph of degree 4; total coupling as in the base.", **many(50, 7)
        ),
        track(
            "unseen-graphs",
            "Every episode draws one of 100 connected random graphs, in which half of all pairs are linked; 4 slots.",
            topology=FactorySpec.of(
                "ptne_env.world.switching:random_graphs", players=5, probability=0.5, modes=100, seed=0
            ),
            slots=4,
        ),
        track("non-quadratic", "The paper's Example 2, whose pseudo-gradient is not Lipschitz.", game=non_quadratic),
        track(
            "weakly-monotone",
            "A game whose pseudo-gradient is monotone but not strongly monotone.",
            game=FactorySpec.of("ptne_env.games:WeaklyMonotoneGame"),
        ),
        track(
            "wrong-clock",
            "The players' clocks are up to 0.2 s fast or slow.",
            clock_shifts=(-0.2, 0.1, 0.0, 0.2, -0.1),
        ),
        track("short-deadline", "A quarter of the time: T = 0.3 at the same c.", deadline=0.3),
        track(
            "hold",
            "100 steps follow the deadline, in which the strategies are pushed by U(−1, 1) per second.",
            metric="digits_after_hold",
            hold_steps=100,
            disturbance=pushes,
        ),
        Track(
            "mixed-team",
            nominal.scenario.replace(name="mixed-team"),
            "Players 2 and 4 of 5 follow the paper's static law, beside every policy.",
            teammates=Teammates(law, (1, 3)),
        ),
        track(
            "robots",
            "Five robots in the plane keep posts and connectivity: two components per player.",
            game=FactorySpec.of("ptne_env.field.games:ConnectivityControl"),
        ),
    )
    return Suite("ptne-v1", tracks)
