"""Recordings for tests, CARLA's own and small ones packed by hand, and functions that read them."""

from __future__ import annotations

import math
import struct
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.formats import create_writer, open_reader
from carla_recap.model.frame import Frame, Header, Packet
from carla_recap.model.records import UE4

ROOT = Path(__file__).parents[1]
"""The folder of the repository."""

SAMPLES = ROOT / "samples"
CRASH, CROSSING = SAMPLES / "crash.mcap", SAMPLES / "crossing.log"
CARLA_LOGS = ROOT.parent / "shared" / "data" / "carla-logs"
RANDOM_LOGS = CARLA_LOGS.with_name("random-logs")
DATE = 1_637_671_165


def carla_log(name: str) -> Path:
    """Return the path of a recording of CARLA; skip the test if it is missing."""
    path = CARLA_LOGS / name
    if not path.exists():
        pytest.skip(f"{path} is not here: it is data that is not part of the repository")
    return path


def text(value: str | bytes) -> bytes:
    data = value.encode() if isinstance(value, str) else value
    return struct.pack("<H", len(data)) + data


def log_header(map_name: str | bytes = "Town01", date: int = DATE, version: int = 1) -> bytes:
    return struct.pack("<H", version) + text("CARLA_RECORDER") + struct.pack("<q", date) + text(map_name)


def packet(id: int, payload: bytes = b"") -> bytes:
    return struct.pack("<BI", id, len(payload)) + payload


def listed(*records: bytes) -> bytes:
    return struct.pack("<H", len(records)) + b"".join(records)


def start(frame: int, elapsed: float, duration: float = -1.0) -> bytes:
    return packet(0, struct.pack("<Qdd", frame, duration, elapsed))


def transform(id: int, x: float = 0, y: float = 0, z: float = 0, yaw: float = 0) -> bytes:
    return struct.pack("<I6f", id, x, y, z, 0, 0, yaw)


def spawn(id: int, kind: int, blueprint: str | bytes, **attributes: str) -> bytes:
    pairs = [bytes((3,)) + text(key) + text(value) for key, value in attributes.items()]
    place = struct.pack("<IB6fI", id, kind, 100, 200, 50, 0, 0, 90, 7)
    return place + text(blueprint) + listed(*pairs)


def collision(sequence: int, actor1: int, actor2: int, hero1: int = 0, hero2: int = 0) -> bytes:
    return struct.pack("<IIIBB", sequence, actor1, actor2, hero1, hero2)


END = packet(1)


def bone(name: str, *pose: float) -> bytes:
    return text(name) + struct.pack("<6f", *pose)


def packet_payloads() -> list[tuple[int, bytes]]:
    """Return packets of every type, with records in all but one, in CARLA's order, and one of a fork of CARLA."""
    wheels = struct.pack("<I", 2) + b"".join(struct.pack("<Bff", n, 1.5, 90) for n in range(2))
    bones = listed(bone("crl_root", *range(6)), bone("crl_hips", *range(6)))
    curve = struct.pack("<I4f", 2, 0, 400, 5000, 500)
    gears = struct.pack("<I3f", 1, 4, 0.5, 0.65)
    physics = struct.pack("<I5fB7f", 7, 5000, 1, 0.2, 2, 0.4, 1, 10, 4, 1800, 0.3, 0.5, 0, -0.2)
    physics += curve + gears + curve + struct.pack("<I12f", 1, *range(12))
    weather = struct.pack("<14f", *range(14))
    hero = spawn(7, 1, "vehicle.tesla.model3", role_name="hero", color="255,0,0")
    return [
        (20, struct.pack("<d", 0.5)),
        (2, listed(hero, spawn(8, 2, "walker.pedestrian.0001"), spawn(9, 3, "traffic.traffic_light"))),
        (3, listed()),
        (4, listed(struct.pack("<II", 9, 7))),
        (5, listed(collision(1, 7, 8, 1, 0))),
        (23, listed(struct.pack("<IBB", 7, 0, 1))),
        (6, listed(transform(7, 100, 200, 50, 90), transform(8, 300, -200, 90))),
        (7, listed(struct.pack("<IBfb", 9, 0, 3.5, 2))),
        (8, listed(struct.pack("<IfffBi", 7, -0.5, 1, 0, 0, 3))),
        (9, listed(struct.pack("<If", 8, 140))),
        (10, listed(struct.pack("<II", 7, 9))),
        (11, listed(struct.pack("<i5fBB", -3, 10, 1, 0.5, 0.25, 1, 1, 2))),
        (21, listed(struct.pack("<I", 7) + wheels)),
        (22, listed(struct.pack("<Iff", 8, 500, 0.5))),
        (24, listed(weather)),
        (12, listed(struct.pack("<I6f", 7, 10, 1, 0, 0, 0, 45))),
        (13, listed(struct.pack("<I6f", 7, 0, 0, 75, 240, 100, 75))),
        (17, listed(struct.pack("<I6f", 9, 0, 0, 75, 240, 100, 75))),
        (14, struct.pack("<d", 123.25)),
        (15, listed(physics)),
        (16, listed(struct.pack("<I3f", 9, 10, 3, 2))),
        (19, listed(struct.pack("<I", 8) + bones)),
        (18, struct.pack("<Q", 77)),
        (201, b"a fork's own"),
    ]


def small_log() -> bytes:
    """Return four frames, a second apart; the first one has records of every type."""
    first = [start(1, 0.0, 1.0), *(packet(id, payload) for id, payload in packet_payloads()), END]
    quiet = [
        part
        for n in range(2, 5)
        for part in (
            start(n, n - 1.0, 1.0 if n < 4 else -1.0),
            packet(2, listed()),
            packet(3, listed(struct.pack("<I", 8)) if n == 4 else listed()),
            packet(5, listed(collision(n, 7, 0xFFFFFFFF, 1, 0)) if n == 3 else listed()),
            packet(6, listed(transform(7, 100 * n, 200, 50, 90))),
            END,
        )
    ]
    return b"".join([log_header(), *first, *quiet])


def drive(seconds: float = 30.0, rate: float = 20.0, size: int = 10) -> Iterator[Frame]:
    """Return the frames of a drive, with transforms in each and collisions in some."""
    transforms, collisions, end = UE4.named("transforms"), UE4.named("collisions"), UE4[1]
    for n in range(int(seconds * rate)):
        poses = listed(*(transform(id, n, id) for id in range(size)))
        packets = [Packet(6, transforms, poses), Packet(1, end, b"")]
        if n % 7 == 0:
            packets.insert(0, Packet(5, collisions, listed(collision(n, 1, 2))))
        yield Frame(n, n + 1, n / rate, 1 / rate, packets)


def write(path: Path, header: Header, frames: Iterable[Frame]) -> Path:
    with create_writer(path, header) as writer:
        for frame in frames:
            writer.write(frame)
    return path


def save(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def names_in(directory: Path) -> list[str]:
    """Return the names of all files and folders in a directory, hidden ones included."""
    return sorted(path.name for path in directory.iterdir())


@contextmanager
def warnings_ignored() -> Iterator[None]:
    """Ignore the warnings about truncated recordings and surplus bytes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecapWarning)
        yield


def double(value: float) -> bytes:
    """Return the bits of a number, so that a NaN equals itself."""
    return struct.pack("<d", value)


def image(frame: Frame) -> tuple[Any, ...]:
    """Return the number, times and packets of a frame, comparable by their bytes."""
    packets = [(packet.id, bytes(packet.payload)) for packet in frame.packets]
    return frame.index, frame.id, double(frame.elapsed), double(frame.duration), frame.preamble, packets


@contextmanager
def reading(path: Path) -> Iterator[Any]:
    """Open the reader of a recording, and close it afterwards."""
    reader = open_reader(path)
    try:
        yield reader
    finally:
        reader.close()


def images(path: Path) -> list[tuple[Any, ...]]:
    """Return all frames of a recording; see `image`."""
    with reading(path) as reader:
        return [image(frame) for frame in reader.frames()]


def all_records(path: Path) -> list[Any]:
    """Return the records of every packet of a recording; see `plain`."""
    with reading(path) as reader:
        return [plain(packet.records) for frame in reader.frames() for packet in frame.packets]


def plain(value: Any) -> Any:
    """Return records as tuples and numbers, in which all NaNs are equal."""
    if isinstance(value, np.ndarray):
        return [plain(row) for row in value.tolist()]
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return "nan" if math.isnan(value) else value
    if hasattr(value, "__dataclass_fields__"):
        return [plain(getattr(value, name)) for name in value.__dataclass_fields__]
    return value


def contents(answer: Any) -> Any:
    """Return an answer without the short form that it has at a prompt: its rows or columns."""
    from carla_recap.tables import Rows, Tabular

    if isinstance(answer, Rows):
        return list(answer)
    return answer.columns() if isinstance(answer, Tabular) else answer


def explore(path: Path) -> list[str]:
    """Call everything that a recording offers, damaged or not.

    Returns:
        The answers as text; errors of the package are answers, too.
    """
    answers = []

    def ask(question: Any) -> None:
        try:
            answers.append(repr(contents(question())))
        except RecapError as error:
            answers.append(f"{type(error).__name__}: {error}")

    import carla_recap

    try:
        recording = carla_recap.open_recording(path)
    except RecapError as error:
        return [f"{type(error).__name__}: {error}"]
    with recording:
        ask(lambda: recording.header)
        ask(lambda: [image(frame) for frame in recording])
        ask(lambda: [plain(packet.records) for frame in recording for packet in frame.packets])
        ask(lambda: recording.info)
        ask(lambda: recording.actors)
        ask(lambda: recording.reader.extent())
        ask(lambda: [image(frame) for frame in recording.frames(1.0, 2.5)])
        for time in (-1.0, 0.0, 1.5, 1e300):
            ask(lambda time=time: image(recording.frame_at(time)))
        for id in (7, 9):
            ask(lambda id=id: recording.trajectory(id))
            ask(lambda id=id: recording.controls(id))
            ask(lambda id=id: recording.light_states(id))
        ask(lambda: b"".join(recording.reader.tail()))
        ask(recording.collisions)
        ask(recording.blocked)
    return answers
