"""What the report page says: an answer that follows from the results, and nothing from outside."""

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

from ptne_env import evaluate
from ptne_env.experiments.traces import comparison_scenes
from ptne_env.report import comparison_report, render_page, suite_report
from ptne_env.style import COLOURS, DARK, LIGHT

VOID = {"meta", "link", "input", "br", "img", "hr"}


class Outline(HTMLParser):
    """Every element with its attributes and the text in it; notes tags that do not close."""

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


def test_a_page_is_well_formed_and_loads_nothing(pages):
    for page in pages.values():
        assert page.wrong == []
        links = [
            (tag, attributes) for tag, attributes, _ in page.elements if {"src", "href", "srcset"} & set(attributes)
        ]
        assert links
        for _, attributes in links:
            assert "src" not in attributes
            assert attributes["href"].startswith(("#", "data:"))
        policy = [attributes for attributes, _ in page.all("meta") if "http-equiv" in attributes]
        assert policy[0]["content"].startswith("default-src 'none'")
        styles = "".join(text for _, text in page.all("style"))
        assert "url(" not in styles
        assert "@import" not in styles


def test_anchors_lead_somewhere_and_no_identifier_repeats(pages):
    for page in pages.values():
        identifiers = [attributes["id"] for _, attributes, _ in page.elements if "id" in attributes]
        assert len(set(identifiers)) == len(identifiers)
        targets = {attributes["href"][1:] for attributes, _ in page.all("a")}
        assert targets <= set(identifiers)


def test_hostile_names_are_shown_and_not_obeyed(pages, page_file, compared, hostile):
    page = pages["comparison"]
    assert len(page.all("script")) == 3 + len(compared.sections)
    assert not page.all("b")
    assert hostile in [text for attributes, text in page.all("th") if attributes.get("scope") == "row"]
    figures = json.loads(next(text for attributes, text in page.all("script") if attributes.get("id") == "figures"))
    assert hostile in figures["policies"]
    assert "alert(1)</script>" not in page_file("comparison").read_text(encoding="utf-8")


def test_tables_can_be_read_by_a_screen_reader(pages):
    for page in pages.values():
        assert len(page.all("caption")) == len(page.all("table"))
        assert all(text.strip() for _, text in page.all("caption"))
        assert all("scope" in attributes for attributes, _ in page.all("th"))
        sortable = [attributes for attributes, _ in page.all("th") if "aria-sort" in attributes]
        assert len(sortable) == len([1 for attributes, _ in page.all("button") if "id" not in attributes])
        for attributes, _ in page.all("div"):
            if "chart" in attributes.get("class", ""):
                assert attributes["role"] == "img"
                assert attributes["aria-label"]


def test_the_answer_follows_from_the_results(comparison, compared):
    means = {
        (cell.scenario, cell.policy): cell.samples["digits"].mean()
        for cell in comparison.cells
        if cell.policy != "oracle"
    }
    for scenario in comparison.scenarios:
        assert max((name for label, name in means if label == scenario), key=lambda n: means[scenario, n]) == "grounded"
    average = np.mean([means[scenario, "grounded"] for scenario in comparison.scenarios])
    law = np.mean([means[scenario, "static"] for scenario in comparison.scenarios])
    assert compared.answer.startswith(
        f"grounded comes closest, or as close as the best, in 4 of 4 cases, with {average:#.3g}"
    )
    assert f"The paper's law (static) reaches {law:#.3g}" in compared.answer
    assert f"gains {average - law:#.3g}" in compared.answer
    assert len(re.findall(r"[.](?: |$)", compared.answer)) == 2


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["static", "null"], "static comes closest"),
        (["null"], "Nobody else took part."),
        (["oracle"], "Only oracles took part"),
        (["adaptive", "null"], "Of the others null reaches most"),
    ],
)
def test_other_results_have_other_answers(names, said):
    results = evaluate(names, ["energy"], episodes=3)
    assert said in comparison_report(results, comparison_scenes(results), episodes=3, hold_steps=0).answer


def test_the_answer_of_a_suite_follows_from_its_scores(board, benched):
    ranked = [row for row in board.overall if not board.run.participants[row.policy].is_oracle]
    assert f"{ranked[0].policy} has the highest score, {ranked[0].score.mean:.3f}" in benched.answer
    assert f"the runner-up is {ranked[1].policy} with {ranked[1].score.mean:.3f}" in benched.answer
    swapped = replace(board, overall=(ranked[1], ranked[0], *board.overall[2:]))
    scenes = benched.scenes
    assert f"{ranked[1].policy} has the highest score" in suite_report(swapped, scenes, folder="x").answer
    assert "No overall score" in suite_report(replace(board, overall=(), common=()), scenes, folder="x").answer


def test_tables_show_the_records(comparison, compared):
    section = next(section for section in compared.sections if section.name == "energy")
    assert [row.name for row in section.table.rows][:2] == ["grounded", "oracle"]
    for row in section.table.rows:
        record = comparison.record("energy", row.name, "digits")
        assert row.values[0].value == record["mean"]
        assert row.oracle == (row.name == "oracle")
    label = [column.label for column in compared.leaderboard.columns].index("energy")
    values = {row.name: row.values[label].value for row in compared.leaderboard.rows}
    assert values == {row.name: row.values[0].value for row in section.table.rows}


def test_who_cannot_act_on_a_track_is_told_with_the_reason(benched):
    plain, robots = benched.sections
    assert "ppo-random-energy" in [row.name for row in plain.table.rows]
    assert "ppo-random-energy" not in [row.name for row in robots.table.rows]
    assert any(note.startswith("ppo-random-energy cannot act here: ") for note in robots.table.notes)


def test_every_number_says_how_to_repeat_it(compared, board, benched, hostile):
    words = shlex.split(compared.sections[0].command)
    assert words[:2] == ["ptne", "compare"]
    assert hostile in words
    assert dict(compared.facts)["seed"] == "0"
    facts = dict(benched.facts)
    assert facts["suite, SHA-256"] == board.run.suite.content_hash
    assert facts["sources of ptne_env, SHA-256"]
    cells = {cell.key for cell in board.run.cells}
    shown = {key for section in benched.sections for row in section.table.rows for key in row.values[-1].title.split()}
    assert shown <= cells
    assert len(shown) == sum(len(section.table.rows) for section in benched.sections)


def test_a_command_of_the_page_repeats_its_numbers(comparison, compared, hostile):
    words = shlex.split(compared.sections[0].command)
    options = list(zip(words[2::2], words[3::2], strict=True))
    chosen = {name: [value for option, value in options if option == name] for name, _ in options}
    again = evaluate(
        [name for name in chosen["--policy"] if name != hostile],
        chosen["--scenario"],
        episodes=int(chosen["--episodes"][0]),
        seed=int(chosen["--seed"][0]),
        hold_steps=int(chosen["--hold-steps"][0]),
    )
    label = compared.sections[0].name
    assert again.record(label, "static", "digits") == comparison.record(label, "static", "digits")


def test_figures_carry_the_episode(compared, pages):
    page = {attributes["id"]: text for attributes, text in pages["comparison"].all("script") if "id" in attributes}
    assert json.loads(page["figures"])["scenes"] == [section.name for section in compared.sections]
    packed = [json.loads(decompress(b64decode(text))) for name, text in page.items() if name.startswith("scene-")]
    for section, drawn in zip(compared.sections, packed, strict=True):
        scene = compared.scenes[section.name]
        frames = len(scene.t)
        offsets = np.frombuffer(b64decode(drawn["traces"]["static"]["estimates"]), "<f4").reshape(5, 5, frames)
        expected = scene.traces["static"].estimates - scene.equilibrium[:, None, None]
        np.testing.assert_allclose(offsets, expected, rtol=1e-6)
        for frame in range(frames):
            live = [links for start, links in drawn["live"] if start <= frame][-1]
            assert live == np.flatnonzero(scene.live[:, frame]).tolist()
    assert len(packed[2]["live"]) > 1  # the graph of energy-switching switches


def test_the_page_of_20_tracks_with_15_policies_is_of_a_size_that_loads_at_once(page_file):
    assert page_file("large").stat().st_size < 5e6
    assert page_file("suite").stat().st_size < 1.5e6  # of which Plotly takes 0.6


def test_plotly_is_the_file_that_npm_has():
    bundle = (resources.files("ptne_env.report") / "plotly" / "plotly-basic.min.js").read_bytes()
    assert b"plotly.js (basic - minified) v4.1.1" in bundle[:100]
    assert sha256(bundle).hexdigest() == "99784e3abfb07b142a15e521a439e6d9addceadb3f79553fd24c72774f0649ba"


def test_the_same_results_make_the_same_page(compared, page_file):
    assert render_page(compared) == page_file("comparison").read_text(encoding="utf-8")


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


def test_the_answer_says_when_who_is_first_most_often_is_behind_on_average(comparison):
    def spoiled(cell):
        if (cell.scenario, cell.policy) != ("energy", "grounded"):
            return cell
        return replace(cell, samples={**cell.samples, "digits": cell.samples["digits"] - 60})

    results = replace(comparison, cells=tuple(spoiled(cell) for cell in comparison.cells))
    answer = comparison_report(results, comparison_scenes(results), episodes=6, hold_steps=0).answer
    assert answer.startswith("grounded comes closest, or as close as the best, in ")
    behind = re.search(r"grounded stays ([\d.]+) \[([\d.]+), ([\d.]+)\] behind it\.$", answer)
    low, middle, high = float(behind[2]), float(behind[1]), float(behind[3])
    assert 0 < low <= middle <= high
