"""Contacts and routed play: who has the fresher copy, and the path of every copy."""

import numpy as np
import pytest
from affine_games import SOAK, affine_scenario, random_affine, random_digraph, run
from worlds import begin, channel_part, fixed_part, world_and_encoder

from ptne_env import FactorySpec, evaluate, get_scenario, laws
from ptne_env.laws.sources import Contacts, find_sources


class Sight:
    """What contacts read of an observation."""

    def __init__(self, relative_estimates):
        self.relative_estimates = np.reshape(relative_estimates, (1, -1, 1))
        self.weights, self.unit = np.ones(self.relative_estimates.shape[:2]), np.ones((1, 1))


def known(slots=1, live=0.0, moved=0.0, seen=0.0, before=0.0, source=0.0, votes=0.0, news=1.0):
    """The contacts so far of one player in a game of one component."""
    links = np.ones((1, slots))
    each = [
        np.broadcast_to(np.reshape(part, (1, -1, 1)), (1, slots, 1)) for part in (moved, seen, before, source, votes)
    ]
    return Contacts(live * links, links, *each, np.full((1, 1), news))


def judge(sight, was, noise=0.0):
    shape = sight.relative_estimates.shape
    no_owner, has_begun = np.zeros(shape, dtype=bool), np.ones((1, 1), dtype=bool)
    return find_sources(sight, was, has_begun, np.zeros((1, 1)), no_owner, np.full((1, 1, 1), noise))


def one_contact(mine, theirs, votes=0.0, seen=0.0, before=0.0, news=1.0, noise=0.0, lasts=False):
    """Whether the neighbour becomes the source at the start of a contact, or later; moves since the last one."""
    sight = Sight(theirs - mine + (seen if np.isfinite(seen) else 0.0))
    was = known(live=float(lasts), moved=mine, seen=seen, before=before, votes=votes, news=news)
    sources, fresh = judge(sight, was, noise)
    return sources.item(), fresh.votes.item()


@pytest.mark.parametrize(
    ("moves", "memory", "expected"),
    [
        ((0.0, 1.0), {}, (True, 1)),  # a copy that moved alone is the fresher one, and gets a vote
        ((1.0, 0.0), {}, (False, -1)),
        ((0.0, 0.0), {"seen": 2.0}, (False, 0)),
        ((1.0, 2.0), {}, (True, 0)),  # of two copies that moved, the one that moved further
        ((2.0, 1.0), {}, (False, 0)),
        ((1.0, 2.0), {"votes": -1}, (False, -1)),  # unless votes tell
        ((2.0, 1.0), {"votes": 1}, (True, 1)),
        ((0.0, 0.0), {"seen": np.inf, "news": 0.0}, (True, 0)),  # a player without news takes any copy
        ((0.0, 0.0), {"seen": np.inf, "news": 1.0}, (False, 0)),
        ((0.0, 1.0), {"lasts": True}, (True, 0)),  # during a contact, a move beyond noise is news
        ((0.0, 1.0), {"lasts": True, "noise": 0.9}, (True, 0)),
        ((0.0, 1.0), {"lasts": True, "noise": 1.1}, (False, 0)),
        ((0.0, 1.0), {"lasts": True, "before": 1.0}, (False, 0)),  # unless it repeats the own move of the step before
        ((0.0, 1.0), {"lasts": True, "before": 0.5}, (True, 0)),
    ],
)
def test_the_copy_that_moved_is_the_fresher_one(moves, memory, expected):
    assert one_contact(*moves, **memory) == expected


@pytest.mark.parametrize(
    ("before", "after", "source", "wakes"), [(0.0, 1.0, 1.0, False), (1.0, 0.5, 1.0, False), (1.0, 0.5, 0.0, True)]
)
def test_no_neighbour_replaces_a_live_source_during_a_contact(before, after, source, wakes):
    was = known(slots=2, live=1.0, seen=[0.0, before], source=[source, 0.0])
    assert judge(Sight([0.0, after]), was)[0][0, 1, 0] == wakes


def hops_of(adjacency):
    """Hop counts by Floyd's algorithm."""
    hops = np.where(adjacency > 0, 1.0, np.inf)
    np.fill_diagonal(hops, 0)
    for middle in range(len(hops)):
        hops = np.minimum(hops, hops[:, [middle]] + hops[[middle]])
    return hops.astype(int)


def episode(law, scenario, seeds=(0,), **arguments):
    """The world, and all estimates (K+1, n, N, B) of a law in the scenario."""
    world, encoder = world_and_encoder(scenario)
    return world, run(world, encoder, law(encoder.layout, **arguments), begin(world, seeds))


@pytest.mark.parametrize("is_directed", [False, True])
@pytest.mark.parametrize("seed", range(100 if SOAK else 3))
def test_a_copy_is_what_the_owner_had_as_many_steps_ago_as_there_are_links(seed, is_directed):
    matrix, offset, adjacency = random_affine(np.random.default_rng(seed), 3 + seed % 4)
    if is_directed:
        adjacency = random_digraph(np.random.default_rng(seed), len(matrix))
    hops, step = hops_of(adjacency), 0.5 / np.diag(matrix).max()
    scenario = affine_scenario(matrix, offset, fixed_part(adjacency), input_limit=1e5, steps=60)
    world, states = episode(laws.RoutedUnknown, scenario, seeds=(seed, seed + 1), step=step)
    late = 2 * hops.max()
    for i, o in np.argwhere(hops >= 0):
        copies, sent = states[late:, o, i], states[late - hops[i, o] : len(states) - hops[i, o], o, o]
        np.testing.assert_allclose(copies, sent, rtol=0, atol=2e-5)
    for k in (late, late + 7):
        gradients = np.einsum("ic,cib->ib", matrix, states[k]) + world.game.offset[:, None]
        expected = np.einsum("iib->ib", states[k]) - step * gradients
        np.testing.assert_allclose(np.einsum("iib->ib", states[k + 1]), expected, rtol=0, atol=2e-5)


def switching(players, modes, dwells):
    graphs = tuple(FactorySpec.of("ptne_env.world.graphs:from_edges", players=players, edges=mode) for mode in modes)
    return FactorySpec.of("topology:periodic", graphs=graphs, dwells=dwells, clock="transformed")


def test_owner_is_the_only_source_from_the_first_meeting_on():
    """Player 0 first hears of component 1 through player 2, then meets player 1 itself, and then player 2 alone."""
    modes = [[(1, 2)], [(0, 2)], [(1, 2), (0, 2)], [(0, 1)], [(0, 2)], [(1, 2)]]
    scenario = affine_scenario(
        np.eye(3) + 0.1, np.ones(3), switching(3, modes, (0.1,) * 6), gain=0.0, s_end=20.0, input_limit=1e5
    )
    world, states = episode(laws.RoutedUnknown, scenario)
    for k, (before, after) in enumerate(zip(states[:, 1, :, 0], states[1:, 1, :, 0], strict=False)):
        links, met = modes[world.modes[k]], 3 in world.modes[: k + 1]
        if (0, 1) in links:
            assert after[0] == pytest.approx(before[1], abs=1e-5)
        elif met:
            assert after[0] == before[0]
        elif k > np.flatnonzero(world.modes == 2)[1]:
            assert after[0] == pytest.approx(before[2], abs=1e-5)


def test_news_that_never_move_reach_players_without_news():
    """Player 2 settles before player 0 meets player 1, whose copy of its strategy never moves again."""
    topology = switching(3, [[(1, 2)], [(0, 1)]], (10.0, 10.0))
    scenario = affine_scenario(np.eye(3), np.ones(3), topology, gain=0.0, s_end=20.0, input_limit=1e5)
    _, states = episode(laws.RoutedUnknown, scenario, step=1.0)
    assert states[-1, 2, 0, 0] == pytest.approx(states[-1, 2, 2, 0], abs=1e-4)


def test_moves_within_noise_add_up_while_the_own_copy_rests():
    was = known(live=1.0)
    for distance in (0.6, 1.2, 1.8):
        found, was = judge(Sight([distance]), was, noise=1.0)
        assert found.item() is (distance > 1)
        if found.item():
            break
    else:
        pytest.fail("no news")


def test_sources_are_found_where_links_switch_and_where_messages_are_noisy():
    noisy = get_scenario("random-energy").replace(name="noise", channel=channel_part("AdditiveNoise", std=0.05))
    laws = ["routed-unknown", "relay", "static"]
    results = evaluate(
        laws, [noisy, get_scenario("random-energy-switching-transformed")], episodes=20 if SOAK else 4, seed=87235
    )
    digits = {place: samples["digits"].mean() for place, samples in results.samples.items()}
    assert digits["noise", "relay"] > digits["noise", "static"] + 0.3
    for name in laws[:2]:
        assert digits["random-energy-switching-transformed", name] > 5


def test_a_step_must_be_positive():
    with pytest.raises(ValueError, match="step must be a finite number above 0"):
        laws.RoutedUnknown(world_and_encoder("energy")[1].layout, step=0.0)
