"""Recordings of one's own: frames from trajectories, logs of other simulators, or tests."""

from __future__ import annotations

import math
import time
from datetime import datetime
from typing import TYPE_CHECKING, Any, Self, SupportsFloat

from carla_recap.errors import RecordError
from carla_recap.formats import create_writer
from carla_recap.model.frame import LAST_FRAME_DURATION, Extent, Frame, Header, Packet
from carla_recap.model.records import FRAME_END, ORDER

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from types import TracebackType

    from carla_recap.model.records import Table


class Recorder:
    """A recording being written; see `create_recording`. Complete when it is closed, removed when its block fails.

    Attributes:
        extent: How far it goes so far.
    """

    def __init__(self, path: Path | str, header: Header, *, additional_data: bool, live: bool) -> None:
        self._table = header.table
        self._writer = create_writer(path, header, live=live)
        self._additional = additional_data
        self._latest: Frame | None = None
        self._closed = False
        self._end = Packet(FRAME_END, self._table[FRAME_END], b"")
        self.extent = Extent()

    def add_frame(self, elapsed: float, **records: Any) -> None:
        """Add a frame.

        Args:
            elapsed: Seconds since the recording began; more than the frame before.
            records: Records by type, in CARLA's units: `transforms=`, `spawned=`, `collisions=` … Each a structured array,
                columns by name, rows, or objects such as `Spawn`; a clock (`platform_time=`) is a number. Whatever
                `frame[...]` gives will do.

        Raises:
            RecordError: They do not fit their type, or time does not go on.
            RecapError: The file cannot be written.
        """
        if self._closed:
            raise RecordError("the recording is closed")
        if not isinstance(elapsed, SupportsFloat) or not 0 <= (elapsed := float(elapsed)) < math.inf:
            raise RecordError(f"elapsed seconds of 0 or more were expected, found {elapsed!r}")
        if self._latest is not None and not elapsed > self._latest.elapsed:
            raise RecordError(f"a frame at {elapsed:g} s cannot follow one at {self._latest.elapsed:g} s")
        number = self.extent.frames + 1
        frame = Frame(number - 1, number, elapsed, LAST_FRAME_DURATION, self._packets(records))
        if self._latest is not None:
            self._latest.duration = elapsed - self._latest.elapsed
            self._writer.write(self._latest)
        self._latest = frame
        self.extent = Extent(number, number, elapsed)

    def close(self) -> None:
        """Finish the recording, and put it under its name."""
        self._closed = True
        try:
            if self._latest is not None:
                self._writer.write(self._latest)
                self._latest = None
            self._writer.close()
        except BaseException:
            self._writer.abort()
            raise

    def abort(self) -> None:
        """Give the recording up."""
        self._closed = True
        self._writer.abort()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

    def _packets(self, given: dict[str, Any]) -> list[Packet]:
        packets = packets_of(self._table, given, additional_data=self._additional)
        return [*(Packet(packet.id, packet.type, packet.payload) for packet in packets), self._end]


def packets_of(table: Table, records: Mapping[str, Any], *, additional_data: bool) -> list[Packet]:
    """The packets of a frame, between its start and its end, as CARLA's recorder writes them.

    Args:
        table: The record types of the recording.
        records: Records by type; those that CARLA tells of in each frame have empty packets where nothing is given.
        additional_data: Whether the packets of CARLA's additional data are among these.

    Raises:
        RecordError: They do not fit their type.
    """
    given = {table.named(name).id: values for name, values in records.items()}
    if min(given, default=FRAME_END + 1) <= FRAME_END:
        raise RecordError("a frame's start and end are not given as records")
    rows = {id: table[id] for id in ORDER}
    return [
        Packet(id, type, records=type.records(given.get(id, [])))
        for id, type in rows.items()
        if id in given or (type.always and (additional_data or not type.additional))
    ]


def create_recording(
    path: Path | str,
    *,
    map_name: str,
    date: datetime | float | None = None,
    additional_data: bool = False,
    live: bool = False,
) -> Recorder:
    """Begin a recording of one's own.

    Args:
        path: The destination; the suffix, .mcap or .log, says the format.
        map_name: The map.
        date: When it begins, as a time or in Unix seconds; now, by default.
        additional_data: Write the packets of CARLA's additional data in every frame, empty ones too, as CARLA does.
        live: Put the data on the disk as it comes, so that a crash costs 5 s at the most (MCAP). What a crash leaves is a
            hidden file beside the destination, which `recover` takes.

    An existing file is replaced when the recording is closed.

    Raises:
        RecordError: The date or the name of the map cannot be written.
        RecapError: The suffix is of no format, or the place cannot be written to.
    """
    if not isinstance(map_name, str):
        raise RecordError(f"{path}: the name of a map was expected, found {map_name!r}")
    if isinstance(date, datetime):
        date = date.timestamp()
    try:
        header = Header(map_name, int(time.time() if date is None else date))
    except (ValueError, OverflowError, TypeError):
        raise RecordError(f"{path}: a date of {date} cannot be written") from None
    return Recorder(path, header, additional_data=additional_data, live=live)
