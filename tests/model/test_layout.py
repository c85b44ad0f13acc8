"""Payloads of packets and the records in them."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carla_recap import RecordError
from carla_recap.model.layout import MAX_COUNT, PayloadError, check, pack, unpack
from carla_recap.model.records import UE4, UE5, Attribute, Bone, Bones, Physics, Spawn, WheelSet
from tests import strategies
from tests.samples import bone, listed, plain, spawn

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


@pytest.mark.parametrize(
    ("name", "payload", "record"),
    [
        (
            "spawned",
            listed(spawn(7, 1, "vehicle.a", role_name="hero")),
            Spawn(7, 1, 100, 200, 50, 0, 0, 90, 7, "vehicle.a", [Attribute(3, "role_name", "hero")]),
        ),
        (
            "walker_bones",
            listed(struct.pack("<I", 8) + listed(bone("hips", 1, 2, 3, 4, 5, 6))),
            Bones(8, [Bone("hips", 1, 2, 3, 4, 5, 6)]),
        ),
    ],
)
def test_records_are_read_and_written_as_the_format_has_them(name, payload, record):
    assert unpack(UE4.named(name), payload) == ([record], 0)
    assert pack(UE4.named(name), [record]) == payload


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


@pytest.mark.parametrize("name", ["transforms", "wheels"])
def test_more_records_than_a_packet_counts_are_refused(name):
    type = UE4.named(name)
    records = np.zeros(MAX_COUNT + 1, type.dtype) if type.fixed else [WheelSet(1, np.empty(0))] * (MAX_COUNT + 1)
    assert pack(type, records[1:])[:2] == b"\xff\xff"
    with pytest.raises(RecordError, match=f"{name}: 65536 records, but a packet counts at most 65535"):
        pack(type, records)


@pytest.mark.parametrize(
    "record",
    [
        Spawn(-1),
        Spawn(1 << 32),
        Spawn(1, kind=256),
        Spawn(1, x="far"),
        Spawn(1, x=1e300),
        Spawn(1, type_id=None),
        Spawn(1, type_id="x" * 0x10000),
        Spawn(1, type_id="\ud800"),
        Spawn(1, attributes=[("role_name", "hero")]),
        Spawn(1, attributes=[Attribute(3, "a", 5)]),
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


def test_a_packet_too_large_to_parse_is_an_error(monkeypatch):
    monkeypatch.setattr("carla_recap.model.layout.OBJECTS_LIMIT", 100)
    with pytest.raises(PayloadError, match="spawned: a packet of at most 100 bytes, this has 101"):
        unpack(UE4.named("spawned"), bytes(101))
    assert check(UE4.named("transforms"), bytes(101)) == 99
