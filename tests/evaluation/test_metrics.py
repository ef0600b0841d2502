"""Metrics: their ranges."""

import numpy as np
import pytest
from small_suite import BASE

from ptne_env import evaluate
from ptne_env.evaluation import METRICS


def test_every_metric_of_a_run_lies_in_its_range():
    results = evaluate(["static", "random"], BASE.replace(hold_steps=5), episodes=3)
    for samples in results.samples.values():
        assert {name for name in METRICS if METRICS[name].value is not None} == samples.keys()
        assert all(METRICS[name].admits(values) for name, values in samples.items())


@pytest.mark.parametrize(
    ("metric", "good", "bad"),
    [
        ("digits", 12.0, 12.1),
        ("settling_time", 0.0, -1.0),
        ("settled_share", 1.0, 1.5),
    ],
)
def test_metrics_refuse_values_outside_their_range(metric, good, bad):
    assert METRICS[metric].admits(np.array([good, np.nan]))
    assert not METRICS[metric].admits(np.array([good, bad]))
