"""PPO and SAC of Stable-Baselines3 on a scenario, with networks that all players share.

An uninterrupted run ends with the same policy on the same machine. A resumed one draws other games and other noise from
its last checkpoint on, and SAC collects anew what it remembers, so it ends with another policy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import stable_baselines3
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import CheckpointCallback, ConvertCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.save_util import load_from_zip_file
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.sac.policies import SACPolicy
from torch import nn

from ptne_env._version import __version__
from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.evaluation import PolicySpec
from ptne_env.learn.layers import LAYERS, Metadata, Weights
from ptne_env.learn.npz_policy import open_policy, seal
from ptne_env.learn.sb3_archive import as_trained
from ptne_env.perception.observation import ObservationLayout
from ptne_env.shared.arrays import FloatArray
from ptne_env.shared.files import require_file
from ptne_env.training import defaults
from ptne_env.training.configuration import POLICY, Configuration, RunSummary, read_finished_run, write_record
from ptne_env.training.curve import CURVE_EPISODES, finish, validate, write_learning_curve
from ptne_env.world.catalogue import get_scenario
from ptne_env.world.world import World

Progress = Callable[[int, int, float], None]
"""A function of the agent-steps done, their total, and the mean digits of the last evaluation (-inf before)."""

EVALUATIONS = 10
"""The number of evaluations, and of checkpoints, in a run."""

REMEMBERED = 300_000
"""The last agent-steps from which SAC learns."""


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
    algorithm, arguments_of = ALGORITHMS[configuration.algorithm]
    arguments = _common_arguments(configuration, env) | arguments_of(configuration, env)
    model = algorithm("MlpPolicy", env, **arguments)
    checkpoints = out / "checkpoints"
    model.num_timesteps = resumed_at = _restore(model, checkpoints)
    write_record(out / "configuration.json", configuration)
    samples = configuration.rollout * env.num_envs
    rollouts = -(-configuration.steps // samples)  # the last one is a whole one
    calls = -(-rollouts * configuration.rollout // EVALUATIONS)  # steps of all environments together
    steps, digits = list[int](), list[FloatArray]()

    def report(*_: Any) -> bool:
        done = model.num_timesteps - resumed_at
        if done % (calls * env.num_envs) == 0:
            steps.append(model.num_timesteps)
            digits.append(validate(PolicySpec("trained", model), scenario, CURVE_EPISODES))
            write_learning_curve(out, steps, digits)
        if progress is not None and done % samples == 0:
            latest = float(digits[-1].mean()) if digits else -math.inf
            progress(model.num_timesteps, configuration.steps, latest)
        return True

    callbacks = [CheckpointCallback(calls, str(checkpoints)), ConvertCallback(report)]
    if configuration.steps > resumed_at:
        model.learn(configuration.steps - resumed_at, callback=callbacks, reset_num_timesteps=False)

    exported = export(model, env.layout, **asdict(configuration))
    return finish(out, exported, scenario, model.num_timesteps, resumed_at, began)


def _common_arguments(configuration: Configuration, env: PlayerVecEnv) -> dict[str, Any]:
    """Return the keyword arguments that all algorithms have."""
    samples = configuration.rollout * env.num_envs
    if configuration.minibatches >= samples:
        raise ValueError(
            f"minibatches must be fewer than the {samples} samples of a rollout, got {configuration.minibatches}"
        )
    return {
        "learning_rate": LinearSchedule(configuration.learning_rate, 0.0, 1.0),
        "batch_size": -(-samples // configuration.minibatches),
        "gamma": configuration.discount,
        "seed": configuration.seed,
        "device": "cpu",
    }


def _ppo_arguments(configuration: Configuration, _: PlayerVecEnv) -> dict[str, Any]:
    return {
        "n_steps": configuration.rollout,
        "n_epochs": configuration.epochs,
        "gae_lambda": 0.9,
        "policy_kwargs": {"net_arch": list(configuration.hidden), "log_std_init": configuration.log_std},
    }


def _sac_arguments(configuration: Configuration, env: PlayerVecEnv) -> dict[str, Any]:
    entropy = configuration.log_std + 0.5 * math.log(2 * math.pi * math.e)  # of a normal action
    return {
        "train_freq": configuration.rollout,
        "gradient_steps": configuration.epochs * configuration.minibatches,
        "buffer_size": REMEMBERED,
        "ent_coef": defaults.SAC["ent_coef"],
        "target_entropy": env.layout.action_size * entropy,
        "policy_kwargs": {"net_arch": list(configuration.hidden)},
    }


ALGORITHMS: Mapping[str, tuple[type[BaseAlgorithm], Callable[[Configuration, PlayerVecEnv], dict[str, Any]]]] = {
    "sb3-ppo": (PPO, _ppo_arguments),
    "sb3-sac": (SAC, _sac_arguments),
}
"""The class of each algorithm, and the keyword arguments that are its own."""


def _restore(model: BaseAlgorithm, checkpoints: Path) -> int:
    """Load the last whole checkpoint, and return its agent-steps; 0 without one.

    A run that was killed may leave a part of a checkpoint. Only arrays are read, which execute no code.
    """
    done = {int(path.stem.split("_")[2]): path for path in checkpoints.glob("rl_model_*_steps.zip")}
    for steps in sorted(done, reverse=True):
        with suppress(Exception):  # zip files and torch raise many classes
            require_file(done[steps])
            _, parameters, variables = load_from_zip_file(str(done[steps]), device="cpu", load_data=False)
            model.set_parameters(parameters, device="cpu")
            for name, value in (variables or {}).items():  # the weight of SAC's entropy
                getattr(model, name).data = value.data
            return steps
    return 0


def export(model: BaseAlgorithm, layout: ObservationLayout, **training: Any) -> bytes:
    """Export the deterministic actions of a model: the content of a file that :func:`ptne_env.learn.load` reads.

    Args:
        model: of PPO, A2C or SAC with an ``MlpPolicy`` of tanh or ReLU.
        layout: the layout of the environments in which it was trained, of units ``scaled``.
        **training: how it was trained, for the metadata.

    Raises:
        ValueError: when no file holds such a policy, or its file is refused or decides differently from the model.
    """
    training |= {"ptne_env": __version__}
    training |= {library.__name__: library.__version__ for library in (stable_baselines3, torch, np)}
    rows = np.random.default_rng(0).standard_normal((100, layout.size)).astype(np.float32)
    try:
        weights, functions = _read_network(model, layout)
        exported = seal(weights, Metadata(layout.interface, layout.action_dims, layout.slots, training, **functions))
        actions, _ = open_policy(Path(POLICY), exported).predict(rows)
        expected, _ = as_trained(model).predict(rows, deterministic=True)
        np.testing.assert_allclose(actions, expected, rtol=1e-4, atol=1e-4, equal_nan=False)
    except (ValueError, AssertionError) as error:
        raise ValueError(
            f"no file can play this {type(model).__name__} ({error}); evaluate takes the model itself"
            + ", or its .zip" * (model.get_vec_normalize_env() is None)
        ) from error
    return exported


_MODULES: dict[type, Callable[[Any], list[nn.Module]]] = {
    ActorCriticPolicy: lambda policy: [*policy.mlp_extractor.policy_net, policy.action_net],
    SACPolicy: lambda policy: [*policy.actor.latent_pi, policy.actor.mu],
}
"""The modules that compute the means of actions, by the class of a policy."""


def _read_network(model: BaseAlgorithm, layout: ObservationLayout) -> tuple[Weights, dict[str, Any]]:
    """Return the weights of the means of a model's actions, as layers, and what its file says of their functions."""
    policy: Any = model.policy
    is_squashed = type(policy) is SACPolicy
    is_plain = type(policy) in _MODULES and policy.squash_output == is_squashed
    modules = _MODULES[type(policy)](policy) if is_plain else []
    activations = {type(each) for each in modules} - {nn.Linear}
    is_normalised = getattr(model.get_vec_normalize_env(), "norm_obs", False)
    if not is_plain or activations - {nn.Tanh, nn.ReLU} or is_normalised or not layout.is_scaled:
        raise ValueError(
            "a file holds an MlpPolicy of PPO, A2C or SAC, of tanh or ReLU, without gSDE, trained on observations "
            "of the interface 'scaled' without VecNormalize"
        )
    layers = [each for each in modules if isinstance(each, nn.Linear)]
    weights: Weights = {}
    for name, layer in zip([*LAYERS[: len(layers) - 1], "out"], layers, strict=True):
        weights |= {name: layer.weight.detach().numpy(), f"{name}_bias": layer.bias.detach().numpy()[:, None]}
    return weights, {"activation": "tanh" if nn.Tanh in activations else "relu", "is_squashed": is_squashed}
