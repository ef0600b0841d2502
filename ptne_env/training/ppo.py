"""PPO of Stable-Baselines3 on a scenario, with a network that all players share.

Run it with ``ptne train random-energy-switching --out DIR`` or ``python baselines/train.py``. ``DIR`` then holds
``policy.onnx`` (load it with :func:`ptne_env.policies.load`), ``summary.json``, TensorBoard logs, and, while it runs,
``checkpoint.zip``; the same command resumes an interrupted run from it.
"""

from __future__ import annotations

import dataclasses
import io
import json
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecMonitor
from torch import nn

from ptne_env.envs.sb3 import MixedPlayerVecEnv, PlayerVecEnv
from ptne_env.experiments import PolicySpec, episode_seed, evaluate
from ptne_env.experiments.suite import find_scenario
from ptne_env.files import read_json, write_atomically
from ptne_env.observation import ActionMode, Interface, InterfaceKind, ObservationLayout
from ptne_env.training import CONFIGURATIONS, configurations
from ptne_env.training.export import to_onnx
from ptne_env.training.features import Products

Progress = Callable[[int, int, float], None]
"""Called with agent-steps done, agent-steps in all, and recent mean digits gained (NaN before an episode ends)."""


@dataclass(frozen=True)
class Arguments:
    """The definition of a training run. Agent-steps count every player of every environment.

    Attributes:
        scenarios: names of scenarios or families of games, or tracks such as ``"ptne-v1/delay"``. Several share the
            environments evenly; their layouts must agree.
        interface: ``"local"`` or ``"physical"``.
        action_mode: ``"input"`` or ``"gains"``.
        steps: agent-steps of training.
        envs: environments stepped together, of all scenarios.
        rollout: steps of every environment between updates.
        minibatches: per epoch.
        epochs: passes over a rollout.
        learning_rate: at the start; it falls linearly to 0 at the end.
        discount: γ of PPO. Returns are reported undiscounted, over the whole horizon.
        trace: λ of generalised advantage estimation.
        clip: of the probability ratio.
        hidden: units of each tanh layer, of actor and critic alike.
        products: whether the networks also see :class:`~ptne_env.training.features.Products`.
        log_std: initial logarithm of the actions' standard deviation.
        seed: of the network, the sampling and the training games.
        validation_episodes: held-out games on which the result is measured.
        checkpoint_seconds: wall time between checkpoints.
    """

    scenarios: tuple[str, ...]
    interface: InterfaceKind = "local"
    action_mode: ActionMode = "input"
    steps: int = 6_000_000
    envs: int = 128
    rollout: int = 50
    minibatches: int = 32
    epochs: int = 5
    learning_rate: float = 1e-3
    discount: float = 0.9
    trace: float = 0.9
    clip: float = 0.2
    hidden: tuple[int, ...] = (64, 64)
    products: bool = True
    log_std: float = -2.0
    seed: int = 0
    validation_episodes: int = 200
    checkpoint_seconds: float = 20.0

    def __post_init__(self) -> None:
        for name in ("scenarios", "hidden"):  # lists come from files
            value = getattr(self, name)
            object.__setattr__(self, name, (value,) if isinstance(value, str) else tuple(value))

    @classmethod
    def from_toml(cls, name_or_path: str | Path, **changes: Any) -> Arguments:
        """The arguments of a shipped configuration, or of a TOML file, with some of them changed.

        Raises:
            ValueError: for an unknown configuration or key, naming the known ones, or a file that is not TOML.
        """
        path = Path(name_or_path)
        if path.suffix != ".toml":
            path = CONFIGURATIONS / f"{name_or_path}.toml"
        if not path.is_file():
            raise ValueError(f"unknown configuration {str(name_or_path)!r}; choose from {', '.join(configurations())}")
        try:
            values = tomllib.loads(path.read_text(encoding="utf-8")) | changes
        except ValueError as error:
            raise ValueError(f"{path} is not a TOML file: {error}") from error
        known = {field.name for field in dataclasses.fields(cls)}
        unknown = sorted(set(values) - known)
        if unknown:
            raise ValueError(f"{path.name}: unknown {', '.join(unknown)}; the arguments are {', '.join(sorted(known))}")
        return cls(**values)


def train(arguments: Arguments, out: Path, progress: Progress | None = None) -> dict[str, Any]:
    """Train, validate and export; resume where an interrupted run with the same arguments stopped.

    Args:
        arguments: of the run.
        out: folder for all files of the run; made if missing.
        progress: called after every rollout.

    Returns:
        The summary, also in ``out/summary.json``: arguments, digits on the validation episodes, seconds.

    Raises:
        ValueError: when ``out`` holds a run with other arguments, or a damaged one.
    """
    out.mkdir(parents=True, exist_ok=True)
    _claim(arguments, out)
    model, env = _start_or_resume(arguments, out)
    began = monotonic()
    remaining = arguments.steps - model.num_timesteps
    if remaining > 0:
        model.learn(
            remaining, callback=_Monitor(arguments, out, progress), reset_num_timesteps=False, tb_log_name="ppo"
        )
    digits = _validate(model, arguments)
    layout = env.get_attr("layout")[0]
    exported = to_onnx(model, layout, scenarios=arguments.scenarios, seed=arguments.seed, digits=digits)
    write_atomically(out / "policy.onnx", exported)
    summary = {
        "arguments": dataclasses.asdict(arguments),
        "validation_digits": digits,
        "agent_steps": int(model.num_timesteps),
        "seconds": monotonic() - began,
    }
    write_atomically(out / "summary.json", json.dumps(summary, indent=2) + "\n")
    (out / "checkpoint.zip").unlink(missing_ok=True)
    return summary


def _claim(arguments: Arguments, out: Path) -> None:
    """Write the arguments into the folder, or check that it holds a run with the same arguments."""
    path = out / "arguments.json"
    mine = json.loads(json.dumps(dataclasses.asdict(arguments)))
    if path.exists():
        theirs = read_json(path, "the arguments of a training run")
        different = sorted(name for name in mine.keys() | theirs.keys() if theirs.get(name) != mine.get(name))
        if different:
            raise ValueError(
                f"{out} holds a run with another {', '.join(different)}; choose another folder, or remove this one to "
                "start afresh"
            )
    else:
        write_atomically(path, json.dumps(mine, indent=2) + "\n")


def make_env(arguments: Arguments) -> VecMonitor:
    """The environments that a run trains in, monitored.

    Raises:
        ValueError: for an unknown scenario or track, scenarios that no policy can share, or a number of environments
            that they cannot share evenly.
    """
    share, rest = divmod(arguments.envs, max(1, len(arguments.scenarios)))
    if rest or not arguments.scenarios:
        raise ValueError(
            f"{arguments.envs} environments cannot be shared evenly by {len(arguments.scenarios)} scenarios"
        )
    parts = [
        PlayerVecEnv(
            find_scenario(name),
            share,
            interface=arguments.interface,
            action_mode=arguments.action_mode,
            max_cycles=None,
        )
        for name in arguments.scenarios
    ]
    return VecMonitor(parts[0] if len(parts) == 1 else MixedPlayerVecEnv(parts))


def settings(arguments: Arguments, layout: ObservationLayout) -> dict[str, Any]:
    """The keyword arguments of PPO."""
    network: dict[str, Any] = {
        "net_arch": list(arguments.hidden),
        "activation_fn": nn.Tanh,
        "log_std_init": arguments.log_std,
        "optimizer_kwargs": {"fused": True},  # one call instead of a dozen per tensor; the networks are small
    }
    if arguments.products:
        network |= {"features_extractor_class": Products, "features_extractor_kwargs": Products.of(layout)}
    samples = arguments.rollout * arguments.envs * layout.num_players
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


def _start_or_resume(arguments: Arguments, out: Path) -> tuple[PPO, VecMonitor]:
    torch.set_num_threads(1)  # the networks are small: a second thread costs more time than it saves
    env = make_env(arguments)
    checkpoint = out / "checkpoint.zip"
    if checkpoint.exists():
        try:
            model = PPO.load(checkpoint, env=env, device="cpu")
        except Exception as error:  # unpickling foreign bytes may raise anything
            raise ValueError(
                f"{checkpoint} is damaged, or not of this run: remove it to train afresh ({error!r})"
            ) from error
    else:
        chosen = settings(arguments, env.get_attr("layout")[0])
        model = PPO("MlpPolicy", env, tensorboard_log=str(out / "tensorboard"), **chosen)
    # A resumed run draws new games, those of the episode number at which it stopped.
    env.seed(episode_seed(arguments.seed, model.num_timesteps, split="train"))
    return model, env


def _validate(model: PPO, arguments: Arguments) -> float:
    spec = PolicySpec("ppo", model, Interface(arguments.interface, arguments.action_mode))
    results = evaluate(
        [spec],
        [find_scenario(name) for name in arguments.scenarios],
        episodes=arguments.validation_episodes,
        split="validation",
        against_laws=False,
    )
    return float(np.mean([samples["digits"].mean() for samples in results.samples.values()]))


class _Monitor(BaseCallback):
    """Reports digits and writes checkpoints, after every update."""

    def __init__(self, arguments: Arguments, out: Path, progress: Progress | None) -> None:
        super().__init__()
        self._arguments, self._out, self._progress = arguments, out, progress
        self._saved = monotonic()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if monotonic() - self._saved >= self._arguments.checkpoint_seconds:
            self._save()

    def _on_rollout_end(self) -> None:
        episodes: list[dict[str, float]] = list(self.model.ep_info_buffer or [])
        digits = float(np.mean([episode["r"] for episode in episodes])) if episodes else float("nan")
        if episodes:
            self.logger.record("rollout/digits_gained", digits)
        if self._progress is not None:
            self._progress(self.num_timesteps, self._arguments.steps, digits)

    def _save(self) -> None:
        buffer = io.BytesIO()
        self.model.save(buffer)
        write_atomically(self._out / "checkpoint.zip", buffer.getvalue())
        self._saved = monotonic()
