"""The script that reads what a policy without sizes learned."""

import importlib
from pathlib import Path

import numpy as np
import pytest
from extras import need_sb3
from worlds import energy_scenario, fixed_part

torch = need_sb3()
need_sb3("onnx")

from ptne_env import Interface
from ptne_env import learn as policies
from ptne_env.evaluation import get_suite
from ptne_env.field.laws.gated import CellGates, SlotEvidence, SlotGates
from ptne_env.learn.size_free import CELL_FEATURES, SLOT_FEATURES
from ptne_env.learn.training.cells import CellBatch
from ptne_env.learn.training.export import size_free_to_onnx
from ptne_env.learn.training.network import ALWAYS, POINTS, GateNetwork

SHAPES = ((32, len(CELL_FEATURES)), (32, 2, len(SLOT_FEATURES)))
NAMES = ["noisy", "closing", "weight", ALWAYS]


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "baselines")
    return importlib.import_module("read_policy")


def clipped(weights, high=1.0, count=4000):
    """Random features and a clipped sum of them."""
    generator = np.random.default_rng(0)
    flags = generator.integers(2, size=(count, 2))
    features = np.column_stack([flags, generator.random(count), np.ones(count)]).astype(float)
    return features, np.clip(features @ [weights.get(name, 0.0) for name in NAMES], 0.0, high)


@pytest.mark.parametrize("law", [{}, {"closing": 1.0}, {"noisy": -1.0, "closing": 2.0, ALWAYS: 0.5}])
def test_a_clipped_sum_is_found_again_from_any_law(script, law):
    sums = {"noisy": 1.3, "weight": -0.8, ALWAYS: 0.2}
    assert script.closed_form(clipped(sums, 2.0), NAMES, law, 2.0) == pytest.approx(sums, abs=0.01)


def test_the_sum_of_the_law_stays_where_others_are_equal_in_all_samples(script):
    law = {"noisy": 1.0, "closing": 1.0, ALWAYS: -1.0}  # 1.5 noisy + 1.5 closing - 2 has the same values
    assert script.closed_form(clipped(law), NAMES, law, 1.0) == law


def test_terms_that_change_nothing_are_dropped(script):
    assert script.closed_form(clipped({}), NAMES, {"noisy": 1.0, "weight": 0.5}, 1.0) == {}
    assert script.closed_form(clipped({"noisy": 0.7}), NAMES, {"noisy": 1.0, "weight": 0.5}, 1.0) == {"noisy": 0.7}


def test_one_gate_of_a_network_acts_alone_in_a_law(script):
    torch.manual_seed(0)
    law, network = GateNetwork.of_law("observer-relay"), GateNetwork()
    torch.nn.init.normal_(network.cell_head.weight)
    torch.nn.init.normal_(network.slot_head.weight)
    generator = np.random.default_rng(0)
    cell, slot = (generator.random(shape, dtype=np.float32) for shape in SHAPES)
    for gate in ("step", "copy"):
        mixed = script.with_gate(law, network, gate).decide(cell, slot)
        for fields, *answers in zip(
            (CellGates._fields, SlotGates._fields),
            mixed,
            law.decide(cell, slot),
            network.decide(cell, slot),
            strict=True,
        ):
            for place, name in enumerate(fields):
                one, of_law, of_network = (each[..., place] for each in answers)
                np.testing.assert_allclose(one, of_network if name == gate else of_law, atol=1e-6)
                assert np.abs(of_network - of_law).max() > 0.1


def test_sums_read_as_sums(script):
    assert script.as_text({"noisy": -1.5, "weight": 0.25, ALWAYS: -2.0}) == "- 1.5 noisy + 0.25 weight - 2"
    assert script.as_text({"weight": 1.0, ALWAYS: 0.5}) == "1 weight + 0.5"
    assert script.as_text({}) == "0"


def test_the_distance_to_a_law_counts_after_clipping(script):
    data = clipped({"noisy": 1.0})
    assert script.off(data, NAMES, {"noisy": 7.0}, 1.0) == 0.0
    assert script.off(data, NAMES, {"noisy": 0.5}, 1.0) == pytest.approx(np.sqrt(0.25 * data[0][:, 0].mean()))


def test_trust_is_the_share_of_a_message_in_copy_and_belief(script):
    slots = {name: np.ones((1, 3, 1)) for name in SlotEvidence._fields}
    slots |= {"live": np.array([1.0, 1.0, 0.0]).reshape(1, 3, 1), "samples": np.array([2.0, 0.0, 6.0]).reshape(1, 3, 1)}
    cell = CellGates(*(np.full((1, 1), 0.5 if name == "copies" else 0.0) for name in CellGates._fields))
    slot = SlotGates(copy=np.array([0.3, 0.1, 1.0]).reshape(1, 3, 1), mean=np.ones((1, 3, 1)), diffusion=0.0)
    weight, belief = script.trust(cell, slot, SlotEvidence(**slots))
    np.testing.assert_allclose(weight.ravel(), [0.375, 0.125, 0.0])  # of the half that is copied; a dead link has none
    np.testing.assert_allclose(belief.ravel(), [0.25, 0.0, 0.75])  # by samples; an old mean counts without its link


def test_hops_are_counted_from_the_neighbour_to_the_owner(script):
    path = np.diag(np.ones(4), 1) + np.diag(np.ones(4), -1)
    scenario = energy_scenario([1.0, 1.3, 0.8, 1.1, 0.9], [10.0, 15.0, 20.0, 25.0, 30.0], fixed_part(path), steps=3)
    batch = CellBatch(scenario, 2)
    batch.start([0, 1])
    found = script.hops(batch.evidence[1].live[:, :, 0], batch)
    for row in range(10):
        for slot, neighbour in enumerate(batch.layout.neighbours[row % 5]):
            np.testing.assert_array_equal(found[row, slot], np.abs(neighbour - np.arange(5)))


def test_noise_is_the_last_stage_of_the_channel(script):
    for name in script.NOISY:
        scenario = get_suite("ptne-v2").track(name).scenario
        assert script.noisy(scenario, script.NOISE) == scenario
        assert script.noisy(scenario, 1.0) != scenario
    assert script.NOISE in script.LEVELS


def test_every_level_of_noise_has_a_point_of_its_own(script):
    count = 2 * script.FEWEST
    rows = {name: np.ones(count * len(script.LEVELS), dtype=np.float32) for name in ("source", "noisy", "scale")}
    rows |= {"restless": 100 * rows["noisy"], "noise": np.repeat(script.LEVELS, count)}
    rows |= {f"weight of {name}": rows["noise"] / 10 for name in ("network", *script.BESIDE)}
    panel = next(panel for panel in script.PANELS if panel.over == "noise")
    for points in script.curves(rows, panel).values():
        np.testing.assert_allclose(points[:, 0], script.LEVELS)
        np.testing.assert_allclose(points[:, 2], np.divide(script.LEVELS, 10))


def test_tracks_are_those_that_all_players_play_by_themselves(script):
    names = [f"{suite.name}/{track}" for suite, track in script.chosen_tracks(())]
    assert {"ptne-v1/noise", "ptne-v2/switching-noise"} < set(names)
    assert not {"ptne-v1/mixed-team", "ptne-v2/strangers", "ptne-v2/crowd-50"} & set(names)
    with pytest.raises(ValueError, match="some players of ptne-v1/mixed-team follow another policy"):
        script.chosen_tracks(["ptne-v1/mixed-team"])
    with pytest.raises(ValueError, match="unknown track of suite ptne-v1 'x'; choose from nominal"):
        script.chosen_tracks(["ptne-v1/x"])


def test_the_script_tells_in_which_gate_a_network_differs_from_the_law(script, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(script, "LEVELS", (script.NOISE,))
    monkeypatch.setattr(script, "NOISY", ("rough-links",))
    cell, slot = POINTS["observer-relay"]
    network = GateNetwork.linear_point({**cell, "copies": {"observed_weight": 0.5}}, slot)
    file, picture, out = (tmp_path / name for name in ("mine.onnx", "trust.png", "form.onnx"))
    file.write_bytes(size_free_to_onnx(network, interface=Interface(), scenarios=("x",), steps=0, seed=0, digits=0.0))
    script.main(str(file), picture, out, track=["ptne-v2/short-deadline"], episodes=1, jobs=1)
    printed = capsys.readouterr().out
    weights = {line.split()[0]: line.split()[-1] for line in printed.split("weight of a message")[1].splitlines()[1:]}
    assert float(weights["network"]) == pytest.approx(float(weights["observer-relay"]) / 2, abs=1e-3)
    rows = {cells[1].strip(): cells for line in printed.splitlines() if len(cells := line.split("|")) == 8}
    assert rows["copies"][4].strip() == "0.5 observed_weight"
    assert float(rows["copies"][2]) > 0.1
    assert float(rows["copies"][3]) < 1e-6
    assert float(rows["copies"][5]) < -0.01  # copies that come half of the way cost digits
    assert rows["copies"][6] == rows["copies"][5]  # the closed form of the gate is the gate
    assert rows["copy"][4].strip() == "1 source"
    assert rows["copy"][5].strip() == ""  # as in the law
    assert "| ptne-v2, mean |" in printed
    assert picture.stat().st_size > 10_000
    assert isinstance(policies.load(out), policies.SizeFreeFile)


def test_wrong_names_are_refused_before_anything_is_played(script, tmp_path):
    with pytest.raises(ValueError, match="policy 'ppo-random-energy' has sizes"):
        script.main("ppo-random-energy")
    file = tmp_path / "mine.onnx"
    content = size_free_to_onnx(GateNetwork(), interface=Interface(), scenarios=("x",), steps=0, seed=0, digits=0.0)
    file.write_bytes(content)
    with pytest.raises(ValueError, match="no law 'x' is a point of the network"):
        script.main(str(file), law="x", track=["ptne-v1/noise"])
