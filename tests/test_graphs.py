import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ptne_env import graphs
from ptne_env.graphs import Graph, Signal


@st.composite
def adjacencies(draw, players=None):
    count = players or draw(st.integers(2, 7))
    matrix = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            matrix[i, j] = matrix[j, i] = draw(st.sampled_from([0.0, 0.0, 0.5, 1.0, 3.0]))
    return matrix


@pytest.mark.parametrize("players", [3, 5, 8])
def test_named_graphs_have_their_textbook_connectivity(players):
    circle = 2 * np.pi / players
    assert graphs.cycle(players).algebraic_connectivity == pytest.approx(2 - 2 * np.cos(circle))
    assert graphs.path(players).algebraic_connectivity == pytest.approx(2 - 2 * np.cos(circle / 2))
    assert graphs.star(players).algebraic_connectivity == pytest.approx(1.0)
    assert graphs.complete(players).algebraic_connectivity == pytest.approx(players)


def test_named_graphs_have_their_links():
    assert graphs.cycle(4).edges == [(0, 1), (0, 3), (1, 2), (2, 3)]
    assert graphs.path(4).edges == [(0, 1), (1, 2), (2, 3)]
    assert graphs.star(4).edges == [(0, 1), (0, 2), (0, 3)]
    assert graphs.complete(3).edges == [(0, 1), (0, 2), (1, 2)]


@given(adjacencies())
def test_laplacian_is_degree_minus_adjacency_and_sums_to_zero(matrix):
    graph = Graph(matrix)
    for i in range(graph.num_players):
        assert graph.laplacian[i, i] == matrix[i].sum()
        for j in range(i):
            assert graph.laplacian[i, j] == -matrix[i, j]
    assert graph.laplacian.sum(axis=1) == pytest.approx(np.zeros(graph.num_players), abs=1e-12)


@given(adjacencies())
def test_connected_exactly_when_every_player_is_reached(matrix):
    reached, frontier = {0}, [0]
    while frontier:
        for j in np.flatnonzero(matrix[frontier.pop()]).tolist():
            if j not in reached:
                reached.add(j)
                frontier.append(j)
    graph = Graph(matrix)
    assert graph.is_connected == (len(reached) == len(matrix))
    assert graph.is_connected == (graph.algebraic_connectivity > 1e-9)


@given(adjacencies(players=4), adjacencies(players=4))
def test_union_has_every_link_with_its_largest_weight(first, second):
    assert np.array_equal(graphs.union([Graph(first), Graph(second)]).adjacency, np.maximum(first, second))


def test_networkx_round_trip_keeps_weights():
    graph = nx.Graph()
    graph.add_nodes_from([0, 1, 2])
    graph.add_edge(0, 2, weight=2.5)
    graph.add_edge(1, 2)
    ours = graphs.from_networkx(graph)
    assert ours.adjacency.tolist() == [[0, 0, 2.5], [0, 0, 1], [2.5, 1, 0]]
    assert graphs.from_networkx(ours.to_networkx()) == ours


def test_equal_graphs_are_equal_keys_and_others_are_not():
    assert len({graphs.cycle(5), graphs.cycle(5), graphs.path(5)}) == 2


def test_matrices_cannot_be_overwritten_from_outside():
    matrix = np.array([[0.0, 1.0], [1.0, 0.0]])
    graph = Graph(matrix)
    matrix[:] = 9
    assert graph.adjacency.tolist() == [[0, 1], [1, 0]]
    for array in (graph.adjacency, graph.laplacian):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 1] = 5


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        ([[0, 1, 0], [1, 0, 1]], "square"),
        ([[0.0]], "at least 2 players"),
        ([[0, -1], [-1, 0]], "finite weights"),
        ([[0, np.nan], [np.nan, 0]], "finite weights"),
        ([[0, np.inf], [np.inf, 0]], "finite weights"),
        ([[1, 1], [1, 0]], "self-loops"),
        ([[0, 1], [2, 0]], "symmetric"),
    ],
)
def test_matrix_that_is_no_undirected_graph_is_refused(matrix, message):
    with pytest.raises(ValueError, match=message):
        Graph(matrix)


def test_directed_networkx_graph_is_refused():
    with pytest.raises(ValueError, match="undirected"):
        graphs.from_networkx(nx.path_graph(3, create_using=nx.DiGraph))


@pytest.mark.parametrize("edge", [(0, 3), (-1, 0), (0, 1, 2), (1,)])
def test_edge_outside_the_players_is_refused(edge):
    with pytest.raises(ValueError, match=r"players 0\.\.2"):
        graphs.from_edges(3, [edge])


@pytest.mark.parametrize(("name", "players"), [("cycle", 2), ("path", 1), ("star", 1), ("complete", 0)])
def test_too_few_players_are_refused(name, players):
    with pytest.raises(ValueError, match="at least"):
        getattr(graphs, name)(players)


def test_paper_signal_has_four_disconnected_modes_that_are_jointly_the_cycle():
    signal = graphs.paper_signal()
    assert [graph.edges for graph in signal.graphs] == [
        [(0, 1), (2, 3)],
        [(1, 2), (3, 4)],
        [(0, 4), (2, 3)],
        [(0, 1), (3, 4)],
    ]
    assert not any(graph.is_connected for graph in signal.graphs)
    assert signal.is_jointly_connected
    assert signal.union == graphs.cycle(5)
    assert signal.period == pytest.approx(0.4)
    assert signal.mean_dwell == pytest.approx(0.1)


def test_signal_whose_union_is_disconnected_is_not_jointly_connected():
    pairs = [graphs.from_edges(4, [(0, 1)]), graphs.from_edges(4, [(2, 3)])]
    assert not graphs.periodic(pairs, [1.0, 1.0]).is_jointly_connected


@given(
    st.lists(st.floats(0.05, 2.0), min_size=2, max_size=5),
    st.lists(st.floats(0.0, 50.0), min_size=1, max_size=20),
)
def test_active_mode_and_age_are_those_found_by_walking_through_the_dwells(dwells, instants):
    signal = Signal([graphs.path(3)] * len(dwells), dwells)
    schedule = signal.schedule(instants)
    for instant, mode, age in zip(instants, schedule.modes, schedule.age, strict=True):
        now, walked = instant, 0
        while now >= dwells[walked % len(dwells)]:
            now -= dwells[walked % len(dwells)]
            walked += 1
        if min(now, dwells[walked % len(dwells)] - now) < 1e-6:
            continue  # at a switch rounding decides; the next test is about that
        assert mode == walked % len(dwells)
        assert age == pytest.approx(min(now / np.mean(dwells), 1.0), abs=1e-6)


def test_instants_that_are_rounded_multiples_of_the_dwell_start_the_next_mode():
    signal = graphs.paper_signal(dwell=0.1)
    instants = np.concatenate([np.arange(400) * 0.1, np.cumsum(np.full(400, 0.1))])
    schedule = signal.schedule(instants)
    expected = np.concatenate([np.arange(400), np.arange(1, 401)]) % 4
    assert np.array_equal(schedule.modes, expected)
    assert schedule.age == pytest.approx(np.zeros(800), abs=1e-8)


def test_age_is_measured_against_the_mean_dwell_and_clipped():
    signal = Signal([graphs.path(3)] * 2, [3.0, 1.0])
    assert signal.schedule([0.0, 1.0, 2.9, 3.0, 3.5]).age == pytest.approx([0.0, 0.5, 1.0, 0.0, 0.25])


def test_fixed_graph_never_changes_and_has_no_age():
    signal = graphs.fixed(graphs.cycle(4))
    schedule = signal.schedule([0.0, 1e9])
    assert schedule.modes.tolist() == [0, 0]
    assert schedule.age.tolist() == [0, 0]
    assert signal.switches(0, 1e9).size == 0


@given(st.lists(st.floats(0.1, 2.0), min_size=2, max_size=4), st.floats(0, 20), st.floats(0.1, 10))
def test_mode_changes_at_every_switch_and_nowhere_else(dwells, start, length):
    signal = Signal([graphs.path(3)] * len(dwells), dwells)
    switches = signal.switches(start, start + length)
    assert np.all((switches > start) & (switches < start + length))
    before, after = (signal.schedule(switches + shift).modes for shift in (-1e-6, 1e-6))
    assert np.array_equal((before + 1) % len(dwells), after)
    bounds = np.concatenate([[start], switches, [start + length]])
    middles = signal.schedule((bounds[:-1] + bounds[1:]) / 2).modes
    assert np.array_equal((middles[:-1] + 1) % len(dwells), middles[1:])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"graphs": []}, "at least one graph"),
        ({"graphs": [graphs.path(3), graphs.path(4)], "dwells": [1, 1]}, "same number of players"),
        ({"graphs": [graphs.path(3)] * 2}, "dwell times"),
        ({"graphs": [graphs.path(3)] * 2, "dwells": [1.0]}, "one dwell time per graph"),
        ({"graphs": [graphs.path(3)] * 2, "dwells": [1.0, 0.0]}, "dwell time must be a finite number above 0"),
        ({"graphs": [graphs.path(3)], "clock": "wall"}, "'physical' or 'transformed'"),
    ],
)
def test_inconsistent_signals_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Signal(**arguments)


def test_instant_before_the_start_is_refused():
    with pytest.raises(ValueError, match="starts at 0"):
        graphs.paper_signal().schedule([-0.1])
