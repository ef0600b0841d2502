"""The recurrent policy: worlds of any size, and memory."""

from pathlib import Path

import numpy as np
import pytest
from policy_files import RECURRENT as WEIGHTS

import ptne_env
from ptne_env import learn
from ptne_env.learn import npz_policy, recurrent
from ptne_env.perception.observation import LayoutError
from ptne_env.shared.parts import FactorySpec
from ptne_env.suites import get_suite

CONTENT = npz_policy.seal(WEIGHTS, {"seed": 0})


def opened(content=CONTENT):
    return npz_policy.open_policy(Path("mine.npz"), content)


@pytest.mark.parametrize("scenario", ["random-energy-switching", "robots", "oligopoly"])
def test_one_file_plays_worlds_of_any_size_and_its_episodes_start_afresh(scenario):
    env = ptne_env.parallel_env(scenario, interface="physical")
    policy, (observations, _) = opened().with_layout(env.layout), env.reset(seed=0)
    actions, memory = policy.predict(np.stack(list(observations.values())))
    assert actions.shape == (env.layout.num_players, env.layout.dimension)
    observations, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
    second = np.stack(list(observations.values()))
    going_on, _ = policy.predict(second, memory)
    mixed, _ = policy.predict(second, memory, np.arange(len(second)) == 0)
    np.testing.assert_array_equal(mixed[1:], going_on[1:])
    np.testing.assert_array_equal(mixed[0], policy.predict(second[0])[0])
    assert (mixed[0] != going_on[0]).any()


@pytest.mark.parametrize("graph", ["star", "path", "cycle"])
def test_empty_slots_decide_nothing_though_they_are_left_out(graph):
    topology, game = (FactorySpec.of(name, players=9) for name in (f"topology:{graph}", "game:random-energy"))
    env = ptne_env.parallel_env("random-energy", game=game, topology=topology, interface="physical")
    layout, memory, whole = env.layout, None, recurrent.initial_memory(WEIGHTS, env.layout.slots, 9, 9)
    policy, (observations, _) = opened().with_layout(layout), env.reset(seed=0)
    for _ in range(3):
        rows = np.stack(list(observations.values()))
        actions, memory = policy.predict(rows, memory)
        expected, whole, _ = recurrent.run_network(WEIGHTS, layout, recurrent.read(layout, rows.T, np.arange(9)), whole)
        np.testing.assert_allclose(actions, expected.T, rtol=1e-3, atol=1e-5 * np.abs(expected).max())
        observations, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
    assert sum(block["hidden"].shape[-1] for block in memory) == 9


def test_the_memory_of_other_players_is_refused():
    star = FactorySpec.of("topology:star", players=5)
    env = ptne_env.parallel_env("random-energy", topology=star, interface="physical")
    policy = opened().with_layout(env.layout)
    rows = np.stack(list(env.reset(seed=0)[0].values()))
    _, memory = policy.predict(rows)
    for others in (rows[:3], rows[1:], np.repeat(rows[:1], 5, axis=0)):
        with pytest.raises(ValueError, match="other players; pass state=None"):
            policy.predict(others, memory)


def test_a_player_knows_where_a_wall_of_its_box_holds_it():
    scenario = get_suite("ptne-v1").track("uneven-box").scenario.replace(disturbance=None)
    env = ptne_env.parallel_env(scenario, interface="physical")
    policy, memory = learn.load("recurrent-random-worlds", env.layout), None
    observations, _ = env.reset(seed=0)
    for _ in range(40):
        rows = np.stack(list(observations.values()))
        actions, memory = policy.predict(rows, memory)
        observations, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
    at_a_wall = (np.abs(rows[:, env.layout.slices["own_estimate"]]) == 5) & env.layout.own_mask
    assert at_a_wall.any()
    (block,) = memory
    np.testing.assert_array_equal(block["held"].T, at_a_wall)


def test_actions_do_not_depend_on_the_unit_of_costs():
    env = ptne_env.parallel_env("random-energy-switching", interface="physical")
    policy, memory, other = opened().with_layout(env.layout), None, None
    observations, _ = env.reset(seed=0)
    for _ in range(10):
        rows = np.stack(list(observations.values()))
        actions, memory = policy.predict(rows, memory)
        rows[:, env.layout.slices["own_gradient"]] *= 1000
        in_cents, other = policy.predict(rows, other)
        np.testing.assert_allclose(in_cents, actions, rtol=1e-3, atol=1e-4 * np.abs(actions).max())
        observations, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
    agreed, _ = env.reset(options={"estimates": np.zeros((5, 5))})
    assert policy.predict(np.stack(list(agreed.values())))[0].any()  # though there is no length to compare with


def test_a_gradient_that_is_0_but_for_rounding_does_not_set_the_unit_of_costs():
    """The gradient of the first player vanishes at the start, and is about 1e-39 one step later."""
    game = FactorySpec.of("game:quadratic", matrix=[[2.0, 1.0], [1.0, 2.0]], offset=[0.0, -3.0])
    start, path = FactorySpec.of("start:fixed", estimates=np.zeros((2, 2))), FactorySpec.of("topology:path", players=2)
    scenario = ptne_env.get_scenario("random-energy", game=game, start=start, topology=path)
    results = ptne_env.evaluate(["recurrent-random-worlds"], scenario, episodes=1)
    assert not results.failures
    assert results.record(scenario.name, "recurrent-random-worlds", "digits")["mean"] == 12


def test_a_neighbour_is_known_by_all_that_it_says():
    """A message about one component changes how much its sender is heard about the others, at once and by memory."""
    env = ptne_env.parallel_env("random-energy", interface="physical")
    weights = WEIGHTS | {"message": np.ones_like(WEIGHTS["message"])}  # they are 0 in the other, which has only memory
    policies = recurrent.RecurrentPolicy("mine", weights, env.layout, {}), opened().with_layout(env.layout)
    rows = np.stack(list(env.reset(seed=0)[0].values()))
    other = rows.copy()
    other[0, env.layout.slices["relative_estimates"].start] /= 2  # not the largest difference, which sets the scale
    for policy, first, second in zip(policies, (rows, other), (other, rows), strict=True):
        before = policy.predict(rows, policy.predict(rows)[1])[1][0]["gates"]
        after = policy.predict(second, policy.predict(first)[1])[1][0]["gates"]
        shares = [each[0, 1:, 0] / each[1, 1:, 0] for each in (before, after)]  # of attention, whatever the amplitude
        assert (np.abs(shares[0] - shares[1]) > 1e-4 * shares[0]).all()
        np.testing.assert_array_equal(before[..., 1:], after[..., 1:])


def test_components_follow_the_moves_of_others_by_learned_shares():
    env = ptne_env.parallel_env("random-energy", interface="physical")
    rows = np.stack(list(env.reset(seed=0)[0].values()))
    policy = opened().with_layout(env.layout)
    alone = policy.predict(rows)[0]
    weights = WEIGHTS | {"query": np.ones_like(WEIGHTS["query"])}
    together = recurrent.RecurrentPolicy("mine", weights, env.layout, {}).predict(rows)[0]
    assert (alone != together).all()
    at_rest = rows.copy()  # where nothing is to move, nothing follows
    for name in ("own_gradient", "relative_estimates"):
        at_rest[:, env.layout.slices[name]] = 0
    weights["out"] = np.zeros_like(weights["out"])
    assert not recurrent.RecurrentPolicy("mine", weights, env.layout, {}).predict(at_rest)[0].any()


def test_a_neighbour_that_lies_does_not_set_the_unit_of_moves_once_gradients_are_small():
    env = ptne_env.parallel_env("random-energy", interface="physical")
    weights = WEIGHTS | {"out": WEIGHTS["out"] * 0, "out_bias": np.array([[-20], [-20], [1]], dtype=np.float32)}
    policy = recurrent.RecurrentPolicy("mine", weights, env.layout, {})  # moves freely by one unit, and copies nothing
    actions = []
    for lie in (1e3, 1e6):
        rows = np.stack([*env.reset(seed=0)[0].values()])
        rows[:, env.layout.slices["relative_estimates"].start] += lie
        _, memory = policy.predict(rows)
        rows[:, env.layout.slices["own_gradient"]] *= 1e-9
        actions.append(policy.predict(rows, memory)[0])
    np.testing.assert_allclose(*actions, rtol=1e-3)
    assert (np.abs(actions) < env.layout.action_bound).all()


def test_a_loaded_policy_has_the_digits_of_its_file_in_every_world(tmp_path):
    (tmp_path / "file.npz").write_bytes(CONTENT)
    specs = [ptne_env.PolicySpec("object", opened()), ptne_env.evaluation.get_policy_spec(str(tmp_path / "file.npz"))]
    found = ptne_env.evaluate(specs, ["random-energy", "random-energy-switching"], episodes=2).samples
    for world in ("random-energy", "random-energy-switching"):
        np.testing.assert_array_equal(found[world, "object"]["digits"], found[world, "file"]["digits"])


def test_a_policy_without_a_layout_or_with_another_interface_says_so():
    with pytest.raises(LayoutError, match=r"without a layout.*load\(path, env.layout\)"):
        opened().predict(np.zeros(3, dtype=np.float32))
    with pytest.raises(LayoutError, match="interface: policy .*physical.*, environment"):
        opened().with_layout(ptne_env.parallel_env("energy").layout)
