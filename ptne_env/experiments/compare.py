"""Comparisons: any set of policies on any set of scenarios, everyone from the same seeded starts."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ptne_env._version import __version__
from ptne_env.arrays import FloatArray, require_count
from ptne_env.catalogue import get_scenario
from ptne_env.dynamics import State
from ptne_env.encoder import make_encoder
from ptne_env.experiments import tuning
from ptne_env.experiments.episodes import Split, draw_start
from ptne_env.experiments.metrics import measure
from ptne_env.experiments.policy_specs import PolicySpec, get_policy_spec
from ptne_env.experiments.rollout import rollout
from ptne_env.experiments.statistics import summarise, worst_decile
from ptne_env.experiments.workers import Workers
from ptne_env.observation import Interface
from ptne_env.scenario import Scenario
from ptne_env.world import World

PAPER_START = " (paper start)"
"""Suffix of the row that runs a catalogue scenario from the paper's own start."""

Record = dict[str, Any]

Item = TypeVar("Item")


@dataclass(frozen=True)
class Cell:
    """One policy on one scenario.

    Attributes:
        scenario: the label of the scenario.
        policy: the name of the entry.
        samples: per metric, one value per episode; NaN where it does not exist.
    """

    scenario: str
    policy: str
    samples: dict[str, FloatArray]

    def records(self) -> list[Record]:
        """One record per metric: scenario, policy, metric, mean, low, high, episodes; ``None`` where nothing exists."""
        table = np.array(list(self.samples.values()))
        summaries = dict(zip(self.samples, summarise(table), strict=True))
        summaries["worst_decile_digits"] = worst_decile(self.samples["digits"])
        return [
            {
                "scenario": self.scenario,
                "policy": self.policy,
                "metric": metric,
                "mean": summary.mean,
                "low": summary.low,
                "high": summary.high,
                "episodes": table.shape[1],
            }
            for metric, summary in summaries.items()
        ]


@dataclass(frozen=True)
class Results:
    """The outcome of a comparison.

    Attributes:
        seed: of the starts.
        scenarios: by label, in the order of the comparison.
        entries: by name, in the order of the comparison.
        tuned: the tuned laws that learned policies were measured against, by scenario and group.
        cells: one per scenario and policy.
        records: one per scenario, policy and metric, with mean and 95 % interval over episodes.
    """

    seed: int
    scenarios: dict[str, Scenario]
    entries: dict[str, PolicySpec]
    tuned: dict[str, dict[str, PolicySpec]]
    cells: tuple[Cell, ...]
    records: tuple[Record, ...]

    @property
    def episodes(self) -> list[Record]:
        """One row per scenario, policy, episode and metric; ``value`` is ``None`` where it does not exist."""
        return [
            {
                "scenario": cell.scenario,
                "policy": cell.policy,
                "episode": episode,
                "metric": metric,
                "value": float(value) if np.isfinite(value) else None,
            }
            for cell in self.cells
            for metric, values in cell.samples.items()
            for episode, value in enumerate(values)
        ]

    def record(self, scenario: str, policy: str, metric: str) -> Record:
        """The record of one scenario, policy and metric.

        Raises:
            KeyError: when the comparison has no such record.
        """
        for record in self.records:
            if (record["scenario"], record["policy"], record["metric"]) == (scenario, policy, metric):
                return record
        raise KeyError(f"no record of {metric!r} for policy {policy!r} on scenario {scenario!r}")

    def to_dict(self) -> dict[str, Any]:
        """Version, seed, scenarios and policies with their parameters, and the records, as a JSON object."""
        return {
            "version": __version__,
            "seed": self.seed,
            "scenarios": {label: scenario.to_dict() for label, scenario in self.scenarios.items()},
            "policies": {name: entry.to_dict() for name, entry in self.entries.items()},
            "tuned_laws": {
                label: {group: entry.to_dict() for group, entry in laws.items()} for label, laws in self.tuned.items()
            },
            "records": list(self.records),
        }

    def to_json(self) -> str:
        """:meth:`to_dict` as a JSON text without NaN or Infinity."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False, ensure_ascii=False)

    def to_csv(self) -> str:
        """The records as CSV, each with version, seed and the parameters of its scenario and policy as JSON texts."""
        buffer = io.StringIO()
        fields = ["scenario", "policy", "metric", "mean", "low", "high", "episodes"]
        fields += ["version", "seed", "scenario_parameters", "policy_parameters"]
        writer = csv.DictWriter(buffer, fields, lineterminator="\n")
        writer.writeheader()
        scenarios = {label: json.dumps(scenario.to_dict()) for label, scenario in self.scenarios.items()}
        policies = {name: json.dumps(entry.to_dict()) for name, entry in self.entries.items()}
        tuned = {
            (label, entry.name): json.dumps(entry.to_dict())
            for label, laws in self.tuned.items()
            for entry in laws.values()
        }
        for record in self.records:
            scenario, policy = record["scenario"], record["policy"]
            writer.writerow(
                {
                    **record,
                    "version": __version__,
                    "seed": self.seed,
                    "scenario_parameters": scenarios[scenario],
                    "policy_parameters": policies[policy] if policy in policies else tuned[scenario, policy],
                }
            )
        return buffer.getvalue()


def evaluate(
    entries: Iterable[str | PolicySpec],
    scenarios: Iterable[str | Scenario],
    *,
    episodes: int = 100,
    seed: int = 0,
    hold_steps: int = 0,
    split: Split = "test",
    against_laws: bool = True,
    workers: Workers = Workers(),  # noqa: B008 - immutable
    progress: Callable[[str, int], None] | None = None,
) -> Results:
    """Run every policy on every scenario from the same seeded starts.

    A scenario given by name is run from ``episodes`` random starts under its own name, and, unless it draws games,
    once more from the paper's start, labelled ``"NAME (paper start)"``. A :class:`~ptne_env.scenario.Scenario` is run
    as it is: from ``episodes`` starts when something in it is random, else once.

    Where a learned policy meets random episodes it is also measured, paired by episode, against the best of the paper's
    laws and the best of all laws, both chosen by mean digits on the validation bank
    (:mod:`ptne_env.experiments.tuning`).

    Args:
        entries: names (:data:`~ptne_env.experiments.policy_specs.ENTRIES`, and the shipped learned policies), ``.onnx``
            files, ``"module:object"`` strings or entries.
        scenarios: names of the catalogue or scenarios.
        episodes: number of random starts.
        seed: of the starts; the draws never depend on a policy.
        hold_steps: steps after the deadline for the scenarios given by name.
        split: whose draws are met: ``"test"``, ``"validation"`` or ``"train"``, which share none.
        against_laws: whether learned policies are measured against tuned laws; the tuning takes longer than the rest.
        workers: who runs them. Only the measured times of policies depend on it.
        progress: called with ``"scenario: policy"`` and the number of all rollouts when one is done.

    Raises:
        ValueError: for unknown or repeated names, or a policy that cannot act in a scenario.
        ImportError, ConnectionError, ChildProcessError: as :meth:`~ptne_env.experiments.workers.Workers.run`.
    """
    require_count("episodes", episodes, 1)
    require_count("seed", seed, 0)
    chosen = _unique([(entry.name, entry) for entry in map(get_policy_spec, entries)], "policy")
    scenarios = list(scenarios)
    names = [(scenario if isinstance(scenario, str) else scenario.name, scenario) for scenario in scenarios]
    _unique(names, "scenario")
    cases = dict(_cases(scenarios, hold_steps))
    entrants = {
        label: [entry for entry in chosen.values() if entry.enters(scenario.name)] for label, scenario in cases.items()
    }
    banks = {
        label: _Bank(scenario, episodes if World(scenario).is_random else 1, seed, split)
        for label, scenario in cases.items()
    }
    tuned_labels = [
        label
        for label, scenario in cases.items()
        if against_laws and World(scenario).is_random and any(entry.is_learned for entry in entrants[label])
    ]
    runs = [(label, entry, banks[label]) for label in cases for entry in entrants[label]]
    laws = [PolicySpec("tuning laws", part, Interface()) for part in tuning.candidates("all")]
    validation = {label: _Bank(cases[label], tuning.VALIDATION_EPISODES, 0, "validation") for label in tuned_labels}
    trials = [(label, law, validation[label]) for label in tuned_labels for law in laws]
    total = len(runs) + len(trials) + len(tuning.GROUPS) * len(tuned_labels)

    def tell(_: int, cell: Cell) -> None:
        if progress is not None:
            progress(f"{cell.scenario}: {cell.policy}", total)

    found = workers.gather(_run, [*runs, *trials], tell)
    cells, tried = found[: len(runs)], found[len(runs) :]
    tuned = {
        label: tuning.best([cell.samples["digits"].mean() for cell in tried if cell.scenario == label])
        for label in tuned_labels
    }
    against = [(label, entry, banks[label]) for label in tuned_labels for entry in tuned[label].values()]
    opposing = workers.gather(_run, against, tell)
    for label in tuned_labels:
        best = {
            group: next(cell for cell in opposing if (cell.scenario, cell.policy) == (label, entry.name))
            for group, entry in tuned[label].items()
        }
        for cell in cells:
            if cell.scenario == label and chosen[cell.policy].is_learned:
                cell.samples.update(_paired(cell, best))
    ordered = tuple(cell for label in cases for cell in (*cells, *opposing) if cell.scenario == label)
    tables = workers.gather(Cell.records, [(cell,) for cell in ordered])
    return Results(seed, cases, chosen, tuned, ordered, tuple(record for table in tables for record in table))


class _Bank(NamedTuple):
    """Episodes that are met: the arguments of :func:`draw_start`."""

    scenario: Scenario
    episodes: int
    seed: int
    split: Split


@lru_cache(maxsize=2)  # policies that meet the same episodes follow each other
def _drawn(bank: _Bank) -> tuple[World, State]:
    world = World(bank.scenario)
    return world, draw_start(world, bank.episodes, bank.seed, bank.split)


def _run(label: str, entry: PolicySpec, bank: _Bank) -> Cell:
    world, start = _drawn(bank)
    encoder = make_encoder(world, entry.interface)
    return Cell(label, entry.name, measure(rollout(entry.build(encoder.layout), encoder, start)))


def _paired(cell: Cell, best: dict[str, Cell]) -> dict[str, FloatArray]:
    """How a learned policy stands against the tuned law of each group, episode by episode."""
    samples = {}
    for group, opponent in best.items():
        difference = cell.samples["digits"] - opponent.samples["digits"]
        samples[f"digits_over_{group}_laws"] = difference
        samples[f"probability_of_beating_{group}_laws"] = (np.sign(difference) + 1) / 2
    return samples


def _cases(scenarios: Iterable[str | Scenario], hold_steps: int) -> Iterator[tuple[str, Scenario]]:
    for scenario in scenarios:
        if isinstance(scenario, Scenario):
            yield scenario.name, scenario
            continue
        named = get_scenario(scenario, hold_steps=hold_steps)
        is_random = World(named).is_random
        yield scenario, named if is_random else named.replace(start="random")
        if not is_random:
            yield scenario + PAPER_START, named


def _unique(pairs: Sequence[tuple[str, Item]], kind: str) -> dict[str, Item]:
    result = dict(pairs)
    if not result:
        raise ValueError(f"a comparison needs at least one {kind}")
    if len(result) < len(pairs):
        raise ValueError(
            f"a comparison needs different names, got a {kind} twice in {', '.join(name for name, _ in pairs)}"
        )
    return result
