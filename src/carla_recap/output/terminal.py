"""Tables on a terminal: columns that share its width; in a narrow one, the less important ones are left out."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from rich.console import Console

_GAP: Final = 2  # spaces between two columns
_COMFORT: Final = {
    "never": 0,
    "middle": 24,
    "words": 40,
    "end": 40,
}  # characters that are enough, by how a column is narrowed
_LEAST: Final = {"never": 0, "middle": 10, "words": 12, "end": 12}  # characters below which nothing could be read


@dataclass(frozen=True)
class TableColumn:
    """A column of a table.

    Attributes:
        heading: Its heading, with the unit.
        is_number: Whether its cells are numbers, which are at the right.
        narrowed: What is done with cells that are too wide: "middle" is left out, as of paths and names, or their "end", or
            they are continued in the next line ("words").
        rank: How soon it is left out if there is not enough room: the highest first, 0 never; below 0 only if
            there is not even enough room for the narrowest forms of the others.
        least: The least width; for tables that are printed in pages.
        brief: Returns a shorter form of a cell, for when there is not enough room.
        style: Returns the style of a cell.
    """

    heading: str
    is_number: bool = False
    narrowed: Literal["never", "middle", "words", "end"] = "never"
    rank: int = 0
    least: int = 0
    brief: Callable[[str], str] | None = None
    style: Callable[[str], str] | None = None

    def width(self, cells: Sequence[str]) -> int:
        """Return the width that cells need."""
        from rich.cells import cell_len

        return max([self.least, cell_len(self.heading), *(cell_len(line) for cell in cells for line in cell.split("\n"))])


def print_table(
    console: Console, columns: Sequence[TableColumn], rows: Sequence[Sequence[str]], *, headed: bool = True
) -> None:
    """Print a table; characters that could control the terminal are shown as escape sequences.

    Columns without any text are left out. If others have to be left out in a narrow terminal, a last line names them.

    Args:
        console: The console to print to.
        columns: The columns.
        rows: The cells of each row.
        headed: Whether it has headings.
    """
    shown = [list(map(visible, cells)) for cells in zip(*rows, strict=True)] or [[] for _ in columns]
    kept = [number for number, cells in enumerate(shown) if any(cells) or not rows or columns[number].least]
    if _total(columns, shown, kept) > console.width:
        for number in kept:
            brief = columns[number].brief
            if brief is not None:
                shown[number] = list(map(brief, shown[number]))
    dropped = _drop(columns, shown, kept, console.width)
    widths = _widths(columns, shown, kept, console.width)
    console.print(_made(columns, shown, kept, widths, headed=headed))
    if dropped and headed:
        from rich.text import Text

        names = ", ".join(dict.fromkeys(columns[number].heading for number in sorted(dropped)))
        console.print(Text(f"({names}: in a wider terminal, or with --json)", style="dim"))


def fits(columns: Sequence[TableColumn], rows: Sequence[Sequence[str]], width: int) -> bool:
    """Return whether all columns of a table fit into a width, with those that may be narrowed as narrow as can be read."""
    shown = [list(map(visible, cells)) for cells in zip(*rows, strict=True)]
    kept = range(len(columns))
    return sum(_limited(columns, shown, kept, _LEAST)) + _GAP * (len(kept) - 1) <= width


def _made(
    columns: Sequence[TableColumn],
    shown: Sequence[Sequence[str]],
    kept: Sequence[int],
    widths: Sequence[int],
    *,
    headed: bool,
) -> Any:
    """Return a table of Rich's."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, show_header=headed, pad_edge=False, padding=(0, 1, 0, 0))
    for number, width in zip(kept, widths, strict=True):
        column = columns[number]
        heading = Text(visible(column.heading))
        table.add_column(heading, justify="right" if column.is_number else "left", width=width, overflow="fold")
    for cells in zip(*(shown[number] for number in kept), strict=True):
        table.add_row(
            *(
                Text(_narrowed(cell, columns[number], width), columns[number].style(cell) if columns[number].style else "")  # type: ignore[misc]
                for cell, number, width in zip(cells, kept, widths, strict=True)
            )
        )
    return table


def _narrowed(cell: str, column: TableColumn, width: int) -> str:
    from rich.cells import cell_len, set_cell_size

    if column.narrowed == "middle":
        return shortened(cell, width)
    is_cut = column.narrowed == "end" and cell_len(cell) > width
    return set_cell_size(cell, max(width - 1, 0)) + "…" if is_cut else cell


def shortened(text: str, width: int) -> str:
    """Return a text of at most a width, with an ellipsis in its middle if it is longer."""
    from rich.cells import cell_len, set_cell_size

    if cell_len(text) <= width:
        return text
    end = max(width - 1, 0) * 2 // 3  # ends of paths and names say more than their starts
    tail = text[len(text) - end :] if end else ""
    while cell_len(tail) > end:
        tail = tail[1:]
    return set_cell_size(text, max(width - 1 - cell_len(tail), 0)) + "…" + tail


def _total(columns: Sequence[TableColumn], shown: Sequence[Sequence[str]], kept: Sequence[int]) -> int:
    return sum(columns[number].width(shown[number]) for number in kept) + _GAP * (len(kept) - 1)


def _limited(
    columns: Sequence[TableColumn], shown: Sequence[Sequence[str]], kept: Sequence[int], enough: Mapping[str, int]
) -> list[int]:
    """Return the width of each column, at most what is enough for one that is narrowed as it is."""
    found = []
    for number in kept:
        column, whole = columns[number], columns[number].width(shown[number])
        found.append(whole if column.narrowed == "never" else min(whole, max(enough[column.narrowed], column.least)))
    return found


def _drop(columns: Sequence[TableColumn], shown: Sequence[Sequence[str]], kept: list[int], room: int) -> list[int]:
    """Remove the less important columns for which there is not enough room; return these."""
    dropped: list[int] = []

    def fits(enough: Mapping[str, int], among: Sequence[int]) -> bool:
        return sum(_limited(columns, shown, among, enough)) + _GAP * (len(among) - 1) <= room

    for enough, sign in ((_COMFORT, 1), (_LEAST, -1)):
        ranked = [number for number in kept if columns[number].rank * sign > 0]
        for number in sorted(ranked, key=lambda number: (columns[number].rank, number), reverse=True):
            if not fits(enough, kept):
                dropped.append(number)
                kept.remove(number)
    for number in reversed(dropped):  # a narrow one may fit, where a wide one was in its way
        if fits(_COMFORT, more := sorted([*kept, number])):
            kept[:] = more
            dropped.remove(number)
    return dropped


def _widths(columns: Sequence[TableColumn], shown: Sequence[Sequence[str]], kept: Sequence[int], room: int) -> list[int]:
    """Return the widths of columns that share a room."""
    room -= _GAP * (len(kept) - 1)
    widths = _limited(columns, shown, kept, _COMFORT)
    whole = [columns[number].width(shown[number]) for number in kept]
    for index, number in sorted(enumerate(kept), key=lambda each: columns[each[1]].narrowed):  # "middle" before "words"
        if columns[number].narrowed != "never":
            widths[index] += max(min(whole[index] - widths[index], room - sum(widths)), 0)
    for least in (_LEAST, dict.fromkeys(_LEAST, 1)):  # numbers are whole for as long as there is room for them
        while sum(widths) > room:
            spare = [
                0 if columns[number].narrowed == "never" else width - least[columns[number].narrowed]
                for width, number in zip(widths, kept, strict=True)
            ]
            if max(spare) <= 0:
                break
            widths[max(range(len(kept)), key=lambda index: (spare[index] > 0, widths[index]))] -= 1
    return widths


def brief_actor(name: str) -> str:
    """Return the name of an actor without its kind, which its blueprint says: `tesla.model3 (hero)`."""
    return re.sub(r"\b(?:vehicle|walker)\.(?=\w)", "", name)


def actor_style(kind: str) -> str:
    """Return the style of a kind of actor."""
    return {"vehicle": "cyan", "walker": "magenta", "": ""}.get(kind, "dim")


INCIDENT_STYLES: Final = {
    "collision": "red",
    "red light": "magenta",
    "wrong way": "magenta",
    "off road": "magenta",
    "stop sign": "magenta",
    "near miss": "yellow",
    "hard braking": "yellow",
    "speeding": "magenta",
    "blocked": "cyan",
}
"""The styles of kinds of incidents, by name; another kind has none."""
