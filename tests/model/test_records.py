"""The table of record types."""

from __future__ import annotations

import math

import numpy as np
import pytest

from carla_recap import RecordError
from carla_recap.model.records import ORDER, UE4, UE5, Attribute, Spawn, attributes


def test_every_packet_has_its_place_in_a_frame():
    assert sorted(ORDER) == list(range(2, 25))


@pytest.mark.parametrize("table", [UE4, UE5])
def test_types_are_found_by_name(table):
    assert table.named("transforms") is table[6]
    with pytest.raises(RecordError, match="no record type 'wings'; there are frame, frame_end, spawned"):
        table.named("wings")


def test_physics_of_ue5_are_opaque():
    assert [type.name for type in UE5 if type.opaque] == ["physics"]
    assert not any(type.opaque for type in UE4)


def test_an_attribute_of_a_spawn_is_found():
    hero = Spawn(1, 1, 0, 0, 0, 0, 0, 0, 0, "a", [Attribute(3, "role_name", "hero"), Attribute(0, "", "")])
    assert (hero.attribute("role_name"), hero.attribute(""), hero.attribute("colour")) == ("hero", "", None)


TRANSFORMS = UE4.named("transforms")


@pytest.mark.parametrize(
    "values",
    [
        {"id": [1, 2], "x": 5.0, "yaw": [0.0, 90.0]},
        {"id": np.array([1, 2]), "x": np.float64(5), "yaw": np.array([0, 90])},
        [(1, 5, 0, 0, 0, 0, 0), (2, 5, 0, 0, 0, 0, 90)],
        np.array([(1, 5, 0, 0, 0, 0, 0), (2, 5, 0, 0, 0, 0, 90)], UE4[6].dtype),
        np.array([(1, 5, 0, 0, 0, 0, 0), (2, 5, 0, 0, 0, 0, 90)], UE5[6].dtype),
        iter([(1, 5, 0, 0, 0, 0, 0), (2, 5, 0, 0, 0, 0, 90)]),
    ],
    ids=["columns", "arrays", "rows", "records", "wide records", "iterator"],
)
def test_records_are_made_of_what_there_is(values):
    records = TRANSFORMS.records(values)
    assert records.dtype == TRANSFORMS.dtype
    assert records.tolist() == [(1, 5.0, 0, 0, 0, 0, 0.0), (2, 5.0, 0, 0, 0, 0, 90.0)]


@pytest.mark.parametrize("values", [[], {}, np.empty(0, TRANSFORMS.dtype), {"id": []}], ids=str)
def test_nothing_makes_no_records(values):
    assert len(TRANSFORMS.records(values)) == 0


def test_one_record_is_a_record():
    assert TRANSFORMS.records({"id": 7}).tolist() == [(7, 0, 0, 0, 0, 0, 0)]
    assert TRANSFORMS.records(np.array((7, 0, 0, 0, 0, 0, 0), TRANSFORMS.dtype)).tolist() == [(7, 0, 0, 0, 0, 0, 0)]


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"id": 1, "wings": 2}, "transforms: there is no field 'wings'; the fields are id, x, y, z, roll, pitch, yaw"),
        ({"id": -1}, "transforms: .*the fields are id"),
        ({"id": 1 << 32}, "transforms: .*the fields are id"),
        ({"id": "a"}, "transforms: .*the fields are id"),
        ({"id": [1, math.nan]}, "transforms: id must be whole numbers within uint32"),
        ({"id": 1, "x": [1e39]}, "transforms: x must be numbers within float32"),
        ({"id": [1, 2], "x": [1, 2, 3]}, "transforms: .*the fields are id"),
        ([(1, 2)], "transforms: .*the fields are id"),
        ([1], "transforms: .*the fields are id"),
        (5, "transforms: .*the fields are id"),
        (np.zeros(3), "transforms: expected rows of 7 numbers"),
        (np.zeros(3, "u4,f4"), "transforms: .*the fields are id"),
    ],
    ids=str,
)
def test_what_makes_no_records_is_an_error(values, reason):
    with pytest.raises(RecordError, match=reason) as caught:
        TRANSFORMS.records(values)
    assert "\n" not in str(caught.value)


def test_objects_are_taken_as_they_are():
    spawns = UE4.named("spawned")
    one, two = Spawn(1), Spawn(2)
    assert spawns.records(iter([one, two])) == [one, two]
    for wrong in (5, [5], [{"id": 1}]):
        with pytest.raises(RecordError, match="spawned"):
            spawns.records(wrong)


def test_attributes_of_values_of_numpy() -> None:
    assert attributes(lanes=np.int64(2), open=np.True_) == [Attribute(1, "lanes", "2"), Attribute(0, "open", "true")]
    with pytest.raises(RecordError, match=r"'x': .*NoneType"):
        attributes(x=None)  # type: ignore[arg-type]
