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

from ptne_env import distances
from ptne_env.arrays import FloatArray
from ptne_env.catalogue import CATALOGUE
from ptne_env.experiments.policy_specs import PolicySpec
from ptne_env.experiments.provenance import content_hash, versions
from ptne_env.experiments.results import Results
from ptne_env.experiments.suite import LAW, PAPER_START, Track
from ptne_env.experiments.traces import Scene
from ptne_env.report.html import render_template
from ptne_env.report.tables import (
    FIRST_MARGIN,
    MARK_NOTES,
    MARKS,
    Table,
    Value,
    first_places,
    mean_digits,
    summary_tables,
    track_rules,
    track_tables,
)
from ptne_env.scenario import Scenario
from ptne_env.style import COLOURS

SHOWN = 5
"""Policies that figures show before the reader chooses: the best, and the paper's law."""

_MOST_LINES = 200
"""The player keeps the estimates of all players up to this many lines, as ``env.render()`` does."""

_VERSIONS = {"sources": "sources of ptne_env, SHA-256"}

_Facts = tuple[tuple[str, str], ...]
"""Names and values."""


@dataclass(frozen=True)
class Section:
    """The part of a page about a track.

    Attributes:
        name: of the track.
        about: its rules and its physics, in sentences.
        tables: of its metrics.
        shown: policies that its figure shows at first.
        command: that repeats its numbers.
        facts: on which its numbers depend.
    """

    name: str
    about: str
    tables: tuple[Table, ...]
    shown: tuple[str, ...]
    command: str
    facts: _Facts


@dataclass(frozen=True)
class Report:
    """The content of a page.

    Attributes:
        title: of the page.
        answer: to the question of the page, in two sentences.
        overview: the tables over all tracks, the scores first.
        sections: one per track.
        policies: names, in the order of their colours.
        profiles: share of scores above each threshold, by policy; empty where there are no scores.
        thresholds: of the profiles.
        scenes: by name of the track.
        command: that repeats everything.
        facts: versions, seeds and hashes.
        parameters: of each training seed of every policy: name, policy, interface, files.
    """

    title: str
    answer: str
    overview: tuple[Table, ...]
    sections: tuple[Section, ...]
    policies: tuple[str, ...]
    profiles: Mapping[str, Sequence[float]]
    thresholds: Sequence[float]
    scenes: Mapping[str, Scene]
    command: str
    facts: _Facts
    parameters: tuple[tuple[str, str, str, str], ...]


def page(results: Results, scenes: Mapping[str, Scene]) -> str:
    """Results as one HTML file with everything that it needs inside.

    Args:
        results: of a comparison or of another suite.
        scenes: of every track (:func:`~ptne_env.experiments.traces.scenes`).

    Raises:
        ImportError: when Jinja is missing, naming the extra to install.
    """
    return render_report(report(results, scenes))


def render_report(content: Report) -> str:
    """The content of a page as HTML.

    Raises:
        ImportError: when Jinja is missing, naming the extra to install.
    """
    scenes = {section.name: scene_data(content.scenes[section.name], section.shown) for section in content.sections}
    figures = {
        "colours": COLOURS,
        "policies": content.policies,
        "profiles": content.profiles,
        "thresholds": content.thresholds,
        "shown": content.sections[0].shown,
        "scenes": list(scenes),
    }
    plotly = resources.files("ptne_env.report") / "plotly" / "plotly-basic.min.js"
    packed = _packed(scenes) | {"plotly": _pack(plotly.read_text(encoding="utf-8"))}
    return render_template(
        "page.html", report=content, figures=figures, packed=packed, marks=MARKS, mark_notes=MARK_NOTES
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
    packed = _packed({name: scene_data(scene, policies)})
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


def report(results: Results, scenes: Mapping[str, Scene]) -> Report:
    """The content of the page of results; arguments as :func:`page`."""
    suite, board = results.suite, results.leaderboard
    tables = summary_tables(results)
    return Report(
        title=f"{suite.name}, seed {results.seed}",
        answer=_answer(results, tables[0]),
        overview=tuple(tables),
        sections=tuple(_section(results, track, scenes[track.name]) for track in results.tracks),
        policies=tuple(results.every_policy),
        profiles={} if board is None else {row.policy: row.profile for row in board.overall},
        thresholds=() if board is None else board.thresholds,
        scenes=dict(scenes),
        command=_command(results, results.tracks),
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


def _answer(results: Results, table: Table) -> str:
    """The best policy, and its distance from the paper's law or from the next policy."""
    firsts, acting = first_places(results), {policy for _, policy in results.samples}
    sections = (names for division, names in table.sections.items() if division != "oracle")
    ranked = next(filter(None, ([name for name in names if name in acting] for names in sections)), [])
    if not ranked and results.failures:
        failing = sorted({policy for _, policy in results.failures})
        return f"{_listed(failing)} failed; the tables below name the steps and the errors."
    if not ranked:
        return "Only oracles were run, which use information that players lack: no policy can be compared with them."
    best, *others = ranked
    values = {column.label: str(column[best]) for column in table.columns if column[best].value is not None}
    count = len(results.tracks)
    tied = (
        [policy for policy in ranked if len(firsts[policy]) == len(firsts[best])] if "score" not in values else [best]
    )
    answer = (
        f"{_listed(tied)} {'is' if len(tied) == 1 else 'are each'} the closest to the equilibrium, or within "
        f"{FIRST_MARGIN:g} digits of the closest, on {len(firsts[best])} of {count} track{'s' * (count > 1)}, with "
        f"{values.get('mean digits', 'no')} digits at the deadline on average"
    )
    if len(tied) > 1:
        answer += f" ({best})"
    if "score" in values:
        answer += f" and a score of {values['score']}, where 0 is zero input and 1 full marks"
    return f"{answer}. {_comparison(results, best, others, values.get(f'P(better than {LAW})'))}"


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _comparison(results: Results, best: str, others: Sequence[str], improvement: str | None) -> str:
    if LAW not in others:
        if not others:
            return "No other policy was run."
        return f"The next is {others[0]}, with {Value.of(mean_digits(results, others[0]))} digits on average."
    law, ahead = mean_digits(results, LAW, on=best), mean_digits(results, best, minus=LAW)
    if ahead.mean is None:
        return f"The paper's law ({LAW}) was run on none of these tracks."
    difference = f"gains {Value.of(ahead)} on it"
    if ahead.mean < 0:  # the first on most tracks, and far behind on the others
        difference = f"stays {Value.of(mean_digits(results, LAW, minus=best))} behind it"
    better = "" if improvement is None else f" and is better with probability {improvement}"
    return f"The paper's law ({LAW}) reaches {Value.of(law)} digits on the same tracks; {best} {difference}{better}."


def _section(results: Results, track: Track, scene: Scene) -> Section:
    tables = tuple(track_tables(results, track))
    world, scenario = track.world, track.scenario
    keys: dict[str, list[str]] = {}
    for job in results.jobs:
        if job.track.name == track.name and job.key is not None:
            keys.setdefault(job.policy.name, []).append(job.key)
    return Section(
        name=track.name,
        about=f"{track_rules(results, track)} {type(world.game).__name__} with {world.game.num_players} players; "
        f"T = {scenario.deadline:g} s, c = {scenario.gain:g} per second, {scenario.steps} steps to the deadline, "
        f"{scenario.hold_steps} after it.",
        tables=tables,
        shown=_shown([policy for policy, division in tables[0].rows.items() if division != "oracle"]),
        command=_command(results, [track]),
        facts=(
            ("track, SHA-256", content_hash(track.to_dict())),
            ("replay of the player's episode", _replay(results, track)),
            ("errors against time", f"median and 10–90 % band over the first {scene.episodes} episodes"),
            *((f"job of {policy}", " ".join(found)) for policy, found in keys.items()),
        ),
    )


def _shown(ranked: Sequence[str]) -> tuple[str, ...]:
    """The best of ``ranked``, and the paper's law last: the player starts with the first and the last of them."""
    others = [name for name in ranked if name != LAW]
    return tuple([*others[: SHOWN - 1], LAW] if LAW in ranked else others[:SHOWN])


def _replay(results: Results, track: Track) -> str:
    """Python that makes an environment and resets it to the first episode of a track."""
    seed = results.suite.episode_set(track.name, seed=results.seed, split=results.split).episode_seed(0)
    name, scenario = track.name.removesuffix(PAPER_START), track.scenario
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


def _command(results: Results, tracks: Sequence[Track]) -> str:
    """The command that repeats the numbers of some tracks."""
    options: dict[str, list[object]] = {"--seed": [results.seed], "--episodes": [max(results.episodes.values())]}
    if results.suite.is_comparison:
        options["--scenario"] = list(dict.fromkeys(track.name.removesuffix(PAPER_START) for track in tracks))
        options["--hold-steps"] = [tracks[0].scenario.hold_steps]
    else:
        options["--suite"] = [results.target or results.suite.name]
        options["--track"] = [track.name for track in tracks if len(tracks) < len(results.suite.tracks)]
    options["--policy"] = list(results.policies)
    words = (word for option, values in options.items() for value in values for word in (option, str(value)))
    return shlex.join(["ptne", "compare", *words])


def _parameters(spec: PolicySpec) -> Iterable[tuple[str, str, str, str]]:
    """A row per training seed: the name, the policy with its arguments, the interface, the files."""
    for seed in spec.to_dict()["training_seeds"]:
        arguments = ", ".join(f"{key}={value!r}" for key, value in seed.get("arguments", {}).items())
        files = ", ".join(f"{name} {digest[:12]}" for name, digest in seed.get("files", {}).items())
        interface = f"{spec.interface.kind}, {spec.interface.action_mode}"
        yield spec.name, f"{seed['target']}({arguments})", interface, files


# --- figures --------------------------------------------------------------------------------------------------------


def scene_data(scene: Scene, shown: Sequence[str]) -> dict[str, Any]:
    """A scene for figures and player, as a JSON object; arrays are base64 of little-endian float32 by rows.

    Args:
        scene: to draw.
        shown: policies that are drawn before the reader chooses.
    """
    changes = np.flatnonzero(np.r_[True, (np.diff(scene.live.astype(np.int8), axis=1) != 0).any(axis=0)])
    components = np.arange(len(scene.owners))
    offsets = {
        name: trace.estimates - scene.equilibrium[:, None] for name, trace in scene.traces.items()
    }  # from x*, so that float32 keeps the last digits of small distances
    return {
        "shown": list(shown),
        "t": _rounded(scene.t, 6),
        "s": _rounded(scene.s, 6),
        "gain": _rounded(scene.gain, 3),
        "deadline": scene.deadline_frame,
        "players": scene.num_players,
        "owners": scene.owners.tolist(),
        "equilibrium": _rounded(scene.equilibrium[:, 0], 6),
        "links": scene.links.tolist(),
        "live": [[int(frame), np.flatnonzero(scene.live[:, frame]).tolist()] for frame in changes],
        "episodes": scene.episodes,
        "traces": {
            name: {
                "errors": [_rounded(-distances.digits(row), 2) for row in trace.errors],
                "error": _rounded(-distances.digits(trace.error), 2),
                "strategies": _encoded(offsets[name][components, scene.owners]),
                "estimates": _encoded(offsets[name]) if trace.estimates[..., 0].size <= _MOST_LINES else None,
                "inputs": _encoded(trace.inputs),
                "gains": _encoded(trace.consensus_gains),
            }
            for name, trace in scene.traces.items()
        },
    }


def _rounded(values: FloatArray, digits: int) -> list[float]:
    return [round(value, digits) + 0.0 for value in values.tolist()]


def _encoded(values: FloatArray) -> str:
    return b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")
