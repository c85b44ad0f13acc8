"""Looks up the impacts of contacts: in the digest of an MCAP file, else in the frames around them."""

from __future__ import annotations

import math
from bisect import bisect_left
from typing import TYPE_CHECKING, Final

from carla_recap.formats.sources import is_remote
from carla_recap.model.contacts import Impact
from carla_recap.model.motion import MOTION

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.contacts import Key
    from carla_recap.model.frame import Frame

LOOK_UPS: Final = 500
"""Moments that are looked up one by one; to find more, all frames are read."""
_BEFORE: Final = 1.0  # s before a moment that are read with it
_BEHIND: Final = 1e-3  # s behind it
_AT_ONCE: Final = 24  # times that are read at once from a remote recording
_FRAMES: Final = 3  # the frame of a contact, and two before it


def impacts(source: Reader, wanted: Mapping[Key, float]) -> dict[Key, Impact]:
    """Return impacts by key: the index of its frame and the ids of the actors; `wanted` has the elapsed seconds of each."""
    if not wanted:
        return {}
    found = {impact.key: impact for impact in listed_impacts(source) or () if impact.key in wanted}
    times = {key: time for key, time in wanted.items() if key not in found}
    if times:
        search = ImpactSearch(times)
        spans = joined((time - _BEFORE, time + _BEHIND) for time in times.values())
        if len(times) <= LOOK_UPS and (frames := source.frames_by_index(search.indexes, MOTION)):
            search.add_frames(frames)
        elif len(spans) <= LOOK_UPS and getattr(source, "metadata", {}).get("steady_clock") == "1":
            for batches in read_spans(source, spans):
                search.add(batches)
        if search.missing:
            search.add(source.batches(MOTION), is_whole=True)
        found |= search.found
    return found


def listed_impacts(source: Reader) -> list[Impact] | None:
    """Return the impacts of all contacts; None if the file does not list them."""
    part = source.digest("contacts")
    rows = part.read() if part is not None else None
    if rows is None:
        return None
    return [Impact(row[0], row[1], row[2], (row[3:6], row[6:9]), (row[9:12], row[12:])) for row in rows]


def joined(spans: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return spans of time in order; those that overlap are joined."""
    found: list[tuple[float, float]] = []
    for start, stop in sorted(spans):
        if found and start <= found[-1][1]:
            found[-1] = (found[-1][0], max(stop, found[-1][1]))
        else:
            found.append((start, stop))
    return found


def read_spans(source: Reader, spans: list[tuple[float, float]]) -> Iterator[Iterable[Batch]]:
    """Yield the motion in each of some spans; of a remote recording, several are read at once, to wait for them once."""
    if not is_remote(source.location):
        for start, stop in spans:
            yield source.batches(MOTION, start=start, stop=stop)
        return
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(_AT_ONCE, "carla-recap-contacts") as pool:
        for index in range(0, len(spans), _AT_ONCE):
            part = spans[index : index + _AT_ONCE]
            yield from pool.map(lambda span: list(source.batches(MOTION, start=span[0], stop=span[1])), part)


class ImpactSearch:
    """Finds the impacts with some keys in frames."""

    def __init__(self, keys: Iterable[Key]) -> None:
        self.found: dict[Key, Impact] = {}
        self.missing: dict[int, list[Key]] = {}  # those that are not found yet, by frame
        for key in keys:
            self.missing.setdefault(key[0], []).append(key)
        # Of the frames that they are found in, in order.
        self.indexes = sorted({index - back for index in self.missing for back in range(_FRAMES) if index >= back})
        self._frames: dict[int, Frame] = {}

    def add(self, batches: Iterable[Batch], *, is_whole: bool = False) -> None:
        """Search consecutive frames, all of a recording or some with the two before each contact, until all is found."""
        self._frames.clear()
        for batch in batches:
            self.batch(batch, is_whole=is_whole)
            if not self.missing:
                return

    def batch(self, batch: Batch, *, is_whole: bool = False) -> None:
        """Search the frames that follow those before."""
        first, stop = (bisect_left(self.indexes, index) for index in (batch.index, batch.index + len(batch)))
        for index in self.indexes[first:stop] if self.missing else ():
            self._add(batch.frame(index - batch.index), index, is_whole=is_whole)

    def add_frames(self, frames: Iterable[Frame]) -> None:
        """Search the frames at `indexes`."""
        for frame in frames:
            self._add(frame, frame.index, is_whole=True)

    def _add(self, frame: Frame, index: int, *, is_whole: bool) -> None:
        self._frames = {each: held for each, held in self._frames.items() if each > index - _FRAMES} | {index: frame}
        _, before, earlier = recent = [self._frames.get(index - back) for back in range(_FRAMES)]
        if is_whole or None not in recent[: index + 1]:
            for key in self.missing.pop(index, ()):
                self.found[key] = Impact.of(key, frame, before, earlier)


def is_known(vector: tuple[float, float, float]) -> bool:
    """Return whether a position or velocity is known."""
    return not math.isnan(vector[0])
