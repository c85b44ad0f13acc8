"""Tables on a terminal: columns that share its width; in a narrow one, the less important ones are left out."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from rich.console import Console, ConsoleOptions
    from rich.measure import Measurement
    from rich.text import Text

    _Shown = list[tuple["TableColumn", list[str]]]

_GAP: Final = 2  # spaces between two columns
_COMFORT: Final = {"middle": 24, "words": 40, "end": 40}  # characters that are enough, by how a column is narrowed
_LEAST: Final = {"middle": 10, "words": 12, "end": 12}  # characters below which nothing could be read


@dataclass(frozen=True)
class TableColumn:
    """A column of a table.

    Of cells that are too wide, the "middle" is left out, as of paths and names, or the "end", or they are continued in the
    next line ("words"). Columns of the highest rank are left out first if there is not enough room, those of 0 never, and
    those below 0 only if there is not even enough room for the narrowest forms of the others.
    """

    heading: str  # with the unit
    cell: Callable[[Any], str] = str  # returns the text of a row
    is_number: bool = False  # whether its cells are numbers, which are at the right
    narrowed: Literal["never", "middle", "words", "end"] = "never"
    rank: int = 0
    least: int = 0  # the least width; for tables that are printed in pages
    brief: Callable[[str], str] | None = None  # returns a shorter form of a cell, for when there is not enough room
    style: Callable[[str], str] | None = None  # returns the style of a cell

    def width(self, cells: Sequence[str], enough: Mapping[str, int] | None = None) -> int:
        """Return the width that cells need, or at most what is enough for a column that is narrowed as it is."""
        from rich.cells import cell_len

        whole = max([self.least, cell_len(self.heading), *(cell_len(line) for cell in cells for line in cell.split("\n"))])
        return min(whole, max(enough.get(self.narrowed, whole), self.least)) if enough else whole

    def shown(self, cell: str) -> _NarrowedText | Text:
        """Return what Rich prints of a cell, in the room that it has for the column."""
        from rich.text import Text

        style = self.style(cell) if self.style else ""
        if self.narrowed == "middle":
            return _NarrowedText(cell, style)
        return Text(cell, style, overflow="ellipsis", no_wrap=True) if self.narrowed == "end" else Text(cell, style)


def number_column(heading: str, cell: Callable[[Any], str], **looks: Any) -> TableColumn:
    """Return a column of numbers."""
    return TableColumn(heading, cell, is_number=True, **looks)


def name_column(heading: str, cell: Callable[[Any], str], **looks: Any) -> TableColumn:
    """Return a column of names of actors."""
    return TableColumn(heading, cell, narrowed="middle", brief=brief_actor, **looks)


def print_table(
    columns: Sequence[TableColumn], rows: Sequence[Sequence[str]], console: Console | None = None, *, headed: bool = True
) -> None:
    """Print a table on a console; None: that of the standard output.

    Characters that could control the terminal are shown as escape sequences. Columns without any text are left out.
    If others have to be left out in a narrow terminal, a last line names them.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = console or Console()
    every = [list(map(visible, cells)) for cells in zip(*rows, strict=True)] or [[]] * len(columns)
    shown = [(column, cells) for column, cells in zip(columns, every, strict=True) if any(cells) or not rows or column.least]
    if _room(shown) > console.width:
        shown = [(column, list(map(column.brief, cells)) if column.brief else cells) for column, cells in shown]
    kept = _kept(shown, console.width)
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, show_header=headed, pad_edge=False, padding=(0, 1, 0, 0))
    for column, _ in kept:
        table.add_column(
            Text(visible(column.heading)),
            justify="right" if column.is_number else "left",
            no_wrap=column.narrowed == "never",
            min_width=column.least,
            overflow="fold",
        )
    for row in zip(*(map(column.shown, cells) for column, cells in kept), strict=True):
        table.add_row(*row)
    console.print(table)
    dropped = dict.fromkeys(column.heading for column, cells in shown if (column, cells) not in kept)
    if dropped and headed:
        console.print(Text(f"({', '.join(dropped)}: in a wider terminal, or with --json)", style="dim"))


def fits(columns: Sequence[TableColumn], rows: Sequence[Sequence[str]], width: int) -> bool:
    """Return whether all columns of a table fit into a width, with those that may be narrowed as narrow as can be read."""
    shown = [list(map(visible, cells)) for cells in zip(*rows, strict=True)]
    return _room(list(zip(columns, shown, strict=True)), _LEAST) <= width


def _room(shown: _Shown, enough: Mapping[str, int] | None = None) -> int:
    return sum(column.width(cells, enough) for column, cells in shown) + _GAP * (len(shown) - 1)


def _kept(shown: _Shown, room: int) -> _Shown:
    """Return the columns, the most important first, for which there is enough room beside those that are never left out."""
    kept = [each for each in shown if not each[0].rank]
    for each in sorted((each for each in shown if each[0].rank), key=lambda each: each[0].rank):
        enough = _COMFORT if each[0].rank > 0 else _LEAST
        if _room(more := [one for one in shown if one in kept or one is each], enough) <= room:
            kept = more
    return kept


class _NarrowedText:
    """A text whose middle is left out if it is too wide."""

    def __init__(self, text: str, style: str) -> None:
        self._text, self._style = text, style

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        from rich.cells import cell_len
        from rich.measure import Measurement

        return Measurement(1, min(cell_len(self._text), options.max_width))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        from rich.text import Text

        yield Text(shortened(self._text, options.max_width), self._style)


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
