"""Smoke test of an installed package: ``python tests/smoke.py [bench]``, outside the source tree."""

import subprocess
import sys
import sysconfig
from importlib import metadata
from pathlib import Path

import gymnasium
import numpy as np
import pettingzoo

import ptne_env


def installed():
    """The package is the installed one, and complete."""
    assert Path(ptne_env.__file__).is_relative_to(sysconfig.get_path("purelib")), ptne_env.__file__
    assert metadata.version("ptne-env") == ptne_env.__version__
    assert (Path(ptne_env.__file__).parent / "py.typed").is_file()


def play():
    """An episode under the law of the paper; environments from both registries."""
    env = pettingzoo.make("parallel", "ptne/energy-v0", interface="physical")
    law, memory = ptne_env.laws.Static(env.layout), None
    observations, _ = env.reset(seed=0)
    while env.agents:
        rows, memory = law.predict(np.stack(list(observations.values())), memory)
        observations, _, _, _, infos = env.step(dict(zip(env.agents, rows, strict=True)))
    assert infos["player_0"]["is_success"]
    gymnasium.make("ptne_env:ptne/energy-joint-v0").reset(seed=0)


def bench():
    """The command line, and a shipped policy."""
    from ptne_env import learn

    command = Path(sysconfig.get_path("scripts")) / "ptne"
    listed = subprocess.run([command, "list"], capture_output=True, text=True, check=True).stdout  # noqa: S603
    assert "energy-switching" in listed
    policy, track = "ppo", "switching-physical"
    assert f"{policy}-{track}" in learn.shipped_names()
    results = ptne_env.evaluate(["static", policy], f"ptne-v1/{track}", episodes=3)
    assert results.record(track, policy, "digits")["mean"] > 3
    page = [command, "compare", "energy", "--policy", "static", "--episodes", "2", "--out", "out"]
    subprocess.run(page, capture_output=True, check=True)  # noqa: S603
    assert "</html>" in Path("out/report.html").read_text(encoding="utf-8")
    return policy


if __name__ == "__main__":
    installed()
    play()
    print("plays, from", Path(ptne_env.__file__).parent)
    if "bench" in sys.argv:
        print("lists, compares, and loads", bench())
    else:
        assert not {"torch", "matplotlib"} & set(sys.modules)
