"""What laws ask of a scenario, and that their theorems hold where they say so, on random affine games."""

import numpy as np
import pytest
from affine_games import affine_scenario, random_affine
from worlds import BLOCKS, fixed_part, loop_matrix

from ptne_env import CATALOGUE, FactorySpec, get_scenario, laws, theory
from ptne_env.theory import condition, problem_constants
from ptne_env.world import World

RANDOM = range(40)


def random_scenario(seed):
    matrix, offset, adjacency = random_affine(np.random.default_rng(seed), 3 + seed % 3, coupling=3.0)
    return affine_scenario(matrix, offset, fixed_part(adjacency)), adjacency


def positive_definite(matrix):
    return np.linalg.eigvalsh(matrix + matrix.T)[0] > 0


def test_conditions_are_decided_by_the_constants_of_the_theory():
    scenario = get_scenario("energy")
    certificate = theory.certify(scenario, kappa=2.0)
    static = condition(laws.Static, scenario)
    assert static == certificate.condition
    assert static.bound == theory.gain_bound(certificate.constants, certificate.algebraic_connectivity)
    assert (static.value, static.holds, static.exact) == (2.0, False, True)
    assert condition(FactorySpec.of("ptne_env.laws:Static", kappa=static.bound * 1.001), scenario).holds
    scaled = condition(FactorySpec.of("ptne_env.laws:Static", kappa=8.0, gradient_gain=4.0), scenario)
    assert scaled == static  # the same law for scaled costs


@pytest.mark.parametrize("scenario", ["energy", "non-quadratic", BLOCKS], ids=str)
def test_premises_have_the_loop_matrix_of_the_theory(scenario):
    scenario = get_scenario(scenario)
    facts = problem_constants(scenario)
    expected = theory.closed_loop_matrix(World(scenario).game, World(scenario).topology.graphs[0], 1.7)
    assert np.array_equal(facts.loop(facts.laplacians[0], 1.7), expected)
    assert facts.exact == World(scenario).game.is_affine


def test_what_recurs_depends_on_the_clock_of_the_signal():
    assert problem_constants(get_scenario("energy-switching")).recurring_connectivity == 0
    transformed = problem_constants(get_scenario("energy-switching-transformed"))
    assert transformed.recurring_connectivity == pytest.approx(4 * np.sin(np.pi / 5) ** 2)
    assert transformed.connectivity == 0
    assert not condition(laws.Adaptive, get_scenario("energy-switching")).holds
    assert condition(laws.Adaptive, get_scenario("energy-switching-transformed")).holds
    assert not condition(laws.Static, get_scenario("energy-switching-transformed")).holds


LAWS = [
    law for law in vars(laws).values() if isinstance(law, type) and issubclass(law, laws.Law) and law is not laws.Law
]


@pytest.mark.parametrize("scenario", CATALOGUE)
@pytest.mark.parametrize("law", LAWS)
def test_every_law_says_whether_a_scenario_meets_its_condition(law, scenario):
    if law is laws.BestResponseOracle and "non-quadratic" in scenario:
        with pytest.raises(ValueError, match="best_response cannot be observed: NonQuadraticGame has none everywhere"):
            condition(law, get_scenario(scenario))
        return
    if law is laws.AggregateTracking and len(set(World(get_scenario(scenario)).game.action_dims)) > 1:
        with pytest.raises(ValueError, match="AggregateTracking adds strategies up: equal dimensions, got"):
            condition(law, get_scenario(scenario))
        return
    found = condition(law, get_scenario(scenario))
    if law in (laws.ZeroInput, laws.CentralisedOracle):
        assert found is None
        return
    assert isinstance(found, laws.Condition)
    assert found.name
    assert found.holds in (True, False)
    if "non-quadratic" in scenario:
        assert not found.holds  # F is not monotone there


@pytest.mark.parametrize("seed", RANDOM)
def test_fixed_gain_of_bianchi_and_grammatico_makes_the_loop_strongly_monotone(seed):
    """Their theorem in its key inequality (𝐱 − 1⊗x*)ᵀ M (𝐱 − 1⊗x*) > 0, for affine games M + Mᵀ ≻ 0."""
    scenario, adjacency = random_scenario(seed)
    bound = condition(laws.FixedGain, scenario).bound
    assert bound <= condition(laws.Static, scenario).bound  # weaker than the paper's
    kappa = 1.0001 * bound
    assert condition(FactorySpec.of("ptne_env.laws:FixedGain", kappa=kappa), scenario).holds
    assert positive_definite(loop_matrix(World(scenario).game, adjacency, kappa))


def test_fixed_gain_condition_does_not_hold_for_nothing():
    """Far below the bound some of the random games lose what the theorem promises."""
    lost = 0
    for seed in RANDOM:
        scenario, adjacency = random_scenario(seed)
        kappa = 0.05 * condition(laws.FixedGain, scenario).bound
        lost += not positive_definite(loop_matrix(World(scenario).game, adjacency, kappa))
    assert lost > 5


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
    """V = ½‖x − x*‖² + ½‖y‖² in the coordinates x and y^i_j = x^i_j − x_j, as :class:`Grounded` derives it."""
    scenario, adjacency = random_scenario(seed)
    kappa = 1.0001 * condition(laws.Grounded, scenario).bound
    game, n = World(scenario).game, World(scenario).game.dimension
    matrix = grounded_matrix(game, adjacency, kappa)
    own = [i * n + i for i in range(n)]
    to_original = np.eye(n * n)  # of (x, y)
    for i in range(n):
        for j in range(n):
            to_original[i * n + j, j * n + j] = 1
    assert positive_definite(np.linalg.solve(to_original, matrix @ to_original))
    assert np.linalg.eigvals(matrix).real.min() > 0
    assert np.array_equal(matrix[own][:, own], np.diag(np.diag(game.matrix)))
