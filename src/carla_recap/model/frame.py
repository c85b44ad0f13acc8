"""The parts of a recording: a header, and frames, each with its packets in file order."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Literal, overload

import numpy as np

from carla_recap.errors import FormatError, RecapWarning
from carla_recap.model.layout import Buffer, Framing, PayloadError, Records, pack, unpack
from carla_recap.model.records import FRAME_END, ORDER, UE4, UE5, Bones, Physics, RecordType, Spawn, Table, WheelSet

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

SAME_TIME: Final = 1e-6
"""The tolerance in s within which a time is that of a frame: CARLA's times are sums of 32-bit steps."""
LAST_FRAME_DURATION: Final = -1.0
"""The duration in s that CARLA writes for the last frame of a recording."""


@dataclass(frozen=True)
class Header:
    """The header of a recording.

    Attributes:
        map_name: The map, such as Town01; a path in some builds.
        date: When the recording began, in Unix seconds.
        version: The version of CARLA's format: 1, or 2 where attribute types count from 1.
        wide: Whether lengths are in double precision, as UE5 builds (0.10) write them.
        shifted: Whether doors, wheels and bikers have the packet ids 21, 22, 23, as some development builds write them.
        raw: CARLA's header as read, where it differs from what the fields above would be written as.
        parameters: The parameters of the simulation by name, such as its seed; only MCAP files have them.
        without_events: Whether it was recovered without all of its spawns, collisions and other events; only MCAP says so.
    """

    map_name: str
    date: int
    version: int = 1
    wide: bool = False
    shifted: bool = False
    raw: bytes | None = None
    parameters: Mapping[str, str] = field(default_factory=dict, hash=False)
    without_events: bool = False

    @property
    def table(self) -> Table:
        """The record types as this recording's build writes them."""
        return UE5 if self.wide else UE4


@dataclass(frozen=True)
class Extent:
    """The size of a recording."""

    frames: int = 0  # the number of frames
    last_id: int = 0  # the id of the last one
    duration: float = 0.0  # the elapsed time of the last one, in seconds


class Packet:
    """One packet: records of a type, or bytes of an unknown one. Never changes.

    Records are parsed from the payload, and the payload is packed from records, when first asked for; one of both is given.
    `origin` is the location of the file that the packet was read from, and the offset in it of the payload, if known.
    """

    __slots__ = ("_origin", "_payload", "_records", "id", "type")

    def __init__(
        self,
        id: int,
        type: RecordType | None,
        payload: Buffer | None = None,
        records: Records | None = None,
        origin: tuple[str, int | None] | None = None,
    ) -> None:
        self.id = id  # as of CARLA 0.9.16
        self.type = type  # None for an unknown id
        self._payload = payload
        self._records = records
        self._origin = origin

    @property
    def payload(self) -> Buffer:
        """The bytes after the packet header."""
        if self._payload is None:
            assert self.type is not None
            assert self._records is not None
            self._payload = pack(self.type, self._records)
        return self._payload

    @property
    def records(self) -> Records:
        """The records; none for an unknown packet, a `FormatError` if the payload contradicts the type's layout."""
        if self._records is None:
            if self.type is None or self.type.opaque:
                return []
            try:
                self._records, extra = unpack(self.type, self.payload)
            except PayloadError as error:
                raise self.error(error) from None
            if extra:
                self.warn_of(extra)
        return self._records

    def error(self, error: PayloadError) -> FormatError:
        """Return the error of a payload that contradicts its layout."""
        path, offset = self._origin or ("a packet", None)
        return FormatError(path, None if offset is None else offset + error.offset, str(error))

    def warn_of(self, extra: int) -> None:
        """Warn of bytes after the records."""
        path, offset = self._origin or ("a packet", None)
        name = self.type.name if self.type else self.id
        where = path if offset is None else f"{path}: byte {offset}"
        message = f"{where}: {name} has {extra} bytes more than its records need; they are kept as they are"
        warnings.warn(message, RecapWarning, stacklevel=3)


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array after making it read-only."""
    array.flags.writeable = False
    return array


class Frame:
    """A frame: `frame["transforms"]` gives all its records of a type, `frame.packets` everything in file order.

    Attributes:
        index: The position in the recording, from 0.
        id: CARLA's frame number, from 1; 0 for packets before the first frame.
        elapsed: Seconds since the recording began.
        duration: Seconds until the next frame; -1 for the last one of a recording.
        packets: The packets after the one that starts the frame, empty ones included.
        preamble: Whether these are packets before the first frame starts.
    """

    __slots__ = ("duration", "elapsed", "id", "index", "packets", "preamble")

    def __init__(
        self,
        index: int,
        id: int,
        elapsed: float,
        duration: float,
        packets: list[Packet],
        *,
        preamble: bool = False,
    ) -> None:
        self.index = index
        self.id = id
        self.elapsed = elapsed
        self.duration = duration
        self.packets = packets
        self.preamble = preamble

    def __repr__(self) -> str:
        names = ", ".join(f"{name}: {len(records)}" for name, records in self.items())
        return f"Frame({self.id} at {self.elapsed:g} s; {names})"

    @overload
    def __getitem__(self, name: Literal["spawned"]) -> list[Spawn]: ...  # type: ignore[overload-overlap]
    @overload
    def __getitem__(self, name: Literal["physics"]) -> list[Physics]: ...  # type: ignore[overload-overlap]
    @overload
    def __getitem__(self, name: Literal["walker_bones"]) -> list[Bones]: ...  # type: ignore[overload-overlap]
    @overload
    def __getitem__(self, name: Literal["wheels"]) -> list[WheelSet]: ...  # type: ignore[overload-overlap]
    @overload
    def __getitem__(self, name: str) -> NDArray[np.void]: ...
    def __getitem__(self, name: str) -> Records:
        """Return the records of a type, in CARLA's units: a structured array, or a list of objects; empty if there are none.

        Arrays are read-only views of what was read: copy one to change it, and `replace` it.

        Raises:
            RecordError: There is no such type.
            FormatError: The packet contradicts its layout.
        """
        found = [p.records for p in self.packets if p.type is not None and p.type.name == name]
        if len(found) == 1:
            return found[0]
        if not found:
            type = UE4.named(name)
            return read_only(np.empty(0, type.dtype)) if type.fixed else []
        if isinstance(found[0], np.ndarray):
            return read_only(np.concatenate([array for array in found if isinstance(array, np.ndarray)]))
        return [record for records in found for record in records]

    def replace(self, **records: Any) -> Frame:
        """Return this frame with other records of some types; see `RecordType.records` for the forms they may have.

        Of a clock, which has one record, none leaves its packet out.

        Raises:
            RecordError: Records do not fit their type.
        """
        table = UE5 if any(p.type is not None and p.type.wide for p in self.packets) else UE4
        new: dict[int, Packet | None] = {}
        for name, values in records.items():
            type = table.named(name)
            found = type.records(values)
            is_left_out = type.framing is Framing.SINGLE and not len(found)
            new[type.id] = None if is_left_out else Packet(type.id, type, pack(type, found), found)
        packets, left = list[Packet](), dict(new)
        for packet in self.packets:
            if packet.id not in new:
                packets.append(packet)
            elif (replaced := left.pop(packet.id, None)) is not None:  # of several packets of a type, the first one
                packets.append(replaced)
        for packet in filter(None, left.values()):
            later = (*ORDER[ORDER.index(packet.id) + 1 :], FRAME_END)
            packets.insert(next((n for n, other in enumerate(packets) if other.id in later), len(packets)), packet)
        return Frame(self.index, self.id, self.elapsed, self.duration, packets, preamble=self.preamble)

    def items(self) -> Iterator[tuple[str, Records]]:
        """Yield the name and the records of each type that has records, in file order."""
        names = dict.fromkeys(p.type.name for p in self.packets if p.type is not None and p.type.id > 1)
        return ((name, records) for name in names if len(records := self[name]))
