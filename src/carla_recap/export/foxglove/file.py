"""An MCAP file of protobuf messages, with all its topics declared at the beginning."""

from __future__ import annotations

from importlib.metadata import version
from typing import TYPE_CHECKING, Final

from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set

from carla_recap.util.files import AtomicFile

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from google.protobuf.message import Message

_CHUNK_SIZE: Final = 1 << 20


class McapFile(AtomicFile):
    """Writes messages.

    Args:
        path: The destination.
        topics: The message of each topic.

    Raises:
        RecapError: The place cannot be written to.
    """

    def __init__(self, path: Path | str, topics: Mapping[str, type[Message]]) -> None:
        super().__init__(path)
        self._channels: dict[str, int] = {}
        self._begin(lambda: self._declare(topics))

    def write(self, topic: str, time: int, message: Message | bytes) -> None:
        """Add a message.

        Args:
            topic: One of those declared.
            time: Nanoseconds since 1970, not before those of the message before.
            message: The message, or what it is when serialized.

        Raises:
            RecapError: The disk is full, or broken.
        """
        data = message if isinstance(message, bytes) else message.SerializeToString()
        try:
            self._writer.add_message(self._channels[topic], time, data, time)
        except OSError as error:
            raise self._unwritable(error) from None

    def describe(self, name: str, values: dict[str, str]) -> None:
        """Add metadata.

        Raises:
            RecapError: The disk is full, or broken.
        """
        try:
            self._writer.add_metadata(name, values)
        except OSError as error:
            raise self._unwritable(error) from None

    def _declare(self, topics: Mapping[str, type[Message]]) -> None:
        self._writer = Writer(self._file, chunk_size=_CHUNK_SIZE, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=f"carla-recap/{version('carla-recap')}")
        schemas: dict[str, int] = {}
        for topic, message in topics.items():
            name = message.DESCRIPTOR.full_name
            if name not in schemas:
                data = build_file_descriptor_set(message).SerializeToString()
                schemas[name] = self._writer.register_schema(name, "protobuf", data)
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", schemas[name])

    def _finish(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
