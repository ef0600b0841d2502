"""Recursive least squares against its closed form, and what is forgotten where a prediction fails."""

import numpy as np
import pytest

from ptne_env.laws.building_blocks.own_gradient import Model, identify

ROWS, OUTPUTS, REGRESSORS, SPREAD, VARIANCE = 4, 2, 5, 3.0, 0.01


@pytest.fixture
def generator():
    return np.random.default_rng(0)


def unknown_rows(spread=SPREAD):
    covariance = np.broadcast_to(spread**2 * np.eye(REGRESSORS), (ROWS, REGRESSORS, REGRESSORS))
    return Model(np.zeros((ROWS, OUTPUTS, REGRESSORS)), covariance)


def feed(model, displacements, changes):
    failures = []
    for displacement, change in zip(displacements, changes, strict=True):
        model, _, failed = identify(model, displacement, change, np.full((len(change), 1), VARIANCE))
        failures.append(failed)
    return model, np.array(failures)


def draw(generator, steps):
    """True rows, displacements, and the changes of the gradient with a little noise."""
    rows = generator.normal(size=(ROWS, OUTPUTS, REGRESSORS))
    displacements = generator.normal(size=(steps, ROWS, REGRESSORS))
    noise = generator.uniform(-0.1, 0.1, (steps, ROWS, OUTPUTS))
    return rows, displacements, np.einsum("rmq,srq->srm", rows, displacements) + noise


def test_model_is_the_regularised_least_squares_fit(generator):
    _, displacements, changes = draw(generator, 12)
    model, failures = feed(unknown_rows(), displacements, changes)
    assert not failures.any()
    for row in range(ROWS):
        information, target = np.eye(REGRESSORS) / SPREAD**2, np.zeros((OUTPUTS, REGRESSORS))
        for phi, y in zip(displacements[:, row], changes[:, row], strict=True):
            information += np.outer(phi, phi) / VARIANCE
            target += np.outer(y, phi) / VARIANCE
        assert model.covariance[row] == pytest.approx(np.linalg.inv(information), rel=1e-6, abs=1e-10)
        assert model.rows[row] == pytest.approx(target @ np.linalg.inv(information), abs=1e-8)


def test_changed_rows_are_learned_in_the_direction_of_the_displacement_alone(generator):
    rows, displacements, changes = draw(generator, 30)
    before, _ = feed(unknown_rows(), displacements, changes)
    direction = generator.normal(size=(ROWS, REGRESSORS))
    change = np.einsum("rmq,rq->rm", rows, direction) + 50.0
    after, error, failed = identify(before, direction, change, np.full((ROWS, 1), VARIANCE))
    assert failed.all()
    assert error == pytest.approx(50, abs=2)
    assert np.einsum("rmq,rq->rm", after.rows, direction) == pytest.approx(change, rel=0.01)
    learned = after.rows - before.rows
    along = np.einsum("rmq,rq->rm", learned, direction) / np.linalg.norm(direction, axis=1)[:, None]
    assert np.linalg.norm(learned, axis=2) == pytest.approx(np.abs(along), rel=0.01)


def test_without_a_displacement_nothing_is_learned_or_forgotten(generator):
    _, displacements, changes = draw(generator, 8)
    before, _ = feed(unknown_rows(), displacements, changes)
    still = np.zeros((ROWS, REGRESSORS))
    after, _, failed = identify(before, still, np.full((ROWS, OUTPUTS), 9.0), np.full((ROWS, 1), VARIANCE))
    assert not failed.any()
    for old, new in zip(before, after, strict=True):
        np.testing.assert_array_equal(old, new)


def test_covariance_stays_positive_over_a_long_run(generator):
    model = unknown_rows(10.0)
    for step in range(400):
        displacement = generator.normal(size=(ROWS, REGRESSORS)) * 0.9**step
        change = 3 * displacement[:, :OUTPUTS]
        model, _, _ = identify(model, displacement, change, np.full((ROWS, 1), 1e-12))
    assert np.linalg.eigvalsh(model.covariance).min() > -1e-12
    assert model.rows == pytest.approx(np.broadcast_to(3 * np.eye(OUTPUTS, REGRESSORS), model.rows.shape), abs=1e-6)
    assert isinstance(model, Model)
