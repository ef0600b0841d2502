"""The effect of each choice of the training: one change at a time, the rest as shipped.

Run it with ``python baselines/ablations.py``; ``ablations.json`` and ``ablations.md`` beside this file are its output.
A variation that is there already is not repeated. The recurrent one needs ``pip install sb3-contrib``.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import torch
import typer
from common import Jobs, Ray, table
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecFrameStack

from ptne_env import Interface, PolicySpec, evaluate
from ptne_env.evaluation import Workers, episode_seed
from ptne_env.learn.training import ppo
from ptne_env.learn.training.arguments import Arguments
from ptne_env.perception.policy import Policy
from ptne_env.shared.files import write_atomically

HERE = Path(__file__).parent

FRAMES = 4
"""Observations that the variation with memory sees: the present one and the three before it."""

SHIPPED: dict[str, Any] = {"epochs": 5, "discount": 0.9, "learning_rate": 1e-3}
"""The settings of the shipped policies, where a configuration has faster ones now."""

VARIATIONS: dict[str, dict[str, Any]] = {
    "as shipped": {},
    "without products": {"products": False},
    "two layers of 32": {"hidden": (32, 32)},
    "two layers of 128": {"hidden": (128, 128)},
    "two layers of 256": {"hidden": (256, 256)},
    "discount 0.8": {"discount": 0.8},
    "discount 0.95": {"discount": 0.95},
    "discount 0.99": {"discount": 0.99},
    "trace 0.95": {"trace": 0.95},
    "learning rate 0.0005": {"learning_rate": 5e-4},
    "learning rate 0.002": {"learning_rate": 2e-3},
    "4 minibatches": {"minibatches": 4},
    "10 epochs": {"epochs": 10},
    f"memory of {FRAMES} observations": {"memory": True},
    # An LSTM costs more than ten times as much per step: this is about the time of the others.
    "recurrent, LSTM of 64, 0.4 M steps": {"recurrent": True, "steps": 400_000},
}


class Remembering:
    """A model of stacked observations as a policy: its memory holds the observations before the present one."""

    def __init__(self, model: PPO) -> None:
        self._model = model

    def predict(
        self,
        observation: npt.NDArray[np.float32],
        state: Any = None,
        episode_start: npt.NDArray[np.bool_] | None = None,
        deterministic: bool = False,  # noqa: FBT001, FBT002 - Stable-Baselines3's signature
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """See :meth:`ptne_env.perception.policy.Policy.predict`."""
        past = np.zeros((len(observation), (FRAMES - 1) * observation.shape[1]), np.float32) if state is None else state
        if episode_start is not None:
            past = np.where(episode_start[:, None], np.float32(0), past)
        stacked = np.concatenate([past, observation], axis=1)
        actions, _ = self._model.predict(stacked, deterministic=deterministic)
        return actions, stacked[:, observation.shape[1] :]


def train(arguments: Arguments, *, memory: bool = False, recurrent: bool = False) -> Policy:
    """Train without checkpoints and logs."""
    torch.set_num_threads(1)
    env: Any = ppo.make_env(arguments)
    layout = env.get_attr("layout")[0]
    settings = ppo.settings(arguments, layout)
    env.seed(episode_seed(arguments.seed, 0, split="train"))
    if recurrent:
        from sb3_contrib import RecurrentPPO

        settings["policy_kwargs"] |= {"lstm_hidden_size": 64}
        model: Any = RecurrentPPO("MlpLstmPolicy", env, **settings)
        return model.learn(arguments.steps)
    if memory:
        env = VecFrameStack(env, FRAMES)
        newest = (FRAMES - 1) * layout.size
        groups = settings["policy_kwargs"]["features_extractor_kwargs"]
        shifted = {name: [index + newest for index in group] for name, group in groups.items()}
        settings["policy_kwargs"]["features_extractor_kwargs"] = shifted
    model = PPO("MlpPolicy", env, **settings).learn(arguments.steps)
    return Remembering(model) if memory else model


def measure(name: str, arguments: Arguments) -> dict[str, Any]:
    """Train and validate one variation."""
    changes = dict(VARIATIONS[name])
    kind = {key: changes.pop(key) for key in ("memory", "recurrent") if key in changes}
    began = perf_counter()
    policy = train(dataclasses.replace(arguments, **changes), **kind)
    seconds = perf_counter() - began
    spec = PolicySpec(name, policy, Interface(arguments.interface, arguments.action_mode))
    results = evaluate([spec], list(arguments.scenarios), episodes=200, split="validation", against_laws=False)
    digits = results.record(arguments.scenarios[0], name, "digits")
    return {"variation": name, "seed": arguments.seed, "seconds": seconds} | {
        key: digits[key] for key in ("mean", "low", "high")
    }


def main(
    configuration: Annotated[str, typer.Option(help="The configuration that is varied.")] = "random-energy-switching",
    steps: Annotated[int, typer.Option(help="Agent-steps of each.")] = 4_000_000,
    seeds: Annotated[int, typer.Option(min=1, help="Training seeds of each.")] = 2,
    runs: Annotated[Path, typer.Option(help="Folder for finished variations.")] = Path("runs/ablations"),
    jobs: Jobs = 2,
    ray: Ray = None,
) -> None:
    """Train every variation and write the table."""
    tasks = [
        (name, Arguments.from_toml(configuration, steps=steps, seed=seed, **SHIPPED))
        for name in VARIATIONS
        for seed in range(seeds)
    ]
    paths = [runs / configuration / f"{steps}-{arguments.seed}" / f"{name}.json" for name, arguments in tasks]
    missing = [index for index, path in enumerate(paths) if not path.exists()]
    workers = Workers(jobs, ray)
    for place, result in workers.run(measure, [tasks[index] for index in missing]):
        write_atomically(paths[missing[place]], json.dumps(result, indent=1) + "\n")
        typer.echo(f"{result['variation']}, seed {result['seed']}: {result['mean']:.2f} digits")
    results = [json.loads(path.read_text(encoding="utf-8")) for path in paths]
    write_atomically(HERE / "ablations.json", json.dumps(results, indent=1) + "\n")
    introduction = (
        f"Written by `python baselines/ablations.py`; do not edit. `{configuration}`, {steps / 1e6:g} M agent-steps "
        "and one change at a time: mean digits on the validation episodes, one column per training seed."
    )
    rows = []
    for name in VARIATIONS:
        own = [result for result in results if result["variation"] == name]
        digits = [f"{result['mean']:.2f}" for result in own]
        rows.append([name, *digits, f"{np.median([result['seconds'] for result in own]):.0f}"])
    headings = ["variation", *(f"seed {seed}" for seed in range(seeds)), "seconds of one core"]
    lines = ["# Ablations", "", introduction, "", *table(headings, rows, texts=("variation",))]
    write_atomically(HERE / "ablations.md", "\n".join(lines) + "\n")


if __name__ == "__main__":
    typer.run(main)
