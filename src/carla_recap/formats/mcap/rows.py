"""Frames that differ in nothing but their numbers, as rows of an array: the messages of each, as they stand in a chunk."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from mcap.opcode import Opcode

from carla_recap.formats.mcap import wire
from carla_recap.formats.mcap.container import EMPTY, FILLED, MESSAGE, MESSAGE_FIELDS
from carla_recap.frame import Block
from carla_recap.payload import EMPTY_LIST, OBJECTS_LIMIT
from carla_recap.records import FRAME_END, FRAME_START, Group

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import DTypeLike, NDArray

    from carla_recap.frame import Packet, Run

_HEADER: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
        ("frame_tag", "u1"),
        ("frame", "<u8"),
        ("elapsed_tag", "u1"),
        ("elapsed", "<f8"),
    ]
)
"""What each message begins with: `MESSAGE`, and then `wire.HEAD`."""
_OWN: Final = ("sequence", "log_time", "publish_time", "frame", "elapsed")
"""What is each frame's own in it."""


class RowForm:
    """How the messages of each frame of some runs follow each other.

    Attributes:
        size: The bytes of all messages of a frame.
        additional: Whether there are packets that CARLA writes only when it records additional data.
    """

    def __init__(self, channels: Mapping[int, int], frame_channel: int, packets: Sequence[Packet | Block]) -> None:
        self.additional = any(packet.type is not None and packet.type.additional for packet in packets)
        self._messages: list[tuple[int, int]] = []  # channel and place of each
        self._fields: dict[str, tuple[DTypeLike, int]] = {}
        template = bytearray()
        for packet in packets:
            if isinstance(packet, Block):
                count = packet.records.shape[1]
                body, dtype = wire.uniform_body(packet.type, count)
                self._fields[packet.type.name] = (dtype, (count,)), len(template) + _HEADER.itemsize
                self._add(template, channels[packet.type.id], body)
        start = bytes((FRAME_START,))
        ids = start + bytes([_id(packet) for packet in packets])
        kinds = start + bytes([FILLED if isinstance(packet, Block) else EMPTY for packet in packets])
        self._fields["duration"] = "<f8", len(template) + _HEADER.itemsize + 1  # behind its tag
        self._add(template, frame_channel, wire.frame_body(0.0, ids, kinds))
        self.size = len(template)
        self._template = np.frombuffer(bytes(template), np.uint8)
        self._dtype = np.dtype(
            {
                "names": list(self._fields),
                "formats": [dtype for dtype, _ in self._fields.values()],
                "offsets": [at for _, at in self._fields.values()],
                "itemsize": self.size,
            }
        )

    def rows(
        self, run: Run, part: slice, sequence: int, times: NDArray[np.uint64]
    ) -> tuple[bytes, dict[int, NDArray[np.uint64]]]:
        """Some frames of a run.

        Args:
            run: A run of this form.
            part: Which of its frames.
            sequence: The number of the first of them.
            times: Log and publish time of each, (frames, 2).

        Returns:
            The records, and by channel the log time and offset of each message, (messages, 2).
        """
        count = len(times)
        data = np.empty((count, self.size), np.uint8)
        data[:] = self._template
        rows = data.view(self._dtype)[:, 0]
        blocks = slice(run.first + part.start, run.first + part.stop)
        for packet in run.packets:
            if isinstance(packet, Block):
                wire.fill(packet.type, rows[packet.type.name], packet.records[blocks])
        rows["duration"] = run.durations[part]
        header = np.empty(count, _HEADER)
        header["sequence"] = np.arange(sequence, sequence + count)
        header["log_time"], header["publish_time"] = times.T
        header["frame"] = np.array(run.indices[part]) + 1
        header["elapsed"] = run.elapsed[part]
        index = {}
        begins = np.arange(0, count * self.size, self.size, dtype=np.uint64)
        for channel, at in self._messages:
            headers = rows[_header_at(at)]
            for name in _OWN:
                headers[name] = header[name]
            index[channel] = np.stack((times[:, 0], begins + np.uint64(at)), axis=1)
        return data.tobytes(), index

    def _add(self, template: bytearray, channel: int, body: bytes) -> None:
        self._messages.append((channel, len(template)))
        self._fields[_header_at(len(template))] = _HEADER, len(template)
        length = MESSAGE_FIELDS + wire.HEAD.size + len(body)
        template += MESSAGE.pack(Opcode.MESSAGE, length, channel, 0, 0, 0) + wire.head(0, 0.0) + body


def _header_at(place: int) -> str:
    """The name of the field of the header of the message at a place."""
    return f"header at {place}"


def has_form(run: Run) -> bool:
    """Whether the frames of a run differ in nothing but their numbers."""
    return all(
        packet.type.group is Group.STATE and packet.size <= OBJECTS_LIMIT and wire.fits(packet.type, packet.records)
        if isinstance(packet, Block)
        else (packet.type is not None and packet.payload == EMPTY_LIST) or (packet.id == FRAME_END and not packet.payload)
        for packet in run.packets
    )


def key(run: Run) -> tuple[tuple[int, int], ...]:
    """What runs of the same form have in common."""
    return tuple((_id(packet), packet.size if isinstance(packet, Block) else -1) for packet in run.packets)


def _id(packet: Packet | Block) -> int:
    return packet.type.id if isinstance(packet, Block) else packet.id
