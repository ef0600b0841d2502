"""A suite of two short tracks that several tests share."""

import json

import ptne_env
from ptne_env import FactorySpec
from ptne_env.evaluation import METRICS, Teammates, Track
from ptne_env.evaluation.provenance import content_hash
from ptne_env.suites import Suite, ptne_v1
from ptne_env.world.graphs import complete

BASE = ptne_env.get_scenario("random-energy", steps=120, deadline=0.2)
COMPLETE = BASE.replace(topology=complete(5))
SMALL = Suite("small-v1", (Track("ring", BASE, "The base."), Track("complete", COMPLETE, "All links.")), episodes=5)
STRANGERS = Track(
    "strangers",
    ptne_v1.BASE.replace(name="strangers", channel=FactorySpec.of("channel:noise", std=0.01)),
    "Player 4 follows another law.",
    Teammates(FactorySpec.of("law:static", kappa=0.4), (3,)),
)
TEAMS = Suite("teams-v1", (STRANGERS,), episodes=5)


def stored(folder):
    """The job files of a results folder by name."""
    return {path.name: path for path in (folder / "jobs").glob("*.json")}


def untimed(results):
    """The records that another run repeats."""
    return [record for record in results.records if not METRICS[record["metric"]].is_timing]


def write_results(folder, data, change=lambda data: None):
    """Write results with a change, and with the checksum that fits, which needs no secret; the folder."""
    changed = json.loads(json.dumps(data))
    change(changed)
    content = {key: value for key, value in changed.items() if key not in ("checksum", "timings")}
    (folder / "results.json").write_text(json.dumps(changed | {"checksum": content_hash(content)}))
    return folder
