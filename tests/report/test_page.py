"""The page of results: what it says, that it escapes names, and that a browser shows it without errors."""

import json
from base64 import b64decode
from gzip import decompress
from html.parser import HTMLParser

import numpy as np
import pytest

from ptne_env import FactorySpec, get_scenario, record
from ptne_env.evaluation import EpisodeSet, Track, get_policy_spec
from ptne_env.evaluation.metrics import number
from ptne_env.report.page import Page, Section, results_page
from ptne_env.report.tables import Cell, Column, Table, answer
from ptne_env.report.traces import make_scene
from ptne_env.shared.style import COLOURS, DARK, LIGHT

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
def text(comparison):
    return results_page(comparison, "ptne compare energy")


@pytest.fixture(scope="module")
def outline(text):
    return Outline(text)


def unpacked(outline, name):
    (packed,) = (text for attributes, text in outline.all("script") if attributes.get("id") == f"{name}-data")
    return decompress(b64decode(packed)).decode()


def test_the_page_is_well_formed_and_loads_nothing(outline):
    assert outline.wrong == []
    for _, attributes, _ in outline.elements:
        assert attributes.get("src", "data:").startswith("data:")
        assert attributes.get("href", "#").startswith(("#", "data:"))
    identifiers = [attributes["id"] for _, attributes, _ in outline.elements if "id" in attributes]
    assert len(set(identifiers)) == len(identifiers)
    assert {attributes["href"][1:] for attributes, _ in outline.all("a")} <= set(identifiers)
    (policy,) = (attributes["content"] for attributes, _ in outline.all("meta") if "http-equiv" in attributes)
    assert policy.startswith("default-src 'none'")


def test_hostile_names_are_shown_as_text(outline, text, hostile):
    assert not outline.all("b")
    assert hostile in [text for attributes, text in outline.all("th") if attributes.get("scope") == "row"]
    assert hostile in json.loads(unpacked(outline, "scene-0"))["traces"]
    assert "alert(1)</script>" not in text


def test_the_page_shows_the_answer_the_command_and_every_record(comparison, outline, hostile):
    assert outline.all("h1")[0][1] == f"grounded, static, {hostile} and 2 more on energy and energy-switching"
    dots = [attributes["title"] for attributes, _ in outline.all("i") if "title" in attributes]
    assert [dot.partition(":")[0] for dot in dots] == 3 * ["static", "grounded", hostile]  # two scenarios, their mean
    assert f"static: {comparison.record('energy', 'static', 'digits')['mean']:.2f} [" in dots[0]
    assert [text for attributes, text in outline.all("p") if attributes.get("class") == "answer"] == list(
        answer(comparison)
    )
    assert "ptne compare energy" in [text for _, text in outline.all("dd")]
    cells = {text.split()[0] for _, text in outline.all("td") if text.strip()}
    for entry in comparison.records:
        if entry["mean"] is not None:
            assert number(entry["mean"]) in cells


def test_figures_show_the_papers_law_and_the_users_own(outline, text, hostile):
    drawn = json.loads(unpacked(outline, "scene-1"))
    assert list(drawn["traces"]) == ["static", "grounded", hostile]
    assert all(len(trace["errors"]) == 3 for trace in drawn["traces"].values())  # the median and its band
    charts = [name["data-scene"] for name, _ in outline.all("div") if "data-scene" in name]
    assert charts == ["scene-0", "scene-1"]
    assert len(text) < 300_000  # so a page of thirteen tracks has less than 2 MB


def test_the_player_has_every_step_of_the_first_episode():
    track = Track("switching", get_scenario("energy-switching", steps=50), "")
    scene = make_scene(track, EpisodeSet(3), [get_policy_spec("static")])
    drawn = json.loads(unpacked(Outline(Page("", (), scenes={"one": scene}).to_html()), "scene-0"))
    run, shown = record("static", track, episodes=3), drawn["traces"]["static"]
    exactness = np.ptp(run.strategies[0, :, 0]) / 100
    np.testing.assert_allclose(shown["estimates"], run.estimates[..., 0].T, atol=exactness)
    np.testing.assert_allclose(shown["strategies"], run.strategies[..., 0].T, atol=exactness)
    np.testing.assert_allclose(shown["error"], run.errors[:, 0], rtol=0.05)
    np.testing.assert_allclose(shown["errors"], np.quantile(run.errors, (0.1, 0.5, 0.9), axis=1), rtol=0.05)
    own = run.inputs[:-1, range(5), range(5), 0].T
    np.testing.assert_allclose(np.array(shown["inputs"])[:, :-1].astype(float), own, atol=0.0051)
    assert shown["inputs"][0][-1] is None  # none is held after the last instant
    for frame, weights in enumerate(run.weights[..., 0]):
        live = [links for start, links in drawn["live"] if start <= frame][-1]
        assert {tuple(sorted(drawn["links"][link][:2])) for link in live} == {
            (i, j) for i, j in run.links[weights > 0] if i < j
        }
    assert len(drawn["live"]) > 1  # the graph switches


def test_links_of_one_way_point_from_the_sender_to_the_receiver():
    hears = np.array([[0, 1, 1], [1, 0, 0], [0, 1, 0]])  # player 0 hears 1 and 2, which hears 1
    game = FactorySpec.of("game:random-energy", players=3)
    track = Track("one-way", get_scenario("random-energy", steps=50, game=game, topology=hears), "")
    scene = make_scene(track, EpisodeSet(1), [get_policy_spec("static")])
    drawn = json.loads(unpacked(Outline(Page("", (), scenes={"one": scene}).to_html()), "scene-0"))
    assert drawn["links"] == [[1, 0, 0], [2, 0, 1], [1, 2, 1]]


def luminance(colour):
    channels = [int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)]
    linear = [value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4 for value in channels]
    return np.dot([0.2126, 0.7152, 0.0722], linear)


def contrast(one, other):
    dark, light = sorted([luminance(one), luminance(other)])
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("scheme", [LIGHT, DARK])
def test_contrast_of_letters_and_lines(scheme, text):
    """WCAG 2 AA: 4.5 for letters, 3 for the lines of a figure."""
    for ground in (scheme["ground"], scheme["panel"]):
        assert min(contrast(scheme[name], ground) for name in ("ink", "faint", "accent")) >= 4.5
    assert min(contrast(colour, scheme["ground"]) for colour in COLOURS) >= 3
    assert " ".join(f"--{role}: {colour};" for role, colour in scheme.items()) in text


@pytest.mark.parametrize(("width", "scheme"), [(1440, "light"), (390, "dark")])
def test_a_browser_shows_charts_sorts_and_plays(open_file, text, tmp_path, hostile, width, scheme):
    (tmp_path / "page.html").write_text(text, encoding="utf-8")
    browser = open_file(tmp_path / "page.html", width, scheme)
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    browser.locator("summary").first.click()
    browser.locator(".chart").first.scroll_into_view_if_needed()
    browser.wait_for_selector(".chart svg path")
    heading = browser.locator("th", has=browser.locator("button", has_text="static")).first
    heading.locator("button").click()
    assert heading.get_attribute("aria-sort") == "descending"
    browser.locator("#player-scene").select_option(label="energy-switching")
    browser.wait_for_selector(".card")
    before = browser.locator("#player-instant").text_content()
    browser.locator("#player-frame").fill("117")
    assert browser.locator("#player-instant").text_content() != before
    assert browser.locator(".card h3").all_text_contents() == ["static", "grounded", hostile]
    browser.locator("#player-play").click()
    browser.wait_for_timeout(1000)
    assert int(browser.locator("#player-frame").input_value()) > 117


def test_sorting_leaves_totals_and_dashes_last(open_file, tmp_path):
    cells = {"a": Cell("2", 2.0), "b": Cell(), "c": Cell("1", 1.0), "mean": Cell("9", 9.0)}
    table = Table("Digits", "track", ("a", "b", "c"), (Column("x", cells),), totals=("mean",))
    (tmp_path / "page.html").write_text(Page("", (Section("", tables=(table,)),)).to_html(), encoding="utf-8")
    browser = open_file(tmp_path / "page.html", 800, "light")
    for heading, order in (("x", "acb"), ("x", "cab"), ("track", "abc"), ("track", "cba")):
        browser.locator("button", has_text=heading).click()
        assert browser.locator("tbody th").all_text_contents() == [*order, "mean"]


def test_an_error_that_hardly_changes_is_drawn_between_two_powers_of_ten(open_file, text, tmp_path):
    (tmp_path / "page.html").write_text(text, encoding="utf-8")
    browser = open_file(tmp_path / "page.html", 800, "light")
    scene = "{t: [0, 1], deadline: 1, traces: {one: {error: [1.4, 1.3]}}}"
    labels = f"[...errorChart({scene}, 'one').svg.querySelectorAll('text')].map((each) => each.textContent)"
    assert {"10⁰", "10¹"} <= set(browser.evaluate(labels))


@pytest.mark.parametrize(("last", "is_inside"), [(12.0, True), (1000.0, False)])
def test_the_player_shows_what_runs_away_and_no_false_line_at_the_frame(open_file, text, tmp_path, last, is_inside):
    (tmp_path / "page.html").write_text(text, encoding="utf-8")
    browser = open_file(tmp_path / "page.html", 800, "light")
    trace = f"{{strategies: [[0, 5, {last}], [10, 9, 8]], estimates: []}}"
    scene = f"{{t: [0, 1, 2], deadline: 2, owners: [0, 1], equilibrium: [0, 10], traces: {{one: {trace}}}}}"
    paths = f"[...strategyChart({scene}, 'one').svg.querySelectorAll('path')].map((path) => path.getAttribute('d'))"
    end = float(browser.evaluate(paths)[2].split()[-1])  # the height of the last point of the first strategy
    assert (end >= 0) == is_inside


def test_a_page_without_a_scene_escapes_its_words():
    table = Table("Claims", "claim", ("<b>",), (Column("says", {"<b>": Cell("&")}),))
    assert "&lt;b&gt;" in Page("Paper", (Section("Claims", tables=(table,)),)).to_html()
