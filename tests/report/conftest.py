"""Small results that all tests of the report page share."""

from dataclasses import replace

import pytest

from ptne_env import FactorySpec, PolicySpec, evaluate, get_scenario
from ptne_env.experiments import get_policy_spec
from ptne_env.experiments.benchmark import run_suite
from ptne_env.experiments.leaderboard import leaderboard
from ptne_env.experiments.suite import Suite, Track
from ptne_env.experiments.traces import comparison_scenes, suite_scenes
from ptne_env.report import comparison_report, render_page, save_video, suite_report


@pytest.fixture(scope="session")
def hostile():
    """A name that a page must show and not obey."""
    return "</script><script>alert(1)</script><b>&\"'"


@pytest.fixture(scope="session")
def comparison(hostile):
    """Results on a fixed and on a drawn world, with an oracle and a hostile name."""
    mine = PolicySpec(hostile, FactorySpec.of("ptne_env.laws:Static", kappa=1.0))
    return evaluate(["static", "grounded", "null", "oracle", mine], ["energy", "energy-switching"], episodes=6)


@pytest.fixture(scope="session")
def compared(comparison):
    """The report on them."""
    return comparison_report(comparison, comparison_scenes(comparison), episodes=6, hold_steps=0)


@pytest.fixture(scope="session")
def board(tmp_path_factory):
    """A suite of two tracks, on one of which a learned policy cannot act."""
    world = get_scenario("random-energy", steps=200)
    robots = world.replace(game=FactorySpec.of("ptne_env.games:ConnectivityControl"))
    suite = Suite("tiny", 1, (Track("plain", world, "Nothing."), Track("robots", robots, "Robots.")), episodes=6)
    folder = tmp_path_factory.mktemp("suite")
    return leaderboard(run_suite(suite, ["ppo-random-energy", "grounded", "adaptive"], folder))


@pytest.fixture(scope="session")
def benched(board):
    """The report on it."""
    return suite_report(board, suite_scenes(board.run), folder="results/tiny-v1")


@pytest.fixture(scope="session")
def page_file(compared, benched, tmp_path_factory):
    """Pages by name, as files: ``comparison``, ``suite``, ``episode`` and ``large``, of 20 tracks with 15 policies."""
    folder = tmp_path_factory.mktemp("pages")
    pages = {"comparison": compared, "suite": benched, "large": _enlarged(benched, 20, 15)}
    for name, report in pages.items():
        (folder / f"{name}.html").write_text(render_page(report), encoding="utf-8")
    save_video(get_scenario("energy", steps=100), get_policy_spec("static"), folder / "episode.html")
    return lambda name: folder / f"{name}.html"


def _enlarged(report, tracks, policies):
    def repeated(items, count):
        return [items[index % len(items)] for index in range(count)]

    section, names = report.sections[0], [f"policy-{index}" for index in range(policies)]
    scene = report.scenes[section.name]
    rows = [replace(row, name=name) for name, row in zip(names, repeated(section.table.rows, policies), strict=True)]
    traces = dict(zip(names, repeated(list(scene.traces.values()), policies), strict=True))
    sections = [
        replace(section, name=f"track-{index}", table=replace(section.table, rows=tuple(rows)), shown=tuple(names[:5]))
        for index in range(tracks)
    ]
    scenes = {one.name: replace(scene, traces=traces) for one in sections}
    profiles = dict(zip(names, repeated(list(report.profiles.values()), policies), strict=True))
    return replace(report, sections=tuple(sections), scenes=scenes, policies=tuple(names), profiles=profiles)
