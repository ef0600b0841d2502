"""The network of policies without sizes: laws are points of its parameters, and its file answers as it does."""

import numpy as np
import pytest
from affine_games import run
from extras import need_sb3
from worlds import BLOCKS, FAULTY, begin, energy_scenario, fixed_part, world_and_encoder

torch = need_sb3()
need_sb3("onnx")

from ptne_env import Interface
from ptne_env import learn as policies
from ptne_env.evaluation import get_suite
from ptne_env.evaluation.policy_specs import POLICIES
from ptne_env.field.laws.gated import CellGates, GatedLaw, ObserverRelay, SlotGates
from ptne_env.learn.size_free import CELL_FEATURES, HIGH, LOW, SLOT_FEATURES, SizeFreePolicy
from ptne_env.learn.training.export import size_free_to_onnx
from ptne_env.learn.training.network import POINTS, GateNetwork

LAWS = {name: POLICIES[name].build for name in POINTS}
KNOWLEDGE = {"routed": "union", "relay": "union"}
PATH = np.diag(np.ones(4), 1) * 0.8 + np.diag(np.ones(4), -1) * 0.8
FIXED = [
    energy_scenario([1.0, 1.3, 0.8, 1.1, 0.9], [10.0, 15.0, 20.0, 25.0, 30.0], fixed_part(PATH), steps=100),
    BLOCKS.replace(steps=100),
]


def track(name):
    return get_suite("ptne-v1").track(name).scenario


def assert_same_run(scenario, name):
    """The point of a law runs as the law does, to the float32 of gates and actions."""
    world, encoder = world_and_encoder(scenario, graph_knowledge=KNOWLEDGE.get(name, "links"))
    law = LAWS[name](encoder.layout)
    point = SizeFreePolicy(encoder.layout, GateNetwork.of_law(name).decide)
    one, two = (run(world, encoder, policy, begin(world, range(3))) for policy in (law, point))
    np.testing.assert_allclose(two, one, atol=1e-6 * np.abs(one).max(), rtol=0)
    errors = [np.abs(states[-1] - world.game.nash_equilibria[:, None]).max() for states in (one, two)]
    assert abs(np.log10(errors[0] / errors[1])) < 1e-6  # digits
    assert np.abs(one[-1] - one[0]).max() > 1


@pytest.mark.parametrize("scenario", FIXED, ids=lambda scenario: scenario.name)
@pytest.mark.parametrize("name", POINTS)
def test_laws_are_points_of_the_network_on_fixed_graphs(name, scenario):
    assert_same_run(scenario, name)


@pytest.mark.parametrize("name", ["static", "grounded", "observer-relay"])
def test_laws_are_points_of_the_network_on_switching_graphs(name):
    assert_same_run(track("switching-physical").replace(start="random"), name)


class Beside(GatedLaw):
    """Acts by the gates of :class:`ObserverRelay`, and compares those of the point with them in every step."""

    def __init__(self, layout):
        super().__init__(layout)
        self.hand, self.point = (
            ObserverRelay(layout),
            SizeFreePolicy(layout, GateNetwork.of_law("observer-relay").decide),
        )
        self.open = set()

    def gates(self, cells, slots):
        answer = self.hand.gates(cells, slots)
        for hand, point in zip(answer, self.point.gates(cells, slots), strict=True):
            for name, gate in hand._asdict().items():
                found = getattr(point, name)
                expected = np.broadcast_to(gate, found.shape)
                np.testing.assert_allclose(found, expected, atol=1e-7, err_msg=name)
                self.open |= {name} if gate.any() else set()
        return answer


def test_the_gates_of_observer_relay_are_linear_in_the_features_under_every_fault():
    opened = set()
    for scenario in (*map(track, ("noise", "quantised", "markov", "hold")), FAULTY):
        world, encoder = world_and_encoder(scenario)
        policy = Beside(encoder.layout)
        run(world, encoder, policy, begin(world, range(4)), min(world.clock.total_steps, 150))
        opened |= policy.open
    assert opened >= {"copies", "belief", "response", "joint", "push", "copy", "mean", "dither"}


def inputs(cells, slots, seed=0):
    """Random features, of which half the links are live."""
    generator = np.random.default_rng(seed)
    cell = generator.random((cells, len(CELL_FEATURES)), dtype=np.float32)
    slot = generator.random((cells, slots, len(SLOT_FEATURES)), dtype=np.float32)
    slot[:, :, SLOT_FEATURES.index("live")] = slot[:, :, 0] > 0.5
    return cell, slot


@pytest.mark.parametrize(("cells", "slots"), [(32, 1), (32, 11), (96, 2), (320, 8), (2048, 4)])
@pytest.mark.parametrize("made", ["random", "observer-relay"])
def test_the_file_answers_as_the_network_does(tmp_path, cells, slots, made):
    torch.manual_seed(1)
    network = GateNetwork() if made == "random" else GateNetwork.of_law(made)
    path = tmp_path / "mine.onnx"
    path.write_bytes(
        size_free_to_onnx(network, interface=Interface(), scenarios=("some",), steps=0, seed=0, digits=0.0)
    )
    for mine, theirs in zip(
        network.decide(*inputs(cells, slots)), policies.load(path).network(*inputs(cells, slots)), strict=True
    ):
        assert mine.dtype == theirs.dtype == np.float32
        np.testing.assert_allclose(mine, theirs, atol=2e-6, rtol=2e-6)


def test_gates_have_the_shapes_and_order_of_their_tuples():
    cell, slot = GateNetwork().decide(*inputs(32, 3))
    assert cell.shape == (32, len(CellGates._fields))
    assert slot.shape == (32, 3, len(SlotGates._fields))
    assert set(HIGH) == {*CellGates._fields, *SlotGates._fields}
    assert min(HIGH.values()) > LOW


def test_the_network_is_small():
    assert sum(weights.numel() for weights in GateNetwork().parameters()) < 10_000


def test_the_order_of_the_neighbours_does_not_matter():
    torch.manual_seed(0)
    network, (cell, slot), order = GateNetwork(), inputs(32, 5), [3, 0, 4, 1, 2]
    plain, permuted = network.decide(cell, slot), network.decide(cell, slot[:, order])
    np.testing.assert_allclose(permuted[0], plain[0], atol=1e-6)
    np.testing.assert_allclose(permuted[1], plain[1][:, order], atol=1e-6)


def test_dead_links_do_not_matter_to_the_component_and_to_other_links():
    torch.manual_seed(0)
    network, (cell, slot) = GateNetwork(), inputs(32, 4)
    slot[0, :, SLOT_FEATURES.index("live")] = 0.0  # a player without links
    live = slot[:, :, SLOT_FEATURES.index("live")] > 0
    changed = np.where(live[:, :, None], slot, np.float32(0.25))
    changed[:, :, SLOT_FEATURES.index("live")] = live
    for array in (slot, changed):
        padded = np.concatenate([array, np.zeros((32, 2, len(SLOT_FEATURES)), dtype=np.float32)], axis=1)
        mine, theirs = network.decide(cell, padded)
        np.testing.assert_allclose(mine, network.decide(cell, slot)[0], atol=1e-6)
        np.testing.assert_allclose(theirs[:, :4][live], network.decide(cell, slot)[1][live], atol=1e-6)


def test_training_leaves_a_point_through_all_its_weights():
    network = GateNetwork.of_law("relay")
    cell, slot = map(torch.from_numpy, inputs(64, 3))
    optimiser = torch.optim.SGD(network.parameters(), lr=0.1)
    for _ in range(2):  # the layers move as soon as their heads have
        optimiser.zero_grad()
        mine, theirs = network(cell, slot)
        (mine.square().sum() + theirs.square().sum()).backward()
        optimiser.step()
    assert all(weights.grad is not None and weights.grad.abs().max() > 0 for weights in network.parameters())


def test_unknown_names_are_refused_and_the_known_ones_named():
    with pytest.raises(ValueError, match="no law 'adaptive' is a point of the network: choose from static, grounded"):
        GateNetwork.of_law("adaptive")
    with pytest.raises(ValueError, match="no weight of 'own' in 'jump': gates are copies, .* features own, turn"):
        GateNetwork.linear_point({"jump": {"own": 1.0}}, {})
    with pytest.raises(ValueError, match="no weight of 'mood' in 'copy': gates are copy, mean, .* features live"):
        GateNetwork.linear_point({}, {"copy": {"mood": 1.0}})


def test_a_linear_point_answers_its_map():
    network = GateNetwork.linear_point({"step": {"own": 0.5, "1": 0.25}}, {"diffusion": {"owner": 3.0}})
    cell, slot = inputs(32, 2)
    mine, theirs = network.decide(cell, slot)
    expected = np.zeros_like(mine)
    expected[:, CellGates._fields.index("step")] = 0.25 + 0.5 * cell[:, CELL_FEATURES.index("own")]
    np.testing.assert_allclose(mine, expected, atol=1e-6)
    expected = np.zeros_like(theirs)
    expected[:, :, SlotGates._fields.index("diffusion")] = 3.0 * slot[:, :, SLOT_FEATURES.index("owner")]
    np.testing.assert_allclose(theirs, expected, atol=1e-6)
