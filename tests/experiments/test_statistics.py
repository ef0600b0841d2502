import numpy as np
import pytest
from scipy import stats

from ptne_env.experiments.statistics import (
    estimate,
    interquartile_mean,
    performance_profile,
    probability_of_improvement,
    summarise,
    unpaired_probability_of_improvement,
)

# Scores of two algorithms, runs in rows and tasks in columns, and the values of rliable 1.2.0
# (aggregate_iqm, probability_of_improvement, run_score_deviation).
X = np.array([[1.06, 0.93, 1.32], [1.05, 0.73, 1.18], [1.65, 1.47, 0.65], [0.37, 0.69, 1.02], [-0.16, 0.89, 0.38],
              [0.63, 0.73, 0.84]])  # fmt: skip
Y = np.array([[1.06, 1.32, 0.74], [1.48, 0.47, 0.98], [1.25, 0.85, 0.43], [0.34, 0.57, 0.91], [0.3, 0.7, 0.72]])


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


def by_task(scores):
    """rliable's matrix as scores per track, of one training seed."""
    return [column[None] for column in scores.T]


def test_interquartile_mean_is_that_of_rliable():
    assert interquartile_mean(by_task(X)) == pytest.approx(0.859, abs=1e-15)
    assert interquartile_mean(by_task(Y)) == pytest.approx(0.7777777777777778, abs=1e-15)


def test_unpaired_probability_of_improvement_is_that_of_rliable():
    assert unpaired_probability_of_improvement(by_task(X), by_task(Y)) == pytest.approx(0.5944444444444444, abs=1e-15)
    assert unpaired_probability_of_improvement(by_task(Y), by_task(X)) == pytest.approx(0.4055555555555556, abs=1e-15)


def test_performance_profile_is_that_of_rliable():
    profile = performance_profile(by_task(X), np.array([0.0, 0.73, 1.0, 2.0]))
    assert profile.tolist() == pytest.approx([17 / 18, 10 / 18, 7 / 18, 0], abs=1e-15)


def test_paired_improvement_compares_the_same_episodes():
    x, y = np.array([[1.0, 2.0, 3.0, 4.0]]), np.array([[0.5, 1.5, 3.0, 5.0]])
    assert probability_of_improvement([x], [y]) == pytest.approx((1 + 1 + 0.5 + 0) / 4)
    assert probability_of_improvement([np.vstack([x, x + 9])], [y]) == pytest.approx((2.5 / 4 + 1) / 2)


def test_a_statistic_that_does_not_vary_has_no_width():
    summary = estimate(interquartile_mean, [np.full((3, 5), 2.0)])
    assert (summary.mean, summary.low, summary.high) == (2.0, 2.0, 2.0)


def test_training_seeds_that_disagree_widen_the_interval():
    episodes = np.random.default_rng(0).normal(size=100)
    agreeing = np.tile(episodes, (5, 1))
    disagreeing = agreeing + np.array([-2.0, -1.0, 0.0, 1.0, 2.0])[:, None]
    narrow, wide = (estimate(mean_of_first, [scores]) for scores in (agreeing, disagreeing))
    assert wide.mean == pytest.approx(narrow.mean)
    # Five seeds with the standard deviation √2.5: t with four degrees of freedom.
    assert wide.high - wide.low == pytest.approx(2 * 2.776 * np.sqrt(2.5 / 5), rel=0.15)
    assert narrow.high - narrow.low < 0.5


def mean_of_first(scores):
    return scores[0].mean(axis=(-2, -1))


def difference_of_means(scores, others):
    return np.mean([x.mean(axis=(-2, -1)) - y.mean(axis=(-2, -1)) for x, y in zip(scores, others, strict=True)], axis=0)


def difference_of_interquartile_means(scores, others):
    return interquartile_mean(scores) - interquartile_mean(others)


@pytest.mark.parametrize(
    ("statistic", "truth", "seeds", "episodes", "tracks", "spread"),
    [
        pytest.param(difference_of_means, 1.0, 1, 100, 1, 0.0, id="mean, nothing trained"),
        pytest.param(difference_of_means, 1.0, 5, 40, 2, 0.5, id="mean, five training seeds"),
        pytest.param(difference_of_means, 1.0, 5, 40, 1, 2.0, id="mean, five training seeds far apart"),
        pytest.param(difference_of_interquartile_means, 1.0, 1, 80, 1, 0.0, id="interquartile mean"),
        pytest.param(
            probability_of_improvement, stats.norm.cdf(1 / np.sqrt(2)), 1, 100, 2, 0.0, id="probability of improvement"
        ),
    ],
)
def test_intervals_cover_a_known_difference_in_95_of_100_repetitions(statistic, truth, seeds, episodes, tracks, spread):
    # Policies that differ by 1 on average, on shared episodes that are worth N(0, 1), with noise N(0, 1) of their own;
    # the first policy is trained `seeds` times, with effects N(0, spread²).
    generator = np.random.default_rng(1)
    covered = 0
    for repetition in range(1000):
        training = spread * generator.normal(size=(seeds, 1))
        scores, others = [], []
        for _ in range(tracks):
            shared = generator.normal(size=episodes)
            scores.append(1 + training + shared + generator.normal(size=(seeds, episodes)))
            others.append(shared + generator.normal(size=(1, episodes)))
        summary = estimate(statistic, scores, others, seed=repetition, resamples=400)
        covered += summary.low <= truth <= summary.high
    assert 930 <= covered <= 970
