"""The followed actor: the frames that a view is fixed to, its motion, and the traffic lights ahead of it."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.lives import heroes_of
from carla_recap.replay import Destroyed, Spawned, quaternions, right_handed
from carla_recap.replay.pose import LOCATION
from carla_recap.replay.selection import index_in
from carla_recap.scene import style
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
    from carla_recap.scene.follow import FollowedSeries
    from carla_recap.show.foxglove.messages import ShownScenes, Stamps
    from carla_recap.util.arrays import Floats, Indices

TRANSFORMS: Final = "/tf"
HERO: Final = "/hero"
LIGHTS: Final = "/lights"
AHEAD: Final = "/scene/ahead"

_FOLLOWED_FRAME: Final = "followed"
_HERO_FRAME: Final = "hero"

_KMH: Final = 3.6  # in a m/s

_POSE: Final = ("x", "y", "z", "roll", "pitch", "yaw")
_CONTROL: Final = ("throttle", "brake", "steer", "hand_brake", "gear")


class ViewFrames:
    """The frames that views are fixed to.

    `followed` is at the followed actor, but with a level horizon and a calm heading; at the origin before that actor
    appears, and where no actor is followed. `hero` is the pose of the hero.
    """

    def __init__(self) -> None:
        self._hero: int | None = None

    def messages(self, scenes: ShownScenes) -> Iterator[TopicMessages]:
        """Yield the messages of some scenes of a batch."""
        (description, rows, stamps, series), batch = scenes, scenes.description.batch
        if any(self._may_be_hero(event) for event in batch.events):
            self._hero = next((actor.id for actor in heroes_of(batch.actors.values())), None)
        views = right_handed(np.nan_to_num(series.camera, nan=0.0))
        column = None if self._hero is None else index_in(description.ids, self._hero)
        hero = np.full((len(rows), 6), np.nan) if column is None else description.poses[rows, column]
        known = np.isfinite(hero).all(axis=1)
        for some, frames in (
            (~known, {_FOLLOWED_FRAME: views}),
            (known, {_FOLLOWED_FRAME: views, _HERO_FRAME: hero}),
        ):
            if some.any():
                yield _transforms(rows[some], stamps[some], {name: poses[some] for name, poses in frames.items()})

    def _may_be_hero(self, event: Event) -> bool:
        """Return whether a hero appears or disappears."""
        if isinstance(event, Spawned):
            return event.actor.is_hero or event.actor.id == self._hero
        return isinstance(event, Destroyed) and event.id == self._hero


class FollowedMotion:
    """The motion of the followed actor: its messages in the scenes in which its pose is known, and one when it vanishes."""

    def __init__(self) -> None:
        self._is_known = False  # in the last scene

    def messages(self, batch: SceneBatch, id: int, series: FollowedSeries) -> Iterator[TopicMessages]:
        """Yield the messages of a batch."""
        vanishes = ~series.known & np.append(self._is_known, series.known[:-1])
        self._is_known = bool(series.known[-1])
        actor = batch.actors.get(id)
        type_id = None if actor is None else actor.type_id
        identity = {"elapsed": series.time, "id": np.full(len(batch), id)}
        values = identity | dict(zip(_POSE, right_handed(series.poses).T, strict=True))
        control = _records_of(batch, "vehicle_controls", id)
        if control is not None:
            values |= {name: control[name] for name in _CONTROL}
            values["hand_brake"] = values["hand_brake"] != 0
            values["shown_throttle"], values["shown_brake"] = series.pedals.T
        known = series.known
        moving = known & np.isfinite(series.speed)
        accelerated = moving & np.isfinite(series.acceleration)
        fast = values | {"speed": series.speed, "speed_kmh": series.speed * _KMH}
        for some, columns in (
            (vanishes, identity),
            (known & ~moving, values),
            (moving & ~accelerated, fast),
            (accelerated, fast | {"acceleration": series.acceleration}),
        ):
            if some.any():
                messages, rows = _followed_template(tuple(columns), type_id).messages(HERO, np.flatnonzero(some))
                for name, column in columns.items():
                    rows[name] = column[some]
                yield messages


class LightMessages:
    """The states of the traffic lights, as in `latest`, and the light ahead, which is picked out in the scene."""

    def __init__(self) -> None:
        self.latest = ShownLights()
        self._shown: tuple[bytes, bytes, int] | None = None  # the latest ids and states, and the id of the light ahead
        self._marked: str | None = None

    def messages(self, scenes: ShownScenes) -> Iterator[TopicMessages]:
        """Yield messages for each of some scenes in which a light has changed, or another light is ahead."""
        (_, rows, stamps, series), batch = scenes, scenes.description.batch
        lights = batch.light_states[rows]
        ids, states, ahead = lights["id"][0], lights["state"], series.light
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
    return ShownLights(elapsed=elapsed, ahead=next((light for light in lights if light.id == ahead), none), lights=lights)


def _color_name(state: int) -> str:
    """Return the name of a traffic light's state."""
    return TrafficLightColor.Name(state if 0 <= state < TRAFFIC_LIGHT_COLOR_UNKNOWN else TRAFFIC_LIGHT_COLOR_UNKNOWN)


def _records_of(batch: SceneBatch, name: str, id: int) -> NDArray[np.void] | None:
    """Return the records of an actor, (scenes,); None if it has none."""
    records = batch.records(name)
    index = index_in(records["id"][0], id)
    return None if index is None else records[:, index]


@cache
def _transforms_template(frames: tuple[str, ...]) -> MessageTemplate:
    return MessageTemplate(*(_transform_part(frame) for frame in frames))


def _transform_part(frame: str) -> MessagePart:
    constant = FrameTransform(parent_frame_id=WORLD, child_frame_id=frame).SerializeToString()
    stamp = timestamp(FrameTransform.TIMESTAMP_FIELD_NUMBER, frame)
    pose = pose_numbers(FrameTransform.TRANSLATION_FIELD_NUMBER, FrameTransform.ROTATION_FIELD_NUMBER, frame)
    return (MessagePart(constant) + stamp + pose).within(FrameTransforms.TRANSFORMS_FIELD_NUMBER)


def _transforms(rows: Indices, stamps: Stamps, frames: dict[str, Floats]) -> TopicMessages:
    """Return messages with the poses of some frames by name, in m and degrees, right-handed."""
    messages, transforms = _transforms_template(tuple(frames)).messages(TRANSFORMS, rows)
    poses = np.stack(list(frames.values()))
    for frame, positions, turns in zip(frames, poses[..., LOCATION], quaternions(poses), strict=True):
        transforms[f"{frame}timestamp"] = stamps
        fill_pose(transforms, positions, turns, frame)
    return messages


@cache
def _followed_template(names: tuple[str, ...], type_id: str | None) -> MessageTemplate:
    return MessageTemplate(MessagePart(Followed(type_id=type_id).SerializeToString()), numbers(Followed, names))
