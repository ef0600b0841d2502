"""A policy without sizes: its features, one file in worlds of every size, relabelled players, files and layouts."""

import json

import numpy as np
import pytest
from affine_games import run
from extras import need_sb3
from test_damaged_files import damaged, with_changed_metadata
from test_rows import WORLDS, assert_decides_rows_alike
from worlds import FAULTY, begin, fixed_part, world_and_encoder

onnx = need_sb3("onnx")

import torch
from onnx import helper

from ptne_env import FactorySpec, Interface, PolicySpec, Scenario, evaluate, laws
from ptne_env import learn as policies
from ptne_env.evaluation import get_suite
from ptne_env.evaluation.policy_specs import get_policy_spec, learned_policy
from ptne_env.field.laws.gated import CellGates, SlotGates
from ptne_env.learn import PolicyFileError, SizeFreeFile, SizeFreeMetadata, SizeFreePolicy
from ptne_env.learn.metadata import GATES, Description
from ptne_env.learn.size_free import CELL_FEATURES, HIGH, LOW, SLOT_FEATURES, features
from ptne_env.learn.training.export import size_free_to_onnx
from ptne_env.learn.training.network import GateNetwork
from ptne_env.perception.encoder import make_encoder
from ptne_env.perception.observation import LayoutError
from ptne_env.shared.parts import LOADER
from ptne_env.world import dynamics

ORIGIN = {"scenarios": ("some-family",), "steps": 3, "seed": 1, "digits": 2.5}


def network(seed=0):
    """A network with random weights, larger than those of training."""
    torch.manual_seed(seed)
    made = GateNetwork()
    with torch.no_grad():
        for weights in made.parameters():
            weights.mul_(2.0)
    return made


def write(path, interface=None, made=None):
    path.write_bytes(size_free_to_onnx(made or network(), interface=interface or Interface(), **ORIGIN))
    return path


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return write(tmp_path_factory.mktemp("files") / "mine.onnx")


class Seen(SizeFreePolicy):
    """Keeps its evidence and gates of the last step."""

    def gates(self, cells, slots):
        answer = super().gates(cells, slots)
        self.seen = cells, slots, *answer
        return answer


def seen_in(scenario, steps=45, episodes=3, made=None, **interface):
    """The evidence and gates of the last of some steps in a world."""
    world, encoder = world_and_encoder(scenario, **interface)
    policy = Seen(encoder.layout, (made or network()).decide)
    run(world, encoder, policy, begin(world, range(episodes)), steps)
    return policy.seen


@pytest.mark.parametrize("name", ["noise", "quantised", "markov", "faulty"])
def test_features_are_of_order_one_and_do_not_depend_on_the_unit(name):
    is_faulty = name == "faulty"  # whose clocks run past the deadline
    scenario = FAULTY if is_faulty else get_suite("ptne-v1").track(name).scenario
    cells, slots, *_ = seen_in(scenario, steps=62 if is_faulty else 45)
    assert (cells.elapsed.max() > 1) == is_faulty
    cell, slot = features(cells, slots)
    rows, _, components = slots.relative.shape
    assert cell.shape == (rows, components, len(CELL_FEATURES))
    assert slot.shape == (rows, components, slots.relative.shape[1], len(SLOT_FEATURES))
    for array in (cell, slot):
        assert array.dtype == np.float32
        assert array.min() >= 0
        assert array.max() <= 1
    distances = {
        "cells": ("scale", "gradient", "response", "noise", "width", "belief", "correction", "doubt", "push"),
        "slots": ("relative", "change", "deviation", "spread"),
    }
    other = features(
        cells._replace(**{name: getattr(cells, name) * 1000.0 for name in distances["cells"]}),
        slots._replace(**{name: getattr(slots, name) * 1000.0 for name in distances["slots"]}),
    )
    np.testing.assert_allclose(other[0], cell, atol=1e-6)
    np.testing.assert_allclose(other[1], slot, atol=1e-6)


def test_every_feature_shows_its_evidence():
    cells, slots, *_ = seen_in(get_suite("ptne-v1").track("markov").scenario, graph_knowledge="union")
    cell, slot = features(cells, slots)
    flags = ("own", "turn", "probing", "closing", "failed", "held", "noisy", "rounded", "broke", "trusted")
    for name in (*flags, "weight", "damping", "elapsed"):
        expected = np.broadcast_to(getattr(cells, name), cells.own.shape)
        np.testing.assert_allclose(cell[:, :, CELL_FEATURES.index(name)], expected, atol=1e-7, err_msg=name)
    signs = {"nearer": slots.nearer > 0, "farther": slots.nearer < 0, "own": cells.own[:, None]}
    assert signs["nearer"].any()
    for name in ("live", "owner", "source", *signs):
        expected = np.broadcast_to(signs.get(name, getattr(slots, name, None)), slots.relative.shape).swapaxes(1, 2)
        np.testing.assert_array_equal(slot[..., SLOT_FEATURES.index(name)], expected, err_msg=name)
    relative = np.maximum(np.abs(slots.relative) / cells.scale[:, None], 0).swapaxes(1, 2)
    decades = (np.log10(relative + 1e-9) + 9) / 12
    np.testing.assert_allclose(slot[..., SLOT_FEATURES.index("relative")], np.clip(decades, 0, 1), atol=1e-5)
    steps = np.broadcast_to(np.log10(1 + slots.age) / 4, slots.relative.shape).swapaxes(1, 2)
    np.testing.assert_allclose(slot[..., SLOT_FEATURES.index("age")], np.clip(steps, 0, 1), atol=1e-6)


@pytest.mark.parametrize(("answer", "expected"), [(-1e9, LOW), (1e9, HIGH), (0.5, 0.5)])
def test_gates_are_clipped_to_their_bounds(answer, expected):
    def constant(cell, slot):
        count, slots = slot.shape[:2]
        return (
            np.full((count, len(CellGates._fields)), answer, dtype=np.float32),
            np.full((count, slots, len(SlotGates._fields)), answer, dtype=np.float32),
        )

    world, encoder = world_and_encoder("energy")
    policy = Seen(encoder.layout, constant)
    policy.predict(encoder.observe(begin(world, [0]))[0])
    for gates in policy.seen[2:]:
        for name, gate in gates._asdict().items():
            np.testing.assert_array_equal(gate, expected[name] if expected is HIGH else expected)


RANDOM = np.random.default_rng(5)


def sized(players):
    """A world of that many players of 1 to 3 components, on graphs of degree up to 8, every third of them switching."""
    dims = RANDOM.integers(1, 4, players).tolist()
    game = FactorySpec.of("ptne_env.games:RandomAffine", players=players, action_dim=dims)
    if players % 3 == 0:
        topology = FactorySpec.of(
            "ptne_env.world.switching:random_edges",
            graph=FactorySpec.of("ptne_env.world.graphs:cycle", players=players),
            probability=0.6,
            dwells=(0.2, 0.4),
        )
    elif players <= 9:
        topology = FactorySpec.of(
            "ptne_env.world.switching:fixed", graph=FactorySpec.of("ptne_env.world.graphs:complete", players=players)
        )
    else:
        topology = FactorySpec.of(
            "ptne_env.world.switching:fixed",
            graph=FactorySpec.of(
                "ptne_env.world.graphs:random_regular", players=players, degree=8 if players < 12 else 4
            ),
        )
    return Scenario(name=f"sized-{players}", game=game, topology=topology, start="random", steps=40)


def test_one_file_plays_every_number_of_players_components_and_links(file):
    sizes = set()
    for players in range(2, 13):
        world, encoder = world_and_encoder(sized(players))
        layout = encoder.layout
        states = run(world, encoder, policies.load(file, layout), begin(world, range(2)))
        assert np.isfinite(states).all()
        assert np.abs(np.diff(states, axis=0)).max() > 0
        sizes.add((layout.num_players, layout.slots, max(layout.action_dims), len(set(layout.action_dims)) > 1))
    players, slots, widest, uneven = map(set, zip(*sizes, strict=True))
    assert players == set(range(2, 13))
    assert {1, 2, 8} <= slots
    assert widest >= {2, 3}
    assert True in uneven


DIMS = np.array([2, 1, 3, 1, 1])
COLUMNS = np.split(np.arange(8), np.cumsum(DIMS)[:-1])


def uneven_world(order):
    """Players of 1 to 3 components on a tree with a triangle and unequal weights, in another order."""
    generator = np.random.default_rng(0)
    square = generator.normal(size=(8, 8))
    matrix, offset = 2 * np.eye(8) + 0.05 * (square + square.T), generator.uniform(-8, 8, 8)
    adjacency = np.zeros((5, 5))
    for (i, j), weight in {(0, 1): 1.0, (1, 2): 0.7, (0, 2): 1.2, (2, 3): 0.9, (3, 4): 1.1}.items():
        adjacency[i, j] = adjacency[j, i] = weight
    columns = np.concatenate([COLUMNS[player] for player in order])
    game = FactorySpec.of(
        "ptne_env.games.affine:AffineGame",
        matrix=matrix[np.ix_(columns, columns)],
        offset=offset[columns],
        action_dims=DIMS[order].tolist(),
    )
    topology = fixed_part(adjacency[np.ix_(order, order)])
    return Scenario(name="uneven", game=game, topology=topology, start="random", steps=60)


@pytest.mark.parametrize("law", [None, "observer-relay"])
def test_relabelling_the_players_permutes_the_decisions(law):
    made = network() if law is None else GateNetwork.of_law(law)
    order = np.array([1, 3, 4, 0, 2])  # the player in each place
    columns = np.concatenate([COLUMNS[player] for player in order])
    world, encoder = world_and_encoder(uneven_world(np.arange(5)))
    relabelled, other_encoder = world_and_encoder(uneven_world(order))
    policy, other = (SizeFreePolicy(each.layout, made.decide) for each in (encoder, other_encoder))
    state, memory, other_memory, largest = begin(world, range(3)), None, None, 0.0
    for step in range(world.clock.steps):
        permuted = dynamics.initial_state(relabelled, state.estimates[columns][:, order])
        permuted = permuted._replace(step=state.step)
        actions, memory = policy.predict(encoder.observe(state).reshape(15, -1), memory)
        others, other_memory = other.predict(other_encoder.observe(permuted).reshape(15, -1), other_memory)
        actions, others = actions.reshape(3, 5, 8), others.reshape(3, 5, 8)
        largest = max(largest, np.abs(actions).max())
        permuted = actions[:, order][:, :, columns]
        np.testing.assert_allclose(others, permuted, atol=1e-6 * largest, rtol=0, err_msg=str(step))
        assert step > 0 or np.abs(others - actions).max() > 0.1 * largest  # the labels matter to the arrays
        state = dynamics.step(world, state, encoder.decode(actions, state))


def test_decisions_follow_the_signature_of_stable_baselines3(file):
    world, encoder = world_and_encoder("random-energy")
    layout = encoder.layout
    policy = policies.load(file, layout)
    assert isinstance(policy, SizeFreePolicy)
    first = encoder.observe(begin(world, [3]))[0]
    actions, memory = policy.predict(first, state=None, deterministic=True)
    assert actions.shape == (5, layout.action_size)
    assert actions.dtype == np.float32
    assert np.abs(actions).max() <= layout.action_bound
    alone, _ = policy.predict(first[2])
    assert alone.shape == (layout.action_size,)
    np.testing.assert_array_equal(alone, actions[2])

    second = first * np.float32(0.9)
    second[:, layout.slices["player"]] = first[:, layout.slices["player"]]
    starts = np.array([False, True, False, False, True])
    restarted, _ = policy.predict(second, memory, starts)
    fresh, _ = policy.predict(second, None)
    continued, _ = policy.predict(second, memory)
    np.testing.assert_array_equal(restarted, np.where(starts[:, None], fresh, continued))
    assert not np.array_equal(fresh, continued)


@pytest.mark.parametrize("world", WORLDS, ids=lambda world: world.scenario.name)
def test_every_row_is_decided_alike_in_every_batch(file, world):
    encoder = make_encoder(world, Interface())
    episodes, players = 4, encoder.layout.num_players
    state = begin(world, range(episodes))

    def observations_of(actions):
        nonlocal state
        if actions is not None:
            state = dynamics.step(world, state, encoder.decode(actions.reshape(episodes, players, -1), state))
        return encoder.observe(state).reshape(-1, encoder.layout.size)

    assert_decides_rows_alike(lambda: policies.load(file, encoder.layout), observations_of, episodes * players)


def test_random_networks_pass_the_audit_in_worlds_of_several_sizes(file):
    scenarios = [FAULTY, *map(sized, (2, 9, 12))]
    results = evaluate([PolicySpec("mine", policies.load(file))], scenarios, episodes=5, against_laws=False)
    assert not results.failures
    assert len(results.samples) == 4


def test_a_file_is_evaluated_by_its_path(file):
    results = evaluate([str(file)], [FAULTY], episodes=3, against_laws=False)
    assert not results.failures
    assert set(results.samples) == {("faulty", "mine")}


@pytest.mark.parametrize("knowledge", ["links", "union"])
def test_a_spec_of_a_file_tells_its_interface_and_memory(tmp_path, knowledge):
    path = str(write(tmp_path / "mine.onnx", Interface(graph_knowledge=knowledge)))
    loaded = FactorySpec.of(LOADER, path_or_name=path)
    for spec in (get_policy_spec(path), learned_policy(path), PolicySpec("mine", loaded)):
        assert spec.interface == Interface(graph_knowledge=knowledge)
        assert spec.has_memory
        assert spec.is_learned
        assert not spec.is_foreign
        assert spec.scenarios is None
        assert spec.knowledge["memory"] == "yes"
        read = PolicySpec.from_dict(json.loads(json.dumps(spec.to_dict())))
        assert read == spec
    in_memory = PolicySpec("mine", policies.load(path))
    assert in_memory.has_memory
    assert in_memory.interface.graph_knowledge == knowledge
    (tmp_path / "mine.onnx").unlink()
    assert spec.has_memory is None
    assert read.has_memory


def test_a_file_decides_the_same_in_its_own_process(file):
    world, encoder = world_and_encoder("random-energy-switching")
    spec = get_policy_spec(str(file))
    with spec.deciding(encoder.layout) as policy:
        assert not isinstance(policy, SizeFreePolicy)
        apart = []
        state, memory = begin(world, [0, 1]), None
        starts = np.ones(10, dtype=bool)
        for _ in range(25):
            rows = encoder.observe(state).reshape(10, -1)
            actions, memory = policy.predict(rows, memory, starts, deterministic=True)
            starts = np.zeros(10, dtype=bool)
            state = dynamics.step(world, state, encoder.decode(actions.reshape(2, 5, -1), state))
            apart.append(state.estimates)
    here = run(world, encoder, spec.build(encoder.layout), begin(world, [0, 1]), 25)
    np.testing.assert_array_equal(np.array(apart), here[1:])


@pytest.mark.parametrize(
    ("interface", "message"),
    [
        (Interface("local"), "interface: policy kind='physical', environment kind='local'$"),
        (Interface("physical", "gains"), "interface: policy .*'input'.* environment .*'gains'"),
        (Interface(graph_knowledge="union"), "interface: policy .*'links'.* environment .*'union'"),
    ],
)
def test_a_layout_of_another_interface_is_refused(file, interface, message):
    _, encoder = world_and_encoder(
        "energy", **{name: getattr(interface, name) for name in ("kind", "action_mode", "graph_knowledge")}
    )
    for make in (lambda: policies.load(file, encoder.layout), lambda: get_policy_spec(str(file)).build(encoder.layout)):
        with pytest.raises(LayoutError, match=message):
            make()


@pytest.mark.parametrize(
    ("kind", "mode", "message"), [("local", "input", "own_estimate"), ("physical", "gains", "action_mode='input'")]
)
def test_a_policy_without_a_file_refuses_layouts_that_it_cannot_play(kind, mode, message):
    _, encoder = world_and_encoder("energy", kind=kind, action_mode=mode)
    with pytest.raises(LayoutError, match=f"SizeFreePolicy .*{message}"):
        SizeFreePolicy(encoder.layout, network().decide)


def changed(content, **changes):
    """The file with other values in its metadata; ``None`` removes one."""
    model = onnx.load_from_string(content)
    data = json.loads(model.metadata_props[0].value) | changes
    text = json.dumps({name: value for name, value in data.items() if value is not None})
    helper.set_model_props(model, {"ptne_env": text})
    return model.SerializeToString()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cell_features": [*CELL_FEATURES, "mood"]}, "features of components: only in the file mood; use the version"),
        ({"slot_features": list(SLOT_FEATURES[1:])}, "features of messages: only in this library live"),
        ({"gates": ["jump", *GATES[1:]]}, "gates: only in the file jump, only in this library copies"),
        ({"cell_features": list(CELL_FEATURES[::-1])}, "features of components: in another order"),
        ({"layout_version": 99}, "layout version 99"),
        ({"cell_features": None}, "damaged or of a later version"),
        ({"cell_features": 3}, "damaged"),
        ({"gates": ["\x1b[31m"]}, "damaged"),
        ({"kind": "other"}, "damaged or of a later version"),
        ({"kind": None}, "damaged"),
        ({"kind": []}, "damaged"),
        ({"action_dims": [1]}, "damaged"),
        ({"digits": "many"}, "damaged"),
    ],
)
def test_a_file_of_another_version_names_the_difference(tmp_path, file, changes, message):
    path = tmp_path / "other.onnx"
    path.write_bytes(changed(file.read_bytes(), **changes))
    with pytest.raises(PolicyFileError, match=message):
        policies.load(path)


def of_flat_policy(content):
    """A network of observations under the metadata of a policy without sizes."""
    flat = onnx.load(policies.shipped_path("ppo-random-energy"))
    helper.set_model_props(flat, {"ptne_env": onnx.load_from_string(content).metadata_props[0].value})
    return flat.SerializeToString()


def with_fixed_slots(content):
    model = onnx.load_from_string(content)
    model.graph.input[1].type.tensor_type.shape.dim[1].dim_value = 1
    return model.SerializeToString()


def with_swapped_outputs(content):
    model = onnx.load_from_string(content)
    outputs = list(model.graph.output)[::-1]
    del model.graph.output[:]
    model.graph.output.extend(outputs)
    return model.SerializeToString()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (of_flat_policy, "other.onnx cannot decide from features cell and slot"),
        (with_fixed_slots, "other.onnx cannot decide from features cell and slot"),
        (with_swapped_outputs, "other.onnx answers with gates .* expected float32 arrays of shapes"),
    ],
)
def test_a_file_with_another_network_is_refused(tmp_path, file, change, message):
    path = tmp_path / "other.onnx"
    path.write_bytes(change(file.read_bytes()))
    with pytest.raises(PolicyFileError, match=message):
        policies.load(path)


def test_damaged_files_are_refused_or_decide(tmp_path, file):
    generator, content, path = np.random.default_rng(0), file.read_bytes(), tmp_path / "damaged.onnx"
    world, encoder = world_and_encoder("energy")
    observations, outcomes = encoder.observe(begin(world, [0]))[0], []
    for number in range(8):
        path.write_bytes((with_changed_metadata if number % 2 else damaged)(content, generator))
        try:
            policy = policies.load(path, encoder.layout)
        except PolicyFileError:
            outcomes.append("refused")
            continue
        assert policy.predict(observations)[0].shape == (5, encoder.layout.action_size)
        outcomes.append("decides")
    assert set(outcomes) == {"refused", "decides"}


def test_metadata_survive_the_round_trip(file):
    metadata = policies.load(file).metadata
    assert isinstance(metadata, SizeFreeMetadata)
    assert Description.from_json(metadata.to_json()) == metadata
    assert metadata.cell_features == CELL_FEATURES
    assert {name: getattr(metadata, name) for name in ORIGIN} == ORIGIN
    assert {"ptne_env", "torch"} <= set(metadata.versions)


def test_a_file_is_called_with_a_layout(file):
    made = policies.load(file)
    assert isinstance(made, SizeFreeFile)
    assert made.name == "mine"
    _, encoder = world_and_encoder("energy")
    assert isinstance(made(encoder.layout), SizeFreePolicy)
    assert isinstance(made(encoder.layout), laws.Law)
