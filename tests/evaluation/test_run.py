"""Runs: comparisons of scenarios, and suites of tracks."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from ptne_env.evaluation.check import check
from small_suite import BASE, SMALL, untimed

import ptne_env
from ptne_env import FactorySpec, PolicySpec, evaluate, laws
from ptne_env.evaluation import COMPARED, Suite, Track, Workers, get_policy_spec, get_suite, run_suite, tuning


@pytest.fixture(scope="module")
def results():
    return evaluate(["static", "zero-input", "oracle", "random"], ["energy", "non-quadratic"], episodes=6, seed=2)


def test_a_named_scenario_is_run_from_random_starts(results):
    assert results.episodes == {"energy": 6, "non-quadratic": 6}
    assert results.record("energy", "static", "digits")["episodes"] == 6


def test_a_scenario_as_an_object_keeps_its_start_and_gives_the_distance_of_the_documented_loop():
    record = evaluate("static", ptne_env.get_scenario("energy")).record("energy", "static", "strategy_distance")
    assert record["episodes"] == 1
    assert record["mean"] == record["low"] == record["high"] == pytest.approx(6.5270e-5, rel=1e-4)


def test_an_episode_without_settling_has_no_settling_time(results):
    assert results.record("energy", "zero-input", "settling_time")["mean"] is None
    assert results.record("energy", "zero-input", "settled_share")["mean"] == 0


def test_results_are_a_function_of_the_seed_apart_from_timings():
    scenario = ptne_env.get_scenario("energy", start="random")
    first, again, other = (evaluate(["static", "random"], [scenario], episodes=3, seed=seed) for seed in (7, 7, 8))
    assert untimed(first) == untimed(again)
    assert untimed(first) != untimed(other)


def test_episodes_do_not_depend_on_the_other_policies():
    scenario = ptne_env.get_scenario("energy-switching", start="random")
    alone = evaluate(["static"], [scenario], episodes=3)
    among = evaluate(["random", "static"], [scenario], episodes=3)
    assert alone.record("energy-switching", "static", "digits") == among.record("energy-switching", "static", "digits")


def test_a_policy_may_be_a_class_a_factory_spec_a_callable_or_an_object():
    scenario = ptne_env.get_scenario("energy")
    env = ptne_env.parallel_env(scenario)
    policies = [
        PolicySpec("class", laws.Static),
        PolicySpec("factory", FactorySpec.of("ptne_env.laws:Static", kappa=2.0)),
        PolicySpec("callable", lambda layout: laws.Static(layout, kappa=2.0)),
        PolicySpec("object", laws.Static(env.layout)),
        get_policy_spec("ptne_env.laws:Static"),
        "static",
    ]
    results = evaluate(policies, [scenario])
    assert len({results.record("energy", name, "digits")["mean"] for name in results.policies}) == 1
    json.loads(results.to_json())


def test_the_two_interfaces_agree_where_no_action_saturates():
    policies = [
        PolicySpec("physical", laws.Static),
        PolicySpec("local", laws.Static, ptne_env.Interface("scaled")),
    ]
    results = evaluate(policies, [ptne_env.get_scenario("energy", start="random")], episodes=5)
    physical, local = (results.record("energy", name, "digits")["mean"] for name in ("physical", "scaled"))
    assert local == pytest.approx(physical, abs=1e-5)


def test_every_default_policy_acts_on_every_scenario_of_the_catalogue():
    results = evaluate(COMPARED, list(ptne_env.CATALOGUE), episodes=2, hold_steps=3)
    assert not results.failures
    assert len(results.samples) == len(COMPARED) * len(ptne_env.CATALOGUE)
    assert not results.not_applicable
    # The reference policies bracket the laws: zero input is worse than the static law, full information is better.
    for scenario in ("energy", "energy-switching", "energy-switching-transformed", "non-quadratic", "random-energy"):
        digits = [results.record(scenario, name, "digits")["mean"] for name in ("zero-input", "static", "oracle")]
        assert digits == sorted(digits)


def test_an_oracle_by_address_brings_the_interface_that_it_needs():
    results = evaluate(["oracle", "ptne_env.laws:CentralisedOracle"], ["energy", "random-energy"], episodes=2)
    for track in results.episodes:
        named, by_address = (results.record(track, name, "digits") for name in results.policies)
        assert named["mean"] == by_address["mean"] > 11


def test_scenarios_that_draw_games_draw_another_in_every_episode():
    results = evaluate(["static"], ["random-energy", "random-energy-switching"], episodes=3)
    assert len({float(value) for samples in results.samples.values() for value in samples["digits"][0]}) == 6


@pytest.mark.parametrize("policies", [["static", "zero-input"], ["ppo-random-energy"]])
def test_progress_is_reported_once_per_job(monkeypatch, policies):
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 2)
    calls = []
    results = evaluate(
        policies, ["energy"], episodes=1, against_laws=True, progress=lambda *arguments: calls.append(arguments)
    )
    trials = [trial for found in results.trials.values() for trial in found]
    searches = len(tuning.FIELD) * (policies == ["ppo-random-energy"])
    assert len(trials) == searches
    assert len(calls) == len(results.jobs) + searches + len(trials)
    work = [done for _, done, _ in calls]
    assert work == sorted(set(work))
    assert {total for *_, total in calls} == {work[-1]}  # the work of tuned laws is in it from the start


def test_an_environment_in_the_place_of_a_scenario_is_refused():
    with pytest.raises(TypeError, match=r"got a NashSeekingEnv; the scenario of an environment is env\.scenario"):
        evaluate("static", ptne_env.parallel_env("energy"))


def test_an_own_scenario_is_evaluated_without_a_search_for_tuned_laws(monkeypatch):
    monkeypatch.setattr(tuning.Tuning, "find", lambda search: pytest.fail("a search takes minutes"))
    results = evaluate([PolicySpec("mine", laws.Static)], ptne_env.get_scenario("random-energy", steps=50), episodes=2)
    assert results.tuned == {}


def test_quick_jobs_run_first():
    done = []
    evaluate(["static", "grounded"], ["robots", "energy"], episodes=2, progress=lambda job, *_: done.append(job))
    assert done == ["energy: static", "energy: grounded", "robots: static", "robots: grounded"]


@pytest.mark.parametrize("rerun", [False, True])
def test_a_law_under_two_names_is_run_once(monkeypatch, tmp_path, rerun):
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 2)
    law = FactorySpec.of("ptne_env.laws:Static", kappa=5.0)
    chosen = {group: PolicySpec(name, law) for group, name in tuning.GROUPS.items()}
    monkeypatch.setattr(tuning, "best", lambda found: chosen)
    policies = [PolicySpec("same", law), "ppo-random-energy"]
    results = evaluate(policies, ["random-energy"], episodes=2, against_laws=True, folder=tmp_path, rerun=rerun)
    times = {
        results.samples["random-energy", name]["microseconds_per_decision"].tobytes()
        for name in ("same", *tuning.GROUPS.values())
    }
    assert len(times) == 1
    (tmp_path / "results.json").write_text(results.to_json())
    assert not check(tmp_path, sample=1).differences


def test_results_do_not_depend_on_the_number_of_processes(monkeypatch):
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 5)
    one, two = (
        evaluate(["static", "random", "ppo-random-energy"], ["random-energy"], episodes=3, workers=Workers(jobs))
        for jobs in (1, 2)
    )
    assert untimed(one) == untimed(two)
    assert one.tuned == two.tuned
    assert list(one.samples) == list(two.samples)


@pytest.mark.parametrize(
    ("policies", "scenarios", "message"),
    [
        (["statics"], ["energy"], "unknown policy 'statics'; did you mean 'static'"),
        (["static"], ["energie"], "unknown scenario 'energie'; did you mean 'energy'"),
        (
            ["static", "static"],
            ["energy"],
            "different names, got static, static; a file gets another name by 'name=path'",
        ),
        (["static"], ["energy", "energy"], "needs different scenarios; energy would"),
        ([], ["energy"], "at least one policy"),
        (["static"], [], "needs at least one scenario"),
        (["no.such.module:thing"], ["energy"], "cannot import"),
        (["ptne_env.laws:NoSuchLaw"], ["energy"], "has no 'NoSuchLaw'"),
        ([PolicySpec("blind", laws.CentralisedOracle, ptne_env.Interface("physical"))], ["energy"], "interface 'full'"),
        (["ppo-random-energy"], ["robots"], "fits no track: the policy was made for another layout"),
    ],
)
def test_wrong_arguments_of_a_comparison_are_refused(policies, scenarios, message):
    with pytest.raises(ValueError, match=message):
        evaluate(policies, scenarios, episodes=1)


@pytest.mark.parametrize(("episodes", "seed"), [(0, 0), (1, -1), (1.5, 0)])
def test_counts_out_of_range_are_refused(episodes, seed):
    with pytest.raises(ValueError, match="whole number"):
        evaluate(["static"], ["energy"], episodes=episodes, seed=seed)


def test_a_policy_is_not_applicable_where_it_does_not_fit_or_is_not_meant_for():
    bound = PolicySpec("bound", FactorySpec.of("ptne_env.laws:ZeroInput"), scenarios=frozenset({"energy"}))
    results = evaluate([bound, "static", "ppo-random-energy"], ["energy", "robots"], episodes=2, against_laws=False)
    assert set(results.policies_on("robots")) == {"static"}
    assert results.not_applicable["robots", "bound"] == "it is run on energy only"
    assert "action_dims" in results.not_applicable["robots", "ppo-random-energy"]
    with pytest.raises(KeyError, match="'bound' on track 'robots': it is run on energy only"):
        results.record("robots", "bound", "digits")


def test_a_policy_of_ones_own_gets_the_same_records(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "my_law.py").write_text(
        "import ptne_env\n\ndef make(layout):\n    return ptne_env.laws.Static(layout)\n"
    )
    results = run_suite(SMALL, ["my_law:make"])
    for track in ("ring", "complete"):
        assert results.summary(track, "my_law:make", "digits") == results.summary(track, "static", "digits")


def test_training_seeds_of_one_policy_share_a_row(tmp_path):
    source = Path(ptne_env.__file__).parent / "policies" / "ppo-random-energy.onnx"
    for seed in range(3):
        folder = tmp_path / f"seed-{seed}"
        folder.mkdir()
        (folder / "policy.onnx").write_bytes(source.read_bytes())
    results = run_suite(SMALL, [f"mine={tmp_path}/seed-*/policy.onnx"], tracks=["ring"])
    assert len(results.policies["mine"].training_seeds) == 3
    assert results.samples["ring", "mine"]["digits"].shape == (3, 5)
    assert results.record("ring", "mine", "digits")["mean"] > results.record("ring", "static", "digits")["mean"]


def test_names_that_clash_are_refused():
    with pytest.raises(ValueError, match="different names"):
        run_suite(SMALL, ["grounded", "grounded"])
    with pytest.raises(ValueError, match="reference policy"):
        run_suite(SMALL, [PolicySpec("static", FactorySpec.of("ptne_env.laws:ZeroInput"))])
    with pytest.raises(ValueError, match="'best of all laws' is the name of a tuned law"):
        evaluate([PolicySpec("best of all laws", laws.ZeroInput)], ["energy"], episodes=2)


def test_a_comparison_needs_different_scenarios_and_episodes():
    with pytest.raises(ValueError, match="at least one scenario"):
        evaluate(["static"], [])
    with pytest.raises(ValueError, match="different scenarios; energy would be run more than once"):
        evaluate(["static"], ["energy", "energy"])
    with pytest.raises(ValueError, match="^episodes must be"):
        evaluate(["static"], ["energy"], episodes=0)


class Wrong:
    def __init__(self, layout):
        self.layout = layout

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return np.full((len(observation), self.layout.action_size), np.nan), state


def test_a_failing_policy_costs_its_own_jobs_alone():
    results = run_suite(SMALL, ["grounded", PolicySpec("wrong", Wrong)])
    text = "step 0: it answered with an action that is not finite; expected numbers without NaN or inf"
    assert results.failures == {("ring", "wrong"): text, ("complete", "wrong"): text}
    assert untimed(run_suite(SMALL, ["grounded"])) == untimed(results)
    assert results.to_dict()["failures"][0] == {"track": "ring", "policy": "wrong", "reason": text}
    with pytest.raises(KeyError, match="not finite"):
        results.record("ring", "wrong", "digits")


def test_a_policy_that_fails_on_a_track_counts_as_zero_input_there():
    once = Suite("once", (SMALL.tracks[0], Track("loop", BASE.replace(steps=121), "One more step.")), episodes=3)
    results = run_suite(once, ["grounded", PolicySpec("late", Late)])
    assert results.failures == {("loop", "late"): results.failures["loop", "late"]}
    assert results.failures["loop", "late"].startswith("step 120: RuntimeError: too late (test_run.py, line ")
    board = results.leaderboard
    (late,) = (row for row in board.overall if row.policy == "late")
    assert late.score.mean == pytest.approx(board.row("ring", "late").score.mean / 2)
    assert board.row("loop", "late") is None


class Late:
    """The static law, for 120 steps."""

    def __init__(self, layout):
        self.law, self.steps = laws.Static(layout), 0

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        if self.steps == 120:
            raise RuntimeError("too late")
        self.steps += 1
        return self.law.predict(observation, state, episode_start, deterministic)


def test_a_reference_policy_that_fails_ends_the_run(monkeypatch):
    monkeypatch.setattr(laws.Static, "inputs", lambda law, observation, memory: (1 / 0, memory))
    with pytest.raises(RuntimeError, match=r"reference policy 'static' fails on track 'ring': step 0: ZeroDivision"):
        run_suite(SMALL, [])


def test_messages_and_bits_are_those_of_the_live_links():
    results = run_suite(get_suite("ptne-v1"), [], tracks=["nominal", "switching-physical"], episodes=2)
    for track, links in (("nominal", 10), ("switching-physical", 4)):
        samples = results.samples[track, "static"]
        assert samples["messages"].tolist() == [[400 * links] * 2]
        assert samples["bits"].tolist() == [[400 * links * 5 * 32] * 2]


def test_regret_and_log_error_area_of_zero_input_follow_from_its_start():
    samples = run_suite(SMALL, [], tracks=["ring"], episodes=3).samples["ring", "zero-input"]
    expected = np.log10(samples["estimate_distance"])
    np.testing.assert_allclose(samples["log_error_area"], expected, rtol=1e-12)
    env, episodes = ptne_env.parallel_env(BASE, reward="regret"), SMALL.episode_set("ring")
    for episode in range(3):
        env.reset(seed=episodes.episode_seed(episode))
        while env.agents:
            _, rewards, *_ = env.step({agent: np.zeros(5, dtype=np.float32) for agent in env.agents})
        assert samples["regret"][0, episode] == pytest.approx(-sum(rewards.values()), rel=1e-12)


def test_every_policy_runs_on_every_track_of_ptne_v1_or_has_a_reason():
    from ptne_env.evaluation import suite_policies
    from ptne_env.learn import shipped

    # On the large tracks a few steps tell as much as 400: a policy fails on its layout, or in its first decisions.
    tracks = (
        replace(track, scenario=track.scenario.replace(steps=40)) if track.name.startswith("large") else track
        for track in get_suite("ptne-v1").tracks
    )
    suite, policies = Suite("short", tuple(tracks)), suite_policies()
    results = run_suite(suite, policies, episodes=1)
    for (track, _), samples in results.samples.items():
        assert np.isfinite(samples[suite.track(track).metric]).all()
    refused = {}
    for track, policy in results.not_applicable:
        refused.setdefault(policy, set()).add(track)
    # Policies with sizes were made for five players of one component each with two neighbour slots, or with the four of
    # the unseen graphs; no best response exists in Example 2; the freshest copies need a known schedule.
    learned = {name: {"large-20", "large-50", "unseen-graphs", "robots"} for name in shipped() if name != "size-free"}
    learned["ppo-ptne-v1-unseen-graphs"] = {track.name for track in suite.tracks} - {"unseen-graphs"}
    assert len(learned) >= 9
    unscheduled = {"markov", "unseen-graphs"}
    laws = {"freshest": unscheduled, "freshest-relay": unscheduled}
    assert refused == {**learned, **laws}
    assert len(results.samples) + len(results.not_applicable) == len(suite.tracks) * len(policies)


def test_one_track_of_a_suite_may_be_a_scenario_with_an_episode_of_its_own():
    suite = Suite("mixed", (Track("ring", BASE, "The base."), Track("once", BASE, "Once.", episodes=1)), episodes=3)
    assert run_suite(suite, [], episodes=2).episodes == {"ring": 2, "once": 1}


class Broken(laws.Static):
    """A law with a mistake of its own."""

    def __init__(self, layout):
        raise ValueError("a mistake of my own")


def test_only_a_layout_error_makes_a_policy_not_applicable():
    broken = [
        PolicySpec("broken", Broken),
        PolicySpec("nothing", lambda layout: object()),
        PolicySpec("uncalled", object),
        PolicySpec("alone", SimpleNamespace(predict=lambda rows, *_, **__: np.zeros((len(rows), 5)))),
    ]
    results = evaluate(["static", *broken], ["energy"], episodes=1, against_laws=False)
    assert results.failures["energy", "broken"].startswith("it cannot be built: ValueError: a mistake of my own")
    assert results.failures["energy", "nothing"] == "it is a object without predict(observation, state, ...)"
    assert "; it is called with the layout" in results.failures["energy", "uncalled"]
    assert results.failures["energy", "alone"] == "step 0: predict returns (actions, state), got a ndarray alone"
    assert not results.not_applicable
