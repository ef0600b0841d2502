"""Conditions of the laws' theorems, and the theorems where the conditions hold, on random affine games."""

import numpy as np
import pytest
from affine_games import SOAK, affine_scenario, random_affine
from sample_laws import condition_on
from worlds import fixed_part, loop_matrix

from ptne_env import CATALOGUE, get_scenario, laws, theory
from ptne_env.world.world import World

RANDOM = range(200 if SOAK else 20)


def random_world(seed):
    matrix, offset, adjacency = random_affine(np.random.default_rng(seed), 3 + seed % 3, coupling=3.0)
    scenario = affine_scenario(matrix, offset, fixed_part(adjacency))
    return scenario, World(scenario).game, adjacency


def positive_definite(matrix):
    return np.linalg.eigvalsh(matrix + matrix.T)[0] > 0


def test_conditions_are_decided_by_the_constants_of_the_theory():
    certificate = theory.certify(get_scenario("energy"), kappa=2.0)
    static = condition_on("energy", laws.Static)
    assert static == certificate.condition
    assert static.bound == theory.gain_bound(certificate.constants, certificate.algebraic_connectivity)
    assert (static.value, static.holds, static.exact) == (2.0, False, True)
    assert condition_on("energy", laws.Static, kappa=static.bound * 1.001).holds
    scaled = condition_on("energy", laws.Static, kappa=8.0, gradient_gain=4.0)
    assert scaled == static  # the same law for scaled costs


@pytest.mark.parametrize("scenario", ["energy", "non-quadratic"])
def test_a_law_of_a_user_registers_its_condition(scenario):
    class Mine(laws.ZeroInput):
        """A law with a theorem of its own."""

    @theory.condition.register
    def condition_of_mine(law: Mine, constants: theory.ProblemConstants) -> theory.Condition:
        return theory.Condition.below("exact", float(not constants.exact), 0.5)

    world = World(CATALOGUE[scenario])
    found = theory.condition(theory.build_law(Mine, world), theory.problem_constants(world))
    assert found.holds == world.game.is_affine
    assert condition_on(scenario, laws.ZeroInput) is None


def test_recurring_graphs_depend_on_the_clock_of_the_topology():
    assert theory.problem_constants(World(CATALOGUE["energy-switching"])).recurring_connectivity == 0
    transformed = theory.problem_constants(World(CATALOGUE["energy-switching-transformed"]))
    assert transformed.recurring_connectivity == pytest.approx(4 * np.sin(np.pi / 5) ** 2)
    assert transformed.connectivity == 0
    assert not condition_on("energy-switching", laws.Adaptive).holds
    assert condition_on("energy-switching-transformed", laws.Adaptive).holds
    assert not condition_on("energy-switching-transformed", laws.Static).holds


LAWS = [
    law for law in vars(laws).values() if isinstance(law, type) and issubclass(law, laws.Law) and law is not laws.Law
]


@pytest.mark.parametrize("scenario", CATALOGUE)
@pytest.mark.parametrize("law", LAWS)
def test_every_law_has_a_condition_on_every_scenario_or_none_at_all(law, scenario):
    found = condition_on(scenario, law)
    if law in (laws.ZeroInput, laws.CentralisedOracle):
        assert found is None
        return
    assert isinstance(found, theory.Condition)
    assert found.name
    assert found.holds in (True, False)
    if "non-quadratic" in scenario:
        assert not found.holds  # F is not monotone there


@pytest.mark.parametrize("seed", RANDOM)
def test_fixed_gain_condition_makes_the_loop_strongly_monotone(seed):
    """Their theorem in its key inequality (𝐱 − 1⊗x*)ᵀ M (𝐱 − 1⊗x*) > 0, for affine games M + Mᵀ ≻ 0."""
    scenario, game, adjacency = random_world(seed)
    bound = condition_on(scenario, laws.FixedGain).bound
    assert bound <= condition_on(scenario, laws.Static).bound  # weaker than the paper's
    kappa = 1.0001 * bound
    assert condition_on(scenario, laws.FixedGain, kappa=kappa).holds
    assert positive_definite(loop_matrix(game, adjacency, kappa))


def test_far_below_the_fixed_gain_bound_some_games_lose_the_theorem():
    lost = 0
    for seed in RANDOM:
        scenario, game, adjacency = random_world(seed)
        kappa = 0.05 * condition_on(scenario, laws.FixedGain).bound
        lost += not positive_definite(loop_matrix(game, adjacency, kappa))
    assert lost > len(RANDOM) / 8


def grounded_matrix(game, adjacency, kappa):
    """The loop of Ye & Hu's law: own components follow own gradients, the others leader–follower consensus."""
    n = game.dimension
    laplacian = np.diag(adjacency.sum(axis=1)) - adjacency
    matrix = kappa * np.kron(laplacian, np.eye(n))
    jacobian = game.jacobian(np.zeros((n, 1)))[:, :, 0]
    for i in range(n):
        for j in range(n):
            if i != j:
                matrix[i * n + j, i * n + j] += kappa * adjacency[i, j]
                matrix[i * n + j, j * n + j] -= kappa * adjacency[i, j]
        matrix[i * n + i] = 0
        matrix[i * n + i, i * n : (i + 1) * n] = jacobian[i]
    return matrix


@pytest.mark.parametrize("seed", RANDOM)
def test_gain_of_ye_and_hu_makes_their_lyapunov_function_decrease(seed):
    """V = ½‖x − x*‖² + ½‖y‖² in the coordinates x and y^i_j = x^i_j − x_j, as in the condition of :class:`Grounded`."""
    scenario, game, adjacency = random_world(seed)
    kappa = 1.0001 * condition_on(scenario, laws.Grounded).bound
    n = game.dimension
    matrix = grounded_matrix(game, adjacency, kappa)
    own = [i * n + i for i in range(n)]
    to_original = np.eye(n * n)  # of (x, y)
    for i in range(n):
        for j in range(n):
            to_original[i * n + j, j * n + j] = 1
    assert positive_definite(np.linalg.solve(to_original, matrix @ to_original))
    assert np.linalg.eigvals(matrix).real.min() > 0
    assert np.array_equal(matrix[own][:, own], np.diag(np.diag(game.matrix)))
