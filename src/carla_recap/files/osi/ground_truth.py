"""Scenes as `osi3.GroundTruth`: moving objects with their motion, props, traffic lights.

Units are m, s and radians; axes are right-handed: x forward, y left, z up, a positive yaw turns left. The position of an
object is the centre of its box.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.files.osi.message_types import GROUND_TRUTH, VERSION, message_class
from carla_recap.model.lives import ROAD_USERS
from carla_recap.replay.motion import SceneMotion
from carla_recap.replay.pose import LOCATION, ROTATION, right_handed, wrap
from carla_recap.scene.appearance import look_of_present
from carla_recap.scene.materials import Tag

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from carla_recap.model.lives import ActorLife
    from carla_recap.replay.scene import SceneBatch
    from carla_recap.scene.appearance import Look
    from carla_recap.util.arrays import Floats


# Values of OSI's enumerations.
_VEHICLE, _PEDESTRIAN = 2, 3
_CAR, _VAN, _TRUCK, _MOTORCYCLE, _BICYCLE, _BUS = 4, 6, 7, 10, 11, 12
_OTHER: Final = 1
_CIVIL: Final = 2
_ROLES: Final = {"ambulance": 3, "firetruck": 4, "police": 5}
_TYPES: Final = {Tag.TRUCK: _TRUCK, Tag.BUS: _BUS, Tag.MOTORCYCLE: _MOTORCYCLE, Tag.BICYCLE: _BICYCLE}
_COLORS: Final = {0: 2, 1: 3, 2: 4}  # red, yellow, green
_UNKNOWN, _OFF, _CONSTANT = 0, 2, 3
_NO_ICON: Final = 2
_STATE_OFF: Final = 3  # of CARLA's lights


class GroundTruths:
    """Makes a message of each scene; with the id of a host vehicle, and the name of a map unless that is empty."""

    def __init__(self, host: int | None, map_reference: str) -> None:
        self._class = message_class(GROUND_TRUTH)
        self._host = host
        self._map_reference = map_reference
        self._motion = SceneMotion()
        self._actors: dict[int, tuple[ActorLife, Look | None]] = {}

    def messages(self, batch: SceneBatch) -> Iterator[tuple[int, Any]]:
        """Yield the time of each scene in ns since the beginning of the recording, and its message.

        A scene whose time is that of the one before, or negative, has none.
        """
        poses = right_handed(batch.poses)
        velocities, accelerations = np.nan_to_num(self._motion.velocities(batch)), np.nan_to_num(self._motion.accelerations)
        rotations = np.radians(wrap(poses[..., ROTATION]))
        finite: Any = np.isfinite(poses).all(axis=2)
        objects = [(column, *found) for column, id in enumerate(batch.ids.tolist()) if (found := self._object(batch, id))]
        centers = {column: _center(poses[:, column], look.center) for column, _, look in objects}
        fixed, lights = self._fixed(batch), self._lights(batch)
        for row, time in enumerate(batch.time.tolist()):
            if not 0 <= time < _LATEST:
                continue
            nanoseconds = round(time * 1e9)
            message = self._class()
            message.version.version_major, message.version.version_minor, message.version.version_patch = VERSION
            _set_time(message.timestamp, nanoseconds)
            if self._host is not None:
                message.host_vehicle_id.value = self._host
            if self._map_reference:
                message.map_reference = self._map_reference
            for column, actor, look in objects:
                if finite[row, column]:
                    moving = actor.kind in ROAD_USERS
                    item = (message.moving_object if moving else message.stationary_object).add()
                    item.id.value = actor.id
                    _set_base(item.base, look, centers[column][row].tolist(), rotations[row, column].tolist())
                    if moving:
                        _set_vector(item.base.velocity, velocities[row, column].tolist())
                        _set_vector(item.base.acceleration, accelerations[row, column].tolist())
                        _classify(item, actor, look)
                    else:
                        item.classification.type = _OTHER
            for item in fixed:
                message.stationary_object.add().CopyFrom(item)
            _add_lights(message, batch.light_states[row], lights, row)
            yield nanoseconds, message

    def _object(self, batch: SceneBatch, id: int) -> tuple[ActorLife, Look] | None:
        """Return an actor with a body; None for another one."""
        actor = batch.actors.get(id)
        if actor is None or actor.kind in ("traffic_light", "traffic_sign"):
            return None
        known = self._actors.get(id)
        if known is None or known[0] is not actor:
            known = self._actors[id] = actor, look_of_present(actor)
        look = known[1]
        return None if look is None else (actor, look)

    def _fixed(self, batch: SceneBatch) -> list[Any]:
        """Return the props without recorded poses, which stay where they were spawned."""
        found = []
        known = set(batch.ids.tolist())
        for id in batch.actors:
            each = self._object(batch, id) if id not in known else None
            pose = batch.pose_of(id, 0) if each else None
            if each is None or pose is None or each[0].kind in ROAD_USERS:
                continue
            turned = right_handed(pose)
            if np.isfinite(turned).all():
                item = self._class().stationary_object.add()
                item.id.value = id
                center = _center(turned[None], each[1].center)[0]
                _set_base(item.base, each[1], center.tolist(), np.radians(wrap(turned[ROTATION])).tolist())
                item.classification.type = _OTHER
                found.append(item)
        return found

    def _lights(self, batch: SceneBatch) -> dict[int, _Light]:
        """Return the traffic lights whose poses are known, by id."""
        found = {}
        for id in np.unique(batch.light_states["id"]).tolist():
            actor, poses = batch.actors.get(id), batch.pose_of(id)
            look = look_of_present(actor) if actor is not None else None
            if poses is not None and look is not None:
                turned = right_handed(poses)
                finite: Any = np.isfinite(turned).all(axis=1)
                found[id] = _Light(look, finite, _center(turned, look.center), np.radians(wrap(turned[:, ROTATION])))
        return found


class _Light(NamedTuple):
    """A traffic light in the scenes of a batch."""

    look: Look
    finite: NDArray[np.bool_]  # whether its pose is finite, (scenes,)
    centers: Floats  # of its box in m, (scenes, 3)
    rotations: Floats  # roll, pitch and yaw in radians, (scenes, 3)


def _add_lights(message: Any, states: NDArray[np.void], lights: Mapping[int, _Light], row: int) -> None:
    for id, state in states[["id", "state"]].tolist():
        light = lights.get(id)
        if light is None or not light.finite[row]:
            continue
        item = message.traffic_light.add()
        item.id.value = id
        _set_base(item.base, light.look, light.centers[row].tolist(), light.rotations[row].tolist())
        item.classification.color = _COLORS.get(state, _UNKNOWN)
        item.classification.icon = _NO_ICON
        item.classification.mode = _CONSTANT if state in _COLORS else _OFF if state == _STATE_OFF else _UNKNOWN


_LATEST: Final = float(1 << 33)  # s; later times are no times of a recording


def _center(poses: Floats, center: tuple[float, float, float]) -> Floats:
    """Return the centres of boxes in the world, (n, 3), of right-handed poses in m and degrees, (n, 6)."""
    roll, pitch, yaw = np.radians(poses[:, ROTATION]).T
    x, y, z = center
    y, z = y * np.cos(roll) - z * np.sin(roll), y * np.sin(roll) + z * np.cos(roll)
    x, z = x * np.cos(pitch) + z * np.sin(pitch), -x * np.sin(pitch) + z * np.cos(pitch)
    x, y = x * np.cos(yaw) - y * np.sin(yaw), x * np.sin(yaw) + y * np.cos(yaw)
    found: Floats = poses[:, LOCATION] + np.stack((x, y, z), axis=1)
    return found


def _classify(item: Any, actor: ActorLife, look: Look) -> None:
    if actor.kind == "walker":
        item.type = _PEDESTRIAN
        return
    item.type = _VEHICLE
    base = actor.spawn.attribute("base_type") or ""
    item.vehicle_classification.type = _VAN if base == "van" else _TYPES.get(look.tag, _CAR)
    item.vehicle_classification.role = next((role for name, role in _ROLES.items() if name in actor.type_id), _CIVIL)


def _set_base(base: Any, look: Look, position: list[float], rotation: list[float]) -> None:
    length, width, height = look.half_extents
    base.dimension.length, base.dimension.width, base.dimension.height = 2 * length, 2 * width, 2 * height
    _set_vector(base.position, position)
    base.orientation.roll, base.orientation.pitch, base.orientation.yaw = rotation


def _set_vector(vector: Any, values: list[float]) -> None:
    vector.x, vector.y, vector.z = values


def _set_time(timestamp: Any, nanoseconds: int) -> None:
    timestamp.seconds, timestamp.nanos = divmod(nanoseconds, 1_000_000_000)
