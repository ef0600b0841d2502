"""A real training run, its files, and its resumption after an interruption."""

import dataclasses
import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from extras import need_sb3

torch = need_sb3()

from stable_baselines3 import PPO

import ptne_env
from ptne_env import Interface, PolicySpec, evaluate, policies
from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.experiments.suite import find_scenario
from ptne_env.training import ppo
from ptne_env.training.export import to_onnx
from ptne_env.training.features import Products

# A few seconds on one core, and more than three digits.
ARGUMENTS = ppo.Arguments("random-energy", steps=100_000, envs=32, validation_episodes=50)


@pytest.fixture(scope="session")
def run(tmp_path_factory, build_once):
    """The folder of the run, its summary and the calls of ``progress``."""

    def build():
        out, reports = tmp_path_factory.mktemp("run"), []
        return out, ppo.train(ARGUMENTS, out, lambda *report: reports.append(report)), reports

    return build_once("training", build)


def test_training_gains_digits_over_its_own_start(run):
    _, summary, _ = run
    env = PlayerVecEnv("random-energy", interface="local")
    torch.manual_seed(0)
    untrained = PPO("MlpPolicy", env, policy_kwargs={"activation_fn": torch.nn.Tanh}, device="cpu", seed=0)
    results = evaluate(
        [PolicySpec("untrained", untrained, Interface("local"))],
        [ptne_env.get_scenario("random-energy")],
        episodes=50,
        split="validation",
        against_laws=False,
    )
    start = results.record("random-energy", "untrained", "digits")["high"]
    # The untrained network gains nothing, this run three digits.
    assert summary["validation_digits"] > start + 1.0


def test_a_run_leaves_a_policy_a_summary_and_logs_and_no_checkpoint(run):
    out, summary, reports = run
    assert (
        json.loads((out / "summary.json").read_text(encoding="utf-8"))["validation_digits"]
        == summary["validation_digits"]
    )
    assert sorted(path.name for path in out.iterdir()) == [
        "arguments.json",
        "policy.onnx",
        "summary.json",
        "tensorboard",
    ]
    assert summary["agent_steps"] >= ARGUMENTS.steps
    done = [report[0] for report in reports]
    assert done == sorted(done)
    assert {report[1] for report in reports} == {ARGUMENTS.steps}
    assert np.isfinite(reports[-1][2])


def test_the_policy_reaches_the_digits_in_its_file(run):
    out, summary, _ = run
    policy = policies.load(out / "policy.onnx")
    results = evaluate(
        [PolicySpec("learned", policy)],
        [ptne_env.get_scenario("random-energy")],
        episodes=50,
        split="validation",
        against_laws=False,
    )
    assert results.record("random-energy", "learned", "digits")["mean"] == pytest.approx(
        policy.metadata.digits, abs=1e-3
    )
    assert policy.metadata.digits == summary["validation_digits"]


def test_another_run_in_the_same_folder_is_refused_and_changes_nothing(run):
    out, _, _ = run
    before = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    with pytest.raises(ValueError, match="another seed"):
        ppo.train(dataclasses.replace(ARGUMENTS, seed=1), out)
    assert before == {path.name: path.stat().st_mtime_ns for path in out.iterdir()}


def test_a_damaged_or_later_folder_is_refused_by_name(tmp_path):
    written = tmp_path / "arguments.json"
    written.write_text(json.dumps(dataclasses.asdict(ARGUMENTS))[:-20], encoding="utf-8")
    with pytest.raises(ValueError, match="arguments.json is not the arguments of a training run: it is cut off"):
        ppo.train(ARGUMENTS, tmp_path)
    written.write_text(json.dumps(dataclasses.asdict(ARGUMENTS) | {"unheard_of": 1}), encoding="utf-8")
    with pytest.raises(ValueError, match="holds a run with another unheard_of"):
        ppo.train(ARGUMENTS, tmp_path)
    written.unlink()
    checkpoint = tmp_path / "checkpoint.zip"
    for content in (b"", b"PK\x03\x04 cut off", b"something else"):
        checkpoint.write_bytes(content)
        with pytest.raises(ValueError, match="checkpoint.zip is damaged, or not of this run: remove it"):
            ppo.train(ARGUMENTS, tmp_path)
        assert checkpoint.read_bytes() == content


def test_a_killed_run_resumes_from_its_last_checkpoint(tmp_path):
    code = (
        "import sys, pathlib\n"
        "from ptne_env.training import ppo\n"
        "arguments = ppo.Arguments('random-energy', steps=60_000, envs=16, checkpoint_seconds=0.1,"
        " validation_episodes=10)\n"
        "steps = []\n"
        "ppo.train(arguments, pathlib.Path(sys.argv[1]), lambda done, total, digits: steps.append(done))\n"
        "print(steps[0])\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    process = subprocess.Popen(command)  # noqa: S603 - our own code
    checkpoint = tmp_path / "checkpoint.zip"
    deadline = time.monotonic() + 120
    while not checkpoint.exists():
        assert process.poll() is None, "the run ended before its first checkpoint"
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    saved = PPO.load(checkpoint, device="cpu").num_timesteps
    assert 0 < saved < 60_000

    outcome = subprocess.run(command, capture_output=True, text=True, check=True, timeout=240)  # noqa: S603
    rollout = 16 * 5 * 50
    assert int(outcome.stdout) == saved + rollout  # only the steps after the checkpoint are lost
    assert policies.load(tmp_path / "policy.onnx").metadata.steps >= 60_000


def test_configurations_name_scenarios_of_the_catalogue():
    assert ppo.configurations()
    for name in ppo.configurations():
        arguments = ppo.Arguments.from_toml(name, seed=3)
        assert all(find_scenario(name) for name in arguments.scenarios)
        assert arguments.seed == 3


def test_an_unknown_configuration_or_argument_is_refused_by_name(tmp_path):
    with pytest.raises(ValueError, match="unknown configuration 'nope'; choose from .*random-energy, "):
        ppo.Arguments.from_toml("nope")
    path = tmp_path / "mine.toml"
    path.write_text('scenario = "random-energy"\nlearning_rat = 1.0\n', encoding="utf-8")
    with pytest.raises(ValueError, match=r"mine.toml: unknown learning_rat"):
        ppo.Arguments.from_toml(path)


@pytest.mark.parametrize("kind", ["local", "physical"])
@pytest.mark.parametrize("mode", ["input", "gains"])
@pytest.mark.parametrize("products", [True, False])
def test_the_exported_policy_acts_like_the_model_over_whole_episodes(kind, mode, products, tmp_path):
    arguments = ppo.Arguments("random-energy-switching", kind, mode, envs=2, minibatches=10, products=products, seed=1)
    env = PlayerVecEnv("random-energy-switching", 2, interface=kind, action_mode=mode, seed=4)
    model = PPO("MlpPolicy", env, **ppo.settings(arguments, env.layout))
    with torch.no_grad():  # large weights, so that actions are clipped too
        for parameter in model.policy.action_net.parameters():
            parameter.mul_(200.0)
    path = tmp_path / "policy.onnx"
    path.write_bytes(to_onnx(model, env.layout, scenarios=("random-energy-switching",), seed=1, digits=0.0))
    policy = policies.load(path)
    policy.require(env.layout)
    observations, clipped = env.reset(), 0
    for _ in range(401):
        expected, _ = model.predict(observations, deterministic=True)
        actions, _ = policy.predict(observations)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(actions, expected, rtol=0, atol=1e-5 * max(scale, 1.0))
        clipped += int((np.abs(actions) == env.layout.action_bound).sum())
        observations, _, _, _ = env.step(actions)
    if kind == "local":
        assert clipped > 0


def test_a_layer_that_cannot_be_exported_is_named():
    env = PlayerVecEnv("random-energy", interface="local")
    model = PPO("MlpPolicy", env, policy_kwargs={"activation_fn": torch.nn.ReLU}, device="cpu")
    with pytest.raises(ValueError, match="ReLU"):
        to_onnx(model, env.layout, scenarios=("random-energy",), seed=0, digits=0.0)


@pytest.mark.parametrize("kind", ["local", "physical"])
def test_products_are_gradient_and_differences_times_links_and_player(kind):
    env = PlayerVecEnv("random-energy-switching", 3, interface=kind, seed=4)
    observations, layout = env.reset(), env.layout
    features = Products(env.observation_space, **Products.of(layout))(torch.as_tensor(observations)).numpy()
    assert np.array_equal(features[:, : layout.size], observations)
    part = {name: layout.select(observations, name) for name in layout.slices}
    factors = np.concatenate([part["own_gradient"], part["relative_estimates"]], axis=1)
    gates = np.concatenate([part["weights"], part["player"]], axis=1)
    assert features.shape[1] == layout.size + factors.shape[1] * gates.shape[1]
    for row in range(len(observations)):
        expected = np.outer(factors[row], gates[row]).ravel()
        assert np.array_equal(features[row, layout.size :], expected)


def test_environments_are_shared_evenly_by_the_scenarios():
    names = ("random-energy", "ptne-v1/coarse-step")
    env = ppo.make_env(ppo.Arguments(names, envs=4))
    assert [scenario.steps for scenario in env.get_attr("scenario")] == [400] * 10 + [150] * 10
    with pytest.raises(ValueError, match="5 environments cannot be shared evenly by 2"):
        ppo.make_env(ppo.Arguments(names, envs=5))
    with pytest.raises(ValueError, match="more than its scenario"):
        ppo.make_env(ppo.Arguments("ptne-v1/mixed-team"))
