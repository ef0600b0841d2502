"""Running a suite cell by cell: one policy on one track from one bank, kept in a file that is whole or not there."""

from __future__ import annotations

import glob
import json
import platform
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property
from hashlib import sha256
from importlib import metadata
from inspect import getsourcefile, unwrap
from pathlib import Path
from typing import Any

import numpy as np

from ptne_env._version import __version__
from ptne_env.arrays import FloatArray, require_count
from ptne_env.encoder import make_encoder
from ptne_env.experiments.episodes import Split, start_from, track_seed
from ptne_env.experiments.metrics import measure_for_suite
from ptne_env.experiments.policy_specs import PolicySpec, get_policy_spec
from ptne_env.experiments.rollout import rollout
from ptne_env.experiments.suite import ANCHORS, LEADERBOARD_SEED, Suite, Track, content_hash, get_suite
from ptne_env.experiments.workers import Workers
from ptne_env.factory import FactorySpec
from ptne_env.files import read_json, write_atomically
from ptne_env.observation import Interface
from ptne_env.policies import shipped_path
from ptne_env.policies.archive import load_archive
from ptne_env.world import World

TIMINGS = ("microseconds_per_decision",)
"""Metrics that another run does not repeat; they are kept apart."""

RESULTS_FORMAT = 2
"""Version of what the entries of ``results.json`` mean; a file of another one is refused."""

_ARCHIVE = "ptne_env.policies.archive:load_archive"
_PACKAGE = Path(__file__).parents[1]
_NOT_COMPUTING = ("report", "paper", "training", "cli.py")
"""Parts of the library on which no number of a cell depends."""

_LIBRARIES = ("numpy", "scipy", "onnxruntime", "torch")


@dataclass(frozen=True)
class Participant:
    """One row of a table.

    Attributes:
        name: for tables and files.
        runs: the entry of each training seed; one where nothing was trained.
    """

    name: str
    runs: tuple[PolicySpec, ...]

    @property
    def is_oracle(self) -> bool:
        """Whether it sees what no player can see."""
        return self.runs[0].interface.kind == "full"

    def to_dict(self) -> dict[str, Any]:
        """A JSON object that says which policies these are, with parameters and the hashes of their files."""
        return {"name": self.name, "runs": [{**run.to_dict(), "files": files(run)} for run in self.runs]}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Participant:
        """The inverse of :meth:`to_dict`; it imports the modules that the policies name."""
        runs = (
            PolicySpec(run["name"], FactorySpec.from_dict(run["policy"]), Interface(**run["interface"]))
            for run in data["runs"]
        )
        return cls(data["name"], tuple(runs))


def get_participant(policy: str | PolicySpec | Participant, *, trust: bool = False) -> Participant:
    """A participant by what names an entry, by a Stable-Baselines3 ``.zip``, or by ``"name=pattern"``.

    A pattern (such as ``"mine=runs/seed-*/policy.onnx"``) stands for the training seeds of one policy, one file each.

    Args:
        policy: what is asked for.
        trust: whether code that is stored in a ``.zip`` may be executed.

    Raises:
        ValueError: for an unknown name, a pattern without files, or a ``.zip`` that is not trusted.
        FileNotFoundError, PolicyFileError, ImportError: when a file cannot be loaded.
    """
    if isinstance(policy, Participant):
        return policy
    if isinstance(policy, PolicySpec):
        return Participant(policy.name, (policy,))
    name, separator, pattern = policy.partition("=")
    if not separator:
        entry = _entry(policy, trust=trust)
        return Participant(entry.name, (entry,))
    paths = sorted(glob.glob(pattern))  # noqa: PTH207 - the pattern may be absolute
    if not (name and paths):
        raise ValueError(f"{policy!r} is not 'name=pattern' with a pattern that matches files")
    return Participant(name, tuple(_entry(path, trust=trust) for path in paths))


def executes_code(policy: str) -> bool:
    """Whether loading what this names, for :func:`get_participant`, executes code that is stored in a file."""
    return policy.endswith(".zip")


def _entry(policy: str, *, trust: bool) -> PolicySpec:
    if not executes_code(policy):
        return get_policy_spec(policy)
    if not trust:
        raise ValueError(f"loading {policy!r} executes code that is stored in it: say that you trust it (--trust)")
    return PolicySpec(Path(policy).stem, FactorySpec.of(_ARCHIVE, path=policy), load_archive(policy).interface)


def files(entry: PolicySpec) -> dict[str, str]:
    """SHA-256 of each file that an entry is made from, outside the library's sources.

    Raises:
        ValueError: when the entry's policy is an object and not a part, so that nobody could make it again.
    """
    if not isinstance(entry.policy, FactorySpec):
        raise ValueError(
            f"policy {entry.name!r} is an object; a suite needs a FactorySpec, 'module:object' with arguments, so that its "
            "results can be repeated"
        )
    return _hashes(entry.policy)


def _hashes(value: Any) -> dict[str, str]:
    """SHA-256 of the files that a part, or any of several, is made from, outside the library's sources; by name."""
    return {path.name: sha256(path.read_bytes()).hexdigest() for path in _paths(value) if path.is_file()}


def _paths(value: Any) -> Iterator[Path]:
    if isinstance(value, FactorySpec):
        try:
            source = getsourcefile(unwrap(value.resolve()))  # as it was written, whatever a decorator compiles later
        except TypeError:  # an object that is no class, function or module
            source = None
        if source is not None and not Path(source).is_relative_to(_PACKAGE):
            yield Path(source)
        yield from _paths(tuple(argument for _, argument in value.arguments))
    elif isinstance(value, tuple):
        for item in value:
            yield from _paths(item)
    elif isinstance(value, str):
        yield shipped_path(value) or Path(value)


@cache
def versions() -> dict[str, str]:
    """The versions that numbers depend on, with a hash of the library's own computing sources."""
    sources = sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        name = path.relative_to(_PACKAGE)
        if name.parts[0] not in _NOT_COMPUTING:
            sources.update(name.as_posix().encode() + path.read_bytes())
    found = {"ptne_env": __version__, "sources": sources.hexdigest(), "python": platform.python_version()}
    for library in _LIBRARIES:
        try:
            found[library] = metadata.version(library)
        except metadata.PackageNotFoundError:
            continue
    return found


@dataclass(frozen=True)
class Cell:
    """One policy on one track from one bank: everything that its numbers depend on.

    Attributes:
        suite: name of the suite.
        track: which world.
        participant: name of the participant.
        run: index of the training seed.
        entry: the policy.
        seed: of the bank.
        split: of the bank.
        episodes: how many.
    """

    suite: str
    track: Track
    participant: str
    run: int
    entry: PolicySpec
    seed: int
    split: Split
    episodes: int

    def to_dict(self) -> dict[str, Any]:
        """Everything the numbers depend on, as a JSON object. The policy's name is not among it."""
        policy = {key: value for key, value in self.entry.to_dict().items() if key != "name"}
        return {
            "suite": self.suite,
            "track": {**self.track.to_dict(), "files": _hashes(self._parts_of_the_track())},
            "entry": {**policy, "files": files(self.entry)},
            "seed": self.seed,
            "split": self.split,
            "episodes": self.episodes,
            "versions": versions(),
        }

    def _parts_of_the_track(self) -> tuple[FactorySpec, ...]:
        values = (getattr(self.track.scenario, field.name) for field in fields(self.track.scenario))
        parts = tuple(value for value in values if isinstance(value, FactorySpec))
        return parts if self.track.teammates is None else (*parts, self.track.teammates.policy)

    @cached_property
    def key(self) -> str:
        """The hash of :meth:`to_dict`, by which the cell is kept."""
        return content_hash(self.to_dict())

    def compute(self) -> Measured:
        """Run the episodes."""
        world = World(self.track.scenario)
        try:
            encoder = make_encoder(world, self.entry.interface)
            policy = self.entry.build(encoder.layout)
        except ValueError as error:  # made for another layout, or for other games
            return Measured({}, {}, str(error))
        teammates = None if self.track.teammates is None else self.track.teammates.join(world)
        seeds = (track_seed(self.suite, self.track.name, self.split, self.seed, k) for k in range(self.episodes))
        samples = measure_for_suite(rollout(policy, encoder, start_from(world, seeds), teammates))
        timings = {name: float(samples.pop(name)[0]) for name in TIMINGS}
        return Measured(samples, timings, None)


@dataclass(frozen=True)
class Measured:
    """What a cell found.

    Attributes:
        samples: per metric, one value per episode, NaN where there is none.
        timings: per metric of :data:`TIMINGS`, its value.
        reason: why the policy cannot act on this track; ``None`` where it can.
    """

    samples: dict[str, FloatArray]
    timings: dict[str, float]
    reason: str | None

    def to_dict(self) -> dict[str, Any]:
        """A JSON object; numbers keep every bit, NaN is ``null``."""
        lists = {
            name: [value if np.isfinite(value) else None for value in values.tolist()]
            for name, values in self.samples.items()
        }
        return {"samples": lists, "not_applicable": self.reason, "timings": self.timings}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Measured:
        """The inverse of :meth:`to_dict`."""
        samples = {name: np.array(values, dtype=np.float64) for name, values in data["samples"].items()}
        return cls(samples, dict(data["timings"]), data["not_applicable"])


class Store:
    """A folder of cells, one file each, named by the hash of what the cell depends on.

    Several runs may share one: files appear whole, and two runs that compute the same cell write the same.

    Args:
        folder: made when the first cell is kept.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, cell: Cell) -> Path:
        """The cell's file."""
        return self.folder / "cells" / f"{cell.key}.json"

    def load(self, cell: Cell) -> Measured | None:
        """What is kept of a cell; ``None`` where nothing is, or a damaged file, and the cell has to be run."""
        try:
            return _read(self.path(cell))
        except (FileNotFoundError, ValueError):
            return None

    def keep(self, cell: Cell, measured: Measured) -> None:
        """Write the cell's file."""
        body = measured.to_dict()
        checksum = content_hash({name: body[name] for name in ("samples", "not_applicable")})
        data = {"cell": cell.to_dict(), "participant": cell.participant, "run": cell.run, **body, "checksum": checksum}
        write_atomically(self.path(cell), json.dumps(data, allow_nan=False, ensure_ascii=False))

    def fetch(self, cells: Sequence[Cell], workers: Workers) -> Iterator[tuple[int, Measured]]:
        """What is kept of the cells, and of the others what workers find, which is kept then; each with its index."""
        missing = []
        for index, cell in enumerate(cells):
            measured = self.load(cell)
            if measured is None:
                missing.append(index)
            else:
                yield index, measured
        for place, measured in workers.run(_measure, [(cells[index], cells[index].key) for index in missing]):
            self.keep(cells[missing[place]], measured)
            yield missing[place], measured


@dataclass(frozen=True)
class Run:
    """A suite that has been run: which cells there are, and what each found.

    Attributes:
        suite: as published.
        target: by which :func:`~ptne_env.experiments.suite.get_suite` finds it.
        tracks: those that were run, in the order of the suite.
        participants: by name, in the order of tables.
        seed: of the banks.
        split: of the banks.
        episodes: per track.
        cells: every track, participant and training seed.
        measured: what each cell found, in the order of ``cells``.
    """

    suite: Suite
    target: str
    tracks: tuple[Track, ...]
    participants: dict[str, Participant]
    seed: int
    split: Split
    episodes: int
    cells: tuple[Cell, ...]
    measured: tuple[Measured, ...]

    def of(self, track: str, participant: str) -> list[Measured]:
        """What was found on a track, one per training seed."""
        return [
            measured
            for cell, measured in zip(self.cells, self.measured, strict=True)
            if (cell.track.name, cell.participant) == (track, participant)
        ]


def run_suite(
    suite: str | Suite,
    policies: Iterable[str | PolicySpec | Participant],
    folder: Path,
    *,
    tracks: Sequence[str] | None = None,
    seed: int = LEADERBOARD_SEED,
    split: Split = "test",
    episodes: int | None = None,
    workers: Workers = Workers(),  # noqa: B008 - immutable
    trust: bool = False,
    progress: Callable[[str, int], None] | None = None,
) -> Run:
    """Run policies, and the anchors of every suite, on the tracks of a suite.

    Cells that the folder holds already are not run again, so an interrupted run goes on where it was, short of the
    cells in flight. Workers return what they found, and only this process writes: they may be machines that share no
    folder with it, but they need the same library and the same files of policies and parts.

    Args:
        suite: by name, ``"module:object"`` or as it is.
        policies: as :func:`get_participant` takes them.
        folder: of the results; cells are kept below it.
        tracks: names; all if left out.
        seed: of the banks; the leaderboard's is 0.
        split: ``"test"``, or ``"validation"`` for tuning.
        episodes: per track; the suite's own number if left out.
        workers: who runs the cells. Only the measured times of policies depend on it.
        trust: whether code that is stored in ``.zip`` files may be executed.
        progress: called with a description and the number of all cells when a cell is done.

    Raises:
        ValueError: for unknown or repeated names, a policy that fits no track, or a worker with other files.
        OSError: when the folder cannot be written.
        ImportError, ConnectionError, ChildProcessError: as :meth:`~ptne_env.experiments.workers.Workers.run`.
    """
    target = suite if isinstance(suite, str) else suite.name
    suite = get_suite(suite)
    chosen = suite.tracks if tracks is None else tuple(suite.track(name) for name in dict.fromkeys(tracks))
    require_count("seed", seed, 0)
    count = suite.episodes if episodes is None else require_count("episodes", episodes, 1)
    named = [get_participant(policy, trust=trust) for policy in policies]
    participants = {participant.name: participant for participant in named}
    if len(participants) < len(named):
        raise ValueError(f"a comparison needs different names, got {', '.join(one.name for one in named)}")
    for name, entry in ANCHORS.items():
        if participants.setdefault(name, Participant(name, (entry,))).runs != (entry,):
            raise ValueError(f"{name!r} is the name of an anchor of every suite: give your policy another name")
    cells = tuple(
        Cell(suite.name, track, participant.name, run, entry, seed, split, count)
        for track in chosen
        for participant in participants.values()
        for run, entry in enumerate(participant.runs)
    )
    # The largest first, so that no worker is left alone with one at the end.
    order = sorted(range(len(cells)), key=lambda index: -World(cells[index].track.scenario).game.num_players)
    found: dict[int, Measured] = {}
    for place, measured in Store(folder).fetch([cells[index] for index in order], workers):
        cell = cells[order[place]]
        found[order[place]] = measured
        if progress is not None:
            progress(f"{cell.track.name}: {cell.participant}", len(cells))
    run = Run(
        suite,
        target,
        chosen,
        participants,
        seed,
        split,
        count,
        cells,
        tuple(found[index] for index in range(len(cells))),
    )
    for name in participants:
        reasons = [measured.reason for track in chosen for measured in run.of(track.name, name)]
        if all(reasons):
            raise ValueError(f"policy {name!r} fits no track: {reasons[0]}")
    return run


def _measure(cell: Cell, key: str) -> Measured:
    """What a worker does, after making sure that it has what the numbers depend on."""
    if content_hash(cell.to_dict()) != key:
        raise ValueError(
            f"a worker on {platform.node()} has another version of the library, its dependencies or the files of "
            f"policy {cell.participant!r} than the machine that asks: install the same on both"
        )
    try:
        return cell.compute()
    except Exception as error:
        error.add_note(f"in track {cell.track.name!r}, policy {cell.participant!r}")
        raise


@dataclass(frozen=True)
class Repetition:
    """A cell that was run again.

    Attributes:
        cell: which.
        difference: the largest |new − old|/(1 + |old|) of any metric and episode; infinite where one has a value and
            the other has none.
    """

    cell: Cell
    difference: float


def check(
    results: Path,
    *,
    suite: Suite | None = None,
    sample: int = 5,
    seed: int | None = None,
    trust: bool = False,
    progress: Callable[[str, int], None] | None = None,
) -> list[Repetition]:
    """Run a random sample of the cells of published results again.

    Args:
        results: the file ``results.json`` of a suite, or its folder, with the cells beside it.
        suite: that was run, where its name in the results does not find it.
        sample: how many cells; all if there are fewer.
        seed: of the choice; fresh if left out.
        trust: whether code that is stored in ``.zip`` files may be executed.
        progress: called with a description and the number of cells to run when a cell is done.

    Raises:
        FileNotFoundError: when there are no results, or a cell's file is missing.
        ValueError: when a file is damaged, foreign or of another version, the suite is not the one that was run, or a
            policy's files are others.
    """
    path = results / "results.json" if results.is_dir() else results
    data = _read_results(path)
    name, published = data["suite"]["target"], data["suite"]["content_hash"]
    listed, participants = data["cells"], {one["name"]: one for one in data["participants"]}
    bank = {key: data[key] for key in ("seed", "split", "episodes")}
    suite = get_suite(name) if suite is None else suite
    if suite.content_hash != published:
        raise ValueError(
            f"{path} is of a {suite.name} with the content hash {published}; this library's is {suite.content_hash}"
        )
    if not trust and any(run["policy"]["target"] == _ARCHIVE for one in participants.values() for run in one["runs"]):
        raise ValueError(f"{path} has policies from .zip files, which execute code: say that you trust them (--trust)")
    chosen = np.random.default_rng(seed).permutation(len(listed))[: require_count("sample", sample, 1)]
    repetitions = []
    for index in sorted(chosen.tolist()):
        entry = listed[index]
        participant = Participant.from_dict(participants[entry["participant"]])
        if participant.to_dict() != participants[entry["participant"]]:
            raise ValueError(f"the files of policy {participant.name!r} are not those that were run")
        run = participant.runs[entry["run"]]
        cell = Cell(suite.name, suite.track(entry["track"]), participant.name, entry["run"], run, **bank)
        kept = _read(path.parent / "cells" / f"{entry['cell']}.json")
        repetitions.append(Repetition(cell, _difference(kept, cell.compute())))
        if progress is not None:
            progress(f"{cell.track.name}: {cell.participant}", len(chosen))
    return repetitions


def _read_results(path: Path) -> dict[str, Any]:
    """What :meth:`Leaderboard.to_dict` wrote."""
    what = "the results file of a suite"
    data = read_json(path, what)
    if missing := sorted({"format", "suite", "cells"} - data.keys()):
        raise ValueError(f"{path} is not {what}: it has no {', '.join(missing)}")
    if data["format"] != RESULTS_FORMAT:
        raise ValueError(
            f"{path} is of format {data['format']!r}, this library reads {RESULTS_FORMAT}: use the version of ptne_env "
            "that wrote it, or run the suite again"
        )
    content = {key: value for key, value in data.items() if key not in ("checksum", "timings")}
    if not _is_hash(data.get("checksum"), content):
        raise ValueError(f"{path} was damaged or changed after it was written: run the suite again, cells are kept")
    return data


def _read(path: Path) -> Measured:
    """What :meth:`Store.keep` wrote to this file, and no other."""
    data = read_json(path, "a cell of a suite's results")
    body = {name: data.get(name) for name in ("samples", "not_applicable")}
    if not (_is_hash(data.get("checksum"), body) and _is_hash(path.stem, data.get("cell"))):
        raise ValueError(f"the cell {path} is damaged, or another one: remove it and run the suite again")
    return Measured.from_dict(data)


def _is_hash(digest: Any, content: Any) -> bool:
    try:
        return bool(digest == content_hash(content))
    except (ValueError, RecursionError):  # NaN, or nested beyond reason
        return False


def _difference(old: Measured, new: Measured) -> float:
    if old.samples.keys() != new.samples.keys() or old.reason != new.reason:
        return float("inf")
    largest = 0.0
    for name, values in old.samples.items():
        if not np.array_equal(np.isfinite(values), np.isfinite(new.samples[name])):
            return float("inf")
        difference = np.abs(new.samples[name] - values) / (1 + np.abs(values))
        largest = max(largest, float(np.nanmax(difference, initial=0.0)))
    return largest
