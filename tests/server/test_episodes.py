from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from carla_recap.sim.town.loading import load_town

if TYPE_CHECKING:
    from pathlib import Path

    import carla

TEXT = load_town().opendrive


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
    topology = {(entry.road_id, entry.lane_id) for entry, _ in world.get_map().get_topology()}
    assert len(world.get_map().get_spawn_points()) == len(topology)
    world = client.reload_world()
    assert world.get_map().name.endswith("OpenDriveMap")
    client.load_world("Brickfield")


def test_what_is_no_map_is_refused(client: carla.Client, world: carla.World) -> None:
    with pytest.raises(RuntimeError, match="OpenDriveMap"):
        client.generate_opendrive_world("<OpenDRIVE>nothing here")
    world.tick()
