"""Recursive least squares against its closed form, and what is forgotten where a prediction fails."""

import numpy as np
import pytest

from ptne_env.laws.identification import Model, identify

ROWS, OUTPUTS, COMPONENTS, SPREAD = 4, 2, 5, 3.0
IS_OWN = np.arange(COMPONENTS)[None] < OUTPUTS


@pytest.fixture
def generator():
    return np.random.default_rng(0)


def begin(generator, spread=SPREAD):
    """A model after its first observation, which has told nothing about the rows."""
    start = generator.normal(size=(ROWS, COMPONENTS))
    shape = (ROWS, 1)
    nothing = Model(
        np.zeros((ROWS, OUTPUTS, COMPONENTS)),
        np.zeros((ROWS, COMPONENTS, COMPONENTS)),
        *(np.zeros(shape), np.zeros_like(start), np.zeros((ROWS, OUTPUTS)), np.zeros(shape), np.zeros(shape)),
    )
    return identify(nothing, start, np.zeros((ROWS, OUTPUTS)), np.full(shape, spread), np.ones(shape), IS_OWN)


def feed(model, displacements, changes):
    """The model after estimates have moved by displacements (S, R, n) and gradients by changes (S, R, m)."""
    for displacement, change in zip(displacements, changes, strict=True):
        estimate, gradient = model.estimate + displacement, model.gradient + change
        model = identify(model, estimate, gradient, model.widest, model.radius, IS_OWN)
    return model


def draw(generator, steps):
    """True rows, displacements, and the changes of the gradient."""
    rows = generator.normal(size=(ROWS, OUTPUTS, COMPONENTS))
    displacements = generator.normal(size=(steps, ROWS, COMPONENTS))
    return rows, displacements, np.einsum("rmn,srn->srm", rows, displacements)


def test_rows_are_known_after_as_many_displacements_as_components(generator):
    rows, displacements, changes = draw(generator, COMPONENTS)
    before, after = (
        feed(begin(generator), displacements[:-1], changes[:-1]),
        feed(begin(generator), displacements, changes),
    )
    assert np.abs(before.rows - rows).max() > 0.1
    assert after.rows == pytest.approx(rows, abs=1e-4)


def test_rows_are_the_least_norm_fit_before(generator):
    """Without a unique fit the smallest rows count, because the prior has mean 0 and equal variances."""
    _, displacements, changes = draw(generator, 3)
    model = feed(begin(generator), displacements, changes)
    for row in range(ROWS):
        expected = np.linalg.pinv(displacements[:, row]) @ changes[:, row]
        assert model.rows[row] == pytest.approx(expected.T, abs=1e-4)
        unknown = np.eye(COMPONENTS) - np.linalg.pinv(displacements[:, row]) @ displacements[:, row]
        assert model.covariance[row] == pytest.approx(SPREAD**2 * unknown, abs=1e-4)


def test_changed_rows_are_learned_in_the_direction_of_the_displacement_alone(generator):
    rows, displacements, changes = draw(generator, 30)
    before = feed(begin(generator), displacements, changes)
    direction = generator.normal(size=(ROWS, COMPONENTS))
    change = np.einsum("rmn,rn->rm", rows, direction) + 50.0
    after = feed(before, direction[None], change[None])
    learned = after.rows - before.rows
    assert np.einsum("rmn,rn->rm", after.rows, direction) == pytest.approx(change, rel=0.01)
    along = np.einsum("rmn,rn->rm", learned, direction) / np.linalg.norm(direction, axis=1)[:, None]
    assert np.linalg.norm(learned, axis=2) == pytest.approx(np.abs(along), rel=0.01)
    assert after.radius == pytest.approx(np.abs(direction[:, :OUTPUTS]).max(axis=1)[:, None] / 2)


def test_without_a_displacement_nothing_is_learned_or_forgotten(generator):
    _, displacements, changes = draw(generator, 8)
    before = feed(begin(generator), displacements, changes)
    after = feed(before, np.zeros((1, ROWS, COMPONENTS)), np.full((1, ROWS, OUTPUTS), 9.0))
    np.testing.assert_array_equal(after.rows, before.rows)
    np.testing.assert_array_equal(after.covariance, before.covariance)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e6])
@pytest.mark.parametrize("spread", [1e-3, 10.0, 1e7])
def test_covariance_stays_positive_and_bounded_in_every_unit(generator, scale, spread):
    """Also where displacements shrink to nothing, and where predictions fail again and again."""
    model = begin(generator, spread)
    for step in range(400):
        displacement = scale * generator.normal(size=(ROWS, COMPONENTS)) * 0.9 ** (step % 150)
        change = 3 * displacement[:, :OUTPUTS] * (1 + (step % 7 == 6) * generator.normal(size=(ROWS, OUTPUTS)))
        model = feed(model, displacement[None], change[None])
        values, widest = np.linalg.eigvalsh(model.covariance), model.widest**2
        assert (values > -1e-9 * widest).all()
        assert (values < COMPONENTS * widest).all()
    assert np.isfinite(model.rows).all()


@pytest.mark.parametrize("spread", [1e3, 1e7])
def test_covariance_stays_positive_where_nearly_all_moves_have_one_direction(generator, spread):
    """Without a floor of the variance, rounding of float64 makes eigenvalues as negative as −1e9 times the largest."""
    model = begin(generator, spread)
    for _ in range(200):
        displacement = generator.normal(size=(ROWS, COMPONENTS)) * [1.0, 1e-4, 1e-8, 1e-8, 1e-8]
        model = feed(model, displacement[None], 3 * displacement[None, :, :OUTPUTS])
        assert (np.linalg.eigvalsh(model.covariance) > -1e-9 * model.widest**2).all()
    assert model.rows[:, :, 0] == pytest.approx(np.tile([3.0, 0.0], (ROWS, 1)), abs=1e-3)
