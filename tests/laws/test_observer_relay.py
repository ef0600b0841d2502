"""The observer relay: what its observers gain over the contact relay, its last steps, and odd worlds."""

import numpy as np
import pytest
from affine_games import affine_scenario, loop_start, random_affine, run
from worlds import BLOCKS, FAULTY, begin, channel_part, fixed_part, world_and_encoder

from ptne_env import FactorySpec, evaluate, get_scenario, laws
from ptne_env.laws import observer_relay
from ptne_env.laws.building_blocks import own_gradient
from ptne_env.suites import get_suite

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
    found = [episode(scenario, law)[0] for law in (laws.ContactRelay, laws.ObserverRelay)]
    np.testing.assert_allclose(*found, rtol=0, atol=1e-9)


GAINS = {"rounding": 1.5, "liar": 1.0, "monotone": 0.5, "coupled": 0.3}
"""Digits that observer-relay gains over contact-relay at least."""


@pytest.mark.parametrize(("name", "gain"), GAINS.items())
def test_observers_gain_digits(name, gain):
    results = evaluate(PAIR, [get_suite("ptne-v1").track(name)], episodes=6, split="validation")
    plain, observer = (results.samples[name, law]["digits"].mean() for law in PAIR)
    assert observer > plain + gain


def test_planes_of_reactions_gain_digits_where_links_switch():
    """The law amplifies rounding there: means over episodes are far above the bound."""
    results = evaluate(PAIR, ["random-energy-switching"], episodes=4)
    plain, observer = (results.samples["random-energy-switching", law]["digits"].mean() for law in PAIR)
    assert observer > plain + 2


BEND = RANDOM.replace(name="bend", game=FactorySpec.of("game:random-saturating", bend=20))

PAIR_OF_PLAYERS = RANDOM.replace(
    name="pair",
    game=FactorySpec.of("game:random-energy", players=2),
    topology=FactorySpec.of("topology:edges", players=2, edges=[[0, 1]]),
    channel=channel_part("AdditiveNoise", std=0.01),
)


BIASED = RANDOM.replace(name="biased", channel=FactorySpec.of("channel:bias", bound=0.1))

LATE = RANDOM.replace(name="late", channel=FactorySpec.of("channel:late-noise", std=0.05, step=150))


@pytest.mark.parametrize(
    ("scenario", "digits"),
    [(BEND, 10.0), (PAIR_OF_PLAYERS, 4.2), (BIASED, 2.2), (LATE, 2.9)],
    ids=["bend", "pair", "biased", "late"],
)
def test_worlds_that_break_fixed_steps_and_floors_of_noise(scenario, digits):
    """A gradient step of fixed length left 2.2 digits of the first and 1.2 of the third, a floor of noise that never
    rises 2.4 of the last, and noise of own components 3.3 of the second."""
    results = evaluate(["observer-relay"], [scenario], episodes=6)
    assert results.samples[scenario.name, "observer-relay"]["digits"].mean() > digits


def test_slow_moves_add_up_to_news():
    """Inputs are so limited that no step moves a copy by more than noise."""
    slow = RANDOM.replace(name="slow", deadline=0.3, input_limit=4.0, channel=channel_part("AdditiveNoise", std=0.02))
    results = evaluate(["observer-relay"], [slow], episodes=4)
    assert results.samples["slow", "observer-relay"]["digits"].min() > 2.5


@pytest.mark.parametrize("rule", observer_relay.RULES)
def test_every_rule_can_be_switched_off(rule):
    world, encoder = world_and_encoder(FAULTY)
    states = run(world, encoder, laws.ObserverRelay(encoder.layout, without=[rule]), begin(world, [0]), steps=30)
    assert np.isfinite(states).all()


def test_unknown_rules_are_named():
    with pytest.raises(ValueError, match="unknown rule 'luck'; choose from noise, rounding"):
        laws.ObserverRelay(world_and_encoder("energy")[1].layout, without=["luck"])


def test_a_rotating_game_settles_with_damping_and_not_without():
    """Each player's own curvature is a third of the coupling; the start is up to 20 units away."""
    scenario = affine_scenario([[0.3, 1.0], [-1.0, 0.3]], [1.0, -2.0], fixed_part(1 - np.eye(2)))
    start = loop_start(world_and_encoder(scenario)[0])
    for law, settles in ((laws.ObserverRelay, True), (laws.ContactRelay, False)):
        states, world = episode(scenario, law, start)
        distance = np.abs(states[-1, ..., 0] - world.game.nash_equilibrium[:, None]).max()
        assert bool(distance < 0.02) is settles
        assert settles or distance > 1


def test_estimates_of_noisy_messages_come_to_rest_near_the_end_when_means_are_stated():
    scenario = RANDOM.replace(channel=channel_part("AdditiveNoise", std=0.05))
    states, world = episode(scenario, laws.ObserverRelay)
    moves = np.abs(np.diff(states[..., 0], axis=0))[:, ~np.eye(5, dtype=bool)]  # (K, 20), of estimates of others
    left = world.clock.s[-1] - world.clock.s[:-1]
    ends, before = np.flatnonzero(left <= 0.9)[1:], np.flatnonzero((left > 1.2) & (left < 3))
    assert np.median(moves[ends]) < 0.2 * np.median(moves[before])


@pytest.mark.parametrize(
    ("scenario", "law"),
    [(BLOCKS, laws.ContactRelay), (BLOCKS, laws.ObserverRelay), (FAULTY, laws.ObserverRelay)],
)
def test_own_blocks_are_enough_in_large_games(scenario, law, monkeypatch):
    whole = law(world_and_encoder(scenario)[1].layout).initial_memory(1).size
    for module in (own_gradient, observer_relay):
        monkeypatch.setattr(module, "LARGEST_ROW", 1)
    assert law(world_and_encoder(scenario)[1].layout).initial_memory(1).size < whole
    states, world = episode(scenario, law)
    assert np.isfinite(states).all()
    if scenario is BLOCKS:
        assert np.abs(states[-1, ..., 0] - world.game.nash_equilibrium[:, None]).max() < 1e-8


def test_estimates_follow_neighbours_whose_messages_never_change():
    """Rounding hides all, so no message is news, and a copy in the middle is better than a far start."""
    world = get_scenario(
        "random-energy",
        steps=100,
        start=FactorySpec.of("start:uniform", low=-400.0, high=400.0),
        channel=FactorySpec.of("channel:rounding", width=1000.0),
    )
    results = evaluate(["observer-relay", "contact-relay"], [world], episodes=4)
    observer, contact = (results.summary("random-energy", name, "digits").mean for name in results.policies)
    assert observer > contact + 0.5
