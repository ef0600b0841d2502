"""PPO of Stable-Baselines3 on a scenario, with a network that all players share.

An uninterrupted run ends with the same policy on the same machine. A resumed one draws other games and other noise from
its last checkpoint on, so it ends with another policy.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np
import stable_baselines3
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import CheckpointCallback, ConvertCallback, EvalCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.utils import LinearSchedule
from torch import nn

from ptne_env._version import __version__
from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.learn.layers import LAYERS, Metadata, Weights
from ptne_env.learn.npz_policy import open_policy, seal
from ptne_env.learn.sb3_archive import as_trained
from ptne_env.perception.observation import ObservationLayout
from ptne_env.shared.files import require_file
from ptne_env.training.configuration import POLICY, Configuration, RunSummary, read_finished_run, write_record
from ptne_env.training.curve import finish
from ptne_env.world.catalogue import get_scenario
from ptne_env.world.world import World

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

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
    if (ended := read_finished_run(configuration, out)) is not None:
        return ended
    began = monotonic()
    torch.set_num_threads(1)  # the networks are small: a second thread costs more time than it saves
    scenario = get_scenario(configuration.scenario)
    env = PlayerVecEnv(scenario, configuration.environments(World(scenario).game.num_players))
    model = PPO("MlpPolicy", env, **_ppo_arguments(configuration, env.num_envs))
    checkpoints = out / "checkpoints"
    model.num_timesteps = resumed_at = _restore(model, checkpoints)
    write_record(out / "configuration.json", configuration)
    samples = configuration.rollout * env.num_envs
    rollouts = -(-configuration.steps // samples)  # the last one is a whole one
    calls = -(-rollouts * configuration.rollout // EVALUATIONS)  # steps of all environments together
    evaluation = EvalCallback(
        PlayerVecEnv(scenario, GAMES, seed=1_000_000),
        n_eval_episodes=GAMES * env.layout.num_players,
        eval_freq=calls,
        log_path=str(out),
        verbose=0,
    )

    def report(*_: Any) -> bool:
        if progress is not None and (model.num_timesteps - resumed_at) % samples == 0:
            progress(model.num_timesteps, configuration.steps, evaluation.last_mean_reward)
        return True

    callbacks = [CheckpointCallback(calls, str(checkpoints)), evaluation, ConvertCallback(report)]
    if configuration.steps > resumed_at:
        model.learn(configuration.steps - resumed_at, callback=callbacks, reset_num_timesteps=False)

    exported = export(model, env.layout, **asdict(configuration))
    return finish(out, exported, scenario, model.num_timesteps, resumed_at, began)


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


def export(model: BaseAlgorithm, layout: ObservationLayout, **training: Any) -> bytes:
    """Export the deterministic actions of a model: the content of a file that :func:`ptne_env.learn.load` reads.

    Args:
        model: of PPO or A2C with an ``MlpPolicy`` of tanh or ReLU.
        layout: the layout of the environments in which it was trained, of units ``scaled``.
        **training: how it was trained, for the metadata.

    Raises:
        ValueError: when no file holds such a policy, or its file is refused or decides differently from the model.
    """
    training |= {"ptne_env": __version__}
    training |= {library.__name__: library.__version__ for library in (stable_baselines3, torch, np)}
    rows = np.random.default_rng(0).standard_normal((100, layout.size)).astype(np.float32)
    try:
        weights, activation = _read_network(model, layout)
        exported = seal(weights, Metadata(layout.interface, layout.action_dims, layout.slots, training, activation))
        actions, _ = open_policy(Path(POLICY), exported).predict(rows)
        expected, _ = as_trained(model).predict(rows, deterministic=True)
        np.testing.assert_allclose(actions, expected, rtol=1e-4, atol=1e-4, equal_nan=False)
    except (ValueError, AssertionError) as error:
        raise ValueError(
            f"no file can play this {type(model).__name__} ({error}); evaluate takes the model itself"
            + ", or its .zip" * (model.get_vec_normalize_env() is None)
        ) from error
    return exported


def _read_network(model: BaseAlgorithm, layout: ObservationLayout) -> tuple[Weights, str]:
    """Return the weights of the means of a model's actions, as layers, and the activation of these."""
    policy: Any = model.policy
    is_plain = type(policy) is ActorCriticPolicy and not policy.squash_output
    modules = [*policy.mlp_extractor.policy_net, policy.action_net] if is_plain else []
    activations = {type(each) for each in modules} - {nn.Linear}
    is_normalised = getattr(model.get_vec_normalize_env(), "norm_obs", False)
    if not is_plain or activations - {nn.Tanh, nn.ReLU} or is_normalised or not layout.is_scaled:
        raise ValueError(
            "a file holds an MlpPolicy of PPO or A2C, of tanh or ReLU, without squash_output, trained on observations "
            "of the interface 'scaled' without VecNormalize"
        )
    layers = [each for each in modules if isinstance(each, nn.Linear)]
    weights: Weights = {}
    for name, layer in zip([*LAYERS[: len(layers) - 1], "out"], layers, strict=True):
        weights |= {name: layer.weight.detach().numpy(), f"{name}_bias": layer.bias.detach().numpy()[:, None]}
    return weights, "tanh" if nn.Tanh in activations else "relu"
