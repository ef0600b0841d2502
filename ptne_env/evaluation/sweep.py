"""Phase diagrams: digits at the deadline over two parameters, as the environment measures and as theory predicts them.

Every point is a batch of episodes of the static law from random starts. Theory predicts the digits of the sampled loop
from the same starts, and boundaries; docs/theory.md shows the diagrams.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ptne_env import theory
from ptne_env._version import __version__
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.provenance import content_hash, versions
from ptne_env.evaluation.rollout import rollout
from ptne_env.evaluation.store import TaskStore, run_missing
from ptne_env.evaluation.workers import Workers
from ptne_env.laws import Static
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import Interface
from ptne_env.shared.arrays import FloatArray, require_count
from ptne_env.shared.names import unknown_name
from ptne_env.shared.parts import FactorySpec
from ptne_env.world.catalogue import get_scenario
from ptne_env.world.dynamics import State
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import World

CEILING = 12.0
"""Digits count up to here, where the environment's float64 and the observations' float32 end."""

FLOOR = -2.0
"""Digits count down to here; below, a loop grows without bound."""

_KAPPA = 2.0


@dataclass(frozen=True)
class Axis:
    """One parameter of a diagram.

    Attributes:
        label: with the symbol and the unit.
        values: the grid, increasing.
        is_logarithmic: whether the logarithms of the values are evenly spaced.
    """

    label: str
    values: tuple[float, ...]
    is_logarithmic: bool = True


@dataclass(frozen=True)
class Boundary:
    """A line that theory draws through a diagram.

    Attributes:
        label: the change that happens there.
        x, y: points of the line, in the units of the axes.
    """

    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True)
class Diagram:
    """A measured phase diagram.

    Attributes:
        name: for files.
        title: for readers.
        x, y: the axes.
        measured: mean digits at T, one row per value of y and one column per value of x, within FLOOR..CEILING;
            ``None`` where no such scenario exists.
        predicted: digits that theory predicts, likewise.
        boundaries: lines that theory draws.
        episodes: number of episodes per point.
        seed: of the starts, and of the noise.
        version: of this library.
    """

    name: str
    title: str
    x: Axis
    y: Axis
    measured: tuple[tuple[float | None, ...], ...]
    predicted: tuple[tuple[float | None, ...], ...]
    boundaries: tuple[Boundary, ...]
    episodes: int
    seed: int
    version: str = __version__

    def grid(self, which: str) -> FloatArray:
        """``"measured"`` or ``"predicted"`` as an array, NaN where there is no scenario; shape (len(y), len(x))."""
        return np.array(getattr(self, which), dtype=np.float64)

    @property
    def difference(self) -> float:
        """The largest |measured − predicted| digits over the points."""
        return float(np.nanmax(np.abs(self.grid("measured") - self.grid("predicted"))))

    def to_json(self) -> str:
        """Everything as a JSON text."""
        return json.dumps(asdict(self), indent=1, allow_nan=False, ensure_ascii=False)


@dataclass(frozen=True)
class Sweep:
    """A diagram that can be measured.

    Attributes:
        title: for readers.
        axes: makes the two axes, for a number of points along each.
        point: makes the scenario and κ of a point (x, y).
        boundaries: makes the lines that theory draws over these axes.
    """

    title: str
    axes: Callable[[int], tuple[Axis, Axis]]
    point: Callable[[float, float], tuple[Scenario, float]]
    boundaries: Callable[[Axis, Axis], Sequence[Boundary]]


def run_sweep(
    name: str,
    *,
    points: int = 14,
    episodes: int = 8,
    seed: int = 0,
    folder: Path | None = None,
    workers: Workers = Workers(),  # noqa: B008 - immutable
    progress: Callable[[int, int], None] | None = None,
) -> Diagram:
    """Measure one phase diagram.

    Points whose result is in the folder already are not measured again, so an interrupted run goes on where it was.

    Args:
        name: one of :data:`SWEEPS`.
        points: along each axis, at least 2.
        episodes: per point.
        seed: of the starts, and of the noise.
        folder: in which the results of finished points are stored; nothing is stored if left out.
        workers: where the points are measured; the results do not depend on it.
        progress: called with the number of points that are done and of all.

    Raises:
        ValueError: when the name is unknown or a number is too small.
        OSError: when the folder cannot be written.
        ImportError, ConnectionError, ChildProcessError: as :meth:`~ptne_env.evaluation.workers.Workers.run`.
    """
    if name not in SWEEPS:
        raise ValueError(unknown_name("diagram", name, SWEEPS))
    require_count("points", points, 2)
    require_count("episodes", episodes, 1)
    sweep = SWEEPS[name]
    x, y = sweep.axes(points)
    places = [_Point(name, across, up, episodes, seed) for up in y.values for across in x.values]
    store = None if folder is None else _PointStore(folder)
    found: dict[int, _Digits] = {}
    for index, digits in run_missing(
        places, store, lambda missing: workers.run(_Point.measure, [(point,) for point in missing])
    ):
        found[index] = digits
        if progress is not None:
            progress(len(found), len(places))
    rows = [[found[start + column] for column in range(points)] for start in range(0, len(places), points)]
    return Diagram(
        name=name,
        title=sweep.title,
        x=x,
        y=y,
        measured=tuple(tuple(digits.measured for digits in row) for row in rows),
        predicted=tuple(tuple(digits.predicted for digits in row) for row in rows),
        boundaries=tuple(sweep.boundaries(x, y)),
        episodes=episodes,
        seed=seed,
    )


@dataclass(frozen=True)
class _Digits:
    """Mean digits at T of one point, as measured and as predicted; ``None`` where there is no scenario."""

    measured: float | None
    predicted: float | None

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], point: Any) -> _Digits:  # noqa: ARG003 - any point has such digits
        if data.keys() != {"measured", "predicted"}:
            raise ValueError("expected measured and predicted digits")
        values = list(data.values())
        if values != [None, None] and not all(type(value) is float and FLOOR <= value <= CEILING for value in values):
            raise ValueError(f"expected digits between {FLOOR:g} and {CEILING:g}")
        return cls(**data)


@dataclass(frozen=True)
class _Point:
    """A point of a diagram: everything that its digits depend on."""

    diagram: str
    x: float
    y: float
    episodes: int
    seed: int

    @property
    def key(self) -> str:
        return content_hash(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        return {**asdict(self), "versions": versions()}

    def measure(self) -> _Digits:
        try:
            world, kappa = _point(self.diagram, self.x, self.y)
        except ValueError:  # such as a dwell that is shorter than a step
            return _Digits(None, None)
        encoder = make_encoder(world, Interface())
        law, start = Static(encoder.layout, kappa), EpisodeSet(self.episodes, self.seed).initial_state(world)
        measured = _mean_digits(rollout(law, encoder, start)["estimate_distance"][world.clock.steps])

        loop = theory.sampled_loop(world, law)
        if not np.all(np.isfinite(loop.transition())):
            return _Digits(measured, FLOOR)
        std = theory.channel_noise(world.channel)
        noise = theory.noise_distance(loop.noise_covariance(std), world.game) if std else 0.0
        return _Digits(measured, _mean_digits(np.hypot(_noiseless(loop, start), noise)))


class _PointStore(TaskStore[_Digits]):
    kind = "point"
    result = _Digits


def _noiseless(loop: theory.SampledLoop, start: State) -> FloatArray:
    """Estimate distances at T of the sampled loop without noise, shape (B,)."""
    errors = theory.start_error(start.estimates, start.game)
    return theory.distance((loop.transition() @ errors).T, start.game)


def _mean_digits(distances: FloatArray) -> float:
    return float(-np.log10(np.clip(distances, 10.0**-CEILING, 10.0**-FLOOR)).mean())


def _point(name: str, x: float, y: float) -> tuple[World, float]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # some diagrams are about short horizons
        scenario, kappa = SWEEPS[name].point(x, y)
        return World(scenario), kappa


def _logarithmic(label: str, low: float, high: float, points: int) -> Axis:
    return Axis(label, tuple(float(value) for value in np.geomspace(low, high, points)))


def _horizontal(label: str, x: Axis, level: float) -> Boundary:
    return Boundary(label, (x.values[0], x.values[-1]), (level, level))


def _vertical(label: str, y: Axis, place: float) -> Boundary:
    return Boundary(label, (place, place), (y.values[0], y.values[-1]))


# The limit on inputs is put out of reach: theory predicts the loop without saturation.
_FREE: Mapping[str, Any] = {"start": "random", "input_limit": 1e6}


def _energy(**changes: Any) -> Scenario:
    return get_scenario("energy", **_FREE, **changes)


def _gain_step_axes(points: int) -> tuple[Axis, Axis]:
    total = World(_energy()).clock.effective_time
    steps = np.unique(np.rint(np.geomspace(total, total / 0.04, points)).astype(int))[::-1]
    if len(steps) < points:
        raise ValueError(f"{points} points along Θ are more than there are numbers of steps")
    return _logarithmic("κ", 0.1, 30.0, points), Axis("step Θ", tuple(float(total / number) for number in steps))


def _gain_step_point(kappa: float, theta: float) -> tuple[Scenario, float]:
    return _energy(steps=round(World(_energy()).clock.effective_time / theta)), kappa


def _gain_step_boundaries(x: Axis, y: Axis) -> list[Boundary]:
    world = World(_energy())
    game, graph = world.game, world.topology.graphs[0]
    kappas = np.geomspace(x.values[0], x.values[-1], 200)
    steps = [theory.largest_stable_step(theory.closed_loop_matrix(game, graph, float(kappa))) for kappa in kappas]
    known = [(float(kappa), step) for kappa, step in zip(kappas, steps, strict=True) if step is not None]
    bound = theory.gain_bound(theory.monotonicity_constants(game), graph.algebraic_connectivity)
    return [
        Boundary("largest stable step", *map(tuple, zip(*known, strict=True))),
        *([_vertical("gain condition (sufficient)", y, bound)] if np.isfinite(bound) else []),
    ]


_NOISE_GAIN = 5.0


def _noise_axes(points: int) -> tuple[Axis, Axis]:
    horizons = tuple(float(value) for value in np.linspace(2.0, 34.0, points))
    return _logarithmic("noise σ", 1e-7, 10.0, points), Axis("horizon s_end", horizons, is_logarithmic=False)


def _noise_point(std: float, s_end: float) -> tuple[Scenario, float]:
    channel = FactorySpec.of("ptne_env.world.channel:AdditiveNoise", std=std)
    return _energy(channel=channel, s_end=s_end, gain=_NOISE_GAIN), _KAPPA


def _noise_boundaries(x: Axis, y: Axis) -> list[Boundary]:  # noqa: ARG001 - the signature is shared
    horizons = np.linspace(y.values[0], y.values[-1], 17)
    levels = []
    for horizon in horizons:
        world, kappa = _point("noise-horizon", 1.0, float(horizon))
        loop = theory.sampled_loop(world, Static(make_encoder(world, Interface()).layout, kappa))
        error = np.exp(np.log(_noiseless(loop, EpisodeSet(64).initial_state(world))).mean())
        levels.append(float(error / theory.noise_distance(loop.noise_covariance(), world.game)))
    return [Boundary("noise as large as the error", tuple(levels), tuple(horizons))]


def _dwell_axes(points: int) -> tuple[Axis, Axis]:
    return _logarithmic("dwell time [s]", 0.01, 0.8, points), _logarithmic("c [1/s]", 1.0, 200.0, points)


def _dwell_point(dwell: float, gain: float) -> tuple[Scenario, float]:
    topology = FactorySpec.of("ptne_env.world.switching:paper_topology", dwell=dwell)
    return _energy(topology=topology, gain=gain), _KAPPA


def _dwell_boundaries(x: Axis, y: Axis) -> list[Boundary]:
    world, kappa = _point("dwell-gain", 0.1, 20.0)
    scenario = world.scenario
    matrices = [theory.closed_loop_matrix(world.game, graph, kappa) for graph in world.topology.graphs]
    steps = [theory.largest_stable_step(matrix) for matrix in matrices]
    stable = min(step for step in steps if step is not None)
    rate = theory.input_decay_rate(matrices, world.topology, scenario.deadline)
    dwells = np.geomspace(x.values[0], x.values[-1], 50)
    settles = dwells[(dwells > 1 / (rate * y.values[-1])) & (dwells < 1 / (rate * y.values[0]))]
    lines = [
        _vertical("all four graphs act before T", y, scenario.deadline / 3),
        Boundary("a graph settles within its dwell", tuple(settles), tuple(1 / (rate * settles))),
    ]
    gain = (stable * scenario.steps - scenario.s_end) / scenario.deadline  # where the step (cT + s_end)/K is stable
    if y.values[0] < gain < y.values[-1]:
        lines.append(_horizontal("largest stable step", x, gain))
    return lines


SWEEPS: Mapping[str, Sweep] = {
    "gain-step": Sweep(
        "Energy game on the 5-cycle: consensus gain and step", _gain_step_axes, _gain_step_point, _gain_step_boundaries
    ),
    "noise-horizon": Sweep(
        f"Energy game, c = {_NOISE_GAIN:g}: noise on messages and horizon", _noise_axes, _noise_point, _noise_boundaries
    ),
    "dwell-gain": Sweep(
        "Energy game, switching in t: dwell time and constant gain", _dwell_axes, _dwell_point, _dwell_boundaries
    ),
}
"""The phase diagrams by name."""
