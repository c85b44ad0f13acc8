"""The wire format: what is written is protobuf's own, and what protobuf may write can be read."""

from __future__ import annotations

import struct
import warnings
from dataclasses import fields

import numpy as np
import pytest
from google.protobuf.descriptor import FieldDescriptor as Field
from google.protobuf.message import DecodeError
from hypothesis import given, settings
from hypothesis import strategies as st

from carla_recap.errors import RecapWarning, RecordError
from carla_recap.formats.mcap import codec
from carla_recap.formats.mcap.schema import FRAME_MESSAGE, RAW_MESSAGE, STATIONARY, TAIL_MESSAGE
from carla_recap.model.layout import FLAG, MAX_COUNT, REAL, TEXT, Framing, Layout, Many, PayloadError, pack
from carla_recap.model.records import UE4, UE5, Spawn, attributes
from carla_recap.model.stationary import BlockedRow
from tests import strategies
from tests.samples import bone, listed, plain
from tests.twins.messages import decoded, every_type
from tests.waiting import time_limit

few = settings(max_examples=settings.default.max_examples // 6)  # of each type


# Kind of a field in the table → types that it may have in a schema.
KINDS = {
    "u1": {Field.TYPE_UINT32, Field.TYPE_ENUM},
    "i1": {Field.TYPE_INT32, Field.TYPE_ENUM},
    "u4": {Field.TYPE_FIXED32},
    "i4": {Field.TYPE_SFIXED32},
    "u8": {Field.TYPE_FIXED64},
    "f4": {Field.TYPE_FLOAT},
    "f8": {Field.TYPE_DOUBLE},
    FLAG: {Field.TYPE_BOOL},
    TEXT: {Field.TYPE_STRING},
}


def head_fields(descriptor):
    return [(f.name, f.number, f.type) for f in descriptor.fields if f.number < codec.ITEMS]


def payload_of(type, data):
    """Any payload of a type; its bytes may be of the kind that no message gives back."""
    return data.draw(strategies.payloads(type, UE5 if type.wide else UE4))


def encoded(type, payload, frame=3, elapsed=1.5):
    return codec.head(frame, elapsed) + codec.encode(type, payload)


def message_of(type, payload):
    return codec.message_class(type.name, type.message_name).FromString(encoded(type, payload))


# --- the schemas agree with the table --------------------------------------------------------------------


def check_layout(layout: Layout, descriptor, wide: bool, first: int = 1) -> None:
    for number, (name, kind) in enumerate(layout.fields.items(), first):
        field = descriptor.fields_by_name[name]
        assert field.number == number, f"{descriptor.full_name}.{name}"
        if isinstance(kind, Many):
            assert field.is_repeated
            check_layout(kind.layouts[0], field.message_type, wide)
            for other in kind.layouts[1:]:
                assert set(other.fields) <= set(kind.layouts[0].fields)
            continue
        code = ("f8" if wide else "f4") if kind == REAL else kind
        assert field.type in KINDS[code], f"{descriptor.full_name}.{name}"
        assert field.has_presence, f"{descriptor.full_name}.{name} is not optional"


@every_type
def test_a_schema_has_the_fields_of_its_layout(type):
    descriptor = codec.message_class(type.name, type.message_name).DESCRIPTOR
    assert descriptor.full_name == type.message_name
    assert head_fields(descriptor) == [("frame", 1, Field.TYPE_FIXED64), ("elapsed", 2, Field.TYPE_DOUBLE)]
    raw = descriptor.fields_by_name["raw"]
    assert (raw.number, raw.type) == (4, Field.TYPE_BYTES)
    assert [f.number for f in descriptor.fields] == [1, 2, 3, 4]
    if type.framing is Framing.SINGLE:
        assert list(type.layout.fields) == [type.items]
        check_layout(type.layout, descriptor, type.wide, first=codec.ITEMS)
    else:
        items = descriptor.fields_by_name[type.items]
        assert items.number == codec.ITEMS
        assert items.is_repeated
        check_layout(type.layout, items.message_type, type.wide)
        assert len(items.message_type.fields) == len(type.layout.fields)


def layouts_with_a_class(layout):
    if layout.make:
        yield layout
    for kind in layout.fields.values():
        if isinstance(kind, Many):
            for inner in kind.layouts:
                yield from layouts_with_a_class(inner)


@pytest.mark.parametrize(
    "layout",
    {layout.make: layout for type in UE4 for layout in layouts_with_a_class(type.layout)}.values(),
    ids=lambda layout: layout.make.__name__,
)
def test_a_record_class_has_the_fields_of_its_layout(layout):
    assert [field.name for field in fields(layout.make)] == list(layout.fields)


# --- what is written -------------------------------------------------------------------------------------


@pytest.mark.parametrize("numbers", [9, 12])  # of a wheel: until 0.9.11, and since
def test_all_bits_of_wheels_come_back(numbers):
    type = UE4.named("physics")
    wheel = struct.pack("<I", 0xFFA20000) * numbers  # a signalling NaN, of which protobuf makes a quiet one
    payload = b"\1\0" + struct.pack("<I5fB7f", 7, *range(5), 1, *range(7)) + bytes(12) + struct.pack("<I", 1) + wheel
    message = encoded(type, payload)
    codec._templates.clear()
    assert codec.decode(type, message) == payload


def test_a_full_packet_comes_back():
    type = UE4.named("transforms")
    payload = struct.pack("<H", MAX_COUNT) + np.random.default_rng(1).bytes(MAX_COUNT * 28)
    assert codec.decode(type, encoded(type, payload)) == payload


@every_type
def test_a_payload_that_ends_too_early_is_refused(type):
    short = bytes(3) if type.framing is Framing.SINGLE else b"\2\0\1"
    with pytest.raises(PayloadError, match=type.name):
        codec.encode(type, short)


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


# --- what others may write -------------------------------------------------------------------------------


@every_type
def test_an_empty_message_is_an_empty_packet(type):
    expected = bytes(8) if type.framing is Framing.SINGLE else listed()
    assert codec.decode(type, b"") == expected


@every_type
@few
@given(data=st.data())
def test_a_broken_message_is_an_error_or_a_packet(type, data):
    message = bytearray(encoded(type, payload_of(type, data)))
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(message) - 1))
        message[at] = data.draw(st.integers(0, 255))
    cut = bytes(message[: data.draw(st.integers(0, len(message)))])
    try:
        payload = codec.decode(type, cut)
    except codec.WireError:
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecapWarning)
        assert isinstance(payload, bytes)


def test_more_records_than_a_packet_counts_are_refused():
    type = UE4.named("destroyed")
    one = codec.encode(type, listed(bytes(4)))
    with pytest.raises(codec.WireError, match="65536 records, a packet counts at most 65535"):
        codec.decode(type, codec.head(1, 0.0) + one * (MAX_COUNT + 1))


def test_a_number_beyond_its_field_is_refused():
    type = UE4.named("doors")
    message = message_of(type, listed(bytes(6)))
    message.doors[0].door = 300
    with pytest.raises(codec.WireError, match="doors"):
        codec.decode(type, message.SerializeToString())


def test_a_huge_message_is_not_parsed():
    with pytest.raises(codec.WireError, match="at most 8388608 bytes"):
        codec.parse("tail", TAIL_MESSAGE, bytes(9 << 20))


def test_a_message_of_records_without_content_is_an_error():
    spawned = UE4.named("spawned")
    message = codec.head(1, 0.0) + b"\x1a\x00" * 1000
    with pytest.raises(codec.WireError, match="1000 records in 2018 bytes, most of them without an id"):
        codec.decode(spawned, message)


def test_stretches_are_read_as_protobuf_reads_them():
    rows = [BlockedRow(1.5, 30.0, 7, "vehicle.ä", 1.0, -2.0, 0.5), BlockedRow(2.0, 31.0, 8, "", 0.0, 0.0, 0.0)]
    message = codec.head(5, 2.5) + codec.encode(STATIONARY, pack(STATIONARY, rows))
    other = codec.parse("stretches", "carla_recap.v1.Stretches", message)
    assert [(s.id, s.type_id, s.start, s.x) for s in other.stretches] == [(r.id, r.type_id, r.start, r.x) for r in rows]
    assert [BlockedRow(**row._asdict()) for row in codec.decode_records(STATIONARY, message)] == rows
    assert codec.decode_records(STATIONARY, codec.head(5, 2.5)) == []
    with pytest.raises(codec.WireError, match="not a carla_recap"):
        codec.decode_records(STATIONARY, message[:-1])


SPAWNED = [Spawn(id, 1, 1.0, type_id="vehicle.ä", attributes=attributes(role_name="hero")) for id in (1, 2)]


# The third and the fourth wire type are groups, which protobuf gave up in 2008; the last bytes would make NaNs.
NEW = st.integers(0, 255).filter(lambda byte: byte & 7 not in (3, 4, 7))


@given(st.sampled_from(["spawned", "doors", "light_states"]), st.integers(0, 200), st.lists(NEW, max_size=3).map(bytes))
@settings(max_examples=300)
def test_a_changed_message_is_read_as_protobuf_reads_it(name, index, new):
    type = UE4.named(name)
    payload = pack(type, SPAWNED) if name == "spawned" else listed(b"\1" * type.dtype.itemsize)
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


def test_a_number_without_an_end_costs_no_time():
    message = codec.head(1, 0.0) + b"\x1a" + b"\xff" * (1 << 20)
    with time_limit(), pytest.raises(codec.WireError):
        codec.decode(UE4.named("spawned"), message)


@pytest.mark.parametrize("count", [2, 1500])
def test_a_signalling_nan_keeps_its_bits(count):
    type = UE4.named("spawned")
    payload = bytearray(pack(type, SPAWNED[:1] * count))
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


def test_messages_of_one_structure_are_moved_together():
    type = UE4.named("walker_bones")
    payloads = np.stack([np.frombuffer(listed(WALKER), np.uint8)] * 3)
    payloads[1, 2], payloads[2, 30] = 9, 1  # an id, and a byte of a number
    bodies = codec.encode_rows(type, payloads)
    assert [body.tobytes() for body in bodies] == [codec.encode(type, payload.tobytes()) for payload in payloads]
    messages = np.stack([np.frombuffer(codec.head(n, 0.5) + bodies[n].tobytes(), np.uint8) for n in range(3)])
    assert (codec.decode_rows(type, messages) == payloads).all()
    other, text = payloads.copy(), payloads.tobytes().index(b"crl_hips")
    other[1, text] += 1
    assert codec.encode_rows(type, other) is None
    messages[1, messages[0].tobytes().index(b"crl_hips")] += 1
    assert codec.decode_rows(type, messages) is None
