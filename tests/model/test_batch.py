"""Batches: parts of them, and records of several packets."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.model.batch import Batch, packed
from carla_recap.model.frame import Frame, Packet
from carla_recap.model.records import UE4


def frame(*packets: list[tuple[float, ...]]) -> Frame:
    type = UE4.named("transforms")
    return Frame(3, 4, 1.5, 0.05, [Packet(type.id, type, records=type.records(rows)) for rows in packets])


def pose(id: int, x: float) -> tuple[float, ...]:
    return (id, x, 0.0, 0.0, 0.0, 0.0, 0.0)


def batch_of(parts: int) -> Batch:
    """Return three frames with packets of poses: of the actors 0, 1, …, one each, at 10 m times the frame."""
    type = UE4.named("transforms")
    columns = [packed(type, np.stack([type.records([pose(part, 10.0 * row)]) for row in range(3)])) for part in range(parts)]
    return Batch(0, np.arange(1, 4, dtype=np.uint64), np.arange(3.0), np.ones(3), columns)


@pytest.mark.parametrize("parts", [1, 2, 3])
def test_records_of_several_packets_follow_each_other(parts: int) -> None:
    for batch, rows in ((batch_of(parts), 3), (Batch.of(frame(*([pose(part, 0.0)] for part in range(parts)))), 1)):
        records = batch.records("transforms")
        assert records["id"].tolist() == [list(range(parts))] * rows
        assert records["x"].tolist() == [[10.0 * row] * parts for row in range(rows)]
        assert not records.flags.writeable


def test_records_of_a_type_without_packets_are_none() -> None:
    assert Batch.of(frame()).records("velocities").shape == (1, 0)
    assert Batch.of(frame()).records("transforms").dtype == UE4.named("transforms").dtype


def test_records_are_not_copied() -> None:
    batch = batch_of(1)
    assert np.shares_memory(batch.records("transforms"), batch.records("transforms"))
