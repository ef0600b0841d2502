"""Pages that open without a network: results with tables, figures and a player, and the player of one episode."""

from __future__ import annotations

import json
import shlex
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from gzip import compress
from importlib import resources
from typing import Any

import numpy as np

from ptne_env.bench.report.answer import answer, leaders, own_policies
from ptne_env.bench.report.html import render_template
from ptne_env.bench.report.tables import MARK_NOTES, MARKS, Table, overview, summary_tables, track_rules, track_tables
from ptne_env.evaluation.policy_specs import (
    PolicySpec,
    default_policies,
    foreign_code,
    get_policy_spec,
    suite_policies,
)
from ptne_env.evaluation.provenance import content_hash, versions
from ptne_env.evaluation.results import Results
from ptne_env.evaluation.suite import LAW, Track, comparison, foreign_suites
from ptne_env.evaluation.traces import Scene
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.style import COLOURS
from ptne_env.world import distances
from ptne_env.world.catalogue import CATALOGUE, DESCRIPTIONS
from ptne_env.world.scenario import Scenario

SHOWN = 5
"""Policies that figures show before the reader chooses: the best, and the paper's law."""

_MOST_COLUMNS = 8
"""Columns that fit beside the names on a page of 1,440 pixels; tables with more are shown in pieces."""

_FINEST, _STEP = 1e-13, 8e-4
"""Of the numbers in the player: the smallest, and the resolution of log10; it keeps a number to 0.1 %."""

_NONE = -(10**6)
"""The code of a number that does not exist."""

_VERSIONS = {"sources": "sources of ptne_env, SHA-256"}

_Facts = tuple[tuple[str, str], ...]
"""Names and values."""


@dataclass(frozen=True)
class Section:
    """The part of a page about a track.

    Attributes:
        name: of the track.
        description: of its world, in a sentence that no other track has.
        about: its rules and its physics, in sentences.
        tables: of its metrics.
        shown: policies that its figure shows at first.
        picked: policies that the player shows at first: the closest, and the user's own.
        command: that repeats its numbers; ``None`` where none does.
        episodes: that its figures show, and that were run.
        facts: on which its numbers depend.
    """

    name: str
    description: str
    about: str
    tables: tuple[Table, ...]
    shown: tuple[str, ...]
    picked: tuple[str, ...]
    command: str | None
    episodes: tuple[int, int]
    facts: _Facts


@dataclass(frozen=True)
class Report:
    """The content of a page.

    Attributes:
        title: of the page.
        answer: to the question of the page, in sentences.
        leaderboard: the entries that play every track, and the specialists.
        all_tracks: the digits on each track, and the room that each leaves.
        sections: one per track.
        policies: names, in the order of their colours.
        profiles: share of scores above each threshold, by policy; empty where there are no scores.
        thresholds: of the profiles.
        scenes: by name of the track.
        command: that repeats everything; ``None`` where none does.
        facts: versions, seeds and hashes.
        parameters: of each training seed of every policy: name, policy, interface, files.
    """

    title: str
    answer: tuple[str, ...]
    leaderboard: tuple[Table, ...]
    all_tracks: tuple[Table, ...]
    sections: tuple[Section, ...]
    policies: tuple[str, ...]
    profiles: Mapping[str, Sequence[float]]
    thresholds: Sequence[float]
    scenes: Mapping[str, Scene]
    command: str | None
    facts: _Facts
    parameters: tuple[tuple[str, str, str, str], ...]


def page(results: Results, scenes: Mapping[str, Scene], words: Sequence[str] | None = None) -> str:
    """Results as one HTML file with everything that it needs inside.

    Args:
        results: of a comparison or of another suite.
        scenes: of every track (:func:`~ptne_env.evaluation.traces.scenes`).
        words: the values of ``--policy`` that name the policies, for the command that repeats the results; found from
            the policies if left out.

    Raises:
        ImportError: when Jinja is missing, naming the extra to install.
    """
    return render_report(report(results, scenes, words))


def render_report(content: Report) -> str:
    """The content of a page as HTML.

    Raises:
        ImportError: when Jinja is missing, naming the extra to install.
    """
    scenes = {
        section.name: scene_data(content.scenes[section.name], section.shown, section.picked)
        for section in content.sections
    }
    figures = {
        "colours": COLOURS,
        "policies": content.policies,
        "profiles": content.profiles,
        "thresholds": content.thresholds,
        "shown": content.sections[0].shown,
        "scenes": list(scenes),
    }
    plotly = resources.files("ptne_env.bench.report") / "plotly" / "plotly-basic.min.js"
    packed = _packed(scenes) | {"plotly": _pack(plotly.read_text(encoding="utf-8"))}
    divisions = {division for table in content.leaderboard for division in table.sections}
    return render_template(
        "page.html",
        report=content,
        figures=figures,
        packed=packed,
        marks=MARKS,
        mark_notes=MARK_NOTES,
        divisions=divisions,
        most_columns=_MOST_COLUMNS,
    )


def render_episode(name: str, scene: Scene) -> str:
    """The player alone, as HTML, with the first episode of every policy of a scene side by side.

    Args:
        name: of the scenario.
        scene: of that scenario.

    Raises:
        ImportError: when Jinja is missing, naming the extra to install.
    """
    policies = list(scene.traces)
    figures = {"colours": COLOURS, "policies": policies, "scenes": [name]}
    packed = _packed({name: scene_data(scene, policies, policies)})
    return render_template("episode.html", title=f"{name}: {', '.join(policies)}", figures=figures, packed=packed)


def _packed(scenes: Mapping[str, Any]) -> dict[str, str]:
    """Every scene by itself: the browser unpacks it when the reader opens it."""
    return {
        f"scene-{index}": _pack(json.dumps(scene, allow_nan=False, ensure_ascii=False, separators=(",", ":")))
        for index, scene in enumerate(scenes.values())
    }


def _pack(text: str) -> str:
    return b64encode(compress(text.encode(), mtime=0)).decode("ascii")


# --- content --------------------------------------------------------------------------------------------------------


def report(results: Results, scenes: Mapping[str, Scene], words: Sequence[str] | None = None) -> Report:
    """The content of the page of results; arguments as :func:`page`."""
    suite, board = results.suite, results.leaderboard
    leading = len(overview(results))
    tables = summary_tables(results)
    named = _words(results) if words is None else words
    first = {track.name: names[0] for names, tracks in leaders(results).items() for track in tracks}
    return Report(
        title=f"{suite.name}, seed {results.seed}",
        answer=answer(results),
        leaderboard=tuple(tables[:leading]),
        all_tracks=tuple(tables[leading:]),
        sections=tuple(_section(results, track, scenes[track.name], named, first) for track in results.tracks),
        policies=tuple(results.policies),
        profiles={} if board is None else {row.policy: row.profile for row in board.overall},
        thresholds=() if board is None else board.thresholds,
        scenes=dict(scenes),
        command=_command(results, results.tracks, named),
        facts=(
            ("suite", suite.name),
            ("suite, SHA-256", suite.content_hash),
            ("seed", str(results.seed)),
            ("split", results.split),
            ("check of a sample of jobs, in the folder of this page", "ptne check results.json"),
            *((_VERSIONS.get(name, f"{name} version"), version) for name, version in versions().items()),
        ),
        parameters=tuple(row for spec in results.policies.values() for row in _parameters(spec)),
    )


def _section(
    results: Results, track: Track, scene: Scene, words: Sequence[str] | None, first: Mapping[str, str]
) -> Section:
    """The part about a track; ``first`` is the entry that the answer names, by track."""
    tables = tuple(track_tables(results, track))
    world, scenario = track.world, track.scenario
    keys: dict[str, list[str]] = {}
    for job in results.jobs:
        if job.track.name == track.name and job.key is not None:
            keys.setdefault(job.policy.name, []).append(job.key)
    ranked = [policy for policy, division in tables[0].rows.items() if division != "oracle"]
    own = [policy for policy in own_policies(results) if policy in ranked]
    ranked.sort(key=lambda policy: policy != first.get(track.name))  # it is the best, or one of the best
    return Section(
        name=track.name,
        description=_description(results, track),
        about=f"{track_rules(results, track)} {type(world.game).__name__} with {world.game.num_players} players; "
        f"T\u00a0=\u00a0{scenario.deadline:g}\u00a0s, c\u00a0=\u00a0{scenario.gain:g} per second, "
        f"{scenario.steps} steps to the deadline, {scenario.hold_steps} after it.",
        tables=tables,
        shown=_shown(ranked, own),
        picked=tuple(dict.fromkeys([*ranked[:1], *(own or [name for name in ranked if name == LAW])])),
        command=_command(results, [track], words),
        episodes=(scene.episodes, results.episodes[track.name]),
        facts=(
            ("track, SHA-256", content_hash(track.to_dict())),
            ("replay of the player's episode", _replay(results, track)),
            *((f"job of {policy}", " ".join(found)) for policy, found in keys.items()),
        ),
    )


def _description(results: Results, track: Track) -> str:
    """One sentence about a track."""
    return DESCRIPTIONS.get(track.name, track.change) if results.suite.is_comparison else track.change


def _shown(ranked: Sequence[str], own: Sequence[str]) -> tuple[str, ...]:
    """The best of ``ranked``, the user's own policies and the paper's law."""
    kept = [*own, *(name for name in ranked if name == LAW)]
    others = [name for name in ranked if name not in kept]
    return (*others[: max(1, SHOWN - len(kept))], *kept)


def _replay(results: Results, track: Track) -> str:
    """Python that makes an environment and resets it to the first episode of a track."""
    seed = results.suite.episode_set(track.name, seed=results.seed, split=results.split).episode_seed(0)
    name, scenario = track.name, track.scenario
    if not results.suite.is_comparison:
        made = f"get_suite({results.target or results.suite.name!r}).track({name!r}).scenario"
    elif scenario == _of_catalogue(name, hold_steps=scenario.hold_steps):
        made = f"{name!r}, hold_steps={scenario.hold_steps}"
    elif scenario == _of_catalogue(name, hold_steps=scenario.hold_steps, start="random"):
        made = f"{name!r}, hold_steps={scenario.hold_steps}, start='random'"
    else:
        made = f"Scenario.from_dict({scenario.to_dict()})"
    return f"ptne_env.parallel_env({made}).reset(seed={seed})"


def _of_catalogue(name: str, **changes: Any) -> Scenario | None:
    return CATALOGUE[name].replace(**changes) if name in CATALOGUE else None


def _words(results: Results) -> list[str] | None:
    """The values of ``--policy`` that name the policies, none for the default ones; ``None`` where names do not do."""
    usual = [*(default_policies() if results.suite.is_comparison else suite_policies()), *results.suite.references]
    if results.policies == {spec.name: spec for spec in usual}:
        return []
    known = {spec.name: get_policy_spec(spec.name) for spec in suite_policies()}
    return list(results.policies) if results.policies.items() <= known.items() else None


def _command(results: Results, tracks: Sequence[Track], words: Sequence[str] | None) -> str | None:
    """The command that repeats the numbers of some tracks; ``None`` where something was made in Python."""
    count, hold_steps = max(results.episodes.values()), tracks[0].scenario.hold_steps
    options: dict[str, Sequence[object]] = {"--seed": [results.seed], "--episodes": [count]}
    if results.suite.is_comparison:
        names = [track.name for track in tracks]
        if not CATALOGUE.keys() >= set(names):
            return None
        if not set(tracks) <= set(comparison(names, episodes=count, hold_steps=hold_steps).tracks):
            return None
        options["--scenario"] = [] if len(names) == len(CATALOGUE) else names
        options["--hold-steps"] = [hold_steps]
    else:
        options["--suite"] = [results.target]
        options["--track"] = [track.name for track in tracks if len(tracks) < len(results.suite.tracks)]
    if words is None or results.split != "test" or options.get("--suite") == [None]:
        return None
    options["--policy"] = words
    given = [word for option, values in options.items() for value in values for word in (option, str(value))]
    foreign = any(map(foreign_code, words)) or foreign_suites(results.target)
    return shlex.join(["ptne", "compare", *given, *(["--trust"] if foreign else [])])


def _parameters(spec: PolicySpec) -> Iterable[tuple[str, str, str, str]]:
    """A row per training seed: the name, the policy with its arguments, the interface, the files."""
    for seed in spec.to_dict()["training_seeds"]:
        arguments = ", ".join(f"{key}={value!r}" for key, value in seed.get("arguments", {}).items())
        files = ", ".join(f"{name} {digest[:12]}" for name, digest in seed.get("files", {}).items())
        yield spec.name, f"{seed['target']}({arguments})", spec.interface.kind, files


# --- figures --------------------------------------------------------------------------------------------------------


def scene_data(scene: Scene, shown: Sequence[str], picked: Sequence[str]) -> dict[str, Any]:
    """A scene for figures and player, as a JSON object. Rows of numbers are codes, each less the code before it.

    The code of a number v is round(log10(|v| / 1e-13) / 8e-4) with the sign of v, 0 below 1e-13; of an error e,
    round(100 log10 e). Neighbours are close, so the differences take less room than numbers.

    Args:
        scene: to draw.
        shown: policies that the figure of errors shows before the reader chooses.
        picked: policies that the player shows before the reader chooses.
    """
    changes = np.flatnonzero(np.r_[True, (np.diff(scene.live.astype(np.int8), axis=1) != 0).any(axis=0)])
    x = scene.equilibrium  # distances from it keep the last digits of small ones
    return {
        "shown": list(shown),
        "picked": list(picked),
        "t": _rounded(scene.t, 6),
        "s": _rounded(scene.s, 6),
        "gain": _rounded(scene.gain, 3),
        "deadline": scene.deadline_frame,
        "players": scene.num_players,
        "owners": scene.owners.tolist(),
        "in_plane": scene.in_plane,
        "equilibrium": _rounded(scene.equilibrium[:, 0], 6),
        "links": scene.links.tolist(),
        "live": [[int(frame), np.flatnonzero(scene.live[:, frame]).tolist()] for frame in changes],
        "episodes": scene.episodes,
        "traces": {
            name: {
                "errors": _differences(-100 * distances.digits(trace.errors)),
                "error": _differences(-100 * distances.digits(trace.error[None])),
                "strategies": _coded(trace.strategies - x),
                "estimates": None if trace.estimates is None else _coded(trace.estimates - x[:, None]),
                "inputs": _coded(trace.inputs),
                "gains": _coded(trace.consensus_gains),
            }
            for name, trace in scene.traces.items()
        },
    }


def _rounded(values: FloatArray, digits: int) -> list[float]:
    return [round(value, digits) + 0.0 for value in values.tolist()]


def _coded(values: FloatArray) -> list[list[int]]:
    """Rows of numbers of any sign and size, the last axis along a row."""
    sizes = np.abs(values)
    with np.errstate(invalid="ignore"):
        codes = np.sign(values) * np.rint(np.log10(np.maximum(sizes, _FINEST) / _FINEST) / _STEP)
    return _differences(np.where(np.isfinite(values), codes, _NONE))


def _differences(codes: FloatArray) -> list[list[int]]:
    whole = np.rint(codes).astype(np.int64).reshape(-1, codes.shape[-1])
    differences: list[list[int]] = np.diff(whole, axis=1, prepend=0).tolist()
    return differences
