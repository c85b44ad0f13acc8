"""Recordings of worlds, and their frames."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import carla_recap
from carla_recap.model.frame import Frame
from carla_recap.sim.recording.writer_process import RecordingWriter
from carla_recap.sim.world import World
from tests.waiting import wait_until


def frames(path: Path) -> list[Frame]:
    with carla_recap.open_recording(path) as recording:
        return list(recording.frames())


def written(path: Path, *frames: dict[str, Any], interval: float = 0.05) -> Path:
    """Write a recording on the plain, of frames with some records each."""
    with carla_recap.create_recording(path, map_name="Flat", date=0) as recording:
        for number, records in enumerate(frames):
            recording.add_frame(number * interval, **records)
    return path


def record(world: World, path: Path, ticks: int, *, additional_data: bool = False, **options: bool) -> list[Frame]:
    """Record some ticks, by default without another process, and return the frames; for the options see `start`."""
    world.recorder.start(path, additional_data, **{"in_process": True, **options})
    for _ in range(ticks):
        world.tick()
    world.stop_recorder()
    return frames(path)


def writer_pid(world: World) -> int:
    """Return the id of the process that writes."""
    return world.recorder._writer.pid


def handed_over(patch: pytest.MonkeyPatch) -> list[str]:
    """Return the list of commands that processes that write have carried out, from now on."""
    done: list[str] = []
    carry_out = RecordingWriter._command

    def counted(self: RecordingWriter, name: str, *arguments: Any) -> None:
        carry_out(self, name, *arguments)
        done.append(name)

    patch.setattr(RecordingWriter, "_command", counted)
    return done


@contextmanager
def disk_of(world: World, size: int) -> Iterator[None]:
    """Let no file that the world's recorder writes grow beyond a size, in bytes: larger than the bytecode of a module."""
    writer = writer_pid(world)
    resource.prlimit(writer, resource.RLIMIT_FSIZE, (size, size))
    yield


def run_until_it_fails(world: World) -> None:
    def has_failed() -> bool:
        world.tick()
        return not world.recorder.path

    wait_until(has_failed, pause=0.0)
