import json
import xml.etree.ElementTree as ET

import pytest
from rich.console import Console

from baselines.paper.claims import Claim
from baselines.paper.figures import FIGURES, draw
from baselines.paper.table import TableRow
from baselines.reproduce import Reproduction, draw_table_one, draw_verdicts, reproduce


def test_every_figure_is_written(reproduction):
    assert len(FIGURES) == 10
    expected = sorted([f"{spec.name}.svg" for spec in FIGURES] + ["results.json"])
    written = [path.name for path in reproduction.figures[0].parent.iterdir()]
    assert sorted(written) == expected  # no temporary file is left
    for path in reproduction.figures:
        assert ET.fromstring(path.read_bytes()).tag.endswith("svg")  # noqa: S314 - our own file


def test_captions_have_the_printed_number_of_the_paper(reproduction):
    for number, spec in enumerate(FIGURES, 1):
        picture = next(path for path in reproduction.figures if path.name == f"{spec.name}.svg")
        assert f"Fig. {number}. " in picture.read_text(encoding="utf-8")


def test_results_file_holds_all_numbers(reproduction):
    def refuse(constant):
        raise AssertionError(constant)

    path = reproduction.figures[0].with_name("results.json")
    data = json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    assert data == json.loads(json.dumps(reproduction.to_dict()))
    assert [row["paper"] for row in data["table_1"]] == [21.0, 13.0, 1.2]
    assert [row["ours"] for row in data["table_1"]] == [
        pytest.approx(21.57, abs=0.01),
        pytest.approx(13.22, abs=0.01),
        pytest.approx(0.794, abs=0.01),
    ]
    assert len(data["claims"]) == len(reproduction.claims)
    assert {claim["verdict"] for claim in data["claims"]} == {"holds", "fails"}


def test_figures_are_the_same_in_every_run(experiments):
    assert draw(FIGURES[1], experiments) == draw(FIGURES[1], experiments)


def test_existing_file_is_refused_as_directory(tmp_path):
    target = tmp_path / "file"
    target.write_text("kept")
    with pytest.raises(NotADirectoryError, match="name a directory"):
        reproduce(target)
    assert target.read_text() == "kept"


def test_the_tables_of_the_paper_have_its_rows_and_verdicts():
    rows = (TableRow("Proposed", 2.0, 20.0, 1.2, None, 0.1),)
    claims = (Claim("Theorem 1", "It converges.", "holds", "r = 0.28"), Claim("Erratum 1", "A misprint.", "fails", "0"))
    found = Reproduction(rows, claims, ())
    screen = Console(width=100, record=True)
    screen.print(draw_table_one(found, 100), *draw_verdicts(found))
    text = screen.export_text()
    assert [words in text for words in ("never", "r = 0.28", "holds", "not confirmed")] == [True] * 4
