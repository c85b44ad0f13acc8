"""Batches: parts of them, and records of several packets."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.model.batch import Batch
from carla_recap.model.frame import Frame, Packet
from carla_recap.model.records import UE4


def frame(*packets: list[tuple[float, ...]]) -> Frame:
    type = UE4.named("transforms")
    return Frame(3, 4, 1.5, 0.05, [Packet(type.id, type, records=type.records(rows)) for rows in packets])


def pose(id: int, x: float) -> tuple[float, ...]:
    return (id, x, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("parts", [1, 2, 3])
def test_records_of_several_packets_follow_each_other(parts: int) -> None:
    batch = Batch.of(frame(*([pose(number, 10.0 * number)] for number in range(parts))))
    records = batch.records("transforms")
    assert records.shape == (1, parts)
    assert records["id"].tolist() == [list(range(parts))]
    assert records["x"].tolist() == [[10.0 * number for number in range(parts)]]
    assert not records.flags.writeable


def test_records_of_a_type_without_packets_are_none() -> None:
    assert Batch.of(frame()).records("velocities").shape == (1, 0)
    assert Batch.of(frame()).records("transforms").dtype == UE4.named("transforms").dtype


def test_records_are_not_copied() -> None:
    batch = Batch.of(frame([pose(1, 10.0)]))
    assert np.shares_memory(batch.records("transforms"), batch.records("transforms"))
