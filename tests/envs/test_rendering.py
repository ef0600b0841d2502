import builtins
import itertools
import signal
import warnings
from functools import partial

import networkx as nx
import numpy as np
import pytest
from extras import need_matplotlib, need_sb3
from worlds import BLOCKS, constant_actions, make_env

need_matplotlib()

from matplotlib import pyplot as plt
from matplotlib.transforms import Affine2DBase

from ptne_env import CATALOGUE
from ptne_env.envs.parallel import aec_env


def picture(name, steps=0, action=1.0):
    env = make_env(name, render_mode="rgb_array")
    env.reset(seed=0)
    for _ in range(steps):
        env.step(constant_actions(env, action))
    pixels = env.render()
    env.close()
    return pixels


@pytest.mark.parametrize("name", ["energy", "robots", BLOCKS], ids=lambda world: getattr(world, "name", world))
def test_every_part_of_a_picture_shows_something(name):
    pixels = picture(name, steps=20)
    assert pixels.dtype == np.uint8
    assert pixels.ndim == 3
    assert pixels.shape[2] == 3
    height, width, _ = pixels.shape
    for rows in (slice(0, height // 2), slice(height // 2, None)):
        for columns in (slice(0, width // 2), slice(width // 2, None)):
            quarter = pixels[rows, columns]
            assert len(np.unique(quarter.reshape(-1, 3), axis=0)) > 20
            assert 0.3 < (quarter == 255).all(axis=2).mean() < 0.99


def test_picture_follows_the_episode_and_is_reproducible():
    assert np.array_equal(picture("energy", steps=5), picture("energy", steps=5))
    assert not np.array_equal(picture("energy", steps=5), picture("energy", steps=200))
    assert not np.array_equal(picture("energy", steps=50), picture("energy", steps=50, action=-1.0))


def test_members_of_stable_baselines3_have_the_picture_of_their_first_environment():
    need_sb3()
    from ptne_env.envs.sb3 import PlayerVecEnv

    with pytest.raises(ValueError, match="unknown render_mode 'human'; choose None or 'rgb_array'"):
        PlayerVecEnv("random-energy", render_mode="human")
    members = PlayerVecEnv("random-energy", 2, seed=3, render_mode="rgb_array", max_cycles=3)
    env = make_env("random-energy", render_mode="rgb_array", interface="scaled")
    for actions in (None, 1.0, -1.0, 0.5, 1.0):  # the third step ends an episode
        if actions is None:
            members.reset(), env.reset(seed=3)
        else:
            _, _, over, _ = members.step(np.full((10, members.layout.action_size), actions, dtype=np.float32))
            env.step(constant_actions(env, actions))
            if over[0]:
                env.reset()
        assert np.array_equal(members.render(), env.render())


def test_picture_shows_the_live_links():
    env = make_env("energy-switching", render_mode="rgb_array")
    env.reset()
    first = env.render()
    while env.world.modes[int(env._simulation.state.step[0])] == 0:
        env.step(constant_actions(env, 0.0))
    height, width, _ = first.shape
    graph = slice(height // 2, None), slice(2 * width // 3, None)
    assert not np.array_equal(first[graph], env.render()[graph])


def test_picture_shows_in_which_direction_a_link_carries_messages():
    one_way = nx.cycle_graph(5, nx.DiGraph)
    graphs = one_way, one_way.reverse(), nx.cycle_graph(5)
    pictures = [picture(CATALOGUE["energy"].replace(topology=graph)) for graph in graphs]
    assert not any(np.array_equal(*pair) for pair in itertools.combinations(pictures, 2))


def test_reset_clears_the_picture():
    env = make_env("energy", render_mode="rgb_array")
    env.reset()
    first = env.render()
    for _ in range(30):
        env.step(constant_actions(env, 2.0))
    env.reset()
    assert np.array_equal(env.render(), first)


@pytest.mark.parametrize("mode", ["rgb_array", "human"])
def test_closing_twice_leaves_no_figure_open(mode):
    before = plt.get_fignums()
    env = make_env("energy", render_mode=mode)
    env.reset()
    env.step(constant_actions(env, 0.0))
    env.render()
    env.close()
    env.close()
    assert plt.get_fignums() == before


def test_finished_and_diverged_episodes_can_be_drawn():
    env = make_env("non-quadratic", render_mode="rgb_array")
    env.reset()
    infos = env.step(constant_actions(env, 1000.0))[4]
    assert infos["player_0"]["diverged"]
    assert env.render().std() > 0


def test_drawing_needs_a_mode_and_an_episode():
    with pytest.raises(RuntimeError, match="render_mode='rgb_array'"):
        make_env("energy").render()
    with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
        make_env("energy", render_mode="rgb_array").render()


def test_ctrl_c_during_a_picture_is_no_error_of_matplotlib(monkeypatch):
    env = make_env("energy", render_mode="rgb_array")
    env.reset()
    array = Affine2DBase.__array__
    monkeypatch.setattr(
        Affine2DBase, "__array__", lambda *args, **kw: signal.raise_signal(signal.SIGINT) or array(*args, **kw)
    )
    ignored = signal.signal(signal.SIGINT, signal.default_int_handler)  # as tests in the background do
    try:
        with pytest.raises(KeyboardInterrupt):
            env.render()
    finally:
        signal.signal(signal.SIGINT, ignored)


def test_unknown_mode_raises_with_the_choices():
    with pytest.raises(ValueError, match=r"unknown render_mode 'ascii'; choose None or one of .*human.*rgb_array"):
        make_env("energy", render_mode="ascii")


def test_missing_matplotlib_names_the_extra_to_install(monkeypatch):
    env = make_env("energy", render_mode="rgb_array")
    env.reset()
    plain = builtins.__import__

    def without(name, *arguments, **keywords):
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return plain(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ImportError, match=r'pip install "ptne-env\[bench\]"'):
        env.render()


def test_the_conformance_suite_of_pettingzoo_renders():
    with warnings.catch_warnings():
        # The suite imports one of PettingZoo's own environments in the way that PettingZoo itself deprecates.
        warnings.filterwarnings("ignore", "The old environment creation API", DeprecationWarning)
        from pettingzoo.test import render_test

    render_test(partial(aec_env, "energy"))
