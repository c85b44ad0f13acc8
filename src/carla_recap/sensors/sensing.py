"""What a rig on an actor of a recording would have measured, as arrays.

with carla_recap.open_recording("crash.mcap") as recording:
    for frame in carla_recap.sense(recording, SensorRig.load("rig.json")):
        for id, sample in frame.samples.items():
            print(frame.time, id, sample.pose, sample.data)
"""

from __future__ import annotations

import math
import warnings
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.lives import HERO, find_actor, heroes_of
from carla_recap.model.presence import FAR
from carla_recap.model.records import CM
from carla_recap.replay import Player
from carla_recap.replay.motion import SceneMotion
from carla_recap.replay.pose import ANGULAR_MIRROR, LOCATION, MIRROR, YAW, attach, left_handed, right_handed, rotations
from carla_recap.replay.recorded_map import load_map_of
from carla_recap.roads.files import read_text
from carla_recap.scene.actor_instances import described_instances
from carla_recap.scene.description import SceneDescriber
from carla_recap.sensors.cameras import PlacedSensor, RigCameras, camera_of
from carla_recap.sensors.carrier_motion import CarrierMotion
from carla_recap.sensors.options import SensingOptions
from carla_recap.sensors.position import Gnss, Imu, acceleration_at, geo_reference
from carla_recap.sensors.ray_process import MAX_STEP, MOMENTS_AHEAD, RAY_KINDS, RayMoment, RayProcess, processes_for
from carla_recap.util.child import started_ahead

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator
    from pathlib import Path
    from typing import Unpack

    from numpy.typing import NDArray

    from carla_recap.model.lives import ActorName
    from carla_recap.recording import Recording
    from carla_recap.rendering.camera import Camera
    from carla_recap.replay import Scene
    from carla_recap.replay.player import Progress
    from carla_recap.roads import RoadMap
    from carla_recap.scene.description import SceneDescription, Uncut
    from carla_recap.sensors.carrier_motion import Motion
    from carla_recap.sensors.options import SensingKeywords
    from carla_recap.sensors.rig import SensorRig, SensorSpec
    from carla_recap.town.mesh import TownMesh
    from carla_recap.util.arrays import Floats


FIX: Final = np.dtype([("latitude", "<f8"), ("longitude", "<f8"), ("altitude", "<f8")])
"""A position: latitude and longitude in degrees, altitude in m."""
INERTIA: Final = np.dtype([("acceleration", "<f8", (3,)), ("angular_velocity", "<f8", (3,)), ("compass", "<f8")])
"""What an IMU measures: acceleration with gravity in m/s², angular velocity in rad/s, radians clockwise from north."""

_PIXELS_AHEAD: Final = 1 << 25  # of the images of these moments: 128 MB of bytes as they are drawn
_USUAL_STEP: Final = 0.05  # s between two frames


@dataclass(frozen=True, eq=False)
class Sample:
    """What a sensor measures at a moment.

    Attributes:
        spec: The sensor.
        time: The moment, in elapsed seconds.
        pose: The pose of the sensor in the world, in m and degrees, right-handed (x forward, y left, z up), (6,).
        data: The values. Of a camera, an array (height, width) or (height, width, channels): rgb: red, green, blue, uint8;
            depth: m along the axis of view, float32, infinite for the sky and from 1,000 m on; semantic_segmentation:
            CARLA's tags, uint8; instance_segmentation: ids of actors, uint32, 0 for none; normals: in the axes of the
            world, right-handed, float32; optical_flow: motion since the image before in pixels, to the right and down,
            float32. Of other sensors, a structured array: `POINT`s of a lidar, `SEMANTIC_POINT`s of a semantic lidar,
            `DETECTION`s of a radar; a single `FIX` of a GNSS receiver, `INERTIA` of an IMU; of a speedometer, the forward
            speed in m/s. Points and vectors are in the sensor's axes, right-handed.
        velocity: The velocity of a radar's carrier in the world in m/s, right-handed, (3,); None of other sensors.
    """

    spec: SensorSpec
    time: float
    pose: Floats
    data: NDArray[Any]
    velocity: Floats | None = None

    @property
    def camera(self) -> Camera:
        """The camera, of a sample of one: it projects points in the world to pixels."""
        return camera_of(self.spec, self.pose)


@dataclass(frozen=True, eq=False)
class SensedFrame:
    """A moment of a recording, and what the sensors of a rig measure then.

    Attributes:
        time: The moment, in elapsed seconds.
        scene: The recording at the moment.
        description: What is to be seen of it; a description of this one scene.
        carrier: The id of the actor that carries the rig; None while there is none.
        carrier_pose: Its pose in m and degrees, right-handed, (6,); NaN while there is none, or it is unknown.
        samples: The samples by the ids of the sensors, without those of sensors that are not due.
    """

    time: float
    scene: Scene
    description: SceneDescription
    carrier: int | None
    carrier_pose: Floats
    samples: Mapping[str, Sample]


def sense(
    recording: Recording, rig: SensorRig, *, progress: Progress | None = None, **options: Unpack[SensingKeywords]
) -> Generator[SensedFrame]:
    """Return what the sensors of a rig on an actor of a recording would have measured, moment by moment.

    The rig sees the town of the recording's map, or without one, roads where its vehicles have driven; and the recorded
    actors. A sensor measures at each moment, or if it has a `sensor_tick`, at the first moment after each multiple of it.
    While the actor is absent, or its pose is unknown, there are no samples.

    Args:
        recording: The recording; it must stay open.
        rig: The sensors.
        progress: Is given all scenes and the player, and passes the scenes on.
        options: The fields of `carla_recap.sensors.options.SensingOptions`: `actor`, which carries the sensors; `start`,
            `duration` and `rate`, which say when they measure; `road_map`; and `quality`, that of RGB images.

    Returns:
        An iterator of the moments. Closing it ends what draws.

    Raises:
        RecapError: There is no such time or actor; or, from the iterator, the map cannot be read, or there is no driver to
            draw with and no sensor that is no camera.
        FormatError: The recording contradicts its format, from the iterator, too.
        MissingExtra: An optional dependency is not installed, from the iterator.

    Warns:
        RecapWarning: There is no map; or there is no driver, and the samples of cameras are missing.
    """
    return sensed_frames(recording, rig, SensingOptions(**options), progress)


def sensed_frames(
    recording: Recording,
    rig: SensorRig,
    options: SensingOptions,
    progress: Progress | None = None,
    uncut: Uncut | None = None,
) -> Generator[SensedFrame]:
    """Return the same, given the options as an object; see `sense`.

    `uncut` is what the recording is a clip of, if that is known: what has happened before is seen then.
    """
    return _Sensing(recording, rig, options, uncut).frames(progress)


class _Town:
    """The town of a recording, loaded when it is first asked for."""

    def __init__(self, recording: Recording, road_map: Path | str | None, player: Player) -> None:
        self._recording = recording
        self._road_map = road_map
        self._span = player.start, player.stop - player.start

    def mesh(self) -> TownMesh | None:
        """Return the surfaces; None if there are none."""
        return self._found[0]

    def opendrive(self) -> str:
        """Return the text of the map; empty without one."""
        path = self._found[1]
        return "" if path is None else read_text(path)

    @cached_property
    def _found(self) -> tuple[TownMesh | None, Path | None]:
        """The surfaces and the map that they are of; None where vehicles have driven along roads of no known map."""
        from carla_recap.town.mesh import load_town_mesh, town_of_map

        def load(path: Path) -> tuple[TownMesh | None, Path | None]:
            return load_town_mesh(path), path

        def convert(corridors: RoadMap) -> tuple[TownMesh | None, Path | None]:
            return town_of_map(corridors), None

        found = load_map_of(self._recording, self._road_map, load, convert, *self._span, longest=math.inf)
        mesh, path = found or (None, None)
        if path is None:
            name = self._recording.header.map_name or "without a name"
            seen = "the ground is missing" if mesh is None else "the roads are where vehicles have driven"
            text = f"{self._recording.location}: the map {name} is not found: {seen}"
            warnings.warn(text, RecapWarning, stacklevel=2)
        return mesh, path


class _Moment(NamedTuple):
    """A moment of the carrier."""

    motion: Motion | None  # its motion; None if no sensor needs it
    pose: Floats  # its pose in m and degrees, right-handed


_Instrument = Callable[[_Moment, "Floats"], "NDArray[Any]"]
"""Returns what a sensor measures at a moment, given its pose in m and degrees, right-handed."""


@dataclass(eq=False)
class _Clock:
    """When a sensor is due."""

    interval: float  # the seconds between two samples; 0: each moment counts
    first: float | None = None  # the elapsed seconds of the first sample; None before that
    ticks: int = 0  # how many intervals have passed until the latest sample

    def is_due(self, time: float) -> bool:
        """Return whether the sensor measures at a time, the next one in elapsed seconds."""
        if self.first is None:
            self.first, self.ticks = time, 0
            return True
        if self.interval <= 0:
            return True
        ticks = math.floor((time - self.first + SAME_TIME) / self.interval)
        is_due, self.ticks = ticks > self.ticks, max(ticks, self.ticks)
        return is_due


class _Sensing:
    """Senses a recording; see `sensed_frames` for the arguments."""

    def __init__(self, recording: Recording, rig: SensorRig, options: SensingOptions, uncut: Uncut | None) -> None:
        find_actor(recording.location, recording.actors.lives, options.actor, purpose="to carry the rig")
        duration = 0.0 if math.isinf(options.duration) else options.duration
        self._recording = recording
        self._options = options
        self._player = Player(recording, start=options.start, duration=duration)
        self._town = _Town(recording, options.road_map, self._player)
        self._rig = tuple(rig)
        self._mounts = np.array(
            [(*(value / CM for value in (spec.x, spec.y, spec.z)), spec.roll, spec.pitch, spec.yaw) for spec in self._rig]
        )
        self._clocks = {spec.id: _Clock(spec.number("sensor_tick")) for spec in self._rig}
        self._describer = SceneDescriber()
        if uncut is None:
            self._describer.recall(self._player)
        else:
            self._describer.recall_uncut(uncut)
        self._needs_motion = any(spec.kind in ("imu", "speedometer", "radar") for spec in self._rig)
        self._motions: dict[int, CarrierMotion] = {}
        self._scene_motion = SceneMotion() if any(spec.kind == "radar" for spec in self._rig) else None
        self._cameras: RigCameras | None = None
        self._rays: RayProcess | None = None
        self._instruments: dict[str, _Instrument] = {}
        self._carrier: int | None = None

    def frames(self, progress: Progress | None) -> Generator[SensedFrame]:
        """Yield the moments; images are drawn some moments ahead."""
        with ExitStack() as stack:
            self._open(stack)
            waiting: deque[Callable[[], SensedFrame]] = deque()
            before = None
            sizes = [int(spec.number("image_size_x") * spec.number("image_size_y")) for spec in self._rig if spec.image]
            ahead = min(MOMENTS_AHEAD, _PIXELS_AHEAD // max(sum(sizes), 1))
            scenes: Iterable[Scene] = self._player.scenes(self._options.rate)
            for scene in progress(scenes, self._player) if progress else scenes:
                waiting.append(self._begin(scene, before))
                before = scene
                if len(waiting) > ahead:
                    yield waiting.popleft()()
            while waiting:
                yield waiting.popleft()()

    def _open(self, stack: ExitStack) -> None:
        """Start what draws, and make the instruments; those that cannot work are left out with a warning."""
        kinds = {spec.kind for spec in self._rig}
        casting = [spec for spec in self._rig if spec.kind in RAY_KINDS]
        with started_ahead(*processes_for(self._rig)):
            rays: RayProcess | None = None
            if casting:
                with _as_warning("lidars and radars", kinds <= RAY_KINDS):
                    town = self._town.mesh()
                    rays = stack.enter_context(closing(RayProcess(town.tiles if town is not None else (), casting)))
            if "camera" in kinds:
                from carla_recap.rendering.process import RenderProcess

                with _as_warning("cameras", kinds == {"camera"}):
                    renderer = stack.enter_context(RenderProcess(self._town.mesh, quality=self._options.quality))
                    self._cameras = RigCameras(renderer)
            if rays is not None:
                with _as_warning("lidars and radars", kinds <= RAY_KINDS):
                    rays.wait()
                    self._rays = rays
        for spec in self._rig:
            if spec.kind == "gnss":
                self._instruments[spec.id] = _gnss(spec, self._town.opendrive())
            elif spec.kind in ("imu", "speedometer"):
                self._instruments[spec.id] = _imu(spec) if spec.kind == "imu" else _speed

    def _begin(self, scene: Scene, before: Scene | None) -> Callable[[], SensedFrame]:
        """Begin to sense a moment; return what waits for the images."""
        description = self._describer.describe(scene.batch)
        carrier, pose = carrier_of(scene, self._options.actor)
        if carrier != self._carrier and self._cameras is not None:
            self._cameras.forget()
        self._carrier = carrier
        moving = None if self._scene_motion is None else np.nan_to_num(self._scene_motion.velocities(scene.batch)[0])
        images: list[Callable[[], dict[str, NDArray[Any]]]] = []
        motion: Motion | None = None
        placed: list[PlacedSensor] = []
        values: dict[str, NDArray[Any]] = {}
        rays: RayProcess | None = None
        if carrier is not None and (np.abs(pose) < FAR).all():  # not so if any is NaN
            due = [row for row, spec in enumerate(self._rig) if self._clocks[spec.id].is_due(scene.time)]
            if due:
                poses = right_handed(attach(left_handed(pose), self._mounts[due]))
                instances = described_instances(description, marks=False)
                motion = self._motion_of(carrier).at(scene.time) if self._needs_motion else None
                moment = _Moment(motion, pose)
                placed = [PlacedSensor(self._rig[row], own) for row, own in zip(due, poses, strict=True)]
                cameras = [sensor for sensor in placed if sensor.spec.kind == "camera"]
                casting = [(sensor.spec.id, sensor.pose) for sensor in placed if sensor.spec.kind in RAY_KINDS]
                if casting and self._rays is not None:
                    rays = self._rays
                    others = instances.take(~np.isin(instances.ids, list(_with_attached(scene, carrier))))
                    velocity = None if motion is None else motion.velocity
                    rays.begin(RayMoment(casting, self._step(scene, before), others, scene.ids, moving, velocity))
                if cameras and self._cameras is not None:
                    images = self._cameras.submit(cameras, instances, scene, _boxes_around(description, carrier))
                for spec, own in placed:
                    if spec.id in self._instruments:
                        values[spec.id] = self._instruments[spec.id](moment, own)

        def finished() -> SensedFrame:
            if rays is not None:
                values.update(rays.points())
            for wait in images:
                values.update(wait())
            samples = {}
            for spec, own in sorted(placed, key=lambda sensor: sensor.spec.kind == "camera"):
                if spec.id in values:
                    velocity = motion.velocity if motion is not None and spec.kind == "radar" else None
                    samples[spec.id] = Sample(spec, scene.time, own, values[spec.id], velocity)
            return SensedFrame(scene.time, scene, description, carrier, pose, samples)

        return finished

    def _step(self, scene: Scene, before: Scene | None) -> float:
        """Return the seconds between a scene and the one before."""
        if before is not None:
            return scene.time - before.time
        if self._options.rate is not None:
            return 1 / self._options.rate
        step = scene.frame.duration  # -1 in the last frame
        return step if 0 < step < MAX_STEP else _USUAL_STEP

    def _motion_of(self, carrier: int) -> CarrierMotion:
        if carrier not in self._motions:
            self._motions[carrier] = CarrierMotion(self._recording, carrier, self._player.start, self._player.stop)
        return self._motions[carrier]


@contextmanager
def _as_warning(sensors: str, is_all: bool) -> Iterator[None]:
    """Warn that sensors cannot work, where the `with` block raises why; raise it if they are all sensors of the rig."""
    try:
        yield
    except RecapError as error:
        if is_all:
            raise
        warnings.warn(f"{sensors} measure nothing: {error}", RecapWarning, stacklevel=3)


def carrier_of(scene: Scene, actor: ActorName) -> tuple[int | None, Floats]:
    """Return which actor carries a rig in a scene, and its pose.

    The id is None while there is none; the pose is in m and degrees, right-handed, (6,), NaN if it is unknown.
    """
    if actor == HERO:
        heroes = heroes_of(scene.actors.values())
        id = heroes[0].id if heroes else None
    else:
        id = int(actor) if int(actor) in scene.actors else None
    pose = None if id is None else scene.pose_of(id)
    return id, np.full(6, np.nan) if pose is None else right_handed(pose)


def _with_attached(scene: Scene, carrier: int) -> frozenset[int]:
    """Return an actor and what is attached to it."""
    found, grows = {carrier}, True
    attached = [(actor.id, actor.parent) for actor in scene.actors.values() if actor.attached]
    while grows:
        more = {id for id, parent in attached if parent in found} - found
        found |= more
        grows = bool(more)
    return frozenset(found)


def _boxes_around(description: SceneDescription, carrier: int) -> Callable[[SensorSpec], frozenset[int]]:
    """Return what tells whether the carrier is hidden from a sensor: it is inside its box, which would hide everything."""
    look = description.actors.look_of(carrier)

    def hidden(spec: SensorSpec) -> frozenset[int]:
        if look is None:
            return frozenset()
        offset = np.array((spec.x, -spec.y, spec.z)) - look.center
        return frozenset((carrier,)) if (np.abs(offset) < look.half_extents).all() else frozenset()

    return hidden


# --- instruments: what measures without being drawn --------------------------------------------------------------------


def _gnss(spec: SensorSpec, opendrive: str) -> _Instrument:
    receiver = Gnss(spec.number, geo_reference(opendrive))

    def measure(moment: _Moment, pose: Floats) -> NDArray[np.void]:
        return np.array(tuple(receiver.measure(pose[LOCATION] * MIRROR)), FIX)

    return measure


def _imu(spec: SensorSpec) -> _Instrument:
    device = Imu(spec.number)

    def measure(moment: _Moment, pose: Floats) -> NDArray[np.void]:
        motion = moment.motion
        assert motion is not None
        turned = rotations(pose) * MIRROR[:, None] * MIRROR
        offset = (pose - moment.pose)[LOCATION]
        acceleration = acceleration_at(offset, motion.acceleration, motion.rotation, motion.angular_acceleration)
        felt, turning, compass = device.measure(
            turned, -float(pose[YAW]), acceleration * MIRROR, motion.rotation * ANGULAR_MIRROR
        )
        return np.array((felt * MIRROR, turning * ANGULAR_MIRROR, compass), INERTIA)

    return measure


def _speed(moment: _Moment, pose: Floats) -> NDArray[np.float64]:
    """Return the speed along the heading of the carrier, as the Leaderboard's speedometer, wherever this one looks."""
    assert moment.motion is not None
    return np.array(moment.motion.velocity @ rotations(moment.pose)[:, 0])
