"""Blocks of motion: which frames they have, and which poses and velocities count."""

from __future__ import annotations

from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from carla_recap.formats import open_reader
from carla_recap.model.lives import ActorLives
from carla_recap.model.presence import FAR
from carla_recap.queries.measures import motion_blocks
from carla_recap.queries.measures.motion_blocks import TYPES, MotionCollector
from carla_recap.queries.recorded_actors import actors
from tests.queries.measures.conftest import Mover, straight

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader
    from carla_recap.queries.measures.motion_blocks import MotionBlock
    from tests.queries.measures.conftest import Drive


def blocks_of(reader: Reader) -> list[MotionBlock]:
    collector = MotionCollector(ActorLives(actors(reader)))
    blocks = [block for batch in reader.batches(TYPES) for block in collector.add(batch)]
    return [*blocks, *collector.finish()]


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
@pytest.mark.parametrize("size", [100, 128, 1024])
def test_blocks_follow_each_other_and_have_three_seconds_before_and_after(
    drive: Drive, monkeypatch: pytest.MonkeyPatch, suffix: str, size: int
) -> None:
    monkeypatch.setattr(motion_blocks, "_FRAMES", size)
    reader = drive([straight(1, 0, 0, 10)], seconds=30, rate=8, suffix=suffix)
    blocks = blocks_of(reader)
    time = np.array([frame.elapsed for frame in reader.frames(("transforms",)) if not frame.preamble])
    spans = [(block.index + block.first, block.index + block.last) for block in blocks]
    assert [stop - start for start, stop in spans[:-1]] == [size] * (len(time) // size)
    assert (spans[0][0], spans[-1][1]) == (0, len(time))
    assert all(one[1] == other[0] for one, other in pairwise(spans))
    for block, (start, stop) in zip(blocks, spans, strict=True):
        first, last = block.index, block.index + len(block.time)
        assert block.time == pytest.approx(time[first:last])
        assert (first, last) == (max(start - 25, 0), min(stop + 25, len(time)))  # 3 s are 25 frames with both ends
        assert block.x[0] == pytest.approx(10 * block.time, abs=1e-3)


def test_a_block_has_no_more_poses_than_fit(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 8 actors, 400 poses are 50 frames, of which at least one is not in a margin."""
    monkeypatch.setattr(motion_blocks, "_VALUES", 400)
    reader = drive([straight(id, 0, 10 * id, 10) for id in range(1, 9)], seconds=10, rate=10)
    blocks = blocks_of(reader)
    spans = [(block.index + block.first, block.index + block.last) for block in blocks]
    assert [start for start, _ in spans[1:]] == [stop for _, stop in spans[:-1]]
    assert (spans[0][0], spans[-1][1]) == (0, 101)
    for block in blocks:
        assert block.x.size <= 400 or block.last - block.first == 1
        assert np.isfinite(block.x).all()


@pytest.mark.parametrize("yaw", [0.0, 30.0, 100.0, 200.0, 300.0])
def test_a_location_is_as_recorded_whatever_the_offset_of_the_box(drive: Drive, yaw: float) -> None:
    (block,) = blocks_of(drive([straight(1, 7, -4, 3, yaw=yaw, offset=(1.0, 0.5), z=2.0)], seconds=1))
    cos, sin = np.cos(np.deg2rad(yaw)), np.sin(np.deg2rad(yaw))
    assert block.location(0, 20) == pytest.approx((7 + 3 * cos, -4 + 3 * sin, 2), abs=1e-4)
    assert (block.x[0, 20], block.y[0, 20], block.z[0, 20]) == pytest.approx(
        (7 + 4 * cos - 0.5 * sin, -4 + 4 * sin + 0.5 * cos, 2.75), abs=1e-4
    )
    assert (block.vx[0, 20], block.vy[0, 20]) == pytest.approx((3 * cos, 3 * sin), abs=1e-4)


@pytest.mark.parametrize(("far", "counts"), [(-0.999 * FAR, True), (0.999 * FAR, True), (FAR, False), (-FAR, False)])
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_pose_farther_out_than_any_place_does_not_count(drive: Drive, axis: str, far: float, counts: bool) -> None:
    given = {axis: far if axis == "z" else lambda _: far}
    (block,) = blocks_of(drive([Mover(1, **given)], seconds=0.5))
    assert np.isfinite([block.x, block.y, block.z, block.yaw, block.vx]).all() == counts
    assert np.isfinite([block.x, block.y, block.z, block.yaw, block.vx]).any() == counts


def test_an_actor_that_jumps_does_not_count_for_half_a_second_before_and_after(drive: Drive) -> None:
    (block,) = blocks_of(drive([Mover(1, lambda t: 0.0 if t < 2.975 else 50.0)], seconds=6, rate=20))
    absent = np.flatnonzero(np.isnan(block.x[0]))
    assert absent.tolist() == list(range(50, 70))  # the jump is from frame 59 to 60; 0.5 s are ten frames
    assert np.isnan(block.vx[0, absent]).all()


def test_a_velocity_that_no_actor_has_is_replaced_by_the_slope_of_the_positions(drive: Drive) -> None:
    fast = {
        10: {"velocities": [(1, 150.0, 0.0, 0.0, 0.0, 0.0, 0.0)]},
        12: {"velocities": [(1, 149.0, 0.0, 0.0, 0.0, 0.0, 0.0)]},
    }
    (block,) = blocks_of(drive([Mover(1, lambda t: 5 * t * t)], seconds=1, events=fast))
    assert block.vx[0, 10] == pytest.approx(10 * 0.5, abs=1e-3)
    assert block.vx[0, 12] == pytest.approx(149.0, abs=1e-3)


def test_the_first_and_last_velocity_are_those_of_their_only_step(drive: Drive) -> None:
    (block,) = blocks_of(drive([Mover(1, lambda t: 5 * t * t, lambda t: -3 * t, has_velocity=False)], seconds=1))
    assert block.vx[0, [0, 1, 10, 20]] == pytest.approx([0.25, 0.5, 5.0, 9.75], abs=2e-3)
    assert block.vy[0] == pytest.approx(-3, abs=2e-3)


def test_a_step_of_more_than_a_second_gives_no_velocity(drive: Drive) -> None:
    for rate, known in ((1.0, True), (0.9, False)):
        (block,) = blocks_of(drive([Mover(1, lambda t: 5 * t, has_velocity=False)], seconds=10, rate=rate))
        assert np.isfinite(block.vx).all() == np.isfinite(block.vx).any() == known
        assert np.isfinite(block.x).all()


@pytest.mark.parametrize(
    ("given", "size"),
    [
        ({"type_id": "vehicle.no.such"}, (4.5, 1.9, 1.5)),
        ({"type_id": "vehicle.no.such", "other": {"number_of_wheels": "2"}}, (2.0, 0.8, 1.6)),
        ({"type_id": "walker.no.such", "kind": 2}, (0.5, 0.5, 1.8)),
    ],
)
def test_an_unknown_actor_has_the_size_of_its_kind(drive: Drive, given: dict, size: tuple) -> None:
    (block,) = blocks_of(drive([Mover(1, size=None, **given)], seconds=0.5))
    assert (block.length[0], block.width[0], block.height[0]) == pytest.approx(size)
    assert block.z[0, 0] == pytest.approx(0.0 if given.get("kind") == 2 else size[2] / 2, abs=1e-3)


def test_signalling_nan_is_unknown_without_a_warning(drive: Drive) -> None:
    reader = drive([Mover(1, lambda t: 123.75 if t == 1 else t)], seconds=2, suffix=".log")
    path = Path(reader.path)
    path.write_bytes(path.read_bytes().replace(np.float32(12375).tobytes(), np.uint32(0x7F800001).tobytes()))
    with closing(open_reader(path)) as damaged:
        (block,) = blocks_of(damaged)
    assert np.flatnonzero(np.isnan(block.x[0])).tolist() == [20]
