"""The policies that were trained through the world: their recipe, their training, and the table ``learned.md``.

    python -m baselines.learned train NAME [--seeds 0,1,2,3,4] [--out runs]   train a recipe; resumes what is unfinished
    python -m baselines.learned table [--out runs]                            compare, and fill ``learned.md``
    python -m baselines.learned limit                                         digits without a model of the unheard

No world of a suite is trained on: sizes, numbers and fault levels of the generalist's worlds are others, and the worlds
of the suite ``robustness`` are drawn from another seed.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np

from baselines.published import best_law, fill_marks, interval_of, markdown, plain, read, with_interval
from ptne_env import PolicySpec, evaluate, get_scenario, learn
from ptne_env.evaluation import Results, get_policy_spec
from ptne_env.evaluation.tracks import Teammates, Track
from ptne_env.execution import Runner, Workers
from ptne_env.learn import npz_policy, recurrent
from ptne_env.shared.files import write_atomically
from ptne_env.shared.parts import FactorySpec
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.suites import get_suite
from ptne_env.suites.robustness import robustness
from ptne_env.world import distances
from ptne_env.world.world import World

part = FactorySpec.of


def _graphs(players: int, probability: float) -> FactorySpec:
    return part("topology:random-graphs", players=players, probability=probability, seed=1)


def _energy(players: int) -> FactorySpec:
    return part("game:random-energy", players=players, coupling=(0.25 / players, 1.5 / players))


def _noisy(std: float, *stages: FactorySpec) -> FactorySpec:
    return part("channel:chain", stages=[*stages, part("channel:noise", std=std)])


def _cycle(players: int, modes: int, dwell: float, clock: str) -> FactorySpec:
    """The links of a cycle in turn, every mode disconnected."""
    links = [(i, (i + 1) % players) for i in range(players)]
    graphs = [part("topology:edges", players=players, edges=links[mode::modes]) for mode in range(modes)]
    return part("topology:periodic", graphs=graphs, dwells=[dwell] * modes, clock=clock)


def _edges(players: int, probability: float, dwells: tuple[float, float], clock: str) -> FactorySpec:
    """Links of a circulant graph that come and go."""
    graph = part("topology:circulant", players=players, offsets=(1, 2))
    return part("topology:random-edges", graph=graph, probability=probability, dwells=dwells, clock=clock)


BURSTS = part("channel:bursts", to_bad=0.08, to_good=0.15)

BASE = get_scenario("random-energy").replace(steps=240, message_range=80.0, gain=16.0, s_end=5.5)


def _world(name: str, players: int, *, kappa: float | None = None, **changes: Any) -> Track:
    changes = {"game": _energy(players), "topology": _graphs(players, 0.45), "channel": _noisy(0.003)} | changes
    team = None if kappa is None else Teammates(part("law:static", kappa=kappa), (1,))
    return Track(f"train-{name}", BASE.replace(name=f"train-{name}", **changes), name, team)


def _dozen(name: str, offsets: tuple[int, ...], **changes: Any) -> Track:
    """Twelve players on a circulant graph."""
    topology = part("topology:circulant", players=12, offsets=offsets)
    return _world(name, 12, **{"topology": topology, "gain": 6.0, "steps": 200, "channel": _noisy(0.001)} | changes)


WORLDS = (
    _world("clean", 4, channel="perfect", message_range=None),
    _world("cycle-physical", 6, topology=_cycle(6, 3, 0.09, "physical"), channel=_noisy(0.002)),
    _world("cycle-of-four", 4, topology=_cycle(4, 2, 0.13, "physical"), channel=_noisy(0.001)),
    _world("cycle-of-seven", 7, topology=_cycle(7, 3, 0.12, "physical"), channel=_noisy(0.001)),
    _world("edges-physical", 4, topology=_edges(4, 0.3, (0.07, 0.15), "physical"), channel=_noisy(0.002)),
    _world("edges-transformed", 6, topology=_edges(6, 0.35, (0.15, 0.5), "transformed"), channel=_noisy(0.2)),
    _world("cycle-clean", 6, topology=_cycle(6, 3, 0.09, "physical"), channel="perfect", message_range=None),
    _world("edges-clean", 4, topology=_edges(4, 0.4, (0.2, 0.6), "transformed"), channel="perfect", message_range=None),
    _world("late", 4, channel=_noisy(0.1, part("channel:delay", steps=0, longest=5), BURSTS)),
    _world("rounded", 6, channel=part("channel:rounding", width=0.3), topology=_graphs(6, 0.35)),
    _world("liar", 6, channel=_noisy(0.003, part("channel:liar", size=12.0))),
    _world("liar-of-eight", 8, channel=_noisy(0.002, part("channel:liar", size=30.0)), topology=_graphs(8, 0.35)),
    _world("short", 4, deadline=0.15, steps=36, input_limit=6.0, topology=_graphs(4, 0.5)),
    _world("short-six", 6, deadline=0.1, steps=28, input_limit=7.0, topology=_graphs(6, 0.35), channel=_noisy(0.002)),
    _world("stranger", 6, kappa=0.8, channel=_noisy(0.02)),
    _world("stranger-of-four", 4, kappa=0.2, channel=_noisy(0.005)),
    _world(
        "monotone",
        4,
        game=part("game:random-affine", players=4, epsilon=0.0),
        start=part("start:uniform", low=-8.0, high=8.0),
        message_range=40.0,
    ),
    _world("bent", 6, game=part("game:random-saturating", affine=part("game:random-affine", players=6), bend=10.0)),
    _world(
        "monotone-six",
        6,
        game=part("game:random-affine", players=6, epsilon=0.0),
        start=part("start:uniform", low=-12.0, high=12.0),
        message_range=60.0,
        channel=_noisy(0.001),
    ),
    _world(
        "bent-four",
        4,
        game=part("game:random-saturating", affine=part("game:random-affine", players=4), bend=15.0),
        channel=_noisy(0.001),
    ),
    _world(
        "box",
        4,
        game=part("game:random-affine", players=4, action_dim=(2, 1, 3, 1), low=-4.0, high=6.0),
        channel=_noisy(0.05),
    ),
    _world(
        "box-six",
        6,
        game=part("game:random-affine", players=6, action_dim=(1, 3, 1, 2, 2, 1), low=-6.0, high=4.0),
        topology=_graphs(6, 0.35),
        channel=_noisy(0.02),
    ),
    _world("coupled", 5, game=part("game:coupled", game=_energy(4), lines=3), message_range=120.0),
    _world(
        "coupled-six",
        7,
        game=part("game:coupled", game=_energy(6), lines=3),
        topology=_graphs(7, 0.35),
        message_range=120.0,
        channel=_noisy(0.001),
    ),
    _world("ten-switching", 10, topology=_cycle(10, 2, 0.1, "physical"), gain=8.0, steps=200, channel=_noisy(0.001)),
    _dozen("dozen", (1, 3), steps=150),
    _dozen("ring", (1,)),
    _world(
        "steep",
        6,
        game=part("game:random-energy", players=6, curvature=(0.1, 20.0), coupling=(0.0, 0.1)),
        steps=300,
        channel=_noisy(0.001),
    ),
)
"""Like tracks of the suite, with other numbers."""

LATER_WORLDS = (
    _world("stranger-of-five", 5, kappa=0.3, channel=_noisy(0.008)),
    _world("stranger-of-seven", 7, kappa=0.5, channel=_noisy(0.015), topology=_graphs(7, 0.35)),
    _dozen("wide", (1, 3), game=part("game:random-affine", players=12, action_dim=(3,) * 12)),
    _dozen("wide-ring", (1,), game=part("game:random-affine", players=12, action_dim=(4,) * 12)),
)
"""Those that the first stage does not see."""


def drawn(count: int, seed: int = 77) -> tuple[Track, ...]:
    """Random worlds of at most nine players and 500 steps, of another seed than those of the suite."""
    tracks = robustness(seed).tracks
    small = [track for track in tracks if len(track.world.neighbours[0]) <= 9 and track.scenario.steps <= 500]
    return tuple(replace(track, name=f"drawn-{track.name}") for track in small[:count])


FIRST, SECOND, ALL = GENERALIST = "random-worlds-first", "random-worlds-second", "random-worlds"
"""The recipes of the three stages of the generalist, of which each goes on from seed 0 of the one before."""

DEFAULTS = "defaults"
"""That of ``ptne train --algorithm through-world``, with all defaults."""

SHARED = {"hidden": 48, "slot_hidden": 24, "knows_costs": False, "cells": 100}
"""Settings of these stages."""

RECIPES: dict[str, dict[str, Any]] = {
    "random-energy-switching-transformed": {"updates": 1200},
    "random-energy-switching": {
        "updates": 1800,
        "cells": 800,
        "window": 100,
        "memory_shrink": 0.97,
        "hidden": 64,
        "slot_hidden": 32,
        "action_repeat": 4,
    },
    DEFAULTS: {"scenario": "random-energy-switching-transformed"},
    FIRST: SHARED | {"updates": 1200},
    SECOND: SHARED | {"updates": 220},
    ALL: SHARED | {"updates": 120, "rate": 1.5e-3},
}
"""Settings of two specialists, of a user's first run, and of the generalist. The scenario is that of the name, unless
it is among them."""

OUTSIDE = (
    ("curvatures of 0.1 to 4, not 0.5 to 2", {"game": part("game:random-energy", players=5, curvature=(0.1, 4.0))}),
    ("messages that are one step late", {"channel": part("channel:delay", steps=1)}),
    ("dwells twice as long", {"topology": part("topology:paper", dwell=0.5, clock="transformed")}),
    ("eight players", {"game": part("game:random-energy", players=8), "topology": _cycle(8, 4, 0.25, "transformed")}),
)
"""Worlds outside of the family of the first specialist."""


def train(name: str, seeds: list[int], out: Path) -> None:
    """Train a recipe with several seeds, and replace the shipped file."""
    from ptne_env.training import through_world
    from ptne_env.training.configuration import POLICY

    def show(done: int, total: int, digits: float) -> None:
        if done % 50 == 0:
            print(f"{name} {seed}: {done}/{total}, {digits:.3f} digits", flush=True)

    stage = GENERALIST.index(name) if name in GENERALIST else 0
    start = str(out / GENERALIST[stage - 1] / "seed-0" / POLICY) if stage else ""
    tracks = WORLDS + drawn(6) if name in GENERALIST else ()
    if stage:
        tracks = LATER_WORLDS + tracks
    folders = [out / name / f"seed-{seed}" for seed in seeds]
    for seed, folder in zip(seeds, folders, strict=True):
        recipe = {"scenario": name, "seed": seed, "start": start} | RECIPES[name]
        summary = through_world.train(through_world.Settings(**recipe), folder, show, tracks)
        steps = f"{summary.agent_steps / 1e6:.1f} M agent-steps"
        print(f"{name} {seed}: {summary.digits:.2f} digits, {steps}, {summary.seconds:.0f} s")
    if name not in {DEFAULTS, FIRST, SECOND}:
        ship(name, folders)


def ship(name: str, folders: list[Path]) -> None:
    """Replace the shipped file by the best policy in training."""
    runs = [learn.load(folder / "policy.npz") for folder in folders]
    best = max(runs, key=lambda run: float(run.training["digits"]))
    start = Path(best.training["start"]).parent.parent.name  # the recipe, on every machine
    shipped = Path(learn.__file__).parent / f"recurrent-{name}.npz"
    write_atomically(shipped, npz_policy.seal(best.weights, best.training | {"start": start}))


def untrained(out: Path, seeds: int = 20) -> PolicySpec:
    """Networks with random weights."""
    for seed in range(seeds):
        weights = recurrent.initial_weights(np.random.default_rng(seed))
        write_atomically(out / "untrained" / f"seed-{seed}.npz", npz_policy.seal(weights, {"seed": seed}))
    return get_policy_spec(f"untrained={out}/untrained/seed-*.npz")


def trained(name: str, out: Path) -> PolicySpec:
    """All training seeds of a recipe that are there."""
    return get_policy_spec(f"trained={out}/{name}/seed-*/policy.npz")


def digits(results: Results, track: str, policy: str) -> str:
    """The mean with its interval, and the spread over training seeds."""
    return with_interval(interval_of(results.record(track, policy, "digits"))) + spread(results, track, policy)


def spread(results: Results, track: str, policy: str) -> str:
    """The standard deviation over training seeds, and their number, if there are several."""
    seeds = results.samples[track, policy]["digits"].mean(1)
    return f" ± {seeds.std(ddof=1):.2f} ({len(seeds)})" if len(seeds) > 1 else ""


def table(out: Path) -> None:
    """Play the specialists on the test episodes of the published laws, and fill ``learned.md``.

    The numbers of the generalist are those of ``results.csv``.
    """
    published, run = read(), Runner(out / "played", Workers(2))

    def played(world: str, name: str, policy: str | PolicySpec, episodes: int = 200) -> str:
        """The digits of a policy of this name."""
        return digits(evaluate(policy, [world], episodes=episodes, run=run), world, name)

    rows = []
    for name in [name for name in RECIPES if name not in GENERALIST]:
        world = str(RECIPES[name].get("scenario", name))
        theirs = plain(published.cell("comparison", world, "static"))
        before = played(world, "untrained", untrained(out), episodes=10)
        ours, file = played(world, "trained", trained(name, out)), f"recurrent-{name}"
        shipped = "–" if name == DEFAULTS else played(world, file, file)
        label = world + ", defaults of `ptne train`" * (name == DEFAULTS)
        law, cell = best_law(published, "comparison", world)
        rows.append([label, theirs, f"{law} {with_interval(cell)}", before, ours, shipped])
    heading = "trained through the world"
    headings = ["", "the paper's law", "best law", "untrained", heading, "the shipped file"]
    parts = {"specialists": markdown(headings, rows)}

    family = get_scenario("random-energy-switching-transformed")
    players = "routed-unknown", f"recurrent-{family.name}"
    outside = [family.replace(name=name, **changes) for name, changes in OUTSIDE]
    found = evaluate(players, outside, episodes=100, run=run)
    rows = [[name, *(digits(found, name, player) for player in players)] for name, _ in OUTSIDE]
    parts["outside"] = markdown(["", "routed-unknown", "the first specialist"], rows)

    rows, shipped, suite = [], f"recurrent-{ALL}", get_suite("ptne-v1")
    found = evaluate(trained(ALL, out), suite.tracks, episodes=suite.episodes, run=run)
    for track in published.names("track", "ptne-v1"):
        ours = with_interval(published.cell("ptne-v1", track, shipped))
        rows.append([track, ours + spread(found, track, "trained")])
    parts["tracks"] = markdown(["", heading], rows)

    document = Path(__file__).with_suffix(".md")
    parts["limit"] = f"{limit('random-energy-switching'):.2f}"
    write_atomically(document, fill_parts(document.read_text(encoding="utf-8"), parts))


def fill_parts(text: str, parts: Mapping[str, str]) -> str:
    """The document with what stands between its marks ``<!-- part NAME -->`` and ``<!-- end of part -->``."""
    return fill_marks(text, "part", "end of part", parts.__getitem__)


def limit(name: str, episodes: int = 200) -> float:
    """The mean digits of players who do all that is possible but predict players whom they cannot hear.

    In every dwell, linked players share their freshest estimates, and play the exact equilibrium among themselves,
    given these. For affine games whose players have one component.
    """
    world, streams = World(get_scenario(name)), [RandomStreams.from_seed(seed) for seed in range(episodes)]
    game, num_players = world.draw_game(streams), world.game.num_players
    truth = game.nash_equilibria
    jacobian = game.jacobian(truth).transpose(2, 0, 1)
    errors = (world.draw_estimates(streams) - truth[:, None]).transpose(1, 2, 0)  # of a player, in an episode
    heard_at = np.eye(num_players)
    for dwell, (mode, _) in enumerate(groupby(world.modes[:-1]), start=2):
        for linked in map(list, nx.connected_components(nx.from_numpy_array(world.topology.graphs[mode].adjacency))):
            others = [player for player in range(num_players) if player not in linked]
            freshest = np.array(linked)[heard_at[linked].argmax(0)]
            shared = errors[freshest, :, range(num_players)].T
            pressure = jacobian[:, linked][:, :, others] @ shared[:, others, None]
            shared[:, linked] = -np.linalg.solve(jacobian[:, linked][:, :, linked], pressure)[..., 0]
            heard_at[linked] = heard_at[linked].max(0)
            heard_at[np.ix_(linked, linked)] = dwell
            errors[linked] = shared
    estimates = truth[:, None] + errors.transpose(2, 0, 1)
    return float(distances.digits(distances.estimate_distance(estimates, game)).mean())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("train", "table", "limit"))
    parser.add_argument("name", nargs="?", choices=tuple(RECIPES), default=ALL)
    parser.add_argument("--seeds", default="0")
    parser.add_argument("--out", type=Path, default=Path("runs"))
    given = parser.parse_args()
    if given.command == "train":
        train(given.name, [int(seed) for seed in given.seeds.split(",")], given.out)
    elif given.command == "table":
        table(given.out)
    else:
        print(f"{limit('random-energy-switching'):.2f} digits")
