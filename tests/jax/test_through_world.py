"""Training through the world: the same network as in numpy, finite gradients, and runs that repeat and resume."""

import dataclasses
import itertools

import pytest

jax = pytest.importorskip("jax")

import numpy as np

import ptne_env.jax
from ptne_env.learn import load, npz_policy, recurrent
from ptne_env.learn.policy_files import shipped_path
from ptne_env.perception.encoder import Encoder
from ptne_env.shared.random_streams import RandomStreams
from ptne_env.training import through_world
from ptne_env.world import dynamics

SHORT = through_world.Settings(
    "test_through_world:SCENARIO", updates=4, cells=50, window=5, hidden=4, slot_hidden=3, rate=0.01
)
SCENARIO = ptne_env.get_scenario("random-energy-switching", steps=20)
TRACK = through_world.Track("energy", SCENARIO, "")
WEIGHTS = recurrent.initial_weights(np.random.default_rng(SHORT.seed), 4, 3)
UPWARDS = {name: np.ones_like(each) for name, each in WEIGHTS.items()}


def test_the_network_is_the_same_in_numpy_and_jax():
    world = ptne_env.jax.JaxWorld(SCENARIO, interface="physical")
    layout, policy = world.layout, recurrent.RecurrentPolicy("mine", WEIGHTS, world.layout, {})
    encoder = Encoder(world.numpy, layout.interface)
    state = dynamics.draw_initial_state(world.numpy, [RandomStreams.from_seed(seed) for seed in range(3)])
    player, memory = np.repeat(np.arange(5), 3), None
    memories = recurrent.initial_memory(WEIGHTS, layout.slots, layout.dimension, 15, jax.numpy)

    @jax.jit
    def play(observed, memories):
        return recurrent.run_network(WEIGHTS, layout, recurrent.read(layout, observed, player), memories)

    for _ in range(6):
        actions, memory = policy.predict(encoder.observe(state).reshape(15, -1), memory)
        again, memories, _ = play(world.observe(world.state(state)).reshape(layout.size, -1), memories)
        by_row = np.asarray(again).reshape(5, 5, 3).transpose(2, 1, 0).reshape(15, 5)
        np.testing.assert_allclose(actions, by_row, rtol=1e-3, atol=1e-4 * np.abs(actions).max())
        state = dynamics.step(world.numpy, state, encoder.decode(actions.reshape(3, 5, 5), state))


def test_gradients_are_finite_where_nothing_is_left_to_do():
    """At the equilibrium distances, differences and scales are 0, and their logarithms are not defined."""
    lesson = through_world.Lesson(TRACK, SHORT, jax.random.key(0))
    state, memory = lesson._carry
    rest = jax.numpy.broadcast_to(state.game.nash_equilibria[:, None], state.estimates.shape)
    state = state._replace(estimates=rest, own_gradients=0 * state.own_gradients)
    slope = jax.grad(lambda weights: lesson._loss(weights, (state, memory))[0])(WEIGHTS)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slope))


def test_gradients_do_not_explode_in_memories(monkeypatch):
    """Gated units with large weights are chaotic, and their gradients grow from step to step."""
    factors = {"again": 16, "slot_again": 16, "out": 20}
    weights = WEIGHTS | {name: factor * WEIGHTS[name] for name, factor in factors.items()}
    settings = dataclasses.replace(SHORT, window=20, shrink=1.0, memory_shrink=1.0)

    def norm():
        lesson = through_world.Lesson(TRACK, settings, jax.random.key(0))
        slope = jax.jit(jax.grad(lambda weights: lesson._loss(weights, lesson._carry)[0]))(weights)
        return sum(float((leaf**2).sum()) for leaf in jax.tree.leaves(slope)) ** 0.5

    bounded = norm()
    monkeypatch.setattr(through_world, "_damp", lambda array, factor, bound: array)
    assert bounded < 0.1 * norm()


def test_gradients_with_respect_to_states_are_cut_in_every_step():
    lesson = through_world.Lesson(TRACK, SHORT, jax.random.key(0))
    before, memory = lesson._carry
    step = jax.jit(lambda each: lesson._step(WEIGHTS, (before._replace(estimates=each), memory))[0][0].estimates)
    estimates, back = jax.vjp(step, before.estimates)
    distances = np.linalg.norm(estimates - before.game.nash_equilibria[:, None], axis=(0, 1))
    assert (np.linalg.norm(back(1e9 * estimates)[0], axis=(0, 1)) < 3 / (lesson.envs * distances)).all()


def test_gradients_are_cut_in_each_environment_and_lost_where_they_are_not_finite():
    given = np.array([[3.0, 0.3, np.inf, 0.0], [4.0, 0.4, 1.0, np.nan]], dtype=np.float32)
    array, back = jax.vjp(lambda array: through_world._damp(array, 0.5, np.ones(4)), np.ones_like(given))
    np.testing.assert_array_equal(array, np.ones_like(given))
    np.testing.assert_allclose(*back(given), [[0.3, 0.15, 0, 0], [0.4, 0.2, 0, 0]], rtol=1e-6)


def test_a_run_learns_and_goes_on_after_an_interruption(tmp_path):
    reports, out = [], tmp_path / "out"
    summary = through_world.train(SHORT, out, lambda *report: reports.append(report))
    assert [report[:2] for report in reports] == [(done, 4) for done in range(1, 5)]
    assert (summary.agent_steps, summary.resumed_at) == (4 * 5 * 10, 0)
    policy = load(out / "policy.npz", ptne_env.jax.JaxWorld(SCENARIO, interface="physical").layout)
    assert policy.training["scenario"] == SHORT.scenario
    assert through_world.train(SHORT, out, lambda *_: pytest.fail("it trains")) == summary
    with pytest.raises(ValueError, match="holds another run: seed is 0 there and 1 here"):
        through_world.train(dataclasses.replace(SHORT, seed=1), out)
    (out / "summary.json").unlink()  # as if it was interrupted after two updates
    (out / "policy.npz").write_bytes(shipped_path("ppo-nominal").read_bytes())
    with pytest.raises(ValueError, match="is no policy of such a run; remove it to start again"):
        through_world.train(SHORT, out)
    half = policy.training | {"done": 2, "agent_steps": 100}
    (out / "policy.npz").write_bytes(npz_policy.seal(policy.weights, half))
    resumed = through_world.train(SHORT, out)
    assert resumed.resumed_at == 2
    assert np.isfinite(resumed.digits)  # though no episode has ended since then
    again = load(out / "policy.npz")
    assert again.training == policy.training
    assert any((again.weights[name] != policy.weights[name]).any() for name in again.weights)


def test_an_update_follows_the_mean_slope_of_all_worlds(tmp_path, monkeypatch):
    for name, factors, moves in (("opposite", (0.001, -0.001), False), ("alike", (0.001, 0.001), True)):
        slopes = itertools.cycle([jax.tree.map(np.float32(factor).__mul__, UPWARDS) for factor in factors])
        monkeypatch.setattr(through_world.Lesson, "slope", lambda *_, of=slopes: (next(of), 0.0))
        through_world.train(dataclasses.replace(SHORT, updates=1), tmp_path / name, tracks=(TRACK, TRACK))
        trained = load(tmp_path / name / "policy.npz").weights
        assert (trained["gate"] != WEIGHTS["gate"]).all() == (trained["again"] != WEIGHTS["again"]).any() == moves


def test_worlds_are_dealt_into_groups_and_each_has_its_turn(tmp_path, monkeypatch):
    class Lesson:
        agent_steps = 1

        def __init__(self, track, *_):
            self.name = track.name

        def slope(self, _):
            played.append(self.name)
            return UPWARDS, 0.0

    played, names = [], "abcde"
    monkeypatch.setattr(through_world, "Lesson", Lesson)
    settings = dataclasses.replace(SHORT, groups=2, updates=8)
    tracks = [dataclasses.replace(TRACK, name=name) for name in names]
    summary = through_world.train(settings, tmp_path, tracks=tracks)
    assert summary.agent_steps == len(played) == 4 * len(names)  # a group is two worlds or three
    deals = [played[start : start + len(names)] for start in range(0, len(played), len(names))]
    assert [sorted(deal) for deal in deals] == [[*names]] * 4
    assert len(set(map(tuple, deals))) > 1


def test_a_run_that_gets_worse_keeps_its_best_weights(tmp_path, monkeypatch):
    moves = []
    for name, digits in (("rises", range(40)), ("falls", [*range(20), *range(0, -20, -1)])):
        following = iter(digits)
        monkeypatch.setattr(through_world.Lesson, "slope", lambda *_, of=following: (UPWARDS, float(next(of))))
        through_world.train(dataclasses.replace(SHORT, updates=40), tmp_path / name)
        moves.append(float((WEIGHTS["gate"] - load(tmp_path / name / "policy.npz").weights["gate"]).mean()))
    assert moves[0] > 1.2 * moves[1] > 0
    monkeypatch.setattr(through_world.Lesson, "slope", lambda *_: (UPWARDS, -1.0))
    file = tmp_path / "falls" / "policy.npz"
    before = load(file)
    file.with_name("summary.json").unlink()  # as if it was interrupted after thirty updates
    file.write_bytes(npz_policy.seal(before.weights, before.training | {"done": 30}))
    through_world.train(dataclasses.replace(SHORT, updates=40), file.parent)
    np.testing.assert_equal(load(file).weights, before.weights)
