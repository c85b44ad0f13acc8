"""Tables of motion: which frames they have, and which poses and velocities count."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.errors import RecapWarning
from carla_recap.formats.base import Reader
from carla_recap.model.batch import Batch
from carla_recap.model.frame import Frame
from carla_recap.model.lives import ActorLife
from carla_recap.model.motion import MOTION
from carla_recap.model.presence import FAR
from carla_recap.model.records import Spawn
from carla_recap.queries.measures import motion_table
from carla_recap.queries.measures.motion_table import MotionCollector, MotionTable
from carla_recap.queries.recorded_actors import actors
from tests.queries.measures.conftest import Drive, Mover, straight


def tables_of(reader: Reader, **margins: float) -> list[MotionTable]:
    collector = MotionCollector(actors(reader), **margins)
    tables = [table for batch in reader.batches(MOTION) for table in collector.add(batch)]
    return [*tables, *collector.finish()]


def frames_of(table: MotionTable, time: np.ndarray) -> range:
    """Return the numbers of the frames that a table is for."""
    first = int(np.searchsorted(time, table.time[table.first] - 1e-6))
    return range(first, first + table.last - table.first)


@pytest.mark.parametrize(("before", "after"), [(1.0, 1.0), (0.0, 8.0), (10.0, 1.0)])
@pytest.mark.parametrize("size", [100, 128])
def test_tables_follow_each_other_and_have_the_time_before_and_after(
    drive: Drive, monkeypatch: pytest.MonkeyPatch, size: int, before: float, after: float
) -> None:
    monkeypatch.setattr(motion_table, "_FRAMES", size)
    reader = drive([straight(1, 0, 0, 10)], seconds=30, rate=8)
    tables = tables_of(reader, before=before, after=after)
    time = np.array([frame.elapsed for frame in reader.frames(("transforms",)) if not frame.preamble])
    frames = [frames_of(table, time) for table in tables]
    assert [len(each) for each in frames[:-1]] == [size] * (len(frames) - 1)
    assert [number for each in frames for number in each] == list(range(len(time)))
    for table, each in zip(tables, frames, strict=True):
        assert table.time[0] <= max(time[each.start] - before, 0) + 1e-6
        assert table.time[-1] >= min(time[each.stop - 1] + after, time[-1]) - 1e-6
        assert table.x[0] == pytest.approx(10 * table.time, abs=1e-3)
        assert all(values.dtype == np.float64 for values in (table.x, table.y, table.z, table.yaw, table.vx, table.vy))


@pytest.mark.parametrize(("actors", "rate", "seconds", "values"), [(8, 10, 10, 400), (2, 1, 200, 1600)])
def test_a_table_has_no_more_than_fits(
    drive: Drive, monkeypatch: pytest.MonkeyPatch, actors: int, rate: int, seconds: int, values: int
) -> None:
    """Of 8 actors, 400 poses are 50 frames; of 2 actors, 1,600 moments are 40 s at 20 Hz, however few frames these have."""
    monkeypatch.setattr(motion_table, "_VALUES", values)
    tables = tables_of(drive([straight(id + 1, 0, 10 * id, 10) for id in range(actors)], seconds=seconds, rate=rate))
    time = np.arange(seconds * rate + 1) / rate
    assert [number for table in tables for number in frames_of(table, time)] == list(range(len(time)))
    for table in tables:
        assert (table.last - table.first) * actors <= values
        assert table.time[-1] - table.time[0] <= 40
        assert np.isfinite(table.x).all()


@pytest.mark.parametrize("early", [False, True])
def test_margins_have_a_limited_number_of_frames(monkeypatch: pytest.MonkeyPatch, early: bool) -> None:
    """However little time passes, or if all times but the first are before that one."""
    monkeypatch.setattr(motion_table, "_MAX_MARGIN", 64)
    monkeypatch.setattr(motion_table, "_FRAMES", 32)
    collector = MotionCollector([ActorLife(1, "vehicle.a", "vehicle", "", 0.0, spawn=Spawn(1))])
    tables: list[MotionTable] = []
    times = [1e9 if early and number == 1 else number * (0.05 if early else 1e-6) for number in range(1000)]
    frames = [Frame(n, n + 1, time, 0.0, []).replace(transforms=[(1, *6 * [0.0])]) for n, time in enumerate(times)]
    with pytest.warns(RecapWarning, match="of what is before and after"):
        tables += [table for frame in frames for table in collector.add(Batch.of(frame))]
    tables += collector.finish()
    assert sum(table.last - table.first for table in tables) == 1000
    assert max(len(table.time) for table in tables) <= 64 + 64 + 64


@pytest.mark.parametrize("yaw", [0.0, 30.0, 100.0, 200.0, 300.0])
def test_a_location_is_as_recorded_whatever_the_offset_of_the_box(drive: Drive, yaw: float) -> None:
    (table,) = tables_of(drive([straight(1, 7, -4, 3, yaw=yaw, offset=(1.0, 0.5), z=2.0)], seconds=1))
    cos, sin = np.cos(np.deg2rad(yaw)), np.sin(np.deg2rad(yaw))
    assert table.location(0, 20) == pytest.approx((7 + 3 * cos, -4 + 3 * sin, 2), abs=1e-4)
    assert (table.x[0, 20], table.y[0, 20], table.z[0, 20]) == pytest.approx(
        (7 + 4 * cos - 0.5 * sin, -4 + 4 * sin + 0.5 * cos, 2.75), abs=1e-4
    )
    assert (table.vx[0, 20], table.vy[0, 20]) == pytest.approx((3 * cos, 3 * sin), abs=1e-4)


@pytest.mark.parametrize(("far", "counts"), [(-0.999 * FAR, True), (0.999 * FAR, True), (FAR, False), (-FAR, False)])
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_pose_farther_out_than_any_place_does_not_count(drive: Drive, axis: str, far: float, counts: bool) -> None:
    given = {axis: far if axis == "z" else lambda _: far}
    (table,) = tables_of(drive([Mover(1, **given)], seconds=0.5))
    assert np.isfinite([table.x, table.y, table.z, table.yaw, table.vx]).all() == counts
    assert np.isfinite([table.x, table.y, table.z, table.yaw, table.vx]).any() == counts


def test_an_actor_that_jumps_does_not_count_for_half_a_second_before_and_after(drive: Drive) -> None:
    (table,) = tables_of(drive([Mover(1, lambda t: 0.0 if t < 2.975 else 50.0)], seconds=6, rate=20))
    absent = np.flatnonzero(np.isnan(table.x[0]))
    assert absent.tolist() == list(range(50, 70))  # the jump is from frame 59 to 60; 0.5 s are ten frames
    assert np.isnan(table.vx[0, absent]).all()


@pytest.mark.parametrize(
    ("given", "size"),
    [
        ({"type_id": "vehicle.no.such"}, (4.5, 1.9, 1.5)),
        ({"type_id": "vehicle.no.such", "other": {"number_of_wheels": "2"}}, (2.0, 0.8, 1.6)),
        ({"type_id": "walker.no.such", "kind": 2}, (0.5, 0.5, 1.8)),
    ],
)
def test_an_unknown_actor_has_the_size_of_its_kind(drive: Drive, given: dict, size: tuple) -> None:
    (table,) = tables_of(drive([Mover(1, size=None, **given)], seconds=0.5))
    assert (table.length[0], table.width[0], table.height[0]) == pytest.approx(size)
    assert table.z[0, 0] == pytest.approx(0.0 if given.get("kind") == 2 else size[2] / 2, abs=1e-3)
