"""Forged results: kinds of changes to ``results.json`` and to the files of jobs, with their checksums computed again.

Published results are one JSON object with the keys ``results`` and ``jobs``, the latter by name of file. A place is a
path in it, where ``*`` stands for any key or index. A forgery changes the object in place.
"""

import copy
import json

from ptne_env.evaluation.provenance import content_hash, file_hashes
from ptne_env.shared.parts import FactorySpec

MARK = "code-of-forged-results-ran"
"""File or folder that the code in forged results makes in the working folder."""

FORGED_MODULE = f"import pathlib; pathlib.Path({MARK!r}).touch(); anything = None"
"""The code of ``forged_module.py``, which forged results import."""


class UnfitError(Exception):
    """There is nothing to forge in this way."""


def places(value, path):
    """All ``(container, key)`` that a path matches."""
    first, _, rest = path.partition("/")
    keys = range(len(value)) if isinstance(value, list) else list(value) if isinstance(value, dict) else []
    found = [key for key in keys if first in ("*", key)]
    if not rest:
        return [(value, key) for key in found]
    return [place for key in found for place in places(value[key], rest)]


def some(random, found):
    """A random one of the items."""
    if not found:
        raise UnfitError
    return found[random.integers(len(found))]


# New values: functions of the old value, the published object and the generator of random numbers.
def more(value, data, random):
    """A larger number of the same type."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return value + (1 if isinstance(value, int) else 0.5) * int(random.integers(1, 9)) if is_number else value


def first(value, data, random):
    """The best rank."""
    return 1 if isinstance(value, int | float) else value


def text(value, data, random):
    """The same as a string."""
    return str(value)


def same(new):
    """The same value everywhere."""
    return lambda value, data, random: new


def another(path):
    """Another value, of another place."""

    def change(value, data, random):
        found = [container[key] for container, key in places(data, path)]
        return some(random, [other for other in found if other != value])

    return change


def digit(value, data, random):
    """A hash with another first digit."""
    return ("0" if value[0] != "0" else "1") + value[1:]


SCALES = "results/leaderboard/scales/*"
ROWS, OVERALL = "results/leaderboard/rows/*", "results/leaderboard/overall/*"
POLICIES, RECORDS, LISTED = "results/policies/*", "results/records/*", "results/jobs/*"
NAMES, TRACKS = another(f"{POLICIES}/name"), another("results/suite/tracks/*/name")

CHANGES = {
    "the mean of a record": (f"{RECORDS}/mean", more),
    "the lower end of an interval": (f"{RECORDS}/low", more),
    "the upper end of an interval": (f"{RECORDS}/high", more),
    "a mean hidden": (f"{RECORDS}/mean", same(None)),
    "a mean as text": (f"{RECORDS}/mean", text),
    "the episodes of a record": (f"{RECORDS}/episodes", more),
    "the policy of a record": (f"{RECORDS}/policy", NAMES),
    "the track of a record": (f"{RECORDS}/track", TRACKS),
    "the metric of a record": (f"{RECORDS}/metric", another(f"{RECORDS}/metric")),
    "a measured time": ("results/timings/*/mean", more),
    "the rank of a row": (f"{ROWS}/rank", first),
    "no rank, as an oracle": (f"{ROWS}/rank", same(None)),
    "the score of a row": (f"{ROWS}/score/mean", more),
    "the interval of a score": (f"{ROWS}/score/low", more),
    "the improvement of a row": (f"{ROWS}/improvement/mean", more),
    "the fine time of a row": (f"{ROWS}/fine_time", more),
    "the success of a row": (f"{ROWS}/success/*", more),
    "the policy of a row": (f"{ROWS}/policy", NAMES),
    "the track of a row": (f"{ROWS}/track", TRACKS),
    "the overall score": (f"{OVERALL}/score/mean", more),
    "the overall improvement": (f"{OVERALL}/improvement/mean", more),
    "the mean rank": (f"{OVERALL}/mean_rank", first),
    "the profile": (f"{OVERALL}/profile/*", more),
    "the overall policy": (f"{OVERALL}/policy", NAMES),
    "the thresholds of the profile": ("results/leaderboard/thresholds/*", more),
    "the errors of the success": ("results/leaderboard/errors/*", more),
    "a saturated track": ("results/leaderboard/saturated", same(["unseen-graphs"])),
    "the full marks of a track": (f"{SCALES}/full_marks", more),
    "the room of a track": (f"{SCALES}/room", more),
    "a track without scores": (f"{SCALES}/has_scores", same(None)),
    "the best known digits of a track": ("results/suite/tracks/*/best_known", same(3.0)),
    "no leaderboard": ("results/leaderboard", same(None)),
    "the name of a policy": (f"{POLICIES}/name", same("entirely new")),
    "the gain of a law": (f"{POLICIES}/training_seeds/*/arguments/kappa", more),
    "the class of a law": (f"{POLICIES}/training_seeds/*/target", another(f"{POLICIES}/training_seeds/*/target")),
    "the hash of a policy's file": (f"{POLICIES}/training_seeds/*/files/*", digit),
    "the memory of a policy": (f"{POLICIES}/knowledge/memory", same("none")),
    "the interface of a policy": (f"{POLICIES}/interface/kind", same("local")),
    "the unit of a policy": (f"{POLICIES}/interface/action_scale", more),
    "a policy for other scenarios only": (f"{POLICIES}/scenarios", same(["elsewhere"])),
    "the reason for n/a": ("results/not_applicable/*/reason", same("no reason")),
    "the track of an n/a": ("results/not_applicable/*/track", TRACKS),
    "the policy of an n/a": ("results/not_applicable/*/policy", NAMES),
    "the number of episodes": ("results/episodes/*", more),
    "the seed": ("results/seed", more),
    "the split": ("results/split", same("validation")),
    "an unknown split": ("results/split", same("easy")),
    "the format": ("results/format", more),
    "the policy of a failure": ("results/failures/*/policy", NAMES),
    "the suite by another address": ("results/suite/target", same("small_suite:SMALL")),
    "the hash of the suite": ("results/suite/content_hash", digit),
    "the name of the suite": ("results/suite/suite", same("ptne-v2")),
    "the episodes of the suite": ("results/suite/rules/episodes", more),
    "the reference laws of the suite": (
        "results/suite/rules/reference_policies/*/*/target",
        same("ptne_env.laws:Static"),
    ),
    "a suite as a comparison": ("results/suite/rules/is_comparison", same(new=True)),
    "the steps of a track": ("results/suite/tracks/*/scenario/steps", more),
    "the name of a track": ("results/suite/tracks/*/name", same("entirely new")),
    "the key of a job": (f"{LISTED}/key", digit),
    "the key of a job hidden": (f"{LISTED}/key", same(None)),
    "the key of a job as a path": (f"{LISTED}/key", same("../results")),
    "the key of a job as a list": (f"{LISTED}/key", same([1])),
    "the training seed of a job": (f"{LISTED}/training_seed", more),
    "the policy of a job": (f"{LISTED}/policy", NAMES),
    "the track of a job": (f"{LISTED}/track", TRACKS),
    "a version": ("results/versions/numpy", same("0.0")),
    "the hash of the sources": ("results/versions/sources", digit),
    "a number of one episode": ("jobs/*/samples/*/*", more),
    "the digits of one episode": ("jobs/*/samples/digits/*", same(12.0)),
    "a number of one episode hidden": ("jobs/*/samples/*/*", same(None)),
    "a number of one episode as text": ("jobs/*/samples/*/*", text),
    "a number of one episode as a list": ("jobs/*/samples/*/*", same([1.0])),
    "a number of one episode beyond all range": ("jobs/*/samples/*/*", same(1e300)),
    "all numbers of a metric as one": ("jobs/*/samples/*", same(12.0)),
    "all samples of a job": ("jobs/*/samples", same({})),
    "a job as n/a": ("jobs/*/not_applicable", same("it does not fit")),
    "the measured time of a job": ("jobs/*/timings/*", more),
    "the gain in a job": ("jobs/*/job/policy/arguments/kappa", more),
    "the seed in a job": ("jobs/*/job/episodes/seed", more),
    "the track in a job": ("jobs/*/job/track/name", TRACKS),
    "the versions in a job": ("jobs/*/job/versions/numpy", same("0.0")),
}
"""Kind: the place, and the new value."""

REMOVALS = {
    "a record removed": RECORDS,
    "a row removed": ROWS,
    "an overall row removed": OVERALL,
    "a policy removed": POLICIES,
    "an n/a removed": "results/not_applicable/*",
    "a failure removed": "results/failures/*",
    "a track removed": "results/episodes/*",
    "a listed job removed": LISTED,
    "a time removed": "results/timings/*",
    "a part of the results removed": "results/*",
    "the file of a job removed": "jobs/*",
    "an episode of a job removed": "jobs/*/samples/*/*",
    "a metric of a job removed": "jobs/*/samples/*",
}
"""Kind: the place of the removed item."""

REPETITIONS = {
    "a record twice": "results/records",
    "a row twice": "results/leaderboard/rows",
    "an overall row twice": "results/leaderboard/overall",
    "a policy twice": "results/policies",
    "a listed job twice": "results/jobs",
    "an n/a twice": "results/not_applicable",
    "an episode twice": "jobs/*/samples/*",
}
"""Kind: the place of the list, of which an item is repeated."""

EXCHANGES = {
    "the means of two records": f"{RECORDS}/mean",
    "the scores of two policies": f"{OVERALL}/score",
    "the places of two overall rows": OVERALL,
    "the names of two policies": f"{POLICIES}/name",
    "the parameters of two policies": f"{POLICIES}/training_seeds",
    "the keys of two jobs": f"{LISTED}/key",
    "the samples of two jobs": "jobs/*/samples",
    "the files of two jobs": "jobs/*",
    "two episodes of a job": "jobs/*/samples/digits/*",
}
"""Kind: the places, of which two exchange their values."""


def change(data, random, path, new):
    """Give one place a new value."""
    found = places(data, path)
    for index in random.permutation(len(found)):
        container, key = found[index]
        value = new(container[key], data, random)
        if value != container[key] or type(value) is not type(container[key]):
            container[key] = copy.deepcopy(value)
            return
    raise UnfitError


def remove(data, random, path):
    """Remove one item."""
    container, key = some(random, places(data, path))
    del container[key]


def repeat(data, random, path):
    """Repeat one item of a list."""
    container, key = some(random, places(data, path))
    if not isinstance(container[key], list):
        raise UnfitError
    container[key].append(copy.deepcopy(some(random, container[key])))


def exchange(data, random, path):
    """Exchange two different values of one kind."""
    found = places(data, path)
    container, key = some(random, found)
    others = [(other, place) for other, place in found if other[place] != container[key]]
    other, place = some(random, others)
    container[key], other[place] = other[place], container[key]


def _without(data, place):
    """Remove the records and the row of a track and policy."""
    results = data["results"]
    for holder, name in ((results, "records"), (results, "timings"), (results["leaderboard"], "rows")):
        holder[name] = [item for item in holder[name] if (item["track"], item["policy"]) != place]


def hide_track(data, random):
    """A policy's result on a track is taken out, and said not to apply."""
    record = some(random, data["results"]["records"])
    place = record["track"], record["policy"]
    _without(data, place)
    data["results"]["not_applicable"].append({"track": place[0], "policy": place[1], "reason": "another layout"})


def hide_failure(data, random):
    """A policy's result on a track is taken out without a word."""
    record = some(random, data["results"]["records"])
    _without(data, (record["track"], record["policy"]))


def add_failure(data, random):
    """A policy's result on a track is said to have failed."""
    record = some(random, data["results"]["records"])
    failure = {"track": record["track"], "policy": record["policy"], "reason": "it failed"}
    data["results"]["failures"] = [*data["results"].get("failures", []), failure]


def weaken_tuned_law(data, random):
    """Learned policies are compared with a weak law, which takes the place of the tuned one."""
    weak = next(policy for policy in data["results"]["policies"] if policy["name"] == "zero-input")
    law = {**copy.deepcopy(weak), "name": "best of all laws"}
    tuned = data["results"]["tuned_laws"]
    tuned[some(random, list(data["results"]["episodes"]))] = {"paper": law, "all": law}


def rename_job(data, random):
    """A job is that of a law with another gain, under the key of that job."""
    listed = some(random, [job for job in data["results"]["jobs"] if job["key"] in data["jobs"]])
    job = data["jobs"].pop(listed["key"])
    job["job"]["policy"]["arguments"] = {"kappa": 9.5}
    listed["key"] = content_hash(job["job"])
    data["jobs"][listed["key"]] = job


def raise_everywhere(data, random):
    """A policy reaches twelve digits in its job, and in the mean of its record."""
    jobs = {key for key, job in data["jobs"].items() if "digits" in job["samples"]}
    listed = some(random, [job for job in data["results"]["jobs"] if job["key"] in jobs])
    samples = data["jobs"][listed["key"]]["samples"]
    samples["digits"] = [12.0] * len(samples["digits"])
    for record in data["results"]["records"]:
        if (record["track"], record["policy"], record["metric"]) == (listed["track"], listed["policy"], "digits"):
            record["mean"] = record["low"] = record["high"] = 12.0


def replace_source(data, random, new):
    """A policy has another factory spec ``new(the present one)``, in the results, in its jobs and in their keys."""
    policy = some(random, data["results"]["policies"])
    source = policy["training_seeds"][0]
    spec = new(FactorySpec.of(source["target"], **source["arguments"]))
    source.update(json.loads(json.dumps({**spec.to_dict(), "files": file_hashes(spec)})))
    for listed in data["results"]["jobs"]:
        if listed["policy"] == policy["name"] and listed["key"] in data["jobs"]:
            job = data["jobs"].pop(listed["key"])
            job["job"]["policy"].update(source)
            listed["key"] = content_hash(job["job"])
            data["jobs"][listed["key"]] = job


def call(target, /, **arguments):
    """A forgery that makes a policy by a call."""
    return lambda data, random: replace_source(data, random, lambda _: FactorySpec.of(target, **arguments))


def call_inside(target, /, **arguments):
    """A forgery that makes an argument of a policy by a call."""
    value = FactorySpec.of(target, **arguments)
    return lambda data, random: replace_source(data, random, lambda spec: FactorySpec.of(spec.target, kappa=value))


def call_in_track(data, random):
    """A part of a track is made by a function of the operating system."""
    track = some(random, data["results"]["suite"]["tracks"])
    track["scenario"]["game"] = {"target": "os:mkdir", "arguments": {"path": MARK}}


STORIES = {
    "a bad track hidden as n/a": hide_track,
    "a bad track hidden": hide_failure,
    "a failure added": add_failure,
    "a weak tuned law": weaken_tuned_law,
    "a job of another law": rename_job,
    "twelve digits in job and record": raise_everywhere,
    "code as a policy": call("os:mkdir", path=MARK),
    "code in an argument": call_inside("os:mkdir", path=MARK),
    "code in a part of a track": call_in_track,
    "code behind a name in the library": call("ptne_env.learn.process:load_archive", path="forged.zip"),
    "code behind a function of the library": call_inside(
        "ptne_env.evaluation.metrics:import_module", name="forged_module"
    ),
    "a suite behind a function of the library": call_inside(
        "ptne_env.evaluation.suite:get_suite", suite="forged_module:anything"
    ),
    "an archive that says that it is trusted": call_inside(
        "ptne_env.evaluation.policy_specs:get_policy_spec", policy="forged.zip", trust=True
    ),
    "a file written by a function of the library": call_inside(
        "ptne_env.shared.files:write_atomically", path=MARK, content="written"
    ),
}
"""Kind: a function of the published object and the generator that changes several places."""


def _kinds():
    for kind, (path, new) in CHANGES.items():
        yield kind, lambda data, random, path=path, new=new: change(data, random, path, new)
    for function, paths in ((remove, REMOVALS), (repeat, REPETITIONS), (exchange, EXCHANGES)):
        for kind, path in paths.items():
            yield kind, lambda data, random, path=path, function=function: function(data, random, path)
    yield from STORIES.items()


KINDS = dict(_kinds())
"""All kinds of forgeries: functions of the published object, which they change, and a generator of random numbers."""


def sealed(content, unchecked=()):
    """A JSON object with the checksum that fits all but some of its keys."""
    checked = {key: value for key, value in content.items() if key not in ("checksum", *unchecked)}
    return {**content, "checksum": content_hash(checked)}


def read_published(folder):
    """The published object of a folder of results, without checksums."""
    paths = {"results": folder / "results.json", **{path.stem: path for path in sorted(folder.glob("jobs/*.json"))}}
    files = {name: json.loads(path.read_text(encoding="utf-8")) for name, path in paths.items()}
    for content in files.values():
        del content["checksum"]
    return {"results": files.pop("results"), "jobs": files}


def write_published(data, folder):
    """Write a published object into a new folder, with checksums that fit."""
    (folder / "jobs").mkdir(parents=True)
    (folder / "results.json").write_text(json.dumps(sealed(data["results"], ["timings"])), encoding="utf-8")
    for key, job in data["jobs"].items():
        (folder / "jobs" / f"{key}.json").write_text(json.dumps(sealed(job)), encoding="utf-8")


def forged(data, random, kinds):
    """A forged copy of a published object.

    Args:
        data: the true one, left as it is.
        random: generator of random numbers.
        kinds: names of :data:`KINDS`, applied one after the other where they fit.

    Raises:
        UnfitError: when none of them fits, or together they change nothing.
    """
    copied = copy.deepcopy(data)
    for kind in kinds:
        try:
            KINDS[kind](copied, random)
        except (UnfitError, KeyError, TypeError, AttributeError, StopIteration):
            continue  # there is no such part, or an earlier forgery took it away
    if json.dumps(copied, sort_keys=True) == json.dumps(data, sort_keys=True):
        raise UnfitError
    return copied


def forgeries(data, random, count):
    """``count`` pairs of names of kinds and a forged object: each kind alone first, then mixtures of two or three."""
    names, made = list(KINDS), 0
    alone = [[name] for name in names]
    while made < count:
        kinds = alone.pop(0) if alone else random.choice(names, size=random.integers(2, 4), replace=False).tolist()
        try:
            found = forged(data, random, kinds)
        except UnfitError:
            continue
        made += 1
        yield kinds, found
