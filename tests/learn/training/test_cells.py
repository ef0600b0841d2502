"""Cells as environments: the same trajectories as a rollout of the gated law, and Stable-Baselines3's checks."""

import numpy as np
import pytest
from extras import need_sb3

torch = need_sb3()

from stable_baselines3.common.vec_env.base_vec_env import VecEnv

from ptne_env import get_scenario
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.rollout import rollout
from ptne_env.field.laws.gated import CellGates, ObserverRelay, SlotGates, evidence
from ptne_env.learn.size_free import CELL_FEATURES, SLOT_FEATURES, features
from ptne_env.learn.training.actor import effects
from ptne_env.learn.training.cells import CELL_GATES, SLOT_GATES, CellBatch, CellVecEnv
from ptne_env.learn.training.network import GateNetwork
from ptne_env.learn.training.worlds import training_world
from ptne_env.perception.encoder import make_encoder

EPISODES = EpisodeSet(3, 0, "train")
SEEDS = [EPISODES.episode_seed(episode) for episode in range(3)]
WORLDS = [training_world(0, 0), get_scenario("random-energy").replace(steps=20)]
BREAKING, TURNS = (get_scenario("random-energy-switching"), 5), (WORLDS[0], 1)
"""Worlds and steps: links are dead in the first, and own components wait for their turn in the second."""


def gates_of_the_law(batch):
    return ObserverRelay.gates(None, *batch.evidence)


@pytest.mark.parametrize("scenario", WORLDS, ids=lambda scenario: scenario.name)
def test_cells_with_the_gates_of_a_law_follow_its_rollout_bit_for_bit(scenario):
    batch = CellBatch(scenario, 3)
    batch.start(SEEDS)
    states = []
    policy = ObserverRelay(batch.layout)
    encoder = make_encoder(batch.world, ObserverRelay.interface)
    rollout(policy, encoder, EPISODES.initial_state(batch.world), watch=lambda state, _: states.append(state.estimates))
    for estimates in states[:-1]:
        np.testing.assert_array_equal(batch.state.estimates, estimates)
        batch.step(*gates_of_the_law(batch))
    np.testing.assert_array_equal(batch.state.estimates, states[-1])
    assert batch.is_over


def test_answers_and_gates_are_inverses_within_the_bounds():
    batch = CellBatch(WORLDS[0], 2)
    batch.start(SEEDS[:2])
    gates = gates_of_the_law(batch)
    for mine, theirs in zip(gates, batch.as_gates(*batch.as_answers(*gates)), strict=True):
        for wanted, found in zip(mine, theirs, strict=True):
            np.testing.assert_array_equal(found, np.broadcast_to(np.float32(wanted), found.shape))


def by_the_law(env):
    """Actions of the law for all members."""
    actions = np.zeros((env.num_envs, *env.action_space.shape), dtype=np.float32)
    for batch, members in zip(env.playing, env.members, strict=True):
        cell, slot = batch.as_answers(*gates_of_the_law(batch))
        flat = np.concatenate([cell, slot.reshape(batch.cells, -1)], axis=1)
        actions[members, : flat.shape[1]] = flat
    return actions


@pytest.fixture
def env():
    return CellVecEnv([[world] for world in WORLDS], episodes=2)


def test_observations_hold_the_features_and_zeros_for_slots_of_other_worlds(env):
    observations = env.reset()
    assert observations.shape == (env.num_envs, *env.observation_space.shape)
    assert observations.dtype == env.observation_space.dtype == np.float32
    for batch, members in zip(env.playing, env.members, strict=True):
        cell, slot = batch.features()
        np.testing.assert_array_equal(observations[members, : len(CELL_FEATURES)], cell)
        slots = observations[members, len(CELL_FEATURES) :].reshape(batch.cells, env.slots, len(SLOT_FEATURES))
        np.testing.assert_array_equal(slots[:, : batch.layout.slots], slot)
        assert not slots[:, batch.layout.slots :].any()


def test_rewards_add_up_to_the_digits_that_players_and_team_gained(env):
    env.seed(1)
    env.reset()
    batch, members = env.playing[1], env.members[1]
    first, total = batch.digits, np.zeros(batch.cells)
    for _ in range(19):
        _, rewards, dones, _ = env.step(by_the_law(env))
        assert not dones[members].any()
        total += rewards[members]
    gained = batch.digits - first
    expected = 0.5 * gained + 0.5 * gained.mean(axis=0)
    np.testing.assert_allclose(total, np.repeat(expected.T.ravel(), batch.layout.dimension), rtol=1e-5)


def test_a_place_starts_new_episodes_with_new_games_when_its_episodes_end(env):
    env.reset()
    batch, members = env.playing[1], env.members[1]
    game = batch.state.game
    for step in range(20):
        observations, _, dones, infos = env.step(by_the_law(env))
        assert dones[members].all() == (step == 19)
        assert not dones[env.members[0]].any()
    assert batch.state.game is not game
    assert (batch.state.step == 0).all()
    last = [info["terminal_observation"] for info in infos[members]]
    assert not np.array_equal(last, observations[members])
    episode = infos[members.start]["episode"]
    assert episode["l"] == 20
    assert episode["r"] > 3
    assert not any(infos[env.members[0]])


def test_the_same_seed_gives_the_same_episodes(env):
    env.seed(5)
    first = env.reset()
    other = CellVecEnv([[world] for world in WORLDS], episodes=2)
    assert other.seed(5) == [5] * env.num_envs
    np.testing.assert_array_equal(other.reset(), first)
    assert not np.array_equal(other.reset(), first)


def test_members_are_those_of_a_vec_env(env):
    assert isinstance(env, VecEnv)
    assert env.observation_space.shape == (len(CELL_FEATURES) + env.slots * len(SLOT_FEATURES),)
    assert env.action_space.shape == (CELL_GATES + env.slots * SLOT_GATES,)
    assert env.get_attr("slots", [0, 1]) == [env.slots] * 2
    assert env.env_is_wrapped(object) == [False] * env.num_envs
    env.set_attr("mark", 3)
    assert env.get_attr("mark") == [3] * env.num_envs
    assert len(env.env_method("seed", 3, indices=[0])) == 1
    with pytest.raises(ValueError, match="for all of them or none"):
        env.set_attr("mark", 4, indices=[0])
    env.close()


def test_worlds_of_a_place_must_have_one_number_of_cells():
    with pytest.raises(ValueError, match=r"same number of cells .*, got train-0: 9, random-energy: 25"):
        CellVecEnv([WORLDS])
    with pytest.raises(ValueError, match="at least one place"):
        CellVecEnv([])


def test_a_network_that_is_a_law_decides_alike():
    network = GateNetwork.of_law("observer-relay")
    batch = CellBatch(WORLDS[1], 2)
    batch.start(SEEDS[:2])
    for _ in range(5):
        mine, theirs = batch.as_gates(*network.decide(*batch.features()))
        for found, wanted in zip((*mine, *theirs), (g for part in gates_of_the_law(batch) for g in part), strict=True):
            np.testing.assert_allclose(found, np.broadcast_to(wanted, found.shape), atol=1e-6)
        batch.step(mine, theirs)


@pytest.mark.parametrize(
    ("scenario", "steps", "counts"),
    [(*BREAKING, True), (*BREAKING, False), (*TURNS, False)],
    ids=["counts", "does not count", "does not count during turns"],
)
@pytest.mark.parametrize("own", [True, False], ids=["own", "of another"])
@pytest.mark.parametrize("name", [*CellGates._fields, *SlotGates._fields])
def test_a_gate_counts_in_training_exactly_where_the_law_reads_it(scenario, steps, name, own, counts):
    generator = np.random.default_rng(0)

    def drawn(*shape):
        return generator.uniform(0.1, 0.4, shape)

    batch = CellBatch(scenario, 2)
    batch.start(SEEDS[:2])
    for _ in range(steps):
        batch.step(*gates_of_the_law(batch))
    found, law = batch._found, batch._law
    cells, links = found.drift.shape, found.means.mean.shape
    means = type(found.means)(*(drawn(*links) for _ in found.means))
    is_heard = generator.random((links[0], links[1], 1)) < 0.5  # of live and of dead links; some rows have no samples
    found = found._replace(  # so that all proposals differ
        track=drawn(*cells),
        unrest=found.unrest._replace(width=drawn(cells[0], 1)),
        means=means._replace(samples=means.samples * is_heard),
        joint=found.joint._replace(point=found.here + drawn(*cells)),
        memory=found.memory | {"push": drawn(*cells)},
    )
    seen = evidence(batch._observation, law._parts.split(batch._memory), found, batch.layout, None)
    cell, slot = features(*seen)
    acts = effects(
        torch.from_numpy(cell.reshape(batch.cells, -1)), torch.from_numpy(slot.reshape(batch.cells, *slot.shape[2:]))
    ).numpy()
    mine, theirs = batch.as_gates(acts[:, :CELL_GATES], acts[:, CELL_GATES:])
    gates = CellGates(*(drawn(*cells) for _ in CellGates._fields))
    is_trusted = generator.random(links) < 0.5  # shares of one message alone matter if they are 0
    slot_gates = SlotGates(*(drawn(*links) * is_trusted for _ in SlotGates._fields))
    is_chosen = (found.is_own == own) if name in CellGates._fields else (found.is_own == own)[:, None]
    place = is_chosen & ((mine._asdict() | theirs._asdict())[name] == counts)

    def inputs(more):
        changed = gates._asdict() | slot_gates._asdict()
        changed[name] = changed[name] + more * drawn(*changed[name].shape) * place
        parts = [kind(*(changed[field] for field in kind._fields)) for kind in (CellGates, SlotGates)]
        return law.follow(batch._observation, batch._memory, found, *parts)[0]

    before, after = inputs(0.0), inputs(1.0)
    if counts:
        assert (np.abs(after - before) > 1e-9).any() == place.any()
    elif name in ("belief", "stated"):  # without samples the belief is the copy plus the estimate minus the estimate
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-9)
    else:
        np.testing.assert_array_equal(after, before)


def test_the_mean_of_a_dead_link_counts_as_long_as_it_has_samples():
    batch = CellBatch(get_scenario("random-energy-switching"), 1)
    batch.start(SEEDS[:1])
    cell, slot = map(torch.from_numpy, batch.features())
    is_other = cell[:, CELL_FEATURES.index("own")] == 0
    slot[:, :, SLOT_FEATURES.index("live")] = 0.0
    slot[:, 0, SLOT_FEATURES.index("samples")] = 0.3
    slot[:, 1:, SLOT_FEATURES.index("samples")] = 0.0
    means = effects(cell, slot)[:, CELL_GATES + SlotGates._fields.index("mean") :: SLOT_GATES]
    assert means[is_other, 0].all()
    assert not means[is_other, 1:].any()
    assert not means[~is_other].any()
