"""What a stranger sends, taken apart into calls, at a bounded cost of memory.

MessagePack does not say how long a value is: one has to look. What has arrived of a call is kept as bytes, and objects are
made of it only once it is whole, since an object takes up to eighty times the memory of its bytes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import msgpack

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_LARGEST: Final = 32 << 20  # bytes of a call: the text of a large map
_LONG: Final = 1 << 20  # bytes: of more than that, the items are counted
_MOST_ITEMS: Final = 2 << 20  # of all arrays that are counted: ten thousand actors to spawn
_MOST_OF_ARRAY: Final = 1 << 14  # items: memory is taken for them before they have arrived
_BUFFER: Final = 1 << 10  # bytes, to begin with


class Inbox:
    """The calls that have arrived over a connection.

    Attributes:
        part: What has arrived of a call of which more is to come.
    """

    def __init__(self) -> None:
        self.part = bytearray()
        self._scanner: msgpack.Unpacker | None = None
        self._chunk = b""
        self._unpacker = _unpacker()
        self._taken = 0
        self._items = 0

    def feed(self, data: bytes) -> None:
        """Take in what has arrived; the calls that had arrived before must have been taken out.

        Raises:
            ValueError: It is no MessagePack, or too large.
        """
        if self._scanner is None:
            self._open(data)
        else:
            self._collect(data)

    def __iter__(self) -> Iterator[Any]:
        """Take out the calls that are whole; one can stop in between, and go on with a new iterator.

        Raises:
            ValueError: What has arrived is no MessagePack, or too large.
        """
        for value in self._unpacker:
            self._taken = self._unpacker.tell()
            yield value
        if self._taken < len(self._chunk):
            part = self._chunk[self._taken :]
            self._open(b"")
            self._scanner = _unpacker()
            self._collect(part)

    def _open(self, chunk: bytes) -> None:
        """Begin with some bytes, the first of which is the first of a call."""
        self._chunk = chunk
        self._taken = self._items = 0
        self._unpacker = _unpacker(self._count if len(chunk) > _LONG else None)
        self._unpacker.feed(chunk)

    def _collect(self, data: bytes) -> None:
        """Add to what has arrived of a call, and see whether it is whole now."""
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
        max_array_len=_MOST_OF_ARRAY,
        max_map_len=0,
        max_ext_len=0,
        list_hook=list_hook,
        unicode_errors="surrogateescape",
    )
