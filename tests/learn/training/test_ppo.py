"""A real training run, its files, and its resumption after an interruption."""

import dataclasses
import json
import os

import numpy as np
import pytest
from extras import need_sb3
from processes import KILLS, kill_at_random_moments, run_python, start_python

torch = need_sb3()

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

import ptne_env
from ptne_env import Interface, PolicySpec, evaluate
from ptne_env import learn as policies
from ptne_env.cli.train import next_commands
from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.learn.training import checkpoint, ppo
from ptne_env.learn.training.arguments import Arguments
from ptne_env.learn.training.export import to_onnx
from ptne_env.learn.training.features import Products

# A few seconds on one core, and more than three digits.
ARGUMENTS = Arguments("random-energy", steps=100_000, envs=32, validation_episodes=50)


@pytest.fixture(scope="session")
def run(tmp_path_factory, build_once):
    """The folder of the run, its summary and the calls of ``progress``."""

    def build():
        out, reports = tmp_path_factory.mktemp("run"), []
        return out, ppo.train(ARGUMENTS, out, lambda *report: reports.append(report)), reports

    return build_once("training", build)


def test_training_gains_digits_over_its_own_start(run):
    _, summary, _ = run
    env = PlayerVecEnv("random-energy", interface="scaled")
    torch.manual_seed(0)
    untrained = PPO("MlpPolicy", env, policy_kwargs={"activation_fn": torch.nn.Tanh}, device="cpu", seed=0)
    results = evaluate(
        [PolicySpec("untrained", untrained, Interface("scaled"))],
        [ptne_env.get_scenario("random-energy")],
        episodes=50,
        split="validation",
        against_laws=False,
    )
    start = results.record("random-energy", "untrained", "digits")["high"]
    # The untrained network gains nothing, this run three digits.
    assert summary.validation_digits > start + 1.0


def test_a_run_leaves_a_policy_a_summary_and_logs_and_no_checkpoint(run):
    out, summary, reports = run
    assert json.loads((out / "summary.json").read_text(encoding="utf-8")) == dataclasses.asdict(summary)
    assert sorted(path.name for path in out.iterdir()) == ["policy.onnx", "summary.json", "tensorboard"]
    assert summary.agent_steps >= ARGUMENTS.steps
    assert summary.parts == 1
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
    assert results.record("random-energy", "learned", "digits")["mean"] == policy.metadata.digits
    assert policy.metadata.digits == summary.validation_digits


def times(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


def test_another_run_in_the_same_folder_is_refused_and_changes_nothing(run):
    out, _, _ = run
    before = times(out)
    with pytest.raises(
        ValueError, match="another run: seed is 0 there and 1 here; choose another folder, or remove this one"
    ):
        ppo.train(dataclasses.replace(ARGUMENTS, seed=1), out)
    assert times(out) == before


def test_a_finished_run_is_not_repeated_and_loses_a_checkpoint_left_over(run):
    out, summary, _ = run
    before = times(out)
    (out / "checkpoint.npz").write_bytes(b"left by a kill after the end")
    assert ppo.train(ARGUMENTS, out, lambda *_: pytest.fail("it trains")) == summary
    assert times(out) == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenarios": "random-enery"}, "unknown scenario 'random-enery'"),
        ({"scenarios": ("random-energy", "ptne-v1/delay"), "envs": 5}, "5 environments cannot be shared evenly by 2"),
        ({"scenarios": "ptne-v1/mixed-team"}, "more than its scenario"),
        (
            {"scenarios": ("random-energy", "robots"), "envs": 2},
            "no policy of one layout can act in both .* a policy without sizes can",
        ),
        ({"interface": "full"}, "choose 'physical', 'local' or 'learner'"),
        ({"envs": 1, "minibatches": 250}, "minibatches must be fewer than the 250 samples of a rollout, got 250"),
    ],
)
def test_a_start_that_fails_leaves_no_files(change, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        ppo.train(dataclasses.replace(ARGUMENTS, **change), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "summary.json is not the summary of a training run: it is cut off"),
        ("[]", "summary.json is not the summary of a training run: expected a JSON object"),
        ('{"parts": 1}', "summary.json is not the summary of a training run: arguments is missing"),
        (None, "holds another run: unheard_of is 1 there and missing here"),
    ],
)
def test_a_damaged_or_later_summary_is_refused_by_name(content, message, run, tmp_path):
    _, summary, _ = run
    later = dataclasses.replace(summary, arguments=summary.arguments | {"unheard_of": 1})
    (tmp_path / "policy.onnx").touch()
    (tmp_path / "summary.json").write_text(content or json.dumps(dataclasses.asdict(later)), encoding="utf-8")
    before = times(tmp_path)
    with pytest.raises(ValueError, match=message):
        ppo.train(ARGUMENTS, tmp_path)
    assert times(tmp_path) == before


# Ten rollouts, with a checkpoint before the first, fourth, seventh and tenth.
SHORT = Arguments(
    "random-energy", steps=4000, envs=8, rollout=10, minibatches=4, validation_episodes=5, checkpoint_rollouts=3
)
MIXED = dataclasses.replace(SHORT, scenarios=("random-energy", "ptne-v1/coarse-step"), action_mode="gains", seed=2)


class InterruptionError(Exception):
    pass


def interrupted(arguments, out, after):
    """Train, and stop ``after`` rollouts; the agent-steps that were reported."""
    done = []

    def report(steps, *_):
        done.append(steps)
        if len(done) == after:
            raise InterruptionError

    with pytest.raises(InterruptionError):
        ppo.train(arguments, out, report)
    return done


@pytest.mark.parametrize("arguments", [SHORT, MIXED, dataclasses.replace(SHORT, products=False)])
def test_an_interrupted_run_ends_as_an_undisturbed_one_bit_for_bit(arguments, tmp_path):
    whole = ppo.train(arguments, tmp_path / "whole")
    np.random.seed(1)  # noqa: NPY002 - the state of the process must not matter
    torch.manual_seed(1)
    out = tmp_path / "parts"
    assert interrupted(arguments, out, after=2)[0] == 400
    assert interrupted(arguments, out, after=5)[0] == 400
    assert interrupted(arguments, out, after=1)[0] == 1600
    assert interrupted(arguments, out, after=6)[0] == 1600
    reports = []
    summary = ppo.train(arguments, out, lambda steps, *_: reports.append(steps))
    assert reports == [2800, 3200, 3600, 4000]
    assert (out / "policy.onnx").read_bytes() == (tmp_path / "whole" / "policy.onnx").read_bytes()
    assert summary == dataclasses.replace(whole, seconds=summary.seconds, parts=5)


def test_the_seconds_of_all_parts_are_summed(tmp_path, monkeypatch):
    clock = iter(range(1000))
    monkeypatch.setattr(ppo, "monotonic", lambda: float(next(clock)))
    # Each reading of the clock is a second: one at the start, and one at each checkpoint.
    interrupted(SHORT, tmp_path, after=4)
    assert checkpoint.read(tmp_path / "checkpoint.npz")[0].seconds == 2.0
    summary = ppo.train(SHORT, tmp_path)
    assert summary.seconds == 2.0 + 5.0  # before rollouts 4, 7 and 10, after training, and at the end
    assert summary.parts == 2


def test_a_run_that_fails_in_its_validation_resumes_there(tmp_path, monkeypatch):
    monkeypatch.setattr(ppo, "_validate", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        ppo.train(SHORT, tmp_path)
    assert not (tmp_path / "policy.onnx").exists()
    monkeypatch.undo()
    summary = ppo.train(SHORT, tmp_path, lambda *_: pytest.fail("it trains again"))
    assert summary == dataclasses.replace(ppo.train(SHORT, tmp_path / "whole"), seconds=summary.seconds, parts=2)


def test_a_policy_that_fails_in_its_validation_is_not_kept(tmp_path, monkeypatch):
    export = ppo.to_onnx

    def broken(model, *arguments, **named):
        with torch.no_grad():
            model.policy.action_net.bias.fill_(float("nan"))
        return export(model, *arguments, **named)

    monkeypatch.setattr(ppo, "to_onnx", broken)
    with pytest.raises(ValueError, match="the trained policy fails on 'random-energy': .*finite"):
        ppo.train(SHORT, tmp_path)
    assert not (tmp_path / "policy.onnx").exists()


def test_an_interrupted_run_with_other_arguments_is_refused(tmp_path):
    interrupted(SHORT, tmp_path, after=1)
    before = times(tmp_path)
    with pytest.raises(
        ValueError,
        match="holds another run: hidden is \\[.*\\] there and \\[8\\] here, seed is 0 there and 1 here; choose",
    ):
        ppo.train(dataclasses.replace(SHORT, seed=1, hidden=(8,)), tmp_path)
    assert times(tmp_path) == before


def test_the_logs_of_a_resumed_run_hold_every_rollout(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    interrupted(SHORT, tmp_path, after=6)
    ppo.train(SHORT, tmp_path)
    (folder,) = (tmp_path / "tensorboard").iterdir()
    events = EventAccumulator(str(folder)).Reload()
    assert {event.step for event in events.Scalars("time/fps")} == set(range(400, 4001, 400))


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """The command that trains :data:`SHORT`, the folder of an undisturbed run, and its summary."""
    folder = tmp_path_factory.mktemp("short")
    configuration = folder / "short.toml"
    values = dataclasses.asdict(SHORT) | {"steps": 20_000, "seed": 5}
    configuration.write_text(
        "".join(f"{name} = {json.dumps(value)}\n" for name, value in values.items()), encoding="utf-8"
    )
    command = ("-m", "ptne_env.cli", "train", configuration, "--out")
    return command, folder / "whole", ppo.train(Arguments.from_toml(configuration), folder / "whole")


@pytest.mark.parametrize("chain", range(8 if os.environ.get("PTNE_SOAK") else 1))
def test_killed_commands_end_as_an_undisturbed_run(chain, short, tmp_path):
    command, whole, summary = short
    out = tmp_path / "out"
    kills = KILLS[chain % 2 :: 2]  # each signal once
    assert kill_at_random_moments(lambda: start_python(*command, out), kills, longest=4.0, seed=chain) > 0
    assert "digits on the validation episodes" in run_python(*command, out).stdout
    assert (out / "policy.onnx").read_bytes() == (whole / "policy.onnx").read_bytes()
    mine = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert mine == dataclasses.asdict(summary) | {"seconds": mine["seconds"], "parts": mine["parts"]}
    assert not (out / "checkpoint.npz").exists()


def test_the_command_takes_the_seed_of_the_file_and_says_that_a_run_has_ended(short, tmp_path):
    command, whole, summary = short
    before = times(whole)
    printed = run_python(*command, whole, "--json", tmp_path / "summary.json").stdout
    assert printed.startswith(f"This run has ended before, with {summary.validation_digits:.2f} digits on the valid")
    assert json.loads((tmp_path / "summary.json").read_text(encoding="utf-8")) == dataclasses.asdict(summary)
    assert times(whole) == before


@pytest.mark.parametrize("kind", ["local", "learner", "physical"])
@pytest.mark.parametrize("mode", ["input", "gains"])
@pytest.mark.parametrize("products", [True, False])
def test_the_exported_policy_acts_like_the_model_over_whole_episodes(kind, mode, products, tmp_path):
    arguments = Arguments("random-energy-switching", kind, mode, envs=2, minibatches=10, products=products, seed=1)
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
    env = PlayerVecEnv("random-energy", interface="scaled")
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
    env = ppo.make_env(Arguments(names, envs=4))
    assert [scenario.steps for scenario in env.get_attr("scenario")] == [400] * 10 + [150] * 10


@pytest.mark.parametrize("names", [("random-energy",), ("random-energy", "ptne-v1/coarse-step")])
def test_statistics_of_episodes_are_kept_once(names):
    env = ppo.make_env(Arguments(names, envs=2))
    assert isinstance(env, VecMonitor)
    assert not isinstance(env.venv, VecMonitor)


def test_the_reported_digits_are_those_of_the_steps_of_the_last_episode_length(tmp_path, monkeypatch):
    rewards, reports = [], []
    step = ppo.PlayerVecEnv.step_wait

    def watched(env):
        outcome = step(env)
        rewards.append(outcome[1].mean())
        return outcome

    monkeypatch.setattr(ppo.PlayerVecEnv, "step_wait", watched)
    arguments = dataclasses.replace(SHORT, envs=2, rollout=200, steps=6000, checkpoint_rollouts=2)
    ppo.train(arguments, tmp_path, lambda *report: reports.append(report[2]))
    assert reports == pytest.approx(
        [400 * np.mean(rewards[:200]), *(np.sum(rewards[first : first + 400]) for first in (0, 200))], rel=1e-4
    )


def test_the_command_trains_several_seeds_resumes_them_and_draws_their_curves(tmp_path):
    command = ("-m", "ptne_env.cli", "train", "random-energy", "--out", tmp_path, "--steps", "1", "--seed", "3")
    interrupted(Arguments.from_toml("random-energy", steps=1, seed=4), tmp_path / "seed-4", after=1)
    printed = run_python(*command, "--seeds", "2", "--json", tmp_path / "all.json").stdout
    summaries = json.loads((tmp_path / "all.json").read_text(encoding="utf-8"))
    assert [(summary["arguments"]["seed"], summary["parts"]) for summary in summaries] == [(3, 1), (4, 2)]
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["all.json", "learning-curve.png", "seed-3", "seed-4"]
    for folder in ("seed-3", "seed-4"):
        assert sorted(path.name for path in (tmp_path / folder).iterdir()) == [
            "curve.csv",
            "policy.onnx",
            "summary.json",
            "tensorboard",
        ]
    mean = np.mean([summary["validation_digits"] for summary in summaries])
    assert f"Mean of 2 seeds: {mean:.2f} digits" in printed
    pattern = f"static,trained={tmp_path}/seed-*/policy.onnx"
    assert f"To compare:  ptne compare random-energy --policy '{pattern}'" in printed
    assert f"To see the logs:  tensorboard --logdir {tmp_path}" in printed


@pytest.mark.parametrize(
    ("scenarios", "where"),
    [
        (["random-energy"], "random-energy"),
        (["ptne-v1/noise", "ptne-v1/delay"], "ptne-v1/noise ptne-v1/delay"),
        (["random-energy", "ptne-v1/delay"], "--suite ptne-v1"),
        (["ptne-v1/noise", "ptne-v2/delay"], "--suite ptne-v2"),
        ([], "--suite ptne-v2"),
    ],
)
def test_the_printed_comparison_is_where_the_policy_was_trained(scenarios, where, tmp_path):
    lines = next_commands(scenarios, tmp_path, [tmp_path], has_seeds=False)
    assert lines == [f"To compare:  ptne compare {where} --policy static,{tmp_path}/policy.onnx"]


@pytest.mark.parametrize(
    ("start", "other"), [("size-free", "size-free"), ("runs/policy.onnx", "start=runs/policy.onnx")]
)
def test_a_specialist_is_compared_with_the_policy_that_it_started_from(start, other, tmp_path):
    lines = next_commands(["ptne-v1/noise"], tmp_path, [], has_seeds=False, start=start)
    assert lines == [f"To compare:  ptne compare ptne-v1/noise --policy {other},{tmp_path}/policy.onnx"]
