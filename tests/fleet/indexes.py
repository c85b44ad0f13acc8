"""What an index contains, in forms that can be compared."""

from __future__ import annotations

from pathlib import Path

from carla_recap import open_index
from carla_recap.fleet.index.tables import TABLES


def contents(index):
    """Return the rows of all tables as sorted texts, in which all NaNs are equal."""
    with open_index(index) as opened:
        return {name: sorted(map(repr, opened.table(name).to_pylist())) for name in TABLES}


def recordings(index):
    """Return the rows of the recordings, by file name."""
    return {Path(row["recording"]).name: row for row in open_index(index).table("recordings").to_pylist()}
