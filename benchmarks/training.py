"""Where the time of a training goes, and the time to the digits of the shipped policies, before and now.

Run ``python -m benchmarks.training --out DIR`` with the extra ``[sb3]`` on idle cores. Trainings with the settings of
the shipped policies and with the present ones take turns; one that is in ``DIR`` already is not repeated.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Annotated, Any

import numpy as np
import torch
import typer
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy
from torch.distributions import Distribution

from benchmarks.ours import timed
from ptne_env import PolicySpec, evaluate
from ptne_env import learn as policies
from ptne_env.envs.sb3 import PlayerVecEnv
from ptne_env.evaluation import Workers
from ptne_env.evaluation.metrics import number
from ptne_env.learn.training import checkpoint, ppo
from ptne_env.learn.training.arguments import Arguments
from ptne_env.shared.files import write_atomically

SHIPPED_STEPS = {
    "random-energy": 4_000_000,
    "random-energy-switching": 6_000_000,
    "random-energy-switching-transformed": 5_000_000,
}
"""Agent-steps of the shipped policies of the configurations that have faster settings now."""

PARTS: dict[str, tuple[Any, str]] = {
    "rollouts": (PPO, "collect_rollouts"),
    "environment": (PlayerVecEnv, "step_wait"),
    "policy": (ActorCriticPolicy, "forward"),
    "checkpoints": (checkpoint, "save"),
    "updates": (PPO, "train"),
    "forward": (ActorCriticPolicy, "evaluate_actions"),
    "backward": (torch.Tensor, "backward"),
    "norm": (torch.nn.utils, "clip_grad_norm_"),
    "Adam": (torch.optim.Adam, "step"),
    "validation": (ppo, "_validate"),
}
"""Functions whose seconds are measured. ``rollouts`` contain the next three, ``updates`` the next four."""


def shipped(configuration: str, **changes: Any) -> Arguments:
    """The arguments with which the shipped policy of a configuration was trained: the defaults, but for the steps."""
    return Arguments(**{"scenarios": configuration, "steps": SHIPPED_STEPS[configuration]} | changes)


def measure(arguments: Arguments, out: Path) -> dict[str, float]:
    """Train and keep the policy, the summary and the figures in ``out``, unless they are there already.

    Returns:
        Processor seconds of all parts, ``cpu`` and ``wall`` seconds of all, ``digits`` on the validation episodes.

    Raises:
        ValueError: when ``out`` holds a training with other arguments.
    """
    file = out / "measured.json"
    if ppo.finished(arguments, out) is not None and file.exists():
        measured: dict[str, float] = json.loads(file.read_text(encoding="utf-8"))
        return measured
    spent = {part: [0.0] for part in PARTS}
    with ExitStack() as stack:  # the run starts afresh: seconds of an interrupted one are not comparable
        run = Path(stack.enter_context(TemporaryDirectory())) / "run"
        for part, (owner, name) in PARTS.items():
            stack.enter_context(timed(owner, name, spent[part], process_time))
        cpu, wall = process_time(), perf_counter()
        digits = ppo.train(arguments, run).validation_digits
        cpu, wall = process_time() - cpu, perf_counter() - wall
        for kept in ("policy.onnx", "summary.json"):
            write_atomically(out / kept, (run / kept).read_bytes())
    measured = {part: seconds for part, (seconds,) in spent.items()} | {"cpu": cpu, "wall": wall, "digits": digits}
    write_atomically(file, json.dumps(measured))
    return measured


def shares(measured: list[dict[str, float]]) -> dict[str, float]:
    """Processor seconds by part, without overlaps: means over the trainings."""
    mean = {part: float(np.mean([one[part] for one in measured])) for part in measured[0]}
    rollouts = mean["rollouts"] - mean["environment"] - mean["policy"] - mean["checkpoints"]
    updates = mean["updates"] - mean["forward"] - mean["backward"] - mean["norm"] - mean["Adam"]
    return {
        "rollouts: the environment": mean["environment"],
        "rollouts: the policy and its value": mean["policy"],
        "rollouts: buffer, monitor, advantages": rollouts,
        "updates: the loss, forward": mean["forward"],
        "updates: the loss, backward": mean["backward"],
        "updates: norm of the gradient": mean["norm"],
        "updates: Adam": mean["Adam"],
        "updates: minibatches, ratios, logs": updates,
        "checkpoints": mean["checkpoints"],
        "validation": mean["validation"],
        "start, logs, export": mean["cpu"] - mean["rollouts"] - mean["updates"] - mean["validation"],
    }


def _settling(configuration: str, runs: list[Path]) -> list[float]:
    """Mean seconds to an error of 1e-6 on the validation episodes, of each policy; NaN if too few episodes reach it."""
    arguments = Arguments.from_toml(configuration)
    named = [PolicySpec(str(run), policies.load(run / "policy.onnx")) for run in runs]
    (scenario,) = arguments.scenarios
    results = evaluate(
        named, [scenario], episodes=arguments.validation_episodes, split="validation", against_laws=False
    )
    return [float(results.record(scenario, spec.name, "settling_time_1e_6")["mean"] or np.nan) for spec in named]


CHOICES: dict[str, tuple[dict[str, Any], Callable[[PPO], object]]] = {
    "as the shipped policies": ({}, lambda _: None),
    "two threads": ({}, lambda _: torch.set_num_threads(2)),
    "denormals flushed to 0": ({}, lambda _: torch.set_flush_denormal(True)),
    "distributions not checked": ({}, lambda _: Distribution.set_default_validate_args(False)),
    "Adam not fused": ({}, lambda model: model.policy.optimizer.param_groups[0].update(fused=False)),
    "16 minibatches": ({"minibatches": 16}, lambda _: None),
    "8 minibatches": ({"minibatches": 8}, lambda _: None),
    "two layers of 32": ({"hidden": (32, 32)}, lambda _: None),
    "1 epoch": ({"epochs": 1}, lambda _: None),
}
"""Arguments of a run, or a change of the model or of PyTorch, whose cost is measured alone."""


def cost(changes: dict[str, Any], prepare: Callable[[PPO], object]) -> tuple[float, float]:
    """Wall seconds of one rollout and of its updates."""
    arguments = shipped("random-energy-switching", **changes)
    env = ppo.make_env(arguments)
    model = PPO("MlpPolicy", env, **ppo.settings(arguments, env.get_attr("layout")[0]))
    spent = {part: [0.0] for part in ("rollouts", "updates")}
    torch.set_num_threads(1)
    try:
        prepare(model)
        with ExitStack() as stack:
            for part, seconds in spent.items():
                stack.enter_context(timed(*PARTS[part], seconds))
            model.learn(1)
    finally:
        torch.set_num_threads(1)
        torch.set_flush_denormal(False)
        Distribution.set_default_validate_args(True)
    return spent["rollouts"][0], spent["updates"][0]


def print_choices(turns: int) -> None:
    """Print the cost of each choice; they take turns."""
    seconds = [[cost(*choice) for choice in CHOICES.values()] for _ in range(turns)]
    typer.echo(f"{'Wall seconds, the least of ' + str(turns) + ' turns':40}{'rollout':>9}{'updates':>9}")
    for name, (rollout, updates) in zip(CHOICES, np.min(seconds, axis=0), strict=True):
        typer.echo(f"{name:40}{rollout:9.3f}{updates:9.3f}")


def main(
    configuration: Annotated[list[str] | None, typer.Argument(help="All three if left out.")] = None,
    *,
    out: Annotated[Path, typer.Option(help="Folder of the trainings.")] = Path("runs/training"),
    seeds: Annotated[int, typer.Option(min=1, help="Training seeds of each.")] = 5,
    jobs: Annotated[int, typer.Option(help="Trainings at a time; each takes one core.")] = 2,
    steps: Annotated[int | None, typer.Option(min=1, help="Agent-steps, for a trial.")] = None,
    choices: Annotated[int, typer.Option(min=0, help="Turns of single choices, which are measured instead.")] = 0,
) -> None:
    """Print the cost of choices, the parts of trainings, and digits and seconds before and now."""
    if choices:
        print_choices(choices)
        return
    chosen = configuration or list(SHIPPED_STEPS)
    changes = {} if steps is None else {"steps": steps}
    definitions = {"before": shipped, "now": Arguments.from_toml}
    runs = list(product(chosen, range(seeds), definitions))
    tasks = [
        (definitions[when](name, seed=seed, **changes), out / name / f"seed-{seed}" / when) for name, seed, when in runs
    ]
    measured = dict(Workers(jobs).run(measure, tasks))
    for name in chosen:
        columns = []
        for when in definitions:
            places = [place for place, run in enumerate(runs) if run[0] == name and run[2] == when]
            parts = shares([measured[place] for place in places])
            digits = [measured[place]["digits"] for place in places]
            settling = _settling(name, [tasks[place][1] for place in places])
            columns.append(
                {
                    "M agent-steps": f"{tasks[places[0]][0].steps / 1e6:.1f}",
                    "digits of the seeds": " ".join(map(number, digits)),
                    "digits, mean": number(float(np.mean(digits))),
                    "seconds to 1e-6, mean": number(float(np.mean(settling))),
                    "wall seconds": f"{np.mean([measured[place]['wall'] for place in places]):.1f}",
                    "CPU seconds": f"{sum(parts.values()):.1f}",
                    **{part: f"{seconds:.1f} ({seconds / sum(parts.values()):.1%})" for part, seconds in parts.items()},
                }
            )
        typer.echo(f"\n{name:40}{'before':>32}{'now':>32}")
        for row in columns[0]:
            typer.echo(f"{row:40}" + "".join(f"{column[row]:>32}" for column in columns))


if __name__ == "__main__":
    typer.run(main)
