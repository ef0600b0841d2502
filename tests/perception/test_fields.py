"""A field is one entry of a table: layouts, adapters and files follow it. Its equality on JAX is in tests/jax."""

import copy
import json
import pickle

import numpy as np
import pytest
from worlds import BLOCKS_SWITCHING, DEGREE, FAULTY, OWN_COST, begin, with_field, world_and_encoder

import ptne_env
from ptne_env import Interface, PolicySpec, evaluate, laws
from ptne_env.learn import Metadata
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.fields import FIELDS
from ptne_env.perception.observation import LayoutError
from ptne_env.world import dynamics

KINDS = "scaled", "physical", "full"


@pytest.fixture(params=[DEGREE, OWN_COST], ids=lambda field: field.name)
def added(request, monkeypatch):
    """A field that is new to the table."""
    monkeypatch.setitem(FIELDS, request.param.name, request.param)
    return request.param


def expected(field, world, state):
    """The new field of every player, (B, N)."""
    if field is DEGREE:
        adjacency = [world.topology.graphs[mode].adjacency for mode in dynamics.active_mode(world, state)]
        return np.array([(matrix > 0).sum(1) for matrix in adjacency])
    return np.array([world.game.costs(x[:, None])[:, 0] for x in dynamics.strategies(state).T])


@pytest.mark.parametrize("units", ["scaled", "physical"])
def test_a_new_field_needs_one_entry(added, units):
    plain, interface = Interface(units), with_field(added.name, units)
    world, encoder = world_and_encoder("energy-switching", interface)
    state = begin(world, [3, 4])
    for _ in range(40):
        state = dynamics.step(world, state, 0.1 * state.estimates)
    observations, layout = encoder.observe(state), encoder.layout
    assert np.array_equal(observations[..., :-1], Encoder(world, plain).observe(state))
    seen = layout.select(observations, added.name)[..., 0]
    assert np.array_equal(seen, expected(added, world, state).astype(np.float32))
    assert np.unique(seen).size > 1
    assert layout.observation_space().contains(observations[0, 0])

    env = ptne_env.parallel_env("energy-switching", interface=interface)
    vector = ptne_env.VectorParallelEnv("energy-switching", 2, interface=interface)
    space = layout.observation_space()
    assert env.observation_space("player_0") == vector.single_observation_space == space
    assert space.shape == (Encoder(world, plain).layout.size + 1,)
    first, together = env.reset(seed=5)[0], vector.reset(seed=5)[0]
    assert np.array_equal(list(first.values()), together[0])
    again = copy.deepcopy(env), pickle.loads(pickle.dumps(env))  # noqa: S301 - our own
    actions = {agent: np.full(5, 0.1, dtype=np.float32) for agent in env.agents}
    steps = [list(other.step(actions)[0].values()) for other in (env, *again)]
    assert np.array_equal(steps[0], steps[1])
    assert np.array_equal(steps[0], steps[2])


def test_a_new_field_is_seen_through_stable_baselines(added):
    pytest.importorskip("stable_baselines3", reason="needs the extra 'sb3'")
    from ptne_env.envs.sb3 import PlayerVecEnv

    env = PlayerVecEnv("energy", 2, interface=with_field(added.name, "scaled"), seed=0)
    assert env.observation_space == env.vector.layout.observation_space()
    assert env.reset().shape == (10, 25)


def test_a_policy_that_sees_a_new_field_is_compared(added):
    class Proud(laws.Static):
        """The static law, which also looks at the field."""

        interface = with_field(added.name, "physical")
        needs = (added.name,)

    proud = PolicySpec("proud", Proud)
    results = evaluate([proud, "static"], "energy", episodes=2)
    assert not results.failures
    assert np.array_equal(*(results.samples["energy", name]["digits"] for name in ("proud", "static")))
    with pytest.raises(LayoutError, match=f"reads {added.name}"):
        Proud(ptne_env.parallel_env("energy", interface="physical").layout)


# Interfaces ----------------------------------------------------------------------------------------------------------


def test_an_interface_has_the_fields_that_its_kind_has_by_default():
    for kind in KINDS:
        interface = Interface(kind)
        assert interface.fields == tuple(name for name, field in FIELDS.items() if kind in field.kinds)
        assert interface.to_dict() == {"kind": kind}  # as in all files that were written before there was a choice
        assert repr(interface) == f"Interface({kind!r})"
        assert Interface(interface.units, interface.fields[::-1]) == interface  # in the order of the table
        assert interface.is_privileged == (kind == "full")
    assert Interface("full").units == "physical"
    assert Interface("full").fields == (*Interface("physical").fields, "relative_equilibrium")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("natural",), "unknown interface 'natural'; choose from scaled, physical, full"),
        (("scaled", ("clok",)), "unknown field of the observation 'clok'; did you mean 'clock'"),
        (("scaled", "clock"), r"fields must be a list of names, such as \['clock'\], got 'clock'"),
        (("scaled", ("own_estimate",)), "'scaled' has no field 'own_estimate', which is one of 'physical', 'full'"),
        (("physical", ("log_scale",)), "'physical' has no field 'log_scale', which is one of 'scaled'"),
    ],
)
def test_a_wrong_interface_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Interface(*arguments)


def test_players_get_no_privileged_field_by_any_name():
    interface = Interface("physical", fields=("clock", "relative_equilibrium"))
    for make in (ptne_env.parallel_env, lambda *args, **kwargs: ptne_env.VectorParallelEnv(*args, 2, **kwargs)):
        with pytest.raises(ValueError, match="information that players lack"):
            make("energy", interface=interface)
    assert PolicySpec("mine", len, interface).is_oracle


def test_other_fields_are_written_and_read_in_files(added):
    interface = with_field(added.name, "scaled")
    data = json.loads(json.dumps(interface.to_dict()))
    assert data == {"kind": "scaled", "fields": [*Interface("scaled").fields, added.name]}
    assert Interface.from_dict(data) == interface
    spec = PolicySpec("mine", ptne_env.FactorySpec.of("law:static"), "physical")
    assert spec.to_dict()["interface"] == {"kind": "physical"}
    assert PolicySpec.from_dict(spec.to_dict()) == spec
    for given, text in ((interface, data), (Interface("physical"), "physical")):
        metadata = Metadata(interface=given, action_dims=(1,) * 5, slots=2, training={})
        assert metadata.to_dict()["interface"] == text
        assert Metadata.from_dict(json.loads(json.dumps(metadata.to_dict()))) == metadata


def test_a_law_names_the_field_that_an_interface_lacks():
    env = ptne_env.parallel_env("energy", interface=Interface("physical", fields=("own_gradient", "clock")))
    rows = np.stack(list(env.reset(seed=0)[0].values()))
    with pytest.raises(LayoutError, match="has no 'player'; it has own_gradient, clock"):
        laws.Static(env.layout).predict(rows)


@pytest.mark.parametrize("scenario", ["energy", BLOCKS_SWITCHING, FAULTY], ids=["energy", "blocks", "faulty"])
@pytest.mark.parametrize("units", ["scaled", "physical"])
def test_a_field_is_the_same_with_and_without_its_neighbours(scenario, units):
    world, encoder = world_and_encoder(scenario, "full" if units == "physical" else units)
    state, layout = begin(world, [0, 1, 2]), encoder.layout
    state = dynamics.step(world, state, np.ones_like(state.estimates))._replace(step=np.array([1, 5, 2]))
    for name in layout.slices:
        alone = Encoder(world, Interface(units, fields=(name,))).observe(state)
        assert np.array_equal(alone, layout.select(encoder.observe(state), name))
