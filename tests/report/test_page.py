"""The page of results: its answer, its tables, its commands, and no reference to the network."""

import json
import re
import shlex
from base64 import b64decode
from dataclasses import replace
from gzip import decompress
from hashlib import sha256
from html.parser import HTMLParser
from importlib import resources

import numpy as np
import pytest

import ptne_env
from ptne_env import Scenario, evaluate, get_scenario
from ptne_env.experiments import get_policy_spec
from ptne_env.experiments.metrics import number
from ptne_env.experiments.traces import scenes
from ptne_env.report import page
from ptne_env.report.pages import report
from ptne_env.style import COLOURS, DARK, LIGHT

VOID = {"meta", "link", "input", "br", "img", "hr"}


class Outline(HTMLParser):
    """Every element with its attributes and text; ``wrong`` lists tags that do not close."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.open, self.wrong = [], [], []
        self.feed(text)
        self.wrong += [tag for tag, *_ in self.open]

    def handle_starttag(self, tag, attrs):
        found = (tag, dict(attrs), [])
        self.elements.append(found)
        if tag not in VOID:
            self.open.append(found)

    def handle_endtag(self, tag):
        if self.open and self.open[-1][0] == tag:
            self.open.pop()
        else:
            self.wrong.append(f"/{tag}")

    def handle_data(self, data):
        for _, _, texts in self.open:
            texts.append(data)

    def all(self, tag):
        return [(attributes, "".join(texts)) for name, attributes, texts in self.elements if name == tag]


@pytest.fixture(scope="module")
def pages(page_file):
    return {name: Outline(page_file(name).read_text(encoding="utf-8")) for name in ("comparison", "suite")}


def test_page_is_well_formed_and_loads_nothing(pages):
    for outline in pages.values():
        assert outline.wrong == []
        links = [
            (tag, attributes) for tag, attributes, _ in outline.elements if {"src", "href", "srcset"} & set(attributes)
        ]
        assert links
        for _, attributes in links:
            assert "src" not in attributes
            assert attributes["href"].startswith(("#", "data:"))
        policy = [attributes for attributes, _ in outline.all("meta") if "http-equiv" in attributes]
        assert policy[0]["content"].startswith("default-src 'none'")
        styles = "".join(text for _, text in outline.all("style"))
        assert "url(" not in styles
        assert "@import" not in styles


def test_anchors_have_targets_and_identifiers_are_unique(pages):
    for outline in pages.values():
        identifiers = [attributes["id"] for _, attributes, _ in outline.elements if "id" in attributes]
        assert len(set(identifiers)) == len(identifiers)
        targets = {attributes["href"][1:] for attributes, _ in outline.all("a")}
        assert targets <= set(identifiers)


def test_hostile_names_are_shown_as_text(pages, page_file, comparison_report, hostile):
    page = pages["comparison"]
    assert len(page.all("script")) == 3 + len(comparison_report.sections)
    assert not page.all("b")
    assert hostile in [text for attributes, text in page.all("th") if attributes.get("scope") == "row"]
    figures = json.loads(next(text for attributes, text in page.all("script") if attributes.get("id") == "figures"))
    assert hostile in figures["policies"]
    assert "alert(1)</script>" not in page_file("comparison").read_text(encoding="utf-8")


def test_screen_readers_find_captions_and_headings(pages):
    for outline in pages.values():
        assert len(outline.all("caption")) == len(outline.all("table"))
        assert all(text.strip() for _, text in outline.all("caption"))
        assert all("scope" in attributes for attributes, _ in outline.all("th"))
        sortable = [attributes for attributes, _ in outline.all("th") if "aria-sort" in attributes]
        assert len(sortable) == len([1 for attributes, _ in outline.all("button") if "id" not in attributes])
        for attributes, _ in outline.all("div"):
            if "chart" in attributes.get("class", ""):
                assert attributes["role"] == "img"
                assert attributes["aria-label"]


def test_answer_follows_from_the_results(comparison, comparison_report):
    means = {place: samples["digits"].mean() for place, samples in comparison.samples.items() if place[1] != "oracle"}
    tracks = list(comparison.episodes)
    for track in tracks:
        assert max((name for label, name in means if label == track), key=lambda n: means[track, n]) == "grounded"
    average = np.mean([means[track, "grounded"] for track in tracks])
    law = np.mean([means[track, "static"] for track in tracks])
    answer = comparison_report.answer
    assert re.match(rf"grounded is the closest .* on 4 of 4 tracks, with {average:#.3g} ", answer)
    assert f"The paper's law (static) reaches {law:#.3g}" in answer
    assert f"grounded gains {average - law:#.3g}" in answer
    assert len(re.findall(r"[.](?: |$)", answer)) == 2


@pytest.mark.parametrize(
    ("names", "part"),
    [
        (["static", "zero-input"], "static is the closest"),
        (["zero-input"], "No other policy was run."),
        (["oracle"], "Only oracles were run"),
        (["adaptive", "zero-input"], "The next is zero-input, with -0.0"),
    ],
)
def test_answer_of_other_results(names, part):
    results = evaluate(names, ["energy"], episodes=3)
    assert part in report(results, scenes(results, episodes=1)).answer


def test_answer_names_every_policy_that_shares_the_first_place():
    grounded = get_policy_spec("grounded")
    results = evaluate([grounded, replace(grounded, name="again"), "static"], ["energy"], episodes=2)
    answer = report(results, scenes(results, episodes=1)).answer
    assert answer.startswith("grounded and again are each the closest to the equilibrium, or within 0.1 digits of ")


def test_answer_of_a_suite_names_the_highest_score(suite, suite_report):
    ranked = [row for row in suite.leaderboard.overall if not suite.policies[row.policy].is_oracle]
    assert suite_report.answer.startswith(f"{ranked[0].policy} is the closest")
    assert f"and a score of {ranked[0].score.mean:.3f}" in suite_report.answer
    assert f"is better with probability {ranked[0].improvement.mean:.3f}" in suite_report.answer


def test_answer_of_a_best_policy_that_is_behind_on_average(comparison, comparison_scenes):
    place = "energy", "grounded"
    spoiled = {**comparison.samples[place], "digits": comparison.samples[place]["digits"] - 60}
    results = replace(comparison, samples={**comparison.samples, place: spoiled})
    answer = report(results, comparison_scenes).answer
    assert answer.startswith("grounded is the closest to the equilibrium, or within ")
    behind = re.search(r"grounded stays ([\d.]+) \[([\d.]+), ([\d.]+)\] behind it\.$", answer)
    low, middle, high = float(behind[2]), float(behind[1]), float(behind[3])
    assert 0 < low <= middle <= high


def test_page_shows_every_record(comparison, pages):
    texts = {text for _, text in pages["comparison"].all("td")}
    for record in comparison.records:
        if record["mean"] is not None:
            assert any(text.startswith(number(record["mean"])) for text in texts)


def test_section_states_how_to_repeat_its_numbers(comparison_report, suite, suite_report, hostile):
    words = shlex.split(comparison_report.sections[0].command)
    assert words[:2] == ["ptne", "compare"]
    assert hostile in words
    assert dict(comparison_report.facts)["seed"] == "0"
    facts = dict(suite_report.facts)
    assert facts["suite, SHA-256"] == suite.suite.content_hash
    assert facts["sources of ptne_env, SHA-256"]
    shown = {
        value
        for section in suite_report.sections
        for name, values in section.facts
        if name.startswith("job of ")
        for value in values.split()
    }
    places = {(job.track.name, job.policy.name): job.key for job in suite.jobs}
    assert shown == {places[place] for place in places}


def test_command_of_a_section_repeats_its_numbers(comparison, comparison_report, hostile):
    words = shlex.split(comparison_report.sections[0].command)
    options = list(zip(words[2::2], words[3::2], strict=True))
    chosen = {name: [value for option, value in options if option == name] for name, _ in options}
    again = evaluate(
        [name for name in chosen["--policy"] if name != hostile],
        chosen["--scenario"],
        episodes=int(chosen["--episodes"][0]),
        seed=int(chosen["--seed"][0]),
        hold_steps=int(chosen["--hold-steps"][0]),
    )
    track = comparison_report.sections[0].name
    assert again.record(track, "static", "digits") == comparison.record(track, "static", "digits")


@pytest.mark.parametrize("changes", [{}, {"start": "random"}, {"start": "random", "steps": 50}])
def test_replay_starts_where_the_episode_of_the_player_starts(changes):
    results = evaluate(["static"], [get_scenario("energy", **changes)], episodes=1)
    content = report(results, scenes(results))
    code = dict(content.sections[0].facts)["replay of the player's episode"]
    env, seed = code.removesuffix(")").split(".reset(seed=")
    env = eval(env, {"ptne_env": ptne_env, "Scenario": Scenario})  # noqa: S307 - the page's own code
    env.reset(seed=int(seed))
    assert env.world.scenario == get_scenario("energy", **changes)
    assert np.array_equal(env.estimates.T, content.scenes["energy"].traces["static"].estimates[..., 0])


def test_figures_hold_the_first_episode(comparison_report, pages):
    page = {attributes["id"]: text for attributes, text in pages["comparison"].all("script") if "id" in attributes}
    assert json.loads(page["figures"])["scenes"] == [section.name for section in comparison_report.sections]
    packed = [json.loads(decompress(b64decode(text))) for name, text in page.items() if name.startswith("scene-")]
    for section, drawn in zip(comparison_report.sections, packed, strict=True):
        scene = comparison_report.scenes[section.name]
        frames = len(scene.t)
        offsets = np.frombuffer(b64decode(drawn["traces"]["static"]["estimates"]), "<f4").reshape(5, 5, frames)
        expected = scene.traces["static"].estimates - scene.equilibrium[:, None]
        np.testing.assert_allclose(offsets, expected, rtol=1e-6)
        for frame in range(frames):
            live = [links for start, links in drawn["live"] if start <= frame][-1]
            assert live == np.flatnonzero(scene.live[:, frame]).tolist()
    assert len(packed[2]["live"]) > 1  # the graph of energy-switching switches


def test_page_of_20_tracks_with_15_policies_stays_small(page_file):
    assert page_file("large").stat().st_size < 5e6
    assert page_file("suite").stat().st_size < 1.5e6  # of which Plotly takes 0.6


def test_plotly_is_the_file_of_npm():
    bundle = (resources.files("ptne_env.report") / "plotly" / "plotly-basic.min.js").read_bytes()
    assert b"plotly.js (basic - minified) v4.1.1" in bundle[:100]
    assert sha256(bundle).hexdigest() == "99784e3abfb07b142a15e521a439e6d9addceadb3f79553fd24c72774f0649ba"


def test_same_results_make_the_same_page(comparison, comparison_scenes, page_file):
    assert page(comparison, comparison_scenes) == page_file("comparison").read_text(encoding="utf-8")


def luminance(colour):
    channels = [int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)]
    linear = [value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4 for value in channels]
    return np.dot([0.2126, 0.7152, 0.0722], linear)


def contrast(one, other):
    dark, light = sorted([luminance(one), luminance(other)])
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("scheme", [LIGHT, DARK])
def test_contrast_of_letters_and_lines(scheme):
    """WCAG 2 AA: 4.5 for letters, 3 for the lines of a figure."""
    for ground in (scheme["ground"], scheme["panel"]):
        assert min(contrast(scheme[name], ground) for name in ("ink", "faint", "accent", "holds", "fails")) >= 4.5
    assert min(contrast(colour, scheme["ground"]) for colour in COLOURS) >= 3
    assert len(set(COLOURS)) == 10


def test_page_declares_both_colour_schemes(page_file):
    text = page_file("comparison").read_text(encoding="utf-8")
    for scheme in (LIGHT, DARK):
        assert f":root {{ {' '.join(f'--{role}: {colour};' for role, colour in scheme.items())}" in text
