"""An export to ASAM OSI: an MCAP trace of `osi3.GroundTruth`, a message for each frame, and the map.

The file follows the multi-trace format of OSI 3.7: topics `ground_truth` and `ground_truth_map`, the version of OSI and of
protobuf in the metadata `net.asam.osi.trace` and in those of the channels. Message times begin at 0.
"""

from __future__ import annotations

from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.editing.convert import check_destination
from carla_recap.files.osi.ground_truth import GroundTruths
from carla_recap.files.osi.message_types import GROUND_TRUTH, MAP, VERSION, message_class, schema
from carla_recap.formats.base import Topic
from carla_recap.formats.mcap.container import ChunkBuilder, ChunkedFile
from carla_recap.formats.mcap.schema import EXPORT_METADATA
from carla_recap.replay import Played, Player
from carla_recap.roads.files import read_text
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from carla_recap.model.frame import Header
    from carla_recap.recording import Recording
    from carla_recap.replay import Follow
    from carla_recap.replay.player import Progress

__all__ = ["export_osi"]

_CHUNK_SIZE: Final = 1 << 20
_LEVEL: Final = 3
_METADATA: Final = "net.asam.osi.trace"
_TOPICS: Final = {"ground_truth": GROUND_TRUTH, "ground_truth_map": MAP}
_TRUTH_CHANNEL, _MAP_CHANNEL = 1, 2


def export_osi(
    source: Recording,
    destination: Path | str,
    *,
    follow: Follow | None = None,
    start: float = 0.0,
    duration: float = 0.0,
    opendrive: Path | str | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Played:
    """Write a recording as an OSI trace.

    Args:
        source: The recording.
        destination: The file; it appears when it is complete.
        follow: The host vehicle: an id or "hero"; None: the hero, if there is one.
        start: The beginning, in elapsed seconds; negative: in seconds before the end.
        duration: The number of seconds to export; 0: all of the rest.
        opendrive: The map of the town, an OpenDRIVE file, which the trace then contains.
        force: Overwrite the file if it exists.
        progress: Is given the stream of scenes and their player, and passes the scenes on.

    Returns:
        The number of messages, and the seconds that they span.

    Raises:
        MissingExtra: The extra `osi` is not installed.
        RecapError: The recording has no such time or no such actor, or a file cannot be read or written.
    """
    reader = source.reader
    check_destination(reader.location, destination, force=force)
    content = None if opendrive is None else read_text(Path(opendrive))
    heroes = [actor.id for actor in source.heroes]
    player = Player(source, start=start, duration=duration, follow=follow)
    host = player.followed if follow is not None else next(iter(heroes), None)
    name = readable(reader.header.map_name)
    truths = GroundTruths(host, name if content is not None else "")
    with _TraceWriter(destination, reader.header, reader.path.name, force=force) as writer:
        if content is not None:
            writer.write_map(name, content)
        for batch in player.batches(progress):
            for time, message in truths.messages(batch):
                writer.write(time, message.SerializeToString())
        return writer.played


class _TraceWriter(ChunkedFile):
    """Writes messages of a recording into a trace; see `AtomicFile`."""

    def __init__(self, path: Path | str, header: Header, name: str, *, force: bool) -> None:
        protobuf = version("protobuf")
        osi = ".".join(map(str, VERSION))
        metadata = {"net.asam.osi.trace.channel.osi_version": osi, "net.asam.osi.trace.channel.protobuf_version": protobuf}
        topics = [Topic(topic, message, partial(schema, message), metadata) for topic, message in _TOPICS.items()]
        super().__init__(path, topics, level=_LEVEL, force=force)
        self._chunk = ChunkBuilder()
        self._sequence = 0
        self._start: int | None = None
        self._last = -1
        self.played = Played(0, 0.0)  # the number of messages, and the seconds that they span
        trace = {
            "version": "1.0.0",
            "min_osi_version": osi,
            "max_osi_version": osi,
            "min_protobuf_version": protobuf,
            "max_protobuf_version": protobuf,
            "zero_time": _iso(header.date),
            "creation_time": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
            "description": f"{name}, a recording of CARLA in {readable(header.map_name)}",
            "data_sources": f"carla-recap {version('carla-recap')}",
        }
        self._begin(lambda: self._write_description(trace))

    def write(self, time: int, message: bytes) -> None:
        """Add a message, unless its time in ns is not after that of the message before."""
        if time <= self._last:
            return
        self._add(_TRUTH_CHANNEL, time, message)
        self._last = time
        self._start = time if self._start is None else self._start
        self.played = Played(self.played.frames + 1, (time - self._start) / 1e9)

    def write_map(self, name: str, opendrive: str) -> None:
        """Add the map."""
        message = message_class(MAP)(map_reference=name, open_drive_xml_content=opendrive)
        self._add(_MAP_CHANNEL, 0, message.SerializeToString())

    def _add(self, channel: int, time: int, message: bytes) -> None:
        self._chunk.add(channel, self._sequence, (time, time), b"", message)
        self._sequence += 1
        if self._chunk.size >= _CHUNK_SIZE:
            self._cut()

    def _write_description(self, trace: dict[str, str]) -> None:
        self._write_start()
        self._write_metadata(_METADATA, trace)
        self._write_metadata(EXPORT_METADATA, {"viewer": "osi"})

    def _cut(self) -> None:
        if not self._chunk.is_empty:
            chunk, self._chunk = self._chunk, ChunkBuilder()
            self._add_chunk(chunk)

    def _finish(self) -> None:
        self._cut()
        super()._finish()


def _iso(seconds: int) -> str:
    """Return a time as ISO 8601; that of 1970 for one that is out of range."""
    try:
        return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    except (OverflowError, OSError, ValueError):
        return "1970-01-01T00:00:00Z"
