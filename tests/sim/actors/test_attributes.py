"""The attributes of blueprints: what they are by default is of their type."""

from __future__ import annotations

import pytest

from carla_recap.sim.actors.attributes import SENSORS, attribute_type, is_modifiable, is_restricted
from carla_recap.sim.actors.blueprints import standard_library

READERS = (
    {"true": True, "false": False}.__getitem__,
    int,
    float,
    str,
    lambda text: tuple(map(int, text.split(","))),
)


@pytest.mark.parametrize("blueprint", standard_library(), ids=lambda blueprint: blueprint.id)
def test_defaults_and_choices_are_of_their_type(blueprint) -> None:  # type: ignore[no-untyped-def]
    for key, value in blueprint.attributes.items():
        for text in (value, *blueprint.choices.get(key, ())):
            READERS[attribute_type(key)](text)
    assert blueprint.choices.keys() <= blueprint.attributes.keys()
    assert all(is_modifiable(key) for key in blueprint.choices)


def test_sensors_have_what_their_pictures_need() -> None:
    assert {id for id, attributes in SENSORS.items() if "fov" in attributes} == {
        id for id in SENSORS if id.startswith("sensor.camera.")
    }
    assert SENSORS["sensor.camera.rgb"].items() >= {"image_size_x": "800", "image_size_y": "600", "fov": "90.0"}.items()
    assert SENSORS["sensor.lidar.ray_cast"].items() >= {"channels": "32", "range": "10.0", "lower_fov": "-30.0"}.items()
    assert [attribute_type(key) for key in ("fov", "image_size_x", "exposure_mode", "use_log")] == [2, 1, 3, 0]


def test_what_a_blueprint_is_cannot_be_changed() -> None:
    assert not any(map(is_modifiable, ("number_of_wheels", "generation", "base_type", "gender", "age", "size")))
    assert all(map(is_modifiable, ("color", "role_name", "speed", "fov", "driver_id")))
    assert is_restricted("driver_id")
    assert not is_restricted("color")
