"""Models of the neighbours' reactions, and damping of responses."""

from types import SimpleNamespace

import numpy as np
import pytest

from ptne_env.laws.building_blocks import reactions
from ptne_env.laws.building_blocks.messages import NeighbourMessages
from ptne_env.laws.building_blocks.own_gradient import UNLIMITED, Model, OwnSide
from ptne_env.laws.building_blocks.reactions import Damping

SCALE = 10.0


def numbers(value):
    return np.full((1, 1), float(value))


def own_side(row, gradient=1.0):
    """The own side of a player that owns the first of the components of ``row``."""
    rows, flags = np.array(row, dtype=float)[None, None], np.zeros((1, 1), dtype=bool)
    return OwnSide(
        model=Model(rows, np.zeros((1, len(row), len(row)))),
        gradient=numbers(gradient),
        blocks=np.zeros((1, 1), dtype=np.int64),
        held=flags,
        radius=numbers(UNLIMITED),
        error=numbers(0),
        is_probe=flags,
        turn=~flags,
        is_fixed=~flags,
    )


# --- damping --------------------------------------------------------------------------------------------------------


def undamped(factor=1.0, change=0.0):
    """The damping at the start, with another factor or last change of the gradient."""
    return Damping(numbers(factor), *[numbers(0)] * 4, numbers(change))


def after(responses, is_loose=True, noise=0.0, doubt=0.0, turns=True):
    """The damping after each of these responses, which change their sign in every step or not."""
    known, found = undamped(), []
    for step, size in enumerate(responses):
        response = size * (-1) ** step if turns else size
        loose, errors = np.full((1, 1), is_loose), (numbers(noise), numbers(doubt), numbers(SCALE))
        known = reactions.update_damping(known, loose, numbers(response), numbers(0), numbers(step), *errors)
        found.append(known.factor.item())
    return np.array(found)


def test_damping_falls_by_a_fifth_every_ten_steps_in_which_responses_do_not_shrink():
    found = after([1.0] * 61)
    assert (found[:30] == 1).all()  # the first two windows are not judged
    assert found[30:] == pytest.approx(0.8 ** (1 + np.arange(31) // 10))
    assert after([1.0] * 400)[-1] == 0.3
    assert after(5 * 0.97 ** np.arange(200))[-1] == 1  # a quarter per window
    assert after(5 * 0.985 ** np.arange(200))[-1] == pytest.approx(0.3)  # a seventh per window


def test_responses_that_lead_somewhere_are_not_damped():
    """A slow approach, as through late messages, is no rotation; damping would make it slower."""
    assert (after([1.0] * 400, turns=False) == 1).all()


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
        ({"noise": 0.6}, 1.0, 1.0),
        ({"doubt": 0.02}, 1.0, 1.0),
        ({"noise": 0.4, "doubt": 0.005}, 1.0, 0.3),
        ({}, 5e-6, 1.0),  # tiny responses are at rest
    ],
)
def test_responses_that_something_else_explains_are_not_damped(explained, response, last):
    assert after([response] * 200, **explained)[-1] == last


@pytest.mark.parametrize(
    ("row", "steps", "loose"), [([1.0, 0.9], 50, False), ([1.0, 1.1], 50, True), ([1.0, 1.1], 1, False)]
)
def test_rows_that_are_not_diagonally_dominant_are_loose(row, steps, loose):
    assert reactions.is_loose(own_side(row), numbers(steps), 2).item() is loose


def test_the_response_is_damped_and_answers_the_expected_gradient():
    own, drift = own_side([2.0, 0.0], gradient=4.0), np.zeros((1, 2))
    assert reactions.damp_response(own, undamped(), numbers(5), drift).item() == pytest.approx(-2.0)
    assert reactions.damp_response(own, undamped(0.5, -2), numbers(5), drift).item() == pytest.approx(-0.75)
    turns = reactions.damp_response(own, undamped(0.5, 2), numbers(5), drift)  # the last two changes do not agree
    assert turns.item() == pytest.approx(-1.0)


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
    here, known = np.full((1, TOTAL), 10.0), reactions.initial_planes(LAYOUT)
    live, before, count = np.ones((1, 2), dtype=bool), np.zeros((1, 2, TOTAL)), 3
    for _ in range(steps):
        content = np.stack([respond(player, GENERATOR.normal(size=TOTAL) * 5) for player in (1, 2)])[None]
        for _ in range(rest):
            sight = SimpleNamespace(player=PLAYER_0, relative_estimates=content - here[:, None])
            messages = NeighbourMessages(live, live & (count > 3), content, np.abs(content - before))
            known = reactions.learn_planes(sight, messages, known, numbers(count), here, LAYOUT)
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
    point, is_trusted = reactions.solve_jointly(PLAYER_0, known, here, here, own, numbers(doubt), LAYOUT)
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
    assert not solve(known, doubt=1.5)[1]
    assert not solve(known._replace(error=np.full((1, 2), 1.5)))[1]
    point, _ = solve(planes_after(2))  # few samples
    assert point[2:] == pytest.approx(EQUILIBRIUM[2:] + 1.0)
