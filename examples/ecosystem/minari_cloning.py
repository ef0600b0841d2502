"""Minari: the law's episodes as a dataset, loaded again and cloned.

The law is linear in the observation of a player, so least squares can clone it.

Run it with: python examples/ecosystem/minari_cloning.py
"""

import os
from tempfile import TemporaryDirectory

import gymnasium
import minari
import numpy as np
from yardstick import EPISODES, LAW, SCENARIO, Acting, digits, law, report

from ptne_env import Interface

NAME = f"ptne/{SCENARIO}/static-v0"


def record() -> None:
    """Write the law's episodes, seeds 0, 1, …, as the dataset of that name."""
    env = minari.DataCollector(gymnasium.make(f"ptne_env:ptne/{SCENARIO}-joint-v0", **LAW))
    layout = env.unwrapped.layout
    policy = law(layout)
    for seed in range(EPISODES):
        observation, _ = env.reset(seed=seed)
        over = False
        while not over:
            actions, _ = policy.predict(observation.reshape(layout.num_players, layout.size))
            observation, _, terminated, truncated, _ = env.step(actions.ravel())
            over = terminated or truncated
    env.create_dataset(
        NAME, algorithm_name="the paper's static law", author="ptne_env", author_email="", code_permalink="",
        description="Joint observations and actions of all players",
    )  # fmt: skip
    env.close()


def replay(dataset: minari.MinariDataset) -> list[float]:
    """The digits gained in each episode, after a check that the recovered environment repeats the rewards."""
    env = dataset.recover_environment()
    gained = []
    for episode in dataset.iterate_episodes():
        (facts,) = dataset.storage.get_episode_metadata([episode.id])
        env.reset(seed=int(facts["seed"]))
        rewards = [env.step(action)[1] for action in episode.actions]
        if not np.array_equal(rewards, episode.rewards):
            raise SystemExit(f"episode {episode.id} did not give its rewards again")
        gained.append(sum(rewards))
    return gained


def clone(dataset: minari.MinariDataset, size: int) -> np.ndarray:
    """The matrix W for which observation @ W is closest to the law's action."""
    episodes = list(dataset.iterate_episodes())
    observations = np.concatenate([episode.observations[:-1] for episode in episodes])  # the last one has no action
    actions = np.concatenate([episode.actions for episode in episodes])
    players = observations.shape[1] // size
    return np.linalg.lstsq(
        observations.reshape(len(observations) * players, -1), actions.reshape(len(actions) * players, -1)
    )[0].astype(np.float32)


def main() -> None:
    """Write, load, replay, clone."""
    with TemporaryDirectory() as folder:
        os.environ["MINARI_DATASETS_PATH"] = folder
        record()
        dataset = minari.load_dataset(NAME)
        gained = replay(dataset)
        weights = clone(dataset, dataset.recover_environment().unwrapped.layout.size)
    before = digits(Acting(lambda observations: observations @ np.zeros_like(weights)), Interface("physical"))
    report(gained, before, digits(Acting(lambda observations: observations @ weights), Interface("physical")))


if __name__ == "__main__":
    main()
