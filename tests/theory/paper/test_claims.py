"""The paper's claims and docs/errata.md: verdicts and measured numbers."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ptne_env.games import NonQuadraticGame
from ptne_env.theory.paper import Experiments, table_one
from ptne_env.theory.paper import claims as claims_module
from ptne_env.theory.paper.claims import VANISHED, lemma_1, proposition_1, theorem_1, theorem_3
from ptne_env.theory.paper.table import misfits
from ptne_env.world.clock import Exponential
from ptne_env.world.graphs import Graph, cycle, path
from ptne_env.world.switching import fixed, paper_topology


def test_table_one(experiments):
    gadjov_pavel, corollary, proposed = table_one(experiments)
    assert (gadjov_pavel.paper, corollary.paper, proposed.paper) == (21.0, 13.0, 1.2)
    assert gadjov_pavel.ours == pytest.approx(21.6, abs=0.1)
    assert corollary.ours == pytest.approx(13.2, abs=0.1)
    assert proposed.ours is not None
    assert proposed.ours < 1.2
    assert proposed.at_paper_time < 0.005


def test_verdicts(claims):
    fails = {name for name, claim in claims.items() if claim.verdict == "fails"}
    assert fails == {
        "Theorem 2, smoothness of u",
        "Theorem 2, boundedness of the plant's input",
        "Theorem 4, dwelling in t (as stated)",
    }
    assert len(claims) == 20


def test_theorem_2_holds_except_for_smoothness_and_the_velocity(claims):
    hold = claims["Theorem 2, hold"].measured
    assert hold["largest_error_after"] <= hold["error_at_deadline"] < VANISHED
    assert claims["Theorem 2, boundedness of u"].measured["exponent"] > 0
    for name in ("Theorem 2, smoothness of u", "Theorem 2, boundedness of the plant's input"):
        assert claims[name].measured["exponent"] == pytest.approx(0.28 - 1, abs=0.01)
        assert claims[name].measured["exponent_above_gain_condition"] < 0


def test_erratum_1_example_2_has_another_equilibrium(claims):
    measured = claims["Erratum 1, equilibrium of Example 2"].measured
    others = [2 * math.log(2), 0.0, -0.5, 2.5]
    printed = [-sum(others), *others]
    np.testing.assert_allclose(measured["equilibrium_printed"], printed, atol=1e-10)
    np.testing.assert_allclose(measured["equilibrium_printed"], [-3.38629, 1.38629, 0, -0.5, 2.5], atol=5e-6)
    np.testing.assert_allclose(measured["equilibrium_corrected"], [-4.6589, 4.1589, 0, -2, 2.5], atol=5e-5)
    assert measured["gradient_at_claimed"]["printed"] == pytest.approx(3.0, abs=1e-3)
    assert measured["gradient_at_claimed"]["corrected"] < 1e-3


def test_erratum_1_example_2_violates_assumptions_3_and_4(claims):
    measured = claims["Erratum 1, assumptions of Example 2"].measured
    assert measured["epsilon"] < 0
    assert measured["iota_within_40"] > 10 * measured["iota_within_10"]
    assert measured["radially_unbounded"][1] is False
    assert measured["estimate_of_x4_positive_until"] > 0
    x = np.zeros((5, 3))
    x[1], x[3] = [-1e2, -1e3, -1e4], 5.0  # with x4 ≥ 0, J2 decreases without bound in x2
    assert np.all(np.diff(NonQuadraticGame().costs(x)[1]) < 0)


def test_erratum_2_error_at_the_deadline_shrinks_with_the_period(claims):
    measured = claims["Erratum 2, switching in t"].measured
    assert measured["periods"] == [0.8, 0.4, 0.2, 0.1]
    errors = measured["error_at_deadline"]
    assert errors == pytest.approx([0.31, 0.090, 0.023, 0.0046], rel=0.05)
    assert measured["switches_before_deadline"] == [5, 11, 23, 47]
    assert measured["error_at_deadline_transformed"] < VANISHED
    stated = claims["Theorem 4, dwelling in t (as stated)"].measured["error_at_s"]
    assert stated["60"] == pytest.approx(stated["15"], rel=1e-3)  # the error is constant
    there = claims["Theorem 4, dwelling in s"].measured["error_at_s"]
    assert there["60"] < 1e-3 * there["30"] < 1e-4 * there["8"]


def test_erratum_3_velocity_and_energy_diverge(claims):
    measured = claims["Erratum 3, velocity near T"].measured
    assert measured["rate"] == pytest.approx(0.2801, abs=1e-4)
    assert measured["velocity_exponent"] == pytest.approx(measured["rate"] - 1, abs=0.01)
    assert measured["input_derivative_exponent"] == pytest.approx(measured["rate"] - 1, abs=0.01)
    assert measured["energy_growth"] == pytest.approx(1 - 2 * measured["rate"], abs=0.01)


def test_erratum_4_the_gain_violates_the_condition_on_most_graphs(claims):
    measured = claims["Erratum 4, the gain of the simulations"].measured
    assert measured["gain_bound_on_cycle"] == pytest.approx(4.2107, abs=1e-4)
    assert measured["least_connectivity"] == pytest.approx(2.91, abs=0.005)
    assert measured["graphs"] == 21
    assert measured["slowest_rate"] > 0


def test_erratum_4_no_graph_with_a_larger_connectivity_comes_near_table_one(claims):
    measured = claims["Erratum 4, the gain of the simulations"].measured
    assert (measured["labelled_graphs"], measured["labelled_graphs_with_larger_connectivity"]) == (728, 26)
    assert measured["labelled_graphs_within_5_percent"] == 304
    assert measured["smallest_deviation_with_larger_connectivity"] == pytest.approx(0.0796, abs=1e-4)


def test_misfit_of_the_cycle_is_that_of_table_one(experiments):
    gadjov_pavel, corollary, _ = table_one(experiments)
    deviation = max(gadjov_pavel.ours / 21 - 1, corollary.ours / 13 - 1)
    assert misfits(experiments, [cycle(5)], np.array([0.005])) == pytest.approx([deviation], rel=1e-3)
    assert misfits(experiments, [cycle(5)], np.geomspace(1e-4, 5e-2, 101)) < [deviation]


def test_erratum_5_misprints(claims):
    coupling = claims["Erratum 5a, Corollary 1's coupling"].measured
    assert coupling["smallest_eigenvalue"] == pytest.approx(1.0)
    assert coupling["error_as_printed"] > 0.5
    assert coupling["error_as_meant"] < 1e-12
    assumptions = claims["Erratum 5b, Corollary 1's assumptions"].measured
    assert assumptions["epsilon"] == pytest.approx(-1.0)
    assert max(assumptions["rates"]) < -0.3
    constant = claims["Erratum 5c, the switching law after T"].measured
    assert constant["growth_with_constant"] / constant["growth_as_printed"] == pytest.approx(20, rel=0.05)


def test_erratum_6_digits(claims):
    measured = claims["Erratum 6, digits at T"].measured
    assert measured["largest_s"] == pytest.approx(36.2, abs=0.1)
    assert measured["pure_digits"] == pytest.approx(measured["pure_digits_predicted"], abs=0.2)
    np.testing.assert_allclose(measured["digits"], measured["digits_predicted"], atol=0.2)


# --- each verdict can fail -----------------------------------------------------------------------------------------


class BrokenExponential(Exponential):
    """λ' is half the derivative of λ."""

    def derivative(self, s):
        return super().derivative(s) / 2


def test_lemma_1_fails_for_a_wrong_transformation(monkeypatch):
    monkeypatch.setattr(claims_module, "Exponential", BrokenExponential)
    (claim,) = lemma_1(Experiments())
    assert claim.verdict == "fails"
    assert claim.measured["violated"]


def test_proposition_1_fails_on_a_disconnected_graph(monkeypatch, experiments):
    nearly = paper_topology().graphs[0].adjacency + 1e-12 * cycle(5).adjacency
    monkeypatch.setattr(claims_module, "path", lambda _: Graph(nearly))
    (claim,) = proposition_1(experiments)
    assert claim.verdict == "fails"


def test_theorem_1_fails_when_the_bound_is_too_small():
    experiments = Experiments()
    experiments.gain_bound = 0.01
    assert next(theorem_1(experiments)).verdict == "fails"


def test_theorem_3_fails_when_gains_fall(experiments):
    falling = Experiments()
    falling.adaptive = replace(experiments.adaptive, gains=experiments.adaptive.gains[::-1])
    (claim,) = theorem_3(falling)
    assert claim.verdict == "fails"


def test_table_one_depends_on_the_graph(experiments):
    slow = Experiments()
    slow.ring = fixed(path(5))
    slow.static, slow.corollary_one = experiments.static, experiments.corollary_one
    assert table_one(slow)[0].ours != pytest.approx(21.6, abs=0.1)
