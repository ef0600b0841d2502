"""The observer relay: what its observers gain over the contact relay, its last steps, and odd worlds."""

import numpy as np
import pytest
from affine_games import SOAK, affine_scenario, loop_start, random_affine, run
from worlds import BLOCKS, FAULTY, begin, channel_part, fixed_part, world_and_encoder

from ptne_env import FactorySpec, evaluate, get_scenario
from ptne_env.bench import get_suite
from ptne_env.evaluation import Teammates, Track
from ptne_env.field import laws as field_laws
from ptne_env.field.laws import contact_relay, observer_relay

RANDOM = get_scenario("random-energy")
PAIR = ["contact-relay", "observer-relay"]


def episode(scenario, law, start=None):
    """All estimates of an episode, (K+1, n, N, B), and the world."""
    world, encoder = world_and_encoder(scenario)
    return run(world, encoder, law(encoder.layout), start or begin(world, [0])), world


@pytest.mark.parametrize("seed", range(2))
def test_observers_see_nothing_on_a_fixed_graph_without_faults(seed):
    matrix, offset, adjacency = random_affine(np.random.default_rng(seed), 4, coupling=0.3)
    scenario = affine_scenario(matrix, offset, fixed_part(adjacency), steps=80)
    found = [episode(scenario, law)[0] for law in (field_laws.ContactRelay, field_laws.ObserverRelay)]
    np.testing.assert_allclose(*found, rtol=0, atol=1e-9)


GAINS = {"noise": 0.01, "quantised": 1.5, "hold": 4.0, "switching-physical": 2.0, "switching-transformed": 1.5}
"""Digits that observer-relay gains over contact-relay at least."""


@pytest.mark.parametrize(("name", "gain"), GAINS.items())
def test_observers_gain_digits(name, gain):
    """Where links switch, the law amplifies rounding: means over episodes are far above the bound."""
    track = get_suite("ptne-v1").track(name)
    results = evaluate(PAIR, [track], episodes=16 if name == "noise" else 3, split="validation")
    plain, observer = (results.samples[name, law][track.metric].mean() for law in PAIR)
    assert observer > plain + gain


def test_bounds_that_stop_strategies_are_no_pushes():
    results = evaluate(["observer-relay"], [get_suite("ptne-v1").track("robots")], episodes=1)
    assert results.samples["robots", "observer-relay"]["digits"].mean() > 11.9


def test_constant_pushes_are_compensated():
    pushed = RANDOM.replace(name="pushed", disturbance=FactorySpec.of("disturbance:uniform", bound=2.0, dwell=40))
    results = evaluate(PAIR, [pushed], episodes=4)
    plain, observer = (results.samples["pushed", law]["digits"].mean() for law in PAIR)
    assert observer > plain + 0.5


def test_a_player_leaves_sources_that_follow_it():
    """Two leaves follow the static law; without the rule, the hub can copy from them the copy that they had from it."""
    star = FactorySpec.of("ptne_env.world.graphs:from_edges", players=5, edges=[[0, 1], [0, 2], [0, 3], [2, 4]])
    leaves = Teammates(FactorySpec.of("law:static", kappa=2.0), (1, 3))
    track = Track("leaves", RANDOM.replace(topology=star), "Leaves average.", teammates=leaves)
    results = evaluate(PAIR, [track], episodes=8 if SOAK else 5, split="validation")
    plain, observer = (results.samples["leaves", law]["digits"] for law in PAIR)
    assert (plain < 1).any()
    assert (observer > 11).all()


def test_a_rotating_game_settles_with_damping_and_not_without():
    """Each player's own curvature is a third of the coupling; the start is up to 20 units away."""
    scenario = affine_scenario([[0.3, 1.0], [-1.0, 0.3]], [1.0, -2.0], fixed_part(1 - np.eye(2)))
    start = loop_start(world_and_encoder(scenario)[0])
    for law, settles in ((field_laws.ObserverRelay, True), (field_laws.ContactRelay, False)):
        states, world = episode(scenario, law, start)
        distance = np.abs(states[-1, ..., 0] - world.game.nash_equilibrium[:, None]).max()
        assert bool(distance < 1e-4) is settles
        assert settles or distance > 1


def test_estimates_of_noisy_messages_come_to_rest_near_the_end_when_means_are_stated():
    scenario = RANDOM.replace(channel=channel_part("AdditiveNoise", std=0.05))
    states, world = episode(scenario, field_laws.ObserverRelay)
    moves = np.abs(np.diff(states[..., 0], axis=0))[:, ~np.eye(5, dtype=bool)]  # (K, 20), of estimates of others
    left = world.clock.s[-1] - world.clock.s[:-1]
    ends, before = np.flatnonzero(left <= 0.9)[1:], np.flatnonzero((left > 1.2) & (left < 3))
    assert np.median(moves[ends]) < 0.2 * np.median(moves[before])


@pytest.mark.parametrize(
    ("scenario", "law"),
    [(BLOCKS, field_laws.ContactRelay), (BLOCKS, field_laws.ObserverRelay), (FAULTY, field_laws.ObserverRelay)],
)
def test_own_blocks_are_enough_in_large_games(scenario, law, monkeypatch):
    whole = law(world_and_encoder(scenario)[1].layout).initial_memory(1).size
    for module in (contact_relay, observer_relay):
        monkeypatch.setattr(module, "LARGEST_ROW", 1)
    assert law(world_and_encoder(scenario)[1].layout).initial_memory(1).size < whole
    states, world = episode(scenario, law)
    assert np.isfinite(states).all()
    if scenario is BLOCKS:
        assert np.abs(states[-1, ..., 0] - world.game.nash_equilibrium[:, None]).max() < 1e-8
