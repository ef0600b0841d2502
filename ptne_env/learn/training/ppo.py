"""PPO of Stable-Baselines3 on a scenario, with a network that all players share.

Run it with ``ptne train random-energy-switching --out DIR`` or ``python baselines/train.py``. ``DIR`` then holds
``policy.onnx`` (load it with :func:`ptne_env.learn.load`), ``summary.json``, TensorBoard logs, and, while it runs,
``checkpoint.npz``; the same command resumes an interrupted run from it, and ends as if it had not been interrupted.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import LinearSchedule
from torch import nn

from ptne_env import learn as policies
from ptne_env.bench import find_scenario
from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.evaluation import PolicySpec, episode_seed, evaluate
from ptne_env.learn.training import checkpoint
from ptne_env.learn.training.arguments import Arguments
from ptne_env.learn.training.checkpoint import CHECKPOINT, Record, Summary, finish, finished, plain, require_same
from ptne_env.learn.training.export import to_onnx
from ptne_env.learn.training.features import Products
from ptne_env.perception.observation import ObservationLayout

Progress = Callable[[int, int, float], None]
"""Called with agent-steps done, agent-steps in all, and the digits that players gain per episode, exploration included:
the mean over the rollouts of the last episode length, or over those since the start of the process."""


def train(arguments: Arguments, out: Path, progress: Progress | None = None) -> Summary:
    """Train, validate and export; resume where an interrupted run with the same arguments stopped.

    A resumed run ends with the same policy as an undisturbed one, bit for bit. A finished run is not repeated.
    The global generators of Python, NumPy and PyTorch are seeded.

    Args:
        arguments: of the run.
        out: folder for all files of the run; made if missing.
        progress: called after every rollout.

    Returns:
        The summary, also in ``out/summary.json``.

    Raises:
        ValueError: for arguments that do not fit each other or name an unknown scenario, and when ``out`` holds a run
            with other arguments, or a damaged one; no file is written then.
    """
    began = monotonic()
    path = out / CHECKPOINT
    done = finished(arguments, out)
    if done is not None:
        path.unlink(missing_ok=True)  # of an interruption after the end
        return done
    torch.set_num_threads(1)  # the networks are small: a second thread costs more time than it saves
    env = make_env(arguments)
    layout = env.get_attr("layout")[0]
    model = PPO("MlpPolicy", env, tensorboard_log=str(out / "tensorboard"), **settings(arguments, layout))
    past = Record(arguments=plain(arguments), agent_steps=0, seconds=0.0, parts=1)
    if path.exists():
        past, arrays = checkpoint.read(path)
        require_same(arguments, past.arguments, out)
        checkpoint.restore(model, arrays)
        past = replace(past, parts=past.parts + 1)
        model.num_timesteps = past.agent_steps

    def record() -> Record:
        seconds = past.seconds + monotonic() - began
        return replace(past, agent_steps=model.num_timesteps, seconds=seconds)

    def save() -> None:
        checkpoint.save(path, model, record())

    remaining = arguments.steps - model.num_timesteps
    if remaining > 0:
        callback = _Segments(arguments, save, progress)
        model.learn(remaining, callback=callback, reset_num_timesteps=False, tb_log_name="ppo")
    save()  # a run that is interrupted during the validation resumes there
    export = partial(to_onnx, model, layout, scenarios=arguments.scenarios, seed=arguments.seed)
    digits = _validate(export(digits=0.0), arguments)
    return finish(out, export(digits=digits), record(), digits)


def make_env(arguments: Arguments) -> PlayerVecEnv:
    """The environments that a run trains in.

    Raises:
        ValueError: for an unknown scenario or track, scenarios that no policy can share, or a number of environments
            that they cannot share evenly.
    """
    share, rest = divmod(arguments.envs, len(arguments.scenarios))
    if rest:
        raise ValueError(
            f"{arguments.envs} environments cannot be shared evenly by {len(arguments.scenarios)} scenarios"
        )
    parts = [
        PlayerVecEnv(
            find_scenario(name),
            share,
            interface=arguments.interface,
            max_cycles=None,
        )
        for name in arguments.scenarios
    ]
    if len(parts) > 1:
        raise ValueError("a policy is trained on one scenario")
    return parts[0]


def settings(arguments: Arguments, layout: ObservationLayout) -> dict[str, Any]:
    """The keyword arguments of PPO.

    Raises:
        ValueError: when a minibatch would hold one sample.
    """
    samples = arguments.rollout * arguments.envs * layout.num_players
    if arguments.minibatches >= samples:
        raise ValueError(
            f"minibatches must be fewer than the {samples} samples of a rollout, got {arguments.minibatches}"
        )
    network: dict[str, Any] = {
        "net_arch": list(arguments.hidden),
        "activation_fn": nn.Tanh,
        "log_std_init": arguments.log_std,
        "optimizer_kwargs": {"fused": True},  # one call instead of a dozen per tensor; the networks are small
    }
    if arguments.products:
        network |= {"features_extractor_class": Products, "features_extractor_kwargs": Products.of(layout)}
    return {
        "learning_rate": LinearSchedule(arguments.learning_rate, 0.0, 1.0),
        "n_steps": arguments.rollout,
        "batch_size": -(-samples // arguments.minibatches),
        "n_epochs": arguments.epochs,
        "gamma": arguments.discount,
        "gae_lambda": arguments.trace,
        "clip_range": arguments.clip,
        "policy_kwargs": network,
        "seed": arguments.seed,
        "device": "cpu",
    }


def _validate(exported: bytes, arguments: Arguments) -> float:
    """The mean digits of an exported policy on the validation episodes.

    Raises:
        ValueError: when it fails there, with the reason.
    """
    with TemporaryDirectory() as folder:
        file = Path(folder) / "policy.onnx"
        file.write_bytes(exported)
        policy = policies.load(file)
    results = evaluate(
        [PolicySpec("ppo", policy)],
        [find_scenario(name) for name in arguments.scenarios],
        episodes=arguments.validation_episodes,
        split="validation",
    )
    for (name, _), reason in results.failures.items():
        raise ValueError(f"the trained policy fails on {name!r}: {reason}")
    return float(np.mean([samples["digits"].mean() for samples in results.samples.values()]))


class _Segments(BaseCallback):
    """A run as a chain of segments, and a report of digits after every rollout.

    A segment begins every few rollouts: all generators are seeded by the seed and the agent-steps of the run, the
    environments start new episodes, and a checkpoint is written. So a segment depends on nothing but the network and
    its optimiser, and a run that is resumed at a checkpoint continues as an undisturbed one.

    Args:
        arguments: of the run.
        save: writes a checkpoint.
        progress: see :func:`train`.
    """

    def __init__(self, arguments: Arguments, save: Callable[[], None], progress: Progress | None) -> None:
        super().__init__()
        self._arguments, self._save, self._progress = arguments, save, progress
        self._lengths = np.empty(0)
        self._gained: deque[float] = deque()

    def _on_training_start(self) -> None:
        """Members of different scenarios have episodes of different lengths."""
        scenarios = self.training_env.get_attr("scenario")
        self._lengths = np.array([scenario.steps + scenario.hold_steps for scenario in scenarios])
        self._gained = deque(maxlen=-(-int(self._lengths.max()) // self._arguments.rollout))

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        env, done = self.training_env, self.model.num_timesteps
        if done % (self._arguments.checkpoint_rollouts * self._arguments.rollout * env.num_envs) == 0:
            number = episode_seed(self._arguments.seed, done, split="train")
            self.model.set_random_seed(int(np.random.SeedSequence(number).generate_state(1)[0]))  # takes 32 bits
            env.seed(number)
            self.model._last_obs = env.reset()  # type: ignore[assignment] # noqa: SLF001 - ``learn`` keeps them there
            self.model._last_episode_starts = np.ones(env.num_envs, dtype=bool)  # noqa: SLF001
            self._save()

    def _on_rollout_end(self) -> None:
        rewards: np.ndarray = self.locals["rollout_buffer"].rewards  # of every step and member
        self._gained.append(float((rewards.mean(axis=0) * self._lengths).mean()))
        digits = float(np.mean(self._gained))
        self.logger.record("rollout/digits_gained", digits)
        if self._progress is not None:
            self._progress(self.num_timesteps, self._arguments.steps, digits)
