"""The followed actor over time: a calm camera, its speed and acceleration, its pedals, and the traffic light ahead of it.

All that show it, on plots, panels or pages, take their numbers from here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from carla_recap.model.blueprints import box_of
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.motion import LONGEST_STEP, possible_step
from carla_recap.model.records import CM
from carla_recap.replay import Player, calm_headings, level, right_handed
from carla_recap.replay.follow import LiveChoice
from carla_recap.replay.motion import SceneMotion
from carla_recap.replay.player import LiveScenes
from carla_recap.replay.pose import LOCATION, YAW
from carla_recap.replay.selection import index_in
from carla_recap.scene.ahead import NO_LIGHT, LightAheadFinder, add_stop_points

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carla_recap.model.frame import Frame
    from carla_recap.recording import Recording
    from carla_recap.replay import Scene, SceneBatch
    from carla_recap.replay.follow import Follow
    from carla_recap.scene.ahead import StopPoints
    from carla_recap.util.arrays import Booleans, Floats, Indices


CONTROLS: Final = ("throttle", "brake", "steer")
"""The recorded controls that are shown."""

_SPAN: Final = 0.3  # s; the time over which an acceleration is a mean
_STANDSTILL: Final = 0.1  # m/s
_HELD: Final = 1.0  # s for which a brake counts as held at a standstill
_BEFORE: Final = 1.0  # s before a part of a recording from which its numbers follow, too


@dataclass(frozen=True, eq=False)
class FollowedRecords:
    """What is recorded of the followed actor in some scenes; NaN where something is unknown."""

    time: Floats  # the moments, in elapsed seconds, (scenes,)
    poses: Floats  # its poses, in cm and degrees, left-handed, (scenes, 6)
    speed: Floats  # its speed in m/s, (scenes,); see `SceneMotion`
    recorded_speed: Floats  # the recorded speed in m/s, by which a jump is told from a fast drive, (scenes,)
    controls: Floats  # the recorded `CONTROLS`: pedals from 0 to 1, steering from -1 (left) to 1, (scenes, 3)
    light: Indices  # the id of the traffic light ahead, or `NO_LIGHT`, (scenes,)
    light_state: Indices  # its state, in CARLA's numbers, (scenes,)
    # the distance from the front of the actor to its stop line, or else to the light itself, in m, (scenes,)
    light_distance: Floats

    def __len__(self) -> int:
        return len(self.time)

    @property
    def known(self) -> Booleans:
        """Whether the actor has a pose of finite numbers, (scenes,)."""
        return np.asarray(np.isfinite(self.poses).all(axis=1))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return those of scenes that follow each other."""
        return cls(**{each.name: np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(cls)})

    def take(self, rows: Indices) -> Self:
        """Return those of some of the scenes."""
        return replace(self, **{name: column[rows] for name, column in vars(self).items()})


@dataclass(frozen=True, eq=False)
class FollowedSeries(FollowedRecords):
    """What is shown of the followed actor in some scenes; NaN where something is unknown."""

    jumped: Booleans  # whether it has a pose, but cannot have come there from that of the scene before, (scenes,)
    camera: Floats  # level axes at the actor that turn calmly, as poses; the latest ones while it is absent, (scenes, 6)
    acceleration: Floats  # the mean acceleration over the last 0.3 s, in m/s², (scenes,)
    # throttle and brake as they are shown: a brake is held at a standstill, where controllers let it chatter, (scenes,
    # 2)
    pedals: Floats

    def row_at(self, time: float) -> int:
        """Return the position of the scene at or before a time; 0 before the first one."""
        return max(0, int(np.searchsorted(self.time, time + SAME_TIME, side="right")) - 1)

    def heading_at(self, time: float) -> float:
        """Return the yaw of the camera's axes between two scenes, in degrees, left-handed."""
        row = self.row_at(time)
        heading, following = float(self.camera[row, YAW]), row + 1
        if following == len(self) or self.jumped[following] or not self.time[row] < time < self.time[following]:
            return heading
        part = (time - self.time[row]) / (self.time[following] - self.time[row])
        return heading + float(part * (self.camera[following, YAW] - heading))


def followed_series(
    source: Recording, id: int, stops: StopPoints, *, start: float = 0.0, stop: float = math.inf
) -> FollowedSeries:
    """Return the series of an actor in all frames of a part of a recording, and of a second before it.

    The part is between two moments, in elapsed seconds; for the stops, see `carla_recap.scene.ahead`.
    """
    begin = max(0.0, start - _BEFORE)
    actor = FollowedActor(id, stops)
    player = Player(source, start=begin, duration=max(stop - begin, SAME_TIME) if stop < math.inf else 0.0, follow=id)
    return actor.derive(FollowedRecords.joined([actor.read(batch) for batch in player.batches()]))


class FollowedActor:
    """Measures the followed actor in scenes, which come in order; after a seek, it begins anew.

    If `id` is None, none is followed. For the stops, see `carla_recap.scene.ahead`.
    """

    def __init__(self, id: int | None, stops: StopPoints) -> None:
        self.id = id
        self._lights = LightAheadFinder(stops)
        self._begin()

    def _begin(self) -> None:
        self._motion = SceneMotion()
        self._path = CalmPath()
        self._accelerations = _Accelerations()
        self._pedals = _HeldPedals()
        self._latest = np.nan, np.full(len(CONTROLS), np.nan)  # the time of the latest controls, and these

    def series(self, batch: SceneBatch) -> FollowedSeries:
        """Return the series of the next scenes."""
        return self.derive(self.read(batch))

    def read(self, batch: SceneBatch) -> FollowedRecords:
        """Return what is recorded in the next scenes; before those after a seek, all others have to be derived."""
        if batch.fresh:
            self._begin()
        poses = None if self.id is None else batch.pose_of(self.id)
        if poses is None:
            poses = np.full((len(batch), 6), np.nan)
        ids = np.array([] if self.id is None else [self.id], np.uint32)
        moving = self._motion.velocities(batch, ids, poses[:, None][:, : len(ids)])
        speed = np.sqrt((moving**2).sum(axis=2)).sum(axis=1) if len(ids) else np.full(len(batch), np.nan)
        recorded = np.sqrt((self._records(batch, "velocities", ("x", "y", "z")) ** 2).sum(axis=1))
        found, distance = self._light_ahead(batch, poses)
        lit = found != NO_LIGHT
        light, state = np.full(len(batch), NO_LIGHT), np.full(len(batch), NO_LIGHT)
        light[lit] = batch.light_states["id"][0][found[lit]]
        state[lit] = batch.light_states["state"][lit, found[lit]]
        controls = self._hold(batch.time, self._records(batch, "vehicle_controls", CONTROLS), poses)
        # A view would keep the poses of all actors, and the bytes that the times are in.
        return FollowedRecords(batch.time.copy(), poses.copy(), speed, recorded, controls, light, state, distance)

    def _hold(self, time: Floats, controls: Floats, poses: Floats) -> Floats:
        """Return controls, in frames without any the latest ones for up to 1 s, while the pose is known."""
        times, every = np.append(self._latest[0], time), np.vstack((self._latest[1], controls))
        known = np.isfinite(poses).all(axis=1)
        ends = np.isfinite(every).all(axis=1) | np.append(False, ~known)  # what was held before
        latest = np.maximum.accumulate(np.where(ends, np.arange(len(every)), 0))
        self._latest = times[latest[-1]], every[latest[-1]]
        held = known & (times - times[latest] <= LONGEST_STEP)[1:]
        return np.where(held[:, None], every[latest[1:]], controls)

    def derive(self, records: FollowedRecords) -> FollowedSeries:
        """Return the series of scenes of which the records have been read, as many as one likes at once."""
        path = self._path.add(records.time, records.poses, records.recorded_speed)
        return FollowedSeries(
            **vars(records),
            jumped=path.jumped,
            camera=path.camera,
            acceleration=self._accelerations.add(records.time, records.speed),
            pedals=self._pedals.add(records.time, records.controls[:, :2], records.speed),
        )

    def _records(self, batch: SceneBatch, name: str, names: Sequence[str]) -> Floats:
        """Return some fields of the records of the actor, (scenes, fields); NaN unless all of a scene are finite."""
        values = np.full((len(batch), len(names)), np.nan)
        records = batch.records(name)
        index = None if self.id is None else index_in(records["id"][0], self.id)
        if index is not None:
            own = records[:, index]
            with np.errstate(invalid="ignore"):  # a signaling NaN
                for column, field in enumerate(names):
                    values[:, column] = own[field]
            values[~np.isfinite(values).all(axis=1)] = np.nan
        return values

    def _light_ahead(self, batch: SceneBatch, poses: Floats) -> tuple[Indices, Floats]:
        """Return the position of the light ahead in each scene, and its distance in m; walkers heed none."""
        actor = None if self.id is None else batch.actors.get(self.id)
        if actor is None or actor.kind == "walker" or not batch.light_states.shape[1]:
            return np.full(len(batch), NO_LIGHT), np.full(len(batch), np.nan)
        found, distance = self._lights.find(batch, right_handed(poses))
        box = box_of(actor)
        return found, np.maximum(distance - box.x - box.extent_x, 0.0)


class LiveFollow:
    """The scenes of a running simulation, and the actor that is followed in them.

    Args:
        follow: Which actor that is; see `LiveChoice`.

    Attributes:
        followed: The followed actor; None before there is one.
        stops: The points at which traffic lights stop cars, as far as they are known; see `carla_recap.scene.ahead`.
    """

    def __init__(self, follow: Follow) -> None:
        self.followed: int | None = None
        self.stops: dict[int, Floats] = {}
        self._choice = LiveChoice(follow)
        self._scenes = LiveScenes()

    def scene(self, frame: Frame) -> tuple[Scene, int | None]:
        """Return the scene of the next frame, and the actor that is followed from it on; None if that is no other one."""
        scene = self._scenes.scene(frame)
        add_stop_points(self.stops, frame)
        chosen = self._choice.choose(scene)
        if chosen is None or chosen == self.followed:
            return scene, None
        self.followed = chosen
        return scene, chosen


@dataclass(frozen=True, eq=False)
class _PathPart:
    """A part of an actor's path: see `FollowedSeries`."""

    camera: Floats
    jumped: Booleans


class CalmPath:
    """The path of an actor from batch to batch, with level axes that follow it and turn calmly.

    Where a camera follows at once is no matter of motion: unlike `steps_joined`, steps up to 5 m are no jumps, for any time.
    """

    def __init__(self) -> None:
        self._time = self._speed = np.nan  # of the latest known pose
        self._pose = np.full(6, np.nan)
        self._camera = np.full(6, np.nan)
        self._is_known = False  # in the latest scene

    def add(self, time: Floats, poses: Floats, speeds: Floats | None = None) -> _PathPart:
        """Return the path in the next scenes, given poses in cm and degrees, left-handed, NaN where there are none.

        Recorded speeds, in m/s, tell jumps from fast drives.
        """
        known = np.asarray(np.isfinite(poses).all(axis=1))
        rows = np.flatnonzero(known)
        speeds = np.full(len(time), np.nan) if speeds is None else speeds
        path = np.concatenate((self._pose[None], poses[rows]))
        at = np.concatenate(([self._time], time[rows]))
        fastest = np.concatenate(([self._speed], speeds[rows]))
        seconds = np.diff(at)
        metres = np.sqrt((np.diff(path[:, LOCATION], axis=0) ** 2).sum(axis=1)) * CM
        with np.errstate(invalid="ignore"):
            far = ~(metres <= possible_step(seconds, np.fmax(fastest[1:], fastest[:-1])))
        absent = np.diff(rows, prepend=-1 if self._is_known else -2) != 1
        jumped = np.zeros(len(time), np.bool_)
        jumped[rows] = far | absent
        headings = self._headings(at, path[1:, YAW], jumped[rows])
        camera = np.concatenate((self._camera[None], level(poses[rows], headings)))
        if len(rows):
            self._time, self._speed, self._pose = at[-1], fastest[-1], path[-1]
        if len(time):
            self._camera, self._is_known = camera[-1], bool(known[-1])
        return _PathPart(camera[np.cumsum(known)], jumped)

    def _headings(self, time: Floats, yaws: Floats, jumped: Booleans) -> Floats:
        """Return the headings of the camera at poses with these yaws; the first time is that of the pose before them."""
        starts = np.flatnonzero(jumped) + 1
        runs = zip(np.split(time, starts), np.split(np.append(self._camera[YAW], yaws), starts), strict=True)
        return np.concatenate([calm_headings(*run) for run in runs])[1:]


class _Accelerations:
    """Accelerations as means over the last 0.3 s, from batch to batch."""

    def __init__(self) -> None:
        self._time: Floats = np.zeros(0)  # of the last speeds, before which accelerations are known
        self._speed: Floats = np.zeros(0)

    def add(self, time: Floats, speed: Floats) -> Floats:
        """Return the acceleration at each time in m/s², given the speeds in m/s; NaN where it is unknown."""
        rows, held = np.flatnonzero(np.isfinite(speed)), len(self._time)
        times, speeds = np.concatenate((self._time, time[rows])), np.concatenate((self._speed, speed[rows]))
        last = np.arange(max(held, 1), len(times))
        first = np.clip(np.searchsorted(times, times[last] - _SPAN - SAME_TIME), 0, last - 1)
        spans = times[last] - times[first]
        usable = (spans > 0) & (spans <= LONGEST_STEP)
        first, last = first[usable], last[usable]
        found = np.full(len(time), np.nan)
        found[rows[last - held]] = (speeds[last] - speeds[first]) / spans[usable]
        kept = slice(int(np.searchsorted(times, times[-1] - _SPAN - SAME_TIME)) if len(times) else 0, None)
        self._time, self._speed = times[kept], speeds[kept]
        return found


class _HeldPedals:
    """Pedals without the chatter at a standstill, from batch to batch.

    What is shown instead is the brake as held for a second after each time, and no throttle meanwhile.
    """

    def __init__(self) -> None:
        self._time: Floats = np.zeros(0)  # of the last rows, within the time for which a brake is held
        self._brake: Floats = np.zeros(0)

    def add(self, time: Floats, pedals: Floats, speed: Floats) -> Floats:
        """Return throttle and brake as they are shown, (scenes, 2), given those recorded and the speeds in m/s."""
        shown = np.full(pedals.shape, np.nan)
        rows, held = np.flatnonzero(np.isfinite(pedals[:, 0])), len(self._time)
        if not len(rows):
            return shown
        throttle, brake = pedals[rows].T
        times, brakes = np.concatenate((self._time, time[rows])), np.concatenate((self._brake, brake))
        stops = np.arange(held, len(brakes)) + 1
        starts = np.minimum(np.searchsorted(times, time[rows] - _HELD), stops - 1)
        ends = np.stack((starts, stops), axis=1).ravel()
        recent = np.maximum.reduceat(np.append(brakes, 0.0), ends)[::2]
        kept = slice(int(starts[-1]), None)
        self._time, self._brake = times[kept], brakes[kept]
        is_held = (speed[rows] < _STANDSTILL) & (recent > 0)
        shown[rows] = np.stack((np.where(is_held, 0.0, throttle), np.where(is_held, recent, brake)), axis=1)
        return shown
