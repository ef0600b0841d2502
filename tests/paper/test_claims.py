"""The paper's claims and docs/errata.md: verdicts and measured numbers."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from baselines.paper import claims as claims_module
from baselines.paper.claims import VANISHED, lemma_1, proposition_1, theorem_1, theorem_3
from baselines.paper.experiments import Experiments
from baselines.paper.table import labelled_graphs, misfits, table_one
from ptne_env import FactorySpec, get_scenario, laws
from ptne_env.evaluation.rollout import rollout
from ptne_env.games import NonQuadraticGame
from ptne_env.perception.encoder import Encoder
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import dynamics
from ptne_env.world.clock import Exponential
from ptne_env.world.graphs import Graph, cycle, path
from ptne_env.world.switching import fixed, paper_topology
from ptne_env.world.world import World


def numbers(claim):
    """The numbers in the finding of a claim."""
    return [float(found) for found in re.findall(r"-?\d+\.?\d*(?:e[+-]?\d+)?", claim.finding)]


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
        "Theorem 4, dwelling in s, another game",
    }
    assert len(claims) == 28


def test_theorem_2_holds_except_for_smoothness_and_the_velocity(claims):
    assert numbers(claims["Theorem 2, boundedness of u"])[-1] > 0
    for name in ("Theorem 2, smoothness of u", "Theorem 2, boundedness of the plant's input"):
        exponent, above_gain_condition = numbers(claims[name])
        assert exponent == pytest.approx(0.28 - 1, abs=0.01)
        assert above_gain_condition < 0


def test_erratum_1_example_2_has_another_equilibrium(claims):
    others = [2 * math.log(2), 0.0, -0.5, 2.5]
    *point, off, rounding = numbers(claims["Erratum 1, equilibrium of Example 2"])
    assert point == pytest.approx([-sum(others), *others], abs=1e-5)
    assert rounding < 1e-4 < off
    gradients = [
        np.linalg.norm(NonQuadraticGame(variant).pseudo_gradient(np.array([[-4.6589], [4.1589], [0], [-2], [2.5]])))
        for variant in ("printed", "corrected")
    ]
    assert gradients == pytest.approx([3.0, 0.0], abs=1e-3)


def test_erratum_1_example_2_violates_assumptions_3_and_4(claims):
    epsilon, within_10, _, within_40, *_, until = numbers(claims["Erratum 1, assumptions of Example 2"])
    assert epsilon < 0 < until
    assert within_40 > 10 * within_10
    x = np.zeros((5, 3))
    for fourth, lowest in ((0.0, 0.0), (5.0, -5e4)):  # at x4 = 0 J2 has an infimum and no minimiser
        x[1], x[3] = [-1e1, -1e2, -1e4], fourth
        costs = NonQuadraticGame().costs(x)[1]
        assert np.all(np.diff(costs) < 0)
        assert costs[-1] == pytest.approx(lowest)


def test_erratum_2_error_at_the_deadline_shrinks_with_the_period(claims, experiments):
    pairs = numbers(claims["Erratum 2, switching in t"])
    assert pairs[1::2] == [0.8, 0.4, 0.2, 0.1]
    assert pairs[::2] == pytest.approx([0.31, 0.090, 0.023, 0.0046], rel=0.05)
    assert [len(run.timeline.segments) - 1 for run in experiments.by_period.values()] == [5, 11, 23, 47]
    errors = {}
    for clock, run in experiments.switching.items():
        places = np.searchsorted(run.timeline.s[: run.timeline.deadline_index + 1], (8, 15, 30, 60))
        errors[clock] = run.estimate_distance[places]
    assert errors["physical"][3] == pytest.approx(errors["physical"][1], rel=1e-3)  # the error is constant
    at_8, _, at_30, at_60 = errors["transformed"]
    assert at_60 < min(1e-3 * at_30, VANISHED)
    assert at_30 < 0.1 * at_8


def test_erratum_2_the_law_diverges_over_disconnected_modes_that_dwell_in_s(claims, experiments):
    pair, five = claims["Erratum 2, switching in s"].finding.split("; ")
    assert numbers(replace(claims["Erratum 2, switching in s"], finding=pair))[:5] == [1, 10.05, 2, 2.757e4, 5]
    assert numbers(replace(claims["Erratum 2, switching in s"], finding=five))[:5] == [1, 10.05, 5, 680.9, 12]
    for name in ("two players", "five players"):
        run = experiments.counterexamples[name]
        assert run.topology.is_jointly_connected
        assert np.diff(run.gains, axis=0).min() >= 0


def test_erratum_2_the_environment_diverges_too():
    """The sampled law, from the same start, grows as the solution in continuous time does."""
    game, topology = Experiments().rotating, FactorySpec.of("topology:paper", dwell=0.25, clock="transformed")
    scenario = get_scenario(
        "energy-switching-transformed",
        game=FactorySpec.of("game:quadratic", matrix=game.matrix, offset=[0.0] * 5),
        topology=topology,
        start=FactorySpec.of("start:fixed", estimates=np.ones((5, 5)).tolist()),
        steps=4000,
        s_end=12.0,
        input_limit=1e9,
    )
    world = World(scenario)
    law = laws.Adaptive(Encoder(world, laws.Adaptive.interface).layout)
    played = rollout(
        law, Encoder(world, law.interface), dynamics.draw_initial_state(world, [RandomStreams.from_seed(0)])
    )
    assert math.sqrt(5) * played["estimate_distance"][4000, 0] == pytest.approx(680.9, rel=0.05)


def test_erratum_2_short_dwells_and_connected_modes_rescue_the_law(claims):
    _, least, *_ = numbers(claims["Erratum 2, short dwells"])
    assert least == pytest.approx(66.2, abs=0.1)
    started, ended, largest, smallest, _ = numbers(claims["Erratum 2, connected modes"])
    assert ended < started
    assert smallest < 0.1 * largest


def test_erratum_3_velocity_and_energy_diverge(claims):
    rate, *exponents = numbers(claims["Erratum 3, velocity near T"])
    assert rate == pytest.approx(0.2801, abs=1e-4)
    assert exponents == pytest.approx([rate - 1, rate - 1, 1 - 2 * rate], abs=0.01)


def test_erratum_4_the_gain_violates_the_condition_on_most_graphs(claims):
    _, bound, violating, graphs, _, least, slowest, *_ = numbers(claims["Erratum 4, the gain of the simulations"])
    assert (bound, least) == pytest.approx((4.2107, 2.91), abs=1e-3)
    assert violating < graphs == 21
    assert slowest > 0


def test_erratum_4_no_graph_with_a_larger_connectivity_comes_near_table_one(claims):
    *_, near, labelled, _, _, nearest = numbers(claims["Erratum 4, the gain of the simulations"])
    assert (near, labelled, nearest) == (304, 728, 7.96)
    assert sum(graph.algebraic_connectivity > 2.91 for graph in labelled_graphs()) == 26


def test_misfit_of_the_cycle_is_that_of_table_one(experiments):
    gadjov_pavel, corollary, _ = table_one(experiments)
    deviation = max(gadjov_pavel.ours / 21 - 1, corollary.ours / 13 - 1)
    assert misfits(experiments, [cycle(5)], np.array([0.005])) == pytest.approx([deviation], rel=1e-3)
    assert misfits(experiments, [cycle(5)], np.geomspace(1e-4, 5e-2, 101)) < [deviation]


def test_erratum_5_misprints(claims):
    smallest, _, printed, meant = numbers(claims["Erratum 5a, Corollary 1's coupling"])
    assert smallest == 1
    assert meant < 1e-12
    assert printed > 0.5
    epsilon, _, largest = numbers(claims["Erratum 5b, Corollary 1's assumptions"])[-3:]
    assert epsilon == -1
    assert largest < -0.3
    assert numbers(claims["Erratum 5c, the switching law after T"])[-1] == pytest.approx(20, rel=0.05)


def test_erratum_6_digits(claims):
    largest, pure, pure_predicted, _, _, digits, predicted = numbers(claims["Erratum 6, digits at T"])
    assert largest == pytest.approx(36.2, abs=0.1)
    assert (pure, digits) == pytest.approx((pure_predicted, predicted), abs=0.2)


def test_erratum_7_u_is_neither_smooth_nor_continuous(claims):
    (exponent,) = numbers(claims["Erratum 7, the adaptive law on a fixed graph"])
    assert exponent == pytest.approx(-0.646, abs=1e-3)
    jumps = numbers(claims["Erratum 7, the adaptive law over switching graphs"])
    assert jumps[:2] == [15, 1.6]
    assert jumps[2:8] == [3.83, 19.8, 0.1, 2.87, 205, 0.3]
    assert jumps[8] < 1e-9
    assert jumps[9] == 23.6


def test_erratum_8_assumption_3_does_not_give_an_equilibrium(claims):
    assert numbers(claims["Erratum 8, Assumption 3 and the equilibrium"])[2:4] == [-1, -1]


def test_erratum_9_corollary_1_does_not_cover_ye_and_hu(claims):
    assert numbers(claims["Erratum 9, Corollary 1 and Ye and Hu"]) == [10000, 0.42, 2.1, 2.1]


# --- each verdict can fail -----------------------------------------------------------------------------------------


class BrokenExponential(Exponential):
    """λ' is half the derivative of λ."""

    def derivative(self, s):
        return super().derivative(s) / 2


def test_lemma_1_fails_for_a_wrong_transformation(monkeypatch):
    monkeypatch.setattr(claims_module, "Exponential", BrokenExponential)
    (claim,) = lemma_1(Experiments())
    assert claim.verdict == "fails"
    assert claim.finding.startswith("conditions violated")


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
