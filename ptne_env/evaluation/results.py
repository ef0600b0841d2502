"""The results of a comparison or suite: samples per track and policy, and their means with intervals."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ptne_env._version import __version__
from ptne_env.evaluation.episodes import EpisodeSet, Split
from ptne_env.evaluation.metrics import METRICS, number
from ptne_env.evaluation.policy_spec import PolicySpec
from ptne_env.evaluation.provenance import content_hash, versions
from ptne_env.evaluation.statistics import STATISTICS, Summary, estimate
from ptne_env.evaluation.tracks import Track
from ptne_env.shared.arrays import FloatArray, data_frame
from ptne_env.shared.files import DamagedFileError, read_json
from ptne_env.shared.names import require_name, unknown_name
from ptne_env.shared.parts import foreign_targets
from ptne_env.shared.style import COLOURS, PRINT, drawing, printed_axes

FORMAT = 9
"""The version of ``results.json``; a file of another version is refused."""

Record: TypeAlias = dict[str, Any]
"""Keys: track, policy, metric, mean, low, high, episodes; the numbers are ``None`` as in a :class:`Summary`."""

COMPARISON = "comparison"
"""The name of all comparisons of scenarios."""

SHOWN = ("digits", "digits_on_the_way", "digits_cvar")
"""The metrics of every table: the score, that which breaks ties, and that which shows bad episodes."""

Samples: TypeAlias = dict[str, FloatArray]
"""Per metric, shape (training seeds, episodes), NaN where an episode has no value; a timing is repeated."""

Place: TypeAlias = tuple[str, str]
"""The names of a track and of a policy."""


def standing(digits: Summary | None, on_the_way: Summary | None) -> tuple[float, float]:
    """Return the key by which policies are ranked, the least first: digits to two decimals, then those on the way.

    So of several policies with all twelve digits, the one that was fast stands first. No value is the worst.
    """
    at_deadline, before = (
        -math.inf if summary is None or summary.mean is None else summary.mean for summary in (digits, on_the_way)
    )
    return -round(at_deadline, 2), -before


@dataclass(frozen=True, eq=False)
class Results:
    """The outcome of a comparison or of a suite.

    Attributes:
        name: the name of the suite; ``"comparison"`` for a comparison of scenarios.
        tracks: the tracks, in the order of tables.
        policies: the policies by name, in the order of tables.
        episode_sets: the episode set of each track.
        samples: the samples by (track, policy).
        not_applicable: why a policy cannot act on a track, by (track, policy).
        failures: the error of a policy on a track, by (track, policy).
    """

    name: str
    tracks: tuple[Track, ...]
    policies: dict[str, PolicySpec]
    episode_sets: dict[str, EpisodeSet]
    samples: dict[Place, Samples]
    not_applicable: dict[Place, str]
    failures: dict[Place, str]

    @property
    def episodes(self) -> dict[str, int]:
        """The number of episodes by name of the track."""
        return {track: episodes.count for track, episodes in self.episode_sets.items()}

    @property
    def counted_tracks(self) -> list[str]:
        """The names of the scored tracks, or of all tracks where none is scored."""
        return [track.name for track in self.tracks if track.scored] or [track.name for track in self.tracks]

    @property
    def seed(self) -> int:
        """The seed of the episode sets."""
        return next(iter(self.episode_sets.values())).seed

    @property
    def split(self) -> Split:
        """The split of the episode sets."""
        return next(iter(self.episode_sets.values())).split

    @property
    def is_comparison(self) -> bool:
        """Whether it is a comparison of scenarios, which has no reference policies and no scores."""
        return self.name == COMPARISON

    @cached_property
    def reasons(self) -> dict[Place, str]:
        """Why a policy has no values on a track, by (track, policy): ``"n/a: …"`` or ``"failed: …"``."""
        verdicts = {"n/a": self.not_applicable, "failed": self.failures}
        return {place: f"{verdict}: {reason}" for verdict, found in verdicts.items() for place, reason in found.items()}

    @cached_property
    def _exact(self) -> set[str]:
        """The tracks whose one episode is the same in every repetition, because nothing is random."""
        return {track.name for track in self.tracks if self.episodes[track.name] == 1 and not track.world.is_random}

    def values(self, track: str, policy: str, metric: str) -> FloatArray | None:
        """Return the numbers per training seed and episode whose mean is a metric; ``None`` where there are none.

        An episode in which nothing is random stands twice, so that its numbers are known to be constant. A timing
        stands once: all episodes are one measurement.

        Raises:
            ValueError: for an unknown metric.
        """
        declared = METRICS[require_name("metric", metric, METRICS)]
        samples = self.samples.get((track, policy), {}).get(declared.source)
        if samples is None:
            return None
        if declared.is_timing:
            return samples[:, :1]
        return np.repeat(STATISTICS[declared.statistic](samples), 2 if track in self._exact else 1, axis=1)

    @cached_property
    def _summaries(self) -> dict[tuple[str, str, str], Summary]:
        return {
            (*place, metric): estimate([values])
            for place in self.samples
            for metric in METRICS
            if (values := self.values(*place, metric)) is not None
        }

    @cached_property
    def records(self) -> tuple[Record, ...]:
        """One per track, policy and metric, with the mean (or another statistic) and its 95 % interval."""
        return tuple(self.record(*key) for key in self._summaries)

    def record(self, track: str, policy: str, metric: str) -> Record:
        """Return the record of one track, policy and metric; ``KeyError`` with the reason why there is none."""
        if (summary := self.summary(track, policy, metric)) is not None:
            names = {"track": track, "policy": policy, "metric": metric}
            return {**names, **asdict(summary), "episodes": self.episodes[track]}
        for what, name, known in (("track", track, self.episodes), ("policy", policy, self.policies)):
            if name not in known:
                raise KeyError(unknown_name(what, name, known))
        because = f": {reason}" if (reason := self.reasons.get((track, policy))) else ""
        raise KeyError(f"no record of {metric!r} for policy {policy!r} on track {track!r}{because}")

    def summary(self, track: str, policy: str, metric: str) -> Summary | None:
        """Return the mean and interval of a record; ``None`` where there is no such record."""
        return self._summaries.get((track, policy, metric))

    def difference(
        self, policy: str, other: str, tracks: str | Iterable[str] | None = None, metric: str = "digits"
    ) -> Summary:
        """Return the mean of a metric of a policy minus that of another one, in the same episodes.

        One of two policies leads if the interval of this difference is clear of 0. Two intervals of their own say less,
        because both policies find some episodes hard.

        Args:
            policy: the name of the policy.
            other: the name of the policy whose values are subtracted.
            tracks: the name of a track, or several; the :attr:`counted_tracks` if left out. The mean is over those on
                which both policies have values in the same episode.
            metric: the name of the metric.

        Raises:
            ValueError: for an unknown policy, track or metric.
        """
        for name in (policy, other):
            require_name("policy", name, self.policies)
        names = self.counted_tracks if tracks is None else [tracks] if isinstance(tracks, str) else list(tracks)
        for name in names:
            require_name("track", name, self.episodes)
        return self.mean_over_tracks(names, metric, policy, other)

    def mean_over_tracks(self, tracks: Iterable[str], metric: str, *policies: str) -> Summary:
        """Return the mean over tracks of a metric of one policy, or that of the first minus that of the second.

        Tracks without an episode in which all of these have values do not count. Scenarios of a comparison have the
        same seeds, so that an episode is easy or hard in all of them: it counts once, with its mean over them.
        """
        together: dict[Any, list[list[FloatArray]]] = {}
        for track in tracks:
            arrays = [values for policy in policies if (values := self.values(track, policy, metric)) is not None]
            if len(arrays) < len(policies) or not np.all([np.isfinite(a).any(axis=0) for a in arrays], axis=0).any():
                continue
            is_whole = all(np.isfinite(array).all() for array in arrays)
            together.setdefault((self.episode_sets[track], arrays[0].shape) if is_whole else track, []).append(arrays)
        share = len(together) / max(1, sum(map(len, together.values())))
        scores = [[share * np.sum(each, axis=0) for each in zip(*group, strict=True)] for group in together.values()]
        return estimate(*zip(*scores, strict=True)) if scores else Summary(None, None, None)

    # --- files ------------------------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Return all that is needed to read the results and to repeat them, as a JSON object.

        ``format`` is the version of the meaning, ``checksum`` the hash of all but itself and the timings.
        """
        libraries = {library for policy in self.policies.values() for library in policy.libraries}
        samples: dict[str, dict[str, dict[str, Any]]] = {"samples": {}, "timings": {}}
        for (track, policy), by_metric in self.samples.items():
            for metric, values in by_metric.items():
                kind = "timings" if METRICS[metric].is_timing else "samples"
                kept = values[:, :1] if METRICS[metric].is_timing else values
                samples[kind].setdefault(track, {}).setdefault(policy, {})[metric] = to_json_list(kept)
        content = {
            "format": FORMAT,
            "name": self.name,
            "tracks": [track.to_dict() for track in self.tracks],
            "episodes": {track: asdict(episodes) for track, episodes in self.episode_sets.items()},
            "policies": [policy.to_dict() for policy in self.policies.values()],
            "not_applicable": _reasons(self.not_applicable),
            "failures": _reasons(self.failures),
            "records": [record for record in self.records if not METRICS[record["metric"]].is_timing],
            "samples": samples["samples"],
            "versions": versions(sorted(libraries)),
        }
        return {**content, "checksum": content_hash(content), "timings": samples["timings"]}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Results:
        """Read what :meth:`to_dict` gives; tables are computed again from the samples. Parts in it are imported.

        Raises:
            ValueError: when the data are no results, or a policy or scenario was an object of another process.
        """
        try:
            episode_sets = {
                track: EpisodeSet(**{**drawn, "track": drawn["track"] and tuple(drawn["track"])})
                for track, drawn in data["episodes"].items()
            }
            samples: dict[Place, Samples] = {}
            for kind in ("samples", "timings"):
                for track, policies in data[kind].items():
                    repeats = episode_sets[track].count if kind == "timings" else 1
                    for policy, metrics in policies.items():
                        for metric, values in metrics.items():
                            if (metric in METRICS and METRICS[metric].is_timing) != (kind == "timings"):
                                raise ValueError(f"not results: {metric} of {policy} on {track} is among the {kind}")
                            array = np.repeat(np.array(values, dtype=np.float64), repeats, axis=1)
                            samples.setdefault((track, policy), {})[metric] = array
            return cls(
                data["name"],
                tuple(Track.from_dict(track) for track in data["tracks"]),
                {policy["name"]: PolicySpec.from_dict(policy) for policy in data["policies"]},
                episode_sets,
                samples,
                {(item["track"], item["policy"]): item["reason"] for item in data["not_applicable"]},
                {(item["track"], item["policy"]): item["reason"] for item in data["failures"]},
            )
        except (KeyError, TypeError, AttributeError, IndexError, OverflowError) as error:
            raise ValueError(f"not results: {type(error).__name__}: {error}") from error

    def to_json(self) -> str:
        """Return :meth:`to_dict` as a JSON text without NaN or Infinity."""
        return json.dumps(self.to_dict(), separators=(",", ":"), allow_nan=False, ensure_ascii=False)

    def to_csv(self) -> str:
        """Return the records as CSV, each with the version, the name of the suite, the seed and the split.

        A text that a spreadsheet would read as a formula is preceded by ``'``.
        """
        common = {"seed": self.seed, "split": self.split, "version": __version__, "suite": self.name}
        rows = [{key: _cell(value) for key, value in (record | common).items()} for record in self.records]
        buffer = io.StringIO()
        writer = csv.DictWriter(buffer, list(rows[0]) if rows else [], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return buffer.getvalue()

    def to_frame(self) -> Any:
        """Return the records as a ``pandas.DataFrame``; ``ImportError`` that names the extra if pandas is missing."""
        return data_frame(self.records)

    def plot(self, metric: str = "digits", axes: Any = None) -> Any:
        """Draw a metric with its 95 % interval, a row per track and a mark per policy.

        It is drawn into ``axes`` of matplotlib, or a new figure, one column wide and unknown to pyplot, and returned.

        Raises:
            ValueError: for an unknown metric.
            ImportError: when matplotlib is missing, naming the extra to install.
        """
        label = METRICS[require_name("metric", metric, METRICS)].label
        tracks, names = list(self.episodes), list(self.policies)
        with drawing("figures", PRINT):
            is_new, height = axes is None, 0.7 + (0.11 * len(names) + 0.1) * len(tracks) + 0.1 * len(names)
            axes = printed_axes(1, height) if is_new else axes
            for place, name in enumerate(names):
                found = [self.summary(track, name, metric) or Summary(None, None, None) for track in tracks]
                ends = np.array([[each.low, each.mean, each.high] for each in found], dtype=np.float64).T
                rows = np.arange(len(tracks)) + 0.7 * ((place + 0.5) / len(names) - 0.5)
                style: dict[str, Any] = {"color": COLOURS[place % len(COLOURS)], "fmt": "osD^v"[place % 5]}
                spread = np.nan_to_num(np.abs(ends[[0, 2]] - ends[1]))
                axes.errorbar(ends[1], rows, xerr=spread, label=self.policies[name].label, markersize=3, **style)
            axes.set(xlabel=label, ylim=(len(tracks) - 0.5, -0.5), yticks=range(len(tracks)), yticklabels=tracks)
            legend = {"loc": "outside upper center", "ncols": 2} if is_new else {}
            (axes.figure if is_new else axes).legend(**legend)
            return axes.figure

    # --- texts ------------------------------------------------------------------------------------------------------

    def standing(self, track: str, policy: str) -> tuple[float, float]:
        """Return the :func:`standing` of a policy on a track."""
        return standing(self.summary(track, policy, "digits"), self.summary(track, policy, "digits_on_the_way"))

    def ranked(self, track: str) -> dict[str, Summary]:
        """Return the digits on a track of the policies that have a value there, the best first."""
        ordered = sorted(self.policies, key=lambda name: self.standing(track, name))
        summaries = {name: self.summary(track, name, "digits") for name in ordered}
        return {name: digits for name, digits in summaries.items() if digits is not None and digits.mean is not None}

    def __repr__(self) -> str:
        policies, tracks = (textwrap.shorten(", ".join(names), 60) for names in (self.policies, self.episodes))
        failed = f", {len(self.failures)} failed" * bool(self.failures)
        return f"<Results of {self.name}: {policies} on {tracks}, seed {self.seed}{failed}>"

    def __str__(self) -> str:
        """Return a line per track and policy, the best first: digits with their 95 % interval, and those beside them.

        Policies without values come last on a track, with the reason.
        """
        lines = [repr(self)]
        for track in self.tracks:
            count = self.episodes[track.name]
            lines += ["", f"{track.name}, {count} episode{'s' * (count > 1)}: digits, on the way, worst tenth"]
            digits = self.ranked(track.name)
            labels = {name: self.policies[name].label for name in digits}
            width = max(map(len, labels.values()), default=0)
            for name, label in labels.items():
                cells = [_with_interval(self.summary(track.name, name, metric)) for metric in SHOWN]
                lines.append(f"  {label:<{width}}  {', '.join(cells)}")
            lines += [f"  {name} {why}" for (place, name), why in self.reasons.items() if place == track.name]
        return "\n".join(lines)


def read_results(path: str | Path, *, trust: bool = False) -> Results:
    """Read the results of a file ``results.json``, or of that in a folder.

    Args:
        path: the path of the file or folder.
        trust: whether code from outside the library that the results name may be imported.

    Raises:
        OSError: when the file cannot be read.
        ValueError: when it is damaged, too large, something else or of another format, when a policy or scenario was an
            object of another process, or when it names code from outside the library and ``trust`` is not set.
    """
    path = Path(path)
    path = path / "results.json" if path.is_dir() else path
    data = read_json(path, "a file of results")
    if data.get("format") != FORMAT:
        raise ValueError(f"{path} is no file of results of format {FORMAT}, which this library reads: run it again")
    content = {key: value for key, value in data.items() if key not in ("checksum", "timings")}
    if data.get("checksum") != content_hash(content):
        raise DamagedFileError(f"{path} was damaged or changed after it was written: run it again")
    if not trust and (foreign := foreign_targets(data)):
        raise ValueError(f"{path} names code from outside the library, which needs trust=True: {', '.join(foreign)}")
    return Results.from_dict(data)


def _with_interval(summary: Summary | None) -> str:
    """Format a mean of digits with its interval, where the two differ."""
    if summary is None or summary.mean is None:
        return number(None)
    mean = f"{summary.mean:z.2f}"
    if summary.low is None or summary.high is None:
        return f"{mean} (no interval)"
    low, high = f"{summary.low:z.2f}", f"{summary.high:z.2f}"
    return mean if low == high else f"{mean} [{low}, {high}]"


def _cell(value: Any) -> Any:
    """Return a cell of a CSV file that no spreadsheet runs, after OWASP's "CSV Injection"; numbers stay as they are.

    A formula begins with =, +, -, @, a tabulator or a carriage return. Some spreadsheets end a cell at a semicolon or a
    tabulator.
    """
    return re.sub(r"(^|[,;\t]\s*)([=+\-@\t\r])", r"\1'\2", value) if isinstance(value, str) else value


def _reasons(reasons: Mapping[Place, str]) -> list[dict[str, str]]:
    return [{"track": track, "policy": policy, "reason": reason} for (track, policy), reason in reasons.items()]


def to_json_list(values: FloatArray) -> list[Any]:
    """Return numbers as a list of the same depth, in which what is not finite is ``None``."""
    numbers = values.astype(object)
    numbers[~np.isfinite(values)] = None
    return list(numbers.tolist())
