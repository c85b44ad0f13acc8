"""The protocols of readers and writers, which every format implements, and what all readers have in common."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol, Self

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator
    from pathlib import Path
    from types import TracebackType

    from carla_recap.model.batch import Batch
    from carla_recap.model.braking import Braking
    from carla_recap.model.contacts import Impact
    from carla_recap.model.frame import Extent, Frame, Header
    from carla_recap.model.stationary import BlockedRow

PIECE = 1 << 20
"""The size in bytes of the pieces in which bytes without a schema are handed on."""


class Reader(Protocol):
    """An open recording.

    Attributes:
        path: Its path; of a URL, one with the same name, which says nothing about this machine.
        location: Its path or URL, as given.
        header: Its header.
    """

    path: Path
    location: str
    header: Header

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
        """Yield the frames in batches of frames that are alike.

        Args:
            types: Names of record types: frames hold the packets of these alone, and no empty ones. None: all packets.
            sparse: Leave out frames that hold no packet of `types`.
            start: The first elapsed time, in seconds.
            stop: The elapsed time at which to stop, in seconds (exclusive). A frame within `SAME_TIME` of either counts as
                being at it.

        Raises:
            FormatError: The file contradicts its format.
        """
        ...

    def frame_at(self, elapsed: float) -> Frame | None:
        """Return the last frame that begins at or before a time in seconds, or within `SAME_TIME` of it; else None."""
        ...

    def frames_by_index(self, indexes: Iterable[int], types: Collection[str]) -> Iterator[Frame] | None:
        """Return the frames at some indexes, in their order; None if that would take reading all frames.

        Args:
            indexes: The positions of frames in the recording, from 0.
            types: Names of record types, as in `batches`.
        """
        return None

    def extent(self) -> Extent:
        """Return the number of frames, the last id and the duration."""
        ...

    def stationary_intervals(self, min_time: float, min_distance: float) -> list[BlockedRow] | None:
        """Return the intervals in which actors were stationary, in no order; None if the file does not list them.

        Args:
            min_time: The shortest interval to return, in seconds.
            min_distance: The distance in cm from which on an actor counts as moved.

        Raises:
            FormatError: The file contradicts its format.
        """
        return None

    def hard_braking(self, deceleration: float) -> list[Braking] | None:
        """Return the intervals in which vehicles brake hard, in no order; None if the file does not list them.

        Args:
            deceleration: The deceleration in m/s² from which on braking is hard.

        Raises:
            FormatError: The file contradicts its format.
        """
        return None

    def impacts(self) -> list[Impact] | None:
        """Return the impacts of all contacts; None if the file does not list them.

        Raises:
            FormatError: The file contradicts its format.
        """
        return None

    def tail(self) -> Iterator[bytes]:
        """Yield the bytes after the last complete packet, in pieces."""
        ...

    def check_open(self) -> None:
        """Check that it is not closed.

        Raises:
            Closed: It was.
        """
        ...

    def close(self) -> None:
        """Close the file; arrays that were read from it stay valid."""
        ...


class Writer(Protocol):
    """A recording that is being written: complete after `close`, removed after `abort`, left unfinished after `abandon`."""

    def write(self, frame: Frame) -> None:
        """Add a frame."""
        ...

    def write_batch(self, batch: Batch) -> None:
        """Add the frames of a batch."""
        ...

    def write_tail(self, piece: bytes) -> None:
        """Add bytes after the last complete packet."""
        ...

    def close(self) -> None:
        """Finish the file, and give it its name."""
        ...

    def abort(self) -> None:
        """Remove what was written."""
        ...

    def abandon(self) -> Path:
        """Stop writing; return the unfinished file, which `recover` can read."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
