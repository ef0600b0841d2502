import os

import numpy as np
import pytest
from scipy import stats

from ptne_env.evaluation.statistics import estimate, tail_values

REPETITIONS = 20_000 if os.environ.get("PTNE_SOAK") else 1000


def test_a_constant_sample_has_low_equal_high_equal_mean_exactly():
    value = 0.1 + 0.2
    summary = estimate([np.full((2, 7), value), np.full((2, 5), value)])
    assert (summary.mean, summary.low, summary.high) == (value, value, value)


def test_an_interval_of_numbers_whose_squares_underflow_is_in_proportion():
    plain, tiny = estimate([np.array([[1.0, 2.0, 3.0]])]), estimate([np.array([[1e-90, 2e-90, 3e-90]])])
    assert (tiny.mean, tiny.low, tiny.high) == pytest.approx((2e-90, 1e-90 * plain.low, 1e-90 * plain.high), rel=1e-12)


def test_a_metric_without_any_value_has_none():
    summary = estimate([np.full((2, 4), np.nan)])
    assert (summary.mean, summary.low, summary.high) == (None, None, None)


def test_missing_values_are_left_out_of_mean_and_interval():
    values = np.random.default_rng(0).normal(size=(1, 50))
    sparse = np.concatenate([values, np.full((1, 20), np.nan), np.full((1, 10), np.inf)], axis=1)
    assert estimate([sparse]) == estimate([values])


def test_a_training_seed_without_values_is_left_out():
    values = np.random.default_rng(0).normal(size=(3, 50))
    assert estimate([np.vstack([values, np.full(50, np.nan)])]) == estimate([values])


def test_the_interval_of_one_policy_on_one_track_is_that_of_student():
    values = np.random.default_rng(1).normal(2.0, 3.0, size=12)
    low, high = stats.t.interval(0.95, 11, values.mean(), stats.sem(values))
    summary = estimate([values[None]])
    assert (summary.mean, summary.low, summary.high) == pytest.approx((values.mean(), low, high))


def test_training_seeds_that_alone_differ_have_the_interval_of_student():
    seeds = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    summary = estimate([np.tile(seeds[:, None], (1, 30))])
    assert summary.high == pytest.approx(stats.t.interval(0.95, 4, 0, stats.sem(seeds))[1])


def test_tracks_of_different_length_count_the_same():
    assert estimate([np.full((1, 3), 1.0), np.full((1, 300), 2.0)]).mean == 1.5


@pytest.mark.parametrize("episodes", [1, 9, 10, 57, 200])
def test_tail_values_have_the_mean_of_the_worst_tenth(episodes):
    samples = np.random.default_rng(0).normal(size=(3, episodes))
    worst = np.sort(samples, axis=1)[:, : max(1, episodes // 10)]
    assert tail_values(samples).mean(axis=1) == pytest.approx(worst.mean(axis=1))


def test_a_cvar_with_missing_values_has_none():
    assert np.isnan(tail_values(np.array([[1.0, np.nan]]))).all()


def normal(generator, size):
    return generator.normal(size=size)


def exponential(generator, size):
    return generator.exponential(size=size) - 1


def mean_of(scores, others):
    return estimate([x - y for x, y in zip(scores, others, strict=True)])


def tail_of(scores, others):
    return estimate([tail_values(x) for x in scores])


TAIL = -np.sqrt(2) * stats.norm.pdf(stats.norm.ppf(0.1)) / 0.1


@pytest.mark.parametrize(
    ("summary_of", "truth", "seeds", "episodes", "tracks", "spread", "effect", "promise"),
    [
        pytest.param(mean_of, 0.0, 1, 100, 1, 0.0, normal, (0.93, 0.97), id="nothing trained"),
        pytest.param(mean_of, 0.0, 5, 40, 2, 0.5, normal, (0.93, 0.97), id="five training seeds, two tracks"),
        pytest.param(mean_of, 0.0, 5, 40, 1, 2.0, normal, (0.93, 0.97), id="five training seeds far apart"),
        pytest.param(
            mean_of, 0.0, 5, 40, 4, 0.1, exponential, (0.93, 0.97), id="skewed training seeds near each other"
        ),
        pytest.param(mean_of, 0.0, 5, 40, 1, 2.0, exponential, (0.86, 0.92), id="skewed training seeds far apart"),
        pytest.param(tail_of, TAIL, 1, 200, 1, 0.0, normal, (0.90, 0.97), id="CVaR"),
    ],
)
def test_intervals_cover_the_truth_as_often_as_promised(
    summary_of, truth, seeds, episodes, tracks, spread, effect, promise
):
    # Two equal policies on shared episodes that are worth N(0, 1), with noise N(0, 1) of their own; the first policy is
    # trained `seeds` times, with effects of mean 0 and standard deviation `spread`, the same on all tracks.
    generator = np.random.default_rng(1)
    covered = 0
    for _ in range(REPETITIONS):
        training = spread * effect(generator, (seeds, 1))
        scores, others = [], []
        for _ in range(tracks):
            shared = generator.normal(size=episodes)
            scores.append(training + shared + generator.normal(size=(seeds, episodes)))
            others.append(shared + generator.normal(size=(1, episodes)))
        summary = summary_of(scores, others)
        covered += summary.low <= truth <= summary.high
    print(f"covered in {covered} of {REPETITIONS} repetitions")
    assert promise[0] <= covered / REPETITIONS <= promise[1]
