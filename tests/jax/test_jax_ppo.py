"""PPO on JAX: the networks of numpy, runs that repeat and resume bit for bit, and what the update is made of."""

import dataclasses
import functools

import pytest

jax = pytest.importorskip("jax")

import numpy as np

import ptne_env
from ptne_env.learn import PolicyFileError, layers, load, npz_policy
from ptne_env.learn.layers import LayeredPolicy
from ptne_env.training import curve, jax_ppo
from ptne_env.training.configuration import Configuration, write_checkpoint
from ptne_env.training.curve import read_learning_curve

SCENARIO = ptne_env.get_scenario("random-energy-switching", steps=15)
SHORT = Configuration(
    "test_jax_ppo:SCENARIO", steps=1000, batch=200, rollout=10, minibatches=2, epochs=2, hidden=(8, 6), log_std=-1.0
)
"""Five updates in short episodes, which end within rollouts."""

ALGORITHMS = "ippo", "mappo-rnn"


learner_of = functools.cache(jax_ppo.Learner)  # compiles once for all tests


def learner(algorithm="ippo", **changes):
    return learner_of(dataclasses.replace(SHORT, algorithm=algorithm, **changes))


@pytest.fixture(autouse=True)
def _few(monkeypatch):
    monkeypatch.setattr(jax_ppo, "Learner", learner_of)
    monkeypatch.setattr(curve, "VALIDATION_EPISODES", 5)


class InterruptionError(Exception):
    pass


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_an_interrupted_run_ends_bit_for_bit_as_an_uninterrupted_one(algorithm, tmp_path):
    configuration, reports = dataclasses.replace(SHORT, algorithm=algorithm), []
    whole = jax_ppo.train(configuration, tmp_path / "whole", lambda *report: reports.append(report))
    assert [report[:2] for report in reports] == [(200 * done, 1000) for done in range(1, 6)]

    def interrupt(done, *_):
        if done == 400:
            raise InterruptionError

    with pytest.raises(InterruptionError):
        jax_ppo.train(configuration, tmp_path / "halves", interrupt)
    assert not (tmp_path / "halves" / "policy.npz").exists()
    halves = jax_ppo.train(configuration, tmp_path / "halves")
    assert (halves.resumed_at, halves.digits) == (400, whole.digits)
    for name in ("policy.npz", "evaluations.npz", "checkpoint.npz"):
        assert (tmp_path / "halves" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert jax_ppo.train(configuration, tmp_path / "whole", lambda *_: pytest.fail("it trains")) == whole
    with pytest.raises(ValueError, match="holds another run: seed is 0 there and 1 here"):
        jax_ppo.train(dataclasses.replace(configuration, seed=1), tmp_path / "whole")
    assert list(read_learning_curve(tmp_path / "whole")[0]) == [200, 400, 600, 800, 1000]


def test_a_damaged_or_foreign_checkpoint_is_refused_by_name(tmp_path):
    path = tmp_path / "checkpoint.npz"
    path.write_bytes(b"PK")
    with pytest.raises(ValueError, match=r"checkpoint\.npz is damaged, or no checkpoint: remove it"):
        jax_ppo.train(SHORT, tmp_path)
    write_checkpoint(path, [np.zeros(3)])
    with pytest.raises(ValueError, match=r"checkpoint\.npz is the checkpoint of another run or version: remove it"):
        jax_ppo.train(SHORT, tmp_path)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_numpy_plays_a_policy_file_as_jax_trained_it(algorithm, tmp_path):
    jax_ppo.train(dataclasses.replace(SHORT, algorithm=algorithm), tmp_path)
    policy = load(tmp_path / "policy.npz", learner().layout)
    weights = jax.tree.map(jax.numpy.asarray, policy.weights)
    rng, memory, other = np.random.default_rng(0), None, np.zeros((6, 7), dtype=np.float32)
    for step in range(5):
        rows = rng.normal(size=(7, learner().layout.size)).astype(np.float32)
        starts = np.arange(7) == step
        actions, memory = policy.predict(rows, memory, starts)
        expected, other = layers.run_layers(weights, rows.T, np.where(starts, 0, other))
        np.testing.assert_allclose(actions, np.clip(expected.T, -1, 1), rtol=1e-5, atol=1e-6)
        alone, _ = policy.predict(rows[2:3], None if memory is None else np.zeros((1, 6), np.float32))
        if memory is None:  # in every batch the same bits
            np.testing.assert_array_equal(alone[0], actions[2])
    assert (memory is None) == (algorithm == "ippo")
    assert np.ptp(actions) > 0.01
    results = ptne_env.evaluate({"mine": policy}, [SCENARIO], episodes=50, split="validation")
    digits = read_learning_curve(tmp_path)[1]
    assert results.record(SCENARIO.name, "mine", "digits")["mean"] == pytest.approx(digits[-1], abs=1e-4)


def test_a_layered_file_with_weights_of_another_network_is_refused(tmp_path):
    jax_ppo.train(SHORT, tmp_path)
    policy = load(tmp_path / "policy.npz")
    assert isinstance(policy, LayeredPolicy)
    assert policy.metadata.training["algorithm"] == "ippo"
    for changes in ({"out": policy.weights["out"][:4]}, {"again": np.zeros((3, 6, 6))}, {"more": np.zeros(1)}):
        content = npz_policy.seal(policy.weights | changes, policy.metadata)
        with pytest.raises(PolicyFileError, match=r"mine\.npz is damaged, or no policy of this library: "):
            npz_policy.open_policy(tmp_path / "mine.npz", content)
    with pytest.raises(ptne_env.perception.observation.LayoutError, match="action_dims"):
        load(tmp_path / "policy.npz", ptne_env.parallel_env("robots").layout)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_network_replays_a_rollout_with_its_memory_and_the_starts_of_episodes(algorithm):
    it = learner(algorithm)
    runner = it.start()
    runner, _ = jax.lax.scan(it._step, runner, jax.random.split(jax.random.key(1), 8))
    _, steps = jax.lax.scan(it._step, runner, jax.random.split(jax.random.key(2), 10))
    assert steps.starts[1:].any()  # an episode starts within the rollout
    assert not steps.starts[0].any()  # so that the first memory matters
    means, _ = jax_ppo._replay(runner.params["actor"], steps.observations, runner.memory, steps.starts)
    actions = np.moveaxis(steps.actions, 1, 0).reshape(5, -1)
    again = jax_ppo._log_probability(actions, means, runner.params["log_std"])
    np.testing.assert_allclose(again, steps.log_probabilities.reshape(-1), rtol=1e-4, atol=1e-4)


def test_advantages_are_discounted_sums_of_errors_that_end_with_episodes():
    it, rng = learner(discount=0.5), np.random.default_rng(0)
    rewards, values = rng.normal(size=(2, 10, 20)).astype(np.float32)
    overs, last = rng.random((10, 20)) < 0.2, rng.normal(size=20).astype(np.float32)
    steps = jax_ppo.Steps(None, None, None, values, rewards=rewards, overs=overs)
    after, expected = np.concatenate([values[1:], last[None]]), np.zeros((11, 20))
    for t in reversed(range(10)):
        error = rewards[t] / 2 + 0.5 * after[t] * ~overs[t] - values[t]
        expected[t] = error + 0.5 * jax_ppo.GAE_LAMBDA * ~overs[t] * expected[t + 1]
    np.testing.assert_allclose(it._advantages(steps, last, 2.0), expected[:10], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("rarity", [5.0, 100.0])
def test_actions_that_became_much_likelier_move_the_actor_no_more_whether_they_were_good_or_bad(rarity):
    """Else a few bad ones, whose ratios grow without bound, decide the update, and long trainings collapse."""
    it = learner()
    runner = it.start()
    _, steps = jax.lax.scan(it._step, runner, jax.random.split(jax.random.key(1), 10))
    steps = jax.tree.map(lambda each: each.reshape(10, -1, each.shape[-1]), steps)
    advantages = jax.random.normal(jax.random.key(2), steps.values.shape)
    for change, moves in ((0.0, True), (rarity, False)):
        before = steps._replace(log_probabilities=steps.log_probabilities - change)
        slope = jax.grad(it._loss)(runner.params, before, advantages, steps.values, runner.memory)
        assert (max(np.abs(each).max() for each in slope["actor"].values()) > 0) == moves
        assert all(np.isfinite(each).all() for each in jax.tree.leaves(slope))


def test_the_critic_of_mappo_alone_sees_the_way_to_the_equilibrium_and_all_distances():
    assert jax.eval_shape(learner()._start).params["critic"]["layer_0"].shape == (8, learner().layout.size)
    it = learner("mappo-rnn")
    runner = it.start()
    assert runner.params["critic"]["layer_0"].shape == (8, it.layout.size + 10 + 6)
    assert runner.params["actor"]["layer_0"].shape == (8, it.layout.size)
    observations = it.world.observe(runner.state)
    seen = it._state_seen(runner.state, observations.reshape(-1, 20)).reshape(10, 5, 4)
    errors = np.asarray(runner.state.game.nash_equilibria)[:, None] - runner.state.estimates
    unit = 10 ** (10 * observations[it.layout.slices["log_scale"]][0, 2])
    ego = [2, 3, 4, 0, 1]
    np.testing.assert_allclose(seen[:5, 2], np.clip(errors[ego, 2] / unit, -3, 3), rtol=1e-4)
    distances = np.linalg.norm(errors, axis=0)[ego]
    np.testing.assert_allclose(seen[5:, 2], np.log10(distances / unit) / 2, rtol=1e-3, atol=1e-5)


def test_seeds_share_no_episode():
    games = [np.asarray(learner(seed=seed).start().state.game.nash_equilibria) for seed in (0, 1)]
    assert not np.isin(games[0], games[1]).any()
    pools = [ptne_env.jax.JaxWorld("random-affine", pool=5, seed=seed) for seed in (0, 1)]
    games = [np.asarray(world.reset(jax.random.key(0), 50).game.nash_equilibria) for world in pools]
    assert not np.isin(games[0], games[1]).any()


def test_a_run_gains_digits_with_minibatches_that_do_not_divide_its_samples(tmp_path):
    jax_ppo.train(
        dataclasses.replace(SHORT, steps=40_000, batch=400, minibatches=3, hidden=(32, 32), log_std=-1.5), tmp_path
    )
    digits = read_learning_curve(tmp_path)[1]
    assert digits[-1] > digits[0] + 0.3


def test_more_minibatches_than_samples_are_refused():
    with pytest.raises(ValueError, match="minibatches must be at most the 20 players of all environments, got 21"):
        learner("ippo-rnn", minibatches=21)
    with pytest.raises(ValueError, match="minibatches must be at most the 200 samples of a rollout, got 201"):
        learner(minibatches=201)


@pytest.mark.parametrize(("players", "environments"), [(1, 640), (5, 128), (54, 11), (1000, 1)])
def test_a_batch_has_as_many_agent_steps_for_any_number_of_players(players, environments):
    assert Configuration("energy", batch=32_000, rollout=50).environments(players) == environments
