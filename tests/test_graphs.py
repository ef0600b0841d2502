import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from ptne_env import FactorySpec, dynamics, get_scenario, graphs, switching
from ptne_env.graphs import Graph
from ptne_env.random_streams import RandomStreams
from ptne_env.switching import EpisodeTopology, MarkovTopology, SwitchingTopology
from ptne_env.world import World


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


def test_signal_whose_union_is_disconnected_is_not_jointly_connected():
    pairs = [graphs.from_edges(4, [(0, 1)]), graphs.from_edges(4, [(2, 3)])]
    assert not switching.periodic(pairs, [1.0, 1.0]).is_jointly_connected


@given(
    st.lists(st.floats(0.05, 2.0), min_size=2, max_size=5),
    st.lists(st.floats(0.0, 50.0), min_size=1, max_size=20),
)
def test_active_mode_and_age_are_those_found_by_walking_through_the_dwells(dwells, instants):
    topology = SwitchingTopology([graphs.path(3)] * len(dwells), dwells)
    schedule = topology.schedule(instants)
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
    topology = switching.paper_topology(dwell=0.1)
    instants = np.concatenate([np.arange(400) * 0.1, np.cumsum(np.full(400, 0.1))])
    schedule = topology.schedule(instants)
    expected = np.concatenate([np.arange(400), np.arange(1, 401)]) % 4
    assert np.array_equal(schedule.modes, expected)
    assert schedule.age == pytest.approx(np.zeros(800), abs=1e-8)


def test_age_is_measured_against_the_mean_dwell_and_clipped():
    topology = SwitchingTopology([graphs.path(3)] * 2, [3.0, 1.0])
    assert topology.schedule([0.0, 1.0, 2.9, 3.0, 3.5]).age == pytest.approx([0.0, 0.5, 1.0, 0.0, 0.25])


def test_fixed_graph_never_changes_and_has_no_age():
    topology = switching.fixed(graphs.cycle(4))
    schedule = topology.schedule([0.0, 1e9])
    assert schedule.modes.tolist() == [0, 0]
    assert schedule.age.tolist() == [0, 0]
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
        ({"graphs": [graphs.path(3)] * 2, "dwells": [1.0, 0.0]}, "dwell time must be a finite number above 0"),
        ({"graphs": [graphs.path(3)], "clock": "wall"}, "'physical' or 'transformed'"),
    ],
)
def test_inconsistent_signals_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        SwitchingTopology(**arguments)


def test_instant_before_the_start_is_refused():
    with pytest.raises(ValueError, match="starts at 0"):
        switching.paper_topology().schedule([-0.1])


FALSE_ALARM = 1e-6
"""The probability with which each statistical test below is wrong by chance; seeds are fixed."""

PAIRS = [graphs.from_edges(4, [(0, 1)]), graphs.from_edges(4, [(1, 2)]), graphs.from_edges(4, [(2, 3)])]
CHAIN = [[0.5, 0.3, 0.2], [0.1, 0.2, 0.7], [0.6, 0.4, 0.0]]


def generators(count, seed=0):
    return [RandomStreams.from_seed(seed + index).graph for index in range(count)]


def following(row, choice):
    """The mode that a choice from [0, 1) picks from a row of the transition matrix."""
    total = 0.0
    for mode, probability in enumerate(row):
        total += probability
        if choice < total:
            return mode
    return len(row) - 1


def walked(topology, instants, generator):
    """Mode and age by walking from dwell to dwell with the same draws, in plain Python."""
    count = int(max(instants) / topology.shortest) + 2
    choices, units = generator.random((2, count))
    modes, ages = [], []
    for instant in instants:
        mode = topology.first if topology.first is not None else int(choices[0] * len(topology.graphs))
        begun, dwell = 0.0, 0
        while True:
            end = begun + topology.shortest + (topology.longest - topology.shortest) * units[dwell]
            if instant < end - 1e-9 * topology.shortest:
                break
            begun, dwell, mode = end, dwell + 1, following(topology.transition[mode].tolist(), choices[dwell + 1])
        modes.append(mode)
        ages.append(min((instant - begun) / topology.mean_dwell, 1.0))
    return modes, ages


@pytest.mark.parametrize(
    "topology",
    [
        switching.markov(PAIRS, CHAIN, (0.2, 0.7)),
        switching.markov(PAIRS, CHAIN, 0.25),
        switching.random_dwells(PAIRS, (0.2, 0.7)),
        switching.random_edges(graphs.complete(4), 0.3, (0.2, 0.7), modes=5),
    ],
    ids=["markov", "markov, dwells known", "dwells", "edges"],
)
def test_drawn_schedule_is_the_one_found_by_walking_through_the_draws(topology):
    instants = np.linspace(0, 12, 97)
    schedule = topology.draw(instants, generators(6))
    assert schedule.modes.shape == schedule.age.shape == (97, 6)
    for b, generator in enumerate(generators(6)):
        modes, ages = walked(topology, instants.tolist(), generator)
        assert schedule.modes[:, b].tolist() == modes
        assert schedule.age[:, b] == pytest.approx(np.array(ages), abs=1e-9)
    assert len({tuple(column) for column in schedule.modes.T}) > 1 or topology.first is not None


def test_schedules_of_episodes_do_not_depend_on_each_other():
    topology, instants = switching.markov(PAIRS, CHAIN, (0.2, 0.7)), np.linspace(0, 12, 97)
    together = topology.draw(instants, generators(5))
    for b in range(5):
        alone = topology.draw(instants, generators(1, seed=b))
        assert np.array_equal(alone.modes[:, 0], together.modes[:, b])
        assert np.array_equal(alone.age[:, 0], together.age[:, b])


def test_modes_follow_the_chain_and_dwells_their_range():
    topology = switching.markov(PAIRS, CHAIN, 1.0)
    modes = topology.draw(np.arange(60) + 0.5, generators(300)).modes
    assert stats.chisquare(np.bincount(modes[0], minlength=3)).pvalue > FALSE_ALARM
    for mode in range(3):
        following = np.bincount(modes[1:][modes[:-1] == mode], minlength=3)
        expected = np.array(CHAIN[mode]) * following.sum()
        possible = expected > 0
        assert not following[~possible].any()
        assert stats.chisquare(following[possible], expected[possible]).pvalue > FALSE_ALARM

    order = switching.random_dwells(PAIRS, (0.5, 1.5))
    instants = np.linspace(0, 1.5, 3001)
    first = (order.draw(instants, generators(400)).modes == 0).sum(axis=0) * 0.0005  # the first dwell of each episode
    assert stats.kstest(first - 0.5, "uniform").pvalue > FALSE_ALARM
    assert set(np.diff(order.draw(np.linspace(0, 30, 3001), generators(5)).modes, axis=0).ravel()) == {0, 1, -2}


def test_links_of_the_pool_are_up_as_often_as_asked_for():
    topology = switching.random_edges(graphs.complete(6), 0.3, 1.0, modes=400, seed=3)
    up = sum(len(graph.edges) for graph in topology.graphs)
    assert stats.binomtest(up, 400 * 15, 0.3).pvalue > FALSE_ALARM
    again = switching.random_edges(graphs.complete(6), 0.3, 1.0, modes=400, seed=3)
    assert again.graphs == topology.graphs
    assert switching.random_edges(graphs.complete(6), 0.3, 1.0, modes=400, seed=4).graphs != topology.graphs
    weighted = switching.random_edges(Graph([[0, 2.5], [2.5, 0]]), 0.5, 1.0, modes=20)
    assert {graph.adjacency[0, 1] for graph in weighted.graphs} == {0.0, 2.5}


def test_every_episode_draws_its_graph_and_keeps_it():
    topology, instants = switching.random_graphs(5, 0.5, modes=7, seed=1), np.linspace(0, 3, 11)
    schedule = topology.draw(instants, generators(2000))
    assert schedule.modes.shape == schedule.age.shape == (11, 2000)
    assert not schedule.age.any()
    assert not np.diff(schedule.modes, axis=0).any()
    assert stats.chisquare(np.bincount(schedule.modes[0], minlength=7)).pvalue > FALSE_ALARM
    for b in range(5):
        alone = topology.draw(instants, generators(1, seed=b))
        assert np.array_equal(alone.modes[:, 0], schedule.modes[:, b])
    assert topology.shortest_dwell == topology.mean_dwell == topology.period == np.inf
    assert topology.switches(0, 10).size == 0


def test_random_graphs_are_connected_and_linked_as_often_as_connected_graphs_are():
    topology = switching.random_graphs(4, 0.5, modes=400, seed=2)
    assert topology.graphs == switching.random_graphs(4, 0.5, modes=400, seed=2).graphs
    assert topology.graphs != switching.random_graphs(4, 0.5, modes=400, seed=3).graphs
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


def test_joint_connectivity_is_what_can_be_promised():
    connected = [graphs.path(4), graphs.cycle(4)]
    apart = [graphs.from_edges(4, [(0, 1)]), graphs.from_edges(4, [(2, 3)])]
    even = np.full((2, 2), 0.5)
    assert switching.fixed(graphs.path(4)).joint_connectivity == "always"
    assert switching.fixed(apart[0]).joint_connectivity == "never"
    assert switching.periodic(PAIRS, [1] * 3).joint_connectivity == "always"
    assert switching.periodic(apart, [1, 1]).joint_connectivity == "never"
    assert switching.random_dwells(PAIRS, (0.5, 1)).joint_connectivity == "always"
    assert switching.markov(PAIRS, CHAIN, 1.0).joint_connectivity == "almost surely"
    assert switching.markov(connected, even, 1.0).joint_connectivity == "always"
    assert switching.markov(apart, even, 1.0).joint_connectivity == "never"
    assert switching.random_edges(graphs.cycle(4), 0.5, 1.0).joint_connectivity == "almost surely"
    assert switching.random_edges(graphs.cycle(4), 1.0, 1.0, modes=2).joint_connectivity == "always"
    assert switching.random_edges(graphs.cycle(4), 1e-9, 1.0).joint_connectivity == "never"
    assert switching.random_graphs(4, 0.5).joint_connectivity == "always"
    assert EpisodeTopology([graphs.path(4), apart[0]]).joint_connectivity == "never"


def test_almost_sure_means_no_window():
    """An episode with a given window in which the union is not connected happens, with any window."""
    topology = switching.markov(PAIRS, np.full((3, 3), 1 / 3), 1.0)
    modes = topology.draw(np.arange(40) + 0.5, generators(2000)).modes
    disconnected = [len(set(modes[:5, b])) < 3 for b in range(2000)]
    probability = (3 * 2**5 - 3) / 3**5  # a mode or two are missing among five
    assert stats.binomtest(sum(disconnected), 2000, probability).pvalue > FALSE_ALARM


def test_random_signal_has_no_schedule_without_a_draw():
    topology = switching.markov(PAIRS, CHAIN, (0.2, 0.7))
    assert topology.is_random
    assert not topology.is_fixed
    assert (topology.shortest_dwell, topology.mean_dwell) == (0.2, pytest.approx(0.45))
    for call in (lambda: topology.schedule([0.0]), lambda: topology.switches(0, 1)):
        with pytest.raises(ValueError, match="is random and has no"):
            call()
    with pytest.raises(ValueError, match="starts at 0"):
        topology.draw([-1.0, 0.0], generators(1))


def test_drawing_a_certain_signal_gives_everybody_its_schedule():
    topology, instants = switching.paper_topology(), np.linspace(0, 1, 31)
    drawn, schedule = topology.draw(instants, generators(3)), topology.schedule(instants)
    for b in range(3):
        assert np.array_equal(drawn.modes[:, b], schedule.modes)
        assert np.array_equal(drawn.age[:, b], schedule.age)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"transition": [[1, 0], [0, 1]]}, "some mode is not reached from some other"),
        ({"transition": [[0.5, 0.5], [0, 1]]}, "some mode is not reached"),
        ({"transition": [[0.5, 0.6], [0.5, 0.5]]}, "2 × 2 matrix of probabilities whose rows sum to 1"),
        ({"transition": [[1.5, -0.5], [0.5, 0.5]]}, "2 × 2 matrix of probabilities"),
        ({"transition": [[1.0]]}, "2 × 2 matrix"),
        ({"dwells": (0.7, 0.2)}, "the shortest dwell comes first"),
        ({"dwells": (0.1, 0.2, 0.3)}, "a time or a range"),
        ({"dwells": 0.0}, "dwell time must be a finite number above 0"),
        ({"first": 2}, "first is a mode 0..1, got 2"),
        ({"graphs": [graphs.path(3)], "transition": [[1.0]]}, "at least two graphs"),
    ],
)
def test_random_signal_that_cannot_be_is_refused(arguments, message):
    defaults = {"graphs": [graphs.path(3)] * 2, "transition": np.full((2, 2), 0.5), "dwells": 1.0}
    with pytest.raises(ValueError, match=message):
        MarkovTopology(**(defaults | arguments))


@pytest.mark.parametrize("probability", [0.0, 1.1, -0.1])
def test_links_that_are_up_with_no_probability_are_refused(probability):
    with pytest.raises(ValueError, match="probability must be"):
        switching.random_edges(graphs.cycle(4), probability, 1.0)


def random_scenario(**arguments):
    part = FactorySpec.of(
        "ptne_env.switching:random_edges", graph=FactorySpec.of("ptne_env.graphs:cycle", players=5), **arguments
    )
    return get_scenario("energy", topology=part, start="random")


def test_scenario_refuses_what_never_connects_and_what_may_dwell_too_shortly():
    with pytest.raises(ValueError, match="not jointly connected.*add links"):
        World(random_scenario(probability=1e-9, dwells=0.1))
    with pytest.raises(ValueError, match=r"shortest dwell, 0\.001 on the physical clock, is shorter"):
        World(random_scenario(probability=0.5, dwells=(0.001, 0.5)))


def test_every_episode_has_its_own_signal_and_it_is_held_in_the_state():
    scenario = random_scenario(probability=0.5, dwells=(0.02, 0.05))
    assert World(scenario).is_random
    world = World(scenario)

    def states(seeds):
        sources = [RandomStreams.from_seed(seed) for seed in seeds]
        estimates, randomness = world.draw_estimates(sources), world.draw_randomness(sources)
        state, result = dynamics.initial_state(world, estimates, randomness=randomness), []
        for _ in range(400):
            result.append(state)
            state = dynamics.step(world, state, np.zeros_like(state.estimates))
        return result

    together = states(range(3))
    modes = np.array([dynamics.active_mode(world, state) for state in together])
    assert len({tuple(column) for column in modes.T}) == 3
    assert np.array_equal(modes[:, [1]], np.array([dynamics.active_mode(world, state) for state in states([1])]))
    for state in together[::40]:
        for b in range(3):
            adjacency = world.topology.graphs[int(dynamics.active_mode(world, state)[b])].adjacency
            for i in range(5):
                assert dynamics.weights(world, state)[:, i, b].tolist() == [
                    adjacency[i, j] for j in world.neighbours[:, i]
                ]
