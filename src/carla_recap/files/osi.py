"""An export to ASAM OSI: an MCAP trace of `osi3.GroundTruth`, a message for each frame, and the map.

The file follows the multi-trace format of OSI 3.7: topics `ground_truth` and `ground_truth_map`, the version of OSI and of
protobuf in the metadata `net.asam.osi.trace` and in those of the channels. Message times begin at 0.
Units are m, s and radians; axes are right-handed: x forward, y left, z up, a positive yaw turns left. The position of an
object is the centre of its box.
"""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from carla_recap.editing.convert import check_destination
from carla_recap.errors import MissingExtra
from carla_recap.formats.mcap.container import MessageFile, message_topic
from carla_recap.formats.mcap.schema import EXPORT_METADATA
from carla_recap.model.lives import ROAD_USERS
from carla_recap.replay import Played, Player
from carla_recap.replay.motion import SceneMotion
from carla_recap.replay.pose import LOCATION, ROTATION, right_handed, wrap
from carla_recap.roads.files import read_text
from carla_recap.scene.appearance import look_of_present
from carla_recap.scene.materials import Tag
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from carla_recap.model.frame import Header
    from carla_recap.model.lives import ActorLife
    from carla_recap.recording import Recording
    from carla_recap.replay import Follow
    from carla_recap.replay.player import Progress
    from carla_recap.replay.scene import SceneBatch
    from carla_recap.scene.appearance import Look
    from carla_recap.util.arrays import Floats

VERSION: Final = (3, 7, 0)
"""The version of OSI."""
GROUND_TRUTH: Final = "osi3.GroundTruth"
MAP: Final = "osi3.MapAsamOpenDrive"
_LEVEL: Final = 3
_METADATA: Final = "net.asam.osi.trace"
_OSI: Final = ".".join(map(str, VERSION))
_TRUTHS, _MAP = "ground_truth", "ground_truth_map"


def export_osi(
    source: Recording,
    destination: Path | str,
    *,
    follow: Follow | None = None,
    start: float = 0.0,
    duration: float = 0.0,
    opendrive: Path | str | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Played:
    """Write a recording as an OSI trace, whose host vehicle is the followed actor, or the hero without one; see `export`.

    The trace contains the map of the town if its OpenDRIVE file is given. Return the number of messages, and the seconds
    that they span.
    """
    reader = source.reader
    check_destination(reader.location, destination, force=force)
    content = None if opendrive is None else read_text(Path(opendrive))
    heroes = [actor.id for actor in source.heroes]
    player = Player(source, start=start, duration=duration, follow=follow)
    host = player.followed if follow is not None else next(iter(heroes), None)
    name = readable(reader.header.map_name)
    truths = GroundTruths(host, name if content is not None else "")
    of_channel = {f"{_METADATA}.channel.osi_version": _OSI, f"{_METADATA}.channel.protobuf_version": version("protobuf")}
    messages = {_TRUTHS: GROUND_TRUTH} | ({} if content is None else {_MAP: MAP})
    topics = [message_topic(topic, message_class(message), of_channel) for topic, message in messages.items()]
    times: list[int] = []
    with MessageFile(destination, topics, _about(reader.header, reader.path.name), level=_LEVEL, force=force) as file:
        if content is not None:
            file.write(_MAP, 0, message_class(MAP)(map_reference=name, open_drive_xml_content=content).SerializeToString())
        for batch in player.batches(progress):
            for time, message in truths.messages(batch):
                if not times or time > times[-1]:
                    file.write(_TRUTHS, time, message.SerializeToString())
                    times.append(time)
    return Played(len(times), (times[-1] - times[0]) / 1e9 if times else 0.0)


def _about(header: Header, name: str) -> dict[str, dict[str, str]]:
    """Return the metadata of a trace by their names."""
    protobuf = version("protobuf")
    trace = {
        "version": "1.0.0",
        "min_osi_version": _OSI,
        "max_osi_version": _OSI,
        "min_protobuf_version": protobuf,
        "max_protobuf_version": protobuf,
        "zero_time": _iso(header.date),
        "creation_time": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "description": f"{name}, a recording of CARLA in {readable(header.map_name)}",
        "data_sources": f"carla-recap {version('carla-recap')}",
    }
    return {_METADATA: trace, EXPORT_METADATA: {"viewer": "osi"}}


def _iso(seconds: int) -> str:
    """Return a time as ISO 8601; that of 1970 for one that is out of range."""
    try:
        return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    except (OverflowError, OSError, ValueError):
        return "1970-01-01T00:00:00Z"


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
        finite: Any = np.isfinite(poses).all(axis=2)
        poses[~finite] = 0  # these are not written
        velocities, accelerations = np.nan_to_num(self._motion.velocities(batch)), np.nan_to_num(self._motion.accelerations)
        rotations = np.radians(wrap(poses[..., ROTATION]))
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


def message_class(name: str) -> Any:
    """Return the class of a message, such as `osi3.GroundTruth`; a `MissingExtra` without betterosi."""
    return GetMessageClass(_pool().FindMessageTypeByName(name))


@cache
def _pool() -> DescriptorPool:
    """Return a pool of our own: another program in this process may have OSI's messages in the common one."""
    pool = DescriptorPool()
    for file in _descriptors().file:
        pool.AddSerializedFile(file.SerializeToString())
    return pool


@cache
def _descriptors() -> FileDescriptorSet:
    # The package itself, with a class for each message in another library's form, is not imported.
    spec = find_spec("betterosi")
    folders = spec.submodule_search_locations if spec else None
    for folder in folders or ():
        path = Path(folder, "generated", ".".join(map(str, VERSION)), "osi3_descriptor_set.pb")
        if path.is_file():
            return FileDescriptorSet.FromString(path.read_bytes())
    raise MissingExtra("an export to OSI", "osi")
