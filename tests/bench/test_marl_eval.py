"""Results in the format of marl-eval: what its DiagnoseData asks for, and the numbers."""

import json
from dataclasses import replace

import numpy as np
import pytest
from small_suite import BASE, SMALL

from ptne_env import evaluate
from ptne_env.bench import leaderboard, run_suite
from ptne_env.bench.marl_eval import marl_eval_json
from ptne_env.evaluation import get_policy_spec


@pytest.fixture(scope="module")
def results():
    grounded = get_policy_spec("grounded")
    trained = replace(grounded, name="two, seeds", policy=(grounded.policy, get_policy_spec("static").policy))
    return run_suite(SMALL, [trained, "ppo-random-energy"])


def test_all_tasks_have_the_same_algorithms_runs_steps_and_metrics(results):
    data = json.loads(marl_eval_json(results))
    assert list(data) == ["small-v1"]
    assert list(data["small-v1"]) == ["ring", "complete"]
    for algorithms in data["small-v1"].values():
        assert list(algorithms) == ["two; seeds", "ppo-random-energy", "zero-input", "static", "oracle"]
        for runs in algorithms.values():
            assert list(runs) == ["run_1", "run_2"]
            for steps in runs.values():
                assert list(steps) == ["step_1", "absolute_metrics"]
                assert list(steps["step_1"]) == ["step_count", "digits", "score"]
                assert [len(values) for values in steps["absolute_metrics"].values()] == [5, 5]


def test_runs_hold_the_digits_and_scores_of_the_training_seeds(results):
    data = json.loads(marl_eval_json(results))["small-v1"]
    digits = results.samples["ring", "two, seeds"]["digits"]
    for run, expected in enumerate(digits):
        found = data["ring"]["two; seeds"][f"run_{run + 1}"]
        assert found["absolute_metrics"]["digits"] == pytest.approx(expected, abs=1e-6)
        assert found["step_1"]["digits"] == pytest.approx([np.mean(expected)], abs=1e-6)
    scores = [data["ring"]["two; seeds"][f"run_{run}"]["absolute_metrics"]["score"] for run in (1, 2)]
    assert np.mean(scores) == pytest.approx(leaderboard(results).row("ring", "two, seeds").score.mean, abs=1e-6)


def test_a_policy_that_cannot_act_has_the_numbers_of_zero_input(results):
    data = json.loads(marl_eval_json(results))["small-v1"]["complete"]
    assert data["ppo-random-energy"] == data["zero-input"]


def test_a_comparison_has_digits_alone_of_policies_that_act_on_all_tracks():
    results = evaluate(
        ["ppo-random-energy", "static"], [BASE, SMALL.track("complete").scenario.replace(name="full")], episodes=2
    )
    data = json.loads(marl_eval_json(results))["comparison"]
    assert [list(algorithms) for algorithms in data.values()] == [["static"], ["static"]]
    assert list(data["full"]["static"]["run_1"]["absolute_metrics"]) == ["digits"]
