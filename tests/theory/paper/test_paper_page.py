"""The page of the reproduction: captions, figures and verdicts."""

import dataclasses
import re
from html import unescape

import pytest

from ptne_env.bench.report.html import indexed
from ptne_env.shared.style import INK
from ptne_env.theory.paper.figures import FIGURES
from ptne_env.theory.paper.page import render_page


@pytest.fixture(scope="module")
def text(reproduction):
    return reproduction[0].page.read_text(encoding="utf-8")


def read(text):
    return unescape(re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", text)))


def test_every_figure_has_the_papers_caption_and_its_verdicts(text, claims):
    sections = text.split('<h3 id="figure-')[1:]
    assert len(sections) == len(FIGURES) == text.count('class="panels"')
    for section, spec in zip(sections, FIGURES, strict=True):
        shown = read(section)
        assert f'">{spec.number} ' in shown
        assert read(indexed(spec.original)) in shown
        assert f"Ours: {read(indexed(spec.caption))}" in shown
        assert re.search(r"\bruns?\b", spec.caption), "a caption says how many runs the figure shows"
        assert spec.claims
        for name in spec.claims:
            assert re.search(
                rf"{re.escape(name)} (holds|fails|confirmed) {re.escape(read(indexed(claims[name].finding)))}", shown
            )
    assert [spec.number for spec in FIGURES[:10]] == [f"Fig. {number}" for number in range(1, 11)]


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("x^i_j(t), κ_ij", "x<sup>i</sup><sub>j</sub>(t), κ<sub>ij</sub>"),
        ("(T−t)^-0.719; e^{(1−2r)s}", "(T−t)<sup>−0.719</sup>; e<sup>(1−2r)s</sup>"),
        ("e^(0.4 s) < 1 of ptne_env", "e<sup>0.4 s</sup> &lt; 1 of ptne_env"),
    ],
)
def test_indices_and_exponents_stand_below_and_above_the_line(text, shown):
    assert indexed(text) == shown


def test_every_claim_and_erratum_has_its_verdict(text, claims):
    articles = re.findall(r'<article class="claim" id="([^"]+)">(.*?)</article>', text, re.DOTALL)
    assert len({identifier for identifier, _ in articles}) == len(articles) == len(claims)
    words = {True: {"holds": "confirmed", "fails": "not confirmed"}, False: {"holds": "holds", "fails": "fails"}}
    for (_, article), claim in zip(articles, claims.values(), strict=True):
        shown = read(article)
        for part in (claim.name, claim.statement, claim.criterion, claim.finding):
            assert read(indexed(part)) in shown
        assert f'{claim.verdict}">{words[claim.name.startswith("Erratum")][claim.verdict]}</strong>' in article
    assert set(re.findall(r'href="#(claim-\d+)"', text)) <= {identifier for identifier, _ in articles}


def test_table_1_has_the_papers_times(text, reproduction):
    table = read(text[text.index("<tbody>") : text.index("</tbody>")])
    for row in reproduction[0].table:
        assert (
            f"{row.algorithm} {row.kappa:g} {row.gain:g} {row.paper:g} {row.ours:.2f} {row.at_paper_time:.2g}" in table
        )


def test_answer_counts_the_claims_that_hold(text, reproduction):
    answer = unescape(re.search(r'id="answer">(.*?)</p>', text, re.DOTALL)[1])
    assert answer.startswith("8 of 11 claims hold when measured. Failing: Theorem 2, smoothness of u; ")
    result = reproduction[0]
    table = [dataclasses.replace(row, ours=None) for row in result.table]
    held = [dataclasses.replace(claim, verdict="holds") for claim in result.claims]
    page = render_page(table, held, {spec.name: [] for spec in FIGURES}, {}, "out")
    assert "11 of 11 claims hold when measured. Failing: none" in page
    assert "<td>never</td>" in page


def test_figures_have_the_colours_of_the_page(text):
    pictures = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    assert len(pictures) >= 2 * len(FIGURES) - 6
    for picture in pictures:
        assert "var(--ink)" in picture
        assert [colour for colour in ("#ffffff", "#000000", INK) if colour in picture] == []


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "light"), (390, "dark")])
def test_browser_shows_the_page_without_errors(open_file, reproduction, width, scheme):
    page = open_file(reproduction[0].page, width, scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    pictures = page.locator("main .panels")
    assert pictures.count() == len(FIGURES)
    for picture in pictures.all():
        assert picture.get_attribute("aria-label")
        for panel in picture.locator("svg").all():
            assert panel.evaluate("panel => panel.getBoundingClientRect().width") >= min(width, 500) / 4
    letters = page.locator("main .panels").first.evaluate("picture => getComputedStyle(picture).fill")
    assert letters == page.evaluate("getComputedStyle(document.body).color")  # readable in the dark
    page.locator("a", has_text="Theorem 1").first.click()
    assert page.evaluate("document.querySelector(':target h3').textContent") == "Theorem 1"
