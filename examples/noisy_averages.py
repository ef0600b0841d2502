"""Averages of noisy messages: the digits that they allow on the track noise of ptne-v1, beside those of policies.

Links of a cycle of five players carry noise of standard deviation σ, new in every one of K steps. Suppose that all
strategies rest at the equilibrium from the first step on, and that every player states a weighted average of the
messages of its two neighbours, about each component of another player. Over many steps only the mean noise of each
link counts: with weights W of player i for neighbour j, the errors of the statements are e = W e + diag(W ξᵀ), where
the mean noises ξ_ij are independent and have variance σ²/K. In the end each player takes the average of the two means
that it has heard, with the weights that make the variance smallest. The script searches for the W that make the sum of
these variances over players smallest, weights between 0 and 1. Larger or negative weights would be a code: statements
far from every belief.

Prints the best weights, the variances in units of σ²/K, and the mean digits over the episodes, with intervals for the
policies.

Run it with: python examples/noisy_averages.py [--episodes 20]
"""

import argparse

import numpy as np
from scipy.optimize import minimize

from ptne_env.experiments import run_suite
from ptne_env.experiments.episodes import EpisodeSet
from ptne_env.experiments.suite import find_scenario
from ptne_env.world import World

PLAYERS, OWNER = 5, 0
OTHERS = [player for player in range(PLAYERS) if player != OWNER]
LINKS = [(player, (player + step) % PLAYERS) for player in OTHERS for step in (-1, 1)]
POLICIES = ("observer-relay", "size-free")


def variances(weights: np.ndarray) -> np.ndarray:
    """Of the final averages of the players that do not own the component; ``weights`` of their first neighbours."""
    taken, noise = np.zeros((PLAYERS, PLAYERS)), np.zeros((PLAYERS, len(LINKS)))
    for link, (player, neighbour) in enumerate(LINKS):
        weight = weights[link // 2] if link % 2 == 0 else 1 - weights[link // 2]
        taken[player, neighbour] = noise[player, link] = weight
    stated = np.linalg.lstsq(np.eye(PLAYERS) - taken, noise, rcond=None)[0]
    heard = stated[[neighbour for _, neighbour in LINKS]] + np.eye(len(LINKS))
    covariances = [pair @ pair.T for pair in heard.reshape(len(OTHERS), 2, -1)]
    return np.array([1 / np.linalg.solve(each + 1e-9 * np.eye(2), np.ones(2)).sum() for each in covariances])


def best_weights(starts: int = 20) -> np.ndarray:
    """The weights of the smallest sum of variances."""
    generator = np.random.default_rng(0)
    inside = [(1e-3, 1 - 1e-3)] * len(OTHERS)
    found = [
        minimize(lambda weights: variances(weights).sum(), start, bounds=inside)
        for start in generator.uniform(size=(starts, len(OTHERS)))
    ]
    return min(found, key=lambda each: each.fun).x


def main(episodes: int) -> None:
    """Print weights, variances and digits."""
    weights = best_weights()
    least = variances(weights)
    print("weights of the neighbour before:", *(f"{weight:.2f}" for weight in weights))
    print("variances:", *(f"{each:.2f}" for each in least), f"sum {least.sum():.2f}")
    world = World(find_scenario("ptne-v1/noise"))
    start = EpisodeSet(episodes, track=("ptne-v1", "noise")).initial_state(world)
    sizes = np.linalg.norm(start.game.nash_equilibria, axis=0)
    digits = -np.log10(np.sqrt(least.sum() / world.clock.steps) * world.channel.std / sizes)
    print(f"averages {digits.mean():.2f} digits")
    results = run_suite("ptne-v1", POLICIES, tracks="noise", episodes=episodes)
    for policy in POLICIES:
        found = results.summary("noise", policy, "digits")
        print(f"{policy} {found.mean:.2f} digits [{found.low:.2f}, {found.high:.2f}]")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--episodes", type=int, default=20)
    main(parser.parse_args().episodes)
