"""Results of a run: samples per track and policy, records with intervals, and the file ``results.json``."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from html import escape
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from ptne_env._version import __version__
from ptne_env.evaluation.episodes import Split
from ptne_env.evaluation.jobs import Job
from ptne_env.evaluation.leaderboard import Leaderboard, leaderboard
from ptne_env.evaluation.metrics import METRICS, Statistic, number
from ptne_env.evaluation.policy_specs import PolicySpec
from ptne_env.evaluation.provenance import content_hash, is_hash_of, versions
from ptne_env.evaluation.statistics import Summary, summaries
from ptne_env.evaluation.suite import Suite, Track
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.files import read_json
from ptne_env.shared.names import unknown_name
from ptne_env.shared.style import COLOURS, drawing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMAT = 5
"""Version of the meaning of ``results.json``; a file of another one is refused."""

_FORMULA = re.compile(r"(^|[,;\t]\s*)([=+\-@\t\r])")
"""The beginning of a text, or of a part of it, that a spreadsheet reads as a formula."""

Record: TypeAlias = dict[str, Any]
"""Keys: track, policy, metric, mean, low, high, episodes; the numbers are ``None`` where no episode has a value."""

Samples: TypeAlias = dict[str, FloatArray]
"""Per metric, shape (training seeds, episodes), NaN where an episode has no value; a timing is repeated."""


@dataclass(frozen=True, eq=False)
class Results:
    """The outcome of a comparison or of another suite.

    Attributes:
        suite: whose tracks were run.
        target: by which :func:`~ptne_env.evaluation.suite.get_suite` finds the suite; ``None`` for an object.
        policies: by name, in the order of tables.
        seed: of the episode sets.
        split: of the episode sets.
        episodes: number of episodes by name of each track that was run, in the order of the suite.
        jobs: of the policies.
        samples: by (track, policy).
        not_applicable: by (track, policy), why the policy cannot act or was not run there.
        failures: by (track, policy), the error of the policy there.
        records: one per track, policy and metric, with the mean (or CVaR) and its 95 % interval.
    """

    suite: Suite
    target: str | None
    policies: dict[str, PolicySpec]
    seed: int
    split: Split
    episodes: dict[str, int]
    jobs: tuple[Job, ...]
    samples: dict[tuple[str, str], Samples]
    not_applicable: dict[tuple[str, str], str]
    failures: dict[tuple[str, str], str]
    records: tuple[Record, ...]

    @property
    def tracks(self) -> tuple[Track, ...]:
        """The tracks that were run, in the order of the suite."""
        return tuple(track for track in self.suite.tracks if track.name in self.episodes)

    def policies_on(self, track: str) -> dict[str, PolicySpec]:
        """The policies that were run on a track, by name, in the order of tables."""
        return {name: policy for name, policy in self.policies.items() if (track, name) in self.samples}

    def record(self, track: str, policy: str, metric: str) -> Record:
        """The record of one track, policy and metric.

        Raises:
            KeyError: when there is no such record, with the reason where the policy cannot act on the track or failed.
        """
        try:
            return self._records[track, policy, metric]
        except KeyError:
            reason = (self.not_applicable | self.failures).get((track, policy))
            because = "" if reason is None else f": {reason}"
            raise KeyError(f"no record of {metric!r} for policy {policy!r} on track {track!r}{because}") from None

    def summary(self, track: str, policy: str, metric: str) -> Summary | None:
        """Mean and interval of a record; ``None`` where there is no such record."""
        record = self._records.get((track, policy, metric))
        return None if record is None else Summary(record["mean"], record["low"], record["high"])

    @cached_property
    def _records(self) -> dict[tuple[str, str, str], Record]:
        return {(record["track"], record["policy"], record["metric"]): record for record in self.records}

    @cached_property
    def leaderboard(self) -> Leaderboard | None:
        """Scores, ranks and profiles; ``None`` for a comparison, which has no reference policies."""
        if self.suite.is_comparison:
            return None
        return leaderboard(self.tracks, self.policies, self.samples)

    def to_dict(self) -> dict[str, Any]:
        """All that is needed to read the results and to repeat them, as a JSON object; timings in one place.

        ``format`` is the version of the meaning, ``checksum`` the hash of all but itself and the timings.
        """
        timed = [METRICS[record["metric"]].is_timing for record in self.records]
        board = self.leaderboard
        content = {
            "format": FORMAT,
            "suite": {"target": self.target, "content_hash": self.suite.content_hash, **self.suite.content()},
            "seed": self.seed,
            "split": self.split,
            "episodes": self.episodes,
            "policies": [policy.to_dict() for policy in self.policies.values()],
            "records": [record for record, is_timing in zip(self.records, timed, strict=True) if not is_timing],
            "not_applicable": _reasons(self.not_applicable),
            "failures": _reasons(self.failures),
            "leaderboard": None if board is None else asdict(board),
            "jobs": [
                {
                    "track": job.track.name,
                    "policy": job.policy.name,
                    "training_seed": job.training_seed,
                    "key": job.key,
                }
                for job in self.jobs
            ],
            "versions": versions(),
        }
        timings = [record for record, is_timing in zip(self.records, timed, strict=True) if is_timing]
        return {**content, "checksum": content_hash(content), "timings": timings}

    def to_json(self) -> str:
        """:meth:`to_dict` as a JSON text without NaN or Infinity."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False, ensure_ascii=False)

    def to_csv(self) -> str:
        """The records as CSV, each with the version, the suite's content hash, seed and split.

        A text that a spreadsheet would read as a formula is preceded by ``'``.
        """
        buffer = io.StringIO()
        writer = csv.DictWriter(buffer, self._columns, lineterminator="\n")
        writer.writeheader()
        for row in self._rows():
            writer.writerow({key: _cell(value) for key, value in row.items()})
        return buffer.getvalue()

    def to_dataframe(self) -> Any:
        """The rows of :meth:`to_csv` as a ``pandas.DataFrame``; NaN where a record has no value.

        Raises:
            ImportError: when pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError as error:
            raise ImportError("a data frame needs pandas: pip install pandas (or use to_csv or records)") from error
        numbers = ("mean", "low", "high")
        return pd.DataFrame(list(self._rows()), columns=self._columns).astype(dict.fromkeys(numbers, float))

    @property
    def _columns(self) -> list[str]:
        common = ["seed", "split", "version", "suite", "content_hash"]
        return ["track", "policy", "metric", "mean", "low", "high", "episodes", *common]

    def _rows(self) -> Iterator[Record]:
        common = (self.seed, self.split, __version__, self.suite.name, self.suite.content_hash)
        for record in self.records:
            values = (*record.values(), *common)
            yield dict(zip(self._columns, values, strict=True))

    def plot(self, metric: str | None = None) -> Figure:
        """A figure with a panel per track: the mean of every policy, and its 95 % interval, the best first.

        Args:
            metric: its name; the metric that scores the track, such as digits, if left out.

        Returns:
            A matplotlib figure, which a notebook shows, and ``plot().savefig("digits.png")`` writes.

        Raises:
            ValueError: for an unknown metric, or one that no policy has a value of.
            ImportError: when matplotlib is missing, naming the extra to install.
        """
        if metric is not None and metric not in METRICS:
            raise ValueError(unknown_name("metric", metric, METRICS))
        panels = {track: found for track in self.tracks if (found := self._ranked(track, metric or track.metric))}
        if not panels:
            raise ValueError(f"no policy has a value of {metric or 'the metric of a track'}: there is nothing to plot")
        colours = dict(zip(self.policies, cycle(COLOURS), strict=False))
        across = min(len(panels), 3)
        down = -(-len(panels) // across)
        height = 0.9 + 0.22 * max(map(len, panels.values()))
        with drawing("plots"):
            from matplotlib import pyplot as plt  # notebooks show the figures of a program that imports it

            figure, grid = plt.subplots(
                down, across, squeeze=False, figsize=(4.2 * across, height * down), layout="constrained"
            )
            plt.close(figure)  # so that a notebook shows it once, as the value of the cell
            places = list(grid.flat)
            for axes in places[len(panels) :]:
                axes.set_axis_off()
            for axes, (track, found) in zip(places, panels.items(), strict=False):
                for place, (policy, summary) in enumerate(found.items()):
                    axes.plot([summary.low, summary.high], [place, place], color=colours[policy], linewidth=2)
                    axes.plot(summary.mean, place, "o", color=colours[policy])
                axes.set_yticks(range(len(found)), map(self._label, found))
                axes.invert_yaxis()
                axes.set_title(f"{track.name}, {self._count(track)}", loc="left")
                axes.set_xlabel(METRICS[metric or track.metric].label)
        return figure

    def _ranked(self, track: Track, metric: str) -> dict[str, Summary]:
        """The summaries of the policies that have a value on a track, the best first."""
        found = {policy: self.summary(track.name, policy, metric) for policy in self.policies_on(track.name)}
        sign = -1 if METRICS[metric].direction == "higher" else 1
        values = {policy: summary for policy, summary in found.items() if summary is not None}
        order = [policy for policy, summary in values.items() if summary.mean is not None]
        return {policy: values[policy] for policy in sorted(order, key=lambda name: sign * (values[name].mean or 0.0))}

    def _label(self, policy: str) -> str:
        """The name of a policy, marked where it is an oracle."""
        return f"{policy} (oracle)" if self.policies[policy].is_oracle else policy

    def _count(self, track: Track) -> str:
        episodes = self.episodes[track.name]
        return f"{episodes} episode{'s' * (episodes > 1)}"

    def __repr__(self) -> str:
        return (
            f"<Results of {self.suite.name}: {_counted(self.policies, 'policies')} on "
            f"{_counted(self.episodes, 'tracks')}, seed {self.seed}"
            + f", {len(self.failures)} failed" * bool(self.failures)
            + ">"
        )

    def __str__(self) -> str:
        """A line per track and policy, the best first: the metric that scores the track, with its 95 % interval.

        Policies that failed come last on a track, with the reason.
        """
        lines = [repr(self)]
        for track in self.tracks:
            lines += ["", f"{track.name}, {self._count(track)}: {METRICS[track.metric].heading}"]
            found = {self._label(name): summary for name, summary in self._ranked(track, track.metric).items()}
            width = max(map(len, found), default=0)
            lines += [f"  {policy:<{width}}  {_digits(summary)}" for policy, summary in found.items()]
            lines += [f"  {name} failed: {why}" for (on, name), why in self.failures.items() if on == track.name]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """A table for notebooks: policies × tracks, the metric that scores each track, with its 95 % interval."""
        ranked = [self._ranked(track, track.metric) for track in self.tracks]
        head = "".join(
            f"<th>{escape(track.name)}<br><small>{escape(METRICS[track.metric].heading)}, "
            f"{self._count(track)}</small></th>"
            for track in self.tracks
        )
        rows = "".join(
            f"<tr><th>{escape(self._label(policy))}</th>"
            + "".join(
                f"<td>{escape(_digits(found[policy]))}</td>" if policy in found else "<td>–</td>" for found in ranked
            )
            + "</tr>"
            for policy in dict.fromkeys(policy for found in ranked for policy in found)
        )
        return (
            f"<table><caption>{escape(repr(self))}; means with 95 % intervals</caption>"
            f"<thead><tr><th>policy</th>{head}</tr></thead><tbody>{rows}</tbody></table>"
        )


_NAMED = 4
"""Names that a short text spells out."""


def _counted(names: Collection[str], kind: str) -> str:
    """The names where they are few, else their number."""
    return ", ".join(names) if len(names) <= _NAMED else f"{len(names)} {kind}"


def _digits(summary: Summary) -> str:
    """A mean with its interval, where the two differ."""
    mean, low, high = map(number, (summary.mean, summary.low, summary.high))
    return mean if low == high else f"{mean} [{low}, {high}]"


def _cell(value: Any) -> Any:
    """A cell of a CSV file, after OWASP's "CSV Injection"; numbers stay as they are.

    Some spreadsheets end a cell at a semicolon or a tabulator.
    """
    return _FORMULA.sub(r"\1'\2", value) if isinstance(value, str) else value


def _reasons(reasons: Mapping[tuple[str, str], str]) -> list[dict[str, str]]:
    return [{"track": track, "policy": policy, "reason": reason} for (track, policy), reason in reasons.items()]


def statistics_of(samples: Samples) -> dict[str, tuple[FloatArray, Statistic]]:
    """The samples and the statistic of each metric of which there are samples, in the order of :data:`METRICS`."""
    return {
        metric.name: (samples[metric.source], metric.statistic)
        for metric in METRICS.values()
        if metric.source in samples
    }


def records(
    track: str, policy: str, statistics: Mapping[str, tuple[FloatArray, Statistic]], episodes: int
) -> list[Record]:
    """One record per metric."""
    return [
        {"track": track, "policy": policy, "metric": metric, **asdict(summary), "episodes": episodes}
        for metric, summary in summaries(statistics).items()
    ]


def read_results(path: Path) -> dict[str, Any]:
    """The content of a file that holds :meth:`Results.to_dict`.

    Raises:
        OSError: when it cannot be read.
        ValueError: when it is damaged, something else or of another format.
    """
    kind = "a file of results"
    data = read_json(path, kind)

    def require(*keys: str) -> None:
        if missing := sorted(set(keys) - data.keys()):
            raise ValueError(f"{path} is not {kind}: it has no {', '.join(missing)}")

    require("format", "suite", "jobs")
    if data["format"] != FORMAT:
        raise ValueError(
            f"{path} is of format {data['format']!r}, this library reads {FORMAT}: use the version of ptne_env that "
            "wrote it, or run the suite again"
        )
    content = {key: value for key, value in data.items() if key not in ("checksum", "timings")}
    if not is_hash_of(data.get("checksum"), content):
        raise ValueError(
            f"{path} was damaged or changed after it was written: run the suite again, which writes it anew from the "
            "stored jobs"
        )
    require("seed", "split", "episodes", "policies", "versions", "timings")
    require("records", "not_applicable", "failures", "leaderboard")
    return data
