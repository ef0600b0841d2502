"""PPO of Stable-Baselines3 on a scenario, with a network that all players share.

Run it with ``ptne train random-energy --algorithm sb3-ppo --out DIR``. ``DIR`` then holds ``policy.onnx`` (load it with
:func:`ptne_env.learn.load`), ``summary.json``, ``configuration.json``, the evaluations of the learning curve
(``evaluations.npz``), and models of Stable-Baselines3 in ``checkpoints``. The same command resumes an interrupted run
from the last of them. An uninterrupted run ends with the same policy on the same machine; a resumed one draws other
games and other noise from there on, so it ends with another policy.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import onnx
import stable_baselines3
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback, CheckpointCallback, EvalCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.utils import LinearSchedule
from torch import nn

from ptne_env._version import __version__
from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.learn.onnx_policy import Metadata, open_policy, seal
from ptne_env.learn.sb3_archive import as_trained
from ptne_env.perception.observation import ObservationLayout
from ptne_env.shared.files import require_file, write_atomically
from ptne_env.suites import find_scenario
from ptne_env.training.configuration import Configuration, RunSummary, read_finished_run, write_record
from ptne_env.training.curve import validate

if TYPE_CHECKING:
    from gymnasium import spaces
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.running_mean_std import RunningMeanStd

POLICY = "policy.onnx"
"""The name of the file of the policy."""

CURVE = "digits_gained"
"""The metric of the learning curve."""

Progress = Callable[[int, int, float], None]
"""A function of the agent-steps done, their total, and the mean digits gained in the last evaluation (-inf before)."""

EVALUATIONS = 10
"""The number of evaluations, and of checkpoints, in a run."""

GAMES = 20
"""The games of an evaluation."""


def train(configuration: Configuration, out: Path, progress: Progress | None = None) -> RunSummary:
    """Train, validate and export, and return the summary; resume an interrupted run. A finished one is not repeated.

    The global generators of Python, NumPy and PyTorch are seeded.

    Args:
        configuration: the definition of the run.
        out: the folder for all files of the run; made if missing.
        progress: a function to call after every rollout.

    Raises:
        ValueError: for values that do not fit each other, for an unknown scenario, when ``out`` holds a run with
            another configuration or a damaged one, and when the trained policy fails on a validation episode.
    """
    if (ended := read_finished_run(configuration, out, POLICY)) is not None:
        return ended
    began = monotonic()
    torch.set_num_threads(1)  # the networks are small: a second thread costs more time than it saves
    scenario = find_scenario(configuration.scenario)
    env = PlayerVecEnv(scenario, configuration.envs)
    model = PPO("MlpPolicy", env, **_ppo_arguments(configuration, env.num_envs))
    checkpoints = out / "checkpoints"
    model.num_timesteps = resumed_at = _restore(model, checkpoints)
    write_record(out / "configuration.json", configuration)
    rollouts = -(-configuration.steps // (configuration.rollout * env.num_envs))  # the last one is a whole one
    calls = -(-rollouts * configuration.rollout // EVALUATIONS)  # steps of all environments together
    evaluation = EvalCallback(
        PlayerVecEnv(scenario, GAMES, seed=1_000_000),
        n_eval_episodes=GAMES * env.layout.num_players,
        eval_freq=calls,
        log_path=str(out),
        verbose=0,
    )
    callbacks = [CheckpointCallback(calls, str(checkpoints)), evaluation, _Report(configuration, evaluation, progress)]
    if configuration.steps > resumed_at:
        model.learn(configuration.steps - resumed_at, callback=callbacks, reset_num_timesteps=False)

    exported = to_onnx(model, env.layout, **asdict(configuration))
    digits = validate(open_policy(Path(POLICY), exported), scenario)
    write_atomically(out / POLICY, exported)
    summary = RunSummary(model.num_timesteps, resumed_at, monotonic() - began, digits)
    write_record(out / "summary.json", summary)
    return summary


def _ppo_arguments(configuration: Configuration, members: int) -> dict[str, Any]:
    """Return the keyword arguments of PPO for a ``VecEnv`` of ``members`` environments."""
    samples = configuration.rollout * members
    if configuration.minibatches >= samples:
        raise ValueError(
            f"minibatches must be fewer than the {samples} samples of a rollout, got {configuration.minibatches}"
        )
    return {
        "learning_rate": LinearSchedule(configuration.learning_rate, 0.0, 1.0),
        "n_steps": configuration.rollout,
        "batch_size": -(-samples // configuration.minibatches),
        "n_epochs": configuration.epochs,
        "gamma": configuration.discount,
        "gae_lambda": 0.9,
        "policy_kwargs": {"net_arch": list(configuration.hidden), "log_std_init": configuration.log_std},
        "seed": configuration.seed,
        "device": "cpu",
    }


def _restore(model: PPO, checkpoints: Path) -> int:
    """Load the last whole checkpoint, and return its agent-steps; 0 without one.

    A run that was killed may leave a part of a checkpoint. Only arrays are read, which execute no code.
    """
    done = {int(path.stem.split("_")[2]): path for path in checkpoints.glob("rl_model_*_steps.zip")}
    for steps in sorted(done, reverse=True):
        with suppress(Exception):  # zip files and torch raise many classes
            require_file(done[steps])
            model.set_parameters(str(done[steps]), device="cpu")
            return steps
    return 0


class _Report(BaseCallback):
    """A callback that reports the progress after every rollout."""

    def __init__(self, configuration: Configuration, evaluation: EvalCallback, progress: Progress | None) -> None:
        super().__init__()
        self._steps, self._evaluation, self._progress = configuration.steps, evaluation, progress

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        if self._progress is not None:
            self._progress(self.num_timesteps, self._steps, self._evaluation.last_mean_reward)


def to_onnx(model: BaseAlgorithm, layout: ObservationLayout, **training: Any) -> bytes:
    """Export the deterministic actions of a model: the content of a file that :func:`ptne_env.learn.load` reads.

    Args:
        model: of any algorithm with an ``MlpPolicy``; the statistics of its ``VecNormalize`` become part of the file.
        layout: the layout of the environments in which it was trained.
        **training: how it was trained, for the metadata.

    Raises:
        ValueError: when the policy cannot be exported, or its file is refused or decides differently from the model.
    """
    content = io.BytesIO()
    training |= {"ptne_env": __version__}
    training |= {library.__name__: library.__version__ for library in (stable_baselines3, torch, np)}
    rows = np.random.default_rng(0).standard_normal((100, layout.size)).astype(np.float32)
    try:
        expected, _ = as_trained(model).predict(rows, deterministic=True)
        with warnings.catch_warnings():
            # The other exporter of torch needs a further package and takes half a minute.
            warnings.simplefilter("ignore", DeprecationWarning)
            torch.onnx.export(
                _Actor(model).eval(),
                (torch.zeros(2, layout.size),),
                content,  # type: ignore[arg-type]  # this exporter takes open files
                input_names=["observation"],
                output_names=["action"],
                dynamic_axes={"observation": {0: "rows"}, "action": {0: "rows"}},
                dynamo=False,
            )
        exported = seal(onnx.load_from_string(content.getvalue()), Metadata.of(layout, training))
        actions, _ = open_policy(Path(POLICY), exported).predict(rows)
        tolerance = 1e-4 * max(1.0, float(np.abs(expected).max()))
        np.testing.assert_allclose(actions, expected, rtol=1e-4, atol=tolerance, equal_nan=False)
    except Exception as error:  # of torch, onnx and the policy
        raise ValueError(
            f"no file can play this {type(model).__name__} ({error}); evaluate takes the model itself, or its .zip"
        ) from error
    return exported


class _Actor(nn.Module):
    """The deterministic actions of a model, scaled or clipped to the action box, as its ``predict`` returns them."""

    def __init__(self, model: BaseAlgorithm) -> None:
        super().__init__()
        self.policy, self.normaliser = model.policy, model.get_vec_normalize_env()
        if self.normaliser is not None and self.normaliser.norm_obs:
            seen = cast("RunningMeanStd", self.normaliser.obs_rms)
            self.mean = torch.Tensor(seen.mean)
            self.deviation = torch.Tensor(np.sqrt(seen.var + self.normaliser.epsilon))
        box = cast("spaces.Box", model.action_space)
        self.low, self.high = torch.as_tensor(box.low), torch.as_tensor(box.high)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        if self.normaliser is not None and self.normaliser.norm_obs:
            limit = self.normaliser.clip_obs
            observations = ((observations - self.mean) / self.deviation).clamp(-limit, limit)
        # The means: torch would export all that a distribution computes beside them.
        policy: Any = self.policy
        if isinstance(policy, ActorCriticPolicy):
            features: Any = policy.extract_features(observations, policy.pi_features_extractor)
            actions = policy.action_net(policy.mlp_extractor.forward_actor(features))
            actions = torch.tanh(actions) if policy.squash_output else actions
        elif hasattr(policy.actor, "get_action_dist_params"):  # as SAC
            actions = torch.tanh(policy.actor.get_action_dist_params(observations)[0])
        else:  # as TD3
            actions = policy.actor(observations)
        if policy.squash_output:
            actions = self.low + 0.5 * (actions + 1) * (self.high - self.low)
        return torch.maximum(torch.minimum(actions, self.high), self.low)
