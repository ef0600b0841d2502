"""Graph observations: the checks of the frameworks, and the same content as the flat observation."""

import copy
import warnings

import gymnasium
import numpy as np
import pytest
from extras import need_sb3
from gymnasium.spaces import GraphInstance
from gymnasium.utils.env_checker import check_env

import ptne_env
from ptne_env import FactorySpec
from ptne_env.envs.gymnasium import JointEnv
from ptne_env.envs.turn_based import aec_env
from ptne_env.envs.vector import VectorParallelEnv
from ptne_env.perception.observation_forms import make_form

with warnings.catch_warnings():
    # The suites import one of PettingZoo's own environments in the way that PettingZoo itself deprecates.
    warnings.filterwarnings("ignore", "The old environment creation API", DeprecationWarning)
    from pettingzoo.test import parallel_api_test, parallel_seed_test

RING = {"scenario": "energy", "start": "random"}
STAR = {
    "scenario": "energy",
    "start": "random",
    "topology": FactorySpec.of(
        "ptne_env.world.switching:fixed", graph=FactorySpec.of("ptne_env.world.graphs:star", players=5)
    ),
}
SWITCHING = {"scenario": "random-energy-switching"}
LOSSY = {"scenario": "energy", "channel": FactorySpec.of("ptne_env.world.channel:Loss", probability=0.5)}
WIDE = {"scenario": "robots"}
CASES = [RING, STAR, SWITCHING, LOSSY, WIDE]
NAMES = ["ring", "star", "switching", "lossy", "robots"]


def flat_from_padded(graph, layout, observers):
    """The flat observations (..., observers, size) that a padded graph holds."""
    rows = np.full((*graph["nodes"].shape[:-2], observers, layout.size), np.nan, dtype=np.float32)
    on_edges = ("relative_estimates", "weights")
    columns = np.concatenate([np.arange(p.start, p.stop) for n, p in layout.slices.items() if n not in on_edges])
    rows[..., columns] = graph["nodes"][..., :observers, :]
    edges = graph["edges"].reshape(*rows.shape[:-1], layout.slots, layout.dimension + 1)
    rows[..., layout.slices["relative_estimates"]] = edges[..., :-1].reshape(*rows.shape[:-1], -1)
    rows[..., layout.slices["weights"]] = edges[..., -1]
    return rows


def flat_from_graph(graph, layout, observers):
    """The flat observations (observers, size) that a graph without padding holds."""
    padded = {
        "nodes": graph.nodes,
        "edges": np.zeros((observers, layout.slots, layout.dimension + 1), dtype=np.float32),
    }
    one_hot = graph.nodes[:, -layout.num_players :]
    assert list(layout.slices)[-1] == "player"
    for edge, (sender, receiver) in zip(graph.edges, graph.edge_links, strict=True):
        neighbours = layout.neighbours[one_hot[receiver].argmax()]
        padded["edges"][receiver, neighbours.index(one_hot[sender].argmax())] = edge
    return flat_from_padded(padded, layout, observers)


@pytest.mark.parametrize("interface", ["physical", "scaled"])
@pytest.mark.parametrize("arguments", CASES, ids=NAMES)
def test_graphs_hold_the_numbers_of_the_flat_observation(arguments, interface):
    arguments = {**arguments, "interface": interface}
    envs = [ptne_env.parallel_env(**arguments, observation=form) for form in ("flat", "graph", "padded-graph")]
    joint_envs = [JointEnv(**arguments, observation=form) for form in ("flat", "graph", "padded-graph")]
    layout = envs[0].layout
    players = layout.num_players
    for instant in range(4):
        if instant == 0:
            flat, graphs, padded = (env.reset(seed=3)[0] for env in envs)
            joint_flat, joint_graph, joint_padded = (env.reset(seed=3)[0] for env in joint_envs)
        else:
            actions = {agent: np.full(layout.action_size, 0.01, dtype=np.float32) for agent in envs[0].agents}
            flat, graphs, padded = (env.step(actions)[0] for env in envs)
            together = np.concatenate(list(actions.values()))
            joint_flat, joint_graph, joint_padded = (env.step(together)[0] for env in joint_envs)
        for agent, row in flat.items():
            assert np.array_equal(flat_from_graph(graphs[agent], layout, 1)[0], row)
            assert np.array_equal(flat_from_padded(padded[agent], layout, 1)[0], row)
            assert len(graphs[agent].nodes) == 1 + len(graphs[agent].edges) == 1 + padded[agent]["edge_mask"].sum()
        rows = joint_flat.reshape(players, -1)
        assert np.array_equal(rows, list(flat.values()))
        assert np.array_equal(flat_from_graph(joint_graph, layout, players), rows)
        assert np.array_equal(flat_from_padded(joint_padded, layout, players), rows)


def test_edges_lead_from_senders_to_receivers_over_live_links_alone():
    env = JointEnv("energy-switching", observation="graph")
    seen = set()
    observation, _ = env.reset(seed=0)
    over = False
    while not over:
        adjacency = env.parallel.state()[-29:-4].reshape(5, 5)
        links = {tuple(link) for link in observation.edge_links.tolist()}
        assert links == set(zip(*(part.tolist() for part in np.nonzero(adjacency)), strict=True))
        estimates = env.parallel.estimates
        for edge, (sender, receiver) in zip(observation.edges, observation.edge_links, strict=True):
            assert edge[:-1] == pytest.approx(estimates[sender] - estimates[receiver], rel=1e-5)
        seen.add(frozenset(links))
        observation, _, terminated, truncated, _ = env.step(np.zeros(25, dtype=np.float32))
        over = terminated or truncated
    assert len(seen) == 4


def test_a_player_sees_its_senders_by_their_names_alone():
    graph = ptne_env.parallel_env("energy", observation="graph").reset(seed=0)[0]["player_0"]
    assert graph.nodes[1:, :-5].any() == np.False_
    assert graph.nodes[:, -5:].argmax(axis=1).tolist() == [0, 1, 4]
    assert graph.edge_links.tolist() == [[1, 0], [2, 0]]


def test_padded_edges_and_their_senders_are_zero():
    env = ptne_env.parallel_env(**STAR, observation="padded-graph")
    leaf = env.reset(seed=0)[0]["player_3"]
    assert leaf["edge_mask"].tolist() == [1, 0, 0, 0]
    assert not leaf["edges"][1:].any()
    assert not leaf["nodes"][2:].any()
    assert leaf["nodes"][1, -5:].tolist() == [1, 0, 0, 0, 0]


# --- the checks of the frameworks -------------------------------------------------------------------------------------

FORMS = ["graph", "padded-graph"]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("arguments", [RING, SWITCHING], ids=["ring", "switching"])
def test_pettingzoo_accepts_the_environment(arguments, form, capsys):
    arguments = {**arguments, "interface": "local", "observation": form}
    parallel_api_test(ptne_env.parallel_env(**arguments), num_cycles=50)
    parallel_seed_test(lambda: ptne_env.parallel_env(**arguments))
    env = aec_env(**arguments)
    env.reset(seed=0)
    assert env.observe("player_1") in env.observation_space("player_1")
    assert "Passed" in capsys.readouterr().out


@pytest.mark.parametrize("form", FORMS)
def test_gymnasium_accepts_the_joint_environment(form):
    env = gymnasium.make("ptne/random-energy-switching-joint-v0", interface="scaled", observation=form)
    check_env(env.unwrapped, skip_render_check=True)
    vector = gymnasium.make_vec(
        "ptne/energy-joint-v0", num_envs=2, vectorization_mode="sync", interface="scaled", observation=form
    )
    observations, _ = vector.reset(seed=0)
    assert observations in vector.observation_space


def test_stable_baselines3_accepts_padded_graphs():
    sb3 = need_sb3("stable_baselines3.common.env_checker")
    # It recommends vectors, or a policy of one's own for other arrays, which a graph network is.
    with pytest.warns(UserWarning, match="unconventional shape") as caught:
        sb3.check_env(JointEnv("energy", interface="scaled", observation="padded-graph"))
    assert {str(each.message).split()[2] for each in caught} == {"nodes", "edges", "edge_links"}


def test_members_of_the_vecenv_see_the_graph_of_their_flat_observation():
    need_sb3("stable_baselines3")
    from ptne_env.envs.sb3 import PlayerVecEnv

    flat, graph = (
        PlayerVecEnv("random-energy", 2, seed=0, interface="scaled", max_cycles=3, observation=form)
        for form in ("flat", "padded-graph")
    )
    rows, shown = flat.reset(), graph.reset()
    actions = np.zeros((10, 5), dtype=np.float32)
    for _ in range(3):
        assert np.array_equal(flat_from_padded(shown, flat.layout, 1)[:, 0], rows)
        assert {name: part[4] for name, part in shown.items()} in graph.observation_space
        (rows, *_, infos), (shown, *_, graph_infos) = flat.step(actions), graph.step(actions)
    for own, other in zip(infos, graph_infos, strict=True):
        last = other["terminal_observation"]
        assert last in graph.observation_space
        assert np.array_equal(flat_from_padded(last, flat.layout, 1)[0], own["terminal_observation"])


def test_a_vecenv_refuses_graphs_without_padding():
    need_sb3("stable_baselines3")
    from ptne_env.envs.sb3 import PlayerVecEnv

    with pytest.raises(ValueError, match="choose observation='flat' or 'padded-graph'"):
        PlayerVecEnv("energy", observation="graph")


# --- the forms themselves ---------------------------------------------------------------------------------------------


def test_an_unknown_form_is_an_error():
    with pytest.raises(ValueError, match="unknown observation 'tree'; choose from flat, graph, padded-graph"):
        ptne_env.parallel_env("energy", observation="tree")


def test_a_form_makes_graphs_of_any_batch_of_flat_observations():
    vector = VectorParallelEnv("random-energy-switching", 3, interface="scaled")
    rows = vector.reset(seed=0)
    form = make_form("padded-graph", vector.layout)
    assert np.array_equal(flat_from_padded(form.show(rows), vector.layout, 1)[:, :, 0], rows)
    joint = make_form("padded-graph", vector.layout, joint=True).show(rows.reshape(3, -1))
    assert np.array_equal(flat_from_padded(joint, vector.layout, 5), rows)
    assert joint["edges"].shape == (3, 10, 6)


@pytest.mark.parametrize("form", FORMS)
def test_shown_graphs_belong_to_the_caller(form):
    env = ptne_env.parallel_env("energy", observation=form)
    first = env.reset(seed=0)[0]["player_0"]
    kept = copy.deepcopy(first)
    parts = list(first) if isinstance(first, GraphInstance) else list(first.values())
    for part in parts:
        assert part.flags.writeable
    env.step({agent: np.ones(5, dtype=np.float32) for agent in env.agents})
    for part, before in zip(parts, list(kept) if isinstance(kept, GraphInstance) else kept.values(), strict=True):
        assert np.array_equal(part, before)
    copied = copy.deepcopy(env)
    assert copied.observation_space("player_0") == env.observation_space("player_0")
