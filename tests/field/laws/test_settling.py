"""Damping: it falls where own rows are loose and responses do not shrink, and players that rotate then settle."""

from types import SimpleNamespace

import numpy as np
import pytest
from affine_games import affine_scenario, loop_start, run
from worlds import fixed_part, world_and_encoder

from ptne_env.field import laws as field_laws
from ptne_env.field.laws.best_response import UNLIMITED
from ptne_env.field.laws.identification import Model
from ptne_env.field.laws.relay import Own
from ptne_env.field.laws.settling import Settling, settle, settling
from ptne_env.laws import settling as module

SCALE = 10.0
ROTATION = [[0.3, 1.0], [-1.0, 0.3]]
"""A monotone game in which each player's own curvature is a third of the coupling."""


def own_side(row, gradient=1.0):
    """The own side of a player that owns the first of the components of ``row``."""
    rows = np.array(row, dtype=float)[None, None]
    flags, ones = np.zeros((1, 1), dtype=bool), np.ones((1, 1))
    return Own(
        model=Model(rows, np.zeros((1, len(row), len(row)))),
        gradient=gradient * ones,
        blocks=np.zeros((1, 1), dtype=np.int64),
        moved=np.zeros((1, len(row))),
        held=flags,
        radius=UNLIMITED * ones,
        error=0 * ones,
        deviation=0 * ones,
        failed=flags,
        is_probe=flags,
        turn=~flags,
    )


def remember(**changes):
    """The memory of one player, with numbers of shape (1, 1)."""
    numbers = {"damping": 1.0, "largest_before": 0.0, "largest_now": 0.0, "steps": 0.0, "gradient": 0.0} | changes
    return {name: np.full((1, 1), float(number)) for name, number in numbers.items()}


def after(responses, is_loose=True, noise=0.0, doubt=0.0):
    """The damping after each of these responses."""
    memory, found = remember(), []
    sight = SimpleNamespace(own_estimate=np.full((1, 2), SCALE))
    part = Settling(np.ones((1, 1)), np.zeros((1, 1)), np.full((1, 1), is_loose))
    for step, response in enumerate(responses):
        memory["steps"] = np.full((1, 1), float(step))
        errors = np.full((1, 1), noise), np.full((1, 1), doubt)
        memory |= settle(sight, memory, part, np.full((1, 1), response), *errors)
        found.append(memory["damping"].item())
    return np.array(found)


# --- when the damping falls -----------------------------------------------------------------------------------------


def test_damping_falls_by_a_fifth_every_ten_steps_in_which_responses_do_not_shrink():
    found = after([1.0] * 61)
    assert (found[:30] == 1).all()  # the first two windows are not judged
    assert found[30:] == pytest.approx(0.8 ** (1 + np.arange(31) // 10))
    assert after([1.0] * 400)[-1] == 0.3


@pytest.mark.parametrize(
    ("rate", "last"), [(0.97, 1.0), (0.985, 0.3)], ids=["a quarter per window", "a seventh per window"]
)
def test_responses_that_shrink_by_a_fifth_in_ten_steps_are_not_damped(rate, last):
    assert after(5 * rate ** np.arange(200))[-1] == pytest.approx(last)


def test_damping_recovers_where_responses_halve_in_ten_steps():
    stuck = [1.0] * 61
    found = after([*stuck, *0.9 ** np.arange(80)])  # a third is left after ten steps
    assert found.min() < 0.5
    assert found[-1] == pytest.approx(1.0)
    slow = after([*stuck, *0.95 ** np.arange(80)])  # 0.6 is left
    assert slow[-1] == slow.min()


@pytest.mark.parametrize(
    "explained",
    [{"is_loose": False}, {"noise": 0.06}, {"doubt": 0.02}],
    ids=["dominant rows", "noise", "drift"],
)
def test_responses_that_something_else_explains_are_not_damped(explained):
    assert (after([1.0] * 200, **explained) == 1).all()


def test_less_noise_and_drift_than_that_explain_nothing():
    assert after([1.0] * 200, noise=0.04, doubt=0.005)[-1] == 0.3


def test_tiny_responses_are_at_rest():
    assert (after([5e-6] * 200) == 1).all()


# --- what it does ---------------------------------------------------------------------------------------------------


def test_only_loose_rows_are_damped_and_extrapolate_their_gradient():
    memory = remember(damping=0.5, steps=50, gradient=3.0)
    dominant, loose = (settling(own_side([1.0, beside], gradient=2.0), memory, 2) for beside in (0.9, 1.1))
    assert (dominant.is_loose.item(), dominant.damping.item(), dominant.expected.item()) == (False, 1.0, 0.0)
    assert (loose.is_loose.item(), loose.damping.item(), loose.expected.item()) == (True, 0.5, -1.0)
    slightly = settling(own_side([1.0, 1.1], gradient=2.0), memory | remember(damping=0.9, steps=50, gradient=3.0), 2)
    assert (slightly.damping.item(), slightly.expected.item()) == (0.9, 0.0)
    assert not settling(own_side([1.0, 1.1]), memory | {"steps": np.ones((1, 1))}, 2).is_loose.any()


def test_the_response_is_damped_and_answers_the_expected_gradient():
    own, drift = own_side([2.0, 0.0], gradient=4.0), np.zeros((1, 2))
    calm = Settling(np.ones((1, 1)), np.zeros((1, 1)), np.zeros((1, 1), dtype=bool))
    assert calm.response(own, drift).item() == pytest.approx(-2.0)
    damped = Settling(np.full((1, 1), 0.5), np.full((1, 1), -1.0), np.ones((1, 1), dtype=bool))
    assert damped.response(own, drift).item() == pytest.approx(-0.75)


def test_players_that_know_their_own_blocks_alone_are_not_damped():
    found = settling(own_side([1.0]), remember(damping=0.5, steps=50), 40)
    assert found.damping.item() == 1.0
    assert not found.is_loose.any()


# --- games that rotate ----------------------------------------------------------------------------------------------


def distance_at_the_deadline(law):
    """To the equilibrium of the rotating game, from 20 units away at most."""
    scenario = affine_scenario(ROTATION, [1.0, -2.0], fixed_part(1 - np.eye(2)))
    world, encoder = world_and_encoder(scenario)
    states = run(world, encoder, law(encoder.layout), loop_start(world))[..., 0]
    return np.abs(states[-1] - world.game.nash_equilibrium[:, None]).max()


def test_a_rotating_game_settles_with_damping_and_not_without(monkeypatch):
    assert distance_at_the_deadline(field_laws.ObserverRelay) < 1e-4
    assert distance_at_the_deadline(field_laws.ContactRelay) > 1.0
    monkeypatch.setattr(module, "_FACTOR", 1.0)
    assert distance_at_the_deadline(field_laws.ObserverRelay) > 1.0
