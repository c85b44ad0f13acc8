"""The releases of CARLA's client that the server speaks with: each is a row of plain data, which codecs and streams read."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, Final, NewType, TypeVar

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.server.protocol.chaos import ChaosControl
from carla_recap.sim.physics.physics_control import PhysicsControl

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from carla_recap.sim.blueprints import Blueprint, BlueprintLibrary

T = TypeVar("T")

Label = NewType("Label", int)
"""A semantic tag, which goes over the wire as the release numbers it."""
Labels = NewType("Labels", bytes)
"""Semantic tags, a byte each."""
AttributeCode = NewType("AttributeCode", int)
"""The type of an attribute, numbered from 0, as in recordings."""
WORLD: Final = "world"
"""The snapshots of the world among what streams carry."""


@dataclass(frozen=True, eq=False, slots=True)
class Release:
    """A release of CARLA's client.

    Attributes:
        name: Its version.
        marker: A text that its library has, and those of the releases after it in the table lack.
        data: What streams carry, in the order of its numbers: the data of sensors, and snapshots of the world.
        commands: The calls that a batch can have, in the order of their numbers.
        lacks: Patterns of blueprints that it does not have.
        adds: Blueprints that it alone has.
        first_attribute_type: The number of the first type of attributes.
        without: Fields of structs that it does not have, each as `Struct.field`.
        structs: Its own structs for ours, where more is different: see `ChaosControl` for what each has.
        labels: Its semantic tags by ours; empty if they are the same.
        wide: Whether its recorder writes lengths in double precision, and other packet ids of doors and wheels.
        renews_stream: Whether a client that begins an episode subscribes to a new stream of snapshots.
    """

    name: str
    marker: bytes
    data: tuple[str, ...]
    commands: tuple[str, ...]
    lacks: tuple[str, ...] = ()
    adds: tuple[str, ...] = ()
    first_attribute_type: int = 0
    without: frozenset[str] = frozenset()
    structs: Mapping[type, Any] = field(default_factory=dict)
    labels: tuple[int, ...] = ()
    wide: bool = False
    renews_stream: bool = False

    def number(self, data: str) -> int | None:
        """Return the number of what a stream carries; None if the release has no such sensor."""
        return self.data.index(data) if data in self.data else None

    def blueprints(self, library: BlueprintLibrary) -> list[Blueprint]:
        """Return the blueprints of a library that the release has."""
        own = [each for each in library if not any(fnmatchcase(each.id, pattern) for pattern in self.lacks)]
        return [*own, *map(library.get, self.adds)]

    def completed(self, value: T, before: T) -> T:
        """Return a value that a client has set, with what the release does not know of it as it was before."""
        own = self.structs.get(type(value))
        completed: T = value if own is None else own.completed(value, before)
        return completed

    def relabelled(self, tags: NDArray[Any]) -> NDArray[Any]:
        """Return semantic tags as the release numbers them."""
        return np.array(self.labels, tags.dtype)[tags] if self.labels else tags


_DATA: Final = (
    *("sensor.other.collision", "sensor.camera.depth", "sensor.camera.normals", "sensor.camera.dvs", "sensor.other.gnss"),
    *("sensor.other.imu", "sensor.other.lane_invasion", "sensor.other.obstacle", "sensor.camera.optical_flow"),
    *("sensor.other.radar", "sensor.lidar.ray_cast_semantic", "sensor.lidar.ray_cast", "sensor.other.rss"),
    *("sensor.camera.rgb", "sensor.camera.semantic_segmentation", "sensor.camera.instance_segmentation"),
    *("sensor.camera.cosmos_visualization", WORLD, "gbuffer of bytes", "gbuffer of numbers"),
    *("sensor.other.v2x", "sensor.other.v2x_custom"),
)
_COMMANDS: Final = (
    *("spawn_actor", "destroy_actor", "apply_control_to_vehicle", "apply_ackermann_control_to_vehicle"),
    *("apply_control_to_walker", "apply_physics_control", "set_actor_transform", "set_walker_state"),
    *("set_actor_target_velocity", "set_actor_target_angular_velocity", "add_actor_impulse", "add_actor_force"),
    *("add_actor_angular_impulse", "add_actor_torque", "set_actor_simulate_physics", "set_actor_enable_gravity"),
    *("set_actor_autopilot", "show_vehicle_debug_telemetry", "set_light_state", "set_actor_location"),
    *("console_command", "set_traffic_light_state"),
)
_SINCE_0_9_16: Final = ("sensor.camera.cosmos_visualization", "sensor.other.v2x", "sensor.other.v2x_custom")
_SINCE_0_9_14: Final = ("sensor.camera.normals", "gbuffer of bytes", "gbuffer of numbers")
_LABELS_OF_0_9_13: Final = (0, 7, 8, 1, 11, 2, 5, 18, 12, 9, 22, 13, 4, 4, *[10] * 6, 19, 20, 3, 21, 6, 14, 15, 16, 17)
"""Cars, trucks, buses, trains and two-wheelers are all vehicles, and riders are pedestrians."""
_VEHICLES_OF_0_10: Final = (
    *("ambulance.ford", "carlacola.actors", "dodge.charger", "dodgecop.charger", "firetruck.actors", "fuso.mitsubishi"),
    *("lincoln.mkz", "mini.cooper", "nissan.patrol", "sprinter.mercedes", "taxi.ford", "ue4.audi.tt"),
    *("ue4.bmw.grantourer", "ue4.chevrolet.impala", "ue4.ford.crown", "ue4.ford.mustang", "ue4.mercedes.ccc"),
)

_0_9_16: Final = Release("0.9.16", b"get_actor_bounding_box", _DATA, _COMMANDS, first_attribute_type=1, renews_stream=True)
_0_9_15: Final = Release(
    "0.9.15",
    b"enable_sensor_for_ros",
    tuple(data for data in _DATA if data not in _SINCE_0_9_16),
    _COMMANDS,
    lacks=_SINCE_0_9_16,
    without=frozenset(("BoxStruct.actor_id", "SpawnCommand.attachment", "SpawnCommand.socket")),
)
_0_10_0: Final = replace(
    _0_9_15,
    name="0.10.0",
    marker=b"is_weather_enabled",
    lacks=(*_0_9_15.lacks, "vehicle.*", "walker.pedestrian.000?", "walker.pedestrian.001[0-4]", "walker.pedestrian.0052"),
    adds=tuple(f"vehicle.{id}" for id in _VEHICLES_OF_0_10),
    structs={PhysicsControl: ChaosControl},
    wide=True,
)
_0_9_14: Final = replace(
    _0_9_15, name="0.9.14", marker=b"get_sensor_token", without=_0_9_15.without | {"EpisodeSettings.spectator_as_ego"}
)
_0_9_13: Final = replace(
    _0_9_14,
    name="0.9.13",
    marker=b"get_episode_info",
    data=tuple(data for data in _0_9_14.data if data not in _SINCE_0_9_14),
    commands=tuple(call for call in _COMMANDS[:19] if call != "apply_ackermann_control_to_vehicle"),
    lacks=(*_0_9_14.lacks, *_SINCE_0_9_14, "vehicle.carlamotors.european_hgv", "vehicle.mitsubishi.fusorosa"),
    without=_0_9_14.without | {"Weather.dust_storm"},
    labels=_LABELS_OF_0_9_13,
)
RELEASES: Final = (_0_9_16, _0_10_0, _0_9_15, _0_9_14, _0_9_13)
"""All releases, in the order in which the markers tell them apart."""
DEFAULT: Final = _0_9_16
"""The release of clients of which it cannot be found."""


def release_named(name: str) -> Release | None:
    """Return the release of a name; None for "auto", which is that of each client. Another name is a `RecapError`."""
    named = {release.name: release for release in RELEASES}
    if name not in (*named, "auto"):
        raise RecapError(f"expected a release of CARLA ({', '.join(sorted(named))}) or auto, found {name!r}")
    return named.get(name)
