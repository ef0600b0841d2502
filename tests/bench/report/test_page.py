"""The page of results: its answer, its tables, its commands, and no reference to the network."""

import json
import re
from base64 import b64decode
from gzip import decompress
from hashlib import sha256
from html.parser import HTMLParser
from importlib import resources

import numpy as np
import pytest

import ptne_env
from ptne_env import Scenario, evaluate, get_scenario
from ptne_env.bench.report import page
from ptne_env.bench.report.answer import answer
from ptne_env.bench.report.html import with_minus_signs
from ptne_env.bench.report.pages import report
from ptne_env.evaluation import default_policies
from ptne_env.evaluation.metrics import number
from ptne_env.evaluation.traces import scenes
from ptne_env.shared.style import COLOURS, DARK, LIGHT
from ptne_env.world import distances
from ptne_env.world.catalogue import CATALOGUE, DESCRIPTIONS

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


def test_the_page_begins_with_the_answer(comparison, pages):
    text = next(text for attributes, text in pages["comparison"].all("div") if attributes.get("id") == "answer")
    assert [line.strip() for line in text.split("\n") if line.strip()] == list(answer(comparison))


def test_every_figure_says_how_many_episodes_it_shows(pages):
    for outline in pages.values():
        captions = [" ".join(text.split()) for _, text in outline.all("figcaption")]
        assert len(captions) == len([1 for found, _ in outline.all("div") if "chart" in found.get("class", "")])
        assert all(re.search(r"(one|\d) episodes?( each)?\.", caption) for caption in captions)
    assert captions[0].endswith(
        "over 2 tracks with 6 episodes each. A policy that does not play a track counts as zero input there."
    )
    assert captions[1].endswith("median and 10–90 % band over the first 6 of 6 episodes.")


def test_every_scenario_has_a_description_of_its_own():
    assert DESCRIPTIONS.keys() == CATALOGUE.keys()
    assert len(set(DESCRIPTIONS.values())) == len(CATALOGUE)


def test_every_section_is_described_in_its_headline(comparison_report, pages):
    descriptions = [section.description for section in comparison_report.sections]
    assert descriptions == [DESCRIPTIONS["energy"], DESCRIPTIONS["energy-switching"]]
    summaries = [text for _, text in pages["comparison"].all("summary")]
    for section in comparison_report.sections:
        assert f"{section.name} {section.description}" in summaries


def test_page_shows_every_record(comparison, pages):
    texts = {text for _, text in pages["comparison"].all("td")}
    for record in comparison.records:
        if record["mean"] is not None:
            assert any(text.startswith(with_minus_signs(number(record["mean"]))) for text in texts)


def test_a_page_says_that_no_command_repeats_what_was_made_in_python(comparison, comparison_scenes, pages):
    content = report(comparison, comparison_scenes)
    assert [content.command, *(section.command for section in content.sections)] == [None] * 3
    text = "".join(text for _, text in pages["comparison"].all("p"))
    assert text.count("no command repeats them") == 3
    own = [get_scenario("energy", steps=50)]
    made = evaluate(["static"], own, episodes=1)
    assert report(made, scenes(made)).command is None


def test_the_command_of_default_policies_names_none():
    results = evaluate(default_policies(), ["robots"], episodes=1)
    expected = "ptne compare --seed 0 --episodes 1 --scenario robots --hold-steps 0"
    assert report(results, scenes(results)).command == expected


def test_the_command_says_trust_where_a_policy_is_code(comparison, comparison_scenes):
    command = report(comparison, comparison_scenes, ["static", "mine:make"]).command
    assert command.endswith("--policy static --policy mine:make --trust")


def test_section_states_how_to_repeat_its_numbers(comparison_report, suite, suite_report):
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


def decoded(rows):
    """The numbers of rows as the player reads them, by the rule in the docstring of ``scene_data``."""
    codes = np.cumsum(rows, axis=1)
    exists = codes != -(10**6)
    return np.where(exists, np.sign(codes) * 1e-13 * 10 ** (8e-4 * np.abs(codes * exists)), np.nan)


def test_figures_hold_every_step_of_the_first_episode(comparison_report, pages):
    page = {attributes["id"]: text for attributes, text in pages["comparison"].all("script") if "id" in attributes}
    assert json.loads(page["figures"])["scenes"] == [section.name for section in comparison_report.sections]
    packed = [json.loads(decompress(b64decode(text))) for name, text in page.items() if name.startswith("scene-")]
    for section, drawn in zip(comparison_report.sections, packed, strict=True):
        scene = comparison_report.scenes[section.name]
        assert drawn["t"] == pytest.approx(scene.t.tolist(), abs=1e-6)
        trace = scene.traces["static"]
        expected = trace.estimates - scene.equilibrium[:, None]
        found = decoded(drawn["traces"]["static"]["estimates"]).reshape(expected.shape)
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=2e-13)
        np.testing.assert_allclose(
            decoded(drawn["traces"]["static"]["inputs"]), trace.inputs, rtol=1e-3, atol=2e-13, equal_nan=True
        )
        errors = np.cumsum(drawn["traces"]["static"]["errors"], axis=1) / 100
        np.testing.assert_allclose(errors, -distances.digits(trace.errors), atol=0.006)
        for frame in range(len(scene.t)):
            live = [links for start, links in drawn["live"] if start <= frame][-1]
            assert live == np.flatnonzero(scene.live[:, frame]).tolist()
    assert len(packed[1]["live"]) > 1  # the graph of energy-switching switches


def test_page_of_20_tracks_with_15_policies_stays_small(page_file):
    assert page_file("large").stat().st_size < 5e6
    assert page_file("suite").stat().st_size < 1.5e6  # of which Plotly takes 0.6


def test_plotly_is_the_file_of_npm():
    bundle = (resources.files("ptne_env.bench.report") / "plotly" / "plotly-basic.min.js").read_bytes()
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


def test_the_player_shows_the_entry_that_the_answer_names_where_several_are_closest():
    results = evaluate(["grounded", "contact-relay"], ["energy", "energy-switching"], episodes=2)
    first, second = (results.record("energy", name, "digits")["mean"] for name in results.policies)
    assert first == second
    assert answer(results)[0].startswith("contact-relay is the closest")
    assert [section.picked[0] for section in report(results, scenes(results)).sections] == ["contact-relay"] * 2
