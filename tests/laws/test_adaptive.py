import numpy as np
import pytest
from worlds import make_env, while_running, world_and_encoder

from ptne_env import laws


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


@pytest.mark.parametrize("name", ["gamma", "initial_gain"])
def test_negative_gains_are_refused(name):
    with pytest.raises(ValueError, match=f"{name} must be a finite number of at least 0"):
        laws.Adaptive(world_and_encoder("energy")[1].layout, **{name: -0.1})
