import numpy as np
import pytest

import ptne_env
from ptne_env.evaluation.episodes import EpisodeSet, episode_seed
from ptne_env.world.world import World


@pytest.mark.parametrize("name", ["energy", "random-energy", "random-energy-switching"])
def test_an_environment_starts_an_episode_of_a_set_with_its_seed(name):
    scenario = ptne_env.get_scenario(name, start="random")
    state = EpisodeSet(3, seed=5).initial_state(World(scenario))
    equilibria = np.broadcast_to(state.game.nash_equilibria, (5, 3))
    env = ptne_env.parallel_env(scenario)
    for episode in range(3):
        env.reset(seed=episode_seed(5, episode))
        np.testing.assert_array_equal(env.estimates.T, state.estimates[:, :, episode])
        np.testing.assert_array_equal(env.nash_equilibrium, equilibria[:, episode])


def test_more_episodes_extend_a_set_and_leave_its_beginning_alone():
    world = World(ptne_env.get_scenario("random-energy"))
    longer, shorter = (EpisodeSet(count, seed=1).initial_state(world) for count in (7, 3))
    np.testing.assert_array_equal(longer.estimates[..., :3], shorter.estimates)
    for parameter in ("curvature", "target", "coupling"):
        np.testing.assert_array_equal(getattr(longer.game, parameter)[..., :3], getattr(shorter.game, parameter))


def test_splits_share_no_episode():
    world = World(ptne_env.get_scenario("random-energy"))
    sets = [EpisodeSet(2, seed, split) for split in ("train", "validation", "test") for seed in (0, 1)]
    seeds = [episodes.episode_seed(episode) for episodes in sets for episode in range(2)]
    assert len(set(seeds)) == len(seeds) == 12
    starts = np.concatenate([episodes.initial_state(world).estimates for episodes in sets], axis=-1)
    assert len(np.unique(starts, axis=-1).T) == 12
    assert episode_seed(0, 3, "train") == 3  # the seeds that people choose by hand
