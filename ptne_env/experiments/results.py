"""Results of a run: samples per track and policy, records with intervals, and the file ``results.json``."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

from ptne_env._version import __version__
from ptne_env.arrays import FloatArray
from ptne_env.experiments.episodes import Split
from ptne_env.experiments.jobs import Job
from ptne_env.experiments.leaderboard import NEEDED, Leaderboard, leaderboard
from ptne_env.experiments.metrics import METRICS, Statistic, measured
from ptne_env.experiments.policy_specs import KNOWLEDGE, PolicySpec
from ptne_env.experiments.provenance import content_hash, is_hash_of, versions
from ptne_env.experiments.statistics import Summary, summaries
from ptne_env.experiments.suite import Suite, Track
from ptne_env.files import read_json

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
        target: by which :func:`~ptne_env.experiments.suite.get_suite` finds the suite; ``None`` for an object.
        policies: by name, in the order of tables.
        tuned: per track with learned policies, the tuned law of each group of laws (keys "paper" and "all").
        seed: of the episode sets.
        split: of the episode sets.
        episodes: number of episodes by name of each track that was run, in the order of the suite.
        jobs: those of the policies and of the tuned laws.
        trials: per track with learned policies, the jobs by whose validation digits the tuned laws were chosen.
        samples: by (track, policy), of policies and tuned laws.
        not_applicable: by (track, policy), why the policy cannot act or was not run there.
        failures: by (track, policy), the error of the policy there.
        records: one per track, policy and metric, with the mean (or CVaR) and its 95 % interval.
    """

    suite: Suite
    target: str | None
    policies: dict[str, PolicySpec]
    tuned: dict[str, dict[str, PolicySpec]]
    seed: int
    split: Split
    episodes: dict[str, int]
    jobs: tuple[Job, ...]
    trials: dict[str, tuple[Job, ...]]
    samples: dict[tuple[str, str], Samples]
    not_applicable: dict[tuple[str, str], str]
    failures: dict[tuple[str, str], str]
    records: tuple[Record, ...]

    @property
    def tracks(self) -> tuple[Track, ...]:
        """The tracks that were run, in the order of the suite."""
        return tuple(track for track in self.suite.tracks if track.name in self.episodes)

    @property
    def every_policy(self) -> dict[str, PolicySpec]:
        """The policies and the tuned laws by name."""
        return self.policies | {law.name: law for laws in self.tuned.values() for law in laws.values()}

    def policies_on(self, track: str) -> dict[str, PolicySpec]:
        """The policies and tuned laws that were run on a track, by name, in the order of tables."""
        chosen = self.policies | {law.name: law for law in self.tuned.get(track, {}).values()}
        return {name: policy for name, policy in chosen.items() if (track, name) in self.samples}

    def of_metrics(self, names: Collection[str]) -> Results:
        """The same results with the samples and records of some metrics alone, and those that follow from them.

        Args:
            names: of metrics that are measured. Timings, and comparisons with tuned laws, are always kept.

        Raises:
            ValueError: for a name that is none, or when one is left out that leaderboards need.
        """
        known = measured()
        if unknown := sorted(set(names) - known):
            raise ValueError(f"no measured metrics: {', '.join(unknown)}; choose from {', '.join(sorted(known))}")
        if needed := sorted(NEEDED - set(names)):
            raise ValueError(f"leaderboards need {', '.join(needed)}: keep these metrics too")
        left_out = known - set(names)
        return replace(
            self,
            samples={
                place: {name: values for name, values in found.items() if name not in left_out}
                for place, found in self.samples.items()
            },
            records=tuple(record for record in self.records if METRICS[record["metric"]].source not in left_out),
        )

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
            "tuned_laws": {
                track: {group: law.to_dict() for group, law in laws.items()} for track, laws in self.tuned.items()
            },
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
            "trials": {track: [job.key for job in jobs] for track, jobs in self.trials.items()},
            "versions": versions(),
        }
        timings = [record for record, is_timing in zip(self.records, timed, strict=True) if is_timing]
        return {**content, "checksum": content_hash(content), "timings": timings}

    def to_json(self) -> str:
        """:meth:`to_dict` as a JSON text without NaN or Infinity."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False, ensure_ascii=False)

    def to_csv(self) -> str:
        """The records as CSV, each with the policy's knowledge, the version, the suite's content hash, seed and split.

        A text that a spreadsheet would read as a formula is preceded by ``'``.
        """
        buffer = io.StringIO()
        fields = ["track", "policy", "metric", "mean", "low", "high", "episodes"]
        common = {
            "seed": self.seed,
            "split": self.split,
            "version": __version__,
            "suite": self.suite.name,
            "content_hash": self.suite.content_hash,
        }
        known = {name: spec.knowledge for name, spec in self.every_policy.items()}
        writer = csv.DictWriter(buffer, [*fields, *KNOWLEDGE, *common], lineterminator="\n")
        writer.writeheader()
        for record in self.records:
            row = {**record, **known[record["policy"]], **common}
            writer.writerow({key: _cell(value) for key, value in row.items()})
        return buffer.getvalue()


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
    require("seed", "split", "episodes", "policies", "tuned_laws", "trials", "versions", "timings")
    require("records", "not_applicable", "failures", "leaderboard")
    return data
