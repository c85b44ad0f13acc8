"""The digest: what queries would otherwise compute from all transforms, kept as events of a recording.

These are stationary intervals, hard braking and impacts. The extent's metadata have what they depend on and
their numbers. A digest is left out where packets are irregular, so that it never differs from what is computed.
"""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.formats.mcap.codec import encode
from carla_recap.formats.mcap.schema import BRAKING, BRAKING_RULE, CONTACTS, STATIONARY, STATIONARY_RULE
from carla_recap.model.braking import HARD, BrakingDetector
from carla_recap.model.contacts import TYPES as CONTACT_TYPES
from carla_recap.model.contacts import ImpactTracker
from carla_recap.model.layout import MAX_COUNT, pack
from carla_recap.model.motion import MOTION
from carla_recap.model.stationary import MIN_DISTANCE, StationaryTracker
from carla_recap.model.stationary import TYPES as STATIONARY_TYPES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.model.batch import Batch
    from carla_recap.model.layout import Records
    from carla_recap.model.records import RecordType, Table
    from carla_recap.model.stationary import BlockedRow

    Message = tuple[str, bytes]  # topic, and body of a message

INTERVAL_TIME: Final = 1.0
"""The shortest stationary intervals that are kept, in seconds."""
_TOGETHER: Final = 100  # rows of a message, which the longest blueprints do not make larger than `OBJECTS_LIMIT`


class Digest:
    """Computes the digest of a recording while it is written."""

    def __init__(self, table: Table) -> None:
        self._stationary: StationaryTracker | None = StationaryTracker(table, INTERVAL_TIME)
        self._detector: BrakingDetector | None = BrakingDetector((), HARD)
        self._impacts: ImpactTracker | None = ImpactTracker()
        self._intervals: list[BlockedRow] = []
        self._interval_count = self._braking_count = self._impact_count = 0

    def batch(self, batch: Batch, index: int) -> None:
        """Process a frame, or several in which no actors spawn; `index`: the position of the first in the file."""
        if self._stationary:
            self._stationary.batch(batch)
        if self._detector:
            spawns = batch.frame(0)["spawned"] if len(batch) == 1 else []
            if self._detector.add_spawns(spawns):
                self._detector.batch(batch)
            else:  # it has left out frames of a vehicle that was not known to be one
                self._detector = None
        if self._impacts:
            self._impacts.batch(batch, index)

    def found_irregular(self, type: RecordType | None) -> None:
        """Leave out what depends on a type of which a packet is irregular."""
        name = type.name if type is not None else ""
        if name in STATIONARY_TYPES:
            self._stationary = None
        if name in MOTION or name == "spawned":
            self._detector = None
        if name in CONTACT_TYPES:
            self._impacts = None

    def take(self) -> Iterator[Message]:
        """Yield the messages that belong to the latest frame."""
        if self._stationary:
            self._intervals += self._stationary.take()
            if len(self._intervals) >= _TOGETHER:
                yield from self._take_intervals()
        if self._impacts and (found := self._impacts.take()):
            self._impact_count += len(found)
            rows = [(*row.key, *chain(*row.positions, *row.velocities)) for row in found]
            yield from _messages(CONTACTS, np.array(rows, CONTACTS.dtype))

    def finish(self) -> Iterator[Message]:
        """Yield the messages behind the last frame."""
        if self._stationary:
            self._intervals += self._stationary.finish()
            yield from self._take_intervals()
        braking = self._detector.finish() if self._detector else []
        self._braking_count = len(braking)
        yield from _messages(BRAKING, np.array([tuple(row) for row in braking], BRAKING.dtype), _TOGETHER)

    def metadata(self) -> dict[str, str]:
        """Return what the extent's metadata say of the digest."""
        intervals = f"{INTERVAL_TIME:g} {MIN_DISTANCE:g} {self._interval_count} {STATIONARY_RULE}"
        braking = f"{HARD:g} {self._braking_count} {BRAKING_RULE}" if self._detector else ""
        contacts = f"{self._impact_count}" if self._impacts else ""
        values = {STATIONARY.name: intervals if self._stationary else "", BRAKING.name: braking, CONTACTS.name: contacts}
        return {name: value for name, value in values.items() if value}

    def _take_intervals(self) -> Iterator[Message]:
        intervals, self._intervals = self._intervals, []
        self._interval_count += len(intervals)
        return _messages(STATIONARY, intervals, _TOGETHER)


def _messages(type: RecordType, records: Records, together: int = MAX_COUNT) -> Iterator[Message]:
    """Yield messages of some records."""
    for start in range(0, len(records), together):
        yield type.topic, encode(type, pack(type, records[start : start + together]))
