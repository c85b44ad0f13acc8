"""A clip: part of a recording as a recording of its own."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.editing.convert import TopicCopy, check_destination
from carla_recap.editing.initial_state import InitialState
from carla_recap.errors import RecapError
from carla_recap.formats import create_writer, open_reader
from carla_recap.model.batch import Batch, within
from carla_recap.model.frame import LAST_FRAME_DURATION, SAME_TIME, Extent
from carla_recap.replay.player import Player

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from carla_recap.editing.convert import Progress
    from carla_recap.formats.base import Reader
    from carla_recap.model.frame import Frame, Header

_LATEST_DATE: Final = (1 << 63) - 1


def clip(
    source: Path | str,
    destination: Path | str,
    *,
    start: float,
    duration: float = 0.0,
    force: bool = False,
    progress: Progress | None = None,
) -> Extent:
    """Write part of a recording as a recording of its own.

    The first frame is the one at the start, the last one that at the end; see `Recording.frame_at`. Elapsed times and frame
    numbers begin at 0 and at 1; the date is that of the first frame, in whole seconds. Actors keep their ids.

    If the clock of the source goes back to before the start in between, it does so in the clip, to times below 0.

    The first frame contains, besides its own records, the state that earlier frames have left: for every actor its spawn
    (with its pose at that time), parent, box, volume, physics and open doors, the states and times of traffic lights, the
    weather, the scene lights, and the ids of destroyed actors, since they may still have transforms. In all other frames
    the packets are those of the source, byte for byte, so their clocks (platform_time, visual_time) are those of the
    source. One exception: a parent that an actor got after its spawn is recorded in the second frame, because a parent in
    the frame of the spawn means that the pose of the spawn is relative to the parent.

    In an .mcap, the clip has the messages of further topics of its time, too, such as those of sensors, their bytes
    unchanged; of a topic with a single message, such as a calibration, that message, and of a latched one, such as a scene's
    lights, the latest one before. A .log cannot hold them.

    Args:
        source: A recording of any format, or its URL.
        destination: The file to write; the suffix says the format. It appears when it is complete.
        start: The beginning, in elapsed seconds; a negative number is counted from the end.
        duration: The length in seconds; 0: up to the end of the recording.
        force: Overwrite an existing file.
        progress: As in `convert`; gets the batches of the clip, and the reader of the source.

    Returns:
        The extent of the clip.

    Raises:
        RecapError: The start lies outside the recording, the source is damaged, or the destination cannot be written.
    """
    check_destination(source, destination, force=force)
    reader = open_reader(source)
    try:
        window = Player(reader, start=start, duration=duration)
        cutter = ClipCutter(reader)
        first = cutter.first_frame(window.start)
        return cutter.write(destination, first, window.stop if duration else math.inf, force=force, progress=progress)
    finally:
        reader.close()


def clip_begin(reader: Reader, start: float) -> float:
    """Return the elapsed seconds of the first frame of a clip; a `RecapError` if it is outside, or there are no frames."""
    return origin(ClipCutter(reader).first_frame(Player(reader, start=start).start))


class ClipCutter:
    """Writes clips of one recording; fastest in the order of their starts."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader
        self._initial_state = InitialState(reader)

    def first_frame(self, start: float) -> Frame:
        """Return the first frame of a clip that starts at a time; a `RecapError` if the recording has none."""
        found = self._reader.frame_at(start)
        if found is None or found.preamble:
            found = next((frame for frame in self._reader.frames() if not frame.preamble), None)
        if found is None:
            raise RecapError(f"{self._reader.location}: the recording has no frames")
        return found

    def write(
        self, destination: Path | str, first: Frame, stop: float, *, force: bool = False, progress: Progress | None = None
    ) -> Extent:
        """Write the clip from a frame to a time, in elapsed seconds of the source, and return its extent; see `clip`."""
        start = origin(first)
        batches: Iterable[Batch] = _renumbered(self._batches(first, stop), start)
        extent = Extent()
        with create_writer(destination, _moved(self._reader.header, start), force=force) as writer:
            copy = TopicCopy(self._reader, writer, start=_start(first), stop=_end(stop), origin=start)
            for batch in progress(batches, self._reader) if progress else batches:
                writer.write_batch(batch)
                copy.write(batch.elapsed[-1].item())
                last = batch.index + len(batch)
                extent = Extent(last, last, batch.elapsed[-1].item())
            copy.write()
        return extent

    def _batches(self, first: Frame, stop: float) -> Iterator[Batch]:
        yield Batch.of(self._initial_state.complete(first))
        if first.elapsed >= stop + SAME_TIME:  # frames behind it count as at its time
            return
        batches = self._reader.batches(start=_start(first))
        later = (batch[max(first.index + 1 - batch.index, 0) :] for batch in batches)
        for rest in within(later, -math.inf, stop + SAME_TIME):
            if self._initial_state.has_late_parents:
                yield Batch.of(self._initial_state.add_parents(rest.frame(0)))
                rest = rest[1:]
            if len(rest):
                yield rest


def origin(first: Frame) -> float:
    """Return the elapsed seconds of the source at which a clip begins whose first frame is given."""
    return first.elapsed if math.isfinite(first.elapsed) else 0.0


def _start(first: Frame) -> float:
    """Return the elapsed seconds of the source from which on frames are read, given the first frame of the clip."""
    return first.elapsed if math.isfinite(first.elapsed) else -math.inf


def _end(stop: float) -> float:
    """Return the elapsed seconds up to which they are read: the stop is part of the clip, within `SAME_TIME`."""
    return stop + 2 * SAME_TIME


def _renumbered(batches: Iterable[Batch], origin: float) -> Iterator[Batch]:
    """Yield batches whose frames count from 0 s and from 1; the last frame has no duration, as in CARLA's recordings."""
    latest, count = None, 0
    for batch in batches:
        if latest is not None:
            yield latest
        index, count = count, count + len(batch)
        numbers = np.arange(index + 1, count + 1, dtype=np.uint64)
        latest = Batch(index, numbers, batch.elapsed - origin, batch.duration, batch.columns)
    if latest is not None:
        latest.duration = np.append(latest.duration[:-1], LAST_FRAME_DURATION)
        yield latest


def _moved(header: Header, seconds: float) -> Header:
    """Return a header whose date is later by a number of seconds."""
    date = header.date + math.floor(seconds)
    if date == header.date or not -_LATEST_DATE <= date <= _LATEST_DATE:
        return header
    return replace(header, date=date, raw=None)
