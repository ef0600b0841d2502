"""rl_zoo3: PPO with the hyperparameters of a file, for one agent that acts for all players.

Run it with: python examples/ecosystem/rlzoo_ppo.py
"""

import subprocess
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.env_util import make_vec_env
from yardstick import EPISODES, LAW, SCENARIO, joint_digits, law, report

ENVIRONMENT = f"ptne/{SCENARIO}-joint-v0"
HYPERPARAMETERS = Path(__file__).with_name("rlzoo_hyperparameters.yml")


def law_digits() -> np.ndarray:
    """Return the law's digits in the episodes of :func:`yardstick.report`, in a vector as rl_zoo3 makes it."""
    env = make_vec_env(ENVIRONMENT, EPISODES, seed=0, env_kwargs=LAW)
    (layout, *_), rows = env.get_attr("layout"), env.reset()
    policy, memory, over, gained = law(layout), None, np.zeros(1), np.zeros(EPISODES)
    while not over.all():
        actions, memory = policy.predict(rows.reshape(-1, layout.size), memory)
        rows, rewards, over, _ = env.step(actions.reshape(EPISODES, -1))
        gained += rewards
    return gained


def act(model: BaseAlgorithm, observations: np.ndarray) -> np.ndarray:
    """Return the actions without noise."""
    return model.predict(observations, deterministic=True)[0]


def train() -> tuple[float, float]:
    """Digits of an untrained network, and of the network that rl_zoo3 trains."""
    policy_kwargs = {"log_std_init": -1.0}
    untrained = PPO("MlpPolicy", gymnasium.make(ENVIRONMENT), policy_kwargs=policy_kwargs, seed=0, device="cpu")
    with TemporaryDirectory() as folder:
        command = [
            sys.executable, "-m", "rl_zoo3.train", "--algo", "ppo", "--env", ENVIRONMENT, "--gym-packages", "ptne_env",
            "--conf-file", str(HYPERPARAMETERS), "--log-folder", folder, "--seed", "0", "--device", "cpu",
            "--eval-freq", "-1",
        ]  # fmt: skip
        subprocess.run(command, check=True, capture_output=True)  # noqa: S603 - the command of the file's head
        (archive,) = Path(folder).rglob(f"{ENVIRONMENT.replace('/', '-')}.zip")
        trained = PPO.load(archive, device="cpu")
    return tuple(joint_digits(partial(act, model)) for model in (untrained, trained))


def main() -> None:
    """The law's digits, and a training by rl_zoo3's command."""
    report(law_digits(), *train())


if __name__ == "__main__":
    main()
