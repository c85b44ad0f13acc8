"""Queries: what an answer is, and one module per query."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from carla_recap.tables import Rows

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.formats.base import Reader

T = TypeVar("T")


class Answer(Rows[T]):
    """The rows that answer a query, with the header and the extent of the recording, which has been read to its end."""

    def __init__(self, rows: Iterable[T], source: Reader, *, compat: bool) -> None:
        super().__init__(rows)
        self.header = source.header
        self.extent = source.extent()
        self.compat = compat
