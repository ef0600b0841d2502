"""Code as a transport: it gains digits where it can, and costs little where it cannot."""

import numpy as np
import pytest
from small_suite import STRANGERS
from worlds import begin, world_and_encoder

from ptne_env import FactorySpec, evaluate, get_scenario, learn
from ptne_env.evaluation import get_policy_spec
from ptne_env.laws import Coded, Static
from ptne_env.learn.layers import LayeredPolicy, Metadata, weight_shapes
from ptne_env.perception.observation import LayoutError
from ptne_env.perception.policy import NetworkPolicy
from ptne_env.suites import get_suite, leaderboard, run_suite
from ptne_env.world import dynamics

PAIR = ["relay", "coded-relay"]
DELAYED = get_scenario("random-energy").replace(
    name="delayed",
    message_range=100.0,
    channel=FactorySpec.of(
        "channel:chain",
        stages=[FactorySpec.of("channel:delay", steps=3), FactorySpec.of("channel:noise", std=0.001)],
    ),
)


def gain(world):
    """The mean digits that code gains over relay."""
    results = evaluate(PAIR, [world], episodes=10)
    plain, coded = (results.samples[world.name, law]["digits"].mean() for law in PAIR)
    return coded - plain


def test_code_gains_digits():
    """So no document may say that code is useless."""
    assert gain(get_suite("ptne-v1").track("rounding")) > 2


@pytest.mark.parametrize("world", [DELAYED, get_suite("ptne-v1").track("short-deadline"), STRANGERS])
def test_players_whose_code_is_not_understood_play_the_relay(world):
    """The first rounds, in which they find out, cost some digits."""
    assert gain(world) > -0.5


def test_any_policy_wears_code_and_is_then_ranked_apart():
    """The network remembers in another form than laws do; code helps it where prices saturate, too."""
    results = run_suite("ptne-v1", ["recurrent-random-worlds", "coded-network", "relay"], tracks="curved", episodes=8)
    assert results.difference("coded-network", "recurrent-random-worlds", "curved").low > 0.5
    board = {row.policy: row.mean_rank for row in leaderboard(results)}
    assert list(board)[-2:] == ["coded-network", "oracle"]
    assert board["coded-network"] is None
    assert board["recurrent-random-worlds"] == 1


def play_alone(world, encoder, policy, seed, steps):
    """The observations and actions of an episode."""
    state, memory, rows, actions = begin(world, [seed]), None, [], []
    for _ in range(steps):
        rows.append(encoder.observe(state)[0])
        decided, memory = policy.predict(rows[-1], memory)
        actions.append(decided)
        state = dynamics.step(world, state, encoder.decode(decided[None], state))
    return rows, actions


def gated(layout):
    """A network with a gated recurrent unit, as PPO trains them, of random weights."""
    shapes = weight_shapes(layout.size, (8, 16), layout.action_size, recurrent=True)
    draw = np.random.default_rng(0).normal
    weights = {name: draw(size=shape).astype(np.float32) / 10 for name, shape in shapes.items()}
    return LayeredPolicy("gated", weights, Metadata(layout.interface, layout.action_dims, layout.slots, {}))


def foreign(layout):
    """A network of another library, which declares no interface."""
    return NetworkPolicy(lambda rows, memory, *_: (np.tanh(rows[:, : layout.action_size]), memory))


@pytest.mark.parametrize("policy", ["coded-relay", "coded-network", gated, foreign])
def test_players_whose_episodes_began_at_other_times_decide_as_they_would_alone(policy):
    world, encoder = world_and_encoder(get_suite("ptne-v1").track("curved").scenario)
    layout = encoder.layout
    policy = get_policy_spec(policy).build(layout) if isinstance(policy, str) else Coded(layout, policy)

    runs = [play_alone(world, encoder, policy, seed, steps) for seed, steps in enumerate((60, 31, 29))]
    first, second = (before + after for before, after in zip(runs[1], runs[2], strict=True))
    memory = None
    for step in range(60):
        starts = np.repeat([step == 0, step in (0, 31)], 5)
        actions, memory = policy.predict(np.concatenate([runs[0][0][step], first[step]]), memory, starts)
        assert np.array_equal(actions, np.concatenate([runs[0][1][step], second[step]]))


def test_a_network_of_another_library_with_a_memory_wears_no_code():
    world, encoder = world_and_encoder(get_suite("ptne-v1").track("curved").scenario)
    policy = Coded(encoder.layout, NetworkPolicy(lambda rows, *_: (rows[:, :1], rows)))
    with pytest.raises(ValueError, match="cannot be kept for some players alone"):
        play_alone(world, encoder, policy, 0, world.clock.total_steps)


def test_code_needs_natural_units():
    _, encoder = world_and_encoder("random-energy", kind="scaled")
    with pytest.raises(LayoutError, match="code needs"):
        Coded(encoder.layout, Static)
    _, encoder = world_and_encoder("random-energy")
    with pytest.raises(LayoutError, match="code needs"):
        Coded(encoder.layout, learn.load("ppo-nominal"))
