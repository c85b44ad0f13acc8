"""The bases of readers and writers, which every format implements."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from carla_recap.errors import RecapError
from carla_recap.model.batch import within
from carla_recap.model.frame import SAME_TIME
from carla_recap.util.files import AtomicFile

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
    from pathlib import Path

    from carla_recap.formats.sources import ByteSource
    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Extent, Frame, Header

PIECE = 1 << 20
"""The size in bytes of the pieces in which bytes without a schema are handed on."""

LATCHED = "latched"
"""The key of a channel's metadata that is "1" if each of its messages is valid until the next one."""


@dataclass(frozen=True)
class Topic:
    """A topic of a file, as MCAP has them."""

    name: str  # the name, such as `/scene`
    message: str  # the full name of the message, as its schema has it; "" for messages without a schema
    schema: Callable[[], bytes]  # returns the message's schema; of protobuf, the descriptors of all files that it needs
    metadata: Mapping[str, str] = field(default_factory=dict)  # what the channel says beside it
    encoding: str = "protobuf"  # the encoding of the messages, as MCAP names it
    schema_encoding: str = "protobuf"  # the encoding of the schema, as MCAP names it

    @property
    def is_latched(self) -> bool:
        """Whether a message is valid until the next one, as its metadata say."""
        return self.metadata.get(LATCHED) == "1"


@dataclass(frozen=True)
class FurtherTopic:
    """A topic that a recording has beside its own, such as a sensor's."""

    topic: Topic  # its name, metadata, and the schema of its messages
    count: int  # the number of messages
    first: float | None  # the elapsed time of the first message, in s; None where there is none
    last: float | None  # the elapsed time of the last message, in s; None where there is none
    group: str  # topics of the same group share chunks


class TopicMessage(NamedTuple):
    """A message of a further topic."""

    topic: str  # its name
    elapsed: float  # its time, in elapsed seconds, to the nanosecond
    data: bytes  # the message, encoded


PartName = Literal["stretches", "braking", "contacts"]
"""What queries would compute from all transforms: stationary intervals, hard braking, and beginnings of contacts."""


@dataclass(frozen=True)
class DigestPart:
    """A part of the digest of a recording, which is kept among its events."""

    # What it depends on: of stretches the least duration in s and the distance in cm, of braking the deceleration in m/s².
    limits: tuple[float, ...]
    # Returns its rows, as `formats/mcap/schema.py` has them, in no order; None if some are missing.
    read: Callable[[], list[tuple[Any, ...]] | None]


class Reader:
    """An open recording."""

    path: Path  # its path; of a URL, one with the same name, which says nothing about this machine
    location: str  # its path or URL, as given
    header: Header
    lost_messages = False  # whether messages of frames that were read are missing
    _source: ByteSource

    @property
    def is_empty(self) -> bool:
        """Whether the file has a header alone, as that of a recording that has just begun."""
        raise NotImplementedError

    def frames(
        self,
        types: Collection[str] | None = None,
        *,
        sparse: bool = False,
        start: float = -math.inf,
        stop: float = math.inf,
    ) -> Iterator[Frame]:
        """Yield the frames one by one; see `batches`."""
        for batch in self.batches(types, sparse=sparse, start=start, stop=stop):
            for frame in batch:
                yield frame
                self.check_open()

    def batches(
        self,
        types: Collection[str] | None = None,
        *,
        sparse: bool = False,
        start: float = -math.inf,
        stop: float = math.inf,
    ) -> Iterator[Batch]:
        """Yield the frames in batches of frames that are alike, with elapsed seconds from `start` to before `stop`.

        A frame within `SAME_TIME` of either counts as being at it. All frames in between are among them, also those whose
        clock goes back: parts that meet have each frame once. With names of record types, frames hold the packets of
        these alone, and no empty ones; None: all packets. With `sparse`, frames that hold no packet of these are left out;
        in MCAP, durations may be unknown (NaN) then. A `FormatError` says where the file contradicts its format.
        """
        self.check_open()
        start, stop = start - SAME_TIME, stop - SAME_TIME
        for batch in within(self._batches(types, start, stop, sparse=sparse), start, stop):
            if batch.columns or not sparse:
                yield batch
                self.check_open()

    def _batches(self, types: Collection[str] | None, start: float, stop: float, *, sparse: bool) -> Iterator[Batch]:
        """Yield batches with the frames from a time to another, and maybe more of them, also such without packets."""
        raise NotImplementedError

    def frame_at(self, elapsed: float) -> Frame | None:
        """Return the frame before the first one that begins later than `SAME_TIME` after a time in seconds; None if none is.

        So a frame whose clock is behind an earlier one's counts as at the time of that one.
        """
        raise NotImplementedError

    def frames_by_index(self, indexes: Iterable[int], types: Collection[str]) -> Iterator[Frame] | None:
        """Return the frames at some indexes, in their order; None if that would take reading all frames.

        Indexes are positions in the recording, from 0; types are names, as in `batches`.
        """
        return None

    def extent(self) -> Extent:
        """Return the number of frames, the last id and the duration."""
        raise NotImplementedError

    def digest(self, part: PartName) -> DigestPart | None:
        """Return a part of the digest; None if the file has none."""
        return None

    def tail(self) -> Iterator[bytes]:
        """Yield the bytes after the last complete packet, in pieces."""
        raise NotImplementedError

    def further_topics(self) -> dict[str, FurtherTopic]:
        """Return the topics beside those of a recording, by name; none in formats that have no others."""
        return {}

    def messages(self, topic: str, start: float = -math.inf, stop: float = math.inf) -> Iterator[tuple[float, bytes]]:
        """Yield elapsed time in seconds and data of the messages of a further topic; see `further_messages`."""
        return ((message.elapsed, message.data) for message in self.further_messages((topic,), start, stop))

    def further_messages(
        self,
        topics: Collection[str] | None = None,
        start: float = -math.inf,
        stop: float = math.inf,
        *,
        in_order: bool = True,
    ) -> Iterator[TopicMessage]:
        """Yield the messages of further topics by their names, or of all, between elapsed seconds as in `batches`.

        They come in order of time, or else in that of the file's chunks, of which one is in memory at a time. A `RecapError`
        says that there is no such topic.
        """
        for topic in topics or ():
            raise RecapError(f"{self.location}: has no further topic {topic!r:.200}; only MCAP files have some")
        return iter(())

    def latest_messages(self, topics: Collection[str], elapsed: float) -> list[TopicMessage]:
        """Return the latest message of each of some further topics at a time, in order of time.

        The time is in elapsed seconds, and messages count up to `SAME_TIME` after it. A `RecapError` says that there is no
        such topic.
        """
        return list(self.further_messages(topics, elapsed, elapsed))

    def expect_events(self) -> None:
        """Raise `RecapError` for a recording that was recovered without all of its events."""
        if self.header.without_events:
            found = "one that was recovered without some of them"
            raise RecapError(f"{self.location}: expected a recording with all of its events, found {found}")

    def check_open(self) -> None:
        """Raise `Closed` if it was closed."""
        self._source.check_open()

    def close(self) -> None:
        """Close the file; arrays that were read from it stay valid."""
        self._source.close()


class Writer(AtomicFile):
    """A recording that is being written; see `AtomicFile`."""

    without_events = False  # whether some or all of its events are lost; an MCAP file says so

    def write(self, frame: Frame) -> None:
        """Add a frame."""
        raise NotImplementedError

    def write_batch(self, batch: Batch) -> None:
        """Add the frames of a batch."""
        raise NotImplementedError

    def write_tail(self, piece: bytes) -> None:
        """Add bytes after the last complete packet."""
        raise NotImplementedError
