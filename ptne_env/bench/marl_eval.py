"""Results in the JSON format of marl-eval (Gorsane et al., NeurIPS 2022), https://github.com/instadeepai/marl-eval."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from ptne_env.bench.leaderboard import scores
from ptne_env.bench.suite import ZERO
from ptne_env.evaluation.results import Results
from ptne_env.shared.arrays import FloatArray

_DECIMALS = 6
"""Decimals of the numbers in the file, which would otherwise be twice as long."""


def marl_eval_json(results: Results) -> str:
    """Results as a JSON text of marl-eval: environment → task → algorithm → run → step or absolute metrics → metric.

    The environment is the suite, a task a track, an algorithm a policy and a run a training seed. Metrics are
    ``digits`` (the metric of the track) and, in a suite, ``score``. ``step_1`` holds the mean of a run,
    ``absolute_metrics`` every episode. ``step_count`` is 0, because policies are evaluated once, after training.

    marl-eval needs the same algorithms on all tasks and the same number of runs of all algorithms. Therefore a policy
    that cannot act on a track, or failed there, has the numbers of zero input, as in the scores; in a comparison, which
    has no zero input, the policy is left out. A policy with fewer training seeds repeats them: a law is the same in
    every run. Commas in names become semicolons.

    Args:
        results: of a comparison or of another suite.
    """
    runs = max(len(spec.training_seeds) for spec in results.policies.values())
    tasks: dict[str, Any] = {}
    for track in results.tracks:
        algorithms = tasks.setdefault(track.name, {})
        for name in results.policies:
            if results.is_comparison and not all((other.name, name) in results.samples for other in results.tracks):
                continue
            acting = name if (track.name, name) in results.samples else ZERO
            digits = results.samples[track.name, acting][track.metric]
            metrics = {"digits": digits}
            if not results.is_comparison:
                metrics["score"] = scores(digits, results.samples[track.name, ZERO][track.metric])
            algorithms[name.replace(",", ";")] = {
                f"run_{run + 1}": _run({metric: values[run % len(values)] for metric, values in metrics.items()})
                for run in range(runs)
            }
    return json.dumps({results.name: tasks}, allow_nan=False, ensure_ascii=False, separators=(",", ":"))


def _run(metrics: dict[str, FloatArray]) -> dict[str, Any]:
    means = {metric: [round(float(np.mean(values)), _DECIMALS)] for metric, values in metrics.items()}
    episodes = {metric: np.round(values, _DECIMALS).tolist() for metric, values in metrics.items()}
    return {"step_1": {"step_count": 0, **means}, "absolute_metrics": episodes}
