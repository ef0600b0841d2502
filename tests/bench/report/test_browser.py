"""The page of results in a real browser: clicks, sorting and scrubbing, without errors in the console."""

import importlib
import re
from pathlib import Path

import numpy as np
import pytest

from ptne_env import get_scenario

playwright = pytest.importorskip("playwright.sync_api", reason="needs Playwright: pip install 'ptne-env[test]'")


@pytest.fixture
def visit(open_file, page_file):
    """Opens a page by name and waits for its figures."""

    def open_page(name, *arguments, **keywords):
        page = open_file(page_file(name), *arguments, **keywords)
        page.wait_for_selector(".card" if name in ("episode", "held") else ".chart .main-svg")
        return page

    return open_page


def column(page, index):
    return page.eval_on_selector_all(
        "#leaderboard tbody tr",
        f"rows => rows.map(row => row.cells[{index}].dataset.value ?? row.cells[{index}].textContent)",
    )


def uncheck_all(boxes):
    for _ in range(boxes.count()):
        boxes.first.uncheck()


def test_click_on_a_heading_sorts(visit, hostile):
    page = visit("comparison")
    heading = page.locator("#leaderboard thead th").filter(has=page.locator("button", has_text="mean digits"))
    index = heading.evaluate("heading => heading.cellIndex")
    heading.locator("button").click()
    assert heading.get_attribute("aria-sort") == "descending"
    *values, _ = map(float, column(page, index))  # the oracle stays apart, below
    assert values == sorted(values, reverse=True)
    assert "mean digits" in page.locator("#status").text_content()
    heading.locator("button").press("Enter")
    assert heading.get_attribute("aria-sort") == "ascending"
    assert list(map(float, column(page, index)))[:-1] == sorted(values)
    page.locator("#leaderboard thead button").first.click()
    assert heading.get_attribute("aria-sort") == "none"
    names = page.eval_on_selector_all("#leaderboard tbody th", "cells => cells.map(cell => cell.textContent)")
    assert names[:-1] == sorted(names[:-1], key=str.casefold)
    assert names[-1].startswith("oracle")
    assert hostile in names


def test_cells_without_a_value_come_last_in_either_order(visit):
    page = visit("comparison")
    for _ in range(2):
        page.locator("#leaderboard thead button", has_text="first").click()
        assert column(page, 2)[-1] == "–"  # the oracle has no first places


def test_player_shows_the_instant_of_the_slider(visit, comparison_report):
    page = visit("comparison")
    page.locator("#player-scene").select_option(label="energy-switching")
    scene = comparison_report.scenes["energy-switching"]
    slider, cards = page.locator("#player-frame"), page.locator("#player-cards .card")
    assert int(slider.get_attribute("max")) == len(scene.t) - 1 == get_scenario("energy-switching").steps
    assert cards.count() == 2
    names = cards.locator("h3").all_text_contents()
    cards.first.locator("summary").click()
    seen = set()
    for frame in (0, 117, 300):
        slider.fill(str(frame))
        assert page.locator("#player-instant").text_content().startswith(f"t = {scene.t[frame]:.3f} s")
        assert slider.get_attribute("aria-valuetext") == page.locator("#player-instant").text_content()
        trace = scene.traces[names[0]]
        strategies = cards.first.locator("tbody tr td:nth-child(2)").all_text_contents()
        for component, text in enumerate(strategies):
            assert float(text) == pytest.approx(trace.strategies[component, frame], rel=5e-3)  # three digits
        links = [f"{i}–{j}" for (i, j), up in zip(scene.links, scene.live[:, frame], strict=True) if up]
        caption = cards.first.locator("figcaption", has_text="Live links").text_content()
        assert caption == f"Live links: {', '.join(links)}"
        assert cards.first.locator("line.up").count() == len(links)
        seen.add(caption)
    assert len(seen) > 1
    cursor = cards.first.locator("line.cursor").first
    before = float(cursor.get_attribute("x1"))
    slider.press("ArrowRight")
    assert float(cursor.get_attribute("x1")) > before


def test_the_player_selects_the_winner_and_the_users_own_policy(visit, hostile):
    page = visit("comparison")
    cards = page.locator("#player-cards .card h3")
    assert cards.all_text_contents() == ["grounded", hostile]
    page.locator("#player-scene").select_option(label="energy-switching")
    assert cards.all_text_contents() == ["grounded", hostile]
    uncheck_all(page.locator("#player-choice input:checked"))
    assert cards.count() == 0
    assert page.locator("#player-cards").text_content() == "No policy is chosen: tick one above."
    page.locator("#player-choice input[value=static]").check()
    page.locator("#player-scene").select_option(label="energy")
    assert cards.all_text_contents() == ["static"]  # the reader's choice is kept


def test_a_figure_without_policies_says_so(visit):
    page = visit("comparison")
    section = page.locator("details.section").first
    uncheck_all(section.locator(".choice input:checked"))
    section.locator(".annotation-text", has_text="No policy is chosen").wait_for()


def test_players_have_the_numbers_of_their_agents(visit):
    page = visit("comparison")
    card = page.locator("#player-cards .card").first
    card.locator("summary").click()
    numbers = ["0", "1", "2", "3", "4"]  # player_0 …
    assert card.locator("svg text.name").all_text_contents() == numbers
    assert card.locator("tbody th").all_text_contents() == numbers


def test_the_axis_of_transformed_time_explains_the_steps_after_the_deadline(visit):
    page = visit("held")
    note, line = page.locator("#player-note"), page.locator("#player-cards .card path[stroke-width]").first
    assert note.is_hidden()
    whole = line.get_attribute("d").count("L")
    page.locator("#player-axis").select_option("s")
    assert note.text_content().startswith(
        "Transformed time s ends at the deadline T. The 30 steps after T have no place"
    )
    assert line.get_attribute("d").count("L") == whole - 30
    page.locator("#player-axis").select_option("t")
    assert note.is_hidden()


def test_robots_move_on_a_map_in_the_plane(visit, suite_report):
    page = visit("suite")
    assert page.locator("#player-cards svg[aria-label^='Communication graph']").count() == 2
    page.locator("#player-scene").select_option(label="robots")
    drawn = page.locator("#player-cards svg[aria-label^='Map of the players, grounded']")
    drawn.wait_for()
    assert drawn.locator("circle.node").count() == 5
    assert page.locator("#player-cards figcaption", has_text="Map of the players: lines are their paths").count() > 0
    scene = suite_report.scenes["robots"]
    strategies = scene.traces["grounded"].strategies
    places = []
    for frame in (0, 30, 200):
        page.locator("#player-frame").fill(str(frame))
        nodes = drawn.locator("circle.node").all()
        found = np.array([[float(node.get_attribute(name)) for name in ("cx", "cy")] for node in nodes])
        places.append((found, strategies[:, frame].reshape(-1, 2)))
    # The map is the plane, turned over because y points down in pictures, with one scale for both axes.
    scale = [np.diff(shown[[0, 3]], axis=0) / np.diff(at[[0, 3]], axis=0) for shown, at in places]
    np.testing.assert_allclose(np.abs(scale), np.abs(scale[0][0, 0]), rtol=0.01)
    assert all(factors[0, 0] > 0 > factors[0, 1] for factors in scale)


def test_policies_are_shown_side_by_side_and_the_episode_plays(visit):
    page = visit("suite", width=1000)
    cards, box = page.locator("#player-cards .card"), page.locator("#player-choice input:not(:checked)").first
    assert cards.count() == 2
    added = box.get_attribute("value")
    assert added not in cards.locator("h3").all_text_contents()
    box.click()
    assert cards.count() == 3
    assert added in cards.locator("h3").all_text_contents()
    page.locator("#player-view").select_option("distance")
    assert cards.locator("figcaption", has_text="Distances of strategies").count() == 3
    page.locator("#player-play").click()
    playwright.expect(page.locator("#player-frame")).to_have_value(re.compile("[3-9]$"), timeout=60_000)
    page.locator("#player-play").click()
    assert page.locator("#player-play").text_content() == "Play"
    page.locator("#player-scene").select_option(label="robots")
    assert cards.count() >= 1


def test_figures_show_the_chosen_policies(visit):
    page = visit("suite")
    section = page.locator("details.section").nth(1)
    assert section.locator(".main-svg").count() == 0
    section.locator("summary").first.click()
    section.locator(".main-svg").first.wait_for()
    lines = section.locator(".chart .scatterlayer .trace .js-line")
    count = lines.count()
    section.locator(".choice input:checked").first.uncheck()
    playwright.expect(lines).not_to_have_count(count)
    assert 0 < lines.count() < count
    boxes = page.locator("#profiles-choice input")
    assert boxes.count() == len(set(page.locator("#leaderboard tbody th").all_text_contents()))


@pytest.mark.parametrize("name", ["comparison", "suite"])
def test_all_columns_fit_a_desktop(visit, name):
    page = visit(name, 1440)
    page.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")
    wide = "regions => regions.filter(each => each.scrollWidth > each.clientWidth).map(each => each.ariaLabel)"
    assert page.eval_on_selector_all(".scroll", wide) == []


@pytest.mark.parametrize("name", ["comparison", "suite"])
def test_a_phone_shows_the_first_numbers_of_every_table(visit, name):
    page = visit(name, 390)
    page.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")
    hidden = """tables => tables.filter(each => {
        const first = each.querySelector("tbody td"), region = each.closest(".scroll");
        return first.getBoundingClientRect().right > region.getBoundingClientRect().right;
    }).map(each => each.caption.textContent)"""
    assert page.eval_on_selector_all("table.sortable", hidden) == []


@pytest.mark.parametrize("name", ["comparison", "suite", "large"])
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "light"), (390, "dark")])
def test_page_never_overflows(visit, name, width, scheme):
    page = visit(name, width, scheme)
    page.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")
    page.evaluate("document.querySelectorAll('option').forEach(each => { each.textContent += ' with a long name'; })")
    page.wait_for_timeout(300)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert ground == {"light": "rgb(255, 255, 255)", "dark": "rgb(20, 23, 27)"}[scheme]


def test_episode_has_a_page_of_its_own(visit):
    page = visit("episode")
    assert page.locator("#player-cards .card h3").all_text_contents() == ["static"]
    page.locator("#player-frame").fill("9")
    assert page.locator("#player-cards .card .cursor").count() == 3


def test_20_tracks_with_15_policies_load_in_2_seconds_of_processor_time(visit, browser, page_file, monkeypatch):
    """Processor time, because other tests run beside this one."""
    page = visit("large")
    assert page.locator("details.section").count() == 20
    assert page.locator("#section-0 table").first.locator("tbody tr").count() == 15
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2]))
    times = importlib.import_module("benchmarks.report_page").load(browser, page_file("large"))
    assert 0 < times["first paint"] < times["first figure"]
    assert times["processor time"] < 2000
