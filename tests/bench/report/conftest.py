"""Small results that all tests of the report share."""

from dataclasses import replace

import pytest

from ptne_env import FactorySpec, PolicySpec, evaluate, get_scenario
from ptne_env.bench.report import page, save_video
from ptne_env.bench.report.pages import render_report, report
from ptne_env.evaluation import Suite, Track, get_policy_spec, run_suite
from ptne_env.evaluation.traces import scenes


@pytest.fixture(scope="session")
def hostile():
    """A name that a page must show as text."""
    return "</script><script>alert(1)</script><b>&\"'"


@pytest.fixture(scope="session")
def comparison(hostile):
    """Results on a fixed and on a drawn world, with an oracle, a learned policy and a hostile name."""
    mine = PolicySpec(hostile, FactorySpec.of("ptne_env.laws:Static", kappa=1.0))
    return evaluate(
        ["static", "grounded", "zero-input", "oracle", mine],
        ["energy", "energy-switching"],
        episodes=6,
        against_laws=False,
    )


@pytest.fixture(scope="session")
def suite():
    """Results of a suite of two tracks; on one of them a learned policy cannot act."""
    world = get_scenario("random-energy", steps=200)
    robots = world.replace(game=FactorySpec.of("ptne_env.field.games:ConnectivityControl"))
    tiny = Suite("tiny", (Track("plain", world, "Nothing."), Track("robots", robots, "Robots.")), episodes=6)
    return run_suite(tiny, ["ppo-random-energy", "grounded", "adaptive"])


@pytest.fixture(scope="session")
def comparison_scenes(comparison):
    """The scenes of the comparison."""
    return scenes(comparison)


@pytest.fixture(scope="session")
def suite_scenes(suite):
    """The scenes of the suite."""
    return scenes(suite)


@pytest.fixture(scope="session")
def comparison_report(comparison, comparison_scenes):
    """The content of the page of the comparison."""
    return report(comparison, comparison_scenes)


@pytest.fixture(scope="session")
def suite_report(suite, suite_scenes):
    """The content of the page of the suite."""
    return report(suite, suite_scenes)


@pytest.fixture(scope="session")
def page_file(comparison, comparison_scenes, suite_report, tmp_path_factory):
    """Pages by name, as files: ``comparison``, ``suite``, ``large``, of 20 tracks with 15 policies, and of one episode
    ``episode`` and ``held``, which has 30 steps after the deadline.
    """
    folder = tmp_path_factory.mktemp("pages")
    pages = {
        "comparison": page(comparison, comparison_scenes),
        "suite": render_report(suite_report),
        "large": render_report(_enlarged(suite_report, 20, 15)),
    }
    for name, text in pages.items():
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
    save_video(get_scenario("energy", steps=100), get_policy_spec("static"), folder / "episode.html")
    save_video(get_scenario("energy", steps=100, hold_steps=30), get_policy_spec("static"), folder / "held.html")
    return lambda name: folder / f"{name}.html"


def _enlarged(content, tracks, policies):
    """The content of a page with copies of its first track and of that track's policies."""
    section, names = content.sections[0], [f"policy-{index}" for index in range(policies)]
    scene = content.scenes[section.name]
    originals = dict(zip(names, [*section.tables[0].rows] * policies, strict=False))
    tables = tuple(
        replace(
            table,
            rows=dict.fromkeys(names, "honest"),
            columns=tuple(
                replace(column, values={name: column[original] for name, original in originals.items()})
                for column in table.columns
            ),
        )
        for table in section.tables
    )
    scene = replace(scene, traces={name: scene.traces[original] for name, original in originals.items()})
    sections = [
        replace(section, name=f"track-{index}", tables=tables, shown=tuple(names[:5]), picked=tuple(names[:2]))
        for index in range(tracks)
    ]
    return replace(
        content,
        sections=tuple(sections),
        scenes={each.name: scene for each in sections},
        policies=tuple(names),
        profiles={name: next(iter(content.profiles.values())) for name in names},
    )
