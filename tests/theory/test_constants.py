"""ε, ι and the gain condition of the paper, by hand and against definitions."""

import math

import numpy as np
import pytest
from proof import proof_matrix
from sample_games import BlockGame

from ptne_env import theory
from ptne_env.games import EnergyGame, Game, NonQuadraticGame
from ptne_env.world.graphs import cycle


class Unknown(BlockGame):
    """A block game that does not know its Jacobian."""

    def jacobian(self, strategies):
        return Game.jacobian(self, strategies)


def test_constants_of_the_energy_game_are_exact():
    constants = theory.monotonicity_constants(EnergyGame())
    assert constants.exact
    assert constants.epsilon == pytest.approx(2.1, abs=1e-12)
    assert constants.iota_strategies == pytest.approx(2.6, abs=1e-12)
    assert constants.iota_estimates == pytest.approx(math.sqrt(2.2**2 + 4 * 0.1**2), abs=1e-12)


def test_constants_of_another_game_are_labelled_as_sampled():
    near = theory.monotonicity_constants(NonQuadraticGame(), radius=5.0)
    far = theory.monotonicity_constants(NonQuadraticGame(), radius=30.0)
    assert (near.exact, near.radius) == (False, 5.0)
    assert near.epsilon < 0  # so F is refuted to be monotone
    assert far.iota > 100 * near.iota  # and no Lipschitz constant is in sight


def test_constants_without_a_jacobian_come_from_differences():
    game = Unknown()
    constants = theory.monotonicity_constants(game)
    assert constants.epsilon == pytest.approx(np.linalg.eigvalsh(game.matrix + game.matrix.T)[0] / 2, rel=1e-8)
    assert constants.iota_strategies == pytest.approx(np.linalg.norm(game.matrix, 2), rel=1e-8)
    rows = [np.linalg.norm(game.matrix[game.owners == i], 2) for i in range(3)]
    assert constants.iota_estimates == pytest.approx(max(rows), rel=1e-8)


def test_lipschitz_constant_of_estimates_bounds_the_stacked_gradient():
    game, generator = BlockGame(), np.random.default_rng(0)
    constants = theory.monotonicity_constants(game)
    x, y = generator.normal(size=(2, 6, 3, 200))
    change = game.own_gradients(x) - game.own_gradients(y)
    size = np.sqrt(((x - y) ** 2).sum(axis=(0, 1)))
    assert np.all(np.linalg.norm(change, axis=0) <= constants.iota_estimates * size * (1 + 1e-9))


@pytest.mark.parametrize("arguments", [{"radius": 0.0}, {"radius": math.inf}])
def test_constants_refuse_bad_sampling(arguments):
    with pytest.raises(ValueError, match="must be"):
        theory.monotonicity_constants(NonQuadraticGame(), **arguments)


def test_gain_condition_of_the_paper():
    constants, ring = theory.monotonicity_constants(EnergyGame()), cycle(5).algebraic_connectivity
    assert theory.gain_bound(constants, ring) == pytest.approx((2.6**2 / 2.1 + 2.6) / ring, rel=1e-12)
    assert theory.gain_bound(constants, ring) == pytest.approx(4.2107, abs=1e-4)
    assert theory.gain_bound(constants, 0.0) == math.inf
    assert theory.gain_bound(theory.monotonicity_constants(NonQuadraticGame()), ring) == math.inf


def test_the_gain_condition_is_that_the_matrix_of_the_proof_is_positive_definite():
    constants, ring = theory.monotonicity_constants(EnergyGame()), cycle(5)
    bound = theory.gain_bound(constants, ring.algebraic_connectivity)

    def rate(kappa):
        return np.linalg.eigvalsh(proof_matrix(constants, ring.algebraic_connectivity, 5, kappa))[0]

    assert rate(0.999 * bound) < 0 < rate(1.001 * bound)
    matrix = theory.closed_loop_matrix(EnergyGame(), ring, 10.0)
    assert rate(10.0) <= np.linalg.eigvalsh((matrix + matrix.T) / 2)[0] <= theory.spectral_abscissa(matrix)
