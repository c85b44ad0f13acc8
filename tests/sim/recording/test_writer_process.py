"""The process that writes recordings: its commands, its answers, and what it does when the disk fails."""

from __future__ import annotations

import io
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import carla_recap
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.formats.mcap.container import ChunkedFile
from carla_recap.formats.mcap.writer import McapWriter
from carla_recap.model.frame import Header
from carla_recap.sim import World
from carla_recap.sim.recording.sampler import WorldSampler
from carla_recap.sim.recording.snapshots import SnapshotBatch
from carla_recap.sim.recording.writer_process import Commands, RecordingWriter, serve
from tests.sim.flat import flat_town, flat_world
from tests.sim.recordings import frames

HEADER = Header("Flat", 0)


def batches(ticks: int) -> list[SnapshotBatch]:
    """Some frames of a world, 0.05 s each."""
    world = flat_world()
    sampler = WorldSampler(world.episode, additional_data=False)
    found: list[SnapshotBatch] = []
    for _ in range(ticks):
        world.tick()
        batch = sampler.sample(world.delta)
        if batch not in found:
            found.append(batch)
    return found


def write(path: Path, ticks: int, *, force: bool = True) -> None:
    """Write a recording with the commands of the process."""
    commands = Commands()
    commands.begin(path, HEADER, force)
    for batch in batches(ticks):
        commands.write(batch)
    commands.close()


def broken_after(monkeypatch: pytest.MonkeyPatch, chunks: int) -> None:
    """Let the disk fail once, at some chunk of the next recording."""
    write, left = McapWriter._write_chunk, [chunks]

    def failing(self: McapWriter, chunk: Any) -> None:
        left[0] -= 1
        if left[0] == -1:
            raise RecapError(f"{self.path}: cannot be written: No space left on device")
        write(self, chunk)

    monkeypatch.setattr(McapWriter, "_write_chunk", failing)


def answers(*commands: tuple[Any, ...], more: bytes = b"") -> Iterator[str | None]:
    """The answers of a process to commands."""
    said = io.BytesIO()
    serve(io.BytesIO(b"".join(pickle.dumps((name, rest)) for name, *rest in commands) + more), said)
    said.seek(0)
    while said.tell() < len(said.getvalue()):
        yield pickle.load(said)


def test_an_error_is_the_answer_and_the_next_recording_is_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    absent = tmp_path / "file" / "a.mcap"
    first, second, third, fourth = answers(
        ("begin", absent, HEADER, True), ("write", None), ("begin", tmp_path / "b.mcap", HEADER, True), ("close",)
    )
    assert first == f"{absent.parent}: is a file; a folder was expected"
    assert second
    assert second.startswith("AssertionError: ")
    assert (third, fourth) == (None, None)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b.mcap", "file"]


@pytest.mark.parametrize("more", [b"", pickle.dumps(("close", ()))[:-3], pickle.dumps(("write", [b"x" * 1000]))[:500]])
def test_a_recording_is_completed_when_the_commands_end(tmp_path: Path, more: bytes) -> None:
    path = tmp_path / "a.mcap"
    begun = [("begin", path, HEADER, True), *(("write", batch) for batch in batches(60))]
    assert list(answers(*begun, more=more)) == [None] * len(begun)
    assert len(frames(path)) == 60
    assert list(tmp_path.iterdir()) == [path]


def test_a_recording_without_frames_is_removed_when_the_commands_end(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", 3)
    assert list(answers(("begin", tmp_path / "a.mcap", HEADER, True))) == [None]
    assert len(frames(tmp_path / "a.mcap")) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_none_is_the_last_command(tmp_path: Path) -> None:
    assert list(answers(("begin", tmp_path / "a.mcap", HEADER, True), more=pickle.dumps(None) + b"x")) == [None]


def test_an_interrupted_start_leaves_the_older_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By Ctrl-C, when the process has begun it."""
    world, carry_out = flat_world(), RecordingWriter._command

    def interrupted(self: RecordingWriter, name: str, *arguments: Any) -> None:
        carry_out(self, name, *arguments)
        raise KeyboardInterrupt

    write(tmp_path / "a.mcap", 3)
    monkeypatch.setattr(RecordingWriter, "_command", interrupted)
    with pytest.raises(KeyboardInterrupt):
        world.start_recorder(tmp_path / "a.mcap")
    world.tick()
    assert world.recorder.path is None
    assert len(frames(tmp_path / "a.mcap")) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_what_is_written_before_a_disk_fails_becomes_a_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken_after(monkeypatch, 2)
    path = tmp_path / "a.mcap"
    with pytest.raises(RecapError, match=r"No space left on device; the recording ends at 4.95 s"):
        write(path, 300)
    assert len(frames(path)) == 100
    assert list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_finished_is_left_to_be_recovered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: ChunkedFile) -> None:
        raise RecapError(f"{self.path}: cannot be written: No space left on device")

    monkeypatch.setattr(ChunkedFile, "_finish", full)
    with pytest.raises(RecapError, match="for carla-recap recover"):
        write(tmp_path / "a.mcap", 240)
    (partial,) = tmp_path.iterdir()
    monkeypatch.undo()
    assert carla_recap.recover(partial, tmp_path / "b.mcap").frames == 240


def test_an_older_recording_outlasts_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "a.mcap", 3)
    broken_after(monkeypatch, 2)
    with pytest.raises(RecapError, match="for carla-recap recover"):
        write(tmp_path / "a.mcap", 300)
    assert len(frames(tmp_path / "a.mcap")) == 3


def test_a_world_that_writes_by_itself_records_the_same_bytes(tmp_path: Path) -> None:
    for name, in_process in (("a", False), ("b", True)):
        with World(flat_town(), seed=3, date=0, parameters={"speed": 8}) as world:
            world.recorder.start(tmp_path / f"{name}.mcap", True, in_process=in_process)
            world.run(3)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    with carla_recap.open_recording(tmp_path / "b.mcap") as recording:
        assert recording.header.parameters == {"speed": "8"}


def test_a_world_that_writes_by_itself_goes_on_when_the_disk_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken_after(monkeypatch, 1)
    world = flat_world()
    world.recorder.start(tmp_path / "a.mcap", in_process=True)
    with pytest.warns(RecapWarning, match="the recording has ended"), world:
        world.run(20)
    assert "no space" in str(world.recorder.error).lower()
    with pytest.warns(RecapWarning, match="was recovered without all of its events"):
        assert len(frames(tmp_path / "a.mcap")) < 400
