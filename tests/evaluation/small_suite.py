"""A suite of two short tracks, and helpers for folders of results, that several tests share."""

import json

import ptne_env
from ptne_env import FactorySpec
from ptne_env.evaluation import Suite, Track

BASE = ptne_env.get_scenario("random-energy", steps=120, deadline=0.2)
COMPLETE = BASE.replace(
    topology=FactorySpec.of("ptne_env.world.graphs:complete", players=5)
)
SMALL = Suite("small-v1", (Track("ring", BASE, "The base."), Track("complete", COMPLETE, "All links.")), episodes=5)


def stored(folder):
    """The job files of a results folder by name."""
    return {path.name: path for path in (folder / "jobs").glob("*.json")}


def without_timings(text):
    """All but the timings, and the checksum, which covers them."""
    return json.dumps({key: value for key, value in json.loads(text).items() if key not in ("timings", "checksum")})


def outcome(folder):
    """Every JSON file of a results folder, without timings."""
    paths = {**stored(folder), "results.json": folder / "results.json"}
    return {name: without_timings(path.read_text(encoding="utf-8")) for name, path in paths.items()}


def written(results, folder):
    """The path of ``results.json`` in a folder of results."""
    path = folder / "results.json"
    path.write_text(results.to_json(), encoding="utf-8")
    return path


def untimed(results):
    """The records that another run repeats."""
    return [record for record in results.records if record["metric"] != "microseconds_per_decision"]
