"""``record``: the arrays of episodes are those of ``evaluate`` and of the environment, and files hold them."""

import sys

import numpy as np
import pytest

import ptne_env
from ptne_env import FactorySpec, PolicySpec, evaluate, get_scenario, record
from ptne_env.evaluation import Teammates, Track
from ptne_env.evaluation.comparison import _round_values
from ptne_env.evaluation.metrics import METRICS, measure
from ptne_env.evaluation.trajectories import ARRAYS, SUFFIXES
from ptne_env.learn import shipped_path
from ptne_env.perception.observation import LayoutError
from ptne_env.perception.policy import PolicyError
from ptne_env.world import dynamics

NOISY = get_scenario(
    "random-energy-switching", channel=FactorySpec.of("channel:noise", std=0.1), steps=250, hold_steps=9
)
TEAM = Track("team", get_scenario("random-energy", steps=30), "", Teammates(FactorySpec.of("law:grounded"), (1, 3)))


@pytest.fixture(scope="module")
def run():
    return record("static", NOISY, seed=3, episodes=2)


def trained(steps=32):
    stable_baselines3 = pytest.importorskip("stable_baselines3", reason="needs the extra 'sb3'")
    from ptne_env.envs.sb3 import PlayerVecEnv

    env = PlayerVecEnv("random-energy", num_envs=2, seed=0)
    return stable_baselines3.PPO("MlpPolicy", env, seed=0, n_steps=steps, batch_size=steps)


@pytest.mark.parametrize(
    ("policy", "scenario"),
    [
        ("static", NOISY),
        ("adaptive-grounded", get_scenario("energy", hold_steps=5, steps=30)),
        ("recurrent-random-worlds", NOISY),
        (trained, TEAM.scenario),
        ("static", TEAM),
    ],
    ids=["law", "law-with-memory", "file", "sb3", "team"],
)
def test_metrics_of_a_trajectory_are_those_of_evaluate_bit_for_bit(policy, scenario):
    policy = PolicySpec("mine", policy()) if policy is trained else policy
    results = evaluate(policy, scenario, episodes=3, seed=4)
    (samples,) = results.samples.values()
    for name, values in measure(record(policy, scenario, episodes=3, seed=4).rollout).items():
        if not METRICS[name].is_timing:
            np.testing.assert_array_equal(_round_values(values), samples[name][0])


def test_arrays_are_what_the_environment_shows(run):
    env = ptne_env.parallel_env(NOISY, interface="physical")
    for episode in range(2):
        env.reset(seed=run.episodes.episode_seed(episode))
        np.testing.assert_array_equal(run.nash_equilibria[:, episode], env.nash_equilibrium)
        for instant, (t, weights, messages) in enumerate(
            zip(run.t, run.weights[..., episode], run.messages[..., episode], strict=True)
        ):
            world, state = env.world, env.get_state()
            assert env.time == t
            np.testing.assert_array_equal(run.estimates[instant, ..., episode], env.estimates)
            np.testing.assert_array_equal(run.strategies[instant, :, episode], env.strategies)
            arrived, heard = dynamics.weights(world, state), dynamics.relative_estimates(world, state)
            for (receiver, sender), weight, message in zip(run.links, weights, messages, strict=True):
                (slot,) = np.flatnonzero(world.neighbours[:, receiver] == sender)
                assert weight == arrived[slot, receiver, 0]
                np.testing.assert_array_equal(message, heard[slot, :, receiver, 0])
            if env.agents:
                held = run.inputs[instant, ..., episode]
                env.step(dict(zip(env.agents, held, strict=True)))
        assert instant == 259
        assert not env.agents
        assert np.isnan(run.inputs[-1]).all()


def test_shapes_and_times_are_as_documented(run):
    shapes = {name: getattr(run, name).shape for name in ARRAYS}
    assert shapes == {
        **dict.fromkeys(("t", "s", "tau"), (260,)),
        "strategies": (260, 5, 2),
        **dict.fromkeys(("estimates", "inputs"), (260, 5, 5, 2)),
        "links": (10, 2),
        "weights": (260, 10, 2),
        "messages": (260, 10, 5, 2),
        "nash_equilibria": (5, 2),
        **dict.fromkeys(("errors", "strategy_errors"), (260, 2)),
    }
    clock = run.rollout.world.clock
    assert run.tau[clock.steps] == pytest.approx(clock.effective_time, rel=1e-12)
    assert run.t[clock.steps] == clock.deadline < run.t[-1]
    assert (run.weights == 0).any()  # links switch
    nothing_is_random = get_scenario("energy", start="paper")
    assert record("static", nothing_is_random, episodes=7).errors.shape == (401, 1)


def test_files_hold_the_arrays(run, tmp_path):
    from scipy.io import loadmat

    for suffix in SUFFIXES:
        run.save(tmp_path / f"run{suffix.upper()}")
    arrays = np.load(tmp_path / "run.NPZ")
    matlab = loadmat(tmp_path / "run.MAT", appendmat=False)
    table = np.genfromtxt(tmp_path / "run.CSV", delimiter=",", names=True)
    for name in ARRAYS:
        np.testing.assert_array_equal(arrays[name], getattr(run, name))
        np.testing.assert_array_equal(matlab[name].reshape(arrays[name].shape), arrays[name])
    assert ptne_env.Scenario.from_dict(ptne_env.shared.files.json.loads(str(arrays["scenario"]))) == NOISY
    assert matlab["policy"] == ["static"]
    assert table.dtype.names == tuple(run.columns())
    np.testing.assert_array_equal(table["t"], np.tile(run.t, 2))
    np.testing.assert_array_equal(table["estimates_4_1"], run.estimates[:, 4, 1].T.ravel())
    np.testing.assert_array_equal(table["inputs_0_2"], run.inputs[:, 0, 2].T.ravel())
    receiver, sender = run.links[3]
    np.testing.assert_array_equal(table[f"messages_{receiver}_{sender}_2"], run.messages[:, 3, 2].T.ravel())
    np.testing.assert_array_equal(table["nash_equilibria_1"], np.repeat(run.nash_equilibria[1], 260))
    for suffix, start in {".PDF": b"%PDF", ".SVG": b"<?xml", ".PNG": b"\x89PNG"}.items():
        content = (tmp_path / f"run{suffix}").read_bytes()
        assert content.startswith(start)
        run.save(tmp_path / f"again{suffix}")
        assert (tmp_path / f"again{suffix}").read_bytes() == content
    assert b"/Type3" not in (tmp_path / "run.PDF").read_bytes()


def test_another_suffix_names_those_that_there_are_and_writes_nothing(run, tmp_path):
    with pytest.raises(ValueError, match=r"ends in \.npz, \.mat, \.csv, \.pdf, \.svg or \.png, got 'run\.hdf5'"):
        run.save(tmp_path / "run.hdf5")
    assert not list(tmp_path.iterdir())


def test_the_figure_is_one_column_wide_and_draws_into_given_axes_too(run):
    from matplotlib.figure import Figure

    figure = run.plot(estimates=True)
    assert figure.get_size_inches()[0] == 3.5
    top, bottom = figure.axes
    assert [text.get_text() for text in top.get_legend().get_texts()] == ["player 0", "1", "2", "3", "4"]
    assert len(top.lines) == 5 * (4 + 1 + 1) + 1  # others' estimates, the strategy, the equilibrium; the deadline
    np.testing.assert_array_equal(bottom.lines[0].get_ydata(), np.median(run.errors, axis=1))
    mine = Figure()
    assert run.plot(mine.subplots(2)) is mine


def test_a_data_frame_has_the_columns_or_the_error_names_the_extra(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r'data frames need pandas: pip install "ptne-env\[pandas\]"'):
        run.to_frame()
    monkeypatch.undo()
    pytest.importorskip("pandas", reason="needs the extra 'pandas'")
    frame = run.to_frame()
    assert frame.shape == (520, len(run.columns()))
    assert frame.groupby("episode").last()["errors"].tolist() == run.errors[-1].tolist()


def test_wrong_arguments_raise_what_evaluate_says():
    with pytest.raises(ValueError, match="unknown scenario 'energi'; did you mean 'energy'"):
        record("static", "energi")
    with pytest.raises(ValueError, match="unknown policy 'statik'; did you mean"):
        record("statik", "energy")
    with pytest.raises(ValueError, match="seed must be a whole number of at least 0, got -1"):
        record("static", "energy", seed=-1)
    with pytest.raises(ValueError, match="episodes must be a whole number of at least 1, got 0"):
        record("static", "energy", episodes=0)
    with pytest.raises(ValueError, match="episodes must be a whole number of at least 1, got 1.5"):
        record("static", "random-energy", episodes=1.5)
    with pytest.raises(LayoutError):
        record(shipped_path("ppo-nominal"), "robots")
    with pytest.raises(PolicyError, match="it cannot be built"):
        record(PolicySpec("mine", lambda layout: 1 / 0), "energy")


def test_a_track_of_a_suite_is_played_in_its_own_episodes():
    samples = evaluate("static", "ptne-v1/rounding", episodes=2).samples["ptne-v1/rounding", "static"]
    run = record("static", "ptne-v1/rounding", episodes=2)
    np.testing.assert_array_equal(_round_values(measure(run.rollout)["digits"]), samples["digits"][0])
