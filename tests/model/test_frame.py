"""Frames and packets."""

from __future__ import annotations

import pickle
import struct
import warnings
from pathlib import Path

import pytest

from carla_recap import FormatError, MissingExtra, RecapWarning, RecordError, Spawn
from carla_recap.formats.mcap.schema import DIGEST
from carla_recap.model.frame import Frame, Packet
from carla_recap.model.records import UE4, UE5, Physics
from tests.samples import listed, transform


def packet_of(name, *records, table=UE4):
    type = table.named(name)
    return Packet(type.id, type, listed(*records))


def test_records_of_all_packets_of_a_type_are_given():
    spawned = [Packet(2, UE4[2], records=[Spawn(n)]) for n in (1, 2)]
    moved = [packet_of("transforms", *map(transform, ids)) for ids in ((1, 2), (3,))]
    frame = Frame(3, 4, 0.15, 0.05, [*spawned, *moved, packet_of("collisions"), Packet(150, None, b"unknown")])
    assert frame["transforms"]["id"].tolist() == [1, 2, 3]
    assert [spawn.id for spawn in frame["spawned"]] == [1, 2]
    assert [(name, len(records)) for name, records in frame.items()] == [("spawned", 2), ("transforms", 3)]
    assert frame["velocities"].dtype == UE4.named("velocities").dtype
    assert (len(frame["velocities"]), len(frame["collisions"]), frame["physics"]) == (0, 0, [])


def test_a_packet_of_records_packs_them():
    packet = Packet(3, UE4[3], records=UE4[3].records({"id": [1, 2]}))
    assert packet.payload == listed(struct.pack("<I", 1), struct.pack("<I", 2))


def test_an_unknown_packet_has_no_records():
    assert Packet(150, None, b"x").records == []
    assert len(Packet(15, UE5[15], b"\1\0x").records) == 0


def test_a_packet_that_contradicts_its_type_names_its_offset():
    packet = Packet(3, UE4[3], b"\2\0\0", origin=(Path("a.log"), 100))
    with pytest.raises(FormatError, match=r"^a\.log: byte 102: destroyed: 2 records need 10 bytes"):
        _ = packet.records


def test_surplus_bytes_are_warned_of():
    packet = Packet(3, UE4[3], b"\0\0abc", origin=(Path("a.log"), 100))
    with pytest.warns(RecapWarning, match=r"^a\.log: byte 100: destroyed has 3 bytes more"):
        assert len(packet.records) == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(packet.records) == 0  # parsed once


@pytest.mark.parametrize("error", [FormatError("a.log", 5, "broken"), MissingExtra("to_pandas()", "pandas")], ids=str)
def test_errors_travel_between_processes(error):
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), vars(again)) == (type(error), str(error), vars(error))


@pytest.mark.parametrize("type", [*UE4, *UE5, *DIGEST], ids=lambda type: type.name + "_wide" * type.wide)
def test_record_types_are_the_same_in_other_processes(type):
    assert pickle.loads(pickle.dumps(type)) is type


def test_records_can_be_replaced():
    ends, transforms, spawns = UE4[1], UE4.named("transforms"), UE4.named("spawned")
    packets = [
        Packet(2, spawns, records=[]),
        Packet(6, transforms, records=transforms.records([(7, 0, 0, 0, 0, 0, 0)])),
        Packet(1, ends, b""),
    ]
    frame = Frame(3, 4, 1.5, 0.5, packets)
    other = frame.replace(transforms={"id": [8], "x": [2.0]}, collisions=[(1, 7, 8, 0, 0)])
    assert [packet.id for packet in other.packets] == [2, 5, 6, 1]
    assert other["transforms"]["id"].tolist() == [8]
    assert (other.index, other.id, other.elapsed, other.duration) == (3, 4, 1.5, 0.5)
    assert frame["transforms"]["id"].tolist() == [7]
    timed = other.replace(platform_time=1.5)
    assert [packet.id for packet in timed.packets] == [2, 5, 6, 14, 1]
    assert [packet.id for packet in timed.replace(platform_time=[]).packets] == [2, 5, 6, 1]


def test_physics_of_ue5_cannot_be_replaced():
    frame = Frame(0, 1, 0.0, -1.0, [packet_of("transforms", table=UE5)])
    physics = Physics(7, *[1.0] * 5, 1, 1.0, 1.0, 1500.0, 0.3, *[0.0] * 3, [], [], [], [])
    with pytest.raises(RecordError, match="physics: records of UE5 builds are kept as bytes"):
        frame.replace(physics=[physics])
    assert frame.replace(physics=[]).packets[1].payload == listed()
