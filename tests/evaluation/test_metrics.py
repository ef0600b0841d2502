"""Metrics, and those that a user declares wrongly."""

import numpy as np
import pytest
from small_suite import BASE

from ptne_env import evaluate
from ptne_env.evaluation import METRICS, Metric, register
from ptne_env.evaluation.metrics import MOST_DIGITS
from ptne_env.evaluation.statistics import STATISTICS


def test_a_run_has_every_metric_in_its_range():
    results = evaluate(["static", "random"], BASE.replace(hold_steps=5), episodes=3)
    for samples in results.samples.values():
        assert {name for name in METRICS if METRICS[name].value is not None} == samples.keys()
        assert all((values <= MOST_DIGITS).all() for name, values in samples.items() if "digits" in name)
        assert all((samples[name] >= 0).all() for name in ("strategy_distance", "regret"))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (lambda rollout: rollout["strategy_distance"], r"one number per episode, shape \(3,\), got shape \(\d+, 3\)"),
        (lambda rollout: 1.0, r"one number per episode, shape \(3,\), got shape \(\)"),
        (lambda rollout: None, r"one number per episode, shape \(3,\), got shape \(\)"),
        (lambda rollout: rollout["strategy_distances"][0], r"unknown series 'strategy_distances'; did you mean 'str"),
        (lambda rollout: rollout["speed"][0], r"unknown series 'speed'; choose from strategy_distance, estimate_dist"),
        (lambda rollout: rollout.speed, r"has no attribute 'speed' \(test_metrics.py, line \d+\)"),
        (lambda: 1.0, r"raised TypeError: .*positional argument"),
        (lambda rollout: ["x"] * 3, r"raised ValueError: could not convert"),
    ],
)
def test_a_metric_that_fails_is_named_with_what_was_expected(monkeypatch, value, message):
    monkeypatch.setitem(METRICS, "mine", Metric("mine", "mine", "a number", value=value))
    with pytest.raises(ValueError, match=f"metric 'mine' .*{message}"):
        evaluate("static", BASE, episodes=3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"direction": "up"}, "direction of metric 'mine' is 'higher' or 'lower' or None, got 'up'"),
        ({"block": "At what price"}, "block of metric 'mine' is 'How close' or 'At what cost', got 'At what price'"),
        ({"statistic": "mode"}, "statistic of metric 'mine' is 'mean' or 'cvar' or 'median', got 'mode'"),
        ({"value": 3.0}, "value of metric 'mine' is a function of a Rollout, got 3.0"),
        ({}, "metric 'mine' needs a value, a function of a Rollout, or the source"),
        ({"source": "digit"}, "metric 'mine' needs a value, a function of a Rollout, or the source"),
        ({"name": "digits"}, "there is a metric 'digits' already"),
    ],
)
def test_a_metric_that_is_declared_wrongly_is_refused(arguments, message):
    declared = {"name": "mine", "heading": "mine", "meaning": "a number"} | arguments
    with pytest.raises(ValueError, match=message):
        register(Metric(**declared))
    assert "mine" not in METRICS


def test_something_else_than_a_metric_is_not_registered():
    with pytest.raises(TypeError, match="register takes Metric"):
        register(len)


def test_a_new_statistic_is_one_entry(monkeypatch):
    monkeypatch.setitem(STATISTICS, "worst", lambda samples: np.full_like(samples, samples.min()))
    for name in STATISTICS:
        monkeypatch.setitem(METRICS, name, Metric(name, name, "a number", source="digits", statistic=name))
    results = evaluate("static", BASE, episodes=20)
    digits = results.samples[BASE.name, "static"]["digits"]
    means = {name: results.record(BASE.name, "static", name)["mean"] for name in STATISTICS}
    assert means == pytest.approx({name: of(digits).mean() for name, of in STATISTICS.items()})
    assert means["worst"] == digits.min() < means["cvar"] < means["mean"]
