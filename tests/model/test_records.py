"""The table of record types."""

from __future__ import annotations

import math

import numpy as np
import pytest

from carla_recap import RecordError
from carla_recap.model.records import UE4, UE5, Attribute, Spawn, attributes


@pytest.mark.parametrize("table", [UE4, UE5])
def test_types_are_found_by_name(table):
    assert table.named("transforms") is table[6]
    with pytest.raises(RecordError, match="no record type 'wings'; there are frame, frame_end, spawned"):
        table.named("wings")


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


@pytest.mark.parametrize(
    ("values", "ids"),
    [([], []), ({}, []), ({"id": []}, []), ({"id": 7}, [7]), (np.array((7, *[0] * 6), TRANSFORMS.dtype), [7])],
    ids=str,
)
def test_there_may_be_no_record_or_one(values, ids):
    assert TRANSFORMS.records(values).tolist() == [(id, 0, 0, 0, 0, 0, 0) for id in ids]


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"id": 1, "wings": 2}, "transforms: there is no field 'wings'; the fields are id, x, y, z, roll, pitch, yaw"),
        ({"id": [1, math.nan]}, "transforms: id must be whole numbers within uint32"),
        ({"id": 1, "x": [1e39]}, "transforms: x must be numbers within float32"),
        (np.zeros(3), "transforms: expected rows of 7 numbers"),
        *(
            (values, "transforms: .*the fields are id")
            for values in ({"id": -1}, {"id": 1 << 32}, {"id": "a"}, {"id": [1, 2], "x": [1, 2, 3]}, [(1, 2)], [1], 5)
        ),
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
