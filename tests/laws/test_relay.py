"""The relay: its response, the plainest inputs, games that rotate, and every kind of player and message."""

import numpy as np
import pytest
from affine_games import affine_scenario, loop_start, random_digraph, run
from worlds import BLOCKS, BLOCKS_SWITCHING, begin, channel_part, fixed_part, world_and_encoder

from ptne_env import FactorySpec, evaluate, get_scenario, laws
from ptne_env.laws import relay
from ptne_env.laws.identification import initial_model, shorten
from ptne_env.suites import get_suite
from ptne_env.world import dynamics

RANDOM = get_scenario("random-energy")


def response(rows, gradient, drift, radius=1e6, covariance=0.0, held=False, share=1.0):
    """Displacement of a player whose m own components come first, and who knows its rows."""
    rows = np.asarray(rows, dtype=float)[None]
    m, n = rows.shape[1:]
    model = initial_model(world_and_encoder("energy")[1].layout, 1)._replace(
        rows=rows,
        covariance=covariance * np.eye(n)[None],
        gradient=np.array(gradient, dtype=float)[None],
        radius=np.full((1, 1), radius),
    )
    wanted = relay._respond(
        model,
        np.array(drift, dtype=float)[None],
        np.arange(m)[None],
        np.arange(n)[None] < m,
        np.broadcast_to(held, (1, m)),
        np.full((1, 1), 2.0),
        np.full((1, 1), share),
    )
    return shorten(wanted, model.radius)[0]


def test_best_response_zeroes_the_own_gradient_at_the_next_estimates():
    rows = [[3.0, 0.5, 0.2, -0.4], [0.5, 2.0, 0.1, 0.3]]
    gradient, drift = [1.0, -4.0], [0.0, 0.0, 2.0, -1.0]
    step = response(rows, gradient, drift)
    assert gradient + np.array(rows) @ [*step, 2.0, -1.0] == pytest.approx([0, 0], abs=1e-12)


@pytest.mark.parametrize(
    ("rows", "gradient", "arguments", "expected"),
    [
        (
            [[1.0, 2.0, -2.0]],
            [4.0],
            {},
            [-0.4],
        ),  # damped: the curvature 1 and, with a delay of 2, three times the excess of 3
        ([[1.0, 2.0, -2.0]], [4.0], {"share": 0.5}, [-4 / 5.5]),
        ([[-2.0, 0.0]], [4.0], {}, [-2.0]),  # a negative curvature gives a gradient step
        ([[0.0, 0.0]], [6.0], {"covariance": 100.0}, [-6 / 30]),  # and an unknown one a short step
        ([[0.0, 0.0]], [6.0], {}, [0.0]),  # without curvature there is no step
        ([[1.0, 0.0], [0.0, 1.0]], [4.0, -2.0], {"radius": 1.0}, [-1.0, 0.5]),  # the trust region shortens
        ([[2.0, 1.0], [1.0, 2.0]], [-2.0, 1.0], {"held": [True, False]}, [1.0, -0.5]),  # as if the held one stayed
    ],
)
def test_response_is_cautious(rows, gradient, arguments, expected):
    assert response(rows, gradient, [0.0] * len(rows[0]), **arguments) == pytest.approx(expected)


def test_a_damped_response_expects_copies_to_go_on():
    assert response([[1.0, 4.0]], [0.0], [0.0, 1.0]) == pytest.approx([-2.5 * 4 / 10])
    assert response([[5.0, 4.0]], [0.0], [0.0, 1.0]) == pytest.approx([-4 / 5])


def adapt(responses, delay=2.0, is_whole=True, share=1.0):
    """Shares of the damping after each of some responses of one player."""
    memory = laws.Relay(world_and_encoder("energy")[1].layout).initial_memory(1)._replace(share=np.full((1, 1), share))
    shares = []
    for response in responses:
        whole, delays = np.full((1, 1), is_whole), np.full((1, 1), delay)
        now, direction = relay._adapt(memory, np.array([[response]]), whole, delays)
        memory = memory._replace(share=now, direction=direction)
        shares.append(now.item())
    return shares


def test_responses_that_creep_are_damped_less_and_those_that_turn_back_more():
    steady = np.cumprod(np.full(40, 0.9))  # after k of them, |v| = 1 − (5/6)^k, which exceeds 0.6 from the sixth on
    shares = adapt(steady)
    assert shares[:5] == [1.0] * 5
    lengths = 1 - (5 / 6) ** np.arange(6, 9)
    assert shares[5:8] == pytest.approx(np.exp(np.cumsum(0.6 - lengths) / 4))
    assert shares[-1] == 0.125
    assert adapt(steady * (-1) ** np.arange(40), share=0.5)[-1] == 1
    assert adapt(steady, is_whole=False) == [1.0] * 40  # shortened steps say nothing
    assert adapt([0.0] * 40) == [1.0] * 40


def starts(scale, **changes):
    start = FactorySpec.of("start:uniform", low=-scale, high=scale)
    return RANDOM.replace(name=f"±{scale:g}", start=start, **changes)


PLAIN = [starts(scale) for scale in (0.01, 1e-6, 1e-12, 1e4)]
ZERO = starts(1.0, game=FactorySpec.of("game:random-energy", players=5, target=(-1e-300, 1e-300), base_price=0.0))
ROTATING = get_scenario(
    "random-affine",
    name="rotating",
    game=FactorySpec.of("game:random-affine", players=5, epsilon=0.1, asymmetry=10.0),
    channel=channel_part("AdditiveNoise", std=0.001),
)


def test_the_plainest_starts_cost_no_digits():
    """A small start is no small problem, and x* = 0 no division by 0."""
    results = evaluate(["relay"], [*PLAIN, ZERO], episodes=10)
    assert len(results.samples) == len(PLAIN) + 1
    for samples in results.samples.values():
        assert samples["digits"].mean() > 11.5


@pytest.mark.parametrize("point", ["equilibrium", "zero", "equal", "far"])
def test_a_start_without_differences_is_no_division_by_zero(point):
    world, encoder = world_and_encoder("energy")
    start = begin(world, [0])
    value = {"equilibrium": world.game.nash_equilibria, "zero": 0.0, "equal": 7.0, "far": 1e4}[point]
    estimates = np.broadcast_to(np.broadcast_to(value, (5, 1))[:, None], start.estimates.shape)
    state = start._replace(estimates=estimates.copy(), own_gradients=world.game.own_gradients(estimates))
    with np.errstate(divide="raise", invalid="raise", over="raise"):
        states = run(world, encoder, laws.Relay(encoder.layout), state)[..., 0]
    assert np.abs(states[-1] - world.game.nash_equilibrium[:, None]).max() < 1e-8


def test_games_that_rotate_come_to_rest():
    """Undamped best responses have a spectral radius of up to 10, and news cross the larger ring in five steps."""
    ring = ROTATING.replace(
        name="ring of 10",
        game=FactorySpec.of("game:random-affine", players=10, epsilon=0.3, asymmetry=10.0),
        topology=FactorySpec.of("topology:cycle", players=10),
    )
    results = evaluate(["relay", "static"], [ROTATING, ring], episodes=20)
    digits = {place: samples["digits"].mean() for place, samples in results.samples.items()}
    assert digits["rotating", "relay"] > 2
    assert digits["ring of 10", "relay"] > 1.5
    assert digits["rotating", "static"] < 0
    assert digits["ring of 10", "static"] < 0.5


@pytest.mark.parametrize(
    ("asymmetry", "epsilon", "channel", "least"),
    [
        (10.0, 0.1, FactorySpec.of("channel:loss", probability=0.5), 1.5),
        (3.0, 0.2, FactorySpec.of("channel:delay", steps=0, longest=6), 1.0),
    ],
)
def test_games_that_rotate_come_to_rest_although_messages_are_lost_or_late(asymmetry, epsilon, channel, least):
    """The first news come earlier than most; with the delay of the first ones, the digits are −0.7 and 0.1."""
    game = FactorySpec.of("game:random-affine", players=5, epsilon=epsilon, asymmetry=asymmetry)
    results = evaluate(["relay"], [ROTATING.replace(game=game, channel=channel)], episodes=10)
    assert results.samples["rotating", "relay"]["digits"].mean() > least


def test_the_delay_is_the_distance_of_the_farthest_player_on_a_fixed_graph():
    world, encoder = world_and_encoder(
        affine_scenario(2 * np.eye(6), np.ones(6), fixed_part(np.eye(6, k=1) + np.eye(6, k=-1)))
    )
    law, state, memory = laws.Relay(encoder.layout), begin(world, [0]), None
    for step in range(20):
        rows = encoder.observe(state)[0]
        actions, memory = law.predict(rows, memory)
        state = dynamics.step(world, state, encoder.decode(actions[None], state))
        if step == 3:  # the number of steps before, as there is no older news of all players yet
            assert memory.delay.ravel().tolist() == [3] * 6
    assert memory.delay.ravel() == pytest.approx([5, 4, 3, 3, 4, 5], abs=1e-3)


def test_damping_that_no_rotation_needs_falls():
    """The couplings of this potential game exceed its curvatures, so best responses are damped; none turns back."""
    matrix = 0.2 * np.eye(4) + np.ones((4, 4))
    world, encoder = world_and_encoder(affine_scenario(matrix, np.arange(4.0), fixed_part(1 - np.eye(4))))
    states = run(world, encoder, laws.Relay(encoder.layout), loop_start(world))[..., 0]
    assert np.abs(states[150] - world.game.nash_equilibrium[:, None]).max() < 1e-3  # 0.03 with all the damping


def test_two_players_who_chase_each_other_meet():
    """Each player's own curvature is a third of the coupling; the start is up to 20 units away."""
    world, encoder = world_and_encoder(
        affine_scenario([[0.3, 1.0], [-1.0, 0.3]], [1.0, -2.0], fixed_part(1 - np.eye(2)))
    )
    states = run(world, encoder, laws.Relay(encoder.layout), loop_start(world))[..., 0]
    assert np.abs(states[-1] - world.game.nash_equilibrium[:, None]).max() < 0.02


@pytest.mark.parametrize("scenario", [BLOCKS, BLOCKS_SWITCHING], ids=lambda scenario: scenario.name)
def test_players_of_unequal_dimensions_reach_the_equilibrium(scenario):
    world, encoder = world_and_encoder(scenario)
    states = run(world, encoder, laws.Relay(encoder.layout), loop_start(world))[..., 0]
    assert np.abs(states[-1] - world.game.nash_equilibrium[:, None]).max() < 1e-8


def test_relay_reaches_many_digits_in_games_and_with_messages_of_all_kinds():
    """Several components at a bound, curvature far from 1, costs that are not quadratic, and late messages."""
    late = RANDOM.replace(name="late", channel=channel_part("Delay", steps=1, longest=7))
    least = {"random-energy": 11.5, "ev-charging": 11.5, "cournot": 11.5, "non-quadratic": 10, late: 6}
    results = evaluate(["relay"], [*least], episodes=8)
    assert len(results.samples) == len(least)
    for samples, digits in zip(results.samples.values(), least.values(), strict=True):
        assert np.median(samples["digits"]) > digits


def test_noise_is_averaged():
    noisy = RANDOM.replace(name="noisy", channel=channel_part("AdditiveNoise", std=0.05))
    results = evaluate(["relay", "grounded"], [noisy], episodes=10)
    relay, plain = (results.samples["noisy", name]["digits"].mean() for name in ("relay", "grounded"))
    assert relay > plain + 0.3


def kept(means, is_noisy=True):
    """What is left of the differences of one component, step by step."""
    size = outlier = np.zeros((1, 1))
    left = []
    for mean in means:
        now, size, outlier = relay._drop_outliers(np.full((1, 1), mean), size, outlier, np.full((1, 1), is_noisy))
        left.append(now.item())
    return left


def test_one_message_that_is_far_off_is_dropped_and_two_are_news():
    usual = [1.0, -1.0, 1.0]
    assert kept([*usual, 9.0, -1.0]) == [*usual, 0.0, -1.0]
    assert kept([*usual, 9.0, -9.0]) == [*usual, 0.0, 0.0]
    assert kept([*usual, 9.0, 9.0, 9.0]) == [*usual, 0.0, 9.0, 9.0]  # the median has followed
    assert kept([*usual, 0.0, 9.0, 0.0, 9.0]) == [*usual, 0.0, 0.0, 0.0, 9.0]  # nothing was heard in between
    assert kept([*usual, 9.0], is_noisy=False) == [*usual, 9.0]


def test_messages_that_are_far_off_at_times_cost_few_digits(monkeypatch):
    tails = RANDOM.replace(name="tails", channel=channel_part("HeavyTails", scale=0.1))
    digits = evaluate("relay", tails, episodes=10).samples["tails", "relay"]["digits"].mean()
    monkeypatch.setattr(relay, "_OUTLIER", 1e9)
    assert digits > evaluate("relay", tails, episodes=10).samples["tails", "relay"]["digits"].mean() + 0.3


@pytest.mark.parametrize("arguments", [{"patience": 0}, {"patience": 2.5}, {"forgetting": 0.0}])
def test_wrong_numbers_are_named(arguments):
    with pytest.raises(ValueError, match=f"{next(iter(arguments))} must be"):
        laws.Relay(world_and_encoder("energy")[1].layout, **arguments)


def test_noise_that_begins_late_is_averaged_too():
    late = RANDOM.replace(name="late", channel=FactorySpec.of("channel:late-noise", std=0.05, step=150))
    results = evaluate(["relay"], [late], episodes=6)
    assert results.samples["late", "relay"]["digits"].mean() > 2.9


def test_estimates_follow_neighbours_whose_messages_never_change():
    """Rounding hides all, so no message is news, and a copy in the middle is better than a far start."""
    hidden = get_scenario(
        "random-energy",
        steps=100,
        start=FactorySpec.of("start:uniform", low=-400.0, high=400.0),
        channel=channel_part("UniformQuantiser", width=1000.0),
    )
    results = evaluate(["relay", "zero-input"], [hidden], episodes=4)
    relay, nothing = (results.summary("random-energy", name, "digits").mean for name in results.policies)
    assert relay > nothing + 1


def test_players_without_news_meet_in_the_middle():
    """Two players who hear of a third one from each other alone: whole steps would exchange their copies for ever."""
    edges = FactorySpec.of("topology:edges", players=3, edges=[[0, 1]])
    away = FactorySpec.of("topology:edges", players=3, edges=[[1, 2]])
    late = FactorySpec.of("topology:periodic", graphs=[edges, away], dwells=[100.0, 1.0], clock="transformed")
    world, encoder = world_and_encoder(get_scenario("random-energy", players=3, topology=late, steps=200))
    states = run(world, encoder, laws.Relay(encoder.layout), begin(world, [0]))[..., 0]
    copies = states[-2, 2, :2]
    assert copies[0] == pytest.approx(copies[1], abs=1e-6 * np.abs(copies).max())
    assert np.abs(states[30, 2, 0] - states[30, 2, 1]) < np.abs(states[0, 2, 0] - states[0, 2, 1])


def test_players_who_copy_each_other_do_not_exchange_their_copies_for_ever():
    """As two newcomers would, each of whom takes the other's copy at their first contact."""
    world, encoder = world_and_encoder(get_suite("ptne-v1").track("switching-physical").scenario)
    for seed in range(4):
        states = run(world, encoder, laws.Relay(encoder.layout), begin(world, [seed]))[..., 0]
        before, after = states[:-1, :, :, None], states[1:, :, :, None]
        apart = np.abs(before - np.moveaxis(before, 3, 2)) > 0.1
        takes = np.abs(after - np.moveaxis(before, 3, 2)) < 0.01
        swaps = apart & takes & np.moveaxis(takes, 3, 2)  # of component c by players i and j in step k: (K, n, N, N)
        assert not (swaps[:-1] & swaps[1:]).any()


def distances_to_owners(scenario, seeds=range(6)):
    """How far copies are from their owners' strategies at T, (n, N, B), in games of players with a component each."""
    world, encoder = world_and_encoder(scenario)
    estimates = run(world, encoder, laws.Relay(encoder.layout), begin(world, seeds))[-1]
    return np.abs(estimates - np.einsum("ccb->cb", estimates)[:, None])


def test_a_constant_error_on_links_adds_up_along_the_way_from_the_owner_alone():
    """Two players who took each other's copies for news would add their errors in every step."""
    bound, path = 0.02, FactorySpec.of("topology:path", players=5)
    biased = RANDOM.replace(topology=path, channel=channel_part("Bias", bound=bound))
    way = np.abs(np.subtract.outer(np.arange(5), np.arange(5)))
    assert (distances_to_owners(biased) <= bound * way[:, :, None] + 1e-5).all()


def test_copies_of_noise_do_not_hide_news():
    """Two players who took each other's noise for news would go on copying it, and rest at no time."""
    game, ring = (FactorySpec.of(part, players=8) for part in ("game:random-energy", "topology:cycle"))
    start, channel = FactorySpec.of("start:uniform", low=-0.02, high=0.02), channel_part("AdditiveNoise", std=0.01)
    assert distances_to_owners(RANDOM.replace(game=game, topology=ring, start=start, channel=channel)).max() < 0.1


def test_late_copies_are_no_news_under_noise():
    """On directed graphs a neighbour that does not hear the player may get the same news later, over a longer way."""
    game, graph = FactorySpec.of("game:random-energy", players=12), random_digraph(np.random.default_rng(0), 12)
    noisy = RANDOM.replace(game=game, topology=graph, channel=channel_part("AdditiveNoise", std=0.1))
    assert distances_to_owners(noisy).max() < 0.1


def test_messages_that_overtake_each_other_part_no_player_from_the_owners():
    """A message that is late says what the neighbour's copy was before, as if it moved again."""
    game = FactorySpec.of("game:random-affine", players=8, scale=0.1, low=-0.1, high=0.1)
    ring, delay = FactorySpec.of("topology:cycle", players=8), FactorySpec.of("channel:delay", steps=0, longest=10)
    start = FactorySpec.of("start:uniform", low=-400.0, high=400.0)
    late = RANDOM.replace(game=game, topology=ring, start=start, channel=delay, steps=400, input_limit=1e5)
    assert distances_to_owners(late).max() < 0.1


def test_large_inputs_do_not_make_a_small_problem_large():
    """Own estimates are much smaller than the equilibria, and these than what inputs may do in a step."""
    target = FactorySpec.of("game:random-energy", target=[-1e-5, 1e-5], base_price=0.0)
    small = RANDOM.replace(game=target, start=FactorySpec.of("start:uniform", low=-1e-7, high=1e-7))
    world, encoder = world_and_encoder(small)
    states = run(world, encoder, laws.Relay(encoder.layout), begin(world, range(4)))
    assert np.abs(states).max() < 1e-4


def test_slow_moves_add_up_to_news():
    """Inputs are so limited that no step moves a copy by more than noise."""
    slow = RANDOM.replace(name="slow", deadline=0.3, input_limit=4.0, channel=channel_part("AdditiveNoise", std=0.02))
    results = evaluate(["relay"], [slow], episodes=4)
    assert results.samples["slow", "relay"]["digits"].min() > 2.5
