"""The network for all tracks that was trained through the world: its worlds, its training, and ``learned.md``.

    python -m baselines.learned train [--seeds 0,1,2,3,4] [--out runs]   train; resumes what is unfinished
    python -m baselines.learned train --without liar [--out runs]        a quarter as long, without the worlds of a kind
    python -m baselines.learned table [--out runs]                       play all of them, and fill ``learned.md``

No world of a suite is trained on: sizes, numbers and fault levels of these worlds are others, and the worlds of the
suite ``robustness`` are drawn from another seed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

from baselines.published import TRAINED, fill_marks, markdown
from ptne_env import evaluate, get_scenario, learn
from ptne_env.evaluation import get_policy_spec
from ptne_env.evaluation.tracks import Teammates, Track
from ptne_env.shared.files import write_atomically
from ptne_env.shared.parts import FactorySpec
from ptne_env.suites import get_suite
from ptne_env.suites.robustness import robustness

part = FactorySpec.of


def _graphs(players: int, probability: float) -> FactorySpec:
    return part("topology:random-graphs", players=players, probability=probability, seed=1)


def _energy(players: int) -> FactorySpec:
    return part("game:random-energy", players=players, coupling=(0.25 / players, 1.5 / players))


def _affine(players: int, **arguments: Any) -> FactorySpec:
    return part("game:random-affine", players=players, **arguments)


def _saturating(players: int, bend: float) -> FactorySpec:
    return part("game:random-saturating", affine=_affine(players), bend=bend)


def _coupled(firms: int) -> FactorySpec:
    return part("game:coupled", game=_energy(firms), lines=3)


def _within(largest: float) -> dict[str, Any]:
    """Starts within a range, and messages within five times that."""
    return {"start": part("start:uniform", low=-largest, high=largest), "message_range": 5 * largest}


def _noisy(std: float, *stages: FactorySpec) -> FactorySpec:
    return part("channel:chain", stages=[*stages, part("channel:noise", std=std)])


def _cycle(players: int, modes: int, dwell: float) -> FactorySpec:
    """The links of a cycle in turn, every mode disconnected."""
    links = [(i, (i + 1) % players) for i in range(players)]
    graphs = [part("topology:edges", players=players, edges=links[mode::modes]) for mode in range(modes)]
    return part("topology:periodic", graphs=graphs, dwells=[dwell] * modes, clock="physical")


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
    _world("stranger-of-five", 5, kappa=0.3, channel=_noisy(0.008)),
    _world("stranger-of-seven", 7, kappa=0.5, channel=_noisy(0.015), topology=_graphs(7, 0.35)),
    _dozen("wide", (1, 3), game=_affine(12, action_dim=(3,) * 12)),
    _dozen("wide-ring", (1,), game=_affine(12, action_dim=(4,) * 12)),
    _world("clean", 4, channel="perfect", message_range=None),
    _world("cycle-physical", 6, topology=_cycle(6, 3, 0.09), channel=_noisy(0.002)),
    _world("cycle-of-four", 4, topology=_cycle(4, 2, 0.13), channel=_noisy(0.001)),
    _world("cycle-of-seven", 7, topology=_cycle(7, 3, 0.12), channel=_noisy(0.001)),
    _world("edges-physical", 4, topology=_edges(4, 0.3, (0.07, 0.15), "physical"), channel=_noisy(0.002)),
    _world("edges-transformed", 6, topology=_edges(6, 0.35, (0.15, 0.5), "transformed"), channel=_noisy(0.2)),
    _world("cycle-clean", 6, topology=_cycle(6, 3, 0.09), channel="perfect", message_range=None),
    _world("edges-clean", 4, topology=_edges(4, 0.4, (0.2, 0.6), "transformed"), channel="perfect", message_range=None),
    _world("late", 4, channel=_noisy(0.1, part("channel:delay", steps=0, longest=5), BURSTS)),
    _world("rounded", 6, channel=part("channel:rounding", width=0.3), topology=_graphs(6, 0.35)),
    _world("liar", 6, channel=_noisy(0.003, part("channel:liar", size=12.0))),
    _world("liar-of-eight", 8, channel=_noisy(0.002, part("channel:liar", size=30.0)), topology=_graphs(8, 0.35)),
    _world("short", 4, deadline=0.15, steps=36, input_limit=6.0, topology=_graphs(4, 0.5)),
    _world("short-six", 6, deadline=0.1, steps=28, input_limit=7.0, topology=_graphs(6, 0.35), channel=_noisy(0.002)),
    _world("stranger", 6, kappa=0.8, channel=_noisy(0.02)),
    _world("stranger-of-four", 4, kappa=0.2, channel=_noisy(0.005)),
    _world("monotone", 4, game=_affine(4, epsilon=0.0), **_within(8.0)),
    _world("bent", 6, game=_saturating(6, bend=10.0)),
    _world("monotone-six", 6, game=_affine(6, epsilon=0.0), channel=_noisy(0.001), **_within(12.0)),
    _world("bent-four", 4, game=_saturating(4, bend=15.0), channel=_noisy(0.001)),
    _world("box", 4, game=_affine(4, action_dim=(2, 1, 3, 1), low=-4.0, high=6.0), channel=_noisy(0.05)),
    _world(
        "box-six",
        6,
        game=_affine(6, action_dim=(1, 3, 1, 2, 2, 1), low=-6.0, high=4.0),
        topology=_graphs(6, 0.35),
        channel=_noisy(0.02),
    ),
    _world("coupled", 5, game=_coupled(4), message_range=120.0),
    _world(
        "coupled-six",
        7,
        game=_coupled(6),
        topology=_graphs(7, 0.35),
        message_range=120.0,
        channel=_noisy(0.001),
    ),
    _world("ten-switching", 10, topology=_cycle(10, 2, 0.1), gain=8.0, steps=200, channel=_noisy(0.001)),
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

EXACT = {"gain": 4.0, "steps": 200, "channel": "perfect", "message_range": None}
HARDER_WORLDS = (
    _world("ring-of-24", 24, topology=part("topology:cycle", players=24), **EXACT),
    _world("path-of-16", 16, topology=part("topology:path", players=16), **EXACT),
    _world("ring-of-16", 16, topology=part("topology:cycle", players=16), **EXACT | {"channel": _noisy(0.0003)}),
    _world("lossy", 6, channel=part("channel:loss", probability=0.7), topology=_graphs(6, 0.5)),
    _world("lossy-star", 7, channel=part("channel:loss", probability=0.5), topology=part("topology:star", players=7)),
    _world("delayed", 5, channel=part("channel:delay", steps=0, longest=9), topology=_graphs(5, 0.4)),
    _world("delayed-ring", 8, channel=part("channel:delay", steps=4), topology=part("topology:cycle", players=8)),
)
"""Long ways, heavy loss and long delays."""


def drawn(seed: int, *kinds: str, most_steps: int = 700) -> tuple[Track, ...]:
    """Random worlds without heavy tails of at most nine players, of some kinds and another seed than the suites."""
    return tuple(
        replace(track, name=f"drawn-{seed}-{track.name}")
        for track in robustness(seed).tracks
        if len(track.world.neighbours[0]) <= 9
        and track.scenario.steps <= most_steps
        and "tails" not in track.change
        and any(kind in track.change for kind in kinds or ("",))
    )


LEFT_OUT = {"liar": "liar", "rounding": "round", "short-deadline": "short", "coupled": "coupled"}
"""Mechanisms that a training may leave out, by their tracks, and the word by which their worlds are known."""


def worlds(without: str | None = None) -> tuple[Track, ...]:
    """The worlds of the training, without those of a mechanism."""
    rotating = [track for seed in (77, 78, 79) for track in drawn(seed, "rotating")]
    others = [track for track in drawn(78, "a perfect channel", "complements") if "rotating" not in track.change]
    every = (*WORLDS, *drawn(77, most_steps=500)[:6], *HARDER_WORLDS, *rotating, *others[:10])
    return tuple(track for track in every if without is None or LEFT_OUT[without] not in track.change)


SETTINGS = {"updates": 2600, "groups": 4, "cells": 100, "hidden": 48, "slot_hidden": 24}
"""Those of :class:`ptne_env.training.through_world.Settings` that are not the defaults."""


def train(seeds: list[int], out: Path, without: str | None) -> None:
    """Train several seeds. Seed 0 replaces the shipped file, so that nobody chose among seeds."""
    from ptne_env.training import through_world
    from ptne_env.training.configuration import POLICY

    def show(done: int, total: int, digits: float) -> None:
        if done % 50 == 0:
            print(f"seed {seed}: {done}/{total}, {digits:.3f} digits", flush=True)

    name, updates, tracks = TRAINED, SETTINGS["updates"], worlds(None if without == "nothing" else without)
    if without is not None:
        name, updates = f"{TRAINED}-without-{without}", updates // 4
    for seed in seeds:
        began = process_time()
        settings = through_world.Settings(name, seed=seed, **SETTINGS | {"updates": updates})
        summary = through_world.train(settings, folder := out / name / f"seed-{seed}", show, tracks)
        steps = f"{summary.agent_steps / 1e6:.1f} M agent-steps"
        print(f"seed {seed}: {summary.digits:.2f} digits, {steps}, {(process_time() - began) / 60:.0f} core minutes")
        if seed == 0 and without is None:
            write_atomically(learn.shipped_path(TRAINED), (folder / POLICY).read_bytes())


def play(out: Path, name: str, tracks: Iterable[str]) -> dict[str, Any]:
    """Return the digits of all seeds of a training by track, each of shape ``(seeds,)``."""
    seeds = get_policy_spec(f"{name}={out}/{name}/seed-*/policy.npz")
    names = {track: f"ptne-v1/{track}" for track in tracks}  # a track as an object draws other episodes
    found = evaluate(seeds, [*names.values()]).samples
    return {track: found[names[track], name]["digits"].mean(1) for track in names}


def table(out: Path) -> None:
    """Play all seeds on the suite, and the networks that lack a mechanism on its track; fill ``learned.md``."""
    digits = play(out, TRAINED, [track.name for track in get_suite("ptne-v1").tracks])
    rows = [[track, f"{means.mean():.2f}", f"{means.std(ddof=1):.2f}"] for track, means in digits.items()]
    parts = {"spread": markdown(["track", f"mean of {len(digits['nominal'])} seeds", "standard deviation"], rows)}
    complete, rows = play(out, f"{TRAINED}-without-nothing", LEFT_OUT), []
    for track in LEFT_OUT:
        lacking = play(out, f"{TRAINED}-without-{track}", [track])[track]
        both = complete[track].mean(), lacking.mean()
        rows.append([track, *(f"{each:.2f}" for each in (*both, both[0] - both[1]))])
    parts["without"] = markdown(["track", "trained with all worlds", "without those of its kind", "loss"], rows)
    document = Path(__file__).with_suffix(".md")
    text = document.read_text(encoding="utf-8")
    write_atomically(document, fill_marks(text, "part", "end of part", parts.__getitem__))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("train", "table"))
    parser.add_argument("--seeds", default="0")
    parser.add_argument("--without", choices=("nothing", *LEFT_OUT))
    parser.add_argument("--out", type=Path, default=Path("runs"))
    given = parser.parse_args()
    if given.command == "train":
        train([int(seed) for seed in given.seeds.split(",")], given.out, given.without)
    else:
        table(given.out)
