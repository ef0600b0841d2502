"""Comparisons: policies on scenarios from seeded episodes."""

import json

import numpy as np
import pytest
from small_suite import BASE, COMPLETE, untimed

import ptne_env
from ptne_env import FactorySpec, PolicySpec, Scenario, evaluate, laws
from ptne_env.envs.gymnasium import JointEnv
from ptne_env.evaluation import COMPARED, POLICIES, Track, get_policy_spec
from ptne_env.perception.observation import LayoutError
from ptne_env.world.world import World


class Picky(laws.Static):
    """The static law, for two neighbour slots."""

    def __init__(self, layout):
        if layout.slots != 2:
            raise LayoutError("it was made for another layout")
        super().__init__(layout)


def test_a_scenario_as_an_object_keeps_its_start_and_gives_the_distance_of_the_documented_loop():
    record = evaluate("static", ptne_env.get_scenario("energy", start="paper")).record(
        "energy", "static", "strategy_distance"
    )
    assert record["episodes"] == 1
    assert record["mean"] == record["low"] == record["high"] == pytest.approx(6.5270e-5, rel=1e-4)


def test_results_are_a_function_of_the_seed_apart_from_timings():
    first, again, other = (evaluate(["static", "random"], BASE, episodes=3, seed=seed) for seed in (7, 7, 8))
    assert untimed(first) == untimed(again)
    assert untimed(first) != untimed(other)


def test_episodes_do_not_depend_on_the_other_policies():
    scenario = ptne_env.get_scenario("energy-switching")
    alone, among = (evaluate(policies, scenario, episodes=3) for policies in ("static", ["random", "static"]))
    place = ("energy-switching", "static")
    np.testing.assert_array_equal(alone.samples[place]["digits"], among.samples[place]["digits"])


def test_a_policy_may_be_a_class_a_factory_spec_a_callable_or_an_object():
    env = ptne_env.parallel_env(BASE, interface="physical")
    policies = [
        PolicySpec("class", laws.Static),
        PolicySpec("factory", FactorySpec.of("law:static", kappa=2.0)),
        PolicySpec("callable", lambda layout: laws.Static(layout, kappa=2.0), ptne_env.Interface("physical")),
        PolicySpec("object", laws.Static(env.layout)),
        laws.Static,
        get_policy_spec("ptne_env.laws:Static"),
        "law:static",
        "static",
    ]
    results = evaluate(policies, BASE, episodes=2)
    assert len({results.record(BASE.name, name, "digits")["mean"] for name in results.policies}) == 1
    json.loads(results.to_json())


def test_every_default_law_acts_in_every_game_of_the_catalogue():
    fixed = (each for each in ptne_env.CATALOGUE.values() if World(each).topology.is_fixed)
    scenarios = [scenario.replace(steps=15) for scenario in fixed]
    results = evaluate(COMPARED, scenarios, episodes=1)
    assert not results.failures
    assert not results.not_applicable
    assert len(results.samples) == len(COMPARED) * len(scenarios)


def test_every_default_law_stands_where_the_equilibrium_is_zero():
    """Regrets fall to 1e-90, and the square of their variance is 0."""
    scenario = Scenario(
        name="zero",
        game=FactorySpec.of("game:quadratic", matrix=[[2.0, 0.5], [0.5, 2.0]], offset=[0.0, 0.0]),
        topology=FactorySpec.of("topology:path", players=2),
        start="random",
    )
    results = evaluate(COMPARED, scenario, episodes=3)
    assert not results.failures
    assert results.record("zero", "relay", "regret")["high"] < 1e-85
    json.loads(results.to_json())


def test_a_start_that_an_environment_refuses_is_refused_in_the_same_words():
    scenario = BASE.replace(start=FactorySpec.of("start:uniform", low=4e5, high=5e5))
    for start in (lambda: evaluate("static", scenario, episodes=1), ptne_env.parallel_env(scenario).reset):
        with pytest.raises(
            ValueError, match="own gradients at the initial estimates must be within ±500000: start clos"
        ):
            start()


def test_a_comparison_takes_tracks_and_runs_the_jobs_by_what_it_is_given():
    asked = []

    def run(jobs):
        asked.extend((job.track.name, job.policy.name, job.episodes.count) for job in jobs)
        return [job.compute() for job in jobs]

    tracks = [Track("ring", BASE, "The base.", episodes=1), Track("all", COMPLETE, "All links.")]
    assert evaluate(["static", "grounded"], tracks, episodes=2, run=run).episodes == {"ring": 1, "all": 2}
    assert asked == [("ring", "static", 1), ("ring", "grounded", 1), ("all", "static", 2), ("all", "grounded", 2)]


def test_an_interface_may_be_given_by_its_kind_and_a_track_its_scenario_by_name():
    spec = PolicySpec("mine", laws.Static, "physical")
    assert spec == PolicySpec("mine", spec.policy, ptne_env.Interface("physical"))
    assert evaluate(spec, Track("mine", "energy", "The paper's."), episodes=1).samples
    assert list(evaluate({"mine": laws.Static, "static": POLICIES["static"]}, BASE, episodes=1).policies) == [
        "mine",
        "static",
    ]


def test_a_policy_that_fits_no_track_is_refused():
    with pytest.raises(ValueError, match="policy 'picky' fits no track: it was made for another layout"):
        evaluate(PolicySpec("picky", Picky), COMPLETE, episodes=1)


def test_a_model_of_the_joint_view_is_told_what_to_train_instead():
    model = laws.ZeroInput(ptne_env.parallel_env(COMPLETE).layout)
    joint = JointEnv(COMPLETE)
    model.observation_space, model.action_space = joint.observation_space, joint.action_space
    with pytest.raises(
        ValueError, match=r"those of all players \(JointEnv\).*a player has one: train .* on PlayerVecEnv"
    ):
        evaluate(model, COMPLETE, episodes=1)


def test_a_policy_is_not_applicable_where_it_does_not_fit():
    results = evaluate(["static", PolicySpec("picky", Picky)], [BASE, COMPLETE.replace(name="complete")], episodes=2)
    assert set(results.ranked("complete")) == {"static"}
    with pytest.raises(KeyError, match="unknown track 'compete'; did you mean 'complete'"):
        results.record("compete", "picky", "digits")
    with pytest.raises(KeyError, match="on track 'complete': n/a: it was made for another layout"):
        results.record("complete", "picky", "digits")


class Late:
    """The static law, for 119 steps."""

    interface = laws.Static.interface

    def __init__(self, layout):
        self.law, self.steps = laws.Static(layout), 0

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        if self.steps == 119:
            raise RuntimeError("too late")
        self.steps += 1
        return self.law.predict(observation, state, episode_start, deterministic)


def test_a_failing_policy_costs_its_own_track_alone():
    short = BASE.replace(name="short", steps=100)
    results = evaluate(["static", PolicySpec("late", Late)], [BASE, short], episodes=2)
    assert list(results.failures) == [(BASE.name, "late")]
    assert results.failures[BASE.name, "late"].startswith("step 119: RuntimeError: too late (test_run.py, line ")
    assert untimed(evaluate("static", BASE, episodes=2)) == [
        record for record in untimed(results) if (record["track"], record["policy"]) == (BASE.name, "static")
    ]
    with pytest.raises(KeyError, match="failed: step 119: .*too late"):
        results.record(BASE.name, "late", "digits")
