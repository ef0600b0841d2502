"""Estimators of the observer relay: noise and rounding, means, liars, damping, pushes, and neighbours' reactions."""

from types import SimpleNamespace

import numpy as np
import pytest

from ptne_env.field.laws import estimators, reactions
from ptne_env.field.laws.best_response import UNLIMITED
from ptne_env.field.laws.constants import C
from ptne_env.field.laws.contact_relay import Own
from ptne_env.field.laws.contacts import Messages, noise_level
from ptne_env.field.laws.estimators import Damage, Damping, Push, Samples, Tempered
from ptne_env.field.laws.identification import Model

SCALE, STD = 10.0, 0.05


def numbers(value):
    return np.full((1, 1), float(value))


def watch(content, is_rounded=None):
    """Of one player whose estimates are all 10 and links last: what it sees in every step, its samples and means.

    Args:
        content: of the messages of every step, shape (K, D, n).
        is_rounded: averages all messages as rounded or as noisy ones; none if left out, and so what damage says.
    """
    _, slots, n = content.shape
    zero, links = np.zeros((1, slots, n)), np.zeros((1, slots))
    seen, samples = Damage(*map(numbers, (UNLIMITED, UNLIMITED, 0, 0))), Samples(*[zero] * 6, links)
    before, was_live, noise, found, means = zero, links > 0, numbers(0), [], zero
    for k, message in enumerate(content[:, None]):
        messages = Messages(links == 0, was_live, message, np.abs(message - before))
        noise = noise_level(messages, noise, numbers(k), np.zeros((1, slots, n), dtype=bool))
        seen, noisy, rounded = estimators.damage(messages, seen, noise, numbers(k), numbers(SCALE))
        found.append((noisy.item(), rounded.item()))
        if is_rounded is not None:
            flag, own = np.full((1, 1), is_rounded), np.zeros((1, n), dtype=bool)
            samples, means = estimators.sampled(messages, samples, np.full((1, n), SCALE), own, flag)
        before, was_live = message, links == 0
    return np.array(found), seen, samples, means


def noisy(value, steps, slots=2, n=3, std=STD, seed=0):
    return value + std * np.random.default_rng(seed).normal(size=(steps, slots, n))


def converging(rate, steps=80):
    """Messages that rest in the first two steps, and then come to rest at this rate."""
    moves = 5 * rate ** np.maximum(np.arange(steps) - 2.0, 0)
    return SCALE + moves[:, None, None] * np.random.default_rng(1).uniform(-1, 1, (2, 3))


def late(content, longest=7):
    """Each of them up to seven steps late, in float32."""
    delays = np.random.default_rng(0).integers(0, longest + 1, len(content))
    return content[np.maximum(np.arange(len(content)) - delays, 0)].astype(np.float32).astype(float)


@pytest.mark.parametrize("std", [1e-3, 0.05, 0.5])
def test_noise_is_recognised_for_good_and_is_no_rounding(std):
    found, seen, *_ = watch(noisy(SCALE, 400, std=std))
    assert not found[: C.start].any()
    assert found[40:, 0].all()  # although the smallest change of messages falls
    assert not found[:, 1].any()
    assert seen.noisy.item() == 1


@pytest.mark.parametrize("width", [0.01, 0.1, 1.0])
def test_rounding_is_recognised_with_its_step_and_is_no_noise(width):
    content = np.round(converging(0.9) / width) * width
    content += width * (np.arange(len(content)) % 7 == 0)[:, None, None]
    found, seen, *_ = watch(content)
    assert found[-1].tolist() == [False, True]
    assert seen.width.item() == pytest.approx(width)
    assert not found[:, 0].any()
    assert not found[: C.start].any()


@pytest.mark.parametrize("rate", [0.3, 0.9, 0.97, 0.995])
@pytest.mark.parametrize("carry", [np.asarray, late], ids=["perfect", "late"])
def test_messages_that_converge_slowly_or_late_carry_no_noise_and_are_not_rounded(rate, carry):
    assert not watch(carry(converging(rate)))[0].any()


def test_a_mean_that_lags_becomes_the_quick_mean():
    content = np.concatenate([noisy(3.0, 150, n=40), noisy(3.0 + 10 * STD, 40, n=40, seed=1)])
    *_, samples, means = watch(content, is_rounded=False)
    assert np.abs(means - 3.0 - 10 * STD).max() < 2.5 * STD
    assert (samples.number < 60).all()


def test_the_mean_of_rounded_messages_of_a_dithered_strategy_is_the_strategy():
    value, width, steps = 3.0 + 0.1 * np.linspace(0.05, 0.95, 7), 0.1, 300
    shake = np.array([estimators.dither(numbers(k)).item() for k in range(steps)])
    assert np.abs(shake).max() <= 0.5
    content = np.round((value + width * shake[:, None, None]) / width) * width
    *_, means = watch(content, is_rounded=True)
    assert np.abs(means - value).max() < 0.01 * width < np.abs(np.round(value / width) * width - value).max()


def test_the_belief_weighs_means_by_their_number_and_variance():
    zero, ones = np.zeros((1, 2, 1)), np.ones((1, 2, 1))
    samples = Samples(zero, zero, zero, np.array([[[30.0], [10.0]]]), np.array([[[1.0], [4.0]]]), zero, ones[..., 0])
    means, otherwise = np.array([[[2.0], [6.0]]]), np.array([[7.0]])
    assert estimators.belief(ones, samples, means, otherwise).item() == pytest.approx((30 * 2 + 2.5 * 6) / 32.5)
    assert estimators.belief(0 * ones, samples, means, otherwise).item() == 7.0


@pytest.mark.parametrize(("gap", "liar"), [(12 * STD, True), (4 * STD, False)])
def test_a_neighbour_whose_mean_about_the_own_strategy_is_far_off_lies(gap, liar):
    zero, links, own = np.zeros((1, 1, 1)), np.zeros((1, 1)), np.ones((1, 1), dtype=bool)
    samples, before = Samples(*[zero] * 6, links), zero
    for k, message in enumerate(noisy(SCALE + gap, 60, slots=1, n=1)[:, None]):
        messages = Messages(links == 0, np.full((1, 1), k > 0), message, np.abs(message - before))
        samples, _ = estimators.sampled(messages, samples, numbers(SCALE), own, ~own)
        before = message
    assert (samples.lies.item() > C.lying_steps) is liar
    assert samples.lies.item() <= C.lying_limit


@pytest.mark.parametrize(
    ("sources", "owners", "lies", "kept"),
    [
        ("110", "000", (10, 0, 0), "010"),  # sources that do not lie
        ("110", "000", (9, 0, 0), "110"),
        ("100", "000", (10, 0, 0), "011"),  # else all neighbours that do not lie
        ("100", "000", (10, 10, 10), "100"),  # else the source
        ("100", "100", (10, 0, 0), "100"),  # an owner does not lie about itself
        ("000", "000", (10, 0, 0), "000"),  # without sources nothing is copied
    ],
)
def test_liars_are_no_sources_where_others_remain(sources, owners, lies, kept):
    source, owner, expected = (np.array([[[mark == "1"] for mark in marks]]) for marks in (sources, owners, kept))
    others = np.ones((1, 3, 1), dtype=bool)
    found = estimators.without_liars(source, others, owner, np.array([lies], dtype=float))
    np.testing.assert_array_equal(found, expected)


# --- damping --------------------------------------------------------------------------------------------------------


def after(responses, is_loose=True, noise=0.0, doubt=0.0):
    """The damping after each of these responses."""
    damping, found = Damping(numbers(1), numbers(0), numbers(0)), []
    for step, response in enumerate(responses):
        errors = numbers(noise), numbers(SCALE), numbers(doubt)
        damping = estimators.damped(damping, np.full((1, 1), is_loose), numbers(response), numbers(step), *errors)
        found.append(damping.factor.item())
    return np.array(found)


def test_damping_falls_by_a_fifth_every_ten_steps_in_which_responses_do_not_shrink():
    found = after([1.0] * 61)
    assert (found[:30] == 1).all()  # the first two windows are not judged
    assert found[30:] == pytest.approx(0.8 ** (1 + np.arange(31) // 10))
    assert after([1.0] * 400)[-1] == 0.3
    assert after(5 * 0.97 ** np.arange(200))[-1] == 1  # a quarter per window
    assert after(5 * 0.985 ** np.arange(200))[-1] == pytest.approx(0.3)  # a seventh per window


def test_damping_recovers_where_responses_halve_in_ten_steps():
    found = after([*[1.0] * 61, *0.9 ** np.arange(80)])  # a third is left after ten steps
    assert found.min() < 0.5
    assert found[-1] == pytest.approx(1.0)
    slow = after([*[1.0] * 61, *0.95 ** np.arange(80)])  # 0.6 is left
    assert slow[-1] == slow.min()


@pytest.mark.parametrize(
    ("explained", "response", "last"),
    [
        ({"is_loose": False}, 1.0, 1.0),
        ({"noise": 0.06}, 1.0, 1.0),
        ({"doubt": 0.02}, 1.0, 1.0),
        ({"noise": 0.04, "doubt": 0.005}, 1.0, 0.3),
        ({}, 5e-6, 1.0),  # tiny responses are at rest
    ],
)
def test_responses_that_something_else_explains_are_not_damped(explained, response, last):
    assert after([response] * 200, **explained)[-1] == last


def own_side(row, gradient=1.0):
    """The own side of a player that owns the first of the components of ``row``."""
    rows, flags = np.array(row, dtype=float)[None, None], np.zeros((1, 1), dtype=bool)
    return Own(
        model=Model(rows, np.zeros((1, len(row), len(row)))),
        gradient=numbers(gradient),
        blocks=np.zeros((1, 1), dtype=np.int64),
        moved=np.zeros((1, len(row))),
        held=flags,
        radius=numbers(UNLIMITED),
        error=numbers(0),
        failed=flags,
        is_probe=flags,
        turn=~flags,
    )


@pytest.mark.parametrize(
    ("row", "steps", "factor", "expected"),
    [
        ([1.0, 0.9], 50, 0.5, (False, 1.0, 0.0)),
        ([1.0, 1.1], 50, 0.5, (True, 0.5, -1.0)),  # loose rows extrapolate their gradient
        ([1.0, 1.1], 50, 0.9, (True, 0.9, 0.0)),
        ([1.0, 1.1], 1, 0.5, (False, 1.0, 0.0)),
    ],
)
def test_only_loose_rows_are_damped(row, steps, factor, expected):
    was = Damping(numbers(factor), numbers(0), numbers(0))
    found = estimators.tempered(own_side(row, gradient=2.0), was, numbers(3.0), numbers(steps), 2)
    assert (found.is_loose.item(), found.factor.item(), found.expected.item()) == expected


def test_the_response_is_damped_and_answers_the_expected_gradient():
    own, drift, flag = own_side([2.0, 0.0], gradient=4.0), np.zeros((1, 2)), np.ones((1, 1), dtype=bool)
    assert Tempered(numbers(1), numbers(0), flag).response(own, drift).item() == pytest.approx(-2.0)
    assert Tempered(numbers(0.5), numbers(-1), flag).response(own, drift).item() == pytest.approx(-0.75)


# --- pushes ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("residuals", "velocity", "steps"),
    [
        ([0.02] * 5, 2.0, 5),  # a constant push is known after its first step
        ([0.02] * 5 + [-0.01] * 2, -1.0, 2),  # a changed push replaces the mean
        ([5e-6] * 3, 0.0, 4),  # below the resolution
        (0.02 + 5e-7 * np.array([1, -1, 1, -1, 1, -1]), 2.0, 6),  # rounding of estimates is averaged
    ],
)
def test_the_push_is_the_mean_of_residuals_since_it_last_changed(residuals, velocity, steps):
    push = Push(numbers(0), numbers(0))
    for residual in [0.0, *residuals]:
        push = estimators.observed_push(push, numbers(residual), numbers(0.01), numbers(SCALE))
    assert push.velocity.item() == pytest.approx(velocity, abs=1e-5)
    assert push.steps.item() == steps


# --- reactions ------------------------------------------------------------------------------------------------------

GENERATOR = np.random.default_rng(3)
DIMS = (2, 1, 2)
N, TOTAL = len(DIMS), sum(DIMS)
OWNERS = np.repeat(np.arange(N), DIMS)
LAYOUT = SimpleNamespace(
    slots=2,
    dimension=TOTAL,
    action_dims=DIMS,
    neighbours=((1, 2), (0, 2), (0, 1)),
    own_components=np.array([[0, 1], [2, TOTAL], [3, 4]]),
    own_mask=np.arange(N)[:, None] == OWNERS,
)
MATRIX = GENERATOR.uniform(-0.3, 0.3, (TOTAL, TOTAL)) + 2 * np.eye(TOTAL)
OFFSET = GENERATOR.uniform(-3, 3, TOTAL)
EQUILIBRIUM = np.linalg.solve(MATRIX, -OFFSET)
PLAYER_0 = np.zeros(1, dtype=int)


def respond(player, estimate):
    """An estimate in which the own components of a player are the best response to the others."""
    own = player == OWNERS
    x = estimate.copy()
    x[own] = np.linalg.solve(MATRIX[np.ix_(own, own)], -OFFSET[own] - MATRIX[own][:, ~own] @ x[~own])
    return x


def planes_after(steps, rest=2):
    """What player 0 knows after it has seen its neighbours at rest at points of their reaction planes."""
    here, known = np.full((1, TOTAL), 10.0), reactions.no_planes(LAYOUT)
    live, before, count = np.ones((1, 2), dtype=bool), np.zeros((1, 2, TOTAL)), 3
    for _ in range(steps):
        content = np.stack([respond(player, GENERATOR.normal(size=TOTAL) * 5) for player in (1, 2)])[None]
        for _ in range(rest):
            sight = SimpleNamespace(player=PLAYER_0, relative_estimates=content - here[:, None])
            messages = Messages(live, live & (count > 3), content, np.abs(content - before))
            known = reactions.learned_planes(sight, messages, known, numbers(count), here, LAYOUT)
            before, count = content, count + 1
    return known


def solve(known, doubt=0.0):
    """The joint solution of player 0, one unit away from the equilibrium in every component."""
    here = EQUILIBRIUM[None] + 1.0
    own = own_side([0.0] * TOTAL)._replace(
        model=Model(MATRIX[None, :2], np.zeros((1, TOTAL, TOTAL))),
        gradient=(MATRIX @ here[0] + OFFSET)[None, :2],
        blocks=LAYOUT.own_components[:1],
    )
    point, is_trusted = reactions.joint_solution(PLAYER_0, known, here, here, own, numbers(doubt), LAYOUT)
    return point[0], is_trusted.item()


def test_planes_of_resting_neighbours_are_identified():
    slopes = planes_after(12).slopes[0]
    for slot, player in enumerate((1, 2)):
        own = player == OWNERS
        exact = -np.linalg.solve(MATRIX[np.ix_(own, own)], MATRIX[own][:, ~own])
        assert slopes[slot, : own.sum()][:, ~own] == pytest.approx(exact, abs=1e-4)
    assert (planes_after(12, rest=1).samples == 0).all()  # moving messages are no samples


def test_joint_solution_of_all_planes_is_the_equilibrium():
    point, is_trusted = solve(planes_after(20))
    assert is_trusted
    assert point == pytest.approx(EQUILIBRIUM, abs=1e-3)


def test_joint_solution_is_not_trusted_while_planes_or_predictions_err():
    known = planes_after(20)
    assert not solve(known, doubt=0.5)[1]
    assert not solve(known._replace(error=np.full((1, 2), 0.5)))[1]
    point, _ = solve(planes_after(2))  # few samples
    assert point[2:] == pytest.approx(EQUILIBRIUM[2:] + 1.0)
