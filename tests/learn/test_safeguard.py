"""Players of bad policies without sizes hand over to the law, players of good ones do not."""

from functools import partial

import numpy as np
import pytest
from affine_games import affine_scenario, random_affine, run
from worlds import begin, fixed_part, world_and_encoder

from ptne_env import FactorySpec, PolicySpec, get_scenario, theory
from ptne_env import learn as policies
from ptne_env.evaluation import get_suite
from ptne_env.evaluation.archive import policy_copy
from ptne_env.evaluation.check import _Copied
from ptne_env.field import laws as field_laws
from ptne_env.field.laws.gated import CellGates, observer_gates
from ptne_env.learn import SizeFreePolicy, safeguard
from ptne_env.shared.parts import LOADER
from ptne_env.world import dynamics

ENOUGH = 9.0
"""The residual may lack 400 steps by 60, each tenth a halving: 10.2 digits, less one digit between residual and error.
The law has 12."""


class Changed(SizeFreePolicy):
    """The gates of the law, some of them replaced from a step on."""

    def __init__(self, layout, guarded=True, since=0, **gates):
        super().__init__(layout, None, guarded=guarded)
        self.changes, self.since = gates, since

    def gates(self, cells, slots):
        gates, slot_gates = observer_gates(cells, slots)
        late = cells.steps >= self.since
        changed = {
            name: np.where(late, value, np.broadcast_to(getattr(gates, name), cells.own.shape))
            for name, value in self.changes.items()
        }
        return gates._replace(**changed), slot_gates


class Random(SizeFreePolicy):
    """Constant random gates."""

    def __init__(self, layout, guarded=True):
        super().__init__(layout, None, guarded=guarded)

    def gates(self, cells, slots):
        draws = np.random.default_rng(3).uniform(0, 0.6, 10)
        mine = CellGates(*(np.full_like(cells.own, draw) for draw in draws))
        return mine._replace(joint=0 * cells.own), observer_gates(cells, slots)[1]


def fixed_world():
    matrix, offset, adjacency = random_affine(np.random.default_rng(1), 4, coupling=1.0)
    return world_and_encoder(affine_scenario(matrix, offset, fixed_part(adjacency), steps=400))


def played(policy, world, encoder, episodes=2):
    """Digits of the worst episode, at most 12."""
    states = run(world, encoder, policy, begin(world, range(episodes)))
    errors = states[world.clock.steps] - world.game.nash_equilibrium[:, None, None]
    distance = np.linalg.norm(errors, axis=(0, 1)) / np.linalg.norm(world.game.nash_equilibrium)
    return min(-np.log10(distance.max()), 12.0)


BAD = {
    "gradient": {"flow": 10.0},
    "slow": {"copies": 0.05},
    "rests": {"response": 0.0},
    "no number": {"copies": np.nan},
    "late": {"since": 20, "response": 0.0},
}


@pytest.mark.parametrize("name", [*BAD, "random"])
def test_bad_policies_lose_few_digits_to_the_law_with_the_safeguard_alone(name):
    """Each case plays 400 steps twice: the safeguard waits 60 steps, and the law then needs its time."""
    world, encoder = fixed_world()
    make = Random if name == "random" else partial(Changed, **BAD[name])
    if name != "no number":
        assert played(make(encoder.layout, guarded=False), world, encoder) < ENOUGH - 1
    assert played(make(encoder.layout, guarded=True), world, encoder) > ENOUGH


@pytest.mark.parametrize("track", ["nominal", "noise", "quantised", "unseen-graphs"])
def test_players_with_the_gates_of_the_law_keep_them(track):
    world, encoder = world_and_encoder(get_suite("ptne-v1").track(track).scenario)
    policy, memory, state = Changed(encoder.layout), None, begin(world, [0])
    for _ in range(120):
        observation = encoder.observe(state).reshape(-1, encoder.layout.size)
        actions, memory = policy.predict(observation, memory)
        state = _stepped(world, encoder, state, actions)
    assert not policy.has_handed_over(memory).any()


def _stepped(world, encoder, state, actions):
    return dynamics.step(world, state, encoder.decode(actions.reshape(1, encoder.layout.num_players, -1), state))


def test_players_hand_over_one_by_one_and_for_good():
    world, encoder = fixed_world()
    policy, memory, state, seen = Changed(encoder.layout, copies=0.0), None, begin(world, [0]), []
    for _ in range(200):
        observation = encoder.observe(state).reshape(-1, encoder.layout.size)
        actions, memory = policy.predict(observation, memory)
        state = _stepped(world, encoder, state, actions)
        seen.append(policy.has_handed_over(memory))
    seen = np.array(seen)
    assert seen[-1].all()
    assert not seen[: int(safeguard.PATIENCE)].any()
    assert (np.diff(seen.astype(int), axis=0) >= 0).all()


def test_the_local_radius_after_handing_over_is_that_of_the_law():
    world, encoder = fixed_world()
    law = theory.local_radius(world, field_laws.ObserverRelay(encoder.layout))
    assert theory.local_radius(world, Changed(encoder.layout, copies=0.0)) == pytest.approx(law, abs=1e-6)
    assert theory.local_radius(world, Changed(encoder.layout, guarded=False, copies=0.0)) == pytest.approx(1.0)


def test_a_file_is_loaded_with_its_safeguard():
    _, encoder = fixed_world()
    assert not policies.load("size-free", encoder.layout).guarded
    assert policies.load("size-free", encoder.layout, guarded=True).guarded
    assert policies.load("size-free", guarded=True)(encoder.layout).guarded
    spec = PolicySpec("guarded", FactorySpec.of(LOADER, path_or_name="size-free", guarded=True))
    assert spec.build(encoder.layout).guarded
    assert spec.has_memory
    assert PolicySpec.from_dict(spec.to_dict()) == spec
    assert theory.certify(get_scenario("energy"), law=spec).law == "size-free with its safeguard"
    with pytest.raises(ValueError, match="has sizes: only policies without sizes have a safeguard"):
        policies.load("ppo-random-energy", guarded=True)


def test_a_copy_of_a_guarded_file_is_guarded_when_results_are_checked(tmp_path):
    path = tmp_path / "mine.onnx"
    path.write_bytes(policies.shipped_path("size-free").read_bytes())
    spec = PolicySpec("guarded", FactorySpec.of(LOADER, path_or_name=str(path), guarded=True))
    description = spec.to_dict()
    ((_, digest),) = description["training_seeds"][0]["files"].items()
    copy = policy_copy(tmp_path / "results", digest)
    copy.parent.mkdir(parents=True)
    path.rename(copy)
    copied = _Copied.of(spec, description, tmp_path / "results")
    assert copied.sources == (FactorySpec.of(LOADER, path_or_name=str(copy), guarded=True),)
