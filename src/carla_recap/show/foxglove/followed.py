"""The followed actor: the frames that a view is fixed to, its motion, and the traffic lights ahead of it."""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.model.motion import possible_step
from carla_recap.model.records import CM
from carla_recap.replay import Destroyed, Spawned, calm_heading, level, quaternions, right_handed
from carla_recap.replay.pose import LOCATION, YAW
from carla_recap.scene import style
from carla_recap.scene.ahead import NO_LIGHT, LightAheadFinder
from carla_recap.scene.motion import Accelerations, HeldPedals
from carla_recap.show.foxglove.bodies import ahead_entity, frame_of
from carla_recap.show.foxglove.messages import (
    ALL_DELETED,
    WORLD,
    FrameTransform,
    FrameTransforms,
    MessagePart,
    MessageTemplate,
    TopicMessages,
    fill_pose,
    numbers,
    pose_numbers,
    single,
    timestamp,
)
from carla_recap.v1.followed_pb2 import Followed, ShownLight, ShownLights
from carla_recap.v1.light_states_pb2 import TRAFFIC_LIGHT_COLOR_UNKNOWN, TrafficLightColor

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.replay import Event
    from carla_recap.replay.scene import SceneBatch
    from carla_recap.scene.ahead import StopPoints
    from carla_recap.show.foxglove.messages import Floats, Indices, Stamps

TRANSFORMS: Final = "/tf"
HERO: Final = "/hero"
LIGHTS: Final = "/lights"
AHEAD: Final = "/scene/ahead"

_FOLLOWED_FRAME: Final = "followed"
_HERO_FRAME: Final = "hero"

_KMH: Final = 3.6  # in a m/s

_POSE: Final = ("x", "y", "z", "roll", "pitch", "yaw")
_CONTROL: Final = ("throttle", "brake", "steer", "hand_brake", "gear")


class KnownPoses(NamedTuple):
    """The poses of an actor in some scenes.

    Attributes:
        time: The moments, in elapsed seconds.
        poses: The poses, in cm and degrees, (scenes, 6).
        known: Whether each pose is known and finite.
    """

    time: Floats
    poses: Floats
    known: NDArray[np.bool_]

    def take(self, rows: Indices) -> KnownPoses:
        """Return those of some of the scenes."""
        return KnownPoses(self.time[rows], self.poses[rows], self.known[rows])


def known_poses(batch: SceneBatch, id: int | None) -> KnownPoses:
    """Return the poses of an actor, if any, in the scenes of a batch."""
    poses = None if id is None else batch.pose_of(id)
    if poses is None:
        poses = np.full((len(batch), 6), np.nan)
    return KnownPoses(batch.time, poses, np.asarray(np.isfinite(poses).all(axis=1)))


class _StepCounter:
    """Computes the steps of an actor from scene to scene."""

    def __init__(self) -> None:
        self._time = 0.0
        self._location = [math.nan] * 3

    def steps(self, found: KnownPoses) -> tuple[Floats, Floats]:
        """Return the seconds and the distance in cm from the previous known pose to each; infinite after a jump."""
        times = np.concatenate(([self._time], found.time[found.known]))
        locations = [self._location, *found.poses[found.known, LOCATION].tolist()]
        self._time, self._location = times[-1].item(), locations[-1]
        seconds = np.diff(times)
        distances = np.array(list(map(math.dist, locations, locations[1:])))
        distances[~(distances * CM <= possible_step(seconds))] = math.inf  # the first one, too
        return seconds, distances


class ViewFrames:
    """The frames that views are fixed to.

    `followed` is at the followed actor, but with a level horizon and a calm heading; at the origin before that actor
    appears, and where no actor is followed. `hero` is the pose of the hero.
    """

    def __init__(self) -> None:
        self._hero: int | None = None
        self._view = np.zeros(6)
        self._steps = _StepCounter()

    def messages(self, batch: SceneBatch, rows: Indices, stamps: Stamps, followed: KnownPoses) -> Iterator[TopicMessages]:
        """Yield the messages of some scenes of a batch.

        Args:
            batch: The scenes.
            rows: The positions of the scenes that are shown.
            stamps: The timestamp of each of these.
            followed: The followed actor in these.
        """
        if any(self._may_be_hero(event) for event in batch.events):
            self._hero = next((actor.id for actor in batch.actors.values() if actor.is_hero), None)
        views = self._views(followed)
        hero = known_poses(batch, self._hero).take(rows)
        for some, frames in (
            (~hero.known, {_FOLLOWED_FRAME: views}),
            (hero.known, {_FOLLOWED_FRAME: views, _HERO_FRAME: hero.poses}),
        ):
            if some.any():
                yield _transforms(rows[some], stamps[some], {name: poses[some] for name, poses in frames.items()})

    def _may_be_hero(self, event: Event) -> bool:
        """Return whether a hero appears or disappears."""
        if isinstance(event, Spawned):
            return event.actor.is_hero or event.actor.id == self._hero
        return isinstance(event, Destroyed) and event.id == self._hero

    def _views(self, followed: KnownPoses) -> Floats:
        """Return the poses of the calm frame; the previous one where that of the actor is unknown."""
        poses = followed.poses[followed.known]
        seconds, distances = self._steps.steps(followed)
        heading, headings = float(self._view[YAW]), []
        for yaw, delta, distance in zip(poses[:, YAW].tolist(), seconds.tolist(), distances.tolist(), strict=True):
            heading = calm_heading(yaw, heading if distance < math.inf else None, delta)
            headings.append(heading)
        views = np.concatenate((self._view[None], level(poses, headings)))[np.cumsum(followed.known)]
        self._view = views[-1]
        return views


class FollowedMotion:
    """The motion of the followed actor."""

    def __init__(self) -> None:
        self._steps = _StepCounter()
        self._pedals = HeldPedals()
        self._accelerations = Accelerations()

    def messages(self, batch: SceneBatch, id: int, found: KnownPoses) -> Iterator[TopicMessages]:
        """Yield the messages of the scenes of a batch in which the pose is known.

        Args:
            batch: The scenes.
            id: The followed actor.
            found: Its poses.
        """
        actor = batch.actors.get(id)
        type_id = None if actor is None else actor.type_id
        values = {"elapsed": found.time, "id": np.full(len(batch), id)}
        values |= dict(zip(_POSE, right_handed(found.poses).T, strict=True))
        control = _records_of(batch, "vehicle_controls", id)
        if control is not None:
            values |= {name: control[name] for name in _CONTROL}
            values["hand_brake"] = values["hand_brake"] != 0
        speeds = self._speeds(batch, id, found)
        if control is not None:
            pedals = np.stack((control["throttle"], control["brake"]), axis=1).astype(np.float64)
            values["shown_throttle"], values["shown_brake"] = self._pedals.shown(found.time, pedals, speeds).T
        moving = found.known & np.isfinite(speeds)
        accelerations = np.full(len(batch), np.nan)
        accelerations[moving] = self._accelerations.at(found.time[moving], speeds[moving])
        accelerated = moving & np.isfinite(accelerations)
        fast = values | {"speed": speeds, "speed_kmh": speeds * _KMH}
        for some, columns in (
            (found.known & ~moving, values),
            (moving & ~accelerated, fast),
            (accelerated, fast | {"acceleration": accelerations}),
        ):
            if some.any():
                messages, rows = _followed_template(tuple(columns), type_id).messages(HERO, np.flatnonzero(some))
                for name, column in columns.items():
                    rows[name] = column[some]
                yield messages

    def _speeds(self, batch: SceneBatch, id: int, found: KnownPoses) -> Floats:
        """Return speeds in m/s: as recorded, or else from the distance to the previous pose; not finite after a jump."""
        seconds, distances = self._steps.steps(found)
        velocity = _records_of(batch, "velocities", id)
        if velocity is not None:
            return np.array(list(map(math.hypot, *(velocity[name].tolist() for name in "xyz"))))
        speeds = np.full(len(batch), np.nan)
        with np.errstate(divide="ignore", invalid="ignore"):
            speeds[found.known] = np.where(seconds > 0, distances * CM / seconds, np.nan)
        return speeds


class LightMessages:
    """The states of the traffic lights, and the light ahead of the followed actor, which is picked out in the scene.

    Args:
        stops: The points at which lights stop cars; see `carla_recap.scene.ahead`.

    Attributes:
        latest: The latest message.
    """

    def __init__(self, stops: StopPoints) -> None:
        self.latest = ShownLights()
        self._ahead = LightAheadFinder(stops)
        self._shown: tuple[bytes, bytes, int] | None = None  # the latest ids and states, and the position of the light ahead
        self._marked: str | None = None

    def messages(self, batch: SceneBatch, rows: Indices, stamps: Stamps, followed: KnownPoses) -> Iterator[TopicMessages]:
        """Yield messages for each of some scenes in which a light has changed, or another light is ahead.

        Args:
            batch: The scenes.
            rows: The positions of the scenes that are shown.
            stamps: The timestamp of each of these.
            followed: The followed actor in these.
        """
        lights = batch.light_states[rows]
        ids, states = lights["id"][0], lights["state"]
        ahead = self._ahead.find(batch, right_handed(np.where(followed.known[:, None], followed.poses, np.nan)))
        changed = (states[1:] != states[:-1]).any(axis=1) | (ahead[1:] != ahead[:-1])
        for row in (0, *(np.flatnonzero(changed) + 1).tolist()):
            shown = (ids.tobytes(), states[row].tobytes(), int(ahead[row]))
            if shown == self._shown:
                continue
            self._shown = shown
            self.latest = _shown_lights(batch.time[rows[row]].item(), ids, states[row], shown[2])
            yield single(LIGHTS, int(rows[row]), self.latest)
            yield from self._mark(batch, int(rows[row]), stamps[row])

    def _mark(self, batch: SceneBatch, row: int, stamp: Stamps) -> Iterator[TopicMessages]:
        """Yield the mark of the light ahead, if another one is ahead, or its state has changed."""
        light = self.latest.ahead
        if light.text == self._marked:
            return
        self._marked = light.text
        actor = batch.actors.get(light.id)
        if actor is None:
            yield single(AHEAD, row, ALL_DELETED)
            return
        yield single(AHEAD, row, ahead_entity(actor, light.state, light.text)[: -stamp.size] + stamp.tobytes())


def _shown_lights(elapsed: float, ids: NDArray[np.integer], states: NDArray[np.integer], ahead: int) -> ShownLights:
    lights = [
        ShownLight(id=id, state=_color_name(state), entity=frame_of(id), text=f"light {id}: {style.light(state)[0]}")
        for id, state in zip(ids.tolist(), states.tolist(), strict=True)
    ]
    none = ShownLight(id=0, state=TRAFFIC_LIGHT_COLOR_UNKNOWN, entity="", text="none")
    return ShownLights(elapsed=elapsed, ahead=none if ahead == NO_LIGHT else lights[ahead], lights=lights)


def _color_name(state: int) -> str:
    """Return the name of a traffic light's state."""
    return TrafficLightColor.Name(state if 0 <= state < TRAFFIC_LIGHT_COLOR_UNKNOWN else TRAFFIC_LIGHT_COLOR_UNKNOWN)


def _records_of(batch: SceneBatch, name: str, id: int) -> NDArray[np.void] | None:
    """Return the records of an actor, (scenes,); None if it has none."""
    records = batch.records(name)
    index = int(np.searchsorted(records["id"][0], id))
    return records[:, index] if index < records.shape[1] and records["id"][0, index] == id else None


@cache
def _transforms_template(frames: tuple[str, ...]) -> MessageTemplate:
    return MessageTemplate(*(_transform_part(frame) for frame in frames))


def _transform_part(frame: str) -> MessagePart:
    constant = FrameTransform(parent_frame_id=WORLD, child_frame_id=frame).SerializeToString()
    stamp = timestamp(FrameTransform.TIMESTAMP_FIELD_NUMBER, frame)
    pose = pose_numbers(FrameTransform.TRANSLATION_FIELD_NUMBER, FrameTransform.ROTATION_FIELD_NUMBER, frame)
    return (MessagePart(constant) + stamp + pose).within(FrameTransforms.TRANSFORMS_FIELD_NUMBER)


def _transforms(rows: Indices, stamps: Stamps, frames: dict[str, Floats]) -> TopicMessages:
    """Return messages with the poses of some frames, in cm and degrees, by name."""
    messages, transforms = _transforms_template(tuple(frames)).messages(TRANSFORMS, rows)
    poses = right_handed(np.stack(list(frames.values())))
    for frame, positions, turns in zip(frames, poses[..., LOCATION], quaternions(poses), strict=True):
        transforms[f"{frame}timestamp"] = stamps
        fill_pose(transforms, positions, turns, frame)
    return messages


@cache
def _followed_template(names: tuple[str, ...], type_id: str | None) -> MessageTemplate:
    return MessageTemplate(MessagePart(Followed(type_id=type_id).SerializeToString()), numbers(Followed, names))
