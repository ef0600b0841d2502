"""Read what a policy without sizes learned: its trust in messages, and its gates as sums that a person can read.

Run it with ``python baselines/read_policy.py POLICY``. It plays the tracks of ptne-v1 and ptne-v2 that all players play
by themselves, without those of more than 20 players, on training and validation episodes, and prints

- the medians of the picture: the trust in a message with noise and switching links, beside laws in the same states;
- the closed form: every gate as a clipped sum of features, fitted to the network in the states that it visits, beside
  the law that it is compared with, and the digits that each change brings alone;
- the digits of network, closed form and law on every track.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import torch
import typer
from common import Jobs, table
from scipy.optimize import minimize
from scipy.sparse.csgraph import shortest_path

from ptne_env import FactorySpec, Scenario
from ptne_env.evaluation import Workers, get_suite
from ptne_env.evaluation.episodes import Split
from ptne_env.evaluation.suite import Suite
from ptne_env.field.laws.gated import CellGates, GatedLaw, SlotEvidence, SlotGates
from ptne_env.learn.size_free import CELL_FEATURES, HIGH, LOW, SLOT_FEATURES
from ptne_env.learn.training import evolution
from ptne_env.learn.training.actor import effects
from ptne_env.learn.training.cells import CELL_GATES, CellBatch
from ptne_env.learn.training.export import size_free_from_onnx, size_free_to_onnx
from ptne_env.learn.training.network import ALWAYS, POINTS, GateNetwork
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.files import write_atomically
from ptne_env.shared.style import COLOURS, drawing

Rows: TypeAlias = dict[str, FloatArray]
"""Columns of equal length by name."""

Play: TypeAlias = tuple[Scenario, list[int]]
"""A world and the seeds of its episodes."""

NOISY = ("switching-noise", "rough-links")
"""Tracks of ptne-v2 in which trust is read."""

LEVELS = (0.0005, 0.005, 0.05, 0.5, 5.0)
"""Standard deviations of the noise there; the tracks have the third."""

BESIDE = ("observer-relay", "contact-relay")
"""Laws whose trust is drawn beside that of the network."""

FEWEST = 50
"""Values in a bin, below which it is left out."""

NOISE = 0.05
"""Their own standard deviation."""

RESTLESS = 40
"""Steps without rest from which trust is read, as laws trust noisy messages less after some time."""

LARGEST = 20
"""Players, beyond which a track is left out."""

SAMPLES = 1500
"""Cells of each track to which the closed form is fitted."""

WORTH, LEAST = 0.2, 1e-6
"""A term of the closed form lowers the mean squared error of its gate by this share, and by this."""

STAY = 1e-6
"""Weight of the distance from the law in a fit: it decides between sums that are equal in all samples."""

TERMS = 8
"""Most terms of a gate."""


def steps(
    network: GateNetwork, scenario: Scenario, seeds: Sequence[int]
) -> Iterator[tuple[CellBatch, npt.NDArray[Any], npt.NDArray[Any]]]:
    """Play episodes; before every step the batch, and the features of cells and of their slots."""
    batch = CellBatch(scenario, len(seeds))
    batch.start(seeds)
    while not batch.is_over:
        cell, slot = batch.features()
        yield batch, cell, slot
        batch.step(*batch.as_gates(*network.decide(cell, slot)))


# --- trust ------------------------------------------------------------------------------------------------------------


def trust(gates: CellGates, slot_gates: SlotGates, slots: SlotEvidence) -> tuple[FloatArray, FloatArray]:
    """Weights of neighbours in the displacement of a component, and in the private belief, shapes (R, D, n)."""
    shares = slots.live * slot_gates.copy
    means = slot_gates.mean * slots.samples / np.maximum(slots.spread**2, 1e-14)
    return gates.copies[:, None] * _normalised(shares), _normalised(means)


def _normalised(shares: FloatArray) -> FloatArray:
    total = shares.sum(axis=1, keepdims=True)
    return shares / np.where(total > 0, total, 1.0)


def hops(live: npt.NDArray[Any], batch: CellBatch) -> FloatArray:
    """Links from each neighbour to the owner of each component, over the links that were ever live, shape (R, D, n)."""
    neighbours, owners = np.array(batch.layout.neighbours), batch.world.game.owners
    players = np.arange(len(neighbours))
    found = []
    for links in live.reshape(batch.episodes, *neighbours.shape):
        adjacency = np.zeros((len(players), len(players)))
        np.maximum.at(adjacency, (players[:, None], neighbours), links)
        found.append(shortest_path(adjacency, directed=False, unweighted=True)[neighbours][:, :, owners])
    return np.concatenate(found)


def readings(network: GateNetwork, scenario: Scenario, seeds: Sequence[int]) -> Rows:
    """Trust in messages about components of others, of the network and of the laws in the states that it visits."""
    policies = {"network": network, **{name: GateNetwork.of_law(name) for name in BESIDE}}
    parts: list[Rows] = []
    ever: npt.NDArray[Any] = np.zeros(())
    for batch, cell, slot in steps(network, scenario, seeds):
        cells, slots = batch.evidence
        shape = slots.relative.shape
        part = {"live": slots.live, "contact": slots.contact, "age": slots.age, "samples": slots.samples}
        part |= {
            "source": slots.source,
            "noisy": cells.noisy[:, None],
            "restless": cells.restless[:, None],
            "scale": cells.scale[:, None],
        }
        part["other"] = 1.0 - cells.own[:, None]
        for name, policy in policies.items():
            part[f"weight of {name}"], part[f"belief of {name}"] = trust(
                *batch.as_gates(*policy.decide(cell, slot)), slots
            )
        parts.append({name: np.broadcast_to(each, shape).astype(np.float32) for name, each in part.items()})
        ever = np.maximum(ever, slots.live[:, :, 0])
    rows = {name: np.stack([part[name] for part in parts]) for name in parts[0]}
    rows["hops"] = np.broadcast_to(hops(ever, batch), rows["live"].shape)
    return {name: each[rows["other"] > 0] for name, each in rows.items()}


def noisy(scenario: Scenario, std: float) -> Scenario:
    """The scenario with another noise, the last stage of its channel."""
    channel = scenario.channel
    arguments = dict(channel.arguments)
    if "stages" not in arguments:
        return scenario.replace(channel=FactorySpec.of(channel.target, std=std))
    *others, last = arguments["stages"]
    return scenario.replace(
        channel=FactorySpec.of(channel.target, stages=[*others, FactorySpec.of(last.target, std=std)])
    )


class Panel(NamedTuple):
    """A panel of the picture: a quantity over another one in bins, of the neighbours of some kind."""

    quantity: str
    over: str
    label: str
    bins: tuple[float, ...]
    neighbours: str


STEPS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0)
LINKS = (0.0, 1.0, 2.0, 3.0)
PANELS = (
    Panel(
        "weight",
        "restless",
        "steps without rest of messages",
        (20.0, 24.0, *range(28, 40, 2), 44.0, 52.0, 68.0, 100.0),
        "source",
    ),
    Panel("weight", "contact", "steps since the link came up", STEPS, "source"),
    Panel("weight", "hops", "links from neighbour to owner", LINKS, "live"),
    Panel("weight", "noise", "noise / largest estimate", LEVELS, "source"),
    Panel("belief", "age", "steps since its last message", (0.0, *STEPS), "samples"),
    Panel("belief", "hops", "links from neighbour to owner", LINKS, "samples"),
)
"""Each bin ends where the next begins."""

QUANTITIES = {"weight": "weight of a message", "belief": "share of a mean of messages"}


def curves(rows: Rows, panel: Panel) -> dict[str, FloatArray]:
    """By policy, a row per bin with values: its place, and the quartiles."""
    chosen = (rows[panel.neighbours] > 0) & (rows["noisy"] > 0)
    if panel.over != "noise":
        chosen &= rows["noise"] == NOISE
    if panel.over != "restless":
        chosen &= rows["restless"] >= RESTLESS
    over, place = rows[panel.over][chosen], rows[panel.over][chosen]
    if panel.over == "noise":
        place = place / rows["scale"][chosen]
    bins = np.digitize(over, panel.bins)
    names = [name for name in ("network", *BESIDE) if rows[f"{panel.quantity} of {name}"].any()]
    return {
        name: np.array(
            [
                [np.median(place[inside]), *np.quantile(values[inside], [0.25, 0.5, 0.75])]
                for inside in (bins == number + 1 for number in range(len(panel.bins)))
                if inside.sum() >= FEWEST
            ]
        )
        for name in names
        for values in [rows[f"{panel.quantity} of {name}"][chosen]]
    }


def draw(rows: Rows, path: Path) -> None:
    """The picture."""
    from matplotlib.figure import Figure

    with drawing("pictures"):
        figure = Figure(figsize=(6.4, 7.4), layout="constrained")
        for axes, panel in zip(figure.subplots(3, 2).flat, PANELS, strict=True):
            for colour, (name, points) in zip(COLOURS, curves(rows, panel).items(), strict=False):
                axes.fill_between(points[:, 0], points[:, 1], points[:, 3], color=colour, alpha=0.15)
                axes.plot(points[:, 0], points[:, 2], "o-", color=colour, label=name, markersize=3)
            if panel.over == "hops":
                axes.set_xticks(LINKS)
            elif panel.over != "restless":
                axes.set_xscale("symlog" if panel.over == "age" else "log")
            axes.set(xlabel=panel.label, ylabel=QUANTITIES[panel.quantity])
        figure.axes[0].legend()
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=150, metadata={"Software": None})


# --- closed form ------------------------------------------------------------------------------------------------------

Samples: TypeAlias = tuple[npt.NDArray[Any], npt.NDArray[Any]]
"""Features of cells or of slots with the constant behind them, and the gate that the network answers there."""

_GATES = (*CellGates._fields, *SlotGates._fields)


def names_of(gate: str) -> list[str]:
    """The features on which a gate depends, and the constant."""
    return [*(CELL_FEATURES if gate in CellGates._fields else SLOT_FEATURES), ALWAYS]


def samples(network: GateNetwork, scenario: Scenario, seeds: Sequence[int]) -> dict[str, Samples]:
    """By gate, cells or slots in which it has an effect, drawn evenly from all steps of the network's episodes."""
    generator, parts = np.random.default_rng(0), []
    for batch, cell, slot in steps(network, scenario, seeds):
        count = min(-(-SAMPLES // batch.world.clock.total_steps), batch.cells)
        rows = generator.choice(batch.cells, count, replace=False)
        parts.append((cell[rows], slot[rows]))
    cell, slot = (np.concatenate(each) for each in zip(*parts, strict=True))
    answers = network.decide(cell, slot)
    acts = np.split(effects(torch.from_numpy(cell), torch.from_numpy(slot)).numpy() > 0, [CELL_GATES], axis=1)
    found = {}
    for features, gates, act, fields in zip(
        (cell, slot), answers, acts, (CellGates._fields, SlotGates._fields), strict=True
    ):
        for place, name in enumerate(fields):
            has_effect = act.reshape(gates.shape)[..., place]
            chosen = features[has_effect]
            gate = np.clip(gates[has_effect, place], LOW, HIGH[name])
            found[name] = np.hstack([chosen, np.ones_like(chosen[:, :1])]).astype(float), gate.astype(float)
    return found


class Fit(NamedTuple):
    """Weights of some features, their places, and the mean squared error."""

    places: tuple[int, ...]
    weights: FloatArray
    error: float


def errors(features: FloatArray, gate: FloatArray, weights: FloatArray, high: float) -> FloatArray:
    """Sum minus gate; a sum beyond a bound at which the gate is has no error."""
    error = features @ weights - gate
    return np.where(gate >= high, np.minimum(error, 0.0), np.where(gate <= LOW, np.maximum(error, 0.0), error))


def fitted(data: Samples, places: tuple[int, ...], near: FloatArray, high: float) -> Fit:
    """The best weights of these features; of equally good ones those near to others."""
    features, gate = data[0][:, places], data[1]

    def loss(weights: FloatArray) -> tuple[float, FloatArray]:
        error, gap = errors(features, gate, weights, high), weights - near
        return float(error @ error) / len(gate) + STAY * float(gap @ gap), 2 * (
            features.T @ error / len(gate) + STAY * gap
        )

    weights = minimize(loss, near, jac=True, method="L-BFGS-B").x if places else near
    return Fit(places, weights, float(np.mean(errors(features, gate, weights, high) ** 2)))


def closed_form(data: Samples, names: Sequence[str], law: Mapping[str, float], high: float) -> dict[str, float]:
    """A gate as a clipped sum of few features, in three digits.

    It is that of the law where this explains the gate. Else the features of the law come first, others are added one by
    one while they explain more, and then the ones that explain nothing are dropped.

    Args:
        data: of the gate.
        names: of the features.
        law: weights of the law with which the network is compared.
        high: the upper bound of the gate.
    """
    features, gate = data
    if off(data, names, law, high) ** 2 < LEAST:
        return dict(law)
    best = fitted(data, tuple(map(names.index, law)), np.array(list(law.values())), high)
    length = np.linalg.norm(features, axis=0) + 1e-9
    while len(best.places) < TERMS:
        gain = np.abs(features.T @ errors(features[:, best.places], gate, best.weights, high)) / length
        gain[list(best.places)] = 0.0
        more = fitted(data, (*best.places, int(gain.argmax())), np.append(best.weights, 0.0), high)
        if best.error - more.error < max(WORTH * best.error, LEAST):
            break
        best = more
    while best.places:
        fewer = [
            fitted(data, best.places[:k] + best.places[k + 1 :], np.delete(best.weights, k), high)
            for k in range(len(best.places))
        ]
        least = min(fewer, key=lambda fit: fit.error)
        if least.error - best.error > max(WORTH * best.error, LEAST):
            break
        best = least
    return {names[place]: float(f"{weight:.3g}") for place, weight in zip(best.places, best.weights, strict=True)}


def off(data: Samples, names: Sequence[str], sums: Mapping[str, float], high: float) -> float:
    """The root of the mean squared difference of clipped sums and gates."""
    weights = np.array([sums.get(name, 0.0) for name in names])
    return float(np.sqrt(np.mean((np.clip(data[0] @ weights, LOW, high) - data[1]) ** 2)))


def as_text(sums: Mapping[str, float]) -> str:
    """Such as ``1.2 noisy - 0.5``."""
    terms = [f"{weight:+g}" + ("" if name == ALWAYS else f" {name}") for name, weight in sums.items()]
    return " ".join(terms).replace("+", "+ ").replace("-", "- ").removeprefix("+ ") or "0"


Point: TypeAlias = dict[str, Mapping[str, float]]
"""Weights of features by gate, of cells and of slots."""


def network_of(point: Point, like: GateNetwork) -> GateNetwork:
    """The network of clipped sums, with layers of the same sizes as another one."""
    cell, slot = ({name: point[name] for name in gates._fields if name in point} for gates in (CellGates, SlotGates))
    units = {"cell_units": len(like.first.bias), "slot_units": len(like.encoder.bias)}
    return GateNetwork.linear_point(cell, slot, **units)


def with_gate(law: GateNetwork, network: GateNetwork, gate: str) -> GateNetwork:
    """The law with one gate of the network."""
    mixed = deepcopy(network)
    with torch.no_grad():
        for part, gates in (("cell", CellGates), ("slot", SlotGates)):
            others = [place for place, name in enumerate(gates._fields) if name != gate]
            for name in (f"{part}_head.weight", f"{part}_skip.weight", f"{part}_skip.bias"):
                mixed.get_parameter(name)[others] = law.get_parameter(name)[others]
    return mixed


def digits(networks: Sequence[GateNetwork], scenario: Scenario, seeds: Sequence[int]) -> FloatArray:
    """Mean digits of each network on the same episodes."""
    names = [name for name, _ in networks[0].named_parameters()]
    vectors = np.stack([evolution.vector(network, names) for network in networks])
    return evolution.scores(networks[0], names, vectors, scenario, seeds)


# --- the script -------------------------------------------------------------------------------------------------------


def chosen_tracks(names: Sequence[str]) -> list[tuple[Suite, str]]:
    """Tracks by ``suite/track``, or all that the script is for.

    Raises:
        ValueError: for an unknown name, or a track in which some players follow another policy.
    """
    if not names:
        return [
            (suite, track.name)
            for suite in map(get_suite, ("ptne-v1", "ptne-v2"))
            for track in suite.tracks
            if track.teammates is None and track.world.game.num_players <= LARGEST
        ]
    chosen = [(get_suite(suite), track) for suite, _, track in (name.partition("/") for name in names)]
    for name, (suite, track) in zip(names, chosen, strict=True):
        if suite.track(track).teammates is not None:
            raise ValueError(f"some players of {name} follow another policy: choose a track without teammates")
    return chosen


def plays(tracks: Sequence[tuple[Suite, str]], episodes: int, split: Split) -> list[Play]:
    """The worlds of tracks, and seeds of their episodes."""
    sets = [suite.episode_set(track, split=split) for suite, track in tracks]
    return [
        (suite.track(track).scenario, [each.episode_seed(number) for number in range(episodes)])
        for (suite, track), each in zip(tracks, sets, strict=True)
    ]


def read_trust(network: GateNetwork, episodes: int, workers: Workers, picture: Path | None) -> list[str]:
    """Draw the picture, and the lines of its medians."""
    suite = get_suite("ptne-v2")
    worlds = plays([(suite, name) for name in NOISY], episodes, "validation")
    tasks = [(network, noisy(scenario, std), seeds) for scenario, seeds in worlds for std in LEVELS]
    found = workers.gather(readings, tasks)
    for number, rows in enumerate(found):
        rows["noise"] = np.full(rows["live"].shape, LEVELS[number % len(LEVELS)])
    rows = {name: np.concatenate([each[name] for each in found]) for name in found[0]}
    if picture is not None:
        draw(rows, picture)
    lines = []
    for panel in PANELS:
        lines.append(f"{QUANTITIES[panel.quantity]}, over {panel.label}:")
        for name, points in curves(rows, panel).items():
            lines.append(f"  {name:15}" + "".join(f"  {at:.3g}: {median:.3f}" for at, _, median, _ in points))
    return lines


def read_gates(
    network: GateNetwork, law: str, tracks: Sequence[tuple[Suite, str]], episodes: int, workers: Workers
) -> tuple[GateNetwork, list[str]]:
    """The closed form, and the lines of its table and of the digits."""
    parts = workers.gather(samples, [(network, *play) for play in plays(tracks, episodes, "train")])
    start: Point = {**POINTS[law][0], **POINTS[law][1]}
    form, distances = dict[str, Mapping[str, float]](), dict[str, tuple[float, float]]()
    for gate in _GATES:
        features, gates = zip(*(part[gate] for part in parts), strict=True)
        data, names, sums = (np.concatenate(features), np.concatenate(gates)), names_of(gate), start.get(gate, {})
        form[gate] = closed_form(data, names, sums, HIGH[gate])
        distances[gate] = off(data, names, sums, HIGH[gate]), off(data, names, form[gate], HIGH[gate])
    changed = [gate for gate in _GATES if form[gate] != start.get(gate, {})]
    closed, own = network_of(form, network), network_of(start, network)
    networks = [network, closed, own]
    for gate in changed:
        networks += with_gate(own, network, gate), with_gate(own, closed, gate)
    found = np.array(workers.gather(digits, [(networks, *play) for play in plays(tracks, episodes, "validation")]))
    alone = (found[:, 3:] - found[:, 2:3]).mean(axis=0).reshape(-1, 2)
    effects_of = {gate: [f"{each:+.3f}" for each in pair] for gate, pair in zip(changed, alone, strict=True)}
    rows = [
        [gate, *(f"{each:.4f}" for each in distances[gate]), as_text(form[gate]), *effects_of.get(gate, ["", ""])]
        for gate in _GATES
    ]
    headings = ["gate", f"{law} is off", "closed form is off", "closed form", "network's alone", "closed form's alone"]
    lines = [*table(headings, rows, texts=("gate", "closed form")), ""]
    rows = [
        [f"{suite.name}/{track}", *(f"{each:.2f}" for each in row[:3])]
        for (suite, track), row in zip(tracks, found, strict=True)
    ]
    for name in dict.fromkeys(suite.name for suite, _ in tracks):
        mean = found[[suite.name == name for suite, _ in tracks], :3].mean(axis=0)
        rows.append([f"{name}, mean", *(f"{each:.3f}" for each in mean)])
    return closed, lines + table(["track", "network", "closed form", law], rows, texts=("track",))


def main(
    policy: Annotated[str, typer.Argument(help="A policy without sizes: a file, or the name of a shipped one.")],
    picture: Annotated[Path | None, typer.Option(help="File of the picture of trust.")] = None,
    out: Annotated[Path | None, typer.Option(help="ONNX file of the closed form, a policy like the others.")] = None,
    law: Annotated[str, typer.Option(help="The law that the network is compared with.")] = "observer-relay",
    track: Annotated[list[str] | None, typer.Option(help="SUITE/TRACK; all if left out.")] = None,
    episodes: Annotated[int, typer.Option(help="Of every track and split.")] = 8,
    jobs: Jobs = 2,
) -> None:
    """Read and print."""
    torch.set_num_threads(1)
    network, workers, tracks = size_free_from_onnx(policy), Workers(jobs), chosen_tracks(track or ())
    GateNetwork.of_law(law)  # refuses unknown names before anything is played
    typer.echo("\n".join(read_trust(network, episodes, workers, picture)) + "\n")
    form, lines = read_gates(network, law, tracks, episodes, workers)
    typer.echo("\n".join(lines))
    if out is not None:
        content = size_free_to_onnx(
            form, interface=GatedLaw.interface, scenarios=("closed form",), steps=0, seed=0, digits=0.0
        )
        write_atomically(out, content)


if __name__ == "__main__":
    typer.run(main)
