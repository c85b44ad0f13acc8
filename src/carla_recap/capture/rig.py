"""Sensors of a server that are listened to: those of a rig, which are spawned, or those that are there."""

from __future__ import annotations

import warnings
from collections import Counter
from contextlib import suppress
from re import sub
from time import monotonic
from typing import TYPE_CHECKING, Any, Final, Literal, Self

import carla
import numpy as np

from carla_recap.capture.actors import OWN, UNANSWERED, parent_of, readable
from carla_recap.capture.observer import ANSWER
from carla_recap.capture.samples import SensorFrame
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.model.lives import HERO
from carla_recap.model.packets import pose
from carla_recap.model.records import CM
from carla_recap.replay.pose import LOCATION, detach
from carla_recap.sensors.kinds import SENSOR_TYPES
from carla_recap.sensors.rig import SensorRig, SensorSpec
from carla_recap.util.text import first_of, single_line

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from carla_recap.capture.observer import Observer
    from carla_recap.model.lives import ActorName

EXISTING: Final = "existing"
"""Stands for the sensors that are there, in place of a rig."""
Sensors = SensorRig | Literal["existing"]

_TICK: Final = 0.5  # s for which a tick is waited for at a time
_ASKING: Final = 1.0  # s between questions for the server's settings
_LISTED: Final = 8  # attributes that a warning lists
_LONGEST_NAME: Final = 64  # characters of an id


class RigSensors:
    """The sensors of a server that are recorded, while a `with` block runs.

    They are those of a rig, which an actor carries (an id, or "hero") and which are destroyed at the end, or `EXISTING`
    ones. The observer ends when a sensor of the rig or the carrier is gone. On entry, an actor that is not there, a sensor
    that cannot be spawned, and no sensors are errors; attributes that the server does not know and sensors that are left out
    are warnings.

    Attributes:
        rig: The sensors that are listened to.
        last_frames: The latest frame in which a sensor that is gone was seen, by id.
    """

    rig: SensorRig

    def __init__(self, observer: Observer, sensors: Sensors, actor: ActorName = HERO) -> None:
        self._observer = observer
        self._sensors = sensors
        self._actor = actor
        self._client = observer.new_client()
        self._carrier: int | None = None
        self._spawned: list[carla.Sensor] = []
        self._listened: dict[str, carla.Sensor] = {}
        self.last_frames: dict[str, int] = {}
        self._seen: dict[int, int] = {}  # the latest frame in which an actor was seen
        self._since = 0  # later frames have all existing sensors, until these are gone
        self._speed_callback: int | None = None
        self._asked_at = 0.0
        self._synchronous = False

    def __enter__(self) -> Self:
        try:
            self._world = self._client.get_world()
            self._await_tick()
            if isinstance(self._sensors, SensorRig):
                self.rig = self._sensors
                self._spawn(self._sensors)
            else:
                self.rig = self._found()
            self._client.set_timeout(ANSWER)
        except UNANSWERED as error:
            self._close()
            raise RecapError(f"{self._observer.place}: {single_line(error)}") from None
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._close()

    @property
    def is_synchronous(self) -> bool:
        """Whether the server is in synchronous mode, as it was a second ago at most; asks the server."""
        now = monotonic()
        if now - self._asked_at > _ASKING:
            self._asked_at = now
            settings = self._observer.answer(self._world.get_settings, None)
            self._synchronous = self._synchronous if settings is None else settings.synchronous_mode
        return self._synchronous

    def listen(self, callback: Callable[[SensorFrame], None]) -> None:
        """Have a function called with what sensors send, in a thread of CARLA's client; `RecapError`: no answer."""
        try:
            for spec in self.rig:
                if spec.id in self._listened:
                    self._listened[spec.id].listen(lambda data, spec=spec: callback(SensorFrame.of(spec, data)))
            if self._speedometers:
                self._speed_callback = self._world.on_tick(self._speeds(self._speedometers, callback))
        except UNANSWERED as error:
            raise RecapError(f"{self._observer.place}: {single_line(error)}") from None

    @property
    def _speedometers(self) -> list[SensorSpec]:
        return [spec for spec in self.rig if not SENSOR_TYPES[spec.type].is_actor]

    def check(self) -> None:
        """End the observer if a sensor of the rig is gone, or all existing ones; a warning says which of these is gone."""
        frame = self._observer.frame  # read first: the actors may be those of a later one
        if frame <= self._since:
            return
        present = self._observer.present
        actors = {sensor.id: [id] for id, sensor in self._listened.items()}
        if self._carrier is not None:
            actors[self._carrier] = [spec.id for spec in self._speedometers]
        self._seen |= dict.fromkeys(actors.keys() & present, frame)
        gone = self._seen.keys() - present
        if self._carrier in gone:
            self._end("the hero is gone" if self._actor == HERO else f"actor {self._actor} is gone")
        for actor in gone & actors.keys():
            last = self._seen.pop(actor)
            for id in actors[actor]:
                self.last_frames[id] = last
                if self._sensors != EXISTING:
                    self._end(f"sensor {id!r} is gone")
                    continue
                self._listened.pop(id)
                warnings.warn(f"sensor {id!r} is gone", RecapWarning, stacklevel=2)
        if gone and not self._listened and self._sensors == EXISTING:
            self._end("all sensors are gone")

    def _end(self, why: str) -> None:
        self._observer.end(why, is_cut_short=True)

    @property
    def count(self) -> int:
        """The number of sensors that are listened to."""
        return len(self._listened) + (self._speed_callback is not None)

    def _await_tick(self) -> None:
        """Wait for a tick: a client knows no actors before."""
        while True:
            with suppress(RuntimeError):  # the time is over
                self._world.wait_for_tick(_TICK)
                return
            if self._observer.why:
                raise RecapError(f"{self._observer.place}: {self._observer.why} before the world ticked")
            self._world.get_settings()  # an error if the server is gone

    # --- sensors of a rig --------------------------------------------------------------------------------------------------

    def _spawn(self, rig: SensorRig) -> None:
        carrier = self._find_carrier()
        self._carrier = carrier.id
        library = self._world.get_blueprint_library()
        for spec in rig:
            if not SENSOR_TYPES[spec.type].is_actor:
                continue
            place = f"{self._observer.place}: sensor {spec.id!r}"
            try:
                blueprint = library.find(spec.type)
            except UNANSWERED:
                raise RecapError(f"{place}: the server has no {spec.type}") from None
            self._set_attributes(blueprint, spec, place)
            turn = carla.Rotation(pitch=spec.pitch, yaw=spec.yaw, roll=spec.roll)
            mount = carla.Transform(carla.Location(spec.x, spec.y, spec.z), turn)
            try:
                sensor = self._world.spawn_actor(blueprint, mount, attach_to=carrier)
            except UNANSWERED as error:
                raise RecapError(f"{place}: {single_line(error)}") from None
            self._spawned.append(sensor)
            self._listened[spec.id] = sensor

    def _find_carrier(self) -> carla.Actor:
        actors = readable(self._world.get_actors())
        if self._actor == HERO:
            found = [actor for actor in actors if actor.attributes.get("role_name") == HERO]
        else:
            found = [actor for actor in actors if actor.id == self._actor]
        if not found:
            name = "hero" if self._actor == HERO else f"actor {self._actor}"
            moving = [str(actor.id) for actor in actors if actor.type_id.startswith(("vehicle.", "walker."))]
            has = f"there are vehicles and walkers {first_of(moving, _LISTED)}" if moving else "there are no vehicles"
            raise RecapError(f"{self._observer.place}: there is no {name} to carry the rig; {has}")
        return min(found, key=lambda actor: actor.id)

    def _set_attributes(self, blueprint: carla.ActorBlueprint, spec: SensorSpec, place: str) -> None:
        """Give a blueprint the attributes of a sensor, but for those that the server does not know."""
        unknown = []
        for key, text in spec.texts().items():
            if not blueprint.has_attribute(key):
                if spec.attributes[key] != SENSOR_TYPES[spec.type].attributes[key].default:
                    unknown.append(key)
                continue
            try:
                blueprint.set_attribute(key, text)
            except UNANSWERED as error:
                raise RecapError(f"{place}: {key}: {text}: {single_line(error)}") from None
        if blueprint.has_attribute("role_name"):
            blueprint.set_attribute("role_name", OWN)
        if unknown:
            text = f"{place}: the server does not know {first_of(unknown, _LISTED)}, which is left out"
            warnings.warn(text, RecapWarning, stacklevel=2)

    def _speeds(self, specs: list[SensorSpec], callback: Callable[[SensorFrame], None]) -> Callable[[Any], None]:
        """Return what measures the speed of the carrier at each tick, or at the interval of a sensor."""
        carrier = self._carrier
        due = dict.fromkeys((spec.id for spec in specs), -np.inf)

        def measure(snapshot: carla.WorldSnapshot) -> None:
            actor = snapshot.find(carrier)
            if actor is None:
                return
            now = snapshot.timestamp.elapsed_seconds
            for spec in specs:
                if now >= due[spec.id]:
                    due[spec.id] = now + spec.number("sensor_tick") - 0.5 * snapshot.timestamp.delta_seconds
                    callback(SensorFrame.of_speed(spec, snapshot, actor))

        return measure

    # --- existing sensors --------------------------------------------------------------------------------------------------

    def _found(self) -> SensorRig:
        """Return the existing sensors as a rig."""
        sensors = [
            actor
            for actor in readable(self._world.get_actors().filter("sensor.*"))
            if actor.type_id in SENSOR_TYPES and actor.attributes.get("role_name") != OWN
        ]
        roles = Counter(sensor.attributes.get("role_name", "") for sensor in sensors)
        specs = []
        for sensor in sorted(sensors, key=lambda sensor: sensor.id):
            role = sensor.attributes.get("role_name", "")
            is_name = roles[role] == 1 and role.isascii() and role.isidentifier() and len(role) <= _LONGEST_NAME
            kind = sub(r"\W+", "_", sensor.type_id.removeprefix("sensor."))
            id = role if is_name else f"{kind}_{sensor.id}"
            try:
                specs.append(SensorSpec.of_texts(id, sensor.type_id, _mount(sensor), sensor.attributes))
            except RecapError as error:
                warnings.warn(f"{error}: it is left out", RecapWarning, stacklevel=2)
                continue
            self._listened[id] = sensor
        self._since = self._world.get_snapshot().frame
        self._seen = {sensor.id: self._since for sensor in self._listened.values()}
        if not specs:
            raise RecapError(f"{self._observer.place}: there are no sensors whose data can be recorded")
        return SensorRig(tuple(specs))

    def _close(self) -> None:
        """Stop listening, and destroy the sensors that were spawned."""
        if self._observer.is_gone:  # and with it all sensors
            return
        with suppress(*UNANSWERED):
            if self._speed_callback is not None:
                self._world.remove_on_tick(self._speed_callback)
            for sensor in self._listened.values():
                if sensor.is_alive and sensor.is_listening:
                    sensor.stop()
        if self._spawned:
            with suppress(*UNANSWERED):
                self._client.apply_batch_sync([carla.command.DestroyActor(sensor) for sensor in self._spawned])
        self._spawned.clear()
        self._listened.clear()


def _mount(sensor: carla.Actor) -> list[float]:
    """Return the pose of a sensor in m and degrees: on its parent, else in the world."""
    mount = np.array(pose(sensor.get_transform()))
    if (parent := parent_of(sensor)) is not None:
        mount = detach(np.array(pose(parent.get_transform())), mount)
    mount[LOCATION] *= CM
    return [float(value) for value in mount]
