"""Train every shipped configuration, and ship the policies: ``python -m baselines.train [--out runs]``.

A run that is in the folder already is not repeated. It takes some minutes; each policy goes to
``ptne_env/learn/ppo-CONFIGURATION.npz``.
"""

import argparse
import shutil
from pathlib import Path

from ptne_env import learn
from ptne_env.training import configurations, ppo
from ptne_env.training.configuration import Configuration


def main(out: Path) -> None:
    """Train and copy."""
    for name in configurations():
        summary = ppo.train(Configuration.from_toml(name), out / name)
        shutil.copyfile(out / name / "policy.npz", Path(learn.__file__).parent / f"ppo-{name}.npz")
        print(f"ppo-{name}: {summary.digits:.2f} digits")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, default=Path("runs"))
    main(parser.parse_args().out)
