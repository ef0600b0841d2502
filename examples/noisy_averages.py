"""Averages of noisy messages: the digits that they allow on the track noise of ptne-v1, beside those of policies.

Links of a cycle of N players carry noise of standard deviation σ, new in every one of K steps. Suppose that all
strategies rest at the equilibrium from the first step on, and that what players state and believe in the end about a
component of another player are averages of messages, present and past, with weights of at least 0 that do not depend on
the noise. Then an average gives each message over each link a weight, and these weights are a flow of 1 from the owner
to the player. Its variance is σ² times the sum of their squares, and at least σ²/K times the sum of squares of the
flows through links. That is smallest for the current of a network of resistors (Thomson's principle): for a player at d
links from the owner it is the resistance between them, d (N − d)/N. No choice of weights reaches it for all players at
once, because both neighbours hear the same statement: it is a bound. A simple way comes close: neighbours of the owner
state its last message, the others the last message of the neighbour nearer to it, and in the end each takes the best
average of its private means.

Averages with negative weights, the own gradient, which shows others' strategies without noise, and codes may have more.

Prints for the bound and for the simple way the variances in units of σ²/K and the digits of the root of the mean square
distance; for Gaussian noise the mean of digits, which tables show, is higher, by 0.02 for the simple way. Then the mean
digits of policies, with intervals.

Run it with: python examples/noisy_averages.py [--episodes 20]
"""

import argparse

import numpy as np

from ptne_env.evaluation import run_suite
from ptne_env.evaluation.episodes import EpisodeSet
from ptne_env.evaluation.suite import find_scenario
from ptne_env.world.world import World

PLAYERS = 5
BOUND = [links * (PLAYERS - links) / PLAYERS for links in range(1, PLAYERS)]
SIMPLE = [1, 1.2, 1.2, 1]
"""Two links away, means of variances 2 and 3 have the average 1/(1/2 + 1/3)."""
POLICIES = ("observer-relay", "size-free")


def main(episodes: int) -> None:
    """Print variances and digits."""
    world = World(find_scenario("ptne-v1/noise"))
    start = EpisodeSet(episodes, track=("ptne-v1", "noise")).initial_state(world)
    sizes = np.linalg.norm(start.game.nash_equilibria, axis=0)
    for name, variances in {"bound": BOUND, "copies and private means": SIMPLE}.items():
        distances = np.sqrt(sum(variances) / world.clock.steps) * world.channel.std / sizes
        print(f"{name}: variances", *variances, f"{-np.log10(distances).mean():.2f} digits")
    results = run_suite("ptne-v1", POLICIES, tracks="noise", episodes=episodes)
    for policy in POLICIES:
        found = results.summary("noise", policy, "digits")
        print(f"{policy} {found.mean:.2f} digits [{found.low:.2f}, {found.high:.2f}]")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--episodes", type=int, default=20)
    main(parser.parse_args().episodes)
