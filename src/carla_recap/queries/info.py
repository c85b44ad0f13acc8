"""Info: the events of a recording, or all its records."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.layout import FLAG, Framing, Layout, Records

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.formats.base import Reader
    from carla_recap.model.frame import Extent, Frame, Header

EVENTS: Final = ("spawned", "destroyed", "parented", "collisions")
"""The record types of events."""


@dataclass(frozen=True, slots=True)
class InfoRow:
    """A record and its time.

    Attributes:
        elapsed: Seconds since the recording began.
        frame: CARLA's frame number.
        type: The record type's name, such as `spawned`.
        record: The record's fields by name: numbers, texts, booleans, lists of such records; units as in
            `records`.
    """

    elapsed: float
    frame: int
    type: str
    record: dict[str, Any]


class Info:
    """The events of a recording, or all records, read anew at each iteration, so that they never fill the memory."""

    row_type = InfoRow

    def __init__(self, source: Reader, *, all: bool = False, compat: bool = False) -> None:
        self.source = source
        self.all = all
        self.compat = compat

    @property
    def header(self) -> Header:
        """The header of the recording."""
        return self.source.header

    @property
    def extent(self) -> Extent:
        """The extent of the recording; known after an iteration."""
        return self.source.extent()

    def frames(self) -> Iterator[Frame]:
        """Return the frames with the records; with `all`, their packets include those without records."""
        return self.source.frames() if self.all else self.source.frames(EVENTS, sparse=True)

    def __iter__(self) -> Iterator[InfoRow]:
        for frame in self.frames():
            if self.all and not frame.preamble:
                start = {"id": frame.id, "duration": frame.duration, "elapsed": frame.elapsed}
                yield InfoRow(frame.elapsed, frame.id, "frame", start)
            for packet in frame.packets:
                if packet.type is not None and packet.type.framing is not Framing.MARKER:
                    for record in _records(packet.type.layout, packet.records):
                        yield InfoRow(frame.elapsed, frame.id, packet.type.name, record)


def info(source: Reader, *, all: bool = False, compat: bool = False) -> Info:
    """Return the events of a recording: spawns, destructions, parentings, collisions; or all records.

    With `compat`, the text of the answer reproduces the mistakes of CARLA 0.9.16.
    """
    return Info(source, all=all, compat=compat)


def _records(layout: Layout, records: Records) -> Iterator[dict[str, Any]]:
    names = tuple(layout.fields)
    if isinstance(records, np.ndarray):
        columns = (records[name] != 0 if layout.fields[name] == FLAG else records[name] for name in names)
        for row in zip(*(values.tolist() for values in columns), strict=True):
            yield dict(zip(names, row, strict=True))
    else:
        from carla_recap.tables.records import plain_record

        for record in records:
            yield plain_record(layout, record)
