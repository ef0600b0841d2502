"""The solver on problems with known solutions, or solutions from enumeration of the active sets."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptne_env.games import ElectricVehicleCharging
from ptne_env.games.variational import natural_map, solve_box


def by_enumeration(matrix, offset, low, high):
    """The solution of the affine problem: the choice of free, low or high components that satisfies it."""
    size = len(offset)
    for choice in itertools.product((-1, 0, 1), repeat=size):
        held = np.array(choice) != 0
        x = np.where(np.array(choice) < 0, low, high).astype(float)
        free = ~held
        if free.any():
            x[free] = np.linalg.solve(
                matrix[np.ix_(free, free)], -(offset[free] + matrix[np.ix_(free, held)] @ x[held])
            )
        value = matrix @ x + offset
        fits = np.where(held, np.array(choice) * value <= 0, (x >= low) & (x <= high))
        if fits.all():
            return x
    raise AssertionError("no active set fits")


def affine(matrix, offset):
    """Field and Jacobian of one affine problem."""
    return lambda x: matrix @ x + offset[:, None], lambda x: np.repeat(matrix[:, :, None], x.shape[1], axis=2)


def unknown(x):
    """No step of Newton follows from it."""
    return np.full((len(x), *x.shape), np.nan)


@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.sampled_from([0.0, 1.0, 10.0]))
def test_affine_problems_agree_with_enumeration_of_active_sets(seed, size, asymmetry):
    generator = np.random.default_rng(seed)
    root = generator.normal(size=(size, size))
    skew = generator.normal(size=(size, size))
    matrix = root @ root.T / size + 0.3 * np.eye(size) + asymmetry * (skew - skew.T)
    offset = 5 * generator.normal(size=size)
    low, high = -generator.uniform(0.1, 2, size), generator.uniform(0.1, 2, size)
    found = solve_box(*affine(matrix, offset), low[:, None], high[:, None], np.zeros((size, 1)))[:, 0]
    assert found == pytest.approx(by_enumeration(matrix, offset, low, high), abs=1e-10)


@pytest.mark.parametrize("known", [True, False])
def test_problem_that_is_not_affine_is_solved(known):
    # x³ + x + y − 2 = 0, with y held at its bound y ≥ 0: x = 1, y = 0
    def field(x):
        return np.stack([x[0] ** 3 + x[0] + x[1] - 2, x[1] - x[0] + 2])

    def jacobian(x):
        one = np.ones_like(x[0])
        return np.array([[3 * x[0] ** 2 + 1, one], [-one, one]])

    box = np.zeros((2, 1)), np.full((2, 1), np.inf)
    found = solve_box(field, jacobian if known else unknown, *box, np.full((2, 1), 7.0))
    assert found[:, 0] == pytest.approx([1.0, 0.0], abs=1e-11)


def test_rotation_is_solved():
    matrix, offset = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([-1.0, 1.0])
    field, jacobian = affine(matrix, offset)
    bounds = np.full((2, 1), -10.0), np.full((2, 1), 10.0)
    for derivative in (jacobian, unknown):
        found = solve_box(field, derivative, *bounds, np.array([[5.0], [-3.0]]))
        assert found[:, 0] == pytest.approx([1.0, 1.0], abs=1e-10)


def test_singular_newton_system_does_not_affect_other_problems():
    # The first problem is flat in one direction: Newton's system is singular, so an extragradient step is taken.
    flat, regular = np.diag([0.0, 1.0]), np.array([[2.0, 1.0], [1.0, 2.0]])
    matrices, offsets = np.stack([flat, regular], axis=-1), np.array([[-1.0, -3.0], [-1.0, -3.0]])

    def field(x):
        return np.einsum("ijb,jb->ib", matrices, x) + offsets

    found = solve_box(field, lambda _: matrices, np.zeros((2, 1)), np.full((2, 1), 4.0), np.ones((2, 2)))
    assert found[:, 0] == pytest.approx([4.0, 1.0], abs=1e-11)
    assert found[:, 1] == pytest.approx([1.0, 1.0], abs=1e-11)


def test_natural_map_vanishes_exactly_at_solutions():
    low, high = np.zeros((2, 1)), np.ones((2, 1))
    assert not natural_map(np.array([[0.0], [1.0]]), np.array([[3.0], [-2.0]]), low, high).any()
    assert natural_map(np.array([[0.0], [1.0]]), np.array([[-3.0], [0.5]]), low, high)[:, 0] == pytest.approx([-1, 0.5])


def test_a_solution_does_not_depend_on_the_others_of_its_batch():
    game = ElectricVehicleCharging()
    strategies = np.random.default_rng(0).uniform(0, 2, (game.dimension, 300))
    alone = [game.best_response(column[:, None]) for column in strategies.T]
    assert np.array_equal(game.best_response(strategies), np.concatenate(alone, axis=1))
