"""Inequality (24) of the proof of Theorem 1: eᵀ M e ≥ (a, b) O/2 (a, b)ᵀ, a and b the norms of two parts of e."""

import numpy as np
import pytest
from affine_games import AffineGame
from proof import proof_matrix

from ptne_env import theory
from ptne_env.theory import MonotonicityConstants
from ptne_env.world.graphs import complete, cycle, path

KAPPA = 3.0


def pursuit(players, strength=4.0):
    """A game in which every player pursues half of the others and flees the rest: ε = 1, and ι is large."""
    skew = np.triu(np.full((players, players), strength), 1)
    return AffineGame(np.eye(players) + skew - skew.T, np.ones(players))


def reduced_matrix(game, graph):
    return proof_matrix(theory.monotonicity_constants(game), graph.algebraic_connectivity, game.num_players, KAPPA)


def slack(game, graph, reduced):
    """The smallest eᵀ M e − (a, b) O/2 (a, b)ᵀ over unit errors e, in the worst mixture of both parts.

    Over e = a m ± b d with unit directions m and d it is a quadratic form in a, b ≥ 0. The directions are those that
    each entry of the matrix bounds, and random ones.
    """
    players, n = game.num_players, game.dimension
    matrix = theory.closed_loop_matrix(game, graph, KAPPA)
    symmetric = (matrix + matrix.T) / 2
    generator = np.random.default_rng(0)
    average = np.kron(np.full((players, players), 1 / players), np.eye(n))
    loose = (np.eye(players * n) - average) @ symmetric @ average
    left, _, right = np.linalg.svd(loose)
    means = [average @ generator.normal(size=players * n) for _ in range(20)] + [right[0]]
    rests = [(np.eye(players * n) - average) @ generator.normal(size=players * n) for _ in range(20)] + [left[:, 0]]
    slowest = np.linalg.eigh(graph.laplacian)[1][:, 1]
    rests.append(np.kron(slowest, np.eye(n)[0]))
    smallest = np.inf
    for mean in means:
        for rest in rests:
            basis = np.stack([mean / np.linalg.norm(mean), rest / np.linalg.norm(rest)], axis=1)
            for sign in (1.0, -1.0):
                form = (basis * [1.0, sign]).T @ symmetric @ (basis * [1.0, sign])
                smallest = min(smallest, least_on_quadrant(form - reduced))
    return smallest


def least_on_quadrant(form):
    """The smallest value of a quadratic form on unit vectors whose two entries are not negative."""
    return float(np.linalg.eigvalsh(form)[0] if form[0, 1] < 0 else np.diag(form).min())


def test_matrix_of_the_proof_by_hand():
    constants = MonotonicityConstants(2.0, 3.0, 1.0, exact=True, radius=None)
    expected = [[0.5, -1.5], [-1.5, 7.0]]  # ε/N = 2/4, ι/√N = 3/2, κλ2 − ι = 5·2 − 3
    np.testing.assert_allclose(proof_matrix(constants, 2.0, 4, 5.0), expected)


@pytest.mark.parametrize("graph", [path, cycle, complete])
@pytest.mark.parametrize("players", [3, 12])
def test_inequality_24_holds_for_the_worst_errors(graph, players):
    game = pursuit(players)
    assert slack(game, graph(players), reduced_matrix(game, graph(players))) >= -1e-9


@pytest.mark.parametrize("name", ["ι/N", "+ ι", "ε"])
def test_inequality_24_is_false_with_another_entry(name):
    game, graph = pursuit(12), cycle(12)
    constants, reduced = theory.monotonicity_constants(game), reduced_matrix(game, graph)
    if name == "ι/N":
        reduced[0, 1] = reduced[1, 0] = -constants.iota / 12
    elif name == "+ ι":
        reduced[1, 1] += 2 * constants.iota
    else:
        reduced[0, 0] = constants.epsilon
    assert slack(game, graph, reduced) < -0.01
