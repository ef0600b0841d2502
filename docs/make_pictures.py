# ruff: noqa: INP001, T201 - a script, and it prints
"""Draw the picture of the README: the last frame of an episode, rendered by the environment.

Run it from the project's folder with: python docs/make_pictures.py
"""

from pathlib import Path

import numpy as np
from matplotlib import image

import ptne_env
from ptne_env import laws

IMAGES = Path(__file__).parent / "images"


def draw_run(path: Path) -> None:
    """Run the static law on ``energy-switching-transformed`` with a hold phase and save the last frame."""
    env = ptne_env.parallel_env("energy-switching-transformed", hold_steps=50, render_mode="rgb_array")
    observations, _ = env.reset(seed=7)
    policy, memory = laws.Static(env.layout, kappa=2.0), None
    while env.agents:
        agents = env.agents
        actions, memory = policy.predict(np.stack([observations[agent] for agent in agents]), state=memory)
        observations, *_ = env.step(dict(zip(agents, actions, strict=True)))
    frame = env.render()
    env.close()
    path.parent.mkdir(parents=True, exist_ok=True)
    # Without the "Software" entry the same frame gives the same file under every version of matplotlib.
    image.imsave(path, frame, metadata={"Software": None})


if __name__ == "__main__":
    draw_run(IMAGES / "run.png")
    print(f"written: {IMAGES / 'run.png'}")
