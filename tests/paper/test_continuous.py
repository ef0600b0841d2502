from itertools import pairwise

import numpy as np
import pytest
from scipy import integrate, linalg

from baselines.paper.continuous import exact_static, plain_timeline, prescribed_timeline, simulate
from ptne_env.games import EnergyGame
from ptne_env.theory import closed_loop_matrix
from ptne_env.world.clock import Exponential, HyperbolicTangent, Rational
from ptne_env.world.graphs import cycle
from ptne_env.world.starts import PaperStart
from ptne_env.world.switching import fixed, paper_topology

DEADLINE, GAIN = 1.2, 20.0
LAMBDA = Exponential(DEADLINE)


@pytest.fixture(scope="module")
def start():
    return PaperStart().draw(5, 5, np.random.default_rng(0)).T


def relative_mismatch(run, other):
    difference = np.linalg.norm(run.errors - other.errors, axis=(1, 2))
    return float((difference / np.linalg.norm(other.errors, axis=(1, 2))).max())


@pytest.mark.parametrize("kappa", [0.5, 2.0, 10.0])
def test_static_law_agrees_with_the_matrix_exponential(start, kappa):
    timeline = prescribed_timeline(fixed(cycle(5)), LAMBDA, GAIN, s_end=8.0, hold=0.1, samples=301)
    run = simulate(EnergyGame(), fixed(cycle(5)), start, timeline, initial_gain=kappa)
    matrix = closed_loop_matrix(EnergyGame(), cycle(5), kappa)
    initial = (start - EnergyGame().nash_equilibrium).ravel()
    for k in (0, 7, 150, 300, -1):
        expected = linalg.expm(-matrix * timeline.tau[k]) @ initial
        assert np.linalg.norm(run.errors[k].ravel() - expected) <= 1e-9 * np.linalg.norm(expected)
    exact = exact_static(EnergyGame(), fixed(cycle(5)), start, timeline, kappa=kappa)
    assert relative_mismatch(run, exact) <= 1e-9


@pytest.mark.parametrize("clock", ["physical", "transformed"])
def test_switching_agrees_with_piecewise_exponentials(start, clock):
    topology = paper_topology(0.1 if clock == "physical" else 0.25, clock)
    timeline = prescribed_timeline(topology, LAMBDA, GAIN, s_end=6.0, hold=0.25, samples=201)
    run = simulate(EnergyGame(), topology, start, timeline, initial_gain=2.0)
    exact = exact_static(EnergyGame(), topology, start, timeline, kappa=2.0)
    assert relative_mismatch(run, exact) <= 1e-9


def test_adaptive_law_agrees_with_an_integration_in_physical_time(start):
    """The paper's equation in t, with plain loops, up to t = 0.9 T."""
    game, topology, gamma = EnergyGame(), paper_topology(0.1, "physical"), 0.1
    horizon = 0.9 * DEADLINE
    weights = [graph.adjacency for graph in topology.graphs]

    def loop(t, y, mode):
        x, kappa = y[:25].reshape(5, 5), y[25:].reshape(5, 5)
        dx, dkappa = np.zeros((5, 5)), np.zeros((5, 5))
        for i in range(5):
            dx[i, i] -= 2 * (x[i, i] - game.targets[i, 0]) + 0.1 * x[i].sum() + 10 + 0.1 * x[i, i]
            for j in range(5):
                difference = x[i] - x[j]
                dx[i] -= kappa[i, j] * weights[mode][i, j] * difference
                dkappa[i, j] = gamma * weights[mode][i, j] * difference @ difference
        return (GAIN + 1 / (DEADLINE - t)) * np.concatenate([dx.ravel(), dkappa.ravel()])

    state = np.concatenate([start.ravel(), np.full(25, 0.5)])
    bounds = [*np.arange(0, horizon, 0.1), horizon]
    for k, (low, high) in enumerate(pairwise(bounds)):
        state = integrate.solve_ivp(loop, (low, high), state, args=(k % 4,), method="DOP853", rtol=1e-10, atol=1e-10).y[
            :, -1
        ]

    timeline = prescribed_timeline(topology, LAMBDA, GAIN, s_end=float(LAMBDA.inverse(horizon)), samples=11)
    run = simulate(game, topology, start, timeline, initial_gain=0.5, gamma=gamma)
    np.testing.assert_allclose(run.estimates[-1], state[:25].reshape(5, 5), atol=1e-7)
    table = state[25:].reshape(5, 5)
    np.testing.assert_allclose(run.gains[-1], [table[edge] for edge in topology.union.edges], atol=1e-7)


@pytest.mark.parametrize("transformation", [Exponential(1.2), Rational(0.7), HyperbolicTangent(2.0)])
def test_timeline_follows_the_transformation(transformation):
    timeline = prescribed_timeline(fixed(cycle(5)), transformation, 5.0, s_end=4.0, samples=50)
    np.testing.assert_allclose(timeline.t, transformation.time(timeline.s), rtol=1e-14)
    np.testing.assert_allclose(timeline.tau, timeline.s + 5.0 * timeline.t, atol=1e-12)
    np.testing.assert_allclose(np.diff(timeline.tau), timeline.tau[-1] / 49, rtol=1e-9)
    assert (timeline.s[0], timeline.s[-1]) == (0.0, 4.0)


def test_switches_in_t_before_and_after_the_deadline():
    topology = paper_topology(0.1, "physical")
    timeline = prescribed_timeline(topology, LAMBDA, GAIN, s_end=30.0, hold=0.25)
    first, hold = timeline.deadline_index, timeline.after_deadline()
    before = [segment for segment in timeline.segments if segment.end <= timeline.tau[first]]
    assert [segment.mode for segment in before] == [0, 1, 2, 3] * 3
    starts = np.array([segment.start for segment in before])
    s = LAMBDA.from_effective_time(starts, GAIN)
    np.testing.assert_allclose(LAMBDA.time(s), np.arange(12) * 0.1, atol=1e-12)
    assert [segment.mode for segment in hold.segments] == [0, 1, 2]
    np.testing.assert_allclose(
        [segment.end - segment.start for segment in hold.segments], [GAIN * 0.1, GAIN * 0.1, GAIN * 0.05]
    )
    np.testing.assert_allclose([hold.t[0], hold.t[-1]], [DEADLINE, DEADLINE + 0.25], atol=1e-12)
    assert hold.tau.size < timeline.tau.size


def test_switches_in_s_continue_up_to_s_end_and_after_the_deadline():
    timeline = prescribed_timeline(paper_topology(0.25, "transformed"), LAMBDA, GAIN, s_end=10.0, hold=0.05)
    modes = [segment.mode for segment in timeline.segments]
    # 40 dwells up to s = 10; the 0.05 s after T are c·0.05 = 1 more of s.
    assert modes == [0, 1, 2, 3] * 11
    starts = np.array([segment.start for segment in timeline.segments[:40]])
    np.testing.assert_allclose(LAMBDA.from_effective_time(starts, GAIN), np.arange(40) * 0.25, atol=1e-9)


def test_segments_cover_the_timeline():
    for topology in (fixed(cycle(5)), paper_topology(0.1), paper_topology(0.3, "transformed")):
        timeline = prescribed_timeline(topology, LAMBDA, GAIN, s_end=12.0, hold=0.4)
        starts = [segment.start for segment in timeline.segments]
        ends = [segment.end for segment in timeline.segments]
        assert starts[0] == timeline.tau[0]
        assert ends[-1] == timeline.tau[-1]
        assert starts[1:] == ends[:-1]
        assert np.all(np.diff(timeline.tau) >= 0)
        assert set(ends) <= set(timeline.tau)


def test_distances_and_settling_time(start):
    topology = fixed(cycle(5))
    run = simulate(EnergyGame(), topology, start, plain_timeline(topology, 30.0), initial_gain=10.0)
    star = run.game.nash_equilibrium
    strategies = np.diagonal(run.estimates[500])
    assert run.strategy_distance[500] == pytest.approx(np.linalg.norm(strategies - star) / np.linalg.norm(star))
    everything = np.linalg.norm(run.estimates[500] - star) / (np.sqrt(5) * np.linalg.norm(star))
    assert run.estimate_distance[500] == pytest.approx(everything)
    settled = run.settling_time(0.005)
    assert settled is not None
    assert np.all(run.strategy_distance[run.timeline.t > settled] <= 0.005)
    assert run.strategy_distance[run.timeline.t < settled][-1] > 0.005
    assert run.settling_time(1e-9) is None
    assert run.settling_time(100.0) == 0.0
    assert run.strategy_distance_at(7.5) == run.strategy_distance[500]
