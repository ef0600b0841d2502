"""Training worlds: all can be built and played, splits share none, and nothing of a track is drawn."""

import dataclasses
import json
from itertools import chain

import numpy as np
import pytest
from affine_games import SOAK

from ptne_env import laws
from ptne_env.evaluation import EpisodeSet
from ptne_env.evaluation.rollout import rollout
from ptne_env.evaluation.suite import SUITES, get_suite
from ptne_env.field import laws as field_laws
from ptne_env.learn.training.worlds import (
    BOXED_GAMES,
    DIFFICULTIES,
    GAMES,
    HELD_OUT_GAMES,
    LEVELS,
    PLAYERS,
    STAGES,
    SWITCHING,
    training_world,
    training_worlds,
)
from ptne_env.perception.encoder import make_encoder
from ptne_env.world.distances import digits
from ptne_env.world.scenario import Scenario
from ptne_env.world.world import World

WORLDS = {split: training_worlds(0, 300, split) for split in ("train", "validation")}
ALL = [*chain(*WORLDS.values())]
TRACKS = [track for name in SUITES for track in get_suite(name).tracks]

ARGUMENTS = {
    ("random_edges", "probability"): "link_probability",
    ("AdditiveNoise", "std"): "noise",
    ("Delay", "longest"): "delay",
    ("Loss", "probability"): "loss",
    ("BurstLoss", "to_bad"): "to_bad",
    ("BurstLoss", "to_good"): "to_good",
    ("UniformQuantiser", "width"): "rounding",
    ("OneWayLinks", "share"): "one_way_share",
    ("Lying", "size"): "lie",
    ("GradientNoise", "std"): "sensor",
    ("Sinusoid", "amplitude"): "amplitude",
    ("UniformDisturbance", "bound"): "push",
    ("UniformDisturbance", "dwell"): "push_steps",
}
"""The quantity that an argument of a part is a level of."""


def parts_of(scenario):
    values = (getattr(scenario, field.name) for field in dataclasses.fields(scenario))
    return [part for value in values if hasattr(value, "nested") for part in value.nested()]


def name_of(part):
    return part.target.split(":")[1]


def levels_of(scenario):
    """All (quantity, level) of a scenario."""
    levels = [(name, getattr(scenario, name)) for name in ("deadline", "gain", "s_end", "steps")]
    for part in parts_of(scenario):
        levels += [
            (ARGUMENTS[name_of(part), argument], value)
            for argument, value in part.arguments
            if (name_of(part), argument) in ARGUMENTS
        ]
        if name_of(part) == "Sinusoid":
            levels.append(("period", dict(part.arguments)["period"] / scenario.deadline))
    if scenario.input_limit < 1000:
        levels.append(("input_limit", scenario.input_limit))
    if scenario.hold_steps:
        levels.append(("hold_steps", scenario.hold_steps))
    if scenario.clock_shifts:
        levels.append(("clock_shift", np.abs(scenario.clock_shifts).max() / scenario.deadline))
    if name_of(scenario.topology) in (*SWITCHING, "paper_topology"):
        topology = scenario.topology.build()
        end = scenario.deadline if topology.clock == "physical" else scenario.s_end
        levels.append(("dwells", end / topology.mean_dwell))
    return levels


def kinds_of(scenario):
    """The parts and the difficulties of a world, by name."""
    kinds = {name_of(part) for part in parts_of(scenario)}
    kinds |= {"limit"} if scenario.input_limit < 1000 else set()
    kinds |= {"clocks"} if scenario.clock_shifts else set()
    kinds |= {"dwells drawn"} if kinds & set(SWITCHING) else set()
    return kinds


def without_name(scenario):
    return scenario.replace(name="world")


# --- draws ------------------------------------------------------------------------------------------------------------


def test_a_world_depends_on_seed_index_and_split_alone():
    assert training_world(3, 12) == training_world(3, 12) == training_worlds(3, 13)[12]
    assert training_world(3, 12).name == "train-12"
    worlds = [training_world(3, 12), training_world(4, 12), training_world(3, 13), training_world(3, 12, "validation")]
    assert len({without_name(world) for world in worlds}) == 4


def test_splits_share_no_world():
    assert len({without_name(scenario) for scenario in ALL}) == len(ALL)


def test_worlds_survive_json():
    for scenario in ALL[:100]:
        assert Scenario.from_json(scenario.to_json()) == scenario
        assert json.loads(scenario.to_json())["steps"] == scenario.steps


def test_every_kind_of_part_is_drawn_in_both_splits():
    rest = {"fixed", "random_graphs", "GradientNoise", "Sinusoid", "UniformDisturbance", "limit", "clocks", "perfect"}
    for worlds in WORLDS.values():
        drawn = set().union(*map(kinds_of, worlds))
        assert {*GAMES, *STAGES, *SWITCHING, *rest} <= drawn
        assert {World(scenario).game.num_players for scenario in worlds[:60]} == set(PLAYERS)


def test_a_third_of_the_channels_is_perfect_and_most_worlds_have_two_difficulties_at_most():
    perfect = [name_of(scenario.channel) == "perfect" for scenario in ALL]
    assert np.mean(perfect) == pytest.approx(1 / 3, abs=0.06)
    marks = ("GradientNoise", "Sinusoid", "UniformDisturbance", "limit", "clocks", "dwells drawn")
    assert len(marks) == len(DIFFICULTIES)
    counts = [len(kinds_of(scenario).intersection(marks)) for scenario in ALL]
    totals = np.array(counts) + ~np.array(perfect)
    assert max(totals) == 3
    assert np.mean(totals <= 2) > 0.8


def test_components_per_player_are_one_to_three_equal_or_not():
    dims = [World(scenario).game.action_dims for scenario in ALL[:60]]
    assert {dim for each in dims for dim in each} == {1, 2, 3}
    assert {len(set(each)) > 1 for each in dims} == {False, True}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 0, "test-set"), "unknown split 'test-set'"),
        ((-1, 0), "seed must be"),
        ((0, 2**32), "an? episode is below"),
    ],
)
def test_wrong_arguments_of_a_world_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        training_world(*arguments)


def test_no_worlds_are_refused():
    with pytest.raises(ValueError, match="count"):
        training_worlds(0, 0)


# --- held out ---------------------------------------------------------------------------------------------------------


def test_no_track_has_as_many_players_as_a_world():
    sizes = {track.world.game.num_players for track in TRACKS}
    assert sizes == {5, 6, 9, 20, 50, 200}
    assert not sizes & set(PLAYERS)
    graphs = [dict(part.arguments) for scenario in ALL for part in scenario.topology.nested()]
    assert {graph["players"] for graph in graphs if "players" in graph} == set(PLAYERS)


def test_no_world_has_a_game_that_is_held_out():
    assert not HELD_OUT_GAMES & set().union(*map(kinds_of, ALL))
    assert not HELD_OUT_GAMES & set(GAMES)
    games = {name_of(part) for track in TRACKS for part in track.scenario.game.nested()}
    assert games - HELD_OUT_GAMES == {"RandomEnergy", "RandomAffine", "RandomSaturating"}


@pytest.mark.parametrize("track", TRACKS, ids=lambda track: track.name)
def test_levels_of_a_track_are_never_drawn(track):
    levels = [(name, level) for name, level in levels_of(track.scenario) if name != "s_end"]
    assert [(name, level) for name, level in levels if LEVELS[name].allows(level)] == []
    assert [(name, level) for name, level in levels if not np.isclose(LEVELS[name].held_out, level).any()] == []


def test_levels_of_worlds_are_those_of_the_table():
    levels = [level for scenario in ALL for level in levels_of(scenario)]
    assert {name for name, _ in levels} == set(LEVELS)
    assert [(name, level) for name, level in levels if not LEVELS[name].allows(level)] == []


@pytest.mark.parametrize(
    ("level", "is_allowed"), [(0.0012, False), (0.00081, False), (0.0013, True), (0.00079, True), (0.5, False)]
)
def test_a_band_around_a_level_is_held_out(level, is_allowed):
    assert LEVELS["noise"].held_out[1] == 0.001
    assert LEVELS["noise"].allows(level) == is_allowed


# --- play -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("split", WORLDS)
def test_worlds_can_be_built(split):
    for scenario in WORLDS[split][: 300 if SOAK else 60]:
        world = World(scenario)
        assert world.topology.is_jointly_connected
        assert world.drift is None or name_of(scenario.game) not in BOXED_GAMES


def test_dwells_are_as_long_as_the_steps_after_the_deadline():
    worlds = [scenario for scenario in ALL if scenario.hold_steps and name_of(scenario.topology) in SWITCHING]
    assert len(worlds) > 5
    for scenario in worlds:
        assert World(scenario).topology.shortest_dwell > 0  # a world refuses shorter dwells


def test_inputs_can_cross_the_range_of_starts_and_pushes_are_short():
    for scenario in ALL:
        effective_time = scenario.s_end + scenario.gain * scenario.deadline
        assert scenario.input_limit * effective_time >= 45
        for part in scenario.disturbance.nested():
            step = effective_time / scenario.steps / scenario.gain
            assert dict(part.arguments).get("bound", 0.0) * step <= 0.1 * (1 + 1e-9)


def digits_gained(scenario, episodes):
    """Mean digits of contact-relay at the deadline beyond those of no input."""
    world = World(scenario)
    start = EpisodeSet(episodes, split="train").initial_state(world)
    encoder = make_encoder(world, field_laws.ContactRelay.interface)
    law, none = (
        digits(rollout(each(encoder.layout), encoder, start, series=["estimate_distance"])["estimate_distance"])
        for each in (field_laws.ContactRelay, laws.ZeroInput)
    )
    return (law - none)[scenario.steps].mean()


def test_contact_relay_gains_a_digit_in_most_worlds():
    gained = np.array([digits_gained(scenario, 2) for scenario in ALL[: 600 if SOAK else 20]])
    assert np.mean(gained > 1) > 0.75
