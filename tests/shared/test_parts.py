import copy
import dataclasses
import json
import pickle
from dataclasses import FrozenInstanceError
from functools import cached_property

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from processes import run_python

from ptne_env import FactorySpec, Scenario, get_scenario
from ptne_env.games import AffineGame, EnergyGame, QuadraticGame, RandomEnergy
from ptne_env.shared.parts import PARTS, foreign_targets, is_part, resolve
from ptne_env.suites import get_suite
from ptne_env.world import channels, graphs, switching
from ptne_env.world.catalogue import CATALOGUE
from ptne_env.world.scenario import PART_FIELDS
from ptne_env.world.starts import FixedStart, UniformStart
from ptne_env.world.switching import SwitchingTopology
from ptne_env.world.world import World

scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
names = st.from_regex(r"[a-z][a-z_]{0,8}", fullmatch=True)
targets = st.builds("{}:{}".format, names, names)


def part_strategy(arguments):
    return st.builds(lambda target, items: FactorySpec.of(target, **items), targets, st.dictionaries(names, arguments))


arguments = st.recursive(scalars, lambda inner: st.lists(inner, max_size=3) | part_strategy(inner), max_leaves=8)
parts = part_strategy(arguments)


@given(parts)
def test_json_round_trip_keeps_equality_and_hash(part):
    again = FactorySpec.from_dict(json.loads(json.dumps(part.to_dict())))
    assert again == part
    assert hash(again) == hash(part)


@pytest.mark.parametrize("name", ["target", "self", "cls"])
def test_arguments_may_have_any_name(name):
    part = FactorySpec.of("builtins:dict", **{name: 3})
    assert part.build() == {name: 3}
    assert FactorySpec.from_dict(part.to_dict()) == part


def test_nested_specs_are_built_first():
    graph = FactorySpec.of("ptne_env.world.graphs:path", players=3)
    built = FactorySpec.of(
        "ptne_env.world.switching:SwitchingTopology", graphs=[graph, graph], dwells=[0.5, 0.25]
    ).build()
    assert isinstance(built, SwitchingTopology)
    assert built.graphs[0].edges == [(0, 1), (1, 2)]


def test_arrays_are_frozen_so_that_specs_are_keys():
    adjacency = np.array([[0.0, 2.0], [2.0, 0.0]])
    part = FactorySpec.of("ptne_env.world.graphs:Graph", adjacency=adjacency)
    adjacency[:] = 7
    assert {part: 1}[FactorySpec.of("ptne_env.world.graphs:Graph", adjacency=[[0.0, 2.0], [2.0, 0.0]])] == 1


@pytest.mark.parametrize("target", ["json", ":loads", "json:", ""])
def test_target_of_another_form_is_refused(target):
    with pytest.raises(ValueError, match="an id such as 'law:static' or by 'module:object'"):
        resolve(target)


@pytest.mark.parametrize(
    ("target", "message"),
    [("no_such_module_anywhere:thing", "cannot import"), ("json:no_such_function", "has no 'no_such_function'")],
)
def test_missing_target_is_named(target, message):
    with pytest.raises(ValueError, match=message) as caught:
        FactorySpec.of(target).build()
    assert target in str(caught.value)


def test_a_module_that_exits_is_an_error_and_no_end_of_the_program(tmp_path, monkeypatch):
    (tmp_path / "exits_at_once.py").write_text("raise SystemExit(0)\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ValueError, match="cannot import the module of part 'exits_at_once:thing'"):
        resolve("exits_at_once:thing")


def test_arguments_of_the_caller_are_named_too():
    with pytest.raises(ValueError, match=r"refuses its arguments \['layout'\]: .*no keyword arguments"):
        FactorySpec.of("builtins:range").build(layout=5)


def test_a_spec_survives_the_dictionaries_of_dataclasses_whose_arguments_are_pairs():
    noise = FactorySpec.of("channel:noise", std=0.1)
    for spec in (noise, FactorySpec.of("channel:chain", stages=[noise, FactorySpec.of("channel:perfect")])):
        assert FactorySpec.from_dict(json.loads(json.dumps(dataclasses.asdict(spec)))) == spec
    for arguments in ([1, 2], [[1, 2]], ["ab"], "ab"):
        with pytest.raises(ValueError, match="a string 'target' and an object 'arguments'"):
            FactorySpec.from_dict({"target": "channel:noise", "arguments": arguments})


@pytest.mark.parametrize("data", [{}, {"target": "a:b", "argument": {}}, {"arguments": {}}])
def test_unknown_or_missing_keys_are_refused(data):
    with pytest.raises(ValueError, match="'target' and 'arguments'"):
        FactorySpec.from_dict(data)


def test_arguments_that_json_cannot_hold_are_refused():
    with pytest.raises(TypeError, match="numbers, strings, lists and parts, got object"):
        FactorySpec.of("a:b", thing=object())


@pytest.mark.parametrize("name", PARTS)
def test_every_id_names_an_object_whose_spec_has_the_id(name):
    kind, _, _ = name.partition(":")
    assert kind in {*PART_FIELDS, "law", "policy", "suite"}
    made = resolve(name)
    assert FactorySpec.of(PARTS[name]).target == name
    assert kind == "suite" or FactorySpec.of(made).target == name


def test_scenarios_and_suites_of_the_library_name_parts_alone():
    scenarios = [*CATALOGUE.values(), *(track.scenario for track in get_suite("ptne-v1").tracks)]
    assert [foreign_targets(scenario.to_dict()) for scenario in scenarios] == [[]] * len(scenarios)
    assert "ptne_env" not in json.dumps(CATALOGUE["random-energy-switching"].to_dict())


@pytest.mark.parametrize(
    "target",
    [
        "os:system",
        "builtins:eval",
        "ptne_env.shared.files:write_atomically",
        "ptne_env.world.channels:replace",
        "ptne_env.laws:NoSuchLaw",
        "ptne_env.laws",
        "law:no-such-law",
        "laws:Static",
        "",
    ],
)
def test_other_targets_are_foreign(target):
    assert not is_part(target)
    assert foreign_targets({"policies": [{"target": target}]}) == [target]


def test_nested_foreign_targets_are_found_in_json_without_an_import(tmp_path):
    (tmp_path / "evil.py").write_text("raise SystemExit('imported')", encoding="utf-8")
    program = (
        "import json, sys\n"
        "from ptne_env.shared.parts import FactorySpec, foreign_targets\n"
        "data = json.loads(sys.argv[1])\n"
        "print(foreign_targets([data]), foreign_targets(FactorySpec.from_dict(data)), 'evil' in sys.modules)"
    )
    call = {"target": "evil:run", "arguments": {"word": {"target": "os:system", "arguments": {"command": "ls"}}}}
    data = {"target": "ptne_env.laws:Static", "arguments": {"kappa": [2.0, [call]], "again": call}}
    found = run_python("-c", program, json.dumps(data), folder=tmp_path)
    assert found.stdout.strip() == "['evil:run', 'os:system'] ['evil:run', 'os:system'] False"


def test_an_unknown_id_gets_the_names_that_were_probably_meant():
    with pytest.raises(ValueError, match="unknown law 'statik'; did you mean 'static'"):
        resolve("law:statik")


def test_parts_that_are_nested_too_deeply_are_refused():
    data = {"target": "a:b"}
    for _ in range(3000):
        data = {"target": "a:b", "arguments": {"inner": data}}
    with pytest.raises(ValueError, match="nested too deeply"):
        FactorySpec.from_dict(data)


# --- parts that are given as objects ----------------------------------------------------------------------------------


class Contest(AffineGame):
    """A game whose arguments are not its matrix."""

    pull: float = 0.5
    tastes: tuple = (1.0, 2.0, 4.0)

    @cached_property
    def matrix(self):
        return np.eye(3) - self.pull / 2 * (1 - np.eye(3))

    @cached_property
    def offset(self):
        return -np.asarray(self.tastes)


class Drawn(AffineGame):
    """A game of another object."""

    generator: object
    matrix = np.eye(3)
    offset = np.ones(3)


def wheel():
    return switching.fixed(graphs.Graph(nx.wheel_graph(5)))


@pytest.mark.parametrize(
    ("part", "named"),
    [
        (EnergyGame(), FactorySpec.of("ptne_env.games:EnergyGame")),
        (EnergyGame, FactorySpec.of("ptne_env.games:EnergyGame")),
        (EnergyGame(2.0, coupling=0.3), FactorySpec.of("ptne_env.games:EnergyGame", curvature=2.0, coupling=0.3)),
        (EnergyGame(target=np.arange(3.0)), FactorySpec.of("ptne_env.games:EnergyGame", target=(0.0, 1.0, 2.0))),
        (Contest(0.25), FactorySpec.of(f"{__name__}:Contest", pull=0.25)),
        (wheel, FactorySpec.of(f"{__name__}:wheel")),
        (
            channels.Chain([channels.AdditiveNoise(0.1)]),
            FactorySpec.of(
                "ptne_env.world.channels:Chain",
                stages=[FactorySpec.of("ptne_env.world.channels:AdditiveNoise", std=0.1)],
            ),
        ),
        (RandomEnergy(5), FactorySpec.of("ptne_env.games:RandomEnergy")),
        (RandomEnergy(6), FactorySpec.of("ptne_env.games:RandomEnergy", players=6)),
    ],
)
def test_the_spec_of_a_part_is_its_class_and_the_fields_that_differ_from_their_defaults(part, named):
    assert FactorySpec.of(part) == named
    if not callable(part):
        assert FactorySpec.of(named.build()) == named


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Drawn(np.random.default_rng(0)),
            "a Drawn cannot be named by its fields .* Generator for 'generator'",
        ),
        (
            type("Contest", (Contest,), {"__module__": __name__}),
            "has no Contest, or another one since this object was",
        ),
    ],
)
def test_an_object_that_fields_do_not_name_is_refused_with_advice(make, message):
    with pytest.raises(ValueError, match=message):
        FactorySpec.of(make())


@pytest.mark.parametrize("tastes", [[1.0, 2.0, 3.0], (1, 2, 3), np.arange(1.0, 4.0)])
def test_a_list_a_tuple_and_an_array_of_equal_entries_make_equal_parts(tastes):
    part, expected = Contest(tastes=tastes), Contest(tastes=(1.0, 2.0, 3.0))
    assert part == expected
    assert hash(part) == hash(expected)
    assert FactorySpec.of(part) == FactorySpec.of(expected)
    assert part != Contest(tastes=(1.0, 2.0, 4.0)) == Contest()
    assert part != AffineContest(tastes=tastes)


class AffineContest(Contest):
    """The same under another name."""


def test_a_part_keeps_copies_and_cannot_be_changed():
    target = np.arange(3.0)
    game = EnergyGame(target=target)
    target[0] = 7.0
    assert game.target.tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(ValueError, match="read-only"):
        game.target[0] = 7.0
    with pytest.raises(FrozenInstanceError, match="cannot assign to field 'target'"):
        game.target = target


def test_an_attribute_of_a_base_is_no_default_of_a_field():
    with pytest.raises(TypeError, match="missing 2 required positional arguments: 'matrix' and 'offset'"):
        QuadraticGame()


def test_a_part_with_an_init_of_its_own_is_refused_with_advice():
    with pytest.raises(TypeError, match="Old defines __init__, but the arguments of a part are its fields: declare"):

        class Old(AffineGame):
            def __init__(self, pull):
                self.pull = pull


@pytest.mark.parametrize("decorate", [dataclasses.dataclass, dataclasses.dataclass(frozen=True)])
def test_a_part_is_a_dataclass_already_and_takes_no_decorator(decorate):
    with pytest.raises(TypeError, match=r"frozen|Cannot overwrite attribute __setattr__ in class Contest"):
        decorate(type("Contest", (Contest,), {}))


def test_an_argument_that_a_check_refuses_is_named():
    with pytest.raises(ValueError, match="std must be a finite number of at least 0, got -1"):
        channels.AdditiveNoise(-1)
    assert channels.LateNoise(1, 3) == channels.LateNoise(std=1.0, step=3)


def test_the_text_of_a_part_is_short():
    assert repr(EnergyGame(2.0)) == "EnergyGame(curvature=2.0)"
    assert len(repr(FixedStart(np.zeros((50, 50))))) < 60


@pytest.mark.parametrize("part", [EnergyGame(target=np.arange(3.0)), graphs.cycle(5), RandomEnergy(5), Contest(0.2)])
def test_a_part_survives_pickle_and_copies(part):
    for again in (pickle.loads(pickle.dumps(part)), copy.deepcopy(part), dataclasses.replace(part)):  # noqa: S301 - ours
        assert again == part
        assert hash(again) == hash(part)


def test_a_class_in_a_function_is_refused_with_advice():
    class Inner(Contest):
        pass

    with pytest.raises(ValueError, match="Inner is defined inside a function or a class: define it at the top"):
        get_scenario("energy", game=Inner())


def test_a_scenario_takes_parts_by_object_and_class():
    named = get_scenario("energy", game=FactorySpec.of(Contest, pull=0.25), start=FactorySpec.of(UniformStart))
    given = get_scenario("energy", game=Contest(0.25), start=UniformStart)
    assert given == named
    assert hash(given) == hash(named)
    assert Scenario.from_dict(json.loads(json.dumps(given.to_dict()))) == named


def test_a_scenario_takes_a_graph_as_topology_and_arrays():
    ring, table = graphs.cycle(5), np.arange(25.0).reshape(5, 5)
    expected = World(get_scenario("energy", topology=switching.fixed(ring), start=FixedStart(table)))
    for topology in (ring, ring.adjacency, FactorySpec.of("ptne_env.world.graphs:cycle", players=5)):
        scenario = get_scenario("energy", topology=topology, start=table)
        world = World(Scenario.from_dict(json.loads(json.dumps(scenario.to_dict()))))
        assert world.topology.graphs == expected.topology.graphs
        assert np.array_equal(world.start.draw(5, 5, None), table.T)


def test_something_else_in_the_place_of_a_part_is_refused():
    with pytest.raises(ValueError, match="game is an object of the library's class for it, .*, got a int"):
        get_scenario("energy", game=5)
