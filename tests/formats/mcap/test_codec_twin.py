"""Packets are encoded and decoded as protobuf's own library does it, one value at a time."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carla_recap.formats.mcap import codec
from carla_recap.model.layout import FLAG, REAL, TEXT, Framing, Layout, Many
from carla_recap.model.records import RecordType
from tests.twins import messages as twin
from tests.twins.messages import TYPES, every_type

if TYPE_CHECKING:
    from collections.abc import Callable

    from hypothesis.strategies import SearchStrategy

few = settings(max_examples=max(settings.default.max_examples // 10, 5))  # of each type
LIMITS = {"u1": (0, 255), "i1": (-128, 127), "u4": (0, 2**32 - 1), "i4": (-(2**31), 2**31 - 1), "u8": (0, 2**64 - 1)}
CODES = {"u1": "B", "i1": "b", "u4": "I", "i4": "i", "u8": "Q", "f4": "f", "f8": "d", FLAG: "B", "u2": "H"}
texts = st.one_of(st.text(max_size=5).map(str.encode), st.integers(0, 300).map(lambda n: b"x" * n), st.binary(max_size=4))


def numbers(kind: str) -> SearchStrategy[Any]:
    """Numbers of a kind, its limits among them; a NaN is quiet, as protobuf's Python makes all of 32 bits."""
    if kind == FLAG:
        return st.sampled_from([0, 1, 1, 0, 2, 255])
    if kind in ("f4", "f8"):
        special = st.sampled_from([float("nan"), float("inf"), -float("inf"), -0.0, 1e-45])
        return st.one_of(st.floats(width=32 if kind == "f4" else 64, allow_nan=False), special)
    low, high = LIMITS[kind]
    return st.one_of(st.sampled_from([0, 1, low, high]), st.integers(low, high))


def packed(kind: str, *, wide: bool) -> SearchStrategy[bytes]:
    kind = ("f8" if wide else "f4") if kind == REAL else kind
    return numbers(kind).map(lambda value: struct.pack(f"<{CODES[kind]}", value))


def records(layout: Layout, *, wide: bool, choice: int) -> SearchStrategy[bytes]:
    parts: list[SearchStrategy[bytes]] = []
    for kind in layout.fields.values():
        if isinstance(kind, Many):
            inner = records(kind.layouts[min(choice, len(kind.layouts) - 1)], wide=wide, choice=choice)
            parts.append(counted(kind.count, inner, 5))
        elif kind == TEXT:
            parts.append(texts.map(lambda text: struct.pack("<H", len(text)) + text))
        else:
            parts.append(packed(kind, wide=wide))
    return st.tuples(*parts).map(b"".join)


def counted(count: str, record: SearchStrategy[bytes], most: int) -> SearchStrategy[bytes]:
    """Some records after their number; up to `most` times the same one."""
    repeated = st.tuples(record, st.integers(0, most)).map(lambda drawn: [drawn[0]] * drawn[1])
    some = st.one_of(st.lists(record, max_size=3), repeated)
    return some.map(lambda found: struct.pack(f"<{CODES[count]}", len(found)) + b"".join(found))


def payloads(type: RecordType) -> SearchStrategy[bytes]:
    """Payloads of a type; a few have surplus bytes, and all wheels of a packet have the same layout."""
    surplus = st.sampled_from([b"", b"", b"", b"\7"])
    if type.framing is Framing.SINGLE:
        return st.tuples(records(type.layout, wide=type.wide, choice=0), surplus).map(b"".join)
    some = [counted("u2", records(type.layout, wide=type.wide, choice=choice), 60) for choice in range(2)]
    return st.tuples(st.one_of(*some), surplus).map(b"".join)


def changed(message: Any, change: Callable[[str, list[bytes]], list[bytes]]) -> bytes:
    """Return a message with the fields of each message in it in another order, or with others."""
    parts = []
    for field, value in message.ListFields():
        for item in list(value) if field.is_repeated else [value]:
            if field.message_type:
                data = changed(item, change)
                parts.append(codec.tag(field.number, codec.LEN) + codec.varint(len(data)) + data)
            else:
                parts.append(type(message)(**{field.name: item}).SerializeToString())
    return b"".join(change(message.DESCRIPTOR.name, parts))


CHANGES: dict[str, Callable[[str, list[bytes]], list[bytes]]] = {
    "as it is": lambda name, parts: parts,
    "reversed": lambda name, parts: parts[::-1],
    "with a new field": lambda name, parts: [*parts[:1], codec.tag(99, codec.LEN) + b"\3new", *parts[1:]],
    "without the last field": lambda name, parts: parts[:-1] if len(parts) > 3 else parts,
    "a number twice": lambda name, parts: [*parts[:1], *parts],
}


@every_type
@few
@given(data=st.data())
def test_packets_are_encoded_and_decoded_as_protobuf_does(type: RecordType, data: st.DataObject) -> None:
    some = data.draw(st.lists(payloads(type), min_size=1, max_size=3))
    elapsed = data.draw(st.sampled_from([0.0, -1.5, float("inf"), 1e300]))
    for payload in some:
        message = codec.head(2**64 - 1, elapsed) + codec.encode(type, payload)
        expected = twin.encoded(type, payload, 2**64 - 1, elapsed)
        raw = codec.tag(codec.RAW, codec.LEN) + codec.varint(len(payload)) + payload
        assert message in (expected, expected + raw)  # with numbers above 127 in a byte, `raw` is kept, too
        assert codec.decode(type, message) == twin.decoded(type, message) == payload


@every_type
@few
@given(data=st.data())
def test_messages_of_others_are_decoded_as_protobuf_does(type: RecordType, data: st.DataObject) -> None:
    found = []
    for payload in data.draw(st.lists(payloads(type), min_size=1, max_size=3)):
        parsed = codec.parse(type.name, type.message_name, twin.encoded(type, payload, 3, 0.5))
        found.append(changed(parsed, CHANGES[data.draw(st.sampled_from(sorted(CHANGES)))]))
    expected = [twin.decoded(type, message) for message in found]
    assert [codec.decode(type, message) for message in found] == expected
    if type.fixed:
        fast = [codec.records_codec(type).decode(message) for message in found]
        assert all(payload in (None, right) for payload, right in zip(fast, expected, strict=True))
    else:
        for message, payload in zip(found, expected, strict=True):
            rows = codec.decode_rows(type, np.frombuffer(message * 2, np.uint8).reshape(2, -1))
            assert rows is None or [row.tobytes() for row in rows] == [payload] * 2


@pytest.mark.parametrize("type", [type for type in TYPES if not type.fixed], ids=lambda type: type.name)
@few
@given(data=st.data())
def test_packets_of_one_structure_are_encoded_as_each_is(type: RecordType, data: st.DataObject) -> None:
    payload = data.draw(payloads(type))
    rows = np.frombuffer(payload * 3, np.uint8).reshape(3, -1).copy()
    for row in (1, 2):
        for at in data.draw(st.lists(st.integers(0, len(payload) - 1), max_size=3)):
            rows[row, at] = data.draw(st.integers(0, 1))
    bodies = codec.encode_rows(type, rows)
    for row, body in enumerate([] if bodies is None else bodies):
        message, payload = codec.head(7, 1.5) + body.tobytes(), rows[row].tobytes()
        # Protobuf does not keep a signalling NaN.
        assert message == twin.encoded(type, payload, 7, 1.5) or twin.decoded(type, message) != payload
        assert codec.decode(type, message) == payload
