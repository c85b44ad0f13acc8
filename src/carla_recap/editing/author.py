"""Recordings of records from elsewhere: trajectories, logs of other simulators, tests."""

from __future__ import annotations

import math
import time
from datetime import datetime
from functools import cache
from typing import TYPE_CHECKING, Any, Self, SupportsFloat

from carla_recap.errors import RecordError
from carla_recap.formats import create_writer
from carla_recap.model.frame import LAST_FRAME_DURATION, Extent, Frame, Header, Packet
from carla_recap.model.layout import EMPTY_LIST, Framing, pack
from carla_recap.model.records import FRAME_END, ORDER

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from types import TracebackType

    from carla_recap.model.records import RecordType, Table


class Recorder:
    """A recording that is being written; see `create_recording`. It is removed if its `with` block raises.

    Attributes:
        extent: The extent of the frames added so far.
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
            elapsed: Seconds since the recording began; more than in the frame before.
            records: Records by type, in CARLA's units: `transforms=`, `spawned=`, `collisions=` … Each a structured array,
                columns by name, rows, or objects such as `Spawn`; a clock (`platform_time=`) is a number. The values of
                `frame[...]` are accepted, too.

        Raises:
            RecordError: The records do not fit their type, or the time is not after that of the frame before.
            RecapError: The file cannot be written.
        """
        if self._closed:
            raise RecordError("the recording is closed")
        if not isinstance(elapsed, float | int | SupportsFloat) or not 0 <= (elapsed := float(elapsed)) < math.inf:
            raise RecordError(f"expected elapsed seconds of 0 or more, found {elapsed!r}")
        if self._latest is not None and not elapsed > self._latest.elapsed:
            raise RecordError(f"a frame at {elapsed:g} s cannot follow one at {self._latest.elapsed:g} s")
        number = self.extent.frames + 1
        packets = [*packets_of(self._table, records, additional_data=self._additional), self._end]
        frame = Frame(number - 1, number, elapsed, LAST_FRAME_DURATION, packets)
        if self._latest is not None:
            self._latest.duration = elapsed - self._latest.elapsed
            self._writer.write(self._latest)
        self._latest = frame
        self.extent = Extent(number, number, elapsed)

    def close(self) -> None:
        """Finish the recording and rename it to its path."""
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
        """Remove the recording."""
        self._closed = True
        self._writer.abort()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()


def packets_of(table: Table, records: Mapping[str, Any], *, additional_data: bool) -> list[Packet]:
    """Return the packets of a frame, between its start and its end, in the order of CARLA's recorder.

    Types that CARLA writes in each frame, or with additional data, get empty packets if they have no records.
    """
    given = {table.named(name).id: values for name, values in records.items()}
    if min(given, default=FRAME_END + 1) <= FRAME_END:
        raise RecordError("a frame's start and end are not given as records")
    packets = dict(empty_packets(table, additional_data))
    for id, values in given.items():
        type = table[id]
        found = type.records(values)
        if len(found) or type.framing is not Framing.SINGLE:
            packets[id] = Packet(id, type, pack(type, found))
    return [packet for packet in packets.values() if packet is not None]


@cache
def empty_packets(table: Table, additional_data: bool) -> dict[int, Packet | None]:
    """Return the packets of a frame without records by id, in CARLA's order; None for those that CARLA leaves out."""
    types: list[RecordType] = [table[id] for id in ORDER]
    return {
        type.id: Packet(type.id, type, EMPTY_LIST) if type.always and (additional_data or not type.additional) else None
        for type in types
    }


def create_recording(
    path: Path | str,
    *,
    map_name: str,
    date: datetime | float | None = None,
    additional_data: bool = False,
    live: bool = False,
) -> Recorder:
    """Create a recording, to which frames are added.

    Args:
        path: The destination; the suffix, .mcap or .log, says the format.
        map_name: The map.
        date: The beginning, as a time or in Unix seconds; now, by default.
        additional_data: Write the packets of CARLA's additional data in every frame, empty ones too, as CARLA does.
        live: Write to the disk continuously, so that a crash loses at most the last 5 s (MCAP). A crash leaves a hidden
            file beside the destination, which `recover` reads.

    An existing file is replaced when the recording is closed.

    Raises:
        RecordError: The date or the name of the map cannot be written.
        RecapError: The suffix is of no format, or the file cannot be created.
    """
    if not isinstance(map_name, str):
        raise RecordError(f"{path}: expected the name of a map, found {map_name!r}")
    if isinstance(date, datetime):
        date = date.timestamp()
    try:
        header = Header(map_name, int(time.time() if date is None else date))
    except (ValueError, OverflowError, TypeError):
        raise RecordError(f"{path}: a date of {date} cannot be written") from None
    return Recorder(path, header, additional_data=additional_data, live=live)
