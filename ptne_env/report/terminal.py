"""Tables in a terminal, drawn with rich. Every function returns a renderable and prints nothing."""

from __future__ import annotations

import re
import textwrap

from rich import box
from rich.cells import cell_len
from rich.console import Group, RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from ptne_env.evaluation.results import Results
from ptne_env.report.tables import Column, Table, answer, answer_table, leaderboard_table, track_tables

_NAME_WIDTH = 24
"""Names of rows are broken at hyphens into lines of at most this length."""

_HEADING_WIDTH, _WORD_WIDTH = 11, 15
"""Headings are broken into lines of at most the first length, a long word of the second: 80 columns have room for the
names of the tracks of ptne-v1 and four policies."""

_TEXT_WIDTH = 100
"""Sentences are broken into lines of at most this length."""

_TEXT_COLUMN = 24
"""Room that a column of words asks for at most; rich wraps them."""

_STYLES = {"holds": "green", "agree": "green", "reproduces": "green", "fails": "red", "differs": "red"}
"""Colours of cells with one of these words."""


def show(table: Table, width: int, *, whole: bool = True) -> Group:
    """A table in as many pieces, one below the other, as the width asks for.

    Args:
        table: to draw.
        width: columns of the terminal.
        whole: whether columns that find no room follow in further pieces; else they are named below the table.
    """
    names = {row: textwrap.fill(row, _NAME_WIDTH) for row in table.rows}
    room = width - max((cell_len(line) for name in names.values() for line in name.splitlines()), default=0) - 2
    pieces: list[list[Column]] = []
    left = 0
    for column in table.columns:
        texts = [_heading(column), *(part for row in table.rows for part in (column[row].text, column[row].interval))]
        needed = 3 + max(cell_len(line) for text in texts for line in text.splitlines())
        if any(cell.is_text for cell in column.cells.values()):
            needed = min(needed, _TEXT_COLUMN)
        if needed > left or not pieces:
            pieces.append([])
            left = room
        pieces[-1].append(column)
        left -= needed
    drawn: list[RenderableType] = [Text(table.caption, style="italic")]
    drawn += [_piece(table, names, columns) for columns in (pieces if whole else pieces[:1])]
    if not whole and pieces[1:]:
        hidden = ", ".join(column.label for piece in pieces[1:] for column in piece)
        drawn.append(Text(f"A wider terminal, or --details, also shows {hidden}.", style="dim"))
    return Group(*drawn, *(Text(note, style="dim") for note in table.notes), Text())


def _piece(table: Table, names: dict[str, str], columns: list[Column]) -> RichTable:
    piece = RichTable(box=box.SIMPLE_HEAD, pad_edge=False)
    piece.add_column(table.subject)
    for column in columns:
        is_text = any(cell.is_text for cell in column.cells.values())
        piece.add_column(Text(_heading(column)), justify="left" if is_text else "right", no_wrap=not is_text)
    for row in table.rows:
        cells = []
        for column in columns:
            cell = Text(column[row].text, style=_STYLES.get(column[row].text.partition(" ")[0], ""))
            if column[row].interval:
                cell.append(f"\n{column[row].interval}", style="dim")
            cells.append(cell)
        piece.add_row(Text(names[row]), *cells)
    return piece


def _heading(column: Column) -> str:
    """The label in lines: broken after a blank or a sign within names, or where a word is too long."""
    lines = re.findall(rf".{{1,{_HEADING_WIDTH}}}(?:(?<=[-_:./ ])|$)|\S{{1,{_WORD_WIDTH}}}\s?", column.label)
    return "\n".join(line.strip() for line in lines)


def answer_tables(results: Results, width: int) -> Group:
    """One table of digits that fits the terminal, and one or two sentences.

    Args:
        results: of a comparison or of another suite.
        width: columns of the terminal; policies that find no room are named below the table, never the paper's law.
    """
    sentences = (Text(textwrap.fill(sentence, min(width, _TEXT_WIDTH))) for sentence in answer(results))
    return Group(show(answer_table(results), width, whole=False), *sentences, Text())


def result_tables(results: Results, width: int = 172) -> Group:
    """All tables: those of every track, then the leaderboard of a suite.

    Args:
        results: of a comparison or of another suite.
        width: columns of the terminal.
    """
    tables = [table for track in results.tracks for table in track_tables(results, track)]
    board = leaderboard_table(results)
    return Group(*(show(table, width) for table in [*tables, *([board] if board else [])]))
