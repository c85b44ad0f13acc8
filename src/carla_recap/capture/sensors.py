"""Sensors of a server, spawned or found there, and the recording of what they send beside the world.

The data of a sensor arrive in a thread of CARLA's client, which only puts them in a queue; other threads make messages of
them, and the thread that writes the frames of the world writes these, too.
"""

from __future__ import annotations

import warnings
from collections import Counter, deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from re import sub
from threading import Condition
from time import monotonic
from typing import TYPE_CHECKING, Any, Final, Literal, Self

import carla
import numpy as np

from carla_recap.capture.actors import OWN, UNANSWERED, parent_of, pose_of, readable
from carla_recap.capture.samples import SensorFrame
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.model.actors import HERO
from carla_recap.model.records import CM
from carla_recap.replay.pose import LOCATION, detach
from carla_recap.sensors.kinds import SENSOR_TYPES
from carla_recap.sensors.messages import SensorMessages
from carla_recap.sensors.rig import SensorRig, SensorSpec
from carla_recap.util.text import first_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from concurrent.futures import Future
    from types import TracebackType

    from carla_recap.capture.observer import Observer
    from carla_recap.formats.mcap.writer import McapWriter
    from carla_recap.model.actors import ActorName
    from carla_recap.model.frame import Header
    from carla_recap.sensors.messages import SensorMessage
    from carla_recap.sensors.sensing import Sample

EXISTING: Final = "existing"
"""Stands for the sensors that are there, in place of a rig."""
Sensors = SensorRig | Literal["existing"]

WAITING_LIMIT: Final = 256 << 20
"""The most bytes of sensors' data that wait to be written."""

_THREADS: Final = 2  # that make messages
_LATEST: Final = 1.0  # s for which the data of a tick are waited for, before those that came are written
_LAST: Final = 3.0  # s for which the last data are waited for
_TICK: Final = 0.5  # s for which a tick is waited for at a time
_PAUSE: Final = 0.02  # s
_ASKING: Final = 1.0  # s between questions for the server's settings
_LISTED: Final = 8  # attributes that a warning lists
_LONGEST_NAME: Final = 64  # characters of an id
_NO_DATA: Final = np.zeros(0)


class RigSensors:
    """The sensors of a server that are recorded, while a `with` block runs.

    Args:
        observer: Observes the server; it ends when a sensor or the carrier is gone.
        sensors: The rig, whose sensors are spawned, and destroyed at the end; or `EXISTING`.
        actor: The actor that carries the rig: an id, or "hero".

    Attributes:
        rig: The sensors that are listened to.

    Raises:
        RecapError: On entry: there is no such actor, or a sensor cannot be spawned, or there are none.

    Warns:
        RecapWarning: On entry: the server does not know an attribute of a sensor, or an existing sensor is left out.
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
        self._seen: set[int] = set()
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
        except UNANSWERED as error:
            self._close()
            raise RecapError(f"{self._observer.place}: {' '.join(str(error).split())}") from None
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
            with suppress(*UNANSWERED):
                self._synchronous = self._world.get_settings().synchronous_mode
        return self._synchronous

    def listen(self, callback: Callable[[SensorFrame], None]) -> None:
        """Have a function called with what sensors send, in a thread of CARLA's client.

        Raises:
            RecapError: The server does not answer.
        """
        speedometers = [spec for spec in self.rig if not SENSOR_TYPES[spec.type].is_actor]
        try:
            for spec in self.rig:
                if spec.id in self._listened:
                    self._listened[spec.id].listen(_receiver(spec, callback))
            if speedometers:
                self._speed_callback = self._world.on_tick(self._speeds(speedometers, callback))
        except UNANSWERED as error:
            raise RecapError(f"{self._observer.place}: {' '.join(str(error).split())}") from None

    def check(self) -> None:
        """End the observer if a sensor of the rig is gone, or all existing ones.

        Warns:
            RecapWarning: An existing sensor is gone.
        """
        present = self._observer.present
        actors = {sensor.id: id for id, sensor in self._listened.items()}
        if self._carrier is not None:
            actors[self._carrier] = ""
        self._seen |= actors.keys() & present
        gone = self._seen - present
        if self._carrier in gone:
            self._observer.end("the hero is gone" if self._actor == HERO else f"actor {self._actor} is gone")
        for actor in gone & actors.keys():
            self._seen.discard(actor)
            if self._sensors != EXISTING:
                self._observer.end(f"sensor {actors[actor]!r} is gone")
                continue
            self._listened.pop(actors[actor])
            warnings.warn(f"sensor {actors[actor]!r} is gone", RecapWarning, stacklevel=2)
        if gone and not self._listened and self._sensors == EXISTING:
            self._observer.end("all sensors are gone")

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
                raise RecapError(f"{place}: {' '.join(str(error).split())}") from None
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
                raise RecapError(f"{place}: {key}: {text}: {' '.join(str(error).split())}") from None
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
        if not specs:
            raise RecapError(f"{self._observer.place}: there are no sensors whose data can be recorded")
        return SensorRig(tuple(specs))

    def _close(self) -> None:
        """Stop listening, and destroy the sensors that were spawned."""
        with suppress(*UNANSWERED):  # the server has gone, and with it all sensors
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


def _receiver(spec: SensorSpec, callback: Callable[[SensorFrame], None]) -> Callable[[Any], None]:
    return lambda data: callback(SensorFrame.of(spec, data))


def _mount(sensor: carla.Actor) -> list[float]:
    """Return the pose of a sensor in m and degrees: on its parent, else in the world."""
    pose = np.array(pose_of(sensor.get_transform()))
    if (parent := parent_of(sensor)) is not None:
        pose = detach(np.array(pose_of(parent.get_transform())), pose)
    pose[LOCATION] *= CM
    return [float(value) for value in pose]


# --- the recording of what they send ---------------------------------------------------------------------------------------


@dataclass(eq=False)
class _TickSamples:
    """The samples of a tick that are to be written.

    Attributes:
        since: When the first one came, on the monotonic clock.
        size: The bytes of the messages.
        samples: The samples, without their data.
        messages: Their messages.
    """

    since: float
    size: int = 0
    samples: list[Sample] = field(default_factory=list)
    messages: list[SensorMessage] = field(default_factory=list)


class SampleRecorder:
    """Records what sensors send, while a `with` block runs.

    In synchronous mode, a sensor's thread waits while too many bytes wait to be written; else its data are dropped.

    Args:
        observer: Observes the server.
        sensors: The sensors.
        writer: Writes the recording; the calls of `advance` and `finish` write to it.
        header: The header of the recording.

    Attributes:
        counts: The number of written samples of each sensor, by id.
        dropped: The number of samples of each sensor that came while too many bytes waited, by id.

    Raises:
        RecapError: The file cannot be written to; on entry: the server does not answer.
    """

    def __init__(self, observer: Observer, sensors: RigSensors, writer: McapWriter, header: Header) -> None:
        self.counts: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()
        self._observer = observer
        self._sensors = sensors
        self._writer = writer
        self._messages = SensorMessages(sensors.rig, header)
        for topic in self._messages.topics:
            writer.add_topic(topic)
        self._changed = Condition()
        self._waiting: deque[SensorFrame] = deque()  # for threads that make messages of them
        self._size = 0  # bytes of what is to be written, as it came and as messages
        self._newest: dict[str, int] = {}  # the latest frame of each sensor
        self._keeps_all = sensors.is_synchronous
        self._closed = False
        self._pool = ThreadPoolExecutor(_THREADS, "samples")
        self._made: deque[tuple[SensorFrame, Future[tuple[Sample, list[SensorMessage]]]]] = deque()
        self._ticks: dict[int, _TickSamples] = {}  # by frame
        self._first: tuple[int, float] | None = None  # frame and time of the first observed tick
        self._frame = 0  # the latest that is written

    def __enter__(self) -> Self:
        self._sensors.listen(self._offer)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._close()
        self._pool.shutdown(cancel_futures=True)

    def advance(self, frame: int | None = None) -> None:
        """Write what has come of ticks whose frames are written.

        Args:
            frame: The number of the latest tick whose frame is written; None: as before.

        Raises:
            RecapError: The disk is full or broken, or the data of a sensor cannot be read.
        """
        self._frame = self._frame if frame is None else frame
        self._sensors.check()
        self._keeps_all = self._sensors.is_synchronous
        self._submit()
        self._collect()
        self._write()

    def finish(self) -> None:
        """Write all that belongs to the frames that are written; in synchronous mode, wait for what is still to come.

        Raises:
            RecapError: The disk is full or broken, or the data of a sensor cannot be read.
        """
        end = monotonic() + (_LAST if self._keeps_all else 0.0)
        while monotonic() < end and not self._has_all():
            self._submit()
            self._collect()
            with self._changed:
                self._changed.wait(_PAUSE)
        self._close()
        self._submit()
        while self._made:
            self._made[0][1].exception()
            self._collect()
        self._write(everything=True)

    def _has_all(self) -> bool:
        """Return whether all sensors without an interval that have begun to send have sent data of the latest frame."""
        begun = [spec for spec in self._sensors.rig if spec.id in self._newest and not spec.number("sensor_tick")]
        return all(self._newest[spec.id] >= self._frame for spec in begun)

    def _close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    # --- in threads of the client ------------------------------------------------------------------------------------------

    def _offer(self, data: SensorFrame) -> None:
        """Take in what a sensor has sent."""
        with self._changed:
            while self._size and self._size + data.size > WAITING_LIMIT and not self._closed:
                if not self._keeps_all:
                    self.dropped[data.spec.id] += 1
                    return
                self._changed.wait(_PAUSE)
            if self._closed:
                return
            self._size += data.size
            self._newest[data.spec.id] = data.frame
            self._waiting.append(data)
            self._changed.notify_all()

    # --- in the thread that writes -----------------------------------------------------------------------------------------

    def _submit(self) -> None:
        """Have messages made of what has come of ticks that were observed."""
        times = self._observer.times
        if not times:
            return
        self._first = self._first or next(iter(times.items()))
        with self._changed:
            waiting, self._waiting = self._waiting, deque()
        latest = self._observer.frame
        early = [data for data in waiting if data.frame > latest]
        for data in waiting:
            if data.frame < self._first[0]:
                self._release(data.size)
            elif data.frame <= latest:
                time = times.get(data.frame, data.timestamp)  # of a tick that was missed: what the sensor says
                self._made.append((data, self._pool.submit(self._make, data, time - self._first[1])))
        with self._changed:
            self._waiting.extendleft(reversed(early))

    def _make(self, data: SensorFrame, elapsed: float) -> tuple[Sample, list[SensorMessage]]:
        """Return a sample without its data, and its messages."""
        sample = data.sample(elapsed, self._ids())
        messages = list(self._messages.of_sample(sample))
        return replace(sample, data=_NO_DATA), messages

    def _ids(self) -> Any:
        return np.array(sorted(self._observer.present), np.uint32)

    def _collect(self) -> None:
        """Take the messages that are made, in the order in which the data came."""
        while self._made and self._made[0][1].done():
            data, made = self._made.popleft()
            sample, messages = made.result()
            size = sum(len(message.data) for message in messages)
            tick = self._ticks.setdefault(data.frame, _TickSamples(monotonic()))
            tick.samples.append(sample)
            tick.messages += messages
            tick.size += size
            self._release(data.size - size)

    def _write(self, *, everything: bool = False) -> None:
        """Write the samples of ticks that have all, or that have been waited for."""
        before = monotonic() - _LATEST
        for frame in sorted(self._ticks):
            tick = self._ticks[frame]
            is_full = self._size > WAITING_LIMIT // 2
            is_due = everything or is_full or tick.since < before or len(tick.samples) >= self._sensors.count
            if frame > self._frame or not is_due:
                break
            for message in self._written(tick):
                self._writer.write_message(*message)
            self.counts.update(sample.spec.id for sample in tick.samples)
            del self._ticks[frame]
            self._release(tick.size)

    def _written(self, tick: _TickSamples) -> Iterator[SensorMessage]:
        yield from tick.messages
        yield from self._messages.poses(tick.samples)

    def _release(self, size: int) -> None:
        """Make room for data."""
        with self._changed:
            self._size -= size
            self._changed.notify_all()
