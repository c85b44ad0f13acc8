"""Recordings to ask: CARLA's own, and hand-made ones; each as a log and as MCAP."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from carla_recap.editing.convert import convert
from carla_recap.formats import create_writer, open_reader
from carla_recap.formats.base import Reader
from carla_recap.model.frame import LAST_FRAME_DURATION, Frame, Header, Packet
from carla_recap.model.records import FRAME_END

Records = Mapping[str, Any]
Make = Callable[..., Reader]

TICK = 0.5
HEADER = Header("Town01", 1_600_000_000)


@pytest.fixture(autouse=True)
def utc(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Dates are printed in local time."""
    with monkeypatch.context() as patch:
        patch.setenv("TZ", "UTC")
        time.tzset()
        yield
    time.tzset()


@pytest.fixture(params=[".log", ".mcap"])
def suffix(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def opened() -> Iterator[Callable[[Path], Reader]]:
    """Opens recordings; they are closed after the test."""
    readers: list[Reader] = []

    def open_one(path: Path) -> Reader:
        readers.append(open_reader(path))
        return readers[-1]

    yield open_one
    for reader in readers:
        reader.close()


@pytest.fixture(scope="session")
def converted(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path, str], Path]:
    """A log in the format of a suffix."""
    directory = tmp_path_factory.mktemp("converted")

    def path_of(log: Path, suffix: str) -> Path:
        path = log if log.suffix == suffix else directory / f"{log.stem}{suffix}"
        if not path.exists():
            convert(log, path)
        return path

    return path_of


@pytest.fixture
def make(tmp_path: Path, suffix: str, opened: Callable[[Path], Reader]) -> Make:
    """Write a recording frame by frame, and open it: `make({"transforms": [...]}, ...)`."""

    def make(*frames: Records | Sequence[Records], **options: Any) -> Reader:
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}{suffix}"
        return opened(write(path, frames, **options))

    return make


def write(
    path: Path,
    frames: Sequence[Records | Sequence[Records]],
    *,
    header: Header = HEADER,
    durations: Sequence[float] | None = None,
    preamble: bool = False,
) -> Path:
    """Write a recording: each frame is records (or a payload) by type, or several such mappings, in the order of packets.

    Without durations, frames have `TICK` seconds, the last one as CARLA leaves it. With a preamble, the first one holds
    packets before any frame.
    """
    if durations is None:
        durations = [*[TICK] * (len(frames) - 1), LAST_FRAME_DURATION][: len(frames)]
    end = Packet(FRAME_END, header.table[FRAME_END], b"")
    elapsed = 0.0
    with create_writer(path, header) as writer:
        for index, (frame, duration) in enumerate(zip(frames, durations, strict=True)):
            parts = [frame] if isinstance(frame, dict) else frame
            packets = [packet(header, *item) for part in parts for item in part.items()]
            if preamble and index == 0:
                writer.write(Frame(index, 0, 0.0, 0.0, packets, preamble=True))
            else:
                writer.write(Frame(index, index + 1 - preamble, elapsed, duration, [*packets, end]))
                elapsed += duration
    return path


def packet(header: Header, name: str, values: Any) -> Packet:
    """A packet of some records, or with a payload."""
    type = header.table.named(name)
    if isinstance(values, bytes):
        return Packet(type.id, type, values)
    return Packet(type.id, type, None, type.records(values))
