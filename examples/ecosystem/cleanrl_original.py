"""CleanRL's own ``ppo_continuous_action.py``, with one agent that acts for all players.

The script is for Gymnasium 0.29 and Python 3.10. One argument is missing for Gymnasium 1.x, and is added here; the
line that prints returns finds no ``final_info`` there and prints nothing. The initial standard deviation of actions is
1/e instead of 1, which is much in actions of [−1, 1].

Run it with: python examples/ecosystem/cleanrl_original.py
"""

import contextlib
import hashlib
import io
import os
import runpy
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.request import urlopen

import gymnasium
import numpy as np
import torch
from yardstick import EPISODES, SCENARIO, TASK, joint_digits, law, report

SCRIPT = "ppo_continuous_action.py"
COMMIT = "fe8d8a03c41a7ef5b523e2e354bd01c363e786bb"
ADDRESS = f"https://raw.githubusercontent.com/vwxyzjn/cleanrl/{COMMIT}/cleanrl/{SCRIPT}"
HASH = "326dd8678bf9cc51abec833eb551ef2409a3804d604b689e1f0a084eca41f655"
CHANGES = {
    "lambda obs: np.clip(obs, -10, 10))": "lambda obs: np.clip(obs, -10, 10), env.observation_space)",
    "nn.Parameter(torch.zeros(1, ": "nn.Parameter(-torch.ones(1, ",
}
STEPS = 40_000


def script() -> str:
    """CleanRL's script at one commit, which is kept in the virtual environment.

    Raises:
        SystemExit: when it cannot be downloaded, or has another content.
    """
    path = Path(sys.prefix) / SCRIPT
    if not path.exists():
        try:
            with urlopen(ADDRESS, timeout=60) as answer:
                downloaded = answer.read()
        except OSError as error:  # such as an unknown host, a timeout or the answer 404
            raise SystemExit(
                f"cannot download {ADDRESS} ({error}): this example needs the network, or this file as {path}"
            ) from error
        path.write_bytes(downloaded)
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != HASH:
        raise SystemExit(f"{path} is not CleanRL's script of the commit {COMMIT}: delete it")
    return content.decode()


def run(steps: int) -> dict[str, Any]:
    """The variables with which the script ends, after ``steps`` steps of training."""
    with TemporaryDirectory() as folder, contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()):
        changed, text = Path(folder) / SCRIPT, script()
        for old, new in CHANGES.items():
            text = text.replace(old, new)
        changed.write_text(text, encoding="utf-8")
        sys.argv = [
            SCRIPT, "--env-id", "Gains-v0", "--total-timesteps", str(steps), "--num-envs", "16", "--num-steps", "50",
            "--num-minibatches", "4", "--learning-rate", "1e-3", "--gamma", "0.9", "--gae-lambda", "0.9", "--no-cuda",
        ]  # fmt: skip
        return runpy.run_path(os.fspath(changed), run_name="__main__")


def digits(ended: dict[str, Any]) -> float:
    """Digits of the script's network, behind the normalisation of the script's first environment."""
    env = ended["envs"].envs[0]
    while not isinstance(env, gymnasium.wrappers.NormalizeObservation):
        env = env.env
    mean, deviation = env.obs_rms.mean, np.sqrt(env.obs_rms.var + env.epsilon)

    def act(observations: np.ndarray) -> np.ndarray:
        rows = np.clip((observations - mean) / deviation, -10, 10).astype(np.float32)
        with torch.no_grad():
            return ended["agent"].actor_mean(torch.from_numpy(rows)).clamp(-1, 1).numpy()

    return joint_digits(act)


def law_digits() -> np.ndarray:
    """Digits that the law gains in the episodes of :func:`yardstick.report`, in a vector as the script makes it."""
    envs = gymnasium.make_vec(f"ptne/{SCENARIO}-joint-v0", EPISODES, vectorization_mode="sync")
    layout = envs.get_attr("layout")[0]
    policy, (rows, _) = law(layout), envs.reset(seed=0)
    gained, over = np.zeros(EPISODES), np.zeros(1)
    while not over.all():
        actions, _ = policy.predict(rows.reshape(-1, layout.size))
        rows, rewards, over, _, _ = envs.step(actions.reshape(EPISODES, -1))
        gained += rewards
    return gained


def main() -> None:
    """The law's digits, and a training by the script."""
    gymnasium.register(
        "Gains-v0", entry_point="ptne_env.envs.gymnasium:JointEnv", kwargs={"scenario": SCENARIO, **TASK}
    )
    report(law_digits(), digits(run(0)), digits(run(STEPS)))


if __name__ == "__main__":
    main()
