"""Payloads of packets and the records in them."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carla_recap import RecordError
from carla_recap.model.layout import MAX_COUNT, Framing, PayloadError, check, pack, unpack
from carla_recap.model.records import UE4, UE5, Attribute, Bone, Bones, Physics, Spawn, WheelSet
from tests import strategies
from tests.samples import bone, listed, plain, spawn, text, transform

TYPES = [type for table in (UE4, UE5) for type in table if type.id > 1]
every_type = pytest.mark.parametrize("type", TYPES, ids=lambda t: t.name + "_wide" * t.wide)
few = settings(max_examples=settings.default.max_examples // 6)  # of each type


@every_type
@few
@given(data=st.data())
def test_a_payload_comes_back(type, data):
    payload = data.draw(strategies.payloads(type, UE5 if type.wide else UE4))
    records, extra = unpack(type, payload)
    assert check(type, payload) == extra
    if not type.opaque:
        packed = pack(type, records)
        assert len(packed) == len(payload) - extra
        # Python's floats lose some bits of a NaN in objects; arrays keep them all.
        assert packed == payload[: len(packed)] or not type.fixed
        assert plain(unpack(type, packed)[0]) == plain(records)


@every_type
@few
@given(data=st.binary(max_size=80))
def test_any_bytes_are_records_or_an_error(type, data):
    try:
        records, extra = unpack(type, data)
    except PayloadError as error:
        assert 0 <= error.offset <= len(data)  # noqa: PT017
        with pytest.raises(PayloadError):
            check(type, data)
    else:
        assert extra == check(type, data) >= 0
        assert len(records) <= MAX_COUNT


def test_records_are_read_as_the_format_has_them():
    records, extra = unpack(UE4.named("transforms"), listed(transform(7, 1, 2, 3, 90)))
    assert (records.tolist(), extra) == ([(7, 1.0, 2.0, 3.0, 0.0, 0.0, 90.0)], 0)


def test_a_spawn_is_read_as_the_format_has_it():
    records, _ = unpack(UE4.named("spawned"), listed(spawn(7, 1, "vehicle.a", role_name="hero")))
    expected = Spawn(7, 1, 100, 200, 50, 0, 0, 90, 7, "vehicle.a", [Attribute(3, "role_name", "hero")])
    assert records == [expected]
    assert pack(UE4.named("spawned"), [expected]) == listed(spawn(7, 1, "vehicle.a", role_name="hero"))


def test_bones_are_read_as_the_format_has_them():
    payload = listed(struct.pack("<I", 8) + listed(bone("hips", 1, 2, 3, 4, 5, 6)))
    records, _ = unpack(UE4.named("walker_bones"), payload)
    assert records == [Bones(8, [Bone("hips", 1, 2, 3, 4, 5, 6)])]
    assert pack(UE4.named("walker_bones"), records) == payload


def test_wheels_are_read_as_the_format_has_them():
    payload = listed(struct.pack("<IIBffBff", 7, 2, 0, 1.5, 90, 3, 0, 45), struct.pack("<II", 8, 0))
    first, second = unpack(UE4.named("wheels"), payload)[0]
    assert (first.id, first.wheels.tolist()) == (7, [(0, 1.5, 90.0), (3, 0.0, 45.0)])
    assert (second.id, len(second.wheels)) == (8, 0)


@pytest.mark.parametrize("count", [0, 1, 2, 4])
@pytest.mark.parametrize("size", [36, 48])
def test_the_layout_of_wheels_is_the_one_that_fits_the_size(size, count):
    physics = UE4.named("physics")
    numbers = [float(n) for n in range(size // 4 * count)]
    payload = listed(bytes(53) + bytes(12) + struct.pack(f"<I{len(numbers)}f", count, *numbers))
    ((record,), extra) = unpack(physics, payload)
    assert extra == 0
    assert isinstance(record, Physics)
    assert len(record.wheels) == count
    if count:
        assert ("lat_stiff_value" in record.wheels.dtype.names) == (size == 48)
        assert record.wheels["position_z"].tolist() == [size // 4 * (n + 1) - 1.0 for n in range(count)]
    assert pack(physics, [record]) == payload


@pytest.mark.parametrize("raw", [b"", b"\0", b"a\0b", b"\xff", b"\xed\xa0\x80", "Straße".encode(), b"x" * 0xFFFF])
def test_any_text_comes_back(raw):
    payload = listed(bytes(33) + text(raw) + listed())
    records, _ = unpack(UE4.named("spawned"), payload)
    assert records[0].type_id == raw.decode("utf-8", "surrogateescape")
    assert pack(UE4.named("spawned"), records) == payload


@pytest.mark.parametrize("name", ["transforms", "spawned", "destroyed", "wheels"])
def test_more_records_than_a_packet_counts_are_refused(name):
    type = UE4.named(name)
    for count in (MAX_COUNT, MAX_COUNT + 1):
        records = np.zeros(count, type.dtype) if type.fixed else [WheelSet(1, np.empty(0))] * count
        if name == "spawned":
            records = [Spawn(1, 1, 0, 0, 0, 0, 0, 0, 0, "")] * count
        if count == MAX_COUNT:
            assert pack(type, records)[:2] == b"\xff\xff"
        else:
            with pytest.raises(RecordError, match=f"{name}: 65536 records, but a packet counts at most 65535"):
                pack(type, records)


def a_spawn(**changes):
    fields = {"id": 1, "kind": 1, "uid": 0, "type_id": "a"} | dict.fromkeys(("x", "y", "z", "roll", "pitch", "yaw"), 0.0)
    return Spawn(**fields | changes)


@pytest.mark.parametrize(
    "record",
    [
        a_spawn(id=-1),
        a_spawn(id=1 << 32),
        a_spawn(kind=256),
        a_spawn(x="far"),
        a_spawn(x=1e300),
        a_spawn(type_id=None),
        a_spawn(type_id="x" * 0x10000),
        a_spawn(type_id="\ud800"),
        a_spawn(attributes=None),
        a_spawn(attributes=[("role_name", "hero")]),
        a_spawn(attributes=[Attribute(3, "a", 5)]),
        (1, 2, 3),
        None,
    ],
    ids=lambda record: repr(record)[:60],
)
def test_a_value_that_does_not_fit_is_refused(record):
    with pytest.raises(RecordError, match="spawned: ") as caught:
        pack(UE4.named("spawned"), [record])
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    "wheels",
    [[(0, 1.0, 2.0)], np.zeros((1, 3)), np.zeros(1, "u1,f8,f8"), None],
    ids=["rows", "numbers", "other types", "none"],
)
def test_an_array_of_another_kind_is_taken_or_refused(wheels):
    type = UE4.named("wheels")
    try:
        payload = pack(type, [WheelSet(7, wheels)])
    except RecordError as error:
        assert "wheels" in str(error)  # noqa: PT017
    else:
        ((found,), extra) = unpack(type, payload)
        assert (len(found.wheels), extra) == (1, 0)


def test_a_marker_has_no_payload():
    end = UE4.named("frame_end")
    assert end.framing is Framing.MARKER
    assert (pack(end, np.empty(0)), check(end, b""), check(end, b"ab")) == (b"", 0, 2)


def test_a_packet_too_large_to_parse_is_an_error(monkeypatch):
    monkeypatch.setattr("carla_recap.model.layout.OBJECTS_LIMIT", 100)
    with pytest.raises(PayloadError, match="spawned: a packet of at most 100 bytes, this has 101"):
        unpack(UE4.named("spawned"), bytes(101))
    assert check(UE4.named("transforms"), bytes(101)) == 99
