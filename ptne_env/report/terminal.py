"""Tables in a terminal, drawn with rich; the functions return renderables and print nothing."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Collection, Iterable

from rich import box
from rich.cells import cell_len
from rich.console import Group, RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from ptne_env.evaluation.results import Results
from ptne_env.report.tables import Column, Table, answer, answer_table, leaders, track_tables


def draw_table(table: Table, width: int, *, keep: Collection[str] | None = None) -> Group:
    """Return a table in as many pieces, one below the other, as a terminal of ``width`` columns demands.

    With ``keep`` there is one piece: the last columns that find no room in it, and are not of these, are named below.
    """
    names = {row: textwrap.fill(row, 24) for row in (*table.rows, *table.totals)}
    room = width - max((cell_len(line) for name in names.values() for line in name.splitlines()), default=0) - 2
    needed = {column.label: _needed_width(column, names) for column in table.columns}
    hidden = list[str]()
    for label in () if keep is None else [label for label in reversed(needed) if label not in keep]:
        if sum(needed.values()) > room:
            hidden.insert(0, label)
            del needed[label]
    pieces: list[list[Column]] = []
    left = 0
    for column in [column for column in table.columns if column.label in needed]:
        if not pieces or (keep is None and needed[column.label] > left):
            pieces.append([])
            left = room
        pieces[-1].append(column)
        left -= needed[column.label]
    drawn: list[RenderableType] = [Text(table.caption, style="italic")]
    drawn += [_draw_piece(table, names, columns) for columns in pieces]
    if hidden:
        drawn.append(Text(f"A wider terminal, or --details, also shows {', '.join(hidden)}.", style="dim"))
    return Group(*drawn, *(Text(note, style="dim") for note in table.notes), Text())


def _needed_width(column: Column, rows: Iterable[str]) -> int:
    """Return the width of a column, with its margin."""
    texts = [_break_heading(column), *(text for row in rows for text in (column[row].text, column[row].interval))]
    return 3 + max(cell_len(line) for text in texts for line in text.splitlines())


def _draw_piece(table: Table, names: dict[str, str], columns: list[Column]) -> RichTable:
    piece = RichTable(box=box.SIMPLE_HEAD, pad_edge=False)
    piece.add_column(table.subject)
    for column in columns:
        piece.add_column(Text(_break_heading(column)), justify="right", no_wrap=True)
    for row, name in names.items():
        cells = []
        for column in columns:
            cell = Text(column[row].text)
            if column[row].interval:
                cell.append(f"\n{column[row].interval}", style="dim")
            cells.append(cell)
        piece.add_row(Text(name), *cells, end_section=row == table.rows[-1] and bool(table.totals))
    return piece


def _break_heading(column: Column) -> str:
    """Return the label in lines, broken after blanks and signs within names, and where a word is too long.

    80 columns then have room for the names of the tracks of ptne-v1 and four policies.
    """
    lines = re.findall(r".{1,11}(?:(?<=[-_:./ ])|$)|\S{1,15}\s?", column.label)
    return "\n".join(line.strip() for line in lines)


def answer_tables(results: Results, width: int, *, whole: bool = False) -> Group:
    """Return one table of digits that fits into ``width`` columns, and the sentences of :func:`answer`.

    The last policies, which find no room, are named below it, but :func:`leaders` stay; a ``whole`` table has all.
    """
    keep = None if whole else [results.policies[name].label for name in leaders(results)]
    sentences = (Text(textwrap.fill(sentence, min(width, 100))) for sentence in answer(results))
    return Group(draw_table(answer_table(results), width, keep=keep), *sentences, Text())


def result_tables(results: Results, width: int = 172) -> Group:
    """Return the tables of every track in ``width`` columns."""
    return Group(*(draw_table(table, width) for track in results.tracks for table in track_tables(results, track)))
