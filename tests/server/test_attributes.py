"""Values of attributes that the official client cannot read are refused, or replaced by the default."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from carla_recap.errors import RecapError
from carla_recap.server.actor_records import check_attributes
from carla_recap.sim.blueprints import standard_library
from carla_recap.sim.town.loading import load_town
from carla_recap.sim.world import World

if TYPE_CHECKING:
    from pathlib import Path

    import carla

    from tests.server.inside import Inside

CAR, WALKER, CAMERA, IMU = "vehicle.audi.tt", "walker.pedestrian.0001", "sensor.camera.rgb", "sensor.other.imu"
BAD = [
    *((CAR, "color", value) for value in ("256,0,0", "1,2", "1,2,3,4", "a,b,c", "-1,0,0", "", "0x1,0,0", "1.5,0,0")),
    *((CAR, "sticky_control", value) for value in ("maybe", "1", "")),
    (WALKER, "is_invincible", "2"),
    *((WALKER, "speed", value) for value in ("fast", "nan", "inf", "1e39", "1_0", "٣", "")),
    (CAMERA, "sensor_tick", "1e400"),
    (IMU, "noise_accel_stddev_x", "abc"),
    *((CAMERA, "image_size_x", value) for value in ("abc", "2147483648", "1.5", "9" * 5000)),
    *((CAMERA, "image_size_y", value) for value in ("0", "-5", "4097")),
]
GOOD = [
    *((CAR, "color", value) for value in ("0,0,0", "255,255,255", "255, 0, 0")),
    *((CAR, "sticky_control", value) for value in ("true", "False")),
    *((WALKER, "speed", value) for value in ("1", "-1.5", ".5", "2.", "1e-3", "3.4e38")),
    *((CAMERA, "image_size_x", value) for value in ("1", "4096", "800.0")),
    (CAR, "role_name", ""),
]


@pytest.mark.parametrize(("name", "key", "value"), BAD)
def test_a_bad_value_is_refused(name: str, key: str, value: str) -> None:
    with pytest.raises(RecapError, match=re.escape(f"{name}: {key} of {value[:60]!r}")):
        check_attributes(standard_library().get(name), {key: value})


@pytest.mark.parametrize(("name", "key", "value"), GOOD)
def test_a_good_value_is_none_of_the_bad_ones(name: str, key: str, value: str) -> None:
    check_attributes(standard_library().get(name), {key: value})


def test_the_blueprints_are_good() -> None:
    library = standard_library()
    for blueprint in library:
        for key, value in [*blueprint.attributes.items(), *((k, v) for k, vs in blueprint.choices.items() for v in vs)]:
            check_attributes(library.get(blueprint.id), {key: value})


def test_each_way_of_spawning_refuses_it(inside: Inside) -> None:
    before = len(inside.world.actors)
    place, bad = [[600.0, 0.0, 0.0], [0.0, 0.0, 0.0]], [0, CAR, [["color", 5, "256,0,0"]]]
    with pytest.raises(RecapError, match="color of '256,0,0'"):
        inside.call("spawn_actor", bad, place)
    with pytest.raises(RecapError, match="color of '256,0,0'"):
        inside.call("spawn_actor_with_parent", bad, place, inside.world.spectator.id, 0, "")
    for parent in ([False], [True, inside.world.spectator.id]):
        ((answer,),) = inside.batch([0, [bad, place, parent, 0, "", []]])
        assert answer[0] == 0
        assert "color of '256,0,0'" in answer[1][0]
    assert len(inside.world.actors) == before


def test_clients_can_read_the_actors_of_a_recording_with_bad_values(
    client: carla.Client, world: carla.World, recordings: Path
) -> None:
    with World(load_town()) as recorded:
        recorded.spawn(CAR, recorded.town.spawn_points[0], color="256,0,0", sticky_control="maybe", role_name="bad")
        recorded.start_recorder(recordings / "bad.log")
        for _ in range(20):
            recorded.tick()
    client.replay_file("bad.log", 0.0, 0.0, 0)
    world.tick()
    (car,) = world.get_actors().filter(CAR)
    defaults = standard_library().get(CAR).attributes
    assert {key: car.attributes[key] for key in ("color", "sticky_control", "role_name")} == {
        "color": defaults["color"],
        "sticky_control": defaults["sticky_control"],
        "role_name": "bad",
    }
