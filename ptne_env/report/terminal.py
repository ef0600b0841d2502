"""Tables in a terminal, drawn with rich; the functions return renderables and print nothing."""

from __future__ import annotations

import re
import textwrap

from rich import box
from rich.cells import cell_len
from rich.console import Group, RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from ptne_env.evaluation.results import Results
from ptne_env.report.tables import Column, Table, answer, answer_table, track_tables


def draw_table(table: Table, width: int, *, whole: bool = True) -> Group:
    """Return a table in as many pieces, one below the other, as a terminal of ``width`` columns demands.

    Unless it is ``whole``, there is one piece, and a note names the columns that find no room in it.
    """
    names = {row: textwrap.fill(row, 24) for row in table.rows}
    room = width - max((cell_len(line) for name in names.values() for line in name.splitlines()), default=0) - 2
    pieces: list[list[Column]] = []
    left = 0
    for column in table.columns:
        cells = [column[row] for row in table.rows]
        texts = [_break_heading(column), *(text for cell in cells for text in (cell.text, cell.interval))]
        needed = 3 + max(cell_len(line) for text in texts for line in text.splitlines())
        if needed > left or not pieces:
            pieces.append([])
            left = room
        pieces[-1].append(column)
        left -= needed
    drawn: list[RenderableType] = [Text(table.caption, style="italic")]
    drawn += [_draw_piece(table, names, columns) for columns in (pieces if whole else pieces[:1])]
    if not whole and pieces[1:]:
        hidden = ", ".join(column.label for piece in pieces[1:] for column in piece)
        drawn.append(Text(f"A wider terminal, or --details, also shows {hidden}.", style="dim"))
    return Group(*drawn, *(Text(note, style="dim") for note in table.notes), Text())


def _draw_piece(table: Table, names: dict[str, str], columns: list[Column]) -> RichTable:
    piece = RichTable(box=box.SIMPLE_HEAD, pad_edge=False)
    piece.add_column(table.subject)
    for column in columns:
        piece.add_column(Text(_break_heading(column)), justify="right", no_wrap=True)
    for row in table.rows:
        cells = []
        for column in columns:
            cell = Text(column[row].text)
            if column[row].interval:
                cell.append(f"\n{column[row].interval}", style="dim")
            cells.append(cell)
        piece.add_row(Text(names[row]), *cells)
    return piece


def _break_heading(column: Column) -> str:
    """Return the label in lines, broken after blanks and signs within names, and where a word is too long.

    80 columns then have room for the names of the tracks of ptne-v1 and four policies.
    """
    lines = re.findall(r".{1,11}(?:(?<=[-_:./ ])|$)|\S{1,15}\s?", column.label)
    return "\n".join(line.strip() for line in lines)


def answer_tables(results: Results, width: int) -> Group:
    """Return one table of digits that fits into ``width`` columns, and the sentences of :func:`answer`.

    Policies that find no room are named below the table, but the paper's law always finds room.
    """
    sentences = (Text(textwrap.fill(sentence, min(width, 100))) for sentence in answer(results))
    return Group(draw_table(answer_table(results), width, whole=False), *sentences, Text())


def result_tables(results: Results, width: int = 172) -> Group:
    """Return the tables of every track in ``width`` columns."""
    return Group(*(draw_table(table, width) for track in results.tracks for table in track_tables(results, track)))
