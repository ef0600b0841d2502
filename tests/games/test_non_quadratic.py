import math

import numpy as np
import pytest
from derivatives import gradient_error

from ptne_env.games import NoBestResponseError, NonQuadraticGame
from ptne_env.theory import check_costs


@pytest.mark.parametrize(
    ("variant", "printed", "exact"),
    [
        ("printed", [-3.38629, 1.38629, 0, -0.5, 2.5], [-2 - 2 * math.log(2), 2 * math.log(2), 0, -0.5, 2.5]),
        ("corrected", [-4.6589, 4.1589, 0, -2, 2.5], [-0.5 - 6 * math.log(2), 6 * math.log(2), 0, -2, 2.5]),
    ],
)
def test_the_corrected_variant_alone_has_the_printed_equilibrium(variant, printed, exact):
    found = NonQuadraticGame(variant).nash_equilibrium
    assert found == pytest.approx(printed, abs=5e-5)
    assert found == pytest.approx(exact, abs=1e-10)


@pytest.mark.parametrize(("variant", "slope"), [("printed", 1.0), ("corrected", 4.0)])
def test_costs_are_those_of_the_paper(variant, slope):
    x1, x2, x3, x4, x5 = x = np.array([1.5, -2.0, 0.5, 0.75, -1.25])
    expected = [
        x1**2 / 2 + x1 * (x2 + x3 + x4 + x5),
        math.exp(x2 / 2) / 2 + x2 * x4,
        x3**2 / 2 + x1**3,
        math.log(math.exp(slope * x4)) + x4**2 + x3**3,
        x5**2 - 5 * x5 + x1**3 * x2 + x3 * x4**4,
    ]
    assert NonQuadraticGame(variant).costs(x[:, None])[:, 0] == pytest.approx(expected, rel=1e-13)


def test_only_the_second_cost_is_not_radially_unbounded():
    assert gradient_error(NonQuadraticGame()) < 1e-9
    assert check_costs(NonQuadraticGame())[1].tolist() == [True, False, True, True, True]


def test_best_response_and_regrets_are_refused_with_a_reason():
    game, x = NonQuadraticGame(), np.zeros((5, 1))
    with pytest.raises(NoBestResponseError, match="NonQuadraticGame has no best response"):
        game.best_response(x)
    with pytest.raises(NoBestResponseError, match="NonQuadraticGame has no best response"):
        game.regrets(x)
    assert not game.has_best_response


def test_unknown_variant_is_refused():
    with pytest.raises(ValueError, match="unknown variant 'fixed'; choose from printed, corrected"):
        NonQuadraticGame("fixed")
