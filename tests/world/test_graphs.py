import networkx as nx
import numpy as np
import pytest
from extras import need_jax, need_sb3
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse

from ptne_env.world import graphs
from ptne_env.world.graphs import Graph

WEIGHTS = st.sampled_from([0.0, 0.0, 0.5, 1.0, 3.0])


@st.composite
def adjacencies(draw, players=None):
    count, is_directed = players or draw(st.integers(2, 7)), draw(st.booleans())
    matrix = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            matrix[i, j] = matrix[j, i] = draw(WEIGHTS)
            matrix[j, i] = draw(WEIGHTS) if is_directed else matrix[i, j]
    return matrix


@pytest.mark.parametrize("players", [3, 5, 8])
def test_named_graphs_have_their_textbook_connectivity(players):
    circle = 2 * np.pi / players
    assert graphs.cycle(players).algebraic_connectivity == pytest.approx(2 - 2 * np.cos(circle))
    assert graphs.path(players).algebraic_connectivity == pytest.approx(2 - 2 * np.cos(circle / 2))
    assert graphs.star(players).algebraic_connectivity == pytest.approx(1.0)
    assert graphs.complete(players).algebraic_connectivity == pytest.approx(players)
    directed = graphs.Graph(nx.cycle_graph(players, nx.DiGraph))
    assert directed.algebraic_connectivity == pytest.approx(1 - np.cos(circle))


@given(adjacencies())
def test_laplacian_is_degree_minus_adjacency_and_sums_to_zero(matrix):
    graph = Graph(matrix)
    for i in range(graph.num_players):
        assert graph.laplacian[i, i] == matrix[i].sum()
        for j in {*range(graph.num_players)} - {i}:
            assert graph.laplacian[i, j] == -matrix[i, j]
    assert graph.laplacian.sum(axis=1) == pytest.approx(np.zeros(graph.num_players), abs=1e-12)


@given(adjacencies())
def test_connected_exactly_when_every_player_hears_of_every_other(matrix):
    hears = (matrix > 0) | np.eye(len(matrix), dtype=bool)
    for middle in range(len(matrix)):  # the algorithm of Warshall
        hears |= hears[:, [middle]] & hears[middle]
    graph = Graph(matrix)
    assert graph.is_directed == (not np.array_equal(matrix, matrix.T))
    assert graph.is_connected == hears.all()
    assert graph.is_connected == (graph.algebraic_connectivity > 0)


@given(adjacencies(players=4), adjacencies(players=4))
def test_union_has_every_link_with_its_largest_weight(first, second):
    assert np.array_equal(graphs.union([Graph(first), Graph(second)]).adjacency, np.maximum(first, second))


def test_a_graph_of_networkx_keeps_its_weights_and_numbered_players():
    graph = nx.Graph([(2, 1)])  # nodes in another order than players
    graph.add_edge(0, 2, weight=2.5)
    ours = graphs.Graph(graph)
    assert ours.adjacency.tolist() == [[0, 0, 2.5], [0, 0, 1], [2.5, 1, 0]]
    assert str(ours) == "Graph(players=3, edges=[(0, 2, 2.5), (1, 2, 1.0)])"


def test_an_edge_of_a_directed_graph_of_networkx_carries_messages_to_its_end():
    graph = nx.DiGraph([(0, 1), (1, 2), (2, 0)])
    graph.add_edge(0, 2, weight=2.5)
    ours = graphs.Graph(graph)
    assert ours.adjacency.tolist() == [[0, 0, 1], [1, 0, 0], [2.5, 1, 0]]
    assert ours.edges == [(0, 1), (0, 2), (1, 2)]
    assert str(ours) == "Graph(players=3, 0 hears {2: 1.0}, 1 hears {0: 1.0}, 2 hears {0: 2.5, 1: 1.0})"
    assert str(graphs.Graph(nx.DiGraph(graph.edges))) == "Graph(players=3, 0 hears [2], 1 hears [0], 2 hears [0, 1])"


@pytest.mark.parametrize("label", [lambda player: player + 1, str, lambda player: float(-9 + player), "0{}".format])
def test_players_of_a_graph_of_networkx_are_its_nodes_in_the_order_of_their_numbers(label):
    graph = nx.star_graph(11)
    shuffled = nx.Graph(sorted(graph.edges, key=lambda edge: -edge[1]))  # nodes are added in another order
    assert graphs.Graph(nx.relabel_nodes(shuffled, label)) == graphs.star(12)


@pytest.mark.parametrize("edges", [[("hub", "one"), ("hub", "two")], [(0, 1), (1, "0")], [(0, 1), (1, float("nan"))]])
def test_a_graph_of_networkx_whose_nodes_have_no_numbers_is_refused(edges):
    with pytest.raises(ValueError, match="convert_node_labels_to_integers"):
        graphs.Graph(nx.Graph(edges))


@pytest.mark.parametrize("convert", [nx.Graph, sparse.csr_array, sparse.coo_matrix, np.ndarray.tolist])
def test_an_adjacency_may_be_sparse_a_list_or_a_graph_of_networkx(convert):
    made = convert(graphs.star(4).adjacency)
    assert Graph(made) == graphs.as_graph(made) == graphs.star(4)


def test_an_adjacency_may_be_a_tensor():
    torch = need_sb3()
    tensor = torch.tensor(graphs.star(4).adjacency, requires_grad=True)
    assert Graph(tensor) == Graph(tensor.to_sparse()) == graphs.star(4)


def test_an_adjacency_may_be_sparse_on_jax():
    need_jax()
    from jax.experimental.sparse import BCOO

    assert Graph(BCOO.fromdense(graphs.star(4).adjacency)) == graphs.star(4)


@pytest.mark.parametrize("scale", [1e-150, 1e-11, 1e150])
def test_tolerances_are_relative_to_the_weights(scale):
    graph = Graph(scale * graphs.cycle(5).adjacency)
    assert graph.is_connected
    assert graph.algebraic_connectivity == pytest.approx(scale * graphs.cycle(5).algebraic_connectivity, rel=1e-9)
    apart = Graph(scale * graphs.from_edges(5, [(0, 1), (1, 2), (3, 4)]).adjacency)
    assert not apart.is_connected
    assert apart.algebraic_connectivity == 0
    rounded = scale * graphs.cycle(5).adjacency
    rounded[0, 1] = np.nextafter(rounded[0, 1], np.inf)
    assert np.array_equal(Graph(rounded).adjacency, np.maximum(rounded, rounded.T))
    assert not Graph(rounded).is_directed
    rounded[0, 1] *= 1 + 1e-9
    assert Graph(rounded).is_directed


def test_a_cycle_of_two_players_is_their_link():
    assert graphs.cycle(2) == graphs.path(2)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        ([[0, 1, 0], [1, 0, 1]], "square"),
        ([[0.0]], "at least 2 players"),
        ([[0, -1], [-1, 0]], "finite weights"),
        ([[0, np.nan], [np.nan, 0]], "finite weights"),
        ([[0, np.inf], [np.inf, 0]], "finite weights"),
        ([[1, 1], [1, 0]], "self-loops"),
    ],
)
def test_invalid_adjacency_matrices_are_refused(matrix, message):
    with pytest.raises(ValueError, match=message):
        Graph(matrix)


@pytest.mark.parametrize("edge", [(0, 3), (-1, 0), (0, 1, 2), (1,)])
def test_edge_outside_the_players_is_refused(edge):
    with pytest.raises(ValueError, match=r"players 0\.\.2"):
        graphs.from_edges(3, [edge])


@pytest.mark.parametrize(("name", "players"), [("cycle", 1), ("path", 1), ("star", 1), ("complete", 0)])
def test_too_few_players_are_refused(name, players):
    with pytest.raises(ValueError, match="at least"):
        getattr(graphs, name)(players)
