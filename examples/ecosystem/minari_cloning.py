"""Minari: the law's episodes as a dataset, loaded again and cloned.

The law of a player is linear in its observation, so least squares can clone it.

Run it with: python examples/ecosystem/minari_cloning.py
"""

import os
from tempfile import TemporaryDirectory

import gymnasium
import minari
import numpy as np
from yardstick import EPISODES, LAW, SCENARIO, digits, law, policy_of, report

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
    """Return the digits gained in each episode, after a check that the recovered environment repeats the rewards."""
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


def clone(dataset: minari.MinariDataset, players: int) -> np.ndarray:
    """Return each player's matrix (N, size, action size) with which observations come closest to the law's actions."""
    episodes = list(dataset.iterate_episodes())
    observations = np.concatenate([episode.observations[:-1] for episode in episodes])  # the last one has no action
    actions = np.concatenate([episode.actions for episode in episodes])
    pairs = zip(np.split(observations, players, axis=1), np.split(actions, players, axis=1), strict=True)
    return np.stack([np.linalg.lstsq(seen.astype(np.float64), done)[0] for seen, done in pairs])


def main() -> None:
    """Write, load, replay and clone a dataset."""
    with TemporaryDirectory() as folder:
        os.environ["MINARI_DATASETS_PATH"] = folder
        record()
        dataset = minari.load_dataset(NAME)
        gained = replay(dataset)
        layout = dataset.recover_environment().unwrapped.layout
        weights = clone(dataset, layout.num_players)

    def act(rows: np.ndarray) -> np.ndarray:
        players = layout.select(rows, "player").argmax(axis=1)
        return np.einsum("rs,rsa->ra", rows, weights[players]).astype(np.float32)

    physical = Interface("physical")
    before = digits(policy_of(lambda rows: np.zeros((len(rows), layout.action_size), dtype=np.float32)), physical)
    report(gained, before, digits(policy_of(act), physical))


if __name__ == "__main__":
    main()
