"""A buffer that splits what a client sends into messages, at a bounded cost of memory.

A MessagePack value does not begin with its length: one has to scan it. The bytes of an incomplete message are kept as they
are, and objects are made only when it is complete, since an object takes up to eighty times the memory of its bytes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import msgpack

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_LARGEST: Final = 32 << 20  # bytes of a message: the text of a large map
_LONG: Final = 1 << 20  # bytes: in longer messages, the items are counted
_MOST_ITEMS: Final = 2 << 20  # of all counted arrays together: ten thousand actors to spawn
_LONGEST_ARRAY: Final = 1 << 14  # items: memory is allocated for them before they have arrived
_BUFFER: Final = 1 << 10  # bytes, at first


class MessageBuffer:
    """The messages that have arrived over a connection.

    Attributes:
        part: The bytes of an incomplete message.
    """

    def __init__(self) -> None:
        self.part = bytearray()
        self._scanner: msgpack.Unpacker | None = None
        self._chunk = b""
        self._unpacker = _unpacker()
        self._consumed = 0
        self._items = 0

    def feed(self, data: bytes) -> None:
        """Add data; all complete messages must have been taken out before.

        Raises:
            ValueError: The data is not MessagePack, or too large.
        """
        if self._scanner is None:
            self._open(data)
        else:
            self._collect(data)

    def __iter__(self) -> Iterator[Any]:
        """Take out the complete messages; one can stop in between and go on with a new iterator.

        Raises:
            ValueError: The data is not MessagePack, or too large.
        """
        for value in self._unpacker:
            self._consumed = self._unpacker.tell()
            yield value
        if self._consumed < len(self._chunk):
            part = self._chunk[self._consumed :]
            self._open(b"")
            self._scanner = _unpacker()
            self._collect(part)

    def _open(self, chunk: bytes) -> None:
        """Start with a chunk that begins with a message."""
        self._chunk = chunk
        self._consumed = self._items = 0
        self._unpacker = _unpacker(self._count if len(chunk) > _LONG else None)
        self._unpacker.feed(chunk)

    def _collect(self, data: bytes) -> None:
        """Add to an incomplete message, and open it if it is complete now."""
        assert self._scanner is not None
        self.part += data
        self._scanner.feed(data)
        try:
            self._scanner.skip()
        except msgpack.OutOfData:
            if len(self.part) > _LARGEST:
                raise ValueError from None
            return
        chunk = bytes(self.part)
        self._scanner = None
        self.part = bytearray()
        self._open(chunk)

    def _count(self, items: list[Any]) -> list[Any]:
        self._items += len(items)
        if self._items > _MOST_ITEMS:
            raise ValueError
        return items


def _unpacker(list_hook: Callable[[list[Any]], list[Any]] | None = None) -> msgpack.Unpacker:
    return msgpack.Unpacker(
        read_size=_BUFFER,
        max_buffer_size=2 * _LARGEST,
        max_array_len=_LONGEST_ARRAY,
        max_map_len=0,
        max_ext_len=0,
        list_hook=list_hook,
        unicode_errors="surrogateescape",
    )
