"""Traces come from the same starts and the same rollout as the samples."""

import numpy as np
import pytest

import ptne_env
from ptne_env import FactorySpec, PolicySpec, evaluate, get_scenario, laws
from ptne_env.evaluation import Suite, Teammates, Track, Workers, episode_seed, get_suite, run_suite
from ptne_env.evaluation.traces import scenes
from ptne_env.world import distances
from ptne_env.world.world import World


def test_the_first_episode_is_the_environments_own():
    scenario = get_scenario("random-energy-switching", hold_steps=30, steps=90)
    results = evaluate(["static"], [scenario], episodes=4, seed=5)
    scene = scenes(results)["random-energy-switching"]
    trace = scene.traces["static"]
    env = ptne_env.parallel_env(scenario)
    observations, _ = env.reset(seed=episode_seed(5, 0))
    law, kept = laws.Static(env.layout, kappa=2.0), [env.estimates]
    while env.agents:
        actions = {agent: law.predict(observation)[0] for agent, observation in observations.items()}
        observations, *_ = env.step(actions)
        kept.append(env.estimates)
    clock = World(scenario).clock
    np.testing.assert_array_equal(scene.t, clock.t)
    assert scene.deadline_frame == clock.steps
    np.testing.assert_array_equal(trace.estimates, np.transpose(kept, (2, 1, 0)))
    np.testing.assert_array_equal(trace.strategies, trace.estimates[range(5), range(5)])
    np.testing.assert_array_equal(scene.equilibrium, np.tile(env.nash_equilibrium[:, None], scene.t.size))


def test_estimates_of_many_players_are_left_out():
    (scene,) = scenes(evaluate(["static"], [get_suite("ptne-v1").track("large-20").scenario], episodes=1)).values()
    assert scene.traces["static"].estimates is None
    assert scene.traces["static"].strategies.shape == (20, scene.t.size)


def test_errors_are_quantiles_of_the_samples():
    results = evaluate(["adaptive"], ["energy"], episodes=5)
    drawn = scenes(results)
    for (track, _), samples in results.samples.items():
        scene, measured = drawn[track], samples["estimate_distance"][0]
        at_deadline = scene.traces["adaptive"].errors[:, scene.deadline_frame]
        np.testing.assert_array_equal(at_deadline, np.quantile(measured, [0.1, 0.5, 0.9]))
        assert scene.traces["adaptive"].error[scene.deadline_frame] == measured[0]
        assert scene.episodes == len(measured)


def test_consensus_gains_are_those_of_the_law():
    results = evaluate(
        [PolicySpec("mine", FactorySpec.of("ptne_env.laws:Static", kappa=3.25))], ["energy-switching"], episodes=2
    )
    scene = scenes(results)["energy-switching"]
    gains = scene.traces["mine"].consensus_gains[:, :-1]
    alone = np.array(
        [[not scene.live[(scene.links == player).any(axis=1), frame].any() for frame in range(gains.shape[1])]
         for player in range(5)]
    )  # fmt: skip
    assert alone.any()
    assert np.isnan(gains[alone]).all()
    np.testing.assert_allclose(gains[~alone], 3.25, rtol=1e-5)  # actions are float32


def test_the_tuned_laws_are_drawn_beside_a_learned_policy():
    results = evaluate(["ppo-random-energy"], [get_scenario("random-energy", steps=40)], episodes=2, against_laws=True)
    scene = scenes(results)["random-energy"]
    assert list(scene.traces) == ["ppo-random-energy", "best of the paper's laws", "best of all laws"]


def test_a_suite_is_drawn_with_its_teammates_from_its_own_episodes():
    world = get_scenario("random-energy", steps=40)
    team = Track("team", world, "A team.", teammates=Teammates(FactorySpec.of("ptne_env.laws:ZeroInput"), (1, 3)))
    suite = Suite("tiny", (Track("alone", world, "Nothing."), team), episodes=3)
    results = run_suite(suite, ["ppo-random-energy-gains"])
    calls = []
    drawn = scenes(results, workers=Workers(2), progress=lambda *arguments: calls.append(arguments))
    assert sorted(calls) == [("alone", 2), ("team", 2)]
    assert list(drawn) == ["alone", "team"]
    for name, scene in drawn.items():
        trace = scene.traces["static"]
        measured = results.samples[name, "static"]["estimate_distance"]
        np.testing.assert_array_equal(trace.errors[1, scene.deadline_frame], np.median(measured))
        game = suite.episode_set(name, 1).initial_state(World(world)).game
        distance = distances.estimate_distance(trace.estimates[..., :1], game)
        assert distance[0] == pytest.approx(trace.error[0], rel=1e-12)
    assert not np.any(drawn["team"].traces["static"].inputs[[1, 3], :-1])
    assert np.all(drawn["alone"].traces["static"].inputs[:, :-1])
