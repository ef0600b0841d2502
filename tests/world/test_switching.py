import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import ptne_env
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.world import graphs, switching
from ptne_env.world.graphs import Graph
from ptne_env.world.switching import EpisodeTopology, RandomTopology, SwitchingTopology


def test_paper_topology_has_four_disconnected_modes_with_union_cycle():
    topology = switching.paper_topology()
    assert [graph.edges for graph in topology.graphs] == [
        [(0, 1), (2, 3)],
        [(1, 2), (3, 4)],
        [(0, 4), (2, 3)],
        [(0, 1), (3, 4)],
    ]
    assert not any(graph.is_connected for graph in topology.graphs)
    assert topology.is_jointly_connected
    assert topology.union == graphs.cycle(5)
    assert topology.period == pytest.approx(0.4)
    assert topology.mean_dwell == pytest.approx(0.1)


@given(st.lists(st.floats(0.05, 2.0), min_size=2, max_size=5), st.lists(st.floats(0.0, 50.0), min_size=1, max_size=20))
def test_schedule_agrees_with_a_walk_through_the_dwells(dwells, instants):
    topology = SwitchingTopology([graphs.path(3)] * len(dwells), dwells)
    schedule = topology.schedule(instants)
    for instant, mode, since in zip(instants, schedule.modes, schedule.time_since_switch, strict=True):
        now, walked = instant, 0
        while now >= dwells[walked % len(dwells)]:
            now -= dwells[walked % len(dwells)]
            walked += 1
        if min(now, dwells[walked % len(dwells)] - now) < 1e-6:
            continue  # rounding decides at a switch; see the next test
        assert mode == walked % len(dwells)
        assert since == pytest.approx(min(now / np.mean(dwells), 1.0), abs=1e-6)


def test_rounded_multiples_of_the_dwell_start_the_next_mode():
    topology = switching.paper_topology(dwell=0.1)
    instants = np.concatenate([np.arange(400) * 0.1, np.cumsum(np.full(400, 0.1))])
    schedule = topology.schedule(instants)
    expected = np.concatenate([np.arange(400), np.arange(1, 401)]) % 4
    assert np.array_equal(schedule.modes, expected)
    assert schedule.time_since_switch == pytest.approx(np.zeros(800), abs=1e-8)


def test_time_since_switch_is_relative_to_the_mean_dwell_and_clipped():
    topology = SwitchingTopology([graphs.path(3)] * 2, [3.0, 1.0])
    assert topology.schedule([0.0, 1.0, 2.9, 3.0, 3.5]).time_since_switch == pytest.approx([0.0, 0.5, 1.0, 0.0, 0.25])


def test_fixed_topology_never_switches():
    topology = switching.fixed(graphs.cycle(4))
    schedule = topology.schedule([0.0, 1e9])
    assert schedule.modes.tolist() == [0, 0]
    assert schedule.time_since_switch.tolist() == [0, 0]
    assert topology.switches(0, 1e9).size == 0


@given(st.lists(st.floats(0.1, 2.0), min_size=2, max_size=4), st.floats(0, 20), st.floats(0.1, 10))
def test_mode_changes_at_every_switch_and_nowhere_else(dwells, start, length):
    topology = SwitchingTopology([graphs.path(3)] * len(dwells), dwells)
    switches = topology.switches(start, start + length)
    assert np.all((switches > start) & (switches < start + length))
    before, after = (topology.schedule(switches + shift).modes for shift in (-1e-6, 1e-6))
    assert np.array_equal((before + 1) % len(dwells), after)
    bounds = np.concatenate([[start], switches, [start + length]])
    middles = topology.schedule((bounds[:-1] + bounds[1:]) / 2).modes
    assert np.array_equal((middles[:-1] + 1) % len(dwells), middles[1:])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"graphs": []}, "at least one graph"),
        ({"graphs": [graphs.path(3), graphs.path(4)], "dwells": [1, 1]}, "same number of players"),
        ({"graphs": [graphs.path(3)] * 2}, "dwell times"),
        ({"graphs": [graphs.path(3)] * 2, "dwells": [1.0]}, "one dwell time per graph"),
        ({"graphs": [graphs.path(3)], "clock": "wall"}, "unknown clock of a topology"),
    ],
)
def test_inconsistent_topologies_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        SwitchingTopology(**arguments)


FALSE_ALARM = 1e-6
"""Probability of a false alarm of each statistical test below; seeds are fixed."""

PAIRS = [graphs.from_edges(4, [(0, 1)]), graphs.from_edges(4, [(1, 2)]), graphs.from_edges(4, [(2, 3)])]


def generators(count, seed=0):
    return [RandomStreams.from_seed(seed + index).graph for index in range(count)]


def walked(topology, instants, generator):
    """Mode and time since the last switch, by a walk from dwell to dwell with the same draws, in plain Python."""
    shortest, longest = topology.dwell_range
    count = int(max(instants) / shortest) + 2
    choices, units = generator.random((2, count))
    modes, since = [], []
    for instant in instants:
        mode = int(choices[0] * len(topology.graphs))
        start, dwell = 0.0, 0
        while True:
            end = start + shortest + (longest - shortest) * units[dwell]
            if instant < end - 1e-9 * shortest:
                break
            start, dwell, mode = end, dwell + 1, int(choices[dwell + 1] * len(topology.graphs))
        modes.append(mode)
        since.append(min((instant - start) / topology.mean_dwell, 1.0))
    return modes, since


@pytest.mark.parametrize(
    "topology",
    [
        RandomTopology(PAIRS, (0.2, 0.7)),
        RandomTopology(PAIRS, 0.25),
        switching.random_edges(graphs.complete(4), 0.3, (0.2, 0.7), modes=5),
    ],
    ids=["pool", "pool, dwells known", "edges"],
)
def test_drawn_schedule_agrees_with_a_walk_through_the_draws(topology):
    instants = np.linspace(0, 12, 97)
    schedule = topology.draw(instants, generators(6))
    assert schedule.modes.shape == schedule.time_since_switch.shape == (97, 6)
    for b, generator in enumerate(generators(6)):
        modes, since = walked(topology, instants.tolist(), generator)
        assert schedule.modes[:, b].tolist() == modes
        assert schedule.time_since_switch[:, b] == pytest.approx(np.array(since), abs=1e-9)
    assert len({tuple(column) for column in schedule.modes.T}) > 1


def test_modes_and_dwells_are_uniform():
    topology = RandomTopology(PAIRS, 1.0)
    modes = topology.draw(np.arange(60) + 0.5, generators(300)).modes
    pairs = np.bincount(3 * modes[:-1].ravel() + modes[1:].ravel(), minlength=9)  # so they are independent too
    assert stats.chisquare(pairs).pvalue > FALSE_ALARM
    since = RandomTopology(PAIRS, (0.5, 1.5)).draw(np.linspace(0, 1.5, 3001), generators(400)).time_since_switch
    first = np.diff(since, axis=0).argmin(axis=0) * 0.0005  # the first dwell of each episode
    assert stats.kstest(first - 0.5, "uniform").pvalue > FALSE_ALARM


def test_links_are_up_with_the_given_probability():
    topology, again, other = (
        switching.random_edges(graphs.complete(6), 0.3, 1.0, modes=100, seed=seed) for seed in (3, 3, 4)
    )
    up = sum(len(graph.edges) for graph in topology.graphs)
    assert stats.binomtest(up, 100 * 15, 0.3).pvalue > FALSE_ALARM
    assert again.graphs == topology.graphs != other.graphs
    weighted = switching.random_edges(Graph([[0, 2.5], [2.5, 0]]), 0.5, 1.0, modes=20)
    assert {graph.adjacency[0, 1] for graph in weighted.graphs} == {0.0, 2.5}
    directed = switching.random_edges(Graph([[0, 2, 0], [1, 0, 1], [1, 0, 0]]), 0.5, 1.0, modes=200)
    drawn = {tuple(graph.adjacency[[0, 1, 1, 2], [1, 0, 2, 0]]) for graph in directed.graphs}
    assert drawn == {(a, b, c, d) for a in (0, 2) for b in (0, 1) for c in (0, 1) for d in (0, 1)}
    assert not any(graph.adjacency[[0, 2], [2, 1]].any() for graph in directed.graphs)


def test_every_episode_draws_its_graph_and_keeps_it():
    topology, instants = switching.random_graphs(5, 0.5, modes=7, seed=1), np.linspace(0, 3, 11)
    schedule = topology.draw(instants, generators(2000))
    assert schedule.modes.shape == schedule.time_since_switch.shape == (11, 2000)
    assert not schedule.time_since_switch.any()
    assert not np.diff(schedule.modes, axis=0).any()
    assert stats.chisquare(np.bincount(schedule.modes[0], minlength=7)).pvalue > FALSE_ALARM
    for b in range(5):
        alone = topology.draw(instants, generators(1, seed=b))
        assert np.array_equal(alone.modes[:, 0], schedule.modes[:, b])
    assert topology.shortest_dwell == topology.mean_dwell == topology.period == np.inf


class Counted(EpisodeTopology):
    """Modes of the user's own, which begin at a number."""

    first: int = 0

    def draw(self, instants, generators):
        schedule = super().draw(instants, generators)
        return schedule._replace(modes=np.full_like(schedule.modes, self.first))


@pytest.mark.parametrize("first", [-1, 2])
def test_modes_of_a_topology_of_ones_own_that_name_no_graph_are_refused(first):
    topology = Counted([graphs.cycle(5), graphs.path(5)], first=first)
    env = ptne_env.parallel_env("energy", topology=topology)
    with pytest.raises(ValueError, match=r"Counted.draw must return modes from 0 to 1 and .*, of shape \(\d+, 1\)"):
        env.reset(seed=0)
    ptne_env.parallel_env("energy", topology=Counted(topology.graphs, first=1)).reset(seed=0)


def test_random_graphs_are_uniform_over_connected_graphs():
    topology = switching.random_graphs(4, 0.5, modes=400, seed=2)
    again, other = (switching.random_graphs(4, 0.5, modes=20, seed=seed) for seed in (2, 3))
    assert topology.graphs[:20] == again.graphs != other.graphs
    assert all(graph.is_connected for graph in topology.graphs)
    # At probability 1/2 all connected graphs are equally likely: of 4 players there are 16, 15, 6 and 1 with 3, ..., 6
    # links.
    links = np.bincount([len(graph.edges) for graph in topology.graphs], minlength=7)
    assert not links[:3].any()
    assert stats.chisquare(links[3:], 400 * np.array([16, 15, 6, 1]) / 38).pvalue > FALSE_ALARM
    with pytest.raises(ValueError, match="hardly any graph of 5 players is connected"):
        switching.random_graphs(5, 1e-6, modes=2)
    with pytest.raises(ValueError, match="between 0 and 1"):
        switching.random_graphs(5, 1.5)
    with pytest.raises(ValueError, match="at least two"):
        EpisodeTopology([graphs.path(3)])
    with pytest.raises(ValueError, match="draw one per episode"):
        topology.schedule([0.0])


def test_joint_connectivity_of_every_kind_of_topology():
    apart = [graphs.from_edges(4, [(0, 1)]), graphs.from_edges(4, [(2, 3)])]
    for topology in (SwitchingTopology(PAIRS, [1] * 3), RandomTopology(PAIRS, 1.0), switching.random_graphs(4, 0.5)):
        assert topology.is_jointly_connected
    pool = EpisodeTopology([graphs.path(4), apart[0]])
    for topology in (switching.fixed(apart[0]), SwitchingTopology(apart, [1, 1]), RandomTopology(apart, 1.0), pool):
        assert not topology.is_jointly_connected
    assert not switching.random_edges(graphs.cycle(4), 1e-9, 1.0).is_jointly_connected


def test_random_topology_has_no_schedule_without_a_draw():
    topology = RandomTopology(PAIRS, (0.2, 0.7))
    assert topology.is_random
    assert not topology.is_fixed
    assert (topology.shortest_dwell, topology.mean_dwell) == (0.2, pytest.approx(0.45))
    for call in (lambda: topology.schedule([0.0]), lambda: topology.switches(0, 1)):
        with pytest.raises(ValueError, match="is random and has no"):
            call()
    with pytest.raises(ValueError, match="starts at 0"):
        topology.draw([-1.0, 0.0], generators(1))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"dwells": (0.7, 0.2)}, "the shortest dwell comes first"),
        ({"dwells": (0.1, 0.2, 0.3)}, "a time or a range"),
        ({"graphs": [graphs.path(3)]}, "at least two graphs"),
    ],
)
def test_invalid_random_topologies_are_refused(arguments, message):
    defaults = {"graphs": [graphs.path(3)] * 2, "dwells": 1.0}
    with pytest.raises(ValueError, match=message):
        RandomTopology(**(defaults | arguments))
