"""Bags of ROS 2: MCAP files with the messages that RViz, Rerun and programs for ROS read.

| Topic                             | Message                        | What                                                 |
|-----------------------------------|--------------------------------|------------------------------------------------------|
| `/clock`                          | rosgraph_msgs/Clock            | the recorded time                                    |
| `/tf`, `/tf_static`               | tf2_msgs/TFMessage             | from `map` to `hero/base_link`, from there to sensors|
| `/odom`                           | nav_msgs/Odometry              | pose and velocities of the hero                      |
| `/markers`                        | visualization_msgs/MarkerArray | boxes of vehicles, walkers, others; collisions marked|
| `/markers/traffic_lights`         | visualization_msgs/MarkerArray | in the colours of their states, whenever one changes |
| `/markers/roads`                  | visualization_msgs/MarkerArray | the lines of the roads, once                         |
| `/sensors/<id>/image/compressed`  | sensor_msgs/CompressedImage    | RGB images as JPEG                                   |
| `/sensors/<id>/image`             | sensor_msgs/Image              | depth in mm (16UC1), semantic tags, ids and others   |
| `/sensors/<id>/camera_info`       | sensor_msgs/CameraInfo         | the pinhole of a camera                              |
| `/sensors/<id>/points`            | sensor_msgs/PointCloud2        | of lidars and radars                                 |
| `/sensors/<id>/fix`, `imu`        | sensor_msgs/NavSatFix, Imu     | of GNSS receivers and IMUs                           |
| `/sensors/<id>/speed`             | std_msgs/Float32               | in m/s                                               |

Positions are in m, angles in radians, axes right-handed: x forward, y left, z up; those of a camera's frame are x right, y
down, z forward.
"""

from __future__ import annotations

import re
import warnings
from contextlib import closing
from heapq import merge
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import FormatError, MissingExtra, RecapWarning
from carla_recap.formats.mcap.schema import SECOND, LogClock
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.lives import HERO
from carla_recap.model.presence import FAR
from carla_recap.queries.sensors import check_new
from carla_recap.replay import Played, Player, quaternions
from carla_recap.replay.pose import LOCATION, quaternions_of, rotations
from carla_recap.replay.recorded_map import load_map_of
from carla_recap.roads import load_map
from carla_recap.scene import style
from carla_recap.scene.actor_instances import described_instances
from carla_recap.scene.description import SceneDescriber
from carla_recap.scene.lamps import state_of_lamps
from carla_recap.scene.marks import MARK_RADIUS
from carla_recap.scene.materials import MATERIALS, Material
from carla_recap.util.files import check_folder, new_folder

try:
    import foxglove_schemas_protobuf  # noqa: F401
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    raise MissingExtra("an export to rosbag2", "ros") from None

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError

from carla_recap.sensors.carrier_motion import CarrierMotion
from carla_recap.sensors.messages import TRANSFORMS, SensorMessages, frame_rotation
from carla_recap.sensors.options import SensingOptions
from carla_recap.sensors.rig import SensorRig, as_rig
from carla_recap.sensors.sensing import carrier_of, sensed_frames
from carla_recap.util.text import single_line
from carla_recap.v1.sensors_pb2 import ImuReading, SpeedReading

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from carla_recap.model.lives import ActorName
    from carla_recap.recording import Recording
    from carla_recap.replay import Scene
    from carla_recap.replay.player import Progress
    from carla_recap.scene.description import SceneDescription
    from carla_recap.util.arrays import Floats

    Sensed = tuple[str, float, bytes]  # topic, elapsed seconds, message

MAP: Final = "map"
"""The frame of all positions."""

_MARKERS: Final = "/markers"
_LIGHTS: Final = "/markers/traffic_lights"
_ROADS: Final = "/markers/roads"
_STATIC: Final = "/tf_static"
_LATCHED: Final = (_STATIC, _LIGHTS, _ROADS)
_FOREVER: Final = QosTime(9_223_372_036, 854_775_807)
_LATEST: Final = (1 << 31) * SECOND  # ns since 1970, which ROS counts in 32 bits
_ADD, _DELETE, _DELETE_ALL = 0, 2, 3
_CUBE, _CYLINDER, _LINES = 1, 3, 5
_FIELD_TYPES: Final = {1: 2, 2: 1, 3: 4, 4: 3, 5: 6, 6: 5, 7: 7, 8: 8}  # Foxglove's numbers of types, and ROS's
_NO_TURN: Final = (0.0, 0.0, 0.0, 1.0)

_STORE: Final = get_typestore(Stores.ROS2_JAZZY)


def export_rosbag(
    source: Recording,
    destination: Path | str,
    *,
    rig: SensorRig | Path | str | None = None,
    actor: ActorName = HERO,
    start: float = 0.0,
    duration: float = 0.0,
    opendrive: Path | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Played:
    """Write a recording as a bag of ROS 2: its scene, and the data of its sensors and of those of a rig, or of its file.

    The actor of the odometry carries the rig; see `export`. Return the number of scenes, and the seconds that they span. A
    `RecapWarning` says that the actor has no pose, so that there is no odometry, or that moments or videos are left out.
    """
    check_folder(destination, force=force)
    folder = Path(destination).absolute()
    found = None if rig is None else as_rig(rig)
    player = Player(source, start=start, duration=duration)
    with new_folder(destination) as partial:
        bag = partial / folder.name
        export = _Export(source, found, actor, player, opendrive)
        writer = Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            played = export.write(writer, progress)
        for file in bag.iterdir():
            file.rename(partial / file.name)
        bag.rmdir()
    export.warn()
    return played


class _Export:
    """Writes the part of a recording that a player has, with further sensors; see `export_rosbag`."""

    def __init__(
        self, source: Recording, rig: SensorRig | None, actor: ActorName, player: Player, opendrive: Path | None
    ) -> None:
        self._source, self._rig, self._actor, self._player, self._map = source, rig, actor, player, opendrive
        self._base = f"{HERO if actor == HERO else f'actor_{actor}'}/base_link"
        self._clock = LogClock(source.header)
        self._describer = SceneDescriber()
        self._motions: dict[int, CarrierMotion] = {}
        self._shown: set[tuple[str, int]] | None = None
        self._lights: Any = None
        self._connections: dict[str, Any] = {}
        check_new(source.reader, (spec.id for spec in rig or ()))
        self._messages = None if rig is None else SensorMessages(rig, source.header)
        further = source.reader.further_topics()
        names = [name for sensor in source.sensors for name in sensor.topics]
        self._names = [*names, *((TRANSFORMS,) if names and TRANSFORMS in further else ())]
        self._schemas = {name: further[name].topic.message for name in self._names}
        if self._messages is not None:
            self._schemas |= {topic.name: topic.message for topic in self._messages.topics}
        self._left_out: set[str] = set()
        self._odometry = self._late = 0

    def write(self, writer: Writer, progress: Progress | None) -> Played:
        """Write everything; return the number of scenes, and the seconds that they span."""
        self._writer = writer
        self._describer.recall(self._player)
        count, first, last = 0, self._player.start, self._player.start
        stop = self._player.stop + 2 * SAME_TIME
        stored = self._source.reader.further_messages(self._names, self._player.start, stop) if self._names else iter(())
        parts: tuple[Iterable[tuple[float, Scene | None, list[Sensed]]], ...] = (
            self._moments(progress),
            ((message.elapsed, None, [message]) for message in stored),
        )
        for elapsed, scene, messages in merge(*parts, key=itemgetter(0)):
            time = self._clock.at(elapsed)
            if time is None or time >= _LATEST:
                self._late += 1
                continue
            if scene is not None:
                if not count:
                    self._write_start(time)
                    first = elapsed
                self._write_scene(scene, time)
                count, last = count + 1, elapsed
            for topic, _, data in messages:
                if topic != TRANSFORMS or scene is None:  # the mounts of a rig are static
                    self._write_sensed(topic, data, elapsed, time)
        return Played(count, last - first)

    def warn(self) -> None:
        """Warn of what the bag does not have."""
        texts = []
        if not self._odometry:
            name = "the hero" if self._actor == HERO else f"actor {self._actor}"
            texts.append(f"{name} has no pose: the bag has no /odom and no {self._base}")
        if self._late:
            texts.append(f"{self._late} moments are left out: ROS has times from 1970 to 2038")
        if self._left_out:
            texts.append(f"left out, as ROS has no such messages: {', '.join(sorted(self._left_out)):.500}")
        for text in texts:
            warnings.warn(f"{self._source.location}: {text}", RecapWarning, stacklevel=3)

    def _moments(self, progress: Progress | None) -> Iterator[tuple[float, Scene, list[Sensed]]]:
        if self._rig is None or self._messages is None:
            scenes: Iterable[Scene] = self._player.scenes()
            for scene in progress(scenes, self._player) if progress else scenes:
                yield scene.time, scene, []
            return
        start, duration = self._player.start, self._player.stop - self._player.start
        part = SensingOptions(actor=self._actor, start=start, duration=duration, road_map=self._map)
        frames = sensed_frames(self._source, self._rig, part, progress)
        with closing(frames), closing(self._messages.encoded(frames)) as encoded:
            for frame, messages in encoded:
                yield frame.time, frame.scene, [*messages]

    # --- scene ---------------------------------------------------------------------------------------------------------

    def _write_start(self, time: int) -> None:
        """Write what never changes: the mounts of the rig, the roads."""
        mounts = []
        for spec in self._rig or ():
            pose = np.array((spec.x, -spec.y, spec.z, spec.roll, -spec.pitch, -spec.yaw))
            mounts.append(_transform(self._base, spec.id, pose[LOCATION], frame_rotation(spec, pose), time))
        if mounts:
            self._write(_STATIC, "tf2_msgs/msg/TFMessage", time, transforms=mounts)
        roads = load_map_of(self._source, self._map, load_map, lambda corridors: corridors)
        markers = []
        for number, (name, color, width) in enumerate(style.ROADS):
            lines = [np.repeat(line, 2, axis=0)[1:-1] for line in getattr(roads, name, ()) if len(line) > 1]
            if lines:
                markers.append(_marker("roads", number, _LINES, time, scale=(width, 0.0, 0.0), color=color))
                markers[-1].points = [
                    _make("geometry_msgs/msg/Point", x=x, y=y, z=z) for x, y, z in np.concatenate(lines).tolist()
                ]
        if markers:
            self._write(_ROADS, "visualization_msgs/msg/MarkerArray", time, markers=markers)

    def _write_scene(self, scene: Scene, time: int) -> None:
        batch = scene.batch if len(scene.batch) == 1 else scene.batch[scene.row : scene.row + 1]
        self._write("/clock", "rosgraph_msgs/msg/Clock", time, clock=_time(time))
        carrier, pose = carrier_of(scene, self._actor)
        if carrier is not None and (np.abs(pose) < FAR).all():  # not so if any is NaN
            self._write_odometry(carrier, pose, scene.time, time)
        self._write_markers(self._describer.describe(batch), time)

    def _write_odometry(self, carrier: int, pose: Floats, elapsed: float, time: int) -> None:
        if carrier not in self._motions:
            self._motions[carrier] = CarrierMotion(self._source, carrier, self._player.start, self._player.stop)
        motion, own = self._motions[carrier].at(elapsed), rotations(pose).T
        turn = quaternions(pose)
        transforms = [_transform(MAP, self._base, pose[LOCATION], turn, time)]
        self._write("/tf", "tf2_msgs/msg/TFMessage", time, transforms=transforms)
        linear, angular = _vector(own @ motion.velocity), _vector(own @ np.radians(motion.rotation))
        unknown, twist = np.zeros(36), _make("geometry_msgs/msg/Twist", linear=linear, angular=angular)
        self._write(
            "/odom",
            "nav_msgs/msg/Odometry",
            time,
            header=_header(MAP, time),
            child_frame_id=self._base,
            pose=_make("geometry_msgs/msg/PoseWithCovariance", pose=_pose(pose[LOCATION], turn), covariance=unknown),
            twist=_make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=unknown),
        )
        self._odometry += 1

    def _write_markers(self, description: SceneDescription, time: int) -> None:
        found = described_instances(description, marks=False)
        turns, sizes = quaternions_of(found.rotations), 2.0 * found.half_extents.astype(np.float64)
        markers: list[Any] = []
        lights: list[Any] = []
        for row, id in enumerate(found.ids.tolist()):
            life, lamps = description.lives[id], int(found.lamps[row])
            is_light = life.kind == "traffic_light"
            color = found.colors[row].tolist()
            if is_light:
                color = style.light(state_of_lamps(lamps))[1]
            marker = _marker(
                life.kind,
                id,
                _CUBE,
                time,
                _pose(found.locations[row], turns[row]),
                sizes[row].tolist(),
                color,
                float(found.opacity[row]),
            )
            (lights if is_light else markers).append(marker)
        mark = MATERIALS[Material.COLLISION_MARK].color
        for number, place in enumerate(description.marks_at(0)):
            size = 2 * MARK_RADIUS, 2 * MARK_RADIUS, 0.01
            markers.append(_marker("collision", number, _CYLINDER, time, _pose(place, _NO_TURN), size, mark))
        shown = {(marker.ns, marker.id) for marker in markers}
        if self._shown is None:
            markers.insert(0, _marker("", 0, _CUBE, time, action=_DELETE_ALL))
        else:
            markers += [_marker(ns, id, _CUBE, time, action=_DELETE) for ns, id in sorted(self._shown - shown)]
        self._shown = shown
        self._write(_MARKERS, "visualization_msgs/msg/MarkerArray", time, markers=markers)
        state = [(each.id, each.color, each.pose) for each in lights]
        if state != self._lights and (lights or self._lights):
            self._lights = state
            lights.insert(0, _marker("", 0, _CUBE, time, action=_DELETE_ALL))
            self._write(_LIGHTS, "visualization_msgs/msg/MarkerArray", time, markers=lights)

    # --- sensors -------------------------------------------------------------------------------------------------------

    def _write_sensed(self, topic: str, data: bytes, elapsed: float, time: int) -> None:
        """Write a message of a sensor; a `FormatError` if it contradicts its schema."""
        translate = _TRANSLATIONS.get(self._schemas[topic])
        if translate is None:
            self._left_out.add(topic)
            return
        id = topic.split("/")[2]
        try:
            name, type, fields = translate(data, id, time)
        except (DecodeError, ValueError) as error:
            text = f"a message of {topic:.200} at {elapsed:g} s: {single_line(error):.200}"
            raise FormatError(self._source.location, None, text) from None
        self._write(name if name.startswith("/") else f"/sensors/{_name(id)}/{name}", type, time, **fields)

    def _write(self, topic: str, type: str, time: int, /, **fields: Any) -> None:
        if topic not in self._connections:
            durability = QosDurability.TRANSIENT_LOCAL if topic in _LATCHED else QosDurability.VOLATILE
            depth = 1 if topic in _LATCHED else 10
            qos = Qos(
                QosHistory.KEEP_LAST,
                depth,
                QosReliability.RELIABLE,
                durability,
                _FOREVER,
                _FOREVER,
                QosLiveliness.AUTOMATIC,
                _FOREVER,
                avoid_ros_namespace_conventions=False,
            )
            self._connections[topic] = self._writer.add_connection(topic, type, typestore=_STORE, offered_qos_profiles=[qos])
        self._writer.write(self._connections[topic], time, _STORE.serialize_cdr(_make(type, **fields), type))


# --- messages ------------------------------------------------------------------------------------------------------------


def _make(type: str, /, **fields: Any) -> Any:
    return _STORE.types[type](**fields)


def _time(time: int) -> Any:
    seconds, nanoseconds = divmod(time, SECOND)
    return _make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)


def _header(frame: str, time: int) -> Any:
    return _make("std_msgs/msg/Header", stamp=_time(time), frame_id=frame)


def _vector(values: Iterable[float]) -> Any:
    x, y, z = map(float, values)
    return _make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _rotation(turn: Iterable[float]) -> Any:
    x, y, z, w = map(float, turn)
    return _make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _pose(location: Iterable[float], turn: Iterable[float]) -> Any:
    x, y, z = map(float, location)
    position = _make("geometry_msgs/msg/Point", x=x, y=y, z=z)
    return _make("geometry_msgs/msg/Pose", position=position, orientation=_rotation(turn))


def _transform(parent: str, child: str, location: Iterable[float], turn: Iterable[float], time: int) -> Any:
    transform = _make("geometry_msgs/msg/Transform", translation=_vector(location), rotation=_rotation(turn))
    return _make(
        "geometry_msgs/msg/TransformStamped", header=_header(parent, time), child_frame_id=child, transform=transform
    )


def _marker(
    namespace: str,
    id: int,
    type: int,
    time: int,
    pose: Any = None,
    scale: Iterable[float] = (0.0, 0.0, 0.0),
    color: Iterable[int] = (0, 0, 0),
    opacity: float = 1.0,
    *,
    action: int = _ADD,
) -> Any:
    """Return a marker; ids from 2**31 on are negative in ROS."""
    red, green, blue = (part / 255 for part in color)
    nothing = np.zeros(0, np.uint8)
    return _make(
        "visualization_msgs/msg/Marker",
        header=_header(MAP, time),
        ns=namespace,
        id=id if id < 1 << 31 else id - (1 << 32),
        type=type,
        action=action,
        pose=_pose((0.0, 0.0, 0.0), _NO_TURN) if pose is None else pose,
        scale=_vector(scale),
        color=_make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=opacity),
        lifetime=_make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=_make("sensor_msgs/msg/CompressedImage", header=_header("", 0), format="", data=nothing),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=_make("visualization_msgs/msg/MeshFile", filename="", data=nothing),
        mesh_use_embedded_materials=False,
    )


def _name(id: str) -> str:
    """Return a sensor's id as a part of a topic's name."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", id)
    return name if name[:1].isalpha() else f"sensor_{name}"


def _bytes(data: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(data, np.uint8)


def _matrix(values: Iterable[float], size: int) -> Floats:
    found = np.array(list(values), np.float64)
    if len(found) != size:
        raise ValueError(f"{len(found)} numbers of a matrix; {size} were expected")
    return found


_Translated = tuple[str, str, dict[str, Any]]  # the topic, or its last part; the type; the fields


def _image(data: bytes, id: str, time: int) -> _Translated:
    message = CompressedImage.FromString(data)
    fields = {"header": _header(id, time), "format": message.format, "data": _bytes(message.data)}
    return "image/compressed", "sensor_msgs/msg/CompressedImage", fields


def _raw_image(data: bytes, id: str, time: int) -> _Translated:
    message = RawImage.FromString(data)
    fields = {key: getattr(message, key) for key in ("width", "height", "encoding", "step")}
    fields |= {"header": _header(id, time), "is_bigendian": 0, "data": _bytes(message.data)}
    return "image", "sensor_msgs/msg/Image", fields


def _calibration(data: bytes, id: str, time: int) -> _Translated:
    message = CameraCalibration.FromString(data)
    region = _make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    fields = {
        "header": _header(id, time),
        "height": message.height,
        "width": message.width,
        "distortion_model": message.distortion_model,
        "d": np.array(list(message.D), np.float64),
        "k": _matrix(message.K, 9),
        "r": _matrix(message.R, 9),
        "p": _matrix(message.P, 12),
        "binning_x": 0,
        "binning_y": 0,
        "roi": region,
    }
    return "camera_info", "sensor_msgs/msg/CameraInfo", fields


def _points(data: bytes, id: str, time: int) -> _Translated:
    message = PointCloud.FromString(data)
    stride = message.point_stride
    if not 0 < stride <= 1 << 16 or any(field.type not in _FIELD_TYPES for field in message.fields):
        raise ValueError(f"points of {stride} bytes, or with fields of an unknown type")
    count = len(message.data) // stride
    columns = [
        _make("sensor_msgs/msg/PointField", name=each.name, offset=each.offset, datatype=_FIELD_TYPES[each.type], count=1)
        for each in message.fields
    ]
    fields = {
        "header": _header(id, time),
        "height": 1,
        "width": count,
        "fields": columns,
        "is_bigendian": False,
        "point_step": stride,
        "row_step": count * stride,
        "data": _bytes(message.data)[: count * stride],
        "is_dense": True,
    }
    return "points", "sensor_msgs/msg/PointCloud2", fields


def _fix(data: bytes, id: str, time: int) -> _Translated:
    message = LocationFix.FromString(data)
    fields = {key: getattr(message, key) for key in ("latitude", "longitude", "altitude")}
    fields |= {
        "header": _header(id, time),
        "status": _make("sensor_msgs/msg/NavSatStatus", status=0, service=1),
        "position_covariance": np.zeros(9),
        "position_covariance_type": 0,
    }
    return "fix", "sensor_msgs/msg/NavSatFix", fields


def _imu(data: bytes, id: str, time: int) -> _Translated:
    message = ImuReading.FromString(data)
    no_orientation = np.array((-1.0, *(0.0,) * 8))
    fields = {
        "header": _header(id, time),
        "orientation": _rotation(_NO_TURN),
        "orientation_covariance": no_orientation,
        "angular_velocity": _vector(getattr(message, f"angular_velocity_{axis}") for axis in "xyz"),
        "angular_velocity_covariance": np.zeros(9),
        "linear_acceleration": _vector(getattr(message, f"acceleration_{axis}") for axis in "xyz"),
        "linear_acceleration_covariance": np.zeros(9),
    }
    return "imu", "sensor_msgs/msg/Imu", fields


def _speed(data: bytes, id: str, time: int) -> _Translated:
    return "speed", "std_msgs/msg/Float32", {"data": SpeedReading.FromString(data).speed}


def _poses(data: bytes, id: str, time: int) -> _Translated:
    found = []
    for each in FrameTransforms.FromString(data).transforms:
        place, turn = each.translation, each.rotation
        location, rotation = (place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w)
        if np.isfinite((*location, *rotation)).all():
            found.append(_transform(MAP, each.child_frame_id, location, rotation, time))
    return "/tf", "tf2_msgs/msg/TFMessage", {"transforms": found}


_TRANSLATIONS: Final = {
    schema.DESCRIPTOR.full_name: translate
    for schema, translate in (
        (CompressedImage, _image),
        (RawImage, _raw_image),
        (CameraCalibration, _calibration),
        (PointCloud, _points),
        (LocationFix, _fix),
        (ImuReading, _imu),
        (SpeedReading, _speed),
        (FrameTransforms, _poses),
    )
}
"""What translates a message of each schema."""
