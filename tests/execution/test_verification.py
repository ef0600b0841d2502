"""The verification of published results: forgeries are refused by name, jobs repeat, and fresh episodes are as good."""

import re
from functools import partial

import numpy as np
import pytest
from small_suite import SMALL, write_results

from ptne_env import FactorySpec, PolicySpec, evaluate, laws
from ptne_env.evaluation.results import Results
from ptne_env.execution.verification import verify
from ptne_env.learn import shipped_path
from ptne_env.shared.parts import PARTS
from ptne_env.suites import run_suite


@pytest.fixture(autouse=True, scope="module")
def published_suite():
    """A small suite is published under its name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PARTS, "suite:small-v1", "small_suite:SMALL")
        yield


@pytest.fixture(scope="module")
def data(published_suite):
    own = PolicySpec("mine", FactorySpec.of("law:grounded", kappa=3.0))
    return run_suite("small-v1", ["grounded", "relay", "ppo-random-energy", own]).to_dict()


@pytest.fixture
def written(data, tmp_path):
    """Writes results with a change, and with the checksum that fits."""

    return partial(write_results, tmp_path, data)


def samples_of(data, policy="grounded", track="ring"):
    return data["samples"][track][policy]


def rebuild(data):
    """Let the tables follow from changed samples."""
    data["records"] = Results.from_dict(data).to_dict()["records"]


def swap(data, other="oracle"):
    """The samples of another policy stand in the rows of the grounded law, and the table follows from them."""
    for track in ("ring", "complete"):
        data["samples"][track]["grounded"] = data["samples"][track][other]
    rebuild(data)


# --- the file -------------------------------------------------------------------------------------------------------


def strike(data, track="complete"):
    """A track is struck, with everything that belongs to it."""
    data["tracks"] = [one for one in data["tracks"] if one["name"] != track]
    for kind in ("not_applicable", "records"):
        data[kind] = [one for one in data[kind] if one["track"] != track]
    for kind in ("samples", "timings", "episodes"):
        del data[kind][track]


def add_ghost(data):
    for kind in ("samples", "timings"):
        data[kind]["ring"]["ghost"] = data[kind]["ring"]["oracle"]
    rebuild(data)


def exchange_names(data):
    for policy, name in zip(data["policies"], ("relay", "grounded"), strict=False):
        policy["name"] = name


def of_policy(data, name):
    return next(policy for policy in data["policies"] if policy["name"] == name)


def leave_out(data, name):
    """A policy is struck everywhere."""
    data["policies"].remove(of_policy(data, name))
    for kind in ("samples", "timings"):
        for policies in data[kind].values():
            del policies[name]
    rebuild(data)


def episodes_of_other_seed(data):
    data["episodes"]["ring"]["seed"] = 7


def fewer_episodes(data):
    for track, drawn in data["episodes"].items():
        drawn["count"] = 3
        for samples in data["samples"][track].values():
            for values in samples.values():
                values[:] = [numbers[:3] for numbers in values]
    rebuild(data)


def empty(data):
    data["tracks"] = []
    for record in data["records"]:
        record.update(mean=12.0, low=12.0, high=12.0)


def nothing(data):
    data.update(tracks=[], episodes={}, samples={}, timings={}, records=[], not_applicable=[])


def without_bad_episodes(data):
    for name in ("digits", "digits_on_the_way"):
        samples_of(data, "mine")[name][0][1:3] = [None, None]
    rebuild(data)


def repeat_training_seed(data):
    """Five copies of one training seed have a short interval."""
    sources = of_policy(data, "mine")["training_seeds"]
    sources *= 5
    for kind in ("samples", "timings"):
        for policies in data[kind].values():
            for values in policies["mine"].values():
                values.extend(values * 4)
    rebuild(data)


def hide_as_not_applicable(data):
    data["not_applicable"].append({"track": "ring", "policy": "grounded", "reason": "it is too good"})


def of_record(data, **changes):
    record = next(one for one in data["records"] if (one["policy"], one["metric"]) == ("mine", "digits"))
    record.update({key: value(record[key]) for key, value in changes.items()})


def small_numbers(data):
    """A distance that rounds to 0 is printed all the same."""
    distances = [one for one in data["records"] if one["metric"] == "estimate_distance" and one["mean"] > 1e-14]
    smallest = min(distances, key=lambda one: one["mean"])
    assert smallest["mean"] < 1e-6
    smallest["mean"] /= 2


FORGERIES = {
    "no track": (nothing, "no track or no policy is listed"),
    "no track, and numbers that nobody checks": (empty, "the tracks are , but there are episodes of ring, complete"),
    "no policy": (lambda data: data["policies"].clear(), "no track or no policy is listed"),
    "a track struck from the list": (lambda data: data["tracks"].pop(), "the tracks are ring, but there are episodes"),
    "a track struck everywhere": (strike, "tracks complete is missing"),
    "a track listed twice": (lambda data: data["tracks"].append(data["tracks"][0]), "tracks are ring, complete, ring"),
    "samples of a policy that is not listed": (add_ghost, "ghost on ring has 1 results"),
    "no samples of a listed policy": (
        lambda data: data["samples"]["ring"].pop("grounded"),
        "grounded on ring has other metrics",
    ),
    "no result of a listed policy": (lambda data: data["not_applicable"].clear(), "ppo-.* on complete has 0 results"),
    "n/a beside numbers": (hide_as_not_applicable, "grounded on ring has 2 results"),
    "n/a without a reason": (lambda data: data["not_applicable"][0].update(reason=""), "has no numbers and no reason"),
    "n/a twice": (lambda data: data["not_applicable"].append(data["not_applicable"][0]), "not_applicable is"),
    "an empty track in samples": (lambda data: data["samples"].update(ghost={}), "samples ghost is of nothing"),
    "the same training seed twice": (
        repeat_training_seed,
        "training seeds of policy mine are the same policy",
    ),
    "versions that are none": (lambda data: data.update(versions=5), "versions is 5"),
    "no arithmetic": (lambda data: data.pop("arithmetic"), "arithmetic is missing"),
    "an unknown key": (lambda data: data.update(score=12.0), "score is of nothing"),
    "no suite": (lambda data: data.update(suite=None), "suite is None, expected 'small-v1'"),
    "another name": (lambda data: data.update(name="ptne-v2"), "name is 'ptne-v2', expected 'small-v1'"),
    "perfect channels": (
        lambda data: data["tracks"][0]["scenario"].update(steps=800),
        "tracks ring scenario steps is 800, expected 120",
    ),
    "perfect channels without a suite": (
        lambda data: (data.update(suite=None), data["tracks"][0]["scenario"].update(steps=800)),
        "tracks ring scenario steps is 800, expected 120",
    ),
    "a track that does not count": (
        lambda data: data["tracks"][1].update(scored=False),
        "tracks complete scored is False",
    ),
    "other episodes on one track": (episodes_of_other_seed, "episodes complete seed is 0, expected 7"),
    "episodes of another suite": (
        lambda data: data["episodes"]["ring"].update(track=["mine", "ring"]),
        "episodes ring track 0 is 'mine', expected 'small-v1'",
    ),
    "episodes of the training": (
        lambda data: [drawn.update(split="train") for drawn in data["episodes"].values()],
        "episodes ring split is 'train', expected 'test'",
    ),
    "fewer episodes": (fewer_episodes, "episodes ring count is 3, expected 5"),
    "exchanged names": (exchange_names, "policies grounded training_seeds 0 .*law:relay.*law:grounded"),
    "a better reference policy": (
        lambda data: of_policy(data, "static")["training_seeds"][0].update(arguments={"kappa": 9.0}),
        "policies static training_seeds 0 arguments kappa is 9.0, expected 2.0",
    ),
    "no reference policy": (lambda data: leave_out(data, "static"), "the reference policy static is missing"),
    "another file of a policy": (
        lambda data: of_policy(data, "ppo-random-energy")["training_seeds"][0].update(sha256="0" * 64),
        "policies ppo-random-energy training_seeds 0 sha256 is '0",
    ),
    "a record that is too high": (lambda data: of_record(data, mean=lambda mean: mean + 1), "digits mine ring mean is"),
    "a lower end that is too high": (
        lambda data: of_record(data, low=lambda low: low + 0.1),
        "digits mine ring low is",
    ),
    "an upper end that is too high": (
        lambda data: of_record(data, high=lambda high: high + 0.1),
        "digits mine ring high is",
    ),
    "more episodes in a record": (lambda data: of_record(data, episodes=lambda _: 200), "digits mine ring episodes is"),
    "a small distance that is smaller": (small_numbers, "records estimate_distance .* mean is"),
    "no record": (lambda data: data["records"].pop(), "records .* is missing"),
    "a record twice": (lambda data: data["records"].append(data["records"][0]), "records is"),
    "records that are none": (lambda data: data.update(records=[5]), r"records is \[5\]"),
    "more than all digits": (lambda data: samples_of(data)["digits"][0].__setitem__(2, 12.5), "digits of grounded on"),
    "a negative time": (
        lambda data: samples_of(data)["settling_time"][0].__setitem__(2, -1.0),
        "settling_time of grounded on ring is outside its range",
    ),
    "bad episodes without a value": (without_bad_episodes, "digits of mine on ring is outside its range"),
    "samples without their record": (
        lambda data: samples_of(data)["digits"][0].__setitem__(2, 3.0),
        "records digits grounded ring mean is",
    ),
    "too few samples": (lambda data: samples_of(data)["digits"].__setitem__(0, [1.0]), "has the shape"),
    "a metric left out": (lambda data: samples_of(data).pop("regret"), "other metrics than a run gives: regret"),
    "a metric that is none": (
        lambda data: samples_of(data).update(glory=samples_of(data)["digits"]),
        "other metrics than a run gives: glory",
    ),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_a_forged_file_is_refused_by_name_before_any_job_runs(name, written):
    forge, fault = FORGERIES[name]
    outcome = verify(written(forge))
    assert not outcome.passes
    assert outcome.repetitions == ()
    assert any(re.search(fault, text) for text in outcome.differences), outcome.differences


# --- jobs that run again --------------------------------------------------------------------------------------------


def test_honest_results_pass_with_two_jobs_of_every_policy(written, data):
    outcome = verify(written())
    assert outcome.passes
    assert outcome.same_arithmetic
    assert outcome.differences == ()
    assert outcome.jobs == 2 * 7
    assert {one.difference for one in outcome.repetitions} == {0.0}
    assert [one.policy for one in outcome.repetitions[::2]] == [policy["name"] for policy in data["policies"]]
    assert {one.policy for one in outcome.repetitions if one.fresh is not None} == {"mine"}
    choices = {tuple(one.track for one in verify(written(), sample=1, seed=seed).repetitions) for seed in (1, 1, 2)}
    assert len(choices) == 2


def test_numbers_of_another_policy_are_found_by_running_jobs_again(written):
    outcome = verify(written(swap))
    assert outcome.differences == ()
    assert not outcome.passes
    assert {one.policy for one in outcome.repetitions if not one.agrees} == {"grounded"}


@pytest.mark.parametrize(
    ("kind", "reason"), [("failures", "step 3: oops"), ("not_applicable", "it is too good for this track")]
)
def test_a_failure_or_a_refusal_that_does_not_repeat_is_reported(written, kind, reason):
    def change(data):
        del data["samples"]["ring"]["grounded"], data["timings"]["ring"]["grounded"]
        data[kind].append({"track": "ring", "policy": "grounded", "reason": reason})
        rebuild(data)

    for seed in (1, 2, 3):  # whatever else is drawn
        outcome = verify(written(change), sample=1, seed=seed)
        assert outcome.differences == ()
        assert [(one.track, one.policy) for one in outcome.repetitions if not one.agrees] == [("ring", "grounded")]


def declare_another_machine(data):
    data["versions"]["numpy"] = "1.0"


def shift(data, by):
    """Move the digits of all jobs of the grounded law by so many standard errors."""
    for track in ("ring", "complete"):
        (values,) = samples_of(data, track=track)["digits"]
        error = np.std(values, ddof=1) / len(values) ** 0.5
        samples_of(data, track=track)["digits"] = [[min(value + by * error, 12.0) for value in values]]
    rebuild(data)
    declare_another_machine(data)


def round_elsewhere(data):
    """Change numbers as another machine does: most a little, and one episode by more, in either direction."""
    for policies in data["samples"].values():
        for samples in policies.values():
            values = np.array(samples["digits"])
            values += 1e-7 * np.array([1, -1, 1, -1, 1])
            values[:, 2] -= 0.3
            samples["digits"] = values.clip(max=12.0).tolist()
    rebuild(data)
    declare_another_machine(data)


def test_results_of_another_machine_differ_from_ours_by_rounding(written):
    outcome = verify(written(round_elsewhere))
    assert not outcome.same_arithmetic
    assert outcome.passes, outcome
    assert max(one.difference for one in outcome.repetitions if one.difference is not None) > 1e-3


@pytest.mark.parametrize("by", [-3.5, 3.5])
def test_another_machine_does_not_shift_all_episodes_in_either_direction(written, by):
    outcome = verify(written(partial(shift, by=by)))
    assert not outcome.same_arithmetic
    assert outcome.differences == ()
    assert [(one.policy, one.agrees) for one in outcome.repetitions if not one.agrees] == [("grounded", False)] * 2


def test_on_another_machine_numbers_of_other_episodes_do_not_agree(written):
    def forge(data):
        for track in ("ring", "complete"):
            samples_of(data, track=track)["digits"] = [sorted(*samples_of(data, track=track)["digits"])]
        swap(data, "relay")
        declare_another_machine(data)

    assert {one.policy for one in verify(written(forge)).repetitions if not one.agrees} == {"grounded"}


def test_another_machine_does_not_halve_distances(written):
    def forge(data):
        for track in ("ring", "complete"):
            (distances,) = samples_of(data, track=track)["strategy_distance"]
            samples_of(data, track=track)["strategy_distance"] = [[value / 2 for value in distances]]
        rebuild(data)
        declare_another_machine(data)

    assert {one.policy for one in verify(written(forge)).repetitions if not one.agrees} == {"grounded"}


def test_a_single_episode_of_another_machine_is_compared_too(tmp_path):
    data = evaluate("grounded", "energy").to_dict()
    declare_another_machine(data)
    assert verify(write_results(tmp_path, data)).passes

    def forge(data):
        samples_of(data, track="energy")["digits"] = [[11.0]]
        rebuild(data)

    assert not verify(write_results(tmp_path, data, forge)).passes


class Memory(laws.Grounded):
    """A policy that acts where it has stored the first observation, and does nothing in other episodes."""

    stored, learns = set(), False

    def initial_memory(self, rows):
        return np.full((rows, 1), np.nan)

    def inputs(self, observation, memory):
        keys = [row.tobytes() for row in observation.own_estimate]
        if self.learns and np.isnan(memory).any():
            self.stored.update(keys)
        known = np.array([[key in self.stored] for key in keys])
        memory = np.where(np.isnan(memory), known, memory)
        return super().inputs(observation, None)[0] * memory, memory


def test_a_policy_that_has_stored_the_published_episodes_fails_on_fresh_ones(tmp_path, monkeypatch):
    policy = PolicySpec("memory", FactorySpec.of(Memory))
    with monkeypatch.context() as patch:
        patch.setattr(Memory, "learns", True)
        evaluate(policy, SMALL.tracks[0], episodes=20)
    results = evaluate(policy, SMALL.tracks[0], episodes=20)
    folder = write_results(tmp_path, results.to_dict())
    (repetition,) = verify(folder, trust=True).repetitions
    assert repetition.difference == 0.0
    assert repetition.fresh < results.record("ring", "memory", "digits")["mean"] - 1
    assert not repetition.agrees
    assert re.match(r"with the fresh seed: .*\d\.\d\d digits are -?\d\.\d\d", repetition.reason)
    with pytest.raises(ValueError, match="the results have the seed 0: fresh episodes need another one"):
        verify(folder, trust=True, seed=0)


def test_a_failure_of_no_training_seed_does_not_repeat(tmp_path):
    policy = PolicySpec("mine", (FactorySpec.of("law:grounded", kappa=3.0), FactorySpec.of("law:grounded", kappa=4.0)))
    data = evaluate(["static", policy], SMALL.tracks[0], episodes=2).to_dict()
    for kind in ("samples", "timings"):
        del data[kind]["ring"]["mine"]
    data["failures"].append({"track": "ring", "policy": "mine", "reason": "step 3: oops"})
    data["records"] = [one for one in data["records"] if one["policy"] == "static"]
    outcome = verify(write_results(tmp_path, data))
    assert outcome.differences == ()
    assert {one.policy for one in outcome.repetitions if not one.agrees} == {"mine"}


def test_policy_files_lie_beside_the_results(tmp_path):
    file = tmp_path / "here" / "mine.npz"
    file.parent.mkdir()
    file.write_bytes(shipped_path("ppo-random-energy").read_bytes())
    results = evaluate([str(file), "static"], SMALL.tracks[0], episodes=2)
    there = tmp_path / "there"
    there.mkdir()
    (there / "results.json").write_text(results.to_json(), encoding="utf-8")
    file.rename(there / "renamed.npz")
    assert verify(there).passes
    (there / "renamed.npz").unlink()
    with pytest.raises(FileNotFoundError, match=r"mine\.npz"):
        verify(there)


def test_results_of_objects_are_refused(tmp_path):
    path = tmp_path / "objects.json"
    path.write_text(evaluate(PolicySpec("mine", laws.Static), SMALL.tracks[0], episodes=1).to_json())
    with pytest.raises(ValueError, match="policy 'mine' was an object"):
        verify(path)
