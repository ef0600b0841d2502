import numpy as np
import pytest
from scipy import stats

from ptne_env.evaluation.statistics import summarise


def test_a_constant_sample_has_low_equal_high_equal_mean_exactly():
    value = 0.1 + 0.2
    (summary,) = summarise(np.full((1, 7), value))
    assert (summary.mean, summary.low, summary.high) == (value, value, value)


def test_a_metric_without_any_value_has_none():
    (summary,) = summarise(np.full((1, 4), np.nan))
    assert (summary.mean, summary.low, summary.high) == (None, None, None)


def test_missing_values_are_left_out_of_mean_and_interval():
    rng = np.random.default_rng(0)
    values = rng.normal(size=50)
    sparse = np.concatenate([values, np.full(30, np.nan)])
    assert summarise(sparse[None])[0] == summarise(values[None])[0]


def test_rows_are_summarised_in_their_order():
    rows = np.stack([np.full(9, 3.0), np.arange(9.0), np.full(9, np.nan), np.arange(9.0) + 100])
    means = [summary.mean for summary in summarise(rows)]
    assert means == [3.0, 4.0, None, 104.0]


def test_the_interval_of_a_large_normal_sample_is_that_of_the_central_limit_theorem():
    values = np.random.default_rng(1).normal(2.0, 3.0, size=4000)
    (summary,) = summarise(values[None])
    half = stats.norm.ppf(0.975) * values.std() / np.sqrt(values.size)
    assert summary.mean == pytest.approx(values.mean())
    assert summary.low == pytest.approx(values.mean() - half, abs=0.15 * half)
    assert summary.high == pytest.approx(values.mean() + half, abs=0.15 * half)


def test_summaries_are_a_function_of_the_sample_and_the_seed():
    values = np.random.default_rng(2).normal(size=(3, 40))
    assert summarise(values, seed=4) == summarise(values, seed=4)
    assert summarise(values, seed=4) != summarise(values, seed=5)
