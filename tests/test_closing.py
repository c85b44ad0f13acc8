"""Closed readers, writers and recordings raise `Closed`; arrays that were read are read-only."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carla_recap import RecapError, Recording, convert, create_writer, open_recording
from carla_recap.formats import open_reader
from carla_recap.formats.base import Reader, Writer
from carla_recap.model.frame import Frame, Header
from tests.samples import drive, write

CLOSED = r"drive\.(log|mcap): .*closed"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("closing") / "drive.log", Header("Town01", 0), drive())


@pytest.fixture(params=[".log", ".mcap"])
def path(request: pytest.FixtureRequest, recorded: Path) -> Path:
    path = recorded.with_suffix(request.param)
    if not path.exists():
        convert(recorded, path)
    return path


ITERATORS: dict[str, Callable[[Reader], Any]] = {
    "frames": lambda reader: reader.frames(),
    "some types": lambda reader: reader.frames(("transforms",)),
    "sparse": lambda reader: reader.frames(("transforms",), sparse=True),
    "window": lambda reader: reader.frames(start=1, stop=29),
    "batches": lambda reader: reader.batches(),
    "recording": lambda reader: iter(Recording(reader)),
}


@pytest.mark.parametrize("name", ITERATORS)
@pytest.mark.parametrize("read", [0, 5, 300])
def test_an_iterator_of_a_closed_reader(path: Path, name: str, read: int) -> None:
    reader = open_reader(path)
    frames = ITERATORS[name](reader)
    for _ in range(min(read, 5) if name == "batches" else read):
        next(frames)
    reader.close()
    with pytest.raises(RecapError, match=CLOSED):
        next(frames)


def test_a_closed_recording(path: Path) -> None:
    with open_recording(path) as recording:
        pass
    for use in (lambda: recording.trajectory(1), lambda: iter(recording), recording.frames):
        with pytest.raises(RecapError, match=CLOSED):
            use()


@pytest.mark.parametrize("use", [lambda r: r.frame_at(1.0), lambda r: list(r.tail())], ids=["frame_at", "tail"])
@pytest.mark.parametrize("before", [True, False])
def test_a_closed_reader(path: Path, use: Callable[[Reader], Any], before: bool) -> None:
    reader = open_reader(path)
    if before:
        use(reader)
    reader.close()
    reader.close()
    with pytest.raises(RecapError, match=CLOSED):
        use(reader)


def test_arrays_outlive_the_reader(path: Path) -> None:
    reader = open_reader(path)
    frame = next(reader.frames())
    records = frame["transforms"]
    before = records.tolist()
    reader.close()
    assert records.tolist() == before


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
@pytest.mark.parametrize("end", ["close", "abort", "abandon"])
def test_a_closed_writer(tmp_path: Path, suffix: str, end: str) -> None:
    writer: Writer = create_writer(tmp_path / f"drive{suffix}", Header("Town01", 0))
    writer.write(Frame(0, 1, 0.0, 0.5, []))
    getattr(writer, end)()
    for use in (lambda: writer.write(Frame(1, 2, 0.5, -1.0, [])), lambda: writer.write_tail(b"x")):
        with pytest.raises(RecapError, match=CLOSED):
            use()
    getattr(writer, end)()


def test_arrays_are_read_only(path: Path) -> None:
    with open_recording(path) as recording:
        for frame in recording:
            for packet in frame.packets:
                records = packet.records
                assert not isinstance(records, np.ndarray) or not records.size or not records.flags.writeable
            with pytest.raises(ValueError, match="read-only"):
                frame["transforms"]["x"] = 1.0
