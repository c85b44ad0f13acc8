"""Batches of frames, written at once, are what they are when they are written one by one."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.formats import create_writer
from carla_recap.formats.mcap import writer
from carla_recap.formats.mcap.writer import has_template
from carla_recap.model.batch import Batch, ConstantColumn, PackedColumn, packed
from carla_recap.model.frame import Header, Packet
from carla_recap.model.layout import EMPTY_LIST, Framing
from carla_recap.model.records import FRAME_END, ORDER, UE4

HEADER = Header("Town01", 1_600_000_000)
END = Packet(FRAME_END, UE4[FRAME_END], b"")
FILLED = ("transforms", "light_states", "vehicle_controls", "visual_time")
FEW = 3_000  # bytes of a chunk


def column(name: str, frames: int, count: int, seed: int) -> PackedColumn:
    """Packets of a type, with any numbers that fit."""
    type = UE4.named(name)
    records = np.zeros((frames, count), type.dtype)
    random = np.random.default_rng(seed)
    for field in type.dtype.names or ():
        records[field] = random.integers(0, 2, records.shape)
    return packed(type, records)


def batch(first: int, elapsed: list[float], count: int) -> Batch:
    """Frames with as many records each, in which packets with and without records take turns."""
    filled = [
        column(name, len(elapsed), 1 if UE4.named(name).framing is Framing.SINGLE else count, first) for name in FILLED
    ]
    bare = [UE4[id] for id in ORDER if UE4[id].always and UE4[id].name not in FILLED]
    empty = [ConstantColumn(Packet(type.id, type, EMPTY_LIST, type.records([])), len(elapsed)) for type in bare]
    ids = np.arange(first, first + len(elapsed), dtype=np.uint64) + np.uint64(1)
    durations = np.full(len(elapsed), 0.05)
    return Batch(first, ids, np.array(elapsed), durations, [*empty, *filled, ConstantColumn(END, len(elapsed))])


def written(batches: list[Batch], *, at_once: bool) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "x.mcap"
        with create_writer(path, HEADER) as recording:
            for frames in batches:
                if at_once:
                    recording.write_batch(frames)
                else:
                    for frame in frames:
                        recording.write(frame)
        return path.read_bytes()


@st.composite
def recordings(draw: st.DrawFn) -> list[Batch]:
    """Batches one after the other; the clock may stand still, or jump."""
    batches, index, now = list[Batch](), 0, 0.0
    for _ in range(draw(st.integers(1, 4))):
        steps = draw(st.lists(st.sampled_from((0.05, 0.05, 0.0, 2.0, -1.0)), min_size=2, max_size=30))
        elapsed = [now := now + step for step in steps]
        batches.append(batch(index, elapsed, draw(st.integers(1, 5))))
        index += len(elapsed)
    return batches


@given(recordings())
def test_a_batch_is_its_frames(batches: list[Batch]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writer, "CHUNK_SIZE", FEW)
        patch.setattr(writer, "CHUNK_FRAMES", 17)
        assert all(map(has_template, batches))
        assert written(batches, at_once=True) == written(batches, at_once=False)


def test_numbers_of_another_size_are_written_all_the_same() -> None:
    frames = batch(0, [0.05, 0.1], 2)
    (controls,) = (column for column in frames.columns if column.type and column.type.name == "vehicle_controls")
    records = controls.records.copy()
    records["hand_brake"] = 0xFF
    frames.columns = [packed(controls.type, records) if column is controls else column for column in frames.columns]
    assert not has_template(frames)
    assert written([frames], at_once=True) == written([frames], at_once=False)
