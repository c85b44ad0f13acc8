"""What every format offers: a reader and a writer of frames."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol, Self

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path
    from types import TracebackType

    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Extent, Frame, Header
    from carla_recap.model.stationary import BlockedRow

PIECE = 1 << 20
"""Bytes that no schema describes travel in pieces of this size."""


class Reader(Protocol):
    """An open recording."""

    path: Path
    header: Header

    def frames(
        self,
        types: Collection[str] | None = None,
        *,
        sparse: bool = False,
        start: float = -math.inf,
        stop: float = math.inf,
    ) -> Iterator[Frame]:
        """Stream the frames, one by one; see `batches`."""
        ...

    def batches(
        self,
        types: Collection[str] | None = None,
        *,
        sparse: bool = False,
        start: float = -math.inf,
        stop: float = math.inf,
    ) -> Iterator[Batch]:
        """Stream the frames, in batches of frames that are alike.

        Args:
            types: Names of record types: frames hold the packets of these alone, and no empty ones. None: all packets.
            sparse: Leave out frames that hold no packet of `types`.
            start: First elapsed time, in seconds.
            stop: Elapsed time, in seconds, at which to stop (exclusive). A frame within `SAME_TIME` of either is at it.

        Raises:
            FormatError: The file contradicts its format.
        """
        ...

    def frame_at(self, elapsed: float) -> Frame | None:
        """Return the last frame that begins at or before a time in seconds, or within `SAME_TIME` of it; else None."""
        ...

    def extent(self) -> Extent:
        """How far the recording goes."""
        ...

    def stretches(self, min_time: float, min_distance: float) -> list[BlockedRow] | None:
        """The stretches in which actors stood still, in no order; None where only the frames tell.

        Args:
            min_time: The shortest stretch to tell of, in seconds.
            min_distance: The distance at which an actor has moved, in cm.

        Raises:
            FormatError: The file contradicts its format.
        """
        ...

    def tail(self) -> Iterator[bytes]:
        """The bytes behind the last complete packet, in pieces."""
        ...

    def close(self) -> None:
        """Let go of the file."""
        ...


class Writer(Protocol):
    """A recording being written; complete after `close`, removed after `abort`, left as it is after `abandon`."""

    def write(self, frame: Frame) -> None:
        """Add a frame."""
        ...

    def write_batch(self, batch: Batch) -> None:
        """Add the frames of a batch."""
        ...

    def write_tail(self, piece: bytes) -> None:
        """Add bytes behind the last complete packet."""
        ...

    def close(self) -> None:
        """Finish the file, and put it under its name."""
        ...

    def abort(self) -> None:
        """Give the file up."""
        ...

    def abandon(self) -> Path:
        """Give the file up, but leave what was written where it is, which is returned; `recover` takes it."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
