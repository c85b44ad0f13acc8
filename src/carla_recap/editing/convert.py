"""Conversion from one format to the other without loss."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.formats import create_writer, format_of, open_reader
from carla_recap.formats.sources import is_remote, path_of
from carla_recap.model.frame import SAME_TIME
from carla_recap.util.files import check_path, prepare_file, writing
from carla_recap.util.text import first_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator

    from carla_recap.formats.base import Reader, TopicMessage, Writer
    from carla_recap.formats.mcap.writer import McapWriter
    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Extent

    Progress = Callable[[Iterable[Batch], Reader], Iterable[Batch]]


def convert(
    source: Path | str,
    destination: Path | str,
    *,
    force: bool = False,
    progress: Progress | None = None,
) -> Extent:
    """Write a recording in another format; `.log` → `.mcap` → `.log` gives back the same bytes.

    Further topics, such as the data of sensors, are kept in an .mcap, and left out of a .log.

    Args:
        source: A recording of any format, or its URL.
        destination: The file to write; the suffix says the format. It appears when it is complete.
        force: Overwrite an existing file.
        progress: Gets the batches and their reader, and yields the batches.

    Returns:
        The extent of the recording.

    Raises:
        RecapError: The source is damaged, or the destination cannot be written.

    Warns:
        RecapWarning: Further topics are left out.
    """
    check_destination(source, destination, force=force)
    reader = open_reader(source)
    try:
        with create_writer(destination, reader.header, force=force) as writer:
            copy = TopicCopy(reader, writer)
            batches: Iterable[Batch] = reader.batches()
            for batch in progress(batches, reader) if progress else batches:
                writer.write_batch(batch)
                copy.write(batch.elapsed[-1].item())
            copy.write()
            for piece in reader.tail():
                writer.write_tail(piece)
        return reader.extent()
    finally:
        reader.close()


class TopicCopy:
    """Copies the further topics of a recording, such as the data of sensors, in step with its frames, but those `without`.

    Copied are messages from `start` to `stop`; times count from `origin`, all in elapsed seconds of the recording. Of topics
    with a single message, such as a map or a calibration, and of latched ones, the latest earlier one is copied, too, to the
    time of the start.
    A `RecapWarning` says that they are left out, since the copy is no MCAP file, which alone can hold them.
    """

    def __init__(
        self,
        reader: Reader,
        writer: Writer,
        *,
        start: float = -math.inf,
        stop: float = math.inf,
        origin: float = 0.0,
        without: Collection[str] = (),
    ) -> None:
        self._writer: McapWriter | None = None
        self._origin = origin
        self._messages: Iterator[TopicMessage] = iter(())
        self._next: TopicMessage | None = None
        topics = {name: topic for name, topic in reader.further_topics().items() if name not in without}
        if not topics:
            return
        from carla_recap.formats.mcap.writer import McapWriter

        if not isinstance(writer, McapWriter):
            things = f"{len(topics)} further topic{'s' * (len(topics) != 1)}"
            names = first_of([*topics])[:200]
            message = f"{reader.location}: {things} ({names}) left out, such as of sensors: only an .mcap holds them"
            warnings.warn(message, RecapWarning, stacklevel=3)
            return
        self._writer = writer
        for topic in topics.values():
            writer.add_topic(topic.topic, group=topic.group)
        latched = [name for name, topic in topics.items() if topic.count == 1 or topic.topic.is_latched]
        for name, elapsed, data in reader.latest_messages(latched, start):
            if elapsed < start - SAME_TIME:
                writer.write_message(name, start - origin, data)
        self._messages = reader.further_messages([*topics], start, stop, in_order=False)
        self._next = next(self._messages, None)

    def write(self, elapsed: float = math.inf) -> None:
        """Copy the messages up to a time, in elapsed seconds of the copy; without one, all that are left."""
        while self._writer is not None and self._next is not None:
            time = self._next.elapsed - self._origin
            if -2 * SAME_TIME < time < 0.0:  # that of the first frame
                time = 0.0
            if time > elapsed:
                return
            self._writer.write_message(self._next.topic, time, self._next.data)
            self._next = next(self._messages, None)


def check_destination(source: Path | str, destination: Path | str, *, force: bool) -> None:
    """Raise `RecapError` if a destination is the source, or if it exists and `force` is false."""
    target = Path(destination)
    with writing(destination):
        same = not is_remote(source) and target.exists() and path_of(source).exists() and target.samefile(path_of(source))
    if same:
        raise RecapError(f"{destination}: is the source itself")
    check_free(destination, force=force)


def check_free(destination: Path | str, *, force: bool) -> None:
    """Raise `RecapError` if a destination is a URL, or if it exists and `force` is false."""
    check_path(destination)
    with writing(destination):
        exists = Path(destination).exists() or Path(destination).is_symlink()
    if exists and not force:
        raise RecapError(f"{destination}: exists already; --force (in Python, force=True) replaces it")


def check_new(destination: Path | str, *, force: bool) -> None:
    """Raise `RecapError` if the suffix of a recording is of no format, or the destination is not free, or not writable."""
    format_of(destination)
    check_free(destination, force=force)
    prepare_file(destination)
