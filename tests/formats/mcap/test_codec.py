"""The wire format: what is written is protobuf's own, and what protobuf may write can be read."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from google.protobuf.message import DecodeError
from hypothesis import given, settings
from hypothesis import strategies as st

from carla_recap.errors import RecordError
from carla_recap.formats.mcap import codec
from carla_recap.formats.mcap.schema import FRAME_MESSAGE, RAW_MESSAGE, STATIONARY, TAIL_MESSAGE
from carla_recap.model.layout import MAX_COUNT, Framing, pack, unpack
from carla_recap.model.records import UE4, UE5, RecordType, Spawn, attributes
from carla_recap.model.stationary import BlockedRow
from tests import strategies
from tests.samples import bone, listed, packet_payloads, plain
from tests.twins.messages import TYPES, decoded, every_type
from tests.twins.messages import encoded as encoded_by_protobuf
from tests.waiting import time_limit

few = settings(max_examples=max(settings.default.max_examples // 10, 5))  # of each type


def encoded(type, payload, frame=3, elapsed=1.5):
    return codec.head(frame, elapsed) + codec.encode(type, payload)


# --- what is written -------------------------------------------------------------------------------------


def test_a_full_packet_comes_back():
    type = UE4.named("transforms")
    payload = struct.pack("<H", MAX_COUNT) + np.random.default_rng(1).bytes(MAX_COUNT * 28)
    assert codec.decode(type, encoded(type, payload)) == payload


@given(st.integers(0, 2**64 - 1), st.floats(), st.floats(), st.binary(max_size=300), st.data())
def test_a_frame_is_what_protobuf_writes(frame, elapsed, duration, ids, data):
    kinds = data.draw(st.binary(min_size=len(ids), max_size=len(ids)))
    written = codec.head(frame, elapsed) + codec.frame_body(duration, ids, kinds)
    message = codec.parse("frame", FRAME_MESSAGE, written)
    assert message.SerializeToString() == written
    assert plain([message.frame, message.elapsed, message.duration]) == plain([frame, elapsed, duration])
    assert (message.packets, message.filled) == (ids, kinds)
    assert plain(codec.read_frame(written)) == plain((frame, elapsed, duration, ids, kinds))


@given(st.binary(max_size=80).filter(lambda data: data[:1] != b"\x09"))
def test_what_is_no_frame_is_left_to_protobuf(data):
    assert codec.read_frame(data) is None


@given(st.integers(0, 255), st.integers(0, 40))
def test_raw_pieces_are_what_protobuf_writes(id, size):
    payload = bytes(range(size))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(codec, "PIECE", 16)
        bodies = list(codec.raw_bodies(id, payload))
    parsed = [codec.parse("raw_packet", RAW_MESSAGE, codec.head(1, 2.0) + body) for body in bodies]
    assert [m.SerializeToString() for m in parsed] == [codec.head(1, 2.0) + body for body in bodies]
    assert b"".join(m.data for m in parsed) == payload
    assert {(m.id, m.size) for m in parsed} == {(id, size)}


@given(st.binary(max_size=300))
def test_a_tail_is_what_protobuf_writes(data):
    message = codec.parse("tail", TAIL_MESSAGE, codec.tail(data))
    assert message.data == data
    assert message.SerializeToString() == codec.tail(data)


# --- as protobuf's own library does it, one value at a time ------------------------------------------------------------


def repeated(payload, times, surplus):
    """The records of a payload some times over."""
    return struct.pack("<H", times * int.from_bytes(payload[:2], "little")) + times * payload[2:] + surplus


def payloads(type):
    """Payloads without a NaN, of which protobuf's Python does not keep all bits; a few have surplus bytes."""
    found = strategies.payloads(type, UE5 if type.wide else UE4, st.just(b""))
    if type.framing is not Framing.SINGLE:
        found = st.builds(repeated, found, st.sampled_from([1, 1, 2, 60]), st.sampled_from([b"", b"", b"", b"\7"]))
    return found.filter(lambda payload: "nan" not in repr(plain(unpack(type, payload)[0])))


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
        expected = encoded_by_protobuf(type, payload, 2**64 - 1, elapsed)
        raw = codec.tag(codec.RAW, codec.LEN) + codec.varint(len(payload)) + payload
        assert message in (expected, expected + raw)  # with numbers above 127 in a byte, `raw` is kept, too
        assert codec.decode(type, message) == decoded(type, message) == payload


@every_type
@few
@given(data=st.data())
def test_messages_of_others_are_decoded_as_protobuf_does(type: RecordType, data: st.DataObject) -> None:
    found = []
    for payload in data.draw(st.lists(payloads(type), min_size=1, max_size=3)):
        parsed = codec.parse(type.name, type.message_name, encoded_by_protobuf(type, payload, 3, 0.5))
        found.append(changed(parsed, CHANGES[data.draw(st.sampled_from(sorted(CHANGES)))]))
    expected = [decoded(type, message) for message in found]
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
        assert message == encoded_by_protobuf(type, payload, 7, 1.5) or decoded(type, message) != payload
        assert codec.decode(type, message) == payload


# --- what others may write -------------------------------------------------------------------------------


@every_type
def test_an_empty_message_is_an_empty_packet(type):
    expected = bytes(8) if type.framing is Framing.SINGLE else listed()
    assert codec.decode(type, b"") == expected


HEAD = codec.head(1, 0.0)


@pytest.mark.parametrize(
    ("name", "message", "reason"),
    [
        ("destroyed", HEAD + b"\x1a\5\x0d\1\0\0\0" * (MAX_COUNT + 1), "65536 records, a packet counts at most 65535"),
        ("doors", HEAD + b"\x1a\3\x10\xac\2", "doors"),  # door 300
        ("spawned", HEAD + b"\x1a\0" * 1000, "1000 records in 2018 bytes, most of them without an id"),
        ("spawned", HEAD + b"\x1a" + b"\xff" * (1 << 20), "more than 64 bits"),
        ("spawned", bytes(9 << 20), "at most 8388608 bytes"),
    ],
    ids=["too many records", "a number beyond its field", "without content", "a number without an end", "too long"],
)
def test_a_message_that_no_packet_gives_is_refused(name, message, reason):
    with time_limit(), pytest.raises(codec.WireError, match=reason):
        codec.decode(UE4.named(name), message)


def test_stretches_are_read_as_protobuf_reads_them():
    rows = [BlockedRow(1.5, 30.0, 7, "vehicle.ä", 1.0, -2.0, 0.5), BlockedRow(2.0, 31.0, 8, "", 0.0, 0.0, 0.0)]
    message = codec.head(5, 2.5) + codec.encode(STATIONARY, pack(STATIONARY, rows))
    other = codec.parse("stretches", "carla_recap.v1.Stretches", message)
    assert [(s.id, s.type_id, s.start, s.x) for s in other.stretches] == [(r.id, r.type_id, r.start, r.x) for r in rows]
    assert [BlockedRow(**row._asdict()) for row in codec.decode_records(STATIONARY, message)] == rows
    assert codec.decode_records(STATIONARY, codec.head(5, 2.5)) == []
    with pytest.raises(codec.WireError, match="not a carla_recap"):
        codec.decode_records(STATIONARY, message[:-1])


# The third and the fourth wire type are groups, which protobuf gave up in 2008; the last bytes would make NaNs.
NEW = st.integers(0, 255).filter(lambda byte: byte & 7 not in (3, 4, 7))


@given(st.sampled_from(packet_payloads()[:-1]), st.integers(0, 200), st.lists(NEW, max_size=3).map(bytes))
@settings(max_examples=300)
def test_a_changed_message_is_read_as_protobuf_reads_it(sample, index, new):
    type, payload = UE4[sample[0]], sample[1]
    message = bytearray(encoded(type, payload))
    message[index : index + len(new)] = new
    try:
        expected = decoded(type, bytes(message))
    except (DecodeError, OverflowError, RecordError):
        expected = None
    try:
        found = codec.decode(type, bytes(message))
    except codec.WireError:
        found = None
    assert found == expected


@pytest.mark.parametrize("count", [2, 1500])
def test_a_signalling_nan_keeps_its_bits(count):
    type = UE4.named("spawned")
    payload = bytearray(pack(type, [Spawn(1, 1, 1.0, type_id="vehicle.ä", attributes=attributes(role_name="hero"))] * count))
    payload[7:11] = b"\x01\x00\x80\x7f"  # x of the first one
    message = encoded(type, bytes(payload))
    assert codec.decode(type, message) == payload


WALKER = struct.pack("<I", 8) + listed(bone("crl_root", *range(6)), bone("crl_hips", *range(6)))


@pytest.mark.parametrize(("name", "record"), [("transforms", bytes(28)), ("walker_bones", WALKER)])
def test_the_head_of_a_message_is_checked(name, record):
    type = UE4.named(name)
    message = encoded(type, listed(record))
    swapped = message[9:18] + message[:9] + message[18:]
    broken = b"\x0b" + message[1:]  # the begin of a group
    for _ in range(2):  # the second time with the template of the first
        assert codec.decode(type, message) == codec.decode(type, swapped) == listed(record)
        with pytest.raises(codec.WireError):
            codec.decode(type, broken)
    if type.fixed:
        assert codec.records_codec(type).decode(message) is not None
        assert codec.records_codec(type).decode(swapped) is None


@pytest.mark.parametrize("tag", range(3))
def test_heads_in_arrays_are_checked(tag):
    heads = np.zeros(3, codec.FRAME_HEAD)
    heads["frame_tag"], heads["elapsed_tag"], heads["duration_tag"] = 0x09, 0x11, 0x19
    assert codec.have_heads(heads)
    heads[("frame_tag", "elapsed_tag", "duration_tag")[tag]][1] += 1
    assert not codec.have_heads(heads)
