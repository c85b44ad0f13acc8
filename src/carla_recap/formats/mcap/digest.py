"""The digest: what queries would otherwise compute from all transforms, kept as events of a recording.

These are stationary intervals, hard braking and beginnings of contacts. The extent's metadata have what they depend on and
their numbers. A digest is left out where packets are irregular, so that it never differs from what is computed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.formats.mcap import messages
from carla_recap.formats.mcap.fixed import fixed_codec
from carla_recap.formats.mcap.messages import parse
from carla_recap.formats.mcap.schema import (
    BRAKING,
    BRAKING_MESSAGE,
    BRAKING_TOPIC,
    CONTACTS,
    CONTACTS_MESSAGE,
    CONTACTS_TOPIC,
    STRETCHES,
    STRETCHES_TOPIC,
)
from carla_recap.model.batch import Batch
from carla_recap.model.braking import HARD, Braking, BrakingDetector
from carla_recap.model.braking import TYPES as BRAKING_TYPES
from carla_recap.model.contacts import TYPES as CONTACT_TYPES
from carla_recap.model.contacts import ContactStart, ContactTracker
from carla_recap.model.layout import EMPTY_LIST, U16, Layout, PacketType
from carla_recap.model.stationary import MIN_DISTANCE, StationaryTracker
from carla_recap.model.stationary import TYPES as STATIONARY_TYPES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from carla_recap.model.frame import Frame
    from carla_recap.model.records import RecordType, Table
    from carla_recap.model.stationary import BlockedRow

    Message = tuple[str, bytes]  # topic, and body of a message

INTERVAL_TIME: Final = 1.0
"""The shortest stationary intervals that are kept, in seconds."""
_TOGETHER: Final = 1_000  # rows of a message, about

_BRAKING: Final = PacketType(
    name="braking",
    layout=Layout({"id": "u4", "start": "f8", "stop": "f8", "x": "f8", "y": "f8", "z": "f8", "speed": "f8"}),
)
_VECTORS: Final = [f"{name}{axis}{side}" for name in ("", "velocity_") for side in "12" for axis in "xyz"]
_CONTACTS: Final = PacketType(
    name="contacts",
    layout=Layout({"index": "u8", "actor1": "u4", "actor2": "u4", **dict.fromkeys(_VECTORS, "f8")}),
)
_ITEMS: Final = {BRAKING_MESSAGE: "intervals", CONTACTS_MESSAGE: "contacts"}


class Digest:
    """Computes the digest of a recording while it is written.

    Args:
        table: The record types of the recording.
    """

    def __init__(self, table: Table) -> None:
        self._stationary_ids = {table.named(name).id for name in STATIONARY_TYPES}
        self._spawned = table.named("spawned").id
        self._stationary: StationaryTracker | None = StationaryTracker(table, INTERVAL_TIME)
        self._detector: BrakingDetector | None = BrakingDetector((), HARD)
        self._contacts: ContactTracker | None = ContactTracker()
        self._intervals: list[BlockedRow] = []
        self._interval_count = self._braking_count = self._contact_count = 0

    def frame(self, frame: Frame, index: int) -> None:
        """Process a frame; `index`: its position in the file that is written."""
        filled = [packet for packet in frame.packets if packet.id in self._stationary_ids and packet.payload != EMPTY_LIST]
        if self._stationary:
            self._stationary.frame(frame, filled)
        if self._detector:
            spawns = [spawn for packet in filled if packet.id == self._spawned for spawn in packet.records]
            if self._detector.add_spawns(spawns):
                self._detector.batch(Batch.of(frame))
            else:  # it has left out frames of a vehicle that was not known to be one
                self._detector = None
        if self._contacts:
            self._contacts.frame(frame, index)

    def batch(self, batch: Batch, index: int) -> None:
        """Process the frames of a batch, in which no actors spawn; see `frame`."""
        if self._stationary:
            self._stationary.batch(batch)
        if self._detector:
            self._detector.batch(batch)
        if self._contacts:
            self._contacts.batch(batch, index)

    def found_irregular(self, type: RecordType | None) -> None:
        """Leave out what depends on a type of which a packet is irregular."""
        name = type.name if type is not None else ""
        if name in STATIONARY_TYPES:
            self._stationary = None
        if name in BRAKING_TYPES or name == "spawned":
            self._detector = None
        if name in CONTACT_TYPES:
            self._contacts = None

    def take(self) -> Iterator[Message]:
        """Yield the messages that belong to the latest frame."""
        if self._stationary:
            self._intervals += self._stationary.take()
            if len(self._intervals) >= _TOGETHER:
                yield self._take_intervals()
        if self._contacts and (found := self._contacts.take()):
            self._contact_count += len(found)
            yield CONTACTS_TOPIC, _contacts(found)

    def finish(self) -> Iterator[Message]:
        """Yield the messages behind the last frame."""
        if self._stationary:
            self._intervals += self._stationary.finish()
            if self._intervals:
                yield self._take_intervals()
        braking = self._detector.finish() if self._detector else []
        self._braking_count = len(braking)
        for start in range(0, len(braking), _TOGETHER):
            yield BRAKING_TOPIC, _encoded(_BRAKING, [tuple(row) for row in braking[start : start + _TOGETHER]])

    def metadata(self) -> dict[str, str]:
        """Return what the extent's metadata say of the digest."""
        stationary = {STRETCHES: f"{INTERVAL_TIME:g} {MIN_DISTANCE:g} {self._interval_count}"} if self._stationary else {}
        braking = {BRAKING: f"{HARD:g} {self._braking_count}"} if self._detector else {}
        contacts = {CONTACTS: f"{self._contact_count}"} if self._contacts else {}
        return stationary | braking | contacts

    def _take_intervals(self) -> Message:
        intervals, self._intervals = self._intervals, []
        self._interval_count += len(intervals)
        return STRETCHES_TOPIC, messages.stationary_intervals(intervals)


def read_braking(messages: Sequence[bytes]) -> list[Braking]:
    """Return the intervals of `BrakingIntervals` messages.

    Raises:
        WireError: One is no such message.
    """
    return [Braking(*row) for row in _decoded(_BRAKING, BRAKING_MESSAGE, messages)]


def read_contacts(messages: Sequence[bytes]) -> list[ContactStart]:
    """Return the contacts of `Contacts` messages.

    Raises:
        WireError: One is no such message.
    """
    rows = _decoded(_CONTACTS, CONTACTS_MESSAGE, messages)
    return [ContactStart(row[0], row[1], row[2], row[3:6], row[6:9], row[9:12], row[12:]) for row in rows]


def _contacts(found: Iterable[ContactStart]) -> bytes:
    rows = [(*row.key, *row.position1, *row.position2, *row.velocity1, *row.velocity2) for row in found]
    return _encoded(_CONTACTS, rows)


def _encoded(type: PacketType, rows: list[tuple[Any, ...]]) -> bytes:
    """Return the body of a message."""
    bodies = fixed_codec(type).encode([U16.pack(len(rows)) + np.array(rows, type.dtype).tobytes()])
    assert bodies is not None
    return bytes(bodies[0])


def _decoded(type: PacketType, name: str, messages: Sequence[bytes]) -> list[Any]:
    """Return the rows of messages of a name; the fields of a message may come in any order."""
    payloads = fixed_codec(type).decode(messages)
    if payloads is not None:
        return [row for index in range(len(messages)) for row in payloads.records(index).tolist()]
    found = [row for message in messages for row in getattr(parse(type.name, name, message), _ITEMS[name])]
    return [tuple(getattr(row, field) for field in type.layout.fields) for row in found]
