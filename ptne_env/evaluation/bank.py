"""The draws that every policy meets: they depend on the scenario and the seed, and never on a policy."""

from __future__ import annotations

from ptne_env import theory
from ptne_env.arrays import require_count
from ptne_env.dynamics import Dynamics, State
from ptne_env.sources import Sources

_EPISODE_BITS = 32


def episode_seed(seed: int, episode: int) -> int:
    """The seed of one episode; ``env.reset(seed=episode_seed(S, k))`` starts where episode k of an evaluation does.

    Raises:
        ValueError: when a number is negative, or the episode is not below 2^32.
    """
    require_count("seed", seed, 0)
    if require_count("episode", episode, 0) >= 1 << _EPISODE_BITS:
        raise ValueError(f"an episode's number is below 2^{_EPISODE_BITS}, got {episode}")
    return (seed << _EPISODE_BITS) + episode


def draw_start(dynamics: Dynamics, episodes: int, seed: int) -> State:
    """The initial state of all episodes, games and estimates drawn.

    Raises:
        ValueError: when a drawn game is not strongly monotone.
    """
    sources = [Sources.from_seed(episode_seed(seed, episode)) for episode in range(episodes)]
    game = dynamics.draw_game(sources)
    if dynamics.scenario.has_random_game:
        theory.require_strong_monotonicity(game)
    return dynamics.start(dynamics.draw_estimates(sources), game)
