"""Recovery of recordings that are damaged or were never finished."""

from __future__ import annotations

import warnings
from contextlib import closing, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from carla_recap.editing.convert import TopicCopy, check_destination
from carla_recap.errors import FormatError, RecapError, RecapWarning
from carla_recap.formats import create_writer, read_start, unfinished
from carla_recap.formats.carla_log import LogReader, is_log
from carla_recap.formats.log_scan import PACKETS_LIMIT
from carla_recap.formats.sources import LocalSource, is_remote, path_of
from carla_recap.model.batch import Batch
from carla_recap.model.layout import PayloadError, check
from carla_recap.model.records import FRAME_END
from carla_recap.util.files import partials

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from carla_recap.editing.convert import Progress
    from carla_recap.formats.base import Reader, Writer
    from carla_recap.model.frame import Packet


@dataclass(frozen=True)
class Recovery:
    """The result of a recovery.

    Attributes:
        frames: The number of frames that were saved.
        lost_frames: The number of frames that are known to be missing between them.
        lost_bytes: The number of bytes of the source that were not used.
        duration: The elapsed seconds of the last saved frame.
        finished: Whether the source was complete up to its end.
        headless: Whether its header was lost, so that the map is unknown.
        lost_packets: The number of packets of saved frames that contradict their type.
        without_events: Whether events of saved frames were lost: an MCAP file has most of them at its end.
    """

    frames: int
    lost_frames: int
    lost_bytes: int
    duration: float
    finished: bool
    headless: bool = False
    lost_packets: int = 0
    without_events: bool = False

    @property
    def losses(self) -> list[str]:
        """What is missing, in words; empty if nothing is."""
        counts = ((self.lost_frames, "frames"), (self.lost_packets, "packets"), (self.lost_bytes, "bytes"))
        lost = [f"{count} {what} lost" for count, what in counts if count]
        if not self.finished:
            lost.append("unfinished or damaged at its end")
        if self.without_events:
            lost.append("spawns, collisions and other events lost")
        if self.headless:
            lost.append("header and map lost")
        return lost

    def __str__(self) -> str:
        saved = f"{self.frames} frame{'s' * (self.frames != 1)} saved, up to {self.duration:g} s"
        return "; ".join([saved, *(self.losses or ["nothing lost"])])


def recover(
    source: Path | str,
    destination: Path | str,
    *,
    force: bool = False,
    progress: Progress | None = None,
    format: str | None = None,
) -> Recovery:
    """Write the intact frames of a recording to a new one, and in an .mcap its intact further topics, such as of sensors.

    Args:
        source: The damaged file, MCAP or log; or its URL, which is copied to a temporary file. If it is missing or has no
            frames, the partial file beside it, which a writer has left, is taken.
        destination: The file to write; the suffix says the format.
        force: Overwrite an existing file.
        progress: As in `convert`.
        format: The suffix of the format, if it is not that of the destination.

    Raises:
        RecapError: Nothing can be saved, or the destination cannot be written.

    Warns:
        RecapWarning: Further topics are left out of a .log, or a partial file is taken.
    """
    check_destination(source, destination, force=force)
    source = _written(source)
    reader, finished, lost_bytes, headless = _open(source)
    frames, last, duration, lost_packets = 0, -1, 0.0, 0
    try:
        with create_writer(destination, reader.header, force=force, format=format) as writer:
            copy = TopicCopy(reader, writer)
            stream: Iterable[Batch] = map(Batch.of, reader.frames())
            for batch in progress(stream, reader) if progress else stream:
                frame = batch.frame(0)
                if frame.preamble and frames:  # its packets would be added to the frame before
                    continue
                sound = [packet for packet in frame.packets if _is_sound(packet)][:PACKETS_LIMIT]
                lost_packets += len(frame.packets) - len(sound)
                frame.packets = sound
                writer.write(frame)
                frames += 1
                last, duration = frame.index, frame.elapsed
                copy.write(duration)
            copy.write()
            writer.without_events = reader.header.without_events or reader.lost_messages
        if isinstance(reader, LogReader):
            cut = sum(map(len, reader.tail()))
            finished = not cut
            lost_bytes += reader.lost_bytes + cut
        expected = max(last + 1, int(getattr(reader, "metadata", {}).get("frames", 0)))
    finally:
        reader.close()
    return Recovery(frames, expected - frames, lost_bytes, duration, finished, headless, lost_packets, writer.without_events)


def finish_partial(
    writer: Writer, path: Path, error: Exception, *, force: bool = False, format: str | None = None
) -> RecapError:
    """Finish a recording whose writer has failed with the frames written so far; if that fails, keep the partial file.

    The error that is returned has the reason, and the end of the recording or the path of the partial file.
    """
    partial = writer.abandon()
    if not partial.exists():
        return RecapError(f"{error}; nothing of what was recorded is left")
    try:
        with warnings.catch_warnings(action="ignore", category=RecapWarning):  # the returned error says that it was cut
            saved = recover(partial, path, force=force, format=format)
    except Exception:  # any error: the partial file has the frames
        return RecapError(f"{error}; what was recorded until then is in {partial}, for carla-recap recover")
    with suppress(OSError):
        partial.unlink()
    return RecapError(f"{error}; the recording ends at {saved.duration:g} s")


def _written(source: Path | str) -> Path | str:
    """Return the file with the frames of a recording: itself, or the partial file beside it."""
    left = [] if is_remote(source) else partials(path_of(source))
    if not left or _has_frames(source):
        return source
    error = unfinished(source, left)
    if len(left) > 1:
        raise error
    warnings.warn(f"{error}, which is recovered", RecapWarning, stacklevel=3)
    return left[0]


def _has_frames(source: Path | str) -> bool:
    with suppress(RecapError):
        reader, *_ = _open(source)
        with closing(reader):
            return next(reader.frames(), None) is not None
    return False


def _is_sound(packet: Packet) -> bool:
    """Return whether a packet matches its type, so that it can be written in any format and read again."""
    try:
        payload = packet.payload
        if packet.id <= FRAME_END:
            return packet.id == FRAME_END and not len(payload)
        if packet.type is not None and not packet.type.opaque:
            check(packet.type, payload)
        return True
    except (FormatError, PayloadError):
        return False


def _open(source: Path | str) -> tuple[Reader, bool, int, bool]:
    """Return a reader of the intact parts, whether the file has an end, its lost bytes, and whether its header is lost."""
    file = None
    if is_remote(source):
        from carla_recap.formats.remote import copy_of

        file = copy_of(str(source))
    if is_log(read_start(source) if file is None else file.read(64)):
        return LogReader(source, lenient=True, file=file), True, 0, False
    raw = LocalSource(source, file)
    try:
        return _open_mcap(raw)
    except BaseException:
        raw.close()
        raise


def _open_mcap(raw: LocalSource) -> tuple[Reader, bool, int, bool]:
    from carla_recap.formats.mcap.reader import McapReader
    from carla_recap.formats.mcap.recovery import guess_header, recover_summary
    from carla_recap.formats.mcap.schema import HEADER_METADATA

    summary, damage = recover_summary(raw)
    source = raw.location
    if not summary.chunks:
        raise RecapError(f"{source}: nothing can be saved: it is no CARLA log, and no whole chunk of an MCAP file was found")
    if not any(name.startswith("carla_recap.v1.") for name in summary.schemas.values()):
        raise RecapError(f"{source}: nothing can be saved: it holds no recording")
    headless = HEADER_METADATA not in summary.metadata
    header = guess_header(summary) if headless else None
    return McapReader(raw, summary=summary, header=header, lenient=True), damage.finished, damage.bytes, headless
