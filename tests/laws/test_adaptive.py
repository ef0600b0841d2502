import numpy as np
import pytest
from worlds import make_env, while_running, world_and_encoder

from ptne_env import FactorySpec, PolicySpec, evaluate, laws


def gains_along(env, law, **reset):
    observations, _ = env.reset(**reset)
    memory, gains = None, []
    for _ in while_running(env):
        actions, memory = law.predict(np.stack(list(observations.values())), state=memory)
        gains.append(memory)
        observations = env.step(dict(zip(list(env.agents), actions, strict=True)))[0]
    return np.array(gains)


@pytest.mark.parametrize("name", ["energy", "energy-switching"])
def test_gains_start_at_the_initial_gain_and_never_fall(name):
    env = make_env(name)
    gains = gains_along(env, laws.Adaptive(env.layout, initial_gain=0.75))
    assert gains[0].min() >= 0.75
    assert np.diff(gains, axis=0).min() >= 0
    assert gains[-1].min() > 0.75
    assert np.diff(gains, axis=0)[-1].max() < 1e-6  # they settle


def test_both_ends_of_a_link_keep_the_same_gain_without_a_message():
    env = make_env("energy-switching")
    gains = gains_along(env, laws.Adaptive(env.layout))
    neighbours = env.layout.neighbours
    for i in range(5):
        for slot, j in enumerate(neighbours[i]):
            back = neighbours[j].index(i)
            assert np.array_equal(gains[:, i, slot], gains[:, j, back])


def test_gain_of_a_link_grows_only_while_it_is_alive():
    env = make_env("energy-switching")
    gains = gains_along(env, laws.Adaptive(env.layout))
    world = env.world
    alive = world.mode_weights[:, :, world.modes[1:-1]].transpose(2, 1, 0) > 0
    grown = np.diff(gains, axis=0) > 0
    assert not grown[~alive].any()
    assert grown[alive][:50].all()


def table(seed):
    """A symmetric table of numbers, one per pair of players."""
    drawn = np.random.default_rng(seed).uniform(0.1, 1.0, (5, 5))
    return (drawn + drawn.T) / 2


def test_gains_of_links_follow_the_equations_of_theorem_3():
    """The paper's equations with γ_ij and κ_ij(0) in plain loops, over one-player observations of the environment."""
    env = make_env("energy-switching")
    gamma, kappa = 0.02 * table(0), table(1)
    law = laws.Adaptive(env.layout, gamma=gamma.tolist(), initial_gain=kappa.tolist())
    observations, _ = env.reset(seed=3)
    memory = dict.fromkeys(env.agents)
    for step in range(100):
        x, world = env.estimates, env.world  # a row per player
        weights = world.topology.graphs[world.modes[step]].adjacency
        u = np.zeros((5, 5))
        for i in range(5):
            u[i, i] = -(2 * (x[i, i] - world.game.target[i]) + 0.1 * x[i].sum() + 10 + 0.1 * x[i, i])
            for j in range(5):
                u[i] -= kappa[i, j] * weights[i, j] * (x[i] - x[j])
        growth = gamma * weights * ((x[:, None] - x) ** 2).sum(axis=2)
        kappa = kappa + world.clock.theta[step] * growth
        actions = {}
        for agent, observation in observations.items():
            actions[agent], memory[agent] = law.predict(observation, state=memory[agent])
        np.testing.assert_allclose(np.stack(list(actions.values())), u, rtol=1e-4, atol=1e-4)
        observations = env.step(actions)[0]
    gains = (np.concatenate(list(memory.values())) + law.surplus)[law.layout.filled_slots]
    links = np.sort(kappa[env.world.topology.union.adjacency > 0])
    np.testing.assert_allclose(np.sort(gains), links, rtol=1e-5)
    assert links.max() > 1.2 * table(1).max()


def test_a_table_of_gains_passes_the_audit_that_hides_the_links_of_others():
    law = FactorySpec.of("law:adaptive", gamma=(0.02 * table(0)).tolist(), initial_gain=table(1).tolist())
    results = evaluate(PolicySpec("table", law), "energy-switching", episodes=2)
    assert not results.failures
    assert results.record("energy-switching", "table", "digits")["mean"] > 0.5


@pytest.mark.parametrize(
    "numbers", [np.ones((4, 4)), -np.ones((5, 5)), np.triu(np.ones((5, 5))), np.full((5, 5), np.nan), np.ones(5)]
)
def test_a_table_that_is_not_one_of_links_is_refused(numbers):
    layout = world_and_encoder("energy")[1].layout
    with pytest.raises(ValueError, match=r"gamma is a number of at least 0, or a symmetric table \(5, 5\) of them"):
        laws.Adaptive(layout, gamma=numbers)


@pytest.mark.parametrize("name", ["gamma", "initial_gain"])
def test_negative_gains_are_refused(name):
    with pytest.raises(ValueError, match=f"{name} must be a finite number of at least 0"):
        laws.Adaptive(world_and_encoder("energy")[1].layout, **{name: -0.1})
