"""Writes an export: all topics of each batch of scenes, in the order of time."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
from mcap.opcode import Opcode
from mcap_protobuf.schema import build_file_descriptor_set

from carla_recap.formats.mcap.container import ChunkBuilder, ChunkedFile, Topic
from carla_recap.formats.mcap.schema import EXPORT_METADATA, MESSAGE, MESSAGE_DTYPE, RECORD, LogClock
from carla_recap.model.frame import SAME_TIME
from carla_recap.replay import Played
from carla_recap.scene.captions import EventText, Level, incident_lines
from carla_recap.scene.collisions import FallenWalkers
from carla_recap.show.foxglove import bodies, followed, marks, scene
from carla_recap.show.foxglove.followed import known_poses
from carla_recap.show.foxglove.messages import FrameTransforms, Log, SceneUpdate, single, timestamps
from carla_recap.show.foxglove.town import MAP, map_message
from carla_recap.v1.followed_pb2 import Followed, ShownLights

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from google.protobuf.message import Message

    from carla_recap.model.frame import Header
    from carla_recap.queries.incidents import Incident
    from carla_recap.rendering.town import TownMesh
    from carla_recap.replay.scene import SceneBatch
    from carla_recap.scene.ahead import StopPoints
    from carla_recap.scene.captions import Line
    from carla_recap.scene.collisions import FallChange
    from carla_recap.show.foxglove.followed import KnownPoses
    from carla_recap.show.foxglove.messages import Floats, Indices, Times, TopicMessages

LOG: Final = "/log"

TOPICS: Final[Mapping[str, type[Message]]] = {
    MAP: SceneUpdate,
    bodies.VEHICLES: SceneUpdate,
    bodies.WALKERS: SceneUpdate,
    bodies.OTHERS: SceneUpdate,
    bodies.LAMPS: SceneUpdate,
    bodies.SIGNALS: SceneUpdate,
    marks.MARKS: SceneUpdate,
    followed.AHEAD: SceneUpdate,
    followed.TRANSFORMS: FrameTransforms,
    scene.MOVED: FrameTransforms,
    scene.STILL: FrameTransforms,
    followed.HERO: Followed,
    followed.LIGHTS: ShownLights,
    LOG: Log,
}
"""The message of each topic."""

RATE: Final = 20.0
"""The number of scenes shown per second, at most; scenes with events are shown besides."""

_TOGETHER: Final = 128  # scenes whose messages are made at once
_SLACK: Final = 0.9  # frames do not come quite evenly
_CHUNK_SIZE: Final = 1 << 20
_COMPRESSION_LEVEL: Final = 1  # the files are as small as those of level 3
_LEVELS: Final = {Level.DEBUG: Log.DEBUG, Level.INFO: Log.INFO, Level.WARNING: Log.WARNING, Level.ERROR: Log.ERROR}


class FoxgloveWriter(ChunkedFile):
    """Writes scenes.

    Args:
        path: The destination.
        header: The header of the recording.
        description: The metadata.
        follow: The id of the followed actor.
        town: The town, if it is known.
        stops: The points at which traffic lights stop cars; see `carla_recap.scene.ahead`.

    Raises:
        RecapError: The file cannot be written.
    """

    def __init__(
        self,
        path: Path | str,
        header: Header,
        description: dict[str, str],
        follow: int | None,
        town: TownMesh | None,
        stops: StopPoints | None = None,
    ) -> None:
        topics = [Topic(name, type.DESCRIPTOR.full_name, partial(_schema, type)) for name, type in TOPICS.items()]
        super().__init__(path, topics, level=_COMPRESSION_LEVEL)
        self._channel_of = {name: channel for channel, name in enumerate(TOPICS, 1)}
        self._chunk = ChunkBuilder()
        self._clock = LogClock(header)
        self._follow = follow
        self._town = town
        self._entities = scene.ActorEntities()
        self._marks = marks.MarkEntities()
        self._walkers = FallenWalkers()
        self._falls: list[FallChange] = []  # since the latest scene that is shown
        self._frames = followed.ViewFrames()
        self._motion = followed.FollowedMotion()
        self._lights = followed.LightMessages(stops or {})
        self._text = EventText()
        self._due = 0.0  # the elapsed time of the next scene to show
        self._start = 0.0  # the elapsed time of the first scene
        self._last: tuple[SceneBatch, Times] | None = None
        self._shown = False  # whether the last scene is shown
        self._count = 0
        self._clock_rows: list[tuple[Floats, Times]] = []  # elapsed seconds and log times of all scenes
        self._begin(lambda: self._write_description(description))

    def write(self, batch: SceneBatch) -> None:
        """Add scenes, which follow those before.

        Raises:
            RecapError: The disk is full, or broken.
        """
        for start in range(0, len(batch), _TOGETHER):
            part = batch if len(batch) <= _TOGETHER else batch[start : start + _TOGETHER]
            times = self._times_of(part)
            self._clock_rows.append((part.time, times))
            self._add(list(self._messages(part, times)), times)
            self._last = part, times
            self._count += len(part)

    def end(self) -> Played:
        """Show the last scene, if it is not shown yet; return how much was written.

        Raises:
            RecapError: The disk is full, or broken.
        """
        if self._last is None:
            return Played(0, 0.0)
        batch, times = self._last
        row, elapsed = len(batch) - 1, batch.time[-1].item()
        messages: list[TopicMessages] = []
        if not self._shown:
            messages += self._show(batch, np.array([row]), times, known_poses(batch, self._follow))
        if self._lights.latest.elapsed != elapsed:
            self._lights.latest.elapsed = elapsed
            messages.append(single(followed.LIGHTS, row, self._lights.latest))
        self._add(messages, times)
        return Played(self._count, elapsed - self._start)

    def write_incidents(self, found: Iterable[Incident]) -> None:
        """Write the incidents that began during the scenes so far as text, each at the scene at which it began."""
        if not self._clock_rows:
            return
        elapsed, times = (np.concatenate(column) for column in zip(*self._clock_rows, strict=True))
        seconds = np.maximum.accumulate(elapsed)
        lines = []
        for start, line in incident_lines(found):
            row = int(np.searchsorted(seconds, start - SAME_TIME))
            if row < len(seconds) and (row or seconds[0] <= start + SAME_TIME):
                lines.append(_log_line(line, row, times))
        self._cut()  # the times of what follows begin again
        self._add(lines, times)

    def _messages(self, batch: SceneBatch, times: Times) -> Iterator[TopicMessages]:
        """Yield the messages of scenes, given the time of each in ns since 1970."""
        if self._last is None:
            self._start = batch.time[0].item()
            yield single(MAP, 0, map_message(self._town, int(times[0])))
        for line in self._text.lines(batch.scene(0)):
            yield _log_line(line, 0, times)
        found = known_poses(batch, self._follow)
        if self._follow is not None:
            yield from self._motion.messages(batch, self._follow, found)
        yield from self._marks.messages(batch, timestamps(times))
        self._falls = [*(fall._replace(row=0) for fall in self._falls), *self._walkers.changes(batch)]
        rows = self._choose(batch)
        if len(rows):
            yield from self._show(batch, rows, times, found)

    def _choose(self, batch: SceneBatch) -> Indices:
        """Return the positions of the scenes that are shown."""
        rows = []
        for row, time in enumerate(batch.time.tolist()):
            self._shown = not time < self._due or (not row and bool(batch.events))
            if self._shown:
                self._due = time + _SLACK / RATE
                rows.append(row)
        return np.array(rows, np.intp)

    def _show(self, batch: SceneBatch, rows: Indices, times: Times, found: KnownPoses) -> Iterator[TopicMessages]:
        """Yield the messages of the scenes that are shown, given the poses of the followed actor."""
        found, stamps = found.take(rows), timestamps(times[rows])
        yield from self._frames.messages(batch, rows, stamps, found)
        falls = [fall for fall in self._falls if fall.row <= rows[-1]]
        self._falls = [fall for fall in self._falls if fall.row > rows[-1]]
        yield from self._entities.messages(batch, rows, stamps, falls)
        yield from self._lights.messages(batch, rows, stamps, found)

    def _times_of(self, batch: SceneBatch) -> Times:
        times = self._clock.times_of(batch.time)
        if times is None:
            return np.array([self._clock.times(time)[0] for time in batch.time.tolist()], np.uint64)
        return times[:, 0]

    # --- the file ------------------------------------------------------------------------------------------------------

    def _write_description(self, description: dict[str, str]) -> None:
        self._write_start()
        self._write_metadata(EXPORT_METADATA, description)
        for channel in self._channel_of.values():
            self._declare(channel)

    def _add(self, messages: Sequence[TopicMessages], times: Times) -> None:
        """Add messages, in the order of time; where times are equal, in the given order."""
        if not messages:
            return
        rows = np.concatenate([some.rows for some in messages])
        order = np.argsort(rows, kind="stable")
        counts = [len(some.rows) for some in messages]
        channels = np.repeat([self._channel_of[some.topic] for some in messages], counts)[order]
        sizes = np.repeat([some.data.shape[1] for some in messages], counts)[order]
        log_times = times[rows[order]]
        records: list[memoryview] = []
        for some in messages:
            records += _records(some, self._channel_of[some.topic], times)
        begin, offsets = 0, np.concatenate(([0], np.cumsum(sizes)))
        while begin < len(order):
            room = offsets[begin] + _CHUNK_SIZE - self._chunk.size
            stop = max(begin + 1, min(int(np.searchsorted(offsets, room)), len(order)))
            entries = np.stack((log_times[begin:stop], (offsets[begin:stop] - offsets[begin]).astype(np.uint64)), axis=1)
            index = {channel: entries[channels[begin:stop] == channel] for channel in set(channels[begin:stop].tolist())}
            added = [records[record] for record in order[begin:stop].tolist()]
            self._chunk.add_records(added, index, int(log_times[begin]), int(log_times[stop - 1]))
            if self._chunk.size >= _CHUNK_SIZE:
                self._cut()
            begin = stop

    def _cut(self) -> None:
        if not self._chunk.is_empty:
            chunk, self._chunk = self._chunk, ChunkBuilder()
            self._add_chunk(chunk)

    def _finish(self) -> None:
        self._cut()
        super()._finish()


def _records(messages: TopicMessages, channel: int, times: Times) -> list[memoryview]:
    """Return the records of messages, whose headers are set."""
    size = messages.data.shape[1]
    header = messages.data[:, : MESSAGE.size].view(MESSAGE_DTYPE)[:, 0]
    header["opcode"], header["length"], header["channel"], header["sequence"] = (
        Opcode.MESSAGE,
        size - RECORD.size,
        channel,
        0,
    )
    header["log_time"] = header["publish_time"] = times[messages.rows]
    data = messages.data.reshape(-1).data
    return [data[start : start + size] for start in range(0, len(data), size)]


def _log_line(line: Line, row: int, times: Times) -> TopicMessages:
    message = Log(level=_LEVELS[line.level], name=line.subject, message=line.text)
    message.timestamp.FromNanoseconds(int(times[row]))
    return single(LOG, row, message)


def _schema(message: type[Message]) -> bytes:
    data: bytes = build_file_descriptor_set(message).SerializeToString()
    return data
