import json
import pickle

import networkx as nx
import numpy as np
import pytest
from extras import need_sb3
from hypothesis import given
from hypothesis import strategies as st
from worlds import FROM_THE_PAPER

from ptne_env import CATALOGUE, FactorySpec, Scenario, get_scenario, record
from ptne_env.games import EnergyGame, NonQuadraticGame, QuadraticGame
from ptne_env.world.clock import HyperbolicTangent, TimeTransformation
from ptne_env.world.graphs import Graph, complete, cycle
from ptne_env.world.switching import SwitchingTopology, paper_topology
from ptne_env.world.world import World


def edges(count, *pairs):
    return FactorySpec.of("ptne_env.world.graphs:from_edges", players=count, edges=pairs)


@given(st.sampled_from(sorted(CATALOGUE["energy"].to_dict())), st.none() | st.integers(-3, 50) | st.text(max_size=3))
@pytest.mark.filterwarnings("ignore:.*short of the deadline")
def test_a_changed_scenario_is_another_one_or_refused(field, value):
    try:
        scenario = Scenario.from_dict({**CATALOGUE["energy"].to_dict(), field: value})
        World(scenario)  # which refuses numbers out of range
    except ValueError as error:
        assert str(error)  # noqa: PT017 - it has to say something
    else:
        assert Scenario.from_dict(json.loads(json.dumps(scenario.to_dict()))) == scenario


@pytest.mark.parametrize("name", CATALOGUE)
def test_catalogue_survives_json_and_pickle(name):
    scenario = CATALOGUE[name]
    again = Scenario.from_dict(json.loads(json.dumps(scenario.to_dict())))
    assert again == scenario
    assert hash(again) == hash(scenario)
    assert pickle.loads(pickle.dumps(scenario)) == scenario  # noqa: S301 - our own bytes
    assert scenario.to_dict()["name"] == name


@pytest.mark.parametrize("name", FROM_THE_PAPER)
def test_catalogue_has_the_settings_of_the_paper(name):
    scenario = CATALOGUE[name]
    clock, game, topology = World(scenario).clock, World(scenario).game, World(scenario).topology
    assert (clock.deadline, clock.gain, clock.steps, clock.s_end, clock.hold_steps) == (1.2, 20.0, 400, 8.0, 0)
    assert type(clock.transformation).__name__ == "Exponential"
    assert scenario.input_limit == 1000.0
    assert isinstance(game, EnergyGame if name.startswith("energy") else NonQuadraticGame)
    if not name.startswith("energy"):
        assert game.variant == ("printed" if name.endswith("printed") else "corrected")
    if "switching" in name:
        assert topology.graphs == paper_topology().graphs
        assert topology.clock == ("transformed" if name.endswith("transformed") else "physical")
        assert topology.dwells == ((0.25,) * 4 if name.endswith("transformed") else (0.1,) * 4)
    else:
        assert topology.graphs == (cycle(5),)


def test_overrides_change_only_what_they_name():
    changed = get_scenario("energy", deadline=2.0, hold_steps=5)
    expected = CATALOGUE["energy"].to_dict() | {"deadline": 2.0, "hold_steps": 5}
    assert changed.to_dict() == expected
    assert CATALOGUE["energy"].deadline == 1.2


def test_families_have_any_number_of_players_and_graphs_come_from_networkx_and_arrays():
    world = World(get_scenario("random-energy", players=7))
    assert (world.game.num_players, world.topology.graphs) == (7, (cycle(7),))
    graph = nx.complete_graph(7)
    matrix = nx.to_numpy_array(graph)
    scenarios = [
        get_scenario("random-energy", players=7, topology=topology)
        for topology in (graph, matrix, matrix.tolist(), nx.adjacency_matrix(graph))
    ]
    assert scenarios == [scenarios[0]] * 4
    assert World(scenarios[0]).topology.graphs == (complete(7),)


def test_tensors_are_topologies():
    torch = need_sb3()
    matrix = nx.to_numpy_array(nx.star_graph(4))
    expected = get_scenario("random-energy", topology=matrix)
    tensor = torch.tensor(matrix, requires_grad=True)
    for topology in (tensor, tensor.detach().to_sparse(), tensor.bool()):
        assert get_scenario("random-energy", topology=topology) == expected


def test_graphs_that_take_turns_are_pairs_with_dwell_times():
    ring, line = cycle(5), nx.path_graph(5)
    pairs = get_scenario("energy", topology=[(ring, 0.1), (line, 0.2)])
    assert pairs == get_scenario("energy", topology=SwitchingTopology([ring, nx.to_numpy_array(line)], [0.1, 0.2]))
    assert World(pairs).topology.mode_dwells == (0.1, 0.2)
    two = [[0.0, 1.0], [1.0, 0.0]]
    assert get_scenario("random-energy", players=2, topology=two).topology.target == "topology:graph"
    for graphs in ([ring, line], [line, ring], [nx.to_numpy_array(line)] * 2):
        with pytest.raises(ValueError, match=r"pairs with dwell times, such as \[\(ring, 0.1\), \(star, 0.2\)\]"):
            get_scenario("energy", topology=graphs)


def test_an_object_as_transformation_has_the_deadline_of_the_scenario():
    named = get_scenario("energy", transformation="tanh", deadline=2.0)
    assert get_scenario("energy", transformation=HyperbolicTangent(2.0), deadline=2.0) == named
    assert Scenario.from_dict(named.to_dict()) == named
    parts = {name: getattr(named, name) for name in ("name", "game", "topology")}
    for make in (lambda **fields: get_scenario("energy", **fields), lambda **fields: Scenario(**parts, **fields)):
        with pytest.raises(ValueError, match=r"has the deadline 2\.0 and the scenario 1\.2: say deadline=2\.0, too"):
            make(transformation=HyperbolicTangent(2.0))


def double(s):
    """A function where a class is needed."""
    return 2 * s


def test_a_function_as_transformation_is_refused_with_the_class_to_write():
    with pytest.raises(
        ValueError, match=r"unexpected keyword argument 'deadline'; subclass TimeTransformation with time"
    ):
        World(get_scenario("energy", transformation=double))


class Slow(TimeTransformation):
    """λ(s) = T s/(2 + s), whose slope at 0 is T/2."""

    def time(self, s):
        return self.deadline * s / (2 + s)

    def derivative(self, s):
        return 2 * self.deadline / (2 + s) ** 2

    def inverse(self, t):
        return 2 * t / (self.deadline - t)


@pytest.mark.filterwarnings("ignore:.*short of the deadline")
def test_a_transformation_that_starts_with_another_slope_is_a_warning_and_its_loop_in_tau_is_the_same():
    default = get_scenario("energy", start="paper")
    s_end = float(Slow(1.2).from_effective_time(np.array(World(default).clock.effective_time), default.gain))
    slow = default.replace(transformation=Slow, s_end=s_end)
    with pytest.warns(UserWarning, match=r"λ'\(0\) = 0\.6 is not T = 1\.2, .* the loop in τ = s \+ c t, .* the same"):
        assert World(slow).clock.transformation.gain(0.0, 20.0) == pytest.approx(20 + 2 / 1.2)
    with pytest.warns(UserWarning, match="λ'"):
        estimates = record("static", slow).estimates
    assert estimates == pytest.approx(record("static", default).estimates, abs=1e-7)


def test_an_object_that_is_no_topology_is_refused_and_the_message_names_matrices_and_graphs():
    with pytest.raises(ValueError, match=r"topology is .*, an adjacency matrix, a graph of networkx, got a set"):
        get_scenario("random-energy", topology={1, 2})


def test_two_players_are_enough():
    world = World(get_scenario("random-energy", players=2))
    assert (world.game.num_players, world.neighbours.tolist()) == (2, [[1, 0]])


def test_a_shortfall_above_one_percent_is_a_warning():
    with pytest.warns(UserWarning, match=r"11\.11% of T short of the deadline; raise s_end"):
        World(get_scenario("energy", transformation="rational"))


def test_an_affine_game_that_is_not_monotone_is_a_warning():
    game = QuadraticGame(2 * np.ones((5, 5)) - np.eye(5), np.ones(5))
    with pytest.warns(UserWarning, match=r"F is not monotone \(ε = -1\).*ptne certify"):
        World(get_scenario("energy", game=game))


def test_a_topology_that_is_not_jointly_connected_is_refused():
    apart = FactorySpec.of("topology:periodic", graphs=[edges(5, (0, 1)), edges(5, (2, 3), (3, 4))], dwells=[1, 1])
    with pytest.raises(ValueError, match="not jointly connected over time.*add links"):
        World(get_scenario("energy", topology=apart))


def test_directed_graphs_need_to_be_strongly_connected_together():
    there, back = (Graph(nx.path_graph(order, nx.DiGraph)) for order in (range(5), range(4, -1, -1)))
    assert World(get_scenario("energy", topology=SwitchingTopology([there, back], [0.1, 0.1]))).slots == 2
    with pytest.raises(ValueError, match="not jointly strongly connected.*player 1 says reaches player 0; add links"):
        World(get_scenario("energy", topology=SwitchingTopology([there, there], [0.1, 0.1])))


def test_dwell_as_long_as_the_longest_step_is_allowed():
    clock = World(get_scenario("energy")).clock
    longest = float(np.diff(clock.t).max())
    topology = FactorySpec.of("ptne_env.world.switching:paper_topology", dwell=longest)
    assert World(get_scenario("energy-switching", topology=topology)).topology.mean_dwell == longest
