import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from processes import run_python

from ptne_env import FactorySpec
from ptne_env.catalogue import CATALOGUE
from ptne_env.experiments import get_suite, suite_policies
from ptne_env.factory import foreign_targets, is_part, resolve
from ptne_env.games import EnergyGame
from ptne_env.switching import SwitchingTopology

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


@given(targets, st.dictionaries(names, scalars, min_size=2))
def test_order_of_arguments_does_not_matter(target, items):
    assert FactorySpec.of(target, **items) == FactorySpec.of(target, **dict(reversed(items.items())))


def test_build_calls_the_named_object_with_its_arguments():
    game = FactorySpec.of("ptne_env.games:EnergyGame", coupling=0.3).build()
    assert isinstance(game, EnergyGame)
    assert game.coupling == 0.3


@pytest.mark.parametrize("name", ["target", "self", "cls"])
def test_arguments_may_have_any_name(name):
    part = FactorySpec.of("builtins:dict", **{name: 3})
    assert part.build() == {name: 3}
    assert FactorySpec.from_dict(part.to_dict()) == part


def test_game_with_other_targets_can_be_named():
    part = FactorySpec.of("ptne_env.games:EnergyGame", target=(1.0, 2.0, 3.0))
    assert part.build().num_players == 3


def test_nested_specs_are_built_first():
    graph = FactorySpec.of("ptne_env.graphs:path", players=3)
    built = FactorySpec.of("ptne_env.switching:SwitchingTopology", graphs=[graph, graph], dwells=[0.5, 0.25]).build()
    assert isinstance(built, SwitchingTopology)
    assert built.graphs[0].edges == [(0, 1), (1, 2)]


def test_arrays_are_frozen_so_that_specs_are_keys():
    adjacency = np.array([[0.0, 2.0], [2.0, 0.0]])
    part = FactorySpec.of("ptne_env.graphs:Graph", adjacency=adjacency)
    adjacency[:] = 7
    assert {part: 1}[FactorySpec.of("ptne_env.graphs:Graph", adjacency=[[0.0, 2.0], [2.0, 0.0]])] == 1


def test_extra_arguments_of_build_are_passed_on():
    assert FactorySpec.of("ptne_env.clock:Exponential").build(deadline=3.0).deadline == 3.0


@pytest.mark.parametrize("target", ["json", ":loads", "json:", ""])
def test_target_of_another_form_is_refused(target):
    with pytest.raises(ValueError, match="'module:object'"):
        resolve(target)


@pytest.mark.parametrize(
    ("target", "message"),
    [("no_such_module_anywhere:thing", "cannot import"), ("json:no_such_function", "has no 'no_such_function'")],
)
def test_missing_target_is_named(target, message):
    with pytest.raises(ValueError, match=message) as caught:
        FactorySpec.of(target).build()
    assert target in str(caught.value)


def test_refused_arguments_are_named():
    with pytest.raises(ValueError, match=r"refuses its arguments \['colour'\]"):
        FactorySpec.of("ptne_env.graphs:cycle", colour="red").build()


@pytest.mark.parametrize("data", [{}, {"target": "a:b", "argument": {}}, {"arguments": {}}])
def test_unknown_or_missing_keys_are_refused(data):
    with pytest.raises(ValueError, match="'target' and 'arguments'"):
        FactorySpec.from_dict(data)


def test_arguments_that_json_cannot_hold_are_refused():
    with pytest.raises(TypeError, match="numbers, strings, lists and parts, got object"):
        FactorySpec.of("a:b", thing=object())


@pytest.mark.parametrize("data", [{"target": 5}, {"target": "a:b", "arguments": [1]}, {"target": None}])
def test_values_of_another_type_are_refused(data):
    with pytest.raises(ValueError, match="string 'target' and an object 'arguments'"):
        FactorySpec.from_dict(data)


def test_any_error_from_wrong_arguments_is_a_refusal():
    for part in (
        FactorySpec.of("ptne_env.switching:fixed", graph=None),
        FactorySpec.of("ptne_env.graphs:union", graphs=[1]),
    ):
        with pytest.raises(ValueError, match=f"part '{part.target}' refuses its arguments"):
            part.build()


def test_every_part_that_the_library_names_is_one():
    suite = get_suite("ptne-v1")
    scenarios = [*CATALOGUE.values(), *(track.scenario for track in suite.tracks)]
    values = [getattr(scenario, field.name) for scenario in scenarios for field in dataclasses.fields(scenario)]
    specs = [value for value in values if isinstance(value, FactorySpec)]
    specs += [seed for policy in suite_policies() for seed in policy.training_seeds]
    targets = {part.target for spec in specs for part in spec.nested()}
    assert len(targets) > 40
    assert [target for target in targets if not is_part(target)] == ["networkx:circulant_graph"]


@pytest.mark.parametrize(
    "target",
    [
        "os:system",
        "builtins:eval",
        "ptne_env.files:write_atomically",
        "ptne_env.factory:resolve",
        "ptne_env.policies.archive:load_archive",
        "ptne_env.policies.learned:load",
        "ptne_env.policies:shipped",
        "ptne_env.experiments.ptne_v1:ptne_v1",
        "ptne_env.channel:replace",  # imported there from dataclasses
        "ptne_env.graphs:require_count",  # imported there from ptne_env.arrays
        "ptne_env.channel:counter_random",  # a module
        "ptne_env.channel:_Noise",
        "ptne_env.laws:NoSuchLaw",
        "ptne_env.laws.no_such_module:Law",
        "ptne_env.laws./tmp/evil:Law",
        "ptne_env.lawsuit:Law",
        "ptne_env.laws",
        "laws:Static",
        "",
    ],
)
def test_other_targets_are_foreign(target):
    assert not is_part(target)


def test_nested_foreign_targets_are_found_in_json_without_an_import(tmp_path):
    (tmp_path / "evil.py").write_text("raise SystemExit('imported')", encoding="utf-8")
    program = (
        "import json, sys\n"
        "from ptne_env.factory import FactorySpec, foreign_targets\n"
        "print(foreign_targets(FactorySpec.from_dict(json.loads(sys.argv[1]))), 'evil' in sys.modules)"
    )
    call = {"target": "evil:run", "arguments": {"word": {"target": "os:system", "arguments": {"command": "ls"}}}}
    data = {"target": "ptne_env.laws:Static", "arguments": {"kappa": [2.0, [call]], "again": call}}
    found = run_python("-c", program, json.dumps(data), folder=tmp_path)
    assert found.stdout.strip() == "['evil:run', 'os:system', 'evil:run', 'os:system'] False"
    assert foreign_targets(FactorySpec.of("ptne_env.laws:Static", kappa=2.0)) == []


def test_parts_that_are_nested_too_deeply_are_refused():
    data = {"target": "a:b"}
    for _ in range(3000):
        data = {"target": "a:b", "arguments": {"inner": data}}
    with pytest.raises(ValueError, match="nested too deeply"):
        FactorySpec.from_dict(data)
