"""The results of a comparison or suite: samples per track and policy, and their means with intervals."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import textwrap
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ptne_env._version import __version__
from ptne_env.evaluation.episodes import EpisodeSet, Split
from ptne_env.evaluation.metrics import METRICS, number
from ptne_env.evaluation.policy_spec import PolicySpec
from ptne_env.evaluation.provenance import arithmetic, content_hash, versions
from ptne_env.evaluation.statistics import STATISTICS, Summary, estimate
from ptne_env.evaluation.tracks import Track
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.files import DamagedFileError, read_json

FORMAT = 7
"""The version of ``results.json``; a file of another version is refused."""

LARGEST_FILE = 32 * 2**20
"""Size in bytes above which a file is refused as a file of results."""

_FORMULA = re.compile(r"(^|[,;\t]\s*)([=+\-@\t\r])")
"""What a spreadsheet takes for the beginning of a formula, at the beginning of a text or of a part of it."""

Record: TypeAlias = dict[str, Any]
"""Keys: track, policy, metric, mean, low, high, episodes; the numbers are ``None`` where no episode has a value."""

Samples: TypeAlias = dict[str, FloatArray]
"""Per metric, shape (training seeds, episodes), NaN where an episode has no value; a timing is repeated."""

Place: TypeAlias = tuple[str, str]
"""The names of a track and of a policy."""


def standing(digits: Summary | None, mean_regret: Summary | None) -> tuple[float, float]:
    """Return the key by which policies are ranked, the least first: digits to two decimals, then the mean regret.

    So of several policies with all twelve digits, the one that was fast stands first. No value is the worst.
    """
    reached = -math.inf if digits is None or digits.mean is None else round(digits.mean, 2)
    return -reached, math.inf if mean_regret is None or mean_regret.mean is None else mean_regret.mean


@dataclass(frozen=True, eq=False)
class Results:
    """The outcome of a comparison or of a suite.

    Attributes:
        name: the name of the suite; ``"comparison"`` for a comparison of scenarios.
        target: the string by which the suite is found again; ``None`` for a comparison and for a suite that was an
            object.
        tracks: the tracks, in the order of tables.
        policies: the policies by name, in the order of tables.
        episode_sets: the episode set of each track.
        samples: the samples by (track, policy).
        not_applicable: why a policy cannot act on a track, by (track, policy).
        failures: the error of a policy on a track, by (track, policy).
    """

    name: str
    target: str | None
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
        return all(episodes.track is None for episodes in self.episode_sets.values())

    @cached_property
    def records(self) -> tuple[Record, ...]:
        """One per track, policy and metric, with the mean (or CVaR) and its 95 % interval."""
        return tuple(
            {"track": track, "policy": policy, "metric": metric.name, **asdict(summary), "episodes": count}
            for (track, policy), samples in self.samples.items()
            for count in [self.episodes[track]]
            for metric in METRICS.values()
            if metric.source in samples
            for summary in [estimate([STATISTICS[metric.statistic](samples[metric.source])])]
        )

    @cached_property
    def _records(self) -> dict[tuple[str, str, str], Record]:
        return {(record["track"], record["policy"], record["metric"]): record for record in self.records}

    def record(self, track: str, policy: str, metric: str) -> Record:
        """Return the record of one track, policy and metric.

        Raises:
            KeyError: when there is no such record; the message says why the policy cannot act on the track or failed.
        """
        try:
            return self._records[track, policy, metric]
        except KeyError:
            reason = (self.not_applicable | self.failures).get((track, policy))
            because = "" if reason is None else f": {reason}"
            raise KeyError(f"no record of {metric!r} for policy {policy!r} on track {track!r}{because}") from None

    def summary(self, track: str, policy: str, metric: str) -> Summary | None:
        """Return the mean and interval of a record; ``None`` where there is no such record."""
        record = self._records.get((track, policy, metric))
        return None if record is None else Summary(record["mean"], record["low"], record["high"])

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
            "suite": self.target,
            "tracks": [track.to_dict() for track in self.tracks],
            "episodes": {track: asdict(episodes) for track, episodes in self.episode_sets.items()},
            "policies": [policy.to_dict() for policy in self.policies.values()],
            "not_applicable": _reasons(self.not_applicable),
            "failures": _reasons(self.failures),
            "records": [record for record in self.records if not METRICS[record["metric"]].is_timing],
            "samples": samples["samples"],
            "versions": versions(sorted(libraries)),
            "arithmetic": arithmetic(),
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
                            array = np.repeat(np.array(values, dtype=np.float64), repeats, axis=1)
                            samples.setdefault((track, policy), {})[metric] = array
            return cls(
                data["name"],
                data["suite"],
                tuple(Track.from_dict(track) for track in data["tracks"]),
                {policy["name"]: PolicySpec.from_dict(policy) for policy in data["policies"]},
                episode_sets,
                samples,
                {(item["track"], item["policy"]): item["reason"] for item in data["not_applicable"]},
                {(item["track"], item["policy"]): item["reason"] for item in data["failures"]},
            )
        except (KeyError, TypeError, AttributeError, IndexError) as error:
            raise ValueError(f"not results: {type(error).__name__}: {error}") from error

    def to_json(self) -> str:
        """Return :meth:`to_dict` as a JSON text without NaN or Infinity."""
        return json.dumps(self.to_dict(), separators=(",", ":"), allow_nan=False, ensure_ascii=False)

    def to_csv(self) -> str:
        """Return the records as CSV, each with the version, the name of the suite, the seed and the split.

        A text that a spreadsheet would read as a formula is preceded by ``'``.
        """
        buffer = io.StringIO()
        writer = csv.DictWriter(buffer, list(next(iter(self._rows()), ())), lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: _cell(value) for key, value in row.items()} for row in self._rows())
        return buffer.getvalue()

    def _rows(self) -> list[Record]:
        common = {"seed": self.seed, "split": self.split, "version": __version__, "suite": self.name}
        return [record | common for record in self.records]

    # --- texts ------------------------------------------------------------------------------------------------------

    def standing(self, track: str, policy: str) -> tuple[float, float]:
        """Return the :func:`standing` of a policy on a track."""
        return standing(self.summary(track, policy, "digits"), self.summary(track, policy, "mean_regret"))

    def ranked(self, track: str) -> dict[str, Summary]:
        """Return the digits on a track of the policies that have a value there, the best first."""
        ordered = sorted(self.policies, key=lambda name: self.standing(track, name))
        summaries = {name: self.summary(track, name, "digits") for name in ordered}
        return {name: digits for name, digits in summaries.items() if digits is not None and digits.mean is not None}

    def _label(self, policy: str) -> str:
        return f"{policy} (oracle)" if self.policies[policy].is_oracle else policy

    def __repr__(self) -> str:
        policies, tracks = (textwrap.shorten(", ".join(names), 60) for names in (self.policies, self.episodes))
        failed = f", {len(self.failures)} failed" * bool(self.failures)
        return f"<Results of {self.name}: {policies} on {tracks}, seed {self.seed}{failed}>"

    def __str__(self) -> str:
        """Return a line per track and policy, the best first: digits with their 95 % interval, and the mean regret.

        Policies that failed come last on a track, with the reason.
        """
        lines = [repr(self)]
        for track in self.tracks:
            count = self.episodes[track.name]
            lines += ["", f"{track.name}, {count} episode{'s' * (count > 1)}: digits, mean regret"]
            cells = {
                self._label(name): (_with_interval(digits), self.summary(track.name, name, "mean_regret"))
                for name, digits in self.ranked(track.name).items()
            }
            width = max(map(len, cells), default=0)
            lines += [
                f"  {policy:<{width}}  {digits}, {number(regret.mean if regret else None)}"
                for policy, (digits, regret) in cells.items()
            ]
            lines += [f"  {name} failed: {why}" for (on, name), why in self.failures.items() if on == track.name]
        return "\n".join(lines)


def read_results(path: Path) -> dict[str, Any]:
    """The content of a file that holds :meth:`Results.to_dict`; nothing is imported.

    Args:
        path: of the file, or of its folder.

    Raises:
        OSError: when it cannot be read.
        ValueError: when it is damaged, too large, something else or of another format.
    """
    path = path / "results.json" if path.is_dir() else path
    if path.is_file() and path.stat().st_size > LARGEST_FILE:
        raise ValueError(f"{path} is larger than {LARGEST_FILE // 2**20} MiB: it is no file of results")
    data = read_json(path, "a file of results")
    if data.get("format") != FORMAT:
        raise ValueError(f"{path} is no file of results of format {FORMAT}, which this library reads: run it again")
    content = {key: value for key, value in data.items() if key not in ("checksum", "timings")}
    if data.get("checksum") != content_hash(content):
        raise DamagedFileError(f"{path} was damaged or changed after it was written: run it again")
    return data


def _with_interval(summary: Summary) -> str:
    """Format a mean with its interval, where the two differ."""
    mean, low, high = map(number, (summary.mean, summary.low, summary.high))
    return mean if low == high else f"{mean} [{low}, {high}]"


def _cell(value: Any) -> Any:
    """Return a cell of a CSV file that no spreadsheet runs, after OWASP's "CSV Injection"; numbers stay as they are.

    Some spreadsheets end a cell at a semicolon or a tabulator.
    """
    return _FORMULA.sub(r"\1'\2", value) if isinstance(value, str) else value


def _reasons(reasons: Mapping[Place, str]) -> list[dict[str, str]]:
    return [{"track": track, "policy": policy, "reason": reason} for (track, policy), reason in reasons.items()]


def to_json_list(values: FloatArray) -> list[Any]:
    """Return numbers as a list of the same depth, in which what is not finite is ``None``."""
    numbers = values.astype(object)
    numbers[~np.isfinite(values)] = None
    return list(numbers.tolist())
