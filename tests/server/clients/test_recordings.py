"""Recordings under the names that clients give them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from carla_recap import open_recording
from tests.server.clients.calls import spawn

if TYPE_CHECKING:
    from pathlib import Path

    import carla


def record(client: carla.Client, name: str, ticks: int = 20) -> str:
    """Record a vehicle; returns the name in the server's reply."""
    world = client.get_world()
    reply = client.start_recorder(name, True)
    vehicle = spawn(world, "vehicle.audi.tt", world.get_map().get_spawn_points()[0])
    for _ in range(ticks):
        world.tick()
    vehicle.destroy()
    world.tick()
    client.stop_recorder()
    return reply


@pytest.mark.parametrize("name", ["manual_recording.rec", "run_0.9.16"])
def test_any_name_records_the_format_of_carla_under_that_very_name(
    client: carla.Client, recordings: Path, name: str
) -> None:
    assert record(client, name) == str(recordings / name)
    information = client.show_recorder_file_info(name, False)
    assert "Version: 1" in information
    assert (recordings / name).read_bytes()[2:18] == b"\x0e\x00CARLA_RECORDER"
    with open_recording(recordings / name) as recording:
        assert sum(1 for _ in recording.frames()) > 20


def test_a_file_is_there_when_the_next_call_is_answered(client: carla.Client, recordings: Path) -> None:
    for number in range(5):
        name = f"quick{number}.log"
        record(client, name, ticks=3)
        client.get_server_version()
        assert (recordings / name).is_file()


def test_a_folder_that_is_missing_outside_the_recordings_gets_an_empty_reply(client: carla.Client, tmp_path: Path) -> None:
    assert client.start_recorder(str(tmp_path / "missing" / "a.log")) == ""
    client.stop_recorder()
    assert not (tmp_path / "missing").exists()


def test_a_replay_brings_back_what_was_recorded(client: carla.Client, world: carla.World) -> None:
    record(client, "again.log", ticks=40)
    answer = client.replay_file("again.log", 0.5, 0.0, 0, False)
    assert "again.log" in answer
    for _ in range(5):
        world.tick()
    assert [actor.type_id for actor in world.get_actors().filter("vehicle.*")] == ["vehicle.audi.tt"]
    client.stop_replayer(False)
