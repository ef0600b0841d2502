"""What a report says: the answer, tables, sections and what its figures draw, built from results and typed."""

from __future__ import annotations

import shlex
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ptne_env import distances
from ptne_env.arrays import FloatArray
from ptne_env.catalogue import CATALOGUE
from ptne_env.experiments import METRICS, PolicySpec, Results, episode_seed
from ptne_env.experiments.benchmark import TIMINGS, Participant, files, versions
from ptne_env.experiments.compare import PAPER_START
from ptne_env.experiments.leaderboard import THRESHOLDS, Leaderboard, OverallRow, TrackRow
from ptne_env.experiments.metrics import SUITE_METRICS
from ptne_env.experiments.statistics import Summary, estimate, mean
from ptne_env.experiments.suite import LAW, content_hash
from ptne_env.experiments.traces import Scene
from ptne_env.factory import FactorySpec
from ptne_env.report.tables import number, share
from ptne_env.world import World

SHOWN = 5
"""Policies that figures show before the reader chooses: the best, and the paper's law."""

_LINES = 200
"""Estimates of all players are kept for the player up to this many lines, as in ``env.render()``."""

_FLOOR_MARGIN = 0.1
"""A policy whose interval comes within this many digits of the best's shares the first place."""


@dataclass(frozen=True)
class Value:
    """A cell of a table.

    Attributes:
        text: as it is shown.
        value: by which the column is sorted; ``None`` where there is none, which stands last.
        interval: the 95 % interval, as it is shown; empty where there is none.
        title: a longer form.
    """

    text: str
    value: float | None = None
    interval: str = ""
    title: str = ""


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        label: its heading.
        meaning: what is in it, in a sentence.
        descending: whether large values are good, so that the first click shows them first.
    """

    label: str
    meaning: str
    descending: bool = False


@dataclass(frozen=True)
class Row:
    """A row of a table: a policy and its values.

    Attributes:
        name: of the policy.
        values: one per column.
        oracle: whether it sees what no player can see.
    """

    name: str
    values: tuple[Value, ...]
    oracle: bool = False


@dataclass(frozen=True)
class Table:
    """A table whose rows are policies, the best first.

    Attributes:
        caption: what it shows.
        columns: the columns after the policy's name.
        rows: one per policy.
        notes: below it.
    """

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Section:
    """A scenario or track.

    Attributes:
        name: of it.
        about: what it is, in a sentence or two.
        table: how all policies did.
        shown: policies that its figures show at first.
        command: that repeats the table's numbers.
        facts: what the numbers depend on: names and values.
    """

    name: str
    about: str
    table: Table
    shown: tuple[str, ...]
    command: str
    facts: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Report:
    """Everything on the page.

    Attributes:
        title: of the page.
        kind: of the sections: ``"scenario"`` or ``"track"``.
        question: that the results answer.
        answer: in two sentences.
        leaderboard: over all sections.
        sections: a scenario or track each.
        policies: names, in the order of the comparison.
        profiles: share of scores above each threshold by policy; empty where there are no scores.
        thresholds: of the profiles.
        scenes: what figures and player draw, by name of the section.
        command: that repeats everything.
        facts: versions, seeds and hashes.
        parameters: of every policy: name, target with arguments, interface, files.
    """

    title: str
    kind: str
    question: str
    answer: str
    leaderboard: Table
    sections: tuple[Section, ...]
    policies: tuple[str, ...]
    profiles: dict[str, tuple[float, ...]]
    thresholds: tuple[float, ...]
    scenes: dict[str, Scene]
    command: str
    facts: tuple[tuple[str, str], ...]
    parameters: tuple[tuple[str, str, str, str], ...]


def drawn(scene: Scene, shown: Sequence[str]) -> dict[str, Any]:
    """What figures and player draw of a scene, as a JSON object; arrays are base64 of little-endian float32 by rows.

    Args:
        scene: to draw.
        shown: policies that are drawn before the reader chooses.
    """
    changes = np.flatnonzero(np.r_[True, (np.diff(scene.live.astype(np.int8), axis=1) != 0).any(axis=0)])
    components = np.arange(len(scene.owners))
    offsets = {
        name: trace.estimates - scene.equilibrium[:, None, None] for name, trace in scene.traces.items()
    }  # from x*, so that float32 keeps the last digits of small distances
    return {
        "shown": list(shown),
        "t": _rounded(scene.t, 6),
        "s": _rounded(scene.s, 6),
        "gain": _rounded(scene.gain, 3),
        "deadline": scene.deadline_frame,
        "players": scene.num_players,
        "owners": scene.owners.tolist(),
        "equilibrium": _rounded(scene.equilibrium, 6),
        "links": scene.links.tolist(),
        "live": [[int(frame), np.flatnonzero(scene.live[:, frame]).tolist()] for frame in changes],
        "episodes": scene.episodes,
        "traces": {
            name: {
                "errors": [_rounded(-distances.digits(row), 2) for row in trace.errors],
                "error": _rounded(-distances.digits(trace.error), 2),
                "strategies": _encoded(offsets[name][components, scene.owners]),
                "estimates": _encoded(offsets[name]) if trace.estimates[..., 0].size <= _LINES else None,
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


def _value(summary: Summary | None, format_: Callable[[float | None], str] = number) -> Value:
    if summary is None or summary.mean is None:
        return Value("–")
    interval = "" if summary.low == summary.high else f"[{format_(summary.low)}, {format_(summary.high)}]"
    return Value(format_(summary.mean), summary.mean, interval)


def _said(summary: Summary, format_: Callable[[float | None], str] = number) -> str:
    """A mean with its interval, for a sentence."""
    value = _value(summary, format_)
    return f"{value.text} {value.interval}".rstrip()


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _parameters(participants: Iterable[Participant]) -> tuple[tuple[str, str, str, str], ...]:
    rows = []
    for participant in participants:
        for run in participant.runs:
            hashes = files(run) if isinstance(run.policy, FactorySpec) else {}
            kinds = f"{run.interface.kind}, {run.interface.action_mode}"
            held = ", ".join(f"{name} {digest[:12]}" for name, digest in hashes.items())
            rows.append((participant.name, _spelled(run), kinds, held))
    return tuple(rows)


def _spelled(entry: PolicySpec) -> str:
    policy = entry.to_dict()["policy"]
    arguments = ", ".join(f"{key}={value!r}" for key, value in policy.get("arguments", {}).items())
    return f"{policy['target']}({arguments})"


def _facts_of(scene: Scene) -> tuple[str, str]:
    return "errors against time", f"median and 10–90 % band over the first {scene.episodes} episodes"


# ---------------------------------------------------------------------------------------------------- comparisons

_COMPARED = {
    "digits": Column("digits", METRICS["digits"], descending=True),
    "worst_decile_digits": Column("worst decile", "mean digits of the worst tenth of the episodes", descending=True),
    "strategy_distance": Column("strategy distance", METRICS["strategy_distance"]),
    "settling_time": Column("settling time [s]", METRICS["settling_time"]),
    "settled_share": Column("settled", METRICS["settled_share"], descending=True),
    "settling_time_1e_6": Column("time to 1e-6 [s]", METRICS["settling_time_1e_6"]),
    "digits_after_hold": Column("digits after hold", METRICS["digits_after_hold"], descending=True),
    "input_energy": Column("input energy", METRICS["input_energy"]),
    "peak_input": Column("peak |u|", METRICS["peak_input"]),
    "diverged_share": Column("diverged", METRICS["diverged_share"]),
}
"""Metrics of a scenario's table."""


def comparison_report(results: Results, scenes: Mapping[str, Scene], *, episodes: int, hold_steps: int) -> Report:
    """The report of a comparison of policies on scenarios.

    Args:
        results: of the comparison.
        scenes: of every scenario.
        episodes: that were asked for, per scenario.
        hold_steps: that were asked for.
    """
    records = {(record["scenario"], record["policy"], record["metric"]): record for record in results.records}
    digits = {
        label: {cell.policy: _summary(records[label, cell.policy, "digits"]) for cell in results.cells
                if cell.scenario == label}
        for label in results.scenarios
    }  # fmt: skip
    oracles = {name for name, entry in results.entries.items() if entry.interface.kind == "full"}
    first = {
        label: _first({name: summary for name, summary in found.items() if name in results.entries}, oracles)
        for label, found in digits.items()
    }
    common = ["compare", "--episodes", str(episodes), "--seed", str(results.seed), "--hold-steps", str(hold_steps)]
    sections = []
    for label, scenario in results.scenarios.items():
        ranked = sorted(digits[label], key=lambda name: -(digits[label][name].mean or 0.0))
        rows = tuple(
            Row(
                name,
                tuple(_value(_summary(records[label, name, metric])) for metric in _COMPARED),
                oracle=name in oracles,
            )
            for name in ranked
        )
        count = records[label, ranked[0], "digits"]["episodes"]
        starts = "the paper's own start" if label.endswith(PAPER_START) else f"{count} starts"
        named = label.removesuffix(PAPER_START)
        game, players = World(scenario).game, World(scenario).game.num_players
        about = (
            f"{type(game).__name__} with {players} players, {starts}; T = {scenario.deadline:g} s, "
            f"c = {scenario.gain:g} per second, {scenario.steps} steps to the deadline, {scenario.hold_steps} after it."
        )
        entrants = [name for name in results.entries if name in digits[label]]
        sections.append(
            Section(
                label,
                about,
                Table(f"{label}: means over {starts} and 95 % intervals", tuple(_COMPARED.values()), rows),
                _shown([name for name in ranked if name not in oracles]),
                _command([*common, "--scenario", named, *_each("--policy", entrants)]),
                (
                    ("scenario, SHA-256", content_hash(scenario.to_dict())),
                    *(
                        (entry.name, f"{_spelled(entry)}, tuned on the validation bank")
                        for entry in results.tuned.get(label, {}).values()
                    ),
                    ("replay of the player's episode", _replay(named, label, results.seed)),
                    _facts_of(scenes[label]),
                ),
            )
        )
    entries = results.entries
    return Report(
        title="Comparison of policies",
        kind="scenario",
        question="Which policy brings the estimates of all players closest to the Nash equilibrium by the deadline, "
        "from what a player can see, and how far does the paper's law come?",
        answer=_comparison_answer(results, digits, first, oracles),
        leaderboard=_comparison_leaderboard(results, digits, first, oracles),
        sections=tuple(sections),
        policies=tuple(dict.fromkeys(cell.policy for cell in results.cells)),
        profiles={},
        thresholds=(),
        scenes=dict(scenes),
        command=_command([*common, *_each("--scenario", _named(results)), *_each("--policy", entries)]),
        facts=_facts({"seed": str(results.seed), "episodes per scenario": str(episodes)}),
        parameters=_parameters(Participant(name, (entry,)) for name, entry in entries.items()),
    )


def _summary(record: Mapping[str, Any]) -> Summary:
    return Summary(record["mean"], record["low"], record["high"])


def _first(found: Mapping[str, Summary], oracles: set[str]) -> list[str]:
    """Who comes first on a scenario: the best mean, and whoever's interval comes within a tenth of a digit of it."""
    means = {name: summary for name, summary in found.items() if name not in oracles}
    best = max((summary.mean or 0.0 for summary in means.values()), default=0.0)
    return [name for name, summary in means.items() if (summary.high or 0.0) >= best - _FLOOR_MARGIN]


def _named(results: Results) -> list[str]:
    return list(dict.fromkeys(label.removesuffix(PAPER_START) for label in results.scenarios))


def _comparison_answer(
    results: Results,
    digits: Mapping[str, Mapping[str, Summary]],
    first: Mapping[str, Sequence[str]],
    oracles: set[str],
) -> str:
    wins = {name: sum(name in names for names in first.values()) for name in results.entries if name not in oracles}
    if not wins:
        return "Only oracles took part, which see what no player can see. There is nobody to compare them with."
    most = max(wins.values())
    best = [name for name, count in wins.items() if count == most]
    of_all = f"{most} of {len(first)} case{'s' * (len(first) > 1)}"
    opening = f"{_listed(best)} {'comes' if len(best) == 1 else 'come'} closest, or as close as the best, in {of_all}"
    named = best[0]
    reached = _mean_digits(results, named)
    opening += f", with {_said(reached)} digits at the deadline on average" + (f" ({named})." if len(best) > 1 else ".")
    if LAW not in results.entries or LAW in best:
        return f"{opening} {_runner_up(results, [name for name in wins if name not in best])}"
    pairs = [
        (cell.samples["digits"] - other.samples["digits"])[None]
        for cell in results.cells
        for other in results.cells
        if cell.scenario == other.scenario and (cell.policy, other.policy) == (named, LAW)
    ]
    if not pairs:
        return f"{opening} The paper's law ({LAW}) took part in none of its cases."
    law = _mean_digits(results, LAW, [label for label, found in digits.items() if named in found])
    closing = f"The paper's law ({LAW}) reaches {_said(law)} digits in the same cases"
    ahead = estimate(mean, pairs)
    if (ahead.mean or 0.0) < 0:  # first in most cases, and far behind in the others
        return f"{opening} {closing}; {named} stays {_said(estimate(mean, [-pair for pair in pairs]))} behind it."
    return f"{opening} {closing}; {named} gains {_said(ahead)} on it."


def _runner_up(results: Results, others: Sequence[str]) -> str:
    if not others:
        return "Nobody else took part."
    runner = max(others, key=lambda name: _mean_digits(results, name).mean or 0.0)
    return f"Of the others {runner} reaches most: {_said(_mean_digits(results, runner))} digits on average."


def _mean_digits(results: Results, policy: str, labels: Sequence[str] | None = None) -> Summary:
    """Mean over scenarios of the mean digits, with the interval over episodes."""
    found = [
        cell.samples["digits"][None]
        for cell in results.cells
        if cell.policy == policy and (labels is None or cell.scenario in labels)
    ]
    return estimate(mean, found)


def _comparison_leaderboard(
    results: Results,
    digits: Mapping[str, Mapping[str, Summary]],
    first: Mapping[str, Sequence[str]],
    oracles: set[str],
) -> Table:
    labels = list(results.scenarios)
    columns = (
        Column(
            "first", "cases in which nobody comes more than a tenth of a digit closer, with certainty", descending=True
        ),
        Column("cases", "scenarios and starts in which it took part", descending=True),
        Column("mean digits", "over the cases in which it took part", descending=True),
        *(Column(label, f"digits on {label}", descending=True) for label in labels),
    )
    rows = []
    for name in results.entries:
        entered = [label for label in labels if name in digits[label]]
        wins = None if name in oracles else sum(name in first[label] for label in entered)
        values = (
            Value("–" if wins is None else str(wins), wins),
            Value(str(len(entered)), len(entered)),
            _value(_mean_digits(results, name)) if entered else Value("–"),
            *(_value(digits[label].get(name)) for label in labels),
        )
        rows.append(Row(name, values, oracle=name in oracles))
    rows.sort(key=lambda row: (-(row.values[0].value or 0.0), -(row.values[2].value or 0.0)))
    return Table("Digits at the deadline by policy and case, with 95 % intervals", columns, tuple(rows))


def _replay(name: str, label: str, seed: int) -> str:
    if label.endswith(PAPER_START):
        return f"ptne_env.parallel_env({name!r}).reset()"
    start = "" if CATALOGUE.get(name) is None or World(CATALOGUE[name]).is_random else ", start='random'"
    return f"ptne_env.parallel_env({name!r}{start}).reset(seed={episode_seed(seed, 0)})"


# ----------------------------------------------------------------------------------------------------- suites


def suite_report(board: Leaderboard, scenes: Mapping[str, Scene], *, folder: str) -> Report:
    """The report of a suite.

    Args:
        board: the results.
        scenes: of every track.
        folder: of the results.
    """
    run = board.run
    names = list(run.participants)
    base = ["compare", "--suite", run.target, "--seed", str(run.seed), "--episodes", str(run.episodes)]
    base += ["--policies", ",".join(names), "--out", folder]
    sections = tuple(_track_section(board, track.name, scenes[track.name], base) for track in run.tracks)
    return Report(
        title=f"{run.suite.name}, seed {run.seed}",
        kind="track",
        question="Which policy brings the estimates of all players closest to the Nash equilibrium by the deadline, "
        "over all tracks and from what a player can see, and is it better than the paper's law?",
        answer=_suite_answer(board),
        leaderboard=_suite_leaderboard(board),
        sections=sections,
        policies=tuple(names),
        profiles={row.policy: row.profile for row in board.overall},
        thresholds=THRESHOLDS,
        scenes=dict(scenes),
        command=_command([*base, *(_each("--track", [t.name for t in run.tracks]) if not _whole(board) else [])]),
        facts=_facts(
            {
                "suite": run.suite.name,
                "suite, SHA-256": run.suite.content_hash,
                "seed": str(run.seed),
                "split": run.split,
                "episodes per track": str(run.episodes),
                "check of a sample of cells": _command(["compare", "--check", f"{folder}/results.json"]),
            }
        ),
        parameters=_parameters(run.participants.values()),
    )


def _whole(board: Leaderboard) -> bool:
    return len(board.run.tracks) == len(board.run.suite.tracks)


def _suite_answer(board: Leaderboard) -> str:
    run = board.run
    ranked = [row for row in board.overall if not run.participants[row.policy].is_oracle]
    if not ranked:
        return (
            "No overall score exists: there is no track that all can play and on which the law gains. "
            "The tracks' own tables say who came closest on each."
        )
    best, tracks = ranked[0], len(board.common)
    firsts = sum(row.rank == 1 for row in board.rows if row.policy == best.policy and row.track in board.common)
    where = f"Over {tracks} track{'s' * (tracks != 1)}"
    if best.policy == LAW:
        text = f"{where}, nobody scores above the paper's law ({LAW}), which is 1 by definition."
    else:
        text = (
            f"{where}, {best.policy} has the highest score, {_said(best.score, share)}, where 0 is doing nothing and 1 "
            f"is the paper's law, and it is better than the law with probability {_said(best.improvement, share)}."
        )
    text += f" It ranks first on {firsts} of them"
    if len(ranked) > 1:
        text += f"; the runner-up is {ranked[1].policy} with {_said(ranked[1].score, share)}"
    return text + "."


def _suite_leaderboard(board: Leaderboard) -> Table:
    run = board.run
    columns = (
        Column(
            "score",
            "interquartile mean of the normalised scores: 0 is doing nothing, 1 the paper's law",
            descending=True,
        ),
        Column("mean rank", "over the tracks that all can play"),
        Column(f"P(better than {LAW})", "probability of improvement, paired by episode", descending=True),
        *(
            Column(track.name, f"{track.metric.replace('_', ' ')} on {track.name}", descending=True)
            for track in run.tracks
        ),
    )
    overall: dict[str, OverallRow] = {row.policy: row for row in board.overall}
    order = [*overall, *(name for name in run.participants if name not in overall)]
    rows = []
    for name in order:
        row = overall.get(name)
        by_track = []
        for track in run.tracks:
            metrics = board.row(track.name, name).metrics
            by_track.append(Value("n/a") if metrics is None else _value(metrics[track.metric]))
        values = (
            _value(None if row is None else row.score, share),
            Value("–") if row is None or row.mean_rank is None else Value(number(row.mean_rank), row.mean_rank),
            _value(None if row is None else row.improvement, share),
            *by_track,
        )
        rows.append(Row(name, values, oracle=run.participants[name].is_oracle))
    told = "No track has scores: none can be played by all and gives the law a gain."
    if board.common:
        told = (
            f"Scores are taken over the tracks that all can play and on which the law gains: {_listed(board.common)}."
        )
    return Table(
        "Overall scores, and what each track is scored by, with 95 % intervals",
        columns,
        tuple(rows),
        (told,),
    )


_TRACK_METRICS = {
    "strategy_distance": Column("strategy distance", SUITE_METRICS["strategy_distance"]),
    "settled_share": Column("settled", SUITE_METRICS["settled_share"], descending=True),
    "regret": Column("regret", SUITE_METRICS["regret"]),
    "log_error_area": Column("mean log10 error", SUITE_METRICS["log_error_area"]),
    "input_energy": Column("input energy", SUITE_METRICS["input_energy"]),
    "diverged_share": Column("diverged", SUITE_METRICS["diverged_share"]),
    "messages": Column("messages", SUITE_METRICS["messages"]),
}


def _track_section(board: Leaderboard, name: str, scene: Scene, base: Sequence[str]) -> Section:
    run = board.run
    track = run.suite.track(name)
    metric = {track.metric: Column(track.metric.replace("_", " "), SUITE_METRICS[track.metric], descending=True)}
    metrics = metric | {"digits": Column("digits", SUITE_METRICS["digits"], descending=True)} | _TRACK_METRICS
    columns = (
        Column("rank", "by time to 1e-6, as the best stand at the floor" if name in board.saturated else "by digits"),
        Column("score", "0 is doing nothing, 1 the paper's law", descending=True),
        Column(f"P(better than {LAW})", "probability of improvement, paired by episode", descending=True),
        *metrics.values(),
        Column("time to 1e-6 [s]", "mean; an episode that never gets there counts as its whole length"),
        Column("µs per decision", SUITE_METRICS[TIMINGS[0]]),
        Column("cell", "hash by which the numbers are kept, and by which they depend on code, policy, track and seed"),
    )
    found = [row for row in board.rows if row.track == name]
    playing = sorted((row for row in found if row.metrics is not None), key=lambda row: (row.rank or 0, row.policy))
    rows = [
        Row(row.policy, _track_values(board, row, list(metrics)), oracle=run.participants[row.policy].is_oracle)
        for row in playing
    ]
    notes = [f"{row.policy} cannot act here: {row.not_applicable}" for row in found if row.metrics is None]
    return Section(
        name,
        track.change,
        Table(f"{name}: means over {run.episodes} episodes and 95 % intervals", columns, tuple(rows), tuple(notes)),
        _shown([row.policy for row in playing if row.rank is not None]),
        _command([*base, "--track", name]),
        (
            ("track, SHA-256", content_hash(track.to_dict())),
            (
                "replay of the player's episode",
                _replay_track(board, name),
            ),
            _facts_of(scene),
        ),
    )


def _replay_track(board: Leaderboard, name: str) -> str:
    run = board.run
    seed = run.suite.episode_seed(name, 0, seed=run.seed, split=run.split)
    return f"ptne_env.parallel_env(get_suite({run.target!r}).track({name!r}).scenario).reset(seed={seed})"


def _track_values(board: Leaderboard, row: TrackRow, metrics: Sequence[str]) -> tuple[Value, ...]:
    run, found = board.run, row.metrics or {}
    cells = [cell for cell in run.cells if (cell.track.name, cell.participant) == (row.track, row.policy)]
    timed = [measured.timings[TIMINGS[0]] for measured in run.of(row.track, row.policy)]
    microseconds = sum(timed) / len(timed)
    keys = [cell.key for cell in cells]
    return (
        Value("–" if row.rank is None else str(row.rank), row.rank),
        _value(row.score, share),
        _value(row.improvement, share),
        *(_value(found[metric]) for metric in metrics),
        Value(number(row.fine_time), row.fine_time),
        Value(number(microseconds), microseconds),
        Value(" ".join(key[:8] for key in keys), title=" ".join(keys)),
    )


# ---------------------------------------------------------------------------------------------------- both


def _shown(ranked: Sequence[str]) -> tuple[str, ...]:
    """The best of ``ranked``, and the paper's law last: the player starts with the first and the last of them."""
    others = [name for name in ranked if name != LAW]
    return tuple([*others[: SHOWN - 1], LAW] if LAW in ranked else others[:SHOWN])


def _each(option: str, values: Iterable[str]) -> list[str]:
    return [word for value in values for word in (option, value)]


def _command(words: Sequence[str]) -> str:
    return shlex.join(["ptne", *words])


def _facts(first: Mapping[str, str]) -> tuple[tuple[str, str], ...]:
    found = versions()
    names = {"ptne_env": "ptne_env version", "sources": "sources of ptne_env, SHA-256"}
    return (*first.items(), *((names.get(name, f"{name} version"), value) for name, value in found.items()))
