"""Runs of frames, written at once, are what they are when they are written one by one."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.formats import create_writer
from carla_recap.formats.mcap import writer
from carla_recap.formats.mcap.rows import has_form
from carla_recap.frame import Block, Frame, Header, Packet, Run
from carla_recap.payload import EMPTY_LIST, pack
from carla_recap.records import FRAME_END, ORDER, UE4, Framing

HEADER = Header("Town01", 1_600_000_000)
END = Packet(FRAME_END, UE4[FRAME_END], b"")
TOLD = ("transforms", "light_states", "vehicle_controls", "visual_time")
FEW = 3_000  # bytes of a chunk


def block(name: str, frames: int, count: int, seed: int) -> Block:
    """Packets of a type, with any numbers that fit."""
    type = UE4.named(name)
    records = np.zeros((frames, count), type.dtype)
    random = np.random.default_rng(seed)
    for field in type.dtype.names or ():
        records[field] = random.integers(0, 2, records.shape)
    payloads = [bytes(pack(type, row)) for row in records]
    return Block(type, memoryview(b"".join(payloads)), len(payloads[0]), records)


def run(first: int, elapsed: list[float], count: int, offset: int = 0) -> Run:
    """Frames with as many records each, in which blocks and empty packets take turns."""
    blocks = {
        name: block(name, offset + len(elapsed), 1 if UE4.named(name).framing is Framing.SINGLE else count, first)
        for name in TOLD
    }
    empty = [UE4[id] for id in ORDER if UE4[id].always and UE4[id].name not in TOLD]
    blank = [Packet(type.id, type, EMPTY_LIST, type.records([])) for type in empty]
    indices = list(range(first, first + len(elapsed)))
    return Run(indices, elapsed, [0.05] * len(elapsed), [*blank, *blocks.values(), END], offset)


def written(runs: list[Run], *, at_once: bool) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "x.mcap"
        with create_writer(path, HEADER) as recording:
            for frames in runs:
                if at_once:
                    recording.write_run(frames)
                else:
                    for frame in frames:
                        recording.write(frame)
        return path.read_bytes()


@st.composite
def recordings(draw: st.DrawFn) -> list[Run]:
    """Runs one after the other; the clock may stand still, or jump."""
    runs, index, now = list[Run](), 0, 0.0
    for _ in range(draw(st.integers(1, 4))):
        steps = draw(st.lists(st.sampled_from((0.05, 0.05, 0.0, 2.0, -1.0)), min_size=1, max_size=30))
        elapsed = [now := now + step for step in steps]
        runs.append(run(index, elapsed, draw(st.integers(1, 5)), draw(st.integers(0, 3))))
        index += len(elapsed)
    return runs


@given(recordings())
def test_a_run_is_its_frames(runs: list[Run]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writer, "CHUNK_SIZE", FEW)
        patch.setattr(writer, "CHUNK_FRAMES", 17)
        assert all(map(has_form, runs))
        assert written(runs, at_once=True) == written(runs, at_once=False)


def test_numbers_of_another_size_are_written_all_the_same() -> None:
    frames = run(0, [0.05, 0.1], 2)
    (controls,) = (
        packet for packet in frames.packets if isinstance(packet, Block) and packet.type.name == "vehicle_controls"
    )
    controls.records["hand_brake"].view(np.uint8)[:] = 0xFF
    payloads = b"".join(bytes(pack(controls.type, row)) for row in controls.records)
    frames.packets[frames.packets.index(controls)] = Block(
        controls.type, memoryview(payloads), controls.size, controls.records
    )
    assert not has_form(frames)
    assert written([frames], at_once=True) == written([frames], at_once=False)


def test_frames_of_a_run_are_frames() -> None:
    frames = list(run(7, [0.05, 0.1], 3, offset=2))
    assert [(frame.index, frame.id, frame.elapsed) for frame in frames] == [(7, 8, 0.05), (8, 9, 0.1)]
    assert all(isinstance(frame, Frame) and len(frame["transforms"]) == 3 for frame in frames)
    assert frames[0].packets[-1] is END
