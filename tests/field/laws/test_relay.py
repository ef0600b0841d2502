"""Relay: its equations, its convergence with every kind of player and message, and its caution."""

import numpy as np
import pytest
from affine_games import SOAK, affine_scenario, loop_start, random_affine, run
from sample_laws import condition_on
from worlds import BLOCKS, BLOCKS_SWITCHING, channel_part, fixed_part

from ptne_env import CATALOGUE, Interface, evaluate, get_scenario, laws
from ptne_env.evaluation import POLICIES, get_suite, run_suite
from ptne_env.field import laws as field_laws
from ptne_env.field.laws.best_response import best_response
from ptne_env.field.laws.identification import Model
from ptne_env.laws import relay
from ptne_env.perception.encoder import make_encoder
from ptne_env.world import dynamics
from ptne_env.world.world import World

RANDOM = get_scenario("random-energy")


def digits(scenario, episodes=4):
    """Digits of each episode."""
    (track,) = evaluate([POLICIES["relay"]], [scenario], episodes=episodes, against_laws=False).samples.values()
    return track["digits"].ravel()


def certain(rows):
    """A model that knows these rows, shape (m, q)."""
    rows = np.asarray(rows, dtype=float)[None]
    return Model(rows, np.zeros((1, rows.shape[2], rows.shape[2])))


def response(rows, gradient, drift, held=False, radius=1e6):
    """Displacement of a player whose m own components come first."""
    m = len(rows)
    places, is_held = np.arange(m)[None], np.broadcast_to(held, (1, m))
    radius = np.full((1, 1), radius)
    arrays = np.array(gradient, dtype=float)[None], np.array(drift, dtype=float)[None]
    return best_response(certain(rows), *arrays, places, is_held, radius)[0]


def test_best_response_zeroes_the_own_gradient_at_the_next_estimates():
    rows = [[3.0, 0.5, 0.2, -0.4], [0.5, 2.0, 0.1, 0.3]]
    gradient, drift = [1.0, -4.0], [0.0, 0.0, 2.0, -1.0]
    step = response(rows, gradient, drift)
    assert gradient + np.array(rows) @ [*step, 2.0, -1.0] == pytest.approx([0, 0], abs=1e-12)


def test_response_is_damped_where_the_game_is_not_diagonally_dominant():
    assert response([[1.0, 2.0, -2.0]], [4.0], [0, 0, 0]) == pytest.approx([-1.0])  # the row sum beside is 4


def test_negative_curvature_gives_a_gradient_step():
    assert response([[-2.0, 0.0]], [4.0], [0, 0]) == pytest.approx([-2.0])
    assert response([[-0.5, 0.0]], [4.0], [0, 0]) == pytest.approx([-4.0])


def test_trust_region_shortens_the_largest_component():
    step = response([[1.0, 0.0], [0.0, 1.0]], [4.0, -2.0], [0, 0], radius=1.0)
    assert step == pytest.approx([-1.0, 0.5])


def test_components_beside_a_held_one_move_as_if_it_stayed():
    rows = [[2.0, 1.0], [1.0, 2.0]]
    assert response(rows, [-2.0, 1.0], [0, 0], held=[True, False]) == pytest.approx([1.0, -0.5])


def test_unknown_curvature_gives_a_short_gradient_step():
    model = Model(np.zeros((1, 1, 2)), 100.0 * np.eye(2)[None])
    places, drift, held = np.zeros((1, 1), dtype=np.int64), np.zeros((1, 2)), np.zeros((1, 1), dtype=bool)
    step = best_response(model, np.array([[6.0]]), drift, places, held, np.full((1, 1), 1e6))
    assert step[0] == pytest.approx([-6 / 30])


@pytest.mark.parametrize("scenario", [BLOCKS, BLOCKS_SWITCHING], ids=lambda scenario: scenario.name)
def test_players_of_unequal_dimensions_reach_the_equilibrium(scenario):
    world = World(scenario)
    encoder = make_encoder(world, field_laws.Relay.interface)
    states = run(world, encoder, field_laws.Relay(encoder.layout), loop_start(world))[..., 0]
    assert np.abs(states[-1] - world.game.nash_equilibrium[:, None]).max() < 1e-8


def test_whole_rows_are_identified_on_the_way():
    matrix, offset, adjacency = random_affine(np.random.default_rng(3), 4)
    world = World(affine_scenario(matrix, offset, fixed_part(adjacency)))
    encoder = make_encoder(world, field_laws.Relay.interface)
    law, memory, state = field_laws.Relay(encoder.layout), None, loop_start(world)
    for _ in range(30):
        actions, memory = law.predict(encoder.observe(state)[0], memory)
        state = dynamics.step(world, state, encoder.decode(actions[None], state))
    size = law.layout.dimension
    assert memory[:, :size].reshape(4, size) == pytest.approx(matrix, abs=1e-3)


def test_own_blocks_are_enough_in_large_games(monkeypatch):
    monkeypatch.setattr(relay, "LARGEST_ROW", 1)
    world = World(BLOCKS)
    encoder = make_encoder(world, field_laws.Relay.interface)
    law = field_laws.Relay(encoder.layout)
    assert law.initial_memory(1).shape[1] < 100
    states = run(world, encoder, law, loop_start(world))[..., 0]
    assert np.abs(states[-1] - world.game.nash_equilibrium[:, None]).max() < 1e-8


@pytest.mark.parametrize("name", ["random-energy", "ev-charging", "cournot", "oligopoly", "non-quadratic"])
def test_relay_reaches_twelve_digits(name):
    """Several components at a bound, curvature far from 1, and costs that are not quadratic."""
    assert np.median(digits(get_scenario(name))) == pytest.approx(12)


def test_relay_is_as_good_over_switching_graphs_as_published():
    episodes = 300 if SOAK else 20
    names = ["random-energy-switching", "random-energy-switching-transformed"]
    results = evaluate(["relay"], names, episodes=episodes, seed=87235, against_laws=False)
    physical, transformed = (results.record(name, "relay", "digits")["mean"] for name in names)
    assert physical >= (3.8 if SOAK else 3.5)
    assert transformed >= (8.2 if SOAK else 7.5)


def test_noise_is_averaged_but_only_noise():
    noisy = digits(RANDOM.replace(name="noisy", channel=channel_part("AdditiveNoise", std=0.05)), 10)
    assert noisy.mean() > 3.3
    assert digits(RANDOM.replace(name="late", channel=channel_part("Delay", steps=1, longest=7))).min() > 11.9


def test_graph_that_is_a_part_of_the_union_suffices():
    track = get_suite("ptne-v1").track("unseen-graphs").scenario
    assert np.all(digits(track) > 11)


@pytest.mark.skipif(not SOAK, reason="all tracks and scenarios, 200 episodes each: set PTNE_SOAK=1")
@pytest.mark.parametrize(
    "law",
    [
        name
        for name in POLICIES
        if set(name.split("-")) & {"relay", "routed", "freshest", "broadcast", "proximal", "rate"}
    ],
)
def test_no_episode_diverges_where_grounded_does_not(law):
    suite = run_suite("ptne-v1", [law, "grounded"], episodes=200)
    catalogue = evaluate([law, "grounded"], list(CATALOGUE), episodes=200, against_laws=False)
    for results in (suite, catalogue):
        for track in results.tracks:
            if (track.name, law) not in results.samples:
                continue
            shares = [results.record(track.name, name, "diverged_share")["mean"] for name in (law, "grounded")]
            assert shares[0] <= shares[1], track.name


def test_condition_is_the_contraction_of_best_responses():
    matrix = np.array([[2.0, 1.0, 0.0], [0.5, 1.0, -0.25], [0.0, 0.0, 1.0]])
    found = condition_on(affine_scenario(matrix, np.ones(3), fixed_part(1 - np.eye(3))), field_laws.Relay)
    assert found.value == pytest.approx(0.5)  # the root of the product of 1/2 and 1/2
    assert found.holds
    assert not condition_on("ev-charging", field_laws.Relay).holds
    assert "links recur" in condition_on("energy-switching", field_laws.Relay).name


def test_condition_of_observer_relay_asks_for_undamped_responses_too():
    dominant = np.array([[2.0, 1.0, 0.0], [0.5, 1.0, -0.25], [0.0, 0.0, 1.0]])
    loose = np.array([[1.0, 1.5, 0.0], [0.1, 1.0, 0.0], [0.0, 0.0, 1.0]])
    for matrix in (dominant, loose):
        scenario = affine_scenario(matrix, np.ones(3), fixed_part(1 - np.eye(3)))
        plain, observer = (condition_on(scenario, law) for law in (field_laws.Relay, field_laws.ObserverRelay))
        assert plain.holds
        assert (observer == plain) is (matrix is dominant)
    assert not observer.holds
    assert observer.value == pytest.approx(1.5)


def test_relay_needs_own_estimates_and_hop_counts():
    world = World(RANDOM)
    with pytest.raises(ValueError, match="Relay reads own_estimate"):
        field_laws.Relay(make_encoder(world, Interface("scaled", graph_knowledge="union")).layout)
    with pytest.raises(ValueError, match="hop counts"):
        field_laws.Relay(make_encoder(world, laws.Grounded.interface).layout)
    with pytest.raises(ValueError, match="patience must be a finite number above 0"):
        field_laws.Relay(make_encoder(world, field_laws.Relay.interface).layout, patience=0.0)
    with pytest.raises(ValueError, match="forgetting must be a finite number above 0"):
        field_laws.Relay(make_encoder(world, field_laws.Relay.interface).layout, forgetting=0.0)
