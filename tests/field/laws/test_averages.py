"""Private means: noise and rounding are recognised, means are as good as their weights, and liars do not count."""

from types import SimpleNamespace

import numpy as np
import pytest

from ptne_env.field.laws.averages import Averages, average_parts, averages, dither, lies, mature, unrest, without_liars
from ptne_env.field.laws.best_response import UNLIMITED
from ptne_env.field.laws.contacts import noise_level
from ptne_env.laws import averages as module
from ptne_env.laws.memory import Parts

SCALE, STD, WIDTH = 10.0, 0.05, 0.1


def watch(messages, live=None, is_rounded=None):
    """Of one player whose estimates are all 10: its unrest after every step, and its means and memory at the end.

    Args:
        messages: of every step, shape (K, D, n).
        live: whether links are live in every step, shape (K, D); all if left out.
        is_rounded: averages all messages as rounded or as noisy ones; none if left out, and so what unrest says.
    """
    steps, slots, n = messages.shape
    layout = SimpleNamespace(slots=slots, dimension=n)
    memory = Parts(
        average_parts(layout) | {"live": (slots,), "messages": (slots, n), "noise": (1,), "steps": (1,)}
    ).zeros(1)
    memory |= {"width": np.full((1, 1), UNLIMITED), "level": np.full((1, 1), UNLIMITED)}
    estimate, found, means = np.full((1, n), SCALE), [], None
    for k in range(steps):
        weights = np.ones((1, slots)) if live is None else live[k : k + 1].astype(float)
        relative = (messages[k : k + 1] - estimate[:, None]) * (weights > 0)[:, :, None]
        sight = SimpleNamespace(own_estimate=estimate, relative_estimates=relative, weights=weights)
        noise = noise_level(sight, memory, np.zeros((1, slots, n), dtype=bool))
        restless = unrest(sight, memory, noise)
        found.append(restless)
        rounded = restless.is_rounded if is_rounded is None else np.full((1, 1), is_rounded)
        if is_rounded is None and not (restless.is_noisy | restless.is_rounded).any():
            memory["samples"] = np.zeros_like(memory["samples"])
        means, changed = averages(sight, memory, rounded)
        memory |= changed | {name: getattr(restless, name) for name in ("width", "level", "since")}
        memory |= {"noisy": restless.is_noisy * 1.0, "noise": noise, "live": weights, "steps": memory["steps"] + 1}
        memory["messages"] = estimate[:, None] + relative
    return found, means, memory


def noisy(value, steps, slots=2, n=3, std=STD, seed=0):
    return value + std * np.random.default_rng(seed).normal(size=(steps, slots, n))


def settling(rate, steps=80):
    """Messages that rest in the first two steps, and then come to rest at this rate."""
    moves = 5 * rate ** np.maximum(np.arange(steps) - 2.0, 0)
    return SCALE + moves[:, None, None] * np.random.default_rng(1).uniform(-1, 1, (2, 3))


def late(messages, longest=7):
    """Each of them up to seven steps late, in float32."""
    delays = np.random.default_rng(0).integers(0, longest + 1, len(messages))
    return messages[np.maximum(np.arange(len(messages)) - delays, 0)].astype(np.float32).astype(float)


# --- recognition ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("std", [1e-3, 0.05, 0.5])
def test_noise_is_recognised_and_is_no_rounding(std):
    found, _, _ = watch(noisy(SCALE, 60, std=std))
    assert not any(each.is_noisy.item() for each in found[: module.START])
    assert found[-1].is_noisy.item()
    assert not any(each.is_rounded.item() for each in found)


@pytest.mark.parametrize("width", [0.01, 0.1, 1.0])
def test_rounding_is_recognised_with_its_step_and_is_no_noise(width):
    messages = np.round(settling(0.9) / width) * width
    messages += width * (np.arange(len(messages)) % 7 == 0)[:, None, None]
    found, _, _ = watch(messages)
    assert found[-1].is_rounded.item()
    assert found[-1].width.item() == pytest.approx(width)
    assert not any(each.is_noisy.item() for each in found)
    assert not any(each.is_rounded.item() for each in found[: module.START])


@pytest.mark.parametrize("rate", [0.3, 0.9, 0.97, 0.995])
@pytest.mark.parametrize("carry", [np.asarray, late], ids=["perfect", "late"])
def test_messages_that_converge_slowly_or_late_carry_no_noise_and_are_not_rounded(rate, carry):
    found, _, _ = watch(carry(settling(rate)))
    assert not any(each.is_noisy.item() or each.is_rounded.item() for each in found)


def test_noise_stays_noise_although_its_smallest_change_falls():
    found, _, memory = watch(noisy(SCALE, 600, n=1, slots=1))
    first = next(k for k, each in enumerate(found) if each.is_noisy.item())
    assert all(each.is_noisy.item() for each in found[first:])
    assert memory["noise"].item() < found[first].level.item() / 2


# --- the mean -------------------------------------------------------------------------------------------------------


def weights_of_samples(steps, forgetting):
    """The weight of each of ``steps`` samples in the mean m ← m + p/(p + k) (x − m)."""
    weights = np.zeros(steps)
    for k in range(steps):
        share = forgetting / (forgetting + k)
        weights *= 1 - share
        weights[k] = share
    return weights


@pytest.mark.parametrize("steps", [40, 120])
def test_the_mean_has_the_variance_of_its_weights(steps, monkeypatch):
    monkeypatch.setattr(module, "_LAG", 1e9)
    _, means, _ = watch(noisy(3.0, steps, slots=1, n=4000), is_rounded=False)
    expected = STD**2 * (weights_of_samples(steps, 2.0) ** 2).sum()
    assert np.var(means.mean) == pytest.approx(expected, rel=0.1)
    assert means.mean.mean() == pytest.approx(3.0, abs=1e-3)
    assert np.median(means.variance) == pytest.approx(STD**2, rel=0.3)
    assert (means.samples == steps).all()


def test_a_mean_that_lags_becomes_the_quick_mean(monkeypatch):
    messages = np.concatenate([noisy(3.0, 150, n=40), noisy(3.0 + 10 * STD, 40, n=40, seed=1)])
    _, means, memory = watch(messages, is_rounded=False)
    assert np.abs(means.mean - 3.0 - 10 * STD).max() < 2.5 * STD
    assert (means.samples < 60).all()
    monkeypatch.setattr(module, "_LAG", 1e9)
    _, slow, _ = watch(messages, is_rounded=False)
    assert np.abs(slow.mean - 3.0 - 10 * STD).min() > 2.5 * STD
    assert (memory["quick"] != memory["mean"]).any()


def test_messages_at_rest_do_not_lag():
    _, means, _ = watch(noisy(3.0, 300, n=100), is_rounded=False)
    assert (means.samples == 300).mean() > 0.9


def test_after_a_break_the_mean_counts_as_few_samples():
    live = np.ones((100, 2), dtype=bool)
    live[80:90, 0] = False
    messages = noisy(3.0, 100)
    _, means, _ = watch(messages, live, is_rounded=False)
    assert (means.samples[0, 0] == 6 + 10).all()
    assert (means.samples[0, 1] == 100).all()
    _, rest, _ = watch(messages[:90], live[:90], is_rounded=False)
    _, before, _ = watch(messages[:80], live[:80], is_rounded=False)
    np.testing.assert_array_equal(rest.mean[0, 0], before.mean[0, 0])  # a link that is down brings nothing


def sent(strategy, steps, amplitude):
    """The rounded messages about strategies, shape (n,), that are dithered by this many steps of rounding."""
    shake = np.array([dither(np.array([[float(k)]])).item() for k in range(steps)])
    return np.round(strategy / WIDTH + amplitude * shake[:, None])[:, None] * WIDTH


def test_rounded_messages_of_a_dithered_strategy_give_it_far_below_the_step():
    strategies = np.random.default_rng(0).uniform(5, 15, 200)
    _, means, memory = watch(sent(strategies, 300, 1.0), is_rounded=True)
    errors = np.abs(means.mean[0, 0] - strategies)
    assert errors.max() < WIDTH / 100
    assert errors.mean() < np.abs(memory["mean"][0, 0] - strategies).mean() / 3  # the single mean
    _, plain, _ = watch(sent(strategies, 300, 0.0), is_rounded=True)
    assert np.abs(plain.mean[0, 0] - strategies).mean() == pytest.approx(WIDTH / 4, rel=0.2)


def test_dither_is_even_and_within_half_a_step():
    shake = np.sort([dither(np.array([[float(k)]])).item() for k in range(1000)])
    assert -0.5 <= shake[0] <= shake[-1] < 0.5
    assert np.diff(shake).max() < 3 / 1000


# --- beliefs --------------------------------------------------------------------------------------------------------


def means_of(mean, samples, variance):
    """Means of the messages of D neighbours about one component."""
    return Averages(*(np.array(part, dtype=float)[None, :, None] for part in (mean, samples, variance)))


def test_belief_weighs_means_by_samples_over_variance():
    means = means_of([1.0, 4.0], [10, 20], [1.0, 4.0])
    assert means.belief(np.ones((1, 2, 1)), np.zeros((1, 1))).item() == pytest.approx((10 * 1 + 5 * 4) / 15)
    assert means.belief(np.array([[[1.0], [0.0]]]), np.zeros((1, 1))).item() == 1.0
    assert means.belief(np.zeros((1, 2, 1)), np.full((1, 1), 7.0)).item() == 7.0


@pytest.mark.parametrize("gap", [0.0, 30 * STD], ids=["honest", "lying"])
def test_statements_far_from_the_own_strategy_are_counted_as_lies(gap):
    means = Averages(np.array([[[SCALE + gap, 3.0]]]), np.full((1, 1, 2), 25.0), np.full((1, 1, 2), STD**2))
    memory, estimate = {"lies": np.full((1, 1), 3.0)}, np.full((1, 2), SCALE)
    is_own = np.array([[True, False]])  # the other component is not the player's, and so not judged
    assert lies(means, memory, estimate, is_own).item() == (4.0 if gap else 2.0)
    young = means._replace(samples=np.full((1, 1, 2), 20.0))
    assert lies(young, memory, estimate, is_own).item() == 2.0
    assert lies(means, {"lies": np.full((1, 1), 30.0)}, estimate, is_own).item() == (30.0 if gap else 29.0)


@pytest.mark.parametrize(
    ("sources", "owners", "lied", "kept"),
    [
        ("11-", "000", (0, 0, 0), "110"),  # nobody lies
        ("11-", "000", (10, 0, 0), "010"),  # the other source remains
        ("1--", "000", (10, 0, 0), "011"),  # else all neighbours that do not lie
        ("1--", "000", (10, 10, 10), "100"),  # else the source
        ("1--", "100", (10, 0, 0), "100"),  # an owner does not lie about itself
        ("---", "000", (10, 0, 0), "000"),  # without sources nothing is copied
    ],
)
def test_liars_are_no_sources_where_others_remain(sources, owners, lied, kept):
    flags = [np.array([[[mark == "1"] for mark in marks]]) for marks in (sources, owners, kept)]
    others = np.ones((1, 3, 1), dtype=bool)
    found = without_liars(flags[0], others, flags[1], np.array([lied], dtype=float))
    np.testing.assert_array_equal(found, flags[2])


@pytest.mark.parametrize(
    ("samples", "is_own", "lied", "expected"),
    [
        ((50, 50), False, 0, True),
        ((30, 50), False, 0, False),  # the source's mean is young
        ((50, 30), False, 0, False),  # the neighbour's is
        ((50, 50), True, 0, False),
        ((50, 50), False, 1, False),
    ],
)
def test_old_means_of_other_neighbours_count_beside_old_means_of_sources(samples, is_own, lied, expected):
    means = means_of([1.0, 1.0], samples, [1.0, 1.0])
    sources, own = np.array([[[True], [False]]]), np.array([[is_own]])
    found = mature(means, sources, own, np.array([[0.0, lied]]))
    assert found[0, 1, 0] == expected
