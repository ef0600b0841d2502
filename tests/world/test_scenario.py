import json
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from worlds import FROM_THE_PAPER

import ptne_env
from ptne_env import CATALOGUE, FactorySpec, Scenario, get_scenario
from ptne_env.games import EnergyGame, NonQuadraticGame
from ptne_env.world.graphs import cycle
from ptne_env.world.switching import paper_topology
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


def test_a_shortfall_above_one_percent_is_a_warning():
    with pytest.warns(UserWarning, match=r"11\.11% of T short of the deadline; raise s_end"):
        World(get_scenario("energy", transformation="rational"))


REFUSED = {
    "unknown scenario": (lambda: get_scenario("enrgy"), "unknown scenario 'enrgy'; did you mean 'energy'"),
    "track of a suite": (lambda: get_scenario("ptne-v1/liar"), r"get_suite\('ptne-v1'\).track\('liar'\).scenario"),
    "unknown field": (lambda: get_scenario("energy", kappa=2), "unknown scenario field 'kappa'; choose from name, "),
    "unknown start": (lambda: get_scenario("energy", start="rnd"), "unknown start 'rnd'; did you mean 'random'"),
    "deadline of zero": (lambda: get_scenario("energy", deadline=0.0), r"deadline must be .* above 0 \(T, in seconds"),
    "number for a name": (lambda: get_scenario("energy", name=5), "name of a scenario must be a text of printable"),
    "escape for a name": (lambda: get_scenario("energy", name="\x1b[31m"), "of printable characters, got '.x1b.31m'"),
    "start of another shape": (
        lambda: get_scenario(
            "energy", start=FactorySpec.of("ptne_env.world.starts:FixedStart", estimates=[[0.0] * 3] * 3)
        ),
        "for 3 players and dimension 3.*choose start='random'",
    ),
    "disconnected graph": (
        lambda: get_scenario("energy", topology=edges(5, (0, 1), (2, 3))),
        "graph is disconnected.*add links",
    ),
    "topology that is not jointly connected": (
        lambda: get_scenario(
            "energy",
            topology=FactorySpec.of(
                "topology:periodic", graphs=[edges(5, (0, 1)), edges(5, (2, 3), (3, 4))], dwells=[1, 1]
            ),
        ),
        "not jointly connected over a period.*add links",
    ),
    "dwell shorter than the longest step": (
        lambda: get_scenario(
            "energy-switching", topology=FactorySpec.of("ptne_env.world.switching:paper_topology", dwell=0.003)
        ),
        "shorter than the longest step.*use more steps, another spacing",
    ),
    "transformed dwell shorter than the longest step": (
        lambda: get_scenario("energy-switching-transformed", steps=20),
        "dwell, 0.25 on the transformed clock, is shorter than the longest step",
    ),
    "game and graph for different numbers": (
        lambda: get_scenario(
            "energy", topology="ptne_env.world.switching:paper_topology", game="sample_games:BlockGame"
        ),
        "the game has 3 players, the graphs 5",
    ),
    "too few slots": (
        lambda: get_scenario("energy", slots=1),
        "a player has 2 neighbours and slots is 1; raise it to 2",
    ),
    "disturbance without an end": (
        lambda: get_scenario("energy", disturbance=FactorySpec.of("disturbance:uniform", bound=float("inf"))),
        "bound must be a finite number above 0",
    ),
    "disturbance that lasts for no step": (
        lambda: get_scenario("energy", disturbance=FactorySpec.of("disturbance:uniform", bound=1.0, dwell=0)),
        "dwell must be a whole number of at least 1",
    ),
    "range of zero": (lambda: get_scenario("energy", message_range=0.0), "message_range must be .* above 0"),
    "range that is none": (
        lambda: get_scenario("energy", message_range=float("inf")),
        "message_range must be a finite",
    ),
    "unknown channel": (
        lambda: get_scenario("energy", channel="noisy"),
        "unknown channel 'noisy'; did you mean 'noise'",
    ),
    "channel of another kind": (
        lambda: get_scenario("energy", channel="start:paper"),
        "built a PaperStart where a Channel is needed",
    ),
    "part of another kind": (
        lambda: get_scenario("energy", game="start:paper"),
        "built a PaperStart where a Game or GameFamily is needed",
    ),
    "missing part": (lambda: get_scenario("energy", game="ptne_env.games:ChessGame"), "has no 'ChessGame'"),
    "unknown key": (
        lambda: Scenario.from_dict(get_scenario("energy").to_dict() | {"colour": 1}),
        r"unknown keys \['colour'\]",
    ),
    "missing key": (lambda: Scenario.from_dict({"name": "x"}), r"missing keys \['game', 'topology'\]"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_invalid_scenarios_are_refused_with_advice(name):
    build, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        World(build())


def test_an_environment_in_the_place_of_a_scenario_is_refused():
    env = ptne_env.parallel_env("energy")
    with pytest.raises(TypeError, match=r"such as env\.scenario of an environment; got a NashSeekingEnv"):
        get_scenario(env)
    assert get_scenario(env.scenario) == get_scenario("energy")


def test_dwell_as_long_as_the_longest_step_is_allowed():
    clock = World(get_scenario("energy")).clock
    longest = float(np.diff(clock.t).max())
    topology = FactorySpec.of("ptne_env.world.switching:paper_topology", dwell=longest)
    assert World(get_scenario("energy-switching", topology=topology)).topology.mean_dwell == longest
