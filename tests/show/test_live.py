"""Live views while actors come and go for long: the picture, the bytes and the memory stay the same."""

from __future__ import annotations

import gc
import os
import resource
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import psutil
import pytest

from carla_recap import RecapError, open_recording
from carla_recap.model.frame import Frame, Header
from tests.replay.scripts import pose, spawn, write
from tests.samples import names_in
from tests.waiting import time_limit

pytest.importorskip("foxglove", reason="the extra foxglove-live is not installed")
pytest.importorskip("rerun", reason="the extra rerun is not installed")

import rerun as rr
from rerun.chunk import RrdReader

from carla_recap.show.foxglove.messages import SceneUpdate
from carla_recap.show.foxglove.websocket import FoxgloveServer, FoxgloveView
from carla_recap.show.rerun import bodies
from carla_recap.show.rerun.blueprint import live_blueprint
from carla_recap.show.rerun.sinks import APPLICATION, rrd_file, save_blueprint, send_blueprint
from carla_recap.show.rerun.writer import LiveView

ACTORS: Final = int(os.environ.get("COMING_AND_GOING", "160"))
"""The number of actors that come and go."""
PRESENT: Final = 10
PARTS: Final = 4
TYPES: Final = ("vehicle.audi.tt", "vehicle.ford.ambulance", "walker.pedestrian.0001", "vehicle.bh.crossbike")


def driving(id: int, frame: int) -> Any:
    return pose(id, 1000 * (id % PRESENT) + 10 * frame, 500 * (id % 7))


@pytest.fixture(scope="module")
def traffic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording in which, after the first frame, an actor goes and another one comes in each frame."""
    frames = []
    for frame in range(ACTORS):
        present = range(frame + 1, frame + 1 + PRESENT)
        new = present if not frame else present[-1:]
        frames.append(
            {
                "spawned": [spawn(id, TYPES[id % len(TYPES)], color="17,37,103") for id in new],
                "destroyed": [frame] if frame else [],
                "transforms": [driving(id, frame) for id in present],
            }
        )
    return write(tmp_path_factory.mktemp("live") / "traffic.log", frames, tick=0.3)


def parts_of(path: Path, enter: Callable[[Frame], None], take: Callable[[], Any]) -> Iterator[tuple[Any, int]]:
    """Yield what is taken after each part of the frames, and the memory in use then, in bytes."""
    with open_recording(path) as recording:
        for number, frame in enumerate(recording.frames(), 1):
            enter(frame)
            if number % (ACTORS // PARTS) == 0:
                taken = take()
                gc.collect()
                yield taken, tracemalloc.get_traced_memory()[0]


@pytest.fixture
def traced() -> Iterator[None]:
    tracemalloc.start()
    yield
    tracemalloc.stop()


@pytest.fixture
def header(traffic: Path) -> Header:
    with open_recording(traffic) as recording:
        return recording.header


def check_flat(sizes: list[int], memory: list[int]) -> None:
    """Check that each part after the first one takes as many bytes as the one before, and the last one no more memory."""
    for before, after in pairwise(sizes[1:]):
        assert after == pytest.approx(before, rel=0.3)
    assert memory[-1] - memory[-2] < 50_000


@pytest.mark.usefixtures("traced")
def test_in_rerun(traffic: Path, header: Header, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if ACTORS < bodies.MOST_BOXES:  # the limits are exceeded in any case
        monkeypatch.setattr(bodies, "MOST_BOXES", 5 * PRESENT)
        monkeypatch.setattr(bodies, "MOST_MODELS", 4 * PRESENT)
    sizes, memory, threads = [], [], []
    stream = rr.RecordingStream(APPLICATION, send_properties=False)
    written = rr.binary_stream(stream)
    send_blueprint(live_blueprint(), stream)
    view = LiveView(stream, header, "test")

    def take() -> bytes:
        view.flush()
        return written.read(flush_timeout_sec=60)

    for data, used in parts_of(traffic, view.enter, take):
        sizes.append(len(data))
        memory.append(used)
        threads.append(psutil.Process().num_threads())
    view.close()  # warns of nothing
    (tmp_path / "last.rrd").write_bytes(data)
    drawn: dict[str, set[str]] = {}
    for chunk in RrdReader(tmp_path / "last.rrd").stream().to_chunks():
        drawn.setdefault(chunk.entity_path, set()).update(chunk.to_record_batch().schema.names)
    for id in range(ACTORS + 1, ACTORS + PRESENT):
        assert {"Mesh3D:vertex_positions", "Transform3D:translation"} <= drawn[f"/world/actors/{id}"]
    check_flat(sizes, memory)
    assert max(threads[1:]) <= threads[0]  # each other actor that is followed has another blueprint


def size_of_200(path: Path, *, live: bool = False) -> int:
    """Return the size of a new file of 200 entities."""
    with rrd_file(path, live_blueprint(), live=live) as stream:
        for number in range(200):
            stream.set_time("frame", sequence=number)
            stream.log(f"/{number}", rr.Scalars(number))
            stream.flush()
    return path.stat().st_size


def test_a_live_file_has_no_index_that_grows_in_memory(tmp_path: Path) -> None:
    assert size_of_200(tmp_path / "live.rrd", live=True) < 0.7 * size_of_200(tmp_path / "whole.rrd")


@contextmanager
def disk_of(size: int) -> Iterator[None]:
    """Let no file of this process grow beyond a size, as on a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.parametrize("live", [False, True])
@pytest.mark.parametrize("size", [5, 100, 50_000, 1_000_000])
def test_a_disk_that_is_full_while_data_wait_is_an_error(tmp_path: Path, size: int, *, live: bool) -> None:
    points = np.random.default_rng(1).random((300_000, 3))
    error = pytest.raises(RecapError, match=r"x\.rrd: cannot be written: File too large")
    with time_limit(), disk_of(size), error, rrd_file(tmp_path / "x.rrd", live_blueprint(), live=live) as stream:
        stream.log("/points", rr.Points3D(points))
    assert names_in(tmp_path) == []


@pytest.mark.parametrize("size", [100, 50_000])
def test_an_arrangement_on_a_full_disk_is_an_error(tmp_path: Path, size: int) -> None:
    with time_limit(), disk_of(size), pytest.raises(OSError, match="File too large"):
        save_blueprint(live_blueprint(), tmp_path / "x.rbl")


@pytest.mark.usefixtures("traced")
def test_in_foxglove(traffic: Path, header: Header, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: dict[str, dict[str, SceneUpdate]] = {}
    sizes, memory = [], []
    with FoxgloveServer("live", 0) as server:
        view = FoxgloveView(server, header)
        sent: list[tuple[str, bytes]] = []
        for topic, channel in server._channels.items():
            server._channels[topic] = _Channel(channel, topic, sent)

        def take() -> int:
            size = sum(len(data) for _, data in sent)
            for topic, data in sent:
                if topic.startswith("/scene/") and topic != "/scene/ahead":
                    update, on_topic = SceneUpdate.FromString(data), shown.setdefault(topic, {})
                    for deletion in update.deletions:
                        on_topic.pop(deletion.id, None)
                    on_topic.update((entity.id, entity) for entity in update.entities)
            sent.clear()
            return size

        for size, used in parts_of(traffic, view.enter, take):
            sizes.append(size)
            memory.append(used)
        view.close()
        latest = {topic: SceneUpdate.FromString(data) for topic, (_, data) in server._latest.items() if topic in shown}
    present = {f"actor {id}" for id in range(ACTORS, ACTORS + PRESENT)}
    found = shown["/scene/vehicles"] | shown["/scene/walkers"]
    assert set(found) == present
    assert all(entity.triangles and not entity.cubes for entity in found.values())
    for topic, whole in latest.items():  # what a new viewer gets
        assert {entity.id for entity in whole.entities} == set(shown[topic])
    one = max(entity.ByteSize() for entity in found.values())
    changes = ACTORS // PARTS
    assert sizes[-1] < changes * (3 * one + 20_000)
    check_flat(sizes, memory)


class _Channel:
    """Keeps what is sent on a channel, and sends nothing."""

    def __init__(self, channel: Any, topic: str, sent: list[tuple[str, bytes]]) -> None:
        self._topic, self._sent = topic, sent

    def log(self, data: bytes, **_: Any) -> None:
        self._sent.append((self._topic, data))
