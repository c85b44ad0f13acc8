from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from carla_recap.sim.town.loading import load_town

if TYPE_CHECKING:
    from pathlib import Path

    import carla

TEXT = load_town().opendrive


def test_the_maps_are_named_as_carla_names_them(client: carla.Client) -> None:
    assert "/Game/Carla/Maps/Brickfield" in client.get_available_maps()


@pytest.mark.parametrize("name", ["Brickfield", "/Game/Carla/Maps/Brickfield", "Carla/Maps/Brickfield", "brickfield"])
def test_a_map_is_loaded_by_its_name(client: carla.Client, world: carla.World, name: str) -> None:
    before = world.id
    after = client.load_world(name)
    assert after.id != before
    assert after.get_map().name.endswith("Brickfield")


def test_an_unknown_map_is_refused_with_the_names_of_all(client: carla.Client, world: carla.World) -> None:
    with pytest.raises(RuntimeError, match="'Atlantis': there is no such map; there are Brickfield"):
        client.load_world("Atlantis")
    world.tick()


def test_files_are_not_read_by_their_paths(client: carla.Client, tmp_path: Path) -> None:
    (tmp_path / "secret.xodr").write_text(TEXT)
    with pytest.raises(RuntimeError, match="there is no such map"):
        client.load_world(str(tmp_path / "secret.xodr"))


def test_a_new_episode_has_no_actors_of_the_last_one_and_never_their_ids(client: carla.Client, world: carla.World) -> None:
    blueprint = world.get_blueprint_library().find("vehicle.tesla.model3")
    point = world.get_map().get_spawn_points()[0]
    before = world.spawn_actor(blueprint, point).id
    frame = world.tick()
    world = client.reload_world(reset_settings=False)
    assert world.tick() > frame
    assert not world.get_actors().filter("vehicle.*")
    assert world.spawn_actor(blueprint, point).id > before


@pytest.mark.parametrize("reset", [True, False])
def test_settings_are_reset_on_request(client: carla.Client, reset: bool) -> None:
    settings = client.reload_world(reset_settings=reset).get_settings()
    assert settings.synchronous_mode is not reset
    assert settings.fixed_delta_seconds == (None if reset else pytest.approx(0.05))


def test_a_map_that_a_client_sends_is_loaded(client: carla.Client) -> None:
    world = client.generate_opendrive_world(TEXT)
    assert world.get_map().name.endswith("OpenDriveMap")
    points = world.get_map().get_spawn_points()
    lanes = [world.get_map().get_waypoint(point.location, project_to_road=True) for point in points]
    topology = {(entry.road_id, entry.lane_id) for entry, _ in world.get_map().get_topology()}
    assert len(points) == len(topology)
    for point, lane in zip(points, lanes, strict=True):
        assert point.location.z - lane.transform.location.z == pytest.approx(3.0, abs=0.01)
        assert point.location.distance(lane.transform.location) < 3.01
    world = client.reload_world()
    assert world.get_map().name.endswith("OpenDriveMap")
    client.load_world("Brickfield")


def test_what_is_no_map_is_refused(client: carla.Client, world: carla.World) -> None:
    with pytest.raises(RuntimeError, match=r"^OpenDriveMap: an OpenDRIVE map was expected"):
        client.generate_opendrive_world("<OpenDRIVE>nothing here")
    world.tick()


def test_another_client_learns_of_the_episode(client: carla.Client, world: carla.World, other_client: carla.Client) -> None:
    theirs = other_client.get_world()
    seen: list[int] = []
    theirs.on_tick(lambda snapshot: seen.append(snapshot.frame))
    world = client.reload_world(reset_settings=False)
    world.tick()
    assert other_client.get_world().id == world.id
    assert seen == sorted(seen)


def test_a_recording_ends_with_its_episode(client: carla.Client, world: carla.World, recordings: Path) -> None:
    client.start_recorder("episode.mcap")
    for _ in range(5):
        world.tick()
    client.reload_world()
    assert "Frames: 5" in client.show_recorder_file_info("episode.mcap", False)
