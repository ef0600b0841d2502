"""Training: what a configuration may hold, what a run leaves in its folder, and what it says about resumption."""

import copy
import dataclasses
import json

import numpy as np
import pytest
from affine_games import SOAK
from extras import need_sb3

torch = need_sb3()

from matplotlib import image
from stable_baselines3 import A2C, PPO, SAC, TD3
from stable_baselines3.common.vec_env import VecNormalize

import ptne_env
from ptne_env import PolicySpec, learn
from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.learn.npz_policy import open_policy, seal
from ptne_env.report.tables import leaders
from ptne_env.training import sb3
from ptne_env.training.configuration import Configuration
from ptne_env.training.curve import VALIDATION_EPISODES, draw, evaluate_laws, read_learning_curve
from ptne_env.training.sb3 import ALGORITHMS, export

SCENARIO = ptne_env.get_scenario("random-energy", steps=40)
SHORT = Configuration("test_training:SCENARIO", steps=700, batch=100, rollout=10, minibatches=2, hidden=(8,))
"""Seven rollouts of a hundred agent-steps, in short episodes."""
RUNS = [dataclasses.replace(SHORT, algorithm=name) for name in ALGORITHMS]
of_every_algorithm = pytest.mark.parametrize("short", RUNS, ids=ALGORITHMS)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("steps", 0),
        ("batch", True),
        ("minibatches", "5"),
        ("learning_rate", float("inf")),
        ("discount", 1.5),
        ("log_std", 1.0),
        ("hidden", [64, 0]),
        ("hidden", []),
        ("scenario", "\x1b[31mred"),
    ],
)
def test_a_wrong_value_is_refused_by_name(name, value, tmp_path):
    with pytest.raises(ValueError, match=name):
        Configuration(**{"scenario": "random-energy", name: value})


@pytest.fixture(scope="module", params=RUNS, ids=ALGORITHMS)
def run(tmp_path_factory, request):
    """The configuration of an uninterrupted run, its folder, its summary and its reports."""
    out, reports = tmp_path_factory.mktemp("run") / "out", []
    return request.param, out, sb3.train(request.param, out, lambda *report: reports.append(report)), reports


def test_a_run_leaves_a_policy_that_reaches_the_digits_in_its_file(run):
    short, out, summary, reports = run
    policy = learn.load(out / "policy.npz", PlayerVecEnv("random-energy").layout)
    assert policy.metadata.training.items() >= {"scenario": short.scenario, "steps": 700, "seed": 0}.items()
    assert (summary.agent_steps, summary.resumed_at) == (700, 0)
    assert json.loads((out / "summary.json").read_text()) == dataclasses.asdict(summary)
    results = ptne_env.evaluate(
        [PolicySpec("mine", policy)], [SCENARIO], episodes=VALIDATION_EPISODES, split="validation"
    )
    assert results.record("random-energy", "mine", "digits")["mean"] == pytest.approx(summary.digits, abs=1e-9)
    assert [report[:2] for report in reports] == [(100 * done, 700) for done in range(1, 8)]
    assert np.isfinite(reports[-1][2])


def test_a_run_without_interruption_is_repeatable(run, tmp_path):
    short, out, summary, _ = run
    again = sb3.train(short, tmp_path)
    assert (tmp_path / "policy.npz").read_bytes() == (out / "policy.npz").read_bytes()
    assert dataclasses.replace(again, seconds=summary.seconds) == summary
    other = sb3.train(dataclasses.replace(short, seed=1), tmp_path / "other")
    assert other.digits != summary.digits


def times(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


def test_a_finished_run_is_not_repeated_and_another_one_is_refused(run):
    short, out, summary, _ = run
    before = times(out)
    assert sb3.train(short, out, lambda *_: pytest.fail("it trains")) == summary
    with pytest.raises(ValueError, match="holds another run: seed is 0 there and 1 here; choose another folder"):
        sb3.train(dataclasses.replace(short, seed=1), out)
    assert times(out) == before


def test_a_run_in_a_world_that_has_changed_since_is_another_run(run, monkeypatch):
    """Its name is the same, and its policy would be that of another world."""
    short, out, _, _ = run
    monkeypatch.setitem(globals(), "SCENARIO", SCENARIO.replace(deadline=2.0))
    with pytest.raises(ValueError, match=r"another run: content of the scenario is \w+ there and \w+ here"):
        sb3.train(short, out)


class InterruptionError(Exception):
    pass


def interrupt(done, *_):
    if done == 500:
        raise InterruptionError


def parameters_of(model):
    """Networks, optimisers, and the weight of SAC's entropy."""
    names = model._get_torch_save_params()[1]
    return copy.deepcopy([model.get_parameters(), [getattr(model, name) for name in names]])


@of_every_algorithm
def test_an_interrupted_run_goes_on_with_all_parameters_of_its_last_whole_checkpoint(short, tmp_path, monkeypatch):
    checkpoints = tmp_path / "checkpoints"
    checkpoints.mkdir()
    (checkpoints / "rl_model_900_steps.zip").write_bytes(b"PK\x03\x04")  # of a run that was killed
    with pytest.raises(InterruptionError):
        sb3.train(short, tmp_path, interrupt)
    path = max(checkpoints.iterdir(), key=lambda path: path.stat().st_mtime_ns)
    last = int(path.stem.split("_")[2])
    assert 400 <= last <= 500
    content = path.read_bytes()
    (checkpoints / "rl_model_800_steps.zip").write_bytes(content[: len(content) // 2])
    (checkpoints / "rl_model_850_steps.zip").symlink_to("/dev/null")
    algorithm, _ = ALGORITHMS[short.algorithm]
    stored, learn_on, resumed, reports = parameters_of(algorithm.load(path, device="cpu")), algorithm.learn, [], []

    def learn_from(model, *arguments, **named):
        resumed.append(parameters_of(model))
        return learn_on(model, *arguments, **named)

    monkeypatch.setattr(algorithm, "learn", learn_from)
    summary = sb3.train(short, tmp_path, lambda done, *_: reports.append(done))
    assert (summary.resumed_at, reports[0]) == (last, last + 100)
    assert summary.agent_steps == reports[-1] >= short.steps
    mine, theirs = (torch.utils._pytree.tree_leaves(parameters) for parameters in (resumed[0], stored))
    pairs = [(a, b) for a, b in zip(mine, theirs, strict=True) if isinstance(a, torch.Tensor)]
    assert len(pairs) > 20  # weights, and the moments of each
    assert all(torch.equal(a, b) for a, b in pairs)


@of_every_algorithm
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenario": "random-enery"}, "unknown scenario 'random-enery'"),
        ({"minibatches": 100}, "minibatches must be fewer than the 100 samples of a rollout, got 100"),
    ],
)
def test_a_start_that_fails_leaves_no_files(short, change, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        sb3.train(dataclasses.replace(short, **change), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_policy_that_fails_in_its_validation_is_not_kept(tmp_path, monkeypatch):
    def broken(*arguments, **named):
        policy = open_policy(tmp_path / "mine.npz", export(*arguments, **named))
        largest = np.finfo(np.float32).max
        weights = {name: np.copysign(largest, each) for name, each in policy.weights.items()}  # their sums overflow
        return seal(weights, policy.metadata)

    monkeypatch.setattr(sb3, "export", broken)
    with pytest.raises(ValueError, match="the trained policy fails on 'random-energy': step 0: .*(overflow|finite)"):
        sb3.train(RUNS[0], tmp_path)
    assert not (tmp_path / "policy.npz").exists()


SMALL = {"net_arch": [16, 16]}


@pytest.mark.parametrize(
    ("algorithm", "arguments"),
    [
        (PPO, SMALL),
        (A2C, SMALL | {"activation_fn": torch.nn.ReLU}),
        (PPO, {"net_arch": []}),
        (SAC, SMALL),
        (SAC, {"net_arch": [], "activation_fn": torch.nn.Tanh}),
    ],
)
def test_the_exported_policy_acts_like_the_model_over_whole_episodes(algorithm, arguments, tmp_path):
    env = PlayerVecEnv("random-energy-switching", 2, seed=4)
    rewards_normalised = VecNormalize(env, norm_obs=False)
    model = algorithm("MlpPolicy", rewards_normalised, seed=1, device="cpu", policy_kwargs={**arguments})
    with torch.no_grad():  # large weights, so that actions are clipped too
        for name, parameter in model.policy.named_parameters():
            parameter.mul_(200.0 if "action_net" in name or "mu" in name else 1.0)
    path = tmp_path / "policy.npz"
    path.write_bytes(export(model, env.layout))
    policy, observations, clipped = learn.load(path, env.layout), env.reset(), 0
    for _ in range(401 if SOAK else 30):
        expected, _ = model.predict(observations, deterministic=True)
        actions, _ = policy.predict(observations)
        np.testing.assert_allclose(actions, expected, rtol=0, atol=1e-5)
        clipped += int((np.abs(actions) == env.layout.action_bound).sum())
        observations, _, _, _ = env.step(actions)
    assert clipped


@pytest.mark.parametrize(
    ("algorithm", "arguments", "kind", "is_normalised"),
    [
        (PPO, {"policy_kwargs": SMALL | {"activation_fn": torch.nn.ELU}}, "scaled", False),
        (PPO, {"policy_kwargs": SMALL | {"squash_output": True}, "use_sde": True}, "scaled", False),
        (PPO, {"policy_kwargs": SMALL}, "physical", False),
        (PPO, {"policy_kwargs": SMALL}, "scaled", True),
        (SAC, {"policy_kwargs": {**SMALL}, "buffer_size": 1, "use_sde": True}, "scaled", False),
        (TD3, {"policy_kwargs": {**SMALL}, "buffer_size": 1}, "scaled", False),
    ],
)
def test_a_model_that_no_file_can_play_is_not_exported(algorithm, arguments, kind, is_normalised):
    env = PlayerVecEnv(SCENARIO, 1, interface=kind)
    model = algorithm("MlpPolicy", VecNormalize(env) if is_normalised else env, device="cpu", **arguments)
    way = "the model itself" + ", or its .zip" * (not is_normalised)
    with pytest.raises(
        ValueError, match=rf"no file can play this (PPO|SAC|TD3) \(a file holds an MlpPolicy .*evaluate takes {way}$"
    ):
        export(model, env.layout)


def test_a_file_that_decides_differently_from_its_model_is_not_exported(monkeypatch):
    env = PlayerVecEnv(SCENARIO, 1)
    model = PPO("MlpPolicy", env, policy_kwargs=SMALL, device="cpu")
    predict = model.predict
    monkeypatch.setattr(model, "predict", lambda *given, **named: (predict(*given, **named)[0] + 0.001, None))
    with pytest.raises(ValueError, match=r"(?s)no file can play this PPO .*Max absolute difference"):
        export(model, env.layout)
    with torch.no_grad():
        model.policy.action_net.bias.fill_(float("nan"))
    with pytest.raises(ValueError, match=r"no file can play this PPO .*not finite"):
        export(model, env.layout)


def test_the_picture_shows_every_run(run, tmp_path):
    _, out, _, _ = run
    steps, digits = read_learning_curve(out)
    assert list(steps) == [70 * done for done in range(1, 11)]
    assert np.isfinite(digits).all()
    laws = evaluate_laws(SCENARIO, 2)
    assert list(leaders(laws).values()) == ["the paper's law", "the best law"]
    without_curve = tmp_path / "removed"
    draw(
        {"one": out, "two": out, "three": without_curve}, tmp_path / "curve.png", title="Training", steps=10, laws=laws
    )
    picture = image.imread(tmp_path / "curve.png")
    assert picture.shape[:2] == (600, 960)
    colours = set(map(tuple, (255 * picture[..., :3]).astype(int).reshape(-1, 3)))
    assert (213, 94, 0) in colours  # of the second run, which covers the first
    (tmp_path / "evaluations.npz").write_bytes(b"PK")
    with pytest.raises(ValueError, match=r"evaluations\.npz is no learning curve"):
        read_learning_curve(tmp_path)
