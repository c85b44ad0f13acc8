"""A recording as ScenarioRunner's metrics see it.

The methods are those of ScenarioRunner's class of this name, with its units: metres, m/s, degrees, CARLA's left-handed axes,
and the types of CARLA's client library. Frames count from 1, except where a method says otherwise, as there. What differs is
listed in docs/scenario-runner.md.
"""

from __future__ import annotations

import math
from collections import defaultdict
from fnmatch import fnmatch
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Self, TypeVar

import numpy as np

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.model.lives import HERO, ActorLives
from carla_recap.model.lives import TYPES as ACTOR_TYPES
from carla_recap.model.motion import steps_joined
from carla_recap.model.records import CM
from carla_recap.output.packet_lines import LIGHTS, sorted_points
from carla_recap.recording import Recording, open_recording
from carla_recap.replay.pose import ANGULAR_MIRROR, angular_velocities, right_handed
from carla_recap.tables.trajectories import actor_rows, life_numbers, trajectories
from carla_recap.util.text import number

try:
    import carla
except ImportError:
    raise MissingExtra("MetricsLog", "carla") from None

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    from carla_recap.model.lives import ActorLife
    from carla_recap.model.records import Physics
    from carla_recap.tables.trajectories import ActorRows, Trajectory
    from carla_recap.util.arrays import Floats


_EVENTS: Final = (*ACTOR_TYPES, "collisions", "trigger_volumes", "physics", "light_times", "scene_lights")
_FULL_COLOR: Final = 255
Value = TypeVar("Value")


def _in_frames(ask: Callable[[MetricsLog, int, int], Value]) -> Callable[..., list[Value]]:
    """Return the method with the values of an actor from a first frame to a last one, both included."""

    def answer(log: MetricsLog, actor_id: int, first_frame: int | None = None, last_frame: int | None = None) -> list[Value]:
        last = log.get_total_frame_count() if last_frame is None else last_frame
        return [ask(log, actor_id, frame) for frame in range(1 if first_frame is None else first_frame, last + 1)]

    return answer


def _by_actor(ask: Callable[[MetricsLog, int, int], Value]) -> Callable[..., dict[int, Value]]:
    """Return the method with the values in a frame by actor: of all that have one, or of those in a list that are there."""

    def answer(log: MetricsLog, frame: int, actor_list: Collection[int] | None = None) -> dict[int, Value]:
        return {id: ask(log, id, frame) for id in log._present(frame, actor_list)}

    return answer


class MetricsLog:
    """Answers questions about the frames and the actors of a recording.

    Args:
        recording: An open recording, a path or a URL. A path or URL is opened, and closed by `close`.

    Raises:
        RecapError: The recording cannot be read.
    """

    def __init__(self, recording: Recording | Path | str) -> None:
        self._owned = not isinstance(recording, Recording)
        self._recording = recording if isinstance(recording, Recording) else open_recording(recording)
        self._reader = self._recording.reader
        self._lives = ActorLives()  # their times are frames, counted from 1
        self._boxes: dict[str, dict[int, carla.BoundingBox]] = {"bounding_box": {}, "trigger_volume": {}}
        self._collisions: list[tuple[int, int, int]] = []  # frame, actor, other
        # By id, the frames from which on something holds, ascending, with its value.
        self._physics: defaultdict[int, list[tuple[int, Physics]]] = defaultdict(list)
        self._light_times: defaultdict[int, list[tuple[int, tuple[float, float, float]]]] = defaultdict(list)
        self._scene_lights: defaultdict[int, list[tuple[int, Any]]] = defaultdict(list)
        self._rows: dict[str, dict[int, ActorRows]] = {}
        self._turning: dict[int, Floats] = {}  # the derived angular velocities in degrees/s, (n, 3), by id
        try:
            self._read_events()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Close the recording, if this object opened it."""
        if self._owned:
            self._recording.close()

    # --- the recording -------------------------------------------------------------------------------------------------

    def get_total_frame_count(self) -> int:
        """Return the number of frames."""
        return self._reader.extent().frames

    def get_elapsed_time(self, frame: int) -> float:
        """Return the elapsed seconds of a frame, counted from 0; of a later one than the last, those of the last."""
        return float(self._clock[self._index(frame)])

    def get_delta_time(self, frame: int) -> float:
        """Return the seconds from the frame before to a frame, counted from 0; 0 for the first."""
        index = self._index(frame)
        return round(float(self._clock[index] - self._clock[index - 1]), 6) if index else 0

    def get_platform_time(self, frame: int) -> float | None:
        """Return the clock of the machine in s in a frame, counted from 0; None if it was not recorded."""
        return self._platform_times.get(self._index(frame))

    def get_actor_collisions(self, actor_id: int) -> dict[int, list[int]]:
        """Return the actors that an actor collides with, by frame, counted from 0."""
        found: dict[int, list[int]] = {}
        for frame, actor, other in self._collisions:
            if actor == actor_id:
                found.setdefault(frame - 1, []).append(other)
        return found

    # --- actors --------------------------------------------------------------------------------------------------------

    def get_ego_vehicle_id(self) -> int:
        """Return the id of the first actor with the role name hero.

        Raises:
            RecapError: There is none.
        """
        found = self.get_actor_ids_with_role_name(HERO)
        if not found:
            roles = sorted({actor.role_name for actor in self._latest_lives() if actor.role_name})
            known = ", ".join(roles[:8]) or "no role names"
            raise RecapError(f"{self._recording.location}: no actor has the role name hero; there are {known}")
        return found[0]

    def get_actor_ids_with_role_name(self, role_name: str) -> list[int]:
        """Return the ids of the actors with a role name."""
        return [actor.id for actor in self._latest_lives() if actor.attributes.get("role_name") == role_name]

    def get_actor_ids_with_type_id(self, type_id: str) -> list[int]:
        """Return the ids of the actors whose blueprint matches a pattern, such as `vehicle.*`."""
        return [actor.id for actor in self._latest_lives() if fnmatch(actor.type_id, type_id)]

    def get_actor_attributes(self, actor_id: int) -> dict[str, Any] | None:
        """Return the attributes of an actor as text, with its type_id, its location, and the frames of its life."""
        actor = self._lives.at(actor_id, math.inf)
        if actor is None:
            return None
        place = (actor.spawn.x * CM, actor.spawn.y * CM, actor.spawn.z * CM)
        found = {"type_id": actor.type_id, "location": carla.Location(*place), "created": actor.spawned_at}
        found |= actor.attributes
        later = {"destroyed": actor.destroyed_at, "parent": actor.parent}
        later |= {key: boxes.get(actor_id) for key, boxes in self._boxes.items()}
        return found | {key: value for key, value in later.items() if value is not None}

    def get_actor_bounding_box(self, actor_id: int) -> carla.BoundingBox | None:
        """Return the bounding box of an actor in its own axes, in m; None if it was not recorded."""
        return self._boxes["bounding_box"].get(actor_id)

    def get_traffic_light_trigger_volume(self, traffic_light_id: int) -> carla.BoundingBox | None:
        """Return the trigger volume of a traffic light, the last one of several; None if it was not recorded."""
        return self._boxes["trigger_volume"].get(traffic_light_id)

    def get_actor_alive_frames(self, actor_id: int) -> tuple[int, int] | tuple[None, None]:
        """Return the first and the last frame of an actor; None for both of an unknown one."""
        actor = self._lives.at(actor_id, math.inf)
        if actor is None:
            return None, None
        stays = actor.destroyed_at is None
        return int(actor.spawned_at), self.get_total_frame_count() if stays else int(actor.end) - 1

    # --- states --------------------------------------------------------------------------------------------------------

    def get_actor_transform(self, actor_id: int, frame: int) -> carla.Transform | None:
        """Return the transform of an actor in a frame; None if it has none."""
        path, row = self._pose(actor_id, frame)
        if path is None:
            return None
        location, rotation = _at(row, path.x, path.y, path.z), _at(row, path.pitch, path.yaw, path.roll)
        return carla.Transform(carla.Location(*location), carla.Rotation(*rotation))

    get_all_actor_transforms = _in_frames(get_actor_transform)
    get_actor_transforms_at_frame = _by_actor(get_actor_transform)

    def get_actor_velocity(self, actor_id: int, frame: int) -> carla.Vector3D | None:
        """Return the velocity of an actor in a frame in m/s, derived from its positions if it was not recorded."""
        path, row = self._pose(actor_id, frame)
        return None if path is None else carla.Vector3D(*_at(row, path.vx, path.vy, path.vz))

    get_all_actor_velocities = _in_frames(get_actor_velocity)
    get_actor_velocities_at_frame = _by_actor(get_actor_velocity)

    def get_actor_angular_velocity(self, actor_id: int, frame: int) -> carla.Vector3D | None:
        """Return the angular velocity of an actor in a frame in degrees/s.

        If it was not recorded, it is derived from its poses, in the frames that a velocity is derived from; 0 without any.
        """
        row = self._row("velocities", actor_id, frame)
        if row is not None:
            return carla.Vector3D(*(float(row[f"angular_{axis}"]) for axis in "xyz"))
        path, index = self._pose(actor_id, frame)
        if path is None:
            return None
        if actor_id not in self._turning:
            spawned = [life.spawned_at - 1 for life in self._lives if life.id == actor_id]
            life = life_numbers(self._paths[actor_id][0], spawned)
            speed = np.where(path.velocity_recorded, path.speed, np.nan)
            joined = steps_joined(path.time, np.stack((path.x, path.y, path.z)), speed, life)
            poses = right_handed(np.stack((path.x, path.y, path.z, path.roll, path.pitch, path.yaw), axis=1))
            turning = angular_velocities(path.time, poses, joined) * ANGULAR_MIRROR
            self._turning[actor_id] = np.nan_to_num(turning, posinf=0, neginf=0)
        return carla.Vector3D(*self._turning[actor_id][index].tolist())

    get_all_actor_angular_velocities = _in_frames(get_actor_angular_velocity)
    get_actor_angular_velocities_at_frame = _by_actor(get_actor_angular_velocity)

    def get_actor_acceleration(self, actor_id: int, frame: int) -> carla.Vector3D | None:
        """Return the acceleration of an actor in m/s²: the change of its velocity since the frame before; 0 in its first."""
        path, row = self._pose(actor_id, frame)
        if path is None:
            return None
        seconds = float(path.time[row] - path.time[row - 1]) if row else 0.0
        before = int(self._paths[actor_id][0][row - 1]) + 1
        if not seconds > 0 or self._lives.at(actor_id, before) is not self._lives.at(actor_id, frame):
            return carla.Vector3D(0, 0, 0)
        return carla.Vector3D(*(float(values[row] - values[row - 1]) / seconds for values in (path.vx, path.vy, path.vz)))

    get_all_actor_accelerations = _in_frames(get_actor_acceleration)
    get_actor_accelerations_at_frame = _by_actor(get_actor_acceleration)

    # --- vehicles and walkers ------------------------------------------------------------------------------------------

    def get_vehicle_control(self, vehicle_id: int, frame: int) -> carla.VehicleControl | None:
        """Return the control of a vehicle in a frame."""
        row = self._row("vehicle_controls", vehicle_id, frame)
        if row is None:
            return None
        pedals, gear = (float(row[name]) for name in ("throttle", "steer", "brake")), int(row["gear"])
        return carla.VehicleControl(*pedals, bool(row["hand_brake"]), gear < 0, False, gear)

    def get_vehicle_physics_control(self, vehicle_id: int, frame: int) -> carla.VehiclePhysicsControl | None:
        """Return the latest physics control of a vehicle up to a frame: positions of wheels in m, their radius in cm."""
        found = _latest(self._physics.get(vehicle_id, []), frame)
        return None if found is None else _physics_control(found)

    def get_walker_speed(self, walker_id: int, frame: int) -> str | None:
        """Return the speed of a walker in cm/s in a frame, as text."""
        row = self._row("walker_controls", walker_id, frame)
        return None if row is None else number(float(row["speed"]))

    def get_vehicle_lights(self, vehicle_id: int, frame: int) -> list[carla.VehicleLightState] | None:
        """Return the lights of a vehicle that are on in a frame; `[NONE]` if all are off, None if they were not recorded."""
        row = self._row("vehicle_lights", vehicle_id, frame)
        if row is None:
            return None
        states = [getattr(carla.VehicleLightState, name) for name in LIGHTS]
        return [state for state in states if int(row["flags"]) & int(state)] or [carla.VehicleLightState.NONE]

    def is_vehicle_light_active(self, light: carla.VehicleLightState, vehicle_id: int, frame: int) -> bool:
        """Return whether a light of a vehicle is on in a frame."""
        return light in (self.get_vehicle_lights(vehicle_id, frame) or [])

    # --- lights --------------------------------------------------------------------------------------------------------

    def get_traffic_light_state(self, traffic_light_id: int, frame: int) -> carla.TrafficLightState | None:
        """Return the state of a traffic light in a frame."""
        row, states = self._row("light_states", traffic_light_id, frame), carla.TrafficLightState
        return None if row is None else states.values.get(int(row["state"]), states.Unknown)

    def is_traffic_light_frozen(self, traffic_light_id: int, frame: int) -> bool | None:
        """Return whether a traffic light is frozen in a frame."""
        row = self._row("light_states", traffic_light_id, frame)
        return None if row is None else bool(row["frozen"])

    def get_traffic_light_elapsed_time(self, traffic_light_id: int, frame: int) -> float | None:
        """Return the seconds since a traffic light changed to its state, in a frame."""
        row = self._row("light_states", traffic_light_id, frame)
        return None if row is None else float(row["elapsed"])

    def get_traffic_light_state_time(
        self, traffic_light_id: int, state: carla.TrafficLightState, frame: int
    ) -> float | None:
        """Return the seconds that a state of a traffic light lasts, as latest recorded up to a frame."""
        found = _latest(self._light_times.get(traffic_light_id, []), frame)
        states = (carla.TrafficLightState.Green, carla.TrafficLightState.Yellow, carla.TrafficLightState.Red)
        return dict(zip(states, found, strict=True)).get(state) if found else None

    def get_scene_light_state(self, light_id: int, frame: int) -> carla.LightState | None:
        """Return the latest state of a lamp of the scene up to a frame; it is always active."""
        found = _latest(self._scene_lights.get(light_id, []), frame)
        if found is None:
            return None
        color = carla.Color(*(int(float(found[name]) * _FULL_COLOR) for name in ("red", "green", "blue")))
        return carla.LightState(int(found["intensity"]), color, carla.LightGroup.NONE, True)

    # --- reading -------------------------------------------------------------------------------------------------------

    def _read_events(self) -> None:
        for frame in self._reader.frames(_EVENTS, sparse=True):
            count = max(frame.index, 0) + 1
            self._lives.add(frame.packets, count)
            self._collisions += [(count, actor, other) for _, actor, other, *_ in frame["collisions"].tolist()]
            for type, boxes in zip(("bounding_boxes", "trigger_volumes"), self._boxes.values(), strict=True):
                for spawn in frame["spawned"]:
                    boxes.pop(spawn.id, None)
                boxes |= {id: _box(sizes) for id, *sizes in frame[type].tolist() if self._lives.at(id, count)}
            for physics in frame["physics"]:
                self._physics[physics.id].append((count, physics))
            for id, *seconds in frame["light_times"].tolist():
                self._light_times[id].append((count, tuple(seconds)))
            for light in frame["scene_lights"]:
                self._scene_lights[int(light["id"])].append((count, light))

    def _latest_lives(self) -> Iterator[ActorLife]:
        """Yield the last actor of each id."""
        return (life for id in self._lives.ids() if (life := self._lives.at(id, math.inf)))

    @cached_property
    def _clock(self) -> Floats:
        """The elapsed seconds of the frames, (n,)."""
        pieces = [batch.elapsed for batch in self._reader.batches(()) if not batch.preamble]
        return np.concatenate([np.zeros(0), *pieces])

    @cached_property
    def _platform_times(self) -> dict[int, float]:
        frames = self._reader.frames(("platform_time",), sparse=True)
        return {frame.index: float(frame["platform_time"]["seconds"][-1]) for frame in frames}

    @cached_property
    def _paths(self) -> dict[int, tuple[NDArray[np.int64], Trajectory]]:
        """The frames, counted from 0, and the trajectory of each actor, in CARLA's axes."""
        frames = {id: found.frame for id, found in actor_rows(self._reader, ("transforms",))["transforms"].items()}
        return {id: (frames[id], path) for id, path in trajectories(self._reader, axes="carla").items()}

    def _index(self, frame: int) -> int:
        """Return the index of a frame that is counted from 0."""
        count = self.get_total_frame_count()
        if frame < 0 or not count:
            location = self._recording.location
            raise RecapError(f"{location}: no frame {frame}; frames count from 0 here, and there are {count}")
        return min(frame, count - 1)

    def _pose(self, actor_id: int, frame: int) -> tuple[Trajectory, int] | tuple[None, int]:
        """Return the trajectory of an actor and the row of a frame in it; None if it has no transform there."""
        frames, path = self._paths.get(actor_id, (np.empty(0, np.int64), None))
        row = _index_of(frames, frame - 1)
        return (None, 0) if path is None or row is None else (path, row)

    def _row(self, type: str, actor_id: int, frame: int) -> np.void | None:
        """Return the record of an actor in a frame."""
        if type not in self._rows:
            self._rows |= actor_rows(self._reader, (type,))
        rows = self._rows[type].get(actor_id)
        row = None if rows is None else _index_of(rows.frame, frame - 1)
        return None if rows is None or row is None else rows.records[row]

    def _present(self, frame: int, actor_list: Collection[int] | None) -> Iterator[int]:
        """Yield the actors with a transform in a frame; of a list, also its traffic lights."""
        for id in self._paths:
            if self._pose(id, frame)[0] is not None and (not actor_list or id in actor_list):
                yield id
        for id in actor_list or ():
            if self._row("light_states", id, frame) is not None and self._pose(id, frame)[0] is None:
                yield id


def _index_of(frames: NDArray[np.int64], frame: int) -> int | None:
    row = int(np.searchsorted(frames, frame))
    return row if row < len(frames) and frames[row] == frame else None


def _at(row: int, *columns: Floats) -> list[float]:
    return [float(values[row]) for values in columns]


def _latest(values: list[tuple[int, Any]], frame: int) -> Any:
    """Return the last value from up to a frame."""
    return next((value for since, value in reversed(values) if since <= frame), None)


def _box(sizes: list[float]) -> carla.BoundingBox:
    """Return a box of its centre and half extents in cm; numbers that are not finite, as sensors have, become 0."""
    center, extent = (
        [value * CM for value in part] if all(map(math.isfinite, part)) else [0.0, 0.0, 0.0]
        for part in (sizes[:3], sizes[3:])
    )
    return carla.BoundingBox(carla.Location(*center), carla.Vector3D(*extent))


def _physics_control(found: Physics) -> carla.VehiclePhysicsControl:
    control = carla.VehiclePhysicsControl()
    for name in (
        *("max_rpm", "moi", "clutch_strength", "final_ratio", "mass", "drag_coefficient"),
        *(f"damping_rate_{name}" for name in ("full_throttle", *(f"zero_throttle_clutch_{x}engaged" for x in ("", "dis")))),
    ):
        setattr(control, name, float(getattr(found, name)))
    control.use_gear_autobox = bool(found.use_gear_auto_box)
    control.center_of_mass = carla.Vector3D(found.center_of_mass_x, found.center_of_mass_y, found.center_of_mass_z)
    control.torque_curve = _points(found.torque_curve)
    control.steering_curve = _points(found.steering_curve)
    control.forward_gears = [
        carla.GearPhysicsControl(*(float(gear[name]) for name in ("ratio", "down_ratio", "up_ratio")))
        for gear in found.forward_gears
    ]
    names = ("tire_friction", "damping_rate", "max_steer_angle", "radius", "max_brake_torque", "max_handbrake_torque")
    control.wheels = [
        carla.WheelPhysicsControl(
            **{name: float(wheel[name]) for name in names},
            position=carla.Vector3D(*(float(wheel[f"position_{axis}"]) * CM for axis in "xyz")),
        )
        for wheel in found.wheels
    ]
    return control


def _points(curve: NDArray[np.void]) -> list[carla.Vector2D]:
    return [carla.Vector2D(float(point["x"]), float(point["y"])) for point in sorted_points(curve)]
