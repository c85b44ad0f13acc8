"""The blueprints of CARLA 0.9.16 that have a body, as tables, and their sizes.

`vehicles.csv`, `walkers.csv` and `props.csv` beside this module list them.
"""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal

if TYPE_CHECKING:
    from collections.abc import Mapping

Table = Literal["vehicles", "walkers", "props"]
Size = tuple[float, float, float]
"""Length, width and height in m."""

_PREFIXES: Final[dict[Table, str]] = {"vehicles": "vehicle", "walkers": "walker", "props": "static.prop"}


def blueprint_rows(table: Table) -> list[dict[str, str]]:
    """Return the rows of a table; their ids lack the prefix of the family."""
    with Path(__file__).with_name(f"{table}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@cache
def blueprint_sizes() -> Mapping[str, Size]:
    """Return the sizes of CARLA's boxes, or close to them, by blueprint; the length and width of a walker are the same."""
    return MappingProxyType(
        {
            f"{prefix}.{row['id']}": (float(row.get("length", row["width"])), float(row["width"]), float(row["height"]))
            for table, prefix in _PREFIXES.items()
            for row in blueprint_rows(table)
        }
    )
