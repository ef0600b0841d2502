"""Train the network of ``ppo-random-energy`` again, in a minute: ``python -m baselines.train [--out runs]``.

PPO of Stable-Baselines3 trains it, and ``ptne_env/learn/ppo-random-energy.npz`` is replaced. A run that is in the
folder already is not repeated.
"""

import argparse
import shutil
from pathlib import Path

from ptne_env import learn
from ptne_env.training import sb3
from ptne_env.training.configuration import POLICY, Configuration

RECIPE = Configuration("random-energy", "sb3-ppo", steps=2_000_000, learning_rate=1.5e-3, log_std=-2.0)

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs"))
    out = parser.parse_args().out / RECIPE.scenario
    print(f"{sb3.train(RECIPE, out).digits:.2f} digits")
    shutil.copyfile(out / POLICY, Path(learn.__file__).parent / f"ppo-{RECIPE.scenario}.npz")
