"""Identify and broadcast: the code, twelve digits over switching graphs, and Relay where messages are damaged."""

from functools import partial

import numpy as np
import pytest
from affine_games import SOAK
from worlds import channel_part

from ptne_env import evaluate, get_scenario
from ptne_env.evaluation import POLICIES, get_suite, run_suite
from ptne_env.field import laws as field_laws
from ptne_env.laws import broadcast
from ptne_env.perception.encoder import make_encoder
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import dynamics
from ptne_env.world.world import World

RANDOM = get_scenario("random-energy")
SWITCHING = ["random-energy-switching", "random-energy-switching-transformed"]


def episodes_of(scenario, episodes=3):
    """Each step's state, observations (rows, size), actions and memory of the law by part."""
    world = World(scenario)
    encoder = make_encoder(world, field_laws.IdentifyAndBroadcast.interface)
    law, memory = field_laws.IdentifyAndBroadcast(encoder.layout), None
    state = dynamics.draw_initial_state(world, [RandomStreams.from_seed(seed) for seed in range(episodes)])
    for _ in range(world.clock.steps):
        observations = encoder.observe(state).reshape(-1, encoder.layout.size)
        actions, memory = law.predict(observations, memory)
        state = dynamics.step(
            world, state, encoder.decode(actions.reshape(episodes, world.game.num_players, -1), state)
        )
        yield state, observations, actions, law._parts.split(memory)


def last(scenario):
    *_, end = episodes_of(scenario)
    return end


def code(players=3):
    generator = np.random.default_rng(0)
    equations = generator.normal(size=(players, players + 1))
    equations[range(players), range(players)] = 1
    return broadcast.with_checksums(equations)


def test_a_code_is_intact_until_an_entry_changes():
    assert broadcast.is_intact(code()).all()
    assert broadcast.is_intact(code() * (1 + 1e-6)).all()
    for entry in range(6):
        damaged = code()
        damaged[1, entry] += 0.01
        assert broadcast.is_intact(damaged).tolist() == [True, False, True]


def test_silence_and_shifted_codes_are_not_intact():
    assert not broadcast.is_intact(np.zeros((3, 6))).any()
    for shift in range(1, 6):
        assert not broadcast.is_intact(np.roll(code(), shift, axis=1)).any()


def test_own_equations_vanish_where_the_own_gradient_does():
    generator = np.random.default_rng(1)
    matrix = generator.normal(size=(4, 4)) + 3 * np.eye(4)
    offset, estimate = generator.normal(size=4), generator.normal(size=4)
    blocks = np.array([[1, 2]])
    gradient = (matrix @ estimate + offset)[blocks]
    (equations,), exist = broadcast.own_equations(matrix[None, 1:3], gradient, estimate[None], blocks)
    assert exist.all()
    assert equations[1:3, 1:3] == pytest.approx(np.eye(2))
    assert not equations[[0, 3]].any()
    equilibrium = np.linalg.solve(matrix, -offset)
    assert equations[1:3, :4] @ equilibrium == pytest.approx(64 * equations[1:3, 4])


def test_singular_own_blocks_have_no_equation():
    rows = np.array([[[1.0, 2.0, 0.0], [2.0, 4.0, 1.0]]])
    _, exist = broadcast.own_equations(rows, np.zeros((1, 2)), np.zeros((1, 3)), np.array([[0, 1]]))
    assert not exist.any()


@pytest.mark.parametrize("name", SWITCHING)
def test_twelve_digits_over_switching_graphs_of_unknown_schedule(name):
    results = evaluate(["identify-and-broadcast"], [name], episodes=300 if SOAK else 5, seed=87235, against_laws=False)
    assert results.samples[name, "identify-and-broadcast"]["digits"].min() > 11.9


@pytest.mark.parametrize("name", ["robots", "random-affine", "oligopoly"])
def test_twelve_digits_in_games_of_other_shapes(name):
    results = evaluate(["identify-and-broadcast"], [name], episodes=3, against_laws=False)
    assert results.samples[name, "identify-and-broadcast"]["digits"].min() > 11.9


def test_solution_is_as_exact_as_messages_and_the_residuals_make_it_exact():
    distances = []
    for state, _, _, memory in episodes_of(get_scenario(SWITCHING[0])):
        if not memory["arrived"].all() or (memory["payload"] != 0).any():
            continue
        errors = np.abs(state.estimates - state.game.nash_equilibria[:, None]).max()
        distances.append((bool((memory["has"] > 0).all()), errors))
    early = [error for complete, error in distances if not complete]
    late = [error for complete, error in distances if complete]
    assert 1e-7 < min(early) < max(early) < 1e-3
    assert min(late) < 1e-10


def test_all_equations_are_known_long_before_the_deadline():
    for _, _, _, memory in episodes_of(RANDOM, 1):
        if memory["steps"][0, 0] == 60:
            break
    assert (memory["knows"] == 1).all()
    assert (memory["is_relay"] == 0).all()


DAMAGES = {
    "noise": channel_part("AdditiveNoise", std=0.05),
    "delay": channel_part("Delay", steps=1, longest=7),
    "constant delay": channel_part("Delay", steps=2),
    "rounding": channel_part("UniformQuantiser", width=0.1),
    "loss": channel_part("Loss", probability=0.3),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_messages_make_every_player_a_relay(damage):
    states, _, _, memories = zip(*episodes_of(RANDOM.replace(name="damaged", channel=DAMAGES[damage])), strict=True)
    assert (memories[200]["is_relay"] == 1).all()
    assert not memories[-1]["arrived"].any()
    state = states[-1]
    errors = np.abs(state.estimates - state.game.nash_equilibria[:, None]).max()
    assert errors < (0.5 if damage in ("noise", "rounding") else 1e-9)


FAINT = {
    "noise": channel_part("AdditiveNoise", std=1e-7),
    "rounding": channel_part("UniformQuantiser", width=1e-4),
    "loss": channel_part("Loss", probability=0.02),
}


@pytest.mark.parametrize("damage", FAINT)
def test_damage_that_the_code_survives_costs_less_than_a_digit(damage):
    base = get_scenario("random-energy-switching-transformed") if damage != "noise" else RANDOM
    scenario = base.replace(name="faint", channel=FAINT[damage])
    results = evaluate(["identify-and-broadcast", "relay"], [scenario], episodes=12, seed=87235, against_laws=False)
    ours, relay = (results.samples["faint", name]["digits"].mean() for name in ("identify-and-broadcast", "relay"))
    assert ours > relay - {"noise": 1.0, "rounding": 0.1, "loss": 0.1}[damage]


def test_a_teammate_with_another_law_ends_the_code_at_once():
    """A player sees the stranger move two components, and its neighbours see that it has given up the code."""
    results = run_suite("ptne-v1", ["identify-and-broadcast", "relay"], tracks=["mixed-team"], episodes=5)
    ours, relay = (results.samples["mixed-team", name]["digits"] for name in ("identify-and-broadcast", "relay"))
    assert np.all(ours > relay - 0.1)


def test_games_that_are_not_affine_make_their_players_relays():
    memory = last(get_scenario("non-quadratic", start="random"))[3]
    assert (memory["is_relay"] == 1).all()
    assert (memory["knows"].sum(axis=1) < 5).all()


def test_large_games_are_played_as_relay_plays_them():
    scenario = get_suite("ptne-v1").track("large-50").scenario
    encoder = make_encoder(World(scenario), field_laws.IdentifyAndBroadcast.interface)
    ours, relay = field_laws.IdentifyAndBroadcast(encoder.layout), field_laws.Relay(encoder.layout)
    observations = np.random.default_rng(0).normal(size=(3, encoder.layout.size)).astype(np.float32)
    (actions, memory), (expected, _) = ours.predict(observations), relay.predict(observations)
    np.testing.assert_array_equal(actions, expected)
    assert memory.shape == relay.initial_memory(3).shape


def test_rows_are_decided_alike_in_all_phases():
    law_of = partial(
        field_laws.IdentifyAndBroadcast, make_encoder(World(RANDOM), field_laws.IdentifyAndBroadcast.interface).layout
    )
    chosen, memories = [[3], [14, 0, 7]], [None, None]
    policies = [law_of() for _ in chosen]
    for _, observations, actions, _ in episodes_of(RANDOM.replace(steps=150)):
        for index, rows in enumerate(chosen):
            alone, memories[index] = policies[index].predict(observations[rows], memories[index])
            np.testing.assert_array_equal(alone, actions[rows])


def test_estimates_are_declared_as_coded():
    assert POLICIES["identify-and-broadcast"].interface.estimates == "coded"
    assert POLICIES["relay"].interface.estimates == "honest"


def test_switch_is_a_share_of_the_deadline():
    layout = make_encoder(World(RANDOM), field_laws.IdentifyAndBroadcast.interface).layout
    with pytest.raises(ValueError, match="switch must be a probability"):
        field_laws.IdentifyAndBroadcast(layout, switch=1.5)


def test_inverses_of_blocks_of_one_component_are_pseudoinverses():
    own = np.array([3.0, -0.7, 0.0, 1e-9]).reshape(-1, 1, 1)
    assert np.array_equal(broadcast.inverses(own), np.linalg.pinv(own))
