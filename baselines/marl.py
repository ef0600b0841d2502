"""Train the field's algorithms on tracks of ptne-v1: ``python -m baselines.marl [--tracks ...] [--seeds 3] ...``.

They come from BenchMARL, Stable-Baselines3 and sb3-contrib; algorithms whose library is missing are left out. BenchMARL
pins an older TorchRL, so all of them go into a virtual environment of their own::

    python -m venv .venv-marl
    .venv-marl/bin/pip install torch==2.13.0 -e '.[sb3]' sb3-contrib==2.9.2 benchmarl==1.5.2
    OMP_NUM_THREADS=1 .venv-marl/bin/python -m baselines.marl --jobs 2

A job is an algorithm with a setting on a track with a seed. The folder ``--out`` keeps a file of every finished job and
checkpoints of the others, so the command can be stopped at any time, and goes on when it is given again. (BenchMARL's
checkpoints lack the state of its optimisers, and a resumed job draws other games.)

At the end it writes all finished jobs into ``marl.json``, in the format of marl-eval, and from it the page ``marl.md``
and the picture ``marl.png``. With ``--tables`` it trains nothing: it writes the jobs that are finished by then, and the
page and the picture.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import os
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from statistics import fmean
from typing import Any

import joblib
import numpy as np
from scipy.stats import trim_mean

from baselines import published
from ptne_env import PolicySpec, VectorParallelEnv
from ptne_env.evaluation.comparison import compare
from ptne_env.shared.files import write_atomically
from ptne_env.shared.style import COLOURS, FAINT, INK, drawing
from ptne_env.suites import get_suite

HOME = Path(__file__).parent
DATA, PAGE, PICTURE = HOME / "marl.json", HOME / "marl.md", HOME / "marl.png"
SUITE = get_suite("ptne-v1")
TRACKS = ("switching-physical", "switching-transformed", "rough-links", "rounding")

LIBRARIES = {
    **dict.fromkeys(("ippo", "mappo", "iddpg", "maddpg", "isac", "masac"), "benchmarl"),
    "ppo": "stable_baselines3",
    "sac": "stable_baselines3",
    "recurrent-ppo": "sb3_contrib",
}
"""The algorithms, and the module that has each."""

PACKAGES = {"benchmarl": "benchmarl", "stable_baselines3": "stable-baselines3", "sb3_contrib": "sb3-contrib"}
OFF_POLICY = ("iddpg", "maddpg", "isac", "masac", "sac")
DETERMINISTIC = ("iddpg", "maddpg")

ENVS, ROLLOUT, UNIT = 32, 64, 30_720
"""Environments stepped together and their steps in a rollout, of tuned settings. Agent-steps are multiples of a unit,
which holds whole rollouts of every setting."""

PLAYERS = 5
"""Of every track that may be chosen."""

DEFAULT = -1
"""The trial that is no trial: the library's defaults."""

FIRST: Mapping[str, float] = {
    "learning_rate": 1e-3, "discount": 0.9, "hidden": 64, "trace": 0.9, "epochs": 5, "minibatches": 8, "spread": 0.4,
    "updates": 16, "batch": 256, "entropy": 1e-3, "reward": 1.0,
}  # fmt: skip
"""Trial 0: the settings of :mod:`ptne_env.training.defaults`, as far as the libraries share them."""

CHOICES: Mapping[str, tuple[float, ...]] = {
    "learning_rate": (1e-4, 3e-4, 1e-3, 3e-3),
    "discount": (0.8, 0.9, 0.95, 0.99),  # of rewards
    "hidden": (64, 128, 256),  # units in each of two layers
    "trace": (0.8, 0.9, 0.95),  # λ of the generalised advantage estimate
    "epochs": (3, 5, 10),  # passes over a rollout
    "minibatches": (8, 16, 32),  # of a rollout
    "spread": (0.1, 0.2, 0.4, 0.8),  # standard deviation of the first actions
    "updates": (8, 16, 32),  # of algorithms with a buffer, per 8 steps of all environments
    "batch": (128, 256, 512),  # agent-steps in an update from a buffer
    "entropy": (1e-4, 1e-3, 1e-2),  # its first weight
    "reward": (1.0, 10.0, 100.0),  # of a digit; that of a step is of order 0.01
}
"""What a further trial draws from, the same for every algorithm; each uses the entries that it knows."""

SLOWER = 0.1
"""The learning rate of a deterministic actor, times that of its critic, as in the paper of DDPG."""

ENOUGH_TRIALS, FLAT = 20, 0.1
"""With fewer trials, or when the last fifth of its curve gains more digits, a result is unfinished."""

CLOSE = 0.1
"""A trial with so many fewer digits than the best is as good: its one run and few games tell no more."""

FAILED = -10.0
"""Digits of a trial that failed, fewer than any that can be played."""

TUNING_SEED = 1000
"""Seed of the trials, none of which is in the table."""

VALIDATION_GAMES = 20

LOWEST = -0.5
"""Digits below which the picture shows nothing."""

Report = Callable[[int, Any], None]
"""Called with the agent-steps done and the policy as it is then."""


@dataclass(frozen=True)
class Job:
    """A training.

    Attributes:
        algorithm: of :data:`LIBRARIES`.
        trial: number of its setting, or :data:`DEFAULT`.
        track: of ptne-v1.
        seed: of networks, games and exploration.
        steps: agent-steps.
    """

    algorithm: str
    trial: int
    track: str
    seed: int
    steps: int

    @property
    def name(self) -> str:
        """Where its files lie in the folder."""
        setting = "default" if self.trial == DEFAULT else f"trial-{self.trial}"
        return f"{self.algorithm}/{setting}/{self.track}/{self.steps}-{self.seed}"

    @property
    def setting(self) -> dict[str, Any]:
        """The drawn values."""
        if self.trial <= 0:
            return dict(FIRST)
        generator = np.random.default_rng(self.trial)
        return {name: values[generator.integers(len(values))] for name, values in CHOICES.items()}

    @property
    def every(self) -> int:
        """Agent-steps between points of its curve."""
        return UNIT * max(1, self.steps // (20 * UNIT))

    def is_due(self, done: int) -> bool:
        """Whether the curve has a point here."""
        return done % self.every == 0 or done >= self.steps


def digits(track: str, policy: Any, split: str) -> list[float]:
    """The digits of a policy on games of a split: of the suite's own number of games, or of some for the curve."""
    games = SUITE.episode_set(track, VALIDATION_GAMES if split == "validation" else None, split=split)
    results = compare(SUITE.name, [SUITE.track(track)], [PolicySpec("trained", policy)], {track: games})
    for reason in results.failures.values():
        raise RuntimeError(reason)
    return [round(value, 4) for value in results.samples[track, "trained"]["digits"][0].tolist()]


def reward_of(job: Job) -> dict[str, float]:
    """The reward of the environment: digits gained, times a number."""
    return {"digits": 1.0 if job.trial == DEFAULT else job.setting["reward"]}


def train_benchmarl(job: Job, folder: Path, report: Report) -> None:
    """Train one of BenchMARL's algorithms, from its last checkpoint on."""
    os.environ["TQDM_DISABLE"] = "1"
    import torch
    from benchmarl import algorithms
    from benchmarl.experiment import Callback, Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig

    from ptne_env.envs.benchmarl import NashSeekingTask, make_policy

    class Reporter(Callback):
        def on_train_end(self, training_td: Any, group: str) -> None:  # noqa: ARG002 - BenchMARL's signature
            if job.is_due(self.experiment.total_frames * PLAYERS):
                report(self.experiment.total_frames * PLAYERS, make_policy(self.experiment))

    logging.getLogger("torchrl").setLevel(logging.WARNING)
    scenario = SUITE.track(job.track).scenario
    config, model = ExperimentConfig.get_from_yaml(), MlpConfig.get_from_yaml()
    algorithm = getattr(algorithms, f"{job.algorithm.capitalize()}Config").get_from_yaml()
    kind = "off_policy" if job.algorithm in OFF_POLICY else "on_policy"
    changes: dict[str, Any] = {f"{kind}_collected_frames_per_batch": UNIT // PLAYERS}  # 6144, and 6000 by default
    if job.trial != DEFAULT:
        s = job.setting
        model.num_cells = [s["hidden"]] * 2
        changes = {"lr": s["learning_rate"], "gamma": s["discount"], f"{kind}_n_envs_per_worker": ENVS}
        changes |= {
            "on_policy_collected_frames_per_batch": ENVS * ROLLOUT,
            "on_policy_n_minibatch_iters": s["epochs"],
            "on_policy_minibatch_size": ENVS * ROLLOUT // s["minibatches"],
            "off_policy_collected_frames_per_batch": ENVS * 8,
            "off_policy_init_random_frames": ENVS * ROLLOUT,
            "off_policy_n_optimizer_steps": s["updates"],
            "off_policy_train_batch_size": s["batch"] // PLAYERS,
            "exploration_eps_init": s["spread"],
        }
        own = {"lmbda": s["trace"], "scale_mapping": f"biased_softplus_{s['spread']}", "alpha_init": s["entropy"]}
        for name in own.keys() & vars(algorithm).keys():
            setattr(algorithm, name, own[name])
        if job.algorithm in DETERMINISTIC:  # else the actions go to their bounds for good, as the page tells
            model.activation_class = torch.nn.ReLU
            algorithm.share_param_critic = job.algorithm == "iddpg"  # else all players of maddpg have the same value
            changes["exploration_eps_end"] = s["spread"]
    frames = job.steps // PLAYERS
    changes |= {"max_n_frames": frames, "off_policy_memory_size": frames, "evaluation": False, "loggers": []}
    changes |= {"create_json": False, "save_folder": str(folder), "keep_checkpoints_num": 1}
    changes |= {"checkpoint_interval": job.every // PLAYERS}
    checkpoints = sorted(folder.glob("*/checkpoints/*.pt"), key=lambda path: path.stat().st_mtime)
    if checkpoints:
        changes["restore_file"] = str(checkpoints[-1])
    for name, value in changes.items():
        setattr(config, name, value)
    task = NashSeekingTask(job.track, {"scenario": scenario, "reward": reward_of(job)})
    experiment, reporter = Experiment(task, algorithm, model, seed=1000 * job.seed, config=config), Reporter()
    reporter.experiment = experiment
    if job.trial != DEFAULT and job.algorithm in DETERMINISTIC:
        for optimizers in experiment.optimizers.values():
            optimizers["loss_actor"].param_groups[0]["lr"] *= SLOWER
    experiment.callbacks.append(reporter)  # an argument would be pickled, which a class in a function cannot be
    experiment.run()


def train_stable_baselines(job: Job, folder: Path, report: Report) -> None:
    """Train an algorithm of Stable-Baselines3 or sb3-contrib, from its last checkpoint on."""
    import torch

    from ptne_env.envs.sb3 import PlayerVecEnv

    torch.set_num_threads(1)
    s = job.setting
    name = {"ppo": "PPO", "sac": "SAC", "recurrent-ppo": "RecurrentPPO"}[job.algorithm]
    algorithm = getattr(import_module(LIBRARIES[job.algorithm]), name)
    is_default, is_recurrent = job.trial == DEFAULT, job.algorithm == "recurrent-ppo"
    # A default rollout of PPO is 2048 steps of 5 members, one of RecurrentPPO 128 steps of 80.
    envs = {"ppo": 1, "sac": 16, "recurrent-ppo": 16}[job.algorithm] if is_default else ENVS
    env = PlayerVecEnv(SUITE.track(job.track).scenario, envs, seed=1000 * job.seed, reward=reward_of(job))
    arguments: dict[str, Any] = {"buffer_size": job.steps} if job.algorithm in OFF_POLICY else {}
    if not is_default:
        arguments |= {"learning_rate": s["learning_rate"], "gamma": s["discount"]}
        layers = {"net_arch": [s["hidden"]] * 2}
        if job.algorithm in OFF_POLICY:
            arguments |= {"batch_size": s["batch"], "train_freq": (8, "step"), "gradient_steps": s["updates"]}
            arguments |= {"learning_starts": env.num_envs * ROLLOUT, "ent_coef": f"auto_{s['entropy']}"}
        else:
            arguments |= {"n_steps": ROLLOUT, "batch_size": env.num_envs * ROLLOUT // s["minibatches"]}
            arguments |= {"n_epochs": s["epochs"], "gae_lambda": s["trace"]}
            layers |= {"log_std_init": math.log(s["spread"])}
            layers |= {"lstm_hidden_size": s["hidden"]} if is_recurrent else {}
        arguments["policy_kwargs"] = layers
    checkpoint, buffer = folder / "model.zip", folder / "buffer.pkl"
    if checkpoint.exists():
        model = algorithm.load(checkpoint, env=env, device="cpu")
        if buffer.exists():
            model.load_replay_buffer(buffer)
    else:
        kind = "MlpLstmPolicy" if is_recurrent else "MlpPolicy"
        model = algorithm(kind, env, seed=job.seed, device="cpu", **arguments)
    while model.num_timesteps < job.steps:
        model.learn(min(job.every, job.steps - model.num_timesteps), reset_num_timesteps=False)
        report(model.num_timesteps, model)
        if job.algorithm in OFF_POLICY:
            model.save_replay_buffer(buffer)
        model.save(checkpoint)


def run(job: Job, out: Path) -> str:
    """Run a job that is not finished, and write its file; a line about it."""
    file, folder = out / f"{job.name}.json", out / job.name
    if file.exists():
        return f"{job.name}: finished before"
    folder.mkdir(parents=True, exist_ok=True)
    progress = folder / "progress.json"
    kept = json.loads(progress.read_text()) if progress.exists() else {"points": [], "seconds": 0.0, "cpu": 0.0}
    began = [time.monotonic(), time.process_time()]

    def report(done: int, policy: Any) -> None:
        now = [time.monotonic(), time.process_time()]
        point = {"step_count": done, "digits": digits(job.track, policy, "validation")}
        kept["points"] = [each for each in kept["points"] if each["step_count"] < done] + [point]
        kept["seconds"], kept["cpu"] = kept["seconds"] + now[0] - began[0], kept["cpu"] + now[1] - began[1]
        if done >= job.steps and job.seed != TUNING_SEED:
            kept["test"] = digits(job.track, policy, "test")
        write_atomically(progress, json.dumps(kept))
        began[:] = [time.monotonic(), time.process_time()]

    train = train_benchmarl if LIBRARIES[job.algorithm] == "benchmarl" else train_stable_baselines
    try:
        train(job, folder, report)
    except Exception as error:  # noqa: BLE001 - of any library; the other jobs go on
        if job.seed == TUNING_SEED:  # such as weights that are no longer finite: it counts as tried
            points = [{"step_count": job.steps, "digits": [FAILED]}]
            write_atomically(file, json.dumps({**asdict(job), "points": points, "failed": repr(error)}))
        return f"{job.name}: failed: {error!r}"
    package = PACKAGES[LIBRARIES[job.algorithm]]
    made_by = {name: version(name) for name in ("ptne-env", "torch", package)}
    write_atomically(file, json.dumps({**asdict(job), **kept, "versions": made_by}))
    shutil.rmtree(folder)
    end = np.mean(kept["points"][-1]["digits"])
    return f"{job.name}: {end:.2f} digits in {kept['seconds']:.0f} s ({kept['cpu']:.0f} s of CPU)"


def finished(out: Path) -> dict[Job, dict[str, Any]]:
    """The files of all finished jobs."""
    fields = Job.__dataclass_fields__
    files = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(out.glob("*/*/*/*.json"))]
    return {Job(**{name: file[name] for name in fields}): file for file in files}


def ranking(
    algorithm: str, found: Mapping[Job, dict[str, Any]], tuning: Mapping[str, Any]
) -> list[dict[int, tuple[float, float]]]:
    """Of an algorithm's trials the digits and the processor time: after the short run, and of finalists after the long.

    They are means over the tracks, the most digits first. Trials count that have all tracks.
    """
    stages: list[dict[int, tuple[float, float]]] = []
    for steps in tuning["steps"]:
        ends: dict[int, dict[str, tuple[float, float]]] = {}
        for job, file in found.items():
            for point in file["points"]:
                if (job.algorithm, job.seed, point["step_count"]) == (algorithm, TUNING_SEED, steps):
                    end = round(float(np.mean(point["digits"])), 4), round(file.get("cpu", 0.0), 1)
                    ends.setdefault(job.trial, {})[job.track] = end
        whole = {trial: [*each.values()] for trial, each in ends.items() if each.keys() == set(tuning["tracks"])}
        means = {trial: (fmean(d for d, _ in each), fmean(s for _, s in each)) for trial, each in whole.items()}
        allowed = [*stages[0]][: tuning["finalists"]] if stages else means
        stages.append({trial: means[trial] for trial in sorted(means, key=lambda t: -means[t][0]) if trial in allowed})
    return stages


def chosen(finalists: Mapping[int, tuple[float, float]]) -> int:
    """Of the finalists that are as good as the best, the one that took the least processor time; else trial 0."""
    equals = [trial for trial, (digits, _) in finalists.items() if digits > next(iter(finalists.values()))[0] - CLOSE]
    return min(equals, key=lambda trial: finalists[trial][1], default=0)


def collect(found: Mapping[Job, dict[str, Any]], steps: int, tuning: Mapping[str, Any]) -> dict[str, Any]:
    """What ``marl.json`` holds.

    ``runs`` has the format of marl-eval: environment, task, algorithm, seed, points of the curve, digits of each game;
    ``absolute_metrics`` are those of the test games. ``tuning`` tells how the trials were made. ``costs`` has of each
    algorithm the digits of its trials after the short run, of the finalists the digits and processor seconds of the
    long one, the setting chosen, and the seconds of its trainings, by the clock and of the processor.
    """

    def order(job: Job) -> tuple[Any, ...]:
        return job.trial == DEFAULT, [*LIBRARIES].index(job.algorithm), job.track, job.seed

    ranked = {algorithm: ranking(algorithm, found, tuning) for algorithm in LIBRARIES}
    tasks: dict[str, Any] = {}
    costs: dict[str, Any] = {}
    for job, file in sorted(found.items(), key=lambda item: order(item[0])):
        short, long = ranked[job.algorithm]
        if job.steps != steps or job.seed == TUNING_SEED or job.trial not in (DEFAULT, chosen(long)):
            continue
        is_default = job.trial == DEFAULT
        name = job.algorithm + "-default" * is_default
        points = {f"step_{number}": point for number, point in enumerate(file["points"])}
        runs = tasks.setdefault(job.track, {}).setdefault(name, {})
        runs[f"seed_{job.seed}"] = {**points, "absolute_metrics": {"digits": file["test"]}}
        digits = {trial: each for trial, (each, _) in short.items()}
        tried = {} if is_default else {"trials": digits, "finalists": long, "trial": job.trial, "setting": job.setting}
        cost = costs.setdefault(name, {**tried, "seconds": [], "cpu_seconds": []})
        cost["seconds"].append(round(file["seconds"]))
        cost["cpu_seconds"].append(round(file["cpu"]))
    return {"runs": {SUITE.name: tasks}, "tuning": tuning, "costs": costs}


def interquartile(samples: np.ndarray) -> tuple[float, float, float]:
    """The interquartile mean of samples (seeds, games), and its 95 % interval by a bootstrap over seeds and games."""
    generator = np.random.default_rng(0)
    seeds, games = samples.shape
    drawn = [
        trim_mean(
            samples[np.ix_(generator.integers(seeds, size=seeds), generator.integers(games, size=games))], 0.25, None
        )
        for _ in range(1000)
    ]
    low, high = np.quantile(drawn, [0.025, 0.975])
    return float(trim_mean(samples, 0.25, None)), float(low), float(high)


def curve(runs: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Agent-steps, and the interquartile mean of the digits over seeds and games there."""
    steps = [[each["step_count"] for name, each in run.items() if name != "absolute_metrics"] for run in runs.values()]
    values = [[each["digits"] for name, each in run.items() if name != "absolute_metrics"] for run in runs.values()]
    return np.array(steps[0]), np.array([trim_mean(point, 0.25, None) for point in np.array(values).swapaxes(0, 1)])


def last_fifth(runs: Mapping[str, Any]) -> float:
    """The digits that the last fifth of the curve gains."""
    steps, values = curve(runs)
    return float(values[-1] - np.interp(0.8 * steps[-1], steps, values))


def lines(track: str) -> dict[str, float]:
    """The published digits of the paper's law and of the best law on a track."""
    numbers = published.read()
    static, (best, row) = numbers.cell(SUITE.name, track, "static"), published.best_law(numbers, SUITE.name, track)
    return {"static": float(static["mean"]), best: float(row["mean"])}


def page(data: Mapping[str, Any]) -> str:
    """The text of the page."""
    tasks, rows = data["runs"][SUITE.name], []
    for name, cost in data["costs"].items():
        found = {track: algorithms[name] for track, algorithms in tasks.items() if name in algorithms}
        cells = []
        for track in tasks:
            if track not in found:
                cells.append("–")
                continue
            mean, low, high = interquartile(np.array([r["absolute_metrics"]["digits"] for r in found[track].values()]))
            gain = last_fifth(found[track])
            cells.append(f"{mean:.2f} [{low:.2f}, {high:.2f}]" + f", rising {gain:.2f}" * (gain > FLAT))
        trials = len(cost.get("trials", ()))
        is_done = trials >= ENOUGH_TRIALS and not any("rising" in cell for cell in cells)
        seeds = sorted({len(each) for each in found.values()})
        seconds, cpu = (round(float(np.mean(cost[key]))) for key in ("seconds", "cpu_seconds"))
        tried = f"{trials} ({cost['trial']})" if trials else "–"
        counts = ["–".join(map(str, dict.fromkeys((seeds[0], seeds[-1])))), tried, f"{seconds} ({cpu})"]
        rows.append([name, *cells, *counts, "" if is_done else "unfinished"])
    for label, index in (("the paper's law (static)", 0), ("best law", 1)):
        laws = [[*lines(track).items()][index] for track in tasks]
        cells = [f"{value:.2f}" + f" ({name})" * index for name, value in laws]
        rows.append([label, *cells, "", "", "", ""])
    steps = next(curve(runs)[0][-1] for algorithms in tasks.values() for runs in algorithms.values())
    tuning = data["tuning"]
    marks = {"steps": int(steps), "short": tuning["steps"][0], "long": tuning["steps"][1], "seed": TUNING_SEED}
    marks |= {"tracks": " and ".join(tuning["tracks"]), "finalists": tuning["finalists"], "games": VALIDATION_GAMES}
    headings = ["algorithm", *tasks, "seeds", "trials (chosen)", "seconds (of CPU)", ""]
    table = published.markdown(headings, rows)
    return TEXT.format(table=table, enough=ENOUGH_TRIALS, flat=FLAT, close=CLOSE, lowest=LOWEST, **marks)


TEXT = """# The field's algorithms

Digits of algorithms of [BenchMARL](https://github.com/facebookresearch/BenchMARL) (`ippo` to `masac`),
[Stable-Baselines3](https://github.com/DLR-RM/stable-baselines3) (`ppo`, `sac`) and sb3-contrib (`recurrent-ppo`) on
tracks of ptne-v1, after {steps:,} agent-steps each. `python -m baselines.marl` trains them and writes this page; its
first lines say how to install the libraries. [marl.json](marl.json) holds all runs in the format of
[marl-eval](https://github.com/instadeepai/marl-eval), under `runs`.

{table}

- A number is the interquartile mean over seeds and the 60 test games, with a 95 % interval by a bootstrap over both;
  with one seed the interval is that of the games alone. The laws' are means over the same games.
- `rising x`: the last fifth of the learning curve (on {games} validation games) gained x digits, more than {flat}.
- `trials (chosen)`: how many settings were tried, and the number of the one that the row shows. Each was trained for
  {short:,} agent-steps on {tracks}, with seed {seed}, and the {finalists} with the most digits on {games} validation
  games for {long:,}. Of those within {close} digits of the best of these, the one that took the least processor time
  was chosen, and trained anew on every track. Trial 0 is the setting of [learning.md](../docs/learning.md); marl.json
  has the digits of all trials and the values chosen.
- `unfinished` is every row that has fewer than {enough} trials or is still rising somewhere. It says what these
  algorithms had learned by then, not what they can learn.
- All players share one network and act from their own observations. The critics of `mappo`, `maddpg` and `masac` see
  those of all players in training. Each policy is trained on the track it plays, on other games.
- `maddpg` departs from the library's defaults as the papers of MADDPG and DDPG have it: a critic for each player
  (BenchMARL's one critic gives all players the same value, but each has its own reward), ReLU for tanh, a learning rate
  of the actor that is a tenth of the critic's; and the exploration does not fade. With the defaults (`--algorithms
  maddpg --settings default`) its digits fall below -3, because its actions go to their bounds at once, and stay there:
  its critic holds that the same push is good in all states. With the changes it learns too, but later than the others.
- Seconds are the mean wall time of a training on one core that other work shared, and in brackets its processor time.

![Learning curves](marl.png)

The picture shows nothing below {lowest} digits.
"""


def draw(data: Mapping[str, Any], path: Path) -> None:
    """Draw the learning curves, a panel per track, with the laws as lines."""
    tasks = data["runs"][SUITE.name]
    with drawing("learning curves"):
        from matplotlib.figure import Figure

        figure = Figure(figsize=(8, 2.6 * math.ceil(len(tasks) / 2)), layout="constrained")
        panels = figure.subplots(math.ceil(len(tasks) / 2), 2, squeeze=False).ravel()
        for axes, (track, algorithms) in zip(panels, tasks.items(), strict=False):
            for name, runs in algorithms.items():
                number = [*LIBRARIES].index(name.removesuffix("-default"))
                style = ":" if name.endswith("-default") else "-"
                axes.plot(*curve(runs), style, color=COLOURS[number], label=name)
            laws = zip(("--", "-."), (FAINT, INK), ("the paper's law", "best law"), lines(track).values(), strict=True)
            for style, colour, law, value in laws:
                axes.axhline(value, linestyle=style, color=colour, linewidth=1, label=law)
            axes.set(title=track, ylabel="digits", xlabel="agent-steps", ylim=(LOWEST, None))
            axes.xaxis.set_major_formatter(lambda steps, _: f"{steps / 1000:g}k")
        for axes in panels[len(tasks) :]:
            axes.remove()
        handles = {
            label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
        }
        figure.legend(handles.values(), handles.keys(), loc="outside right center")
        figure.savefig(path, dpi=90, metadata={"Software": None})


def carry_out(jobs: Sequence[Job], out: Path, workers: int) -> None:
    """Run jobs, and tell of each that ends."""
    began = time.monotonic()
    tasks = (joblib.delayed(run)(job, out) for job in jobs)
    for number, line in enumerate(joblib.Parallel(workers, return_as="generator_unordered")(tasks), 1):
        print(f"{number} of {len(jobs)}, {(time.monotonic() - began) / 60:.1f} min: {line}", flush=True)


def write_page() -> dict[str, Any]:
    """Write ``marl.md`` from ``marl.json`` and ``results.csv``, and return the numbers."""
    data: dict[str, Any] = json.loads(DATA.read_text(encoding="utf-8"))
    write_atomically(PAGE, page(data))
    return data


def main() -> None:
    """Tune, train and write."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    installed = [name for name, library in LIBRARIES.items() if find_spec(library)]
    alone = [track for track in SUITE.tracks if track.teammates is None]
    tracks = [track.name for track in alone if VectorParallelEnv(track.scenario).num_players == PLAYERS]
    parser.add_argument("--tracks", nargs="+", default=TRACKS, choices=tracks)
    parser.add_argument("--algorithms", nargs="+", default=installed, choices=installed)
    parser.add_argument("--settings", nargs="+", default=["tuned"], choices=["tuned", "default"])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=3 * UNIT, help=f"agent-steps of a job, a multiple of {UNIT}")
    parser.add_argument("--trials", type=int, default=ENOUGH_TRIALS, help="settings tried; with 0 the first is taken")
    parser.add_argument("--tuning-steps", nargs=2, type=int, default=(UNIT, 3 * UNIT), help="of all, and of the best")
    parser.add_argument("--tuning-tracks", nargs="+", default=TRACKS[:1], choices=tracks)
    parser.add_argument("--finalists", type=int, default=5, help="trials that get the long run")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=HOME.parent / "runs" / "marl")
    parser.add_argument("--tables", action="store_true", help="train nothing")
    given = parser.parse_args()
    if any(steps % UNIT for steps in (given.steps, *given.tuning_steps)):
        parser.error(f"agent-steps must be multiples of {UNIT}")
    tuning = {"steps": given.tuning_steps, "tracks": given.tuning_tracks, "finalists": given.finalists}
    if not given.tables:
        places = [(track, algorithm) for track in given.tracks for algorithm in given.algorithms]
        for stage, tuning_steps in enumerate(given.tuning_steps if "tuned" in given.settings else ()):
            found = finished(given.out)
            tried = {algorithm: ranking(algorithm, found, tuning)[0] for algorithm in given.algorithms}
            trials = [
                Job(algorithm, trial, track, TUNING_SEED, tuning_steps)
                for algorithm, ranked in tried.items()
                for trial in ([*ranked][: given.finalists] if stage else set(range(given.trials)) - ranked.keys())
                for track in given.tuning_tracks
            ]
            carry_out(trials, given.out, given.jobs)
        found = finished(given.out)
        best = {algorithm: chosen(ranking(algorithm, found, tuning)[1]) for algorithm in given.algorithms}
        jobs = [
            Job(algorithm, DEFAULT if setting == "default" else best[algorithm], track, seed, given.steps)
            for seed in range(given.seeds)
            for setting in given.settings
            for track, algorithm in places
        ]
        carry_out(jobs, given.out, given.jobs)
    if found := finished(given.out):
        write_atomically(DATA, json.dumps(collect(found, given.steps, tuning), separators=(",", ":")) + "\n")
    draw(write_page(), PICTURE)


if __name__ == "__main__":
    main()
