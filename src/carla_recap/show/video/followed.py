"""The followed actor of a video: its box, heading and speed, its controls, and the traffic light ahead of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.motion import possible_step
from carla_recap.replay import calm_heading, right_handed
from carla_recap.replay.pose import LOCATION, rotations
from carla_recap.scene.ahead import NO_LIGHT, LightAheadFinder
from carla_recap.scene.style import box_of
from carla_recap.show.video.overlay import LightAhead

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.replay import Scene
    from carla_recap.scene.ahead import StopPoints
    from carla_recap.scene.instances import Instances

    Floats = NDArray[np.float64]

_CALM_TURN: Final = 0.6  # s; the time constant of the heading of the camera


@dataclass(frozen=True, eq=False)
class Subject:
    """The followed actor at a moment, in m, right-handed.

    Attributes:
        ground: The point below its centre, at the bottom of its box.
        rotation: A matrix whose columns point forward, left and up.
        half: Half the size of its box.
        heading: The yaw of a calm camera, in degrees.
        speed: Its speed in m/s; None if unknown.
        two_wheeled: Whether its rider is not inside of it.
        is_walker: Whether it is a walker.
    """

    ground: Floats
    rotation: Floats
    half: Floats
    heading: float
    speed: float | None
    two_wheeled: bool = False
    is_walker: bool = False


class FollowedActor:
    """Measures the followed actor, scene by scene.

    Args:
        id: The actor; None: there is none.
        stops: Where traffic lights stop cars; see `stop_points`.
    """

    def __init__(self, id: int | None, stops: StopPoints | None = None) -> None:
        self.id = id
        self._stops = stops or {}
        self._lights = LightAheadFinder(self._stops)
        self.subject: Subject | None = None
        self._time = -math.inf

    def update(self, scene: Scene, instances: Instances) -> Subject | None:
        """Return the actor in a scene; if it has no finite pose then, as it was before."""
        if self.id is None:
            return None
        found = self._box(scene, instances)
        if found is None:
            return self.subject
        ground, rotation, half = found
        before, delta = self.subject, scene.time - self._time
        step = math.inf if before is None else float(np.linalg.norm(ground - before.ground))
        recorded = self._recorded_speed(scene)
        jumped = before is None or delta <= 0 or step > possible_step(delta, math.nan if recorded is None else recorded)
        speed = recorded
        if speed is None and before is not None and not jumped:
            share = -math.expm1(-delta / 0.2)
            speed = step / delta if before.speed is None else before.speed + share * (step / delta - before.speed)
        yaw = math.degrees(math.atan2(rotation[1, 0], rotation[0, 0]))
        heading = calm_heading(yaw, None if before is None or jumped else before.heading, delta, _CALM_TURN)
        actor = scene.actors.get(self.id)
        wheels = actor.spawn.attribute("number_of_wheels") if actor is not None else None
        is_walker = actor is not None and actor.type_id.startswith("walker.")
        self.subject = Subject(ground, rotation, half, heading, speed, wheels == "2", is_walker)
        self._time = scene.time
        return self.subject

    def controls(self, scene: Scene) -> tuple[float, float, float] | None:
        """Return throttle, brake and steering in a scene, if recorded."""
        row = _record(scene.vehicle_controls, self.id)
        if row is None:
            return None
        values = float(row["throttle"]), float(row["brake"]), float(row["steer"])
        return values if all(map(math.isfinite, values)) else None

    def light_ahead(self, scene: Scene) -> LightAhead | None:
        """Return the traffic light ahead of the actor in a scene, if any."""
        subject, pose = self.subject, None if self.id is None else scene.pose_of(self.id)
        if subject is None or pose is None or subject.is_walker:
            return None
        placed = right_handed(pose)
        found = int(self._lights.find(scene.batch, placed[None])[0])
        if found == NO_LIGHT:
            return None
        id, state = (int(scene.light_states[name][found]) for name in ("id", "state"))
        location = scene.pose_of(id)
        points = self._stops[id] if id in self._stops or location is None else right_handed(location)[None, LOCATION]
        ahead = (points[:, :2] - placed[:2]) @ subject.rotation[:2, 0]
        return LightAhead(state, max(float(np.abs(ahead).min()) - float(subject.half[0]), 0.0))

    def _box(self, scene: Scene, instances: Instances) -> tuple[Floats, Floats, Floats] | None:
        """Return the lowest point below the centre, the rotation and half the size of the box; None without a pose."""
        pose = None if self.id is None else scene.pose_of(self.id)
        actor = scene.actors.get(self.id or 0)
        if pose is None or actor is None:
            return None
        placed = right_handed(pose)
        rotation = rotations(placed)
        index = int(np.searchsorted(instances.ids, self.id or 0))
        if index < len(instances) and instances.ids[index] == self.id:
            centre, half = instances.locations[index], instances.half_extents[index].astype(np.float64)
        else:
            box = box_of(actor)
            half = np.array((box.extent_x, box.extent_y, box.extent_z))
            centre = placed[LOCATION] + rotation @ np.array((box.x, box.y, box.z))
        if not (np.isfinite(centre).all() and np.isfinite(rotation).all() and np.isfinite(half).all()):
            return None
        return centre - (0.0, 0.0, half[2]), rotation, half

    def _recorded_speed(self, scene: Scene) -> float | None:
        row = _record(scene.velocities, self.id)
        speed = math.nan if row is None else math.hypot(*(float(row[axis]) for axis in "xyz"))
        return speed if math.isfinite(speed) else None


def _record(records: NDArray[np.void], id: int | None) -> np.void | None:
    """Return the record of an actor; None if it has none."""
    index = int(np.searchsorted(records["id"], id or 0))
    row: np.void | None = records[index] if index < len(records) and records["id"][index] == id else None
    return row
