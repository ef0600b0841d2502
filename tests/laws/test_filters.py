"""Filters of messages: noise and rounding, and the means beneath them."""

import numpy as np
import pytest

from ptne_env.laws.building_blocks.messages import (
    RATES,
    Damage,
    Filters,
    NeighbourMessages,
    dither,
    filter_messages,
    measure_damage,
)

SCALE, STD = 10.0, 0.05


def numbers(value):
    return np.full((1, 1), float(value))


def watch(content):
    """Of one player whose estimates are all 10 and links last: the damage in every step, and the last means.

    ``content`` are the messages of every step, shape (K, D, n); the means have the shape (D, n).
    """
    _, slots, n = content.shape
    links, each, none = np.zeros((1, slots)), np.zeros((1, slots, n)), numbers(0)
    means = np.zeros((1, len(RATES), slots, n))
    was = Filters(links, each, each, none, none, none, none + np.inf, none, means, means + 1e6)
    found, mean = [], each
    for k, message in enumerate(content[:, None]):
        messages = NeighbourMessages(links == 0, np.full(links.shape, k > 0), message, np.abs(message - was.last))
        fresh, damage = measure_damage(messages, was, numbers(k), each > 0, numbers(SCALE))
        mean = message
        if damage.deviation.item() > 0:
            fresh, (mean, _) = filter_messages(messages, was, fresh, damage)
        was = fresh
        found.append((damage.noise.item(), damage.step.item()))
    return np.array(found), mean[0]


def noisy(value, steps, slots=2, n=3, std=STD, seed=0):
    return value + std * np.random.default_rng(seed).normal(size=(steps, slots, n))


def converging(rate, steps=80):
    """Messages that rest in the first two steps, and then come to rest at this rate."""
    moves = 5 * rate ** np.maximum(np.arange(steps) - 2.0, 0)
    return SCALE + moves[:, None, None] * np.random.default_rng(1).uniform(-1, 1, (2, 3))


@pytest.mark.parametrize("std", [1e-3, 0.05, 0.5])
def test_noise_is_measured_from_the_first_step_on_and_is_no_rounding(std):
    found, _ = watch(noisy(SCALE, 400, std=std, n=8))
    assert (found[1:, 0] > 0.3 * std).all()
    assert np.median(found[50:, 0]) == pytest.approx(std, rel=0.2)
    assert (found[:, 1] == 0).all()


def test_noise_may_begin_late_rise_and_fall():
    stds = np.repeat([0.0, 0.02, 0.2, 0.01], 200)
    content = SCALE + stds[:, None, None] * np.random.default_rng(0).normal(size=(800, 2, 8))
    found = watch(content)[0][:, 0]
    assert (found[:200] == 0).all()
    assert found[[399, 599, 799]] == pytest.approx([0.02, 0.2, 0.01], rel=0.5)


@pytest.mark.parametrize("width", [0.01, 0.1, 1.0])
def test_rounding_is_recognised_with_its_step_and_is_no_noise(width):
    content = np.round(converging(0.9) / width) * width
    content += width * (np.arange(len(content)) % 7 == 0)[:, None, None]
    found, _ = watch(content)
    assert found[-1] == pytest.approx([0, width])


@pytest.mark.parametrize("rate", [0.3, 0.9, 0.97])
def test_messages_that_converge_carry_no_noise_and_are_not_rounded(rate):
    found, _ = watch(converging(rate, steps=400))
    assert (found[:, 0] < 0.1).all()
    assert found[-1].tolist() == [0, 0]


def test_a_long_mean_of_noisy_messages_is_close_and_follows_when_the_sender_moves():
    _, means = watch(noisy(3.0, 300, n=40))
    assert np.sqrt(np.mean((means - 3.0) ** 2)) < 2 * STD / np.sqrt(300)
    _, means = watch(np.concatenate([noisy(3.0, 150, n=40), noisy(3.0 + 10 * STD, 40, n=40, seed=1)]))
    assert np.sqrt(np.mean((means - 3.0 - 10 * STD) ** 2)) < STD / 3


def test_single_outliers_move_no_mean():
    content = noisy(3.0, 200, n=8)
    content[np.arange(5, 200, 20)] += 100.0
    _, means = watch(content)
    assert np.abs(means - 3.0).max() < STD


def test_the_mean_of_rounded_messages_of_a_dithered_strategy_is_the_strategy():
    value, width, steps = 3.0 + 0.1 * np.linspace(0.05, 0.95, 7), 0.1, 300
    shake = np.array([dither(numbers(k)).item() for k in range(steps)])
    assert np.abs(shake).max() <= 0.5
    content = np.round((value + width * shake[:, None, None]) / width) * width
    _, means = watch(content)
    assert np.abs(means - value).max() < 0.015 * width < np.abs(np.round(value / width) * width - value).max()


def test_damage_of_rounding_is_that_of_a_uniform_error():
    assert Damage(numbers(0), numbers(np.sqrt(12))).deviation.item() == pytest.approx(1)


def held(content, longest=4):
    """The messages as they arrive after random delays: the last arrival is held, in float32 of the own estimates."""
    generator, newest = np.random.default_rng(2), 0
    found = []
    for k in range(len(content)):
        newest = max(newest, k - int(generator.integers(longest + 1)))
        own = SCALE * (1 + 1e-9 * generator.normal())
        found.append(own + (content[newest] - own).astype(np.float32))
    return np.array(found)


def test_late_noise_is_heard_through_delays():
    rng = np.random.default_rng(0)
    late = SCALE + (np.arange(1000) > 200)[:, None, None] * 0.02 * rng.normal(size=(1000, 2, 8))
    assert watch(held(late))[0][-1, 0] == pytest.approx(0.02, rel=0.2)


def test_strategies_that_chase_each_other_forever_are_no_noise():
    turns = np.cos(0.5 * np.arange(400.0)[:, None, None] + np.random.default_rng(0).uniform(0, 6, (2, 3)))
    turns[:3] = turns[3]  # estimates of others rest in the first step
    assert (watch(SCALE + turns)[0][:, 0] == 0).all()
