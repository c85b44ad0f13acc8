"""Observes the world of a server tick by tick, as one more of its clients: it never ticks, and changes nothing.

Snapshots arrive in a thread of CARLA's client, and are read there, while the client's actors have their states. Other data
is requested from the server now and then, by the thread that takes the observations.
"""

from __future__ import annotations

import socket
from collections import defaultdict, deque
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import partial
from queue import Empty, Queue
from threading import Lock
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, Final, Self, TypeVar

import carla

from carla_recap.capture import actors
from carla_recap.capture.actors import UNANSWERED, ActorTracker, readable
from carla_recap.capture.collisions import CollisionListener
from carla_recap.errors import RecapError
from carla_recap.model.records import NO_ACTOR, UE4, ActorKind
from carla_recap.util.signals import call_on_termination
from carla_recap.util.text import single_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager
    from types import TracebackType

T = TypeVar("T")

HOST: Final = "127.0.0.1"
PORT: Final = 2000
"""The default port of CARLA's servers."""
ANSWER: Final = 2.0
"""The time in s within which a server must answer that has answered before; else it is asked again."""

_FIRST_ANSWER: Final = 10.0  # s, within which the server must answer at first
_CONNECTION: Final = 2.0  # s, within which it must accept a connection
_QUIET: Final = 1.0  # s without a tick, after which the server is checked
_ASKING: Final = 0.1  # s between questions to the server
_PAUSE: Final = 0.05  # s
_DRAIN: Final = 0.1  # s, in which callbacks of the client end that have begun before they were removed
_WAITING: Final = 4096  # the most observations that wait; further ticks are missed
_HELD: Final = 4  # observations that are held back, since collisions arrive on other connections
_GONE: Final = "the server is gone"
_ANOTHER_EPISODE: Final = "the server has begun another episode"
_WEATHER: Final = tuple(UE4.named("weather").layout.fields)


@dataclass(slots=True, eq=False)
class Observation:
    """An observed tick.

    Attributes:
        time: Seconds since the episode began.
        real_time: Seconds of the server's own clock.
        records: The records of the frame, by type.
    """

    frame: int
    time: float
    real_time: float
    records: dict[str, Any]


class Observer:
    """Observes a server from `begin` on, while a `with` block runs.

    With additional data, it observes velocities, boxes, physics and the times of lights, too. With `attach`, heroes without
    a collision sensor get one until the end; else only collisions of other clients' sensors are observed. The interval is
    the least time between observed ticks, in s of real time.

    Attributes:
        missed: The number of ticks that were missed.
        why: The reason of the end, in words; "" before it.
        is_cut_short: Whether it has ended since something that was to be recorded is gone.
        times: The times of the latest observed frames by their numbers, in s since the episode began. A thread of the
            client adds to them.

    Raises:
        RecapError: On entry: there is no server.
    """

    map: carla.Map

    def __init__(
        self, host: str, port: int, *, additional_data: bool = False, attach: bool = False, interval: float = 0.0
    ) -> None:
        self.missed = 0
        self.why = ""
        self.is_cut_short = False
        self.times: dict[int, float] = {}
        self._host, self._port = host, port
        self._additional = additional_data
        self._attach = attach
        self._interval = interval
        self._callback: int | None = None
        self._lock = Lock()
        self._error: Exception | None = None
        self._observations: Queue[Observation] = Queue(_WAITING)
        self._later: deque[tuple[int, str, Any]] = deque()  # earliest frame, type, record
        self._newcomers: deque[tuple[int, carla.Actor]] = deque()  # with the frame in which they came
        self._vehicle_lights: dict[int, int] = {}
        self._light_times: dict[int, tuple[float, ...]] = {}
        self._weather: tuple[float, ...] = ()
        self._collision_count = 0
        self._frame = 0
        self._observed_at = self._asked_at = 0.0

    def __enter__(self) -> Self:
        self._connect()
        self._tracker = ActorTracker(self._world, additional_data=self._additional)
        self._listener = CollisionListener(self._world, self._note_collision, attach=self._attach)
        present = readable(self._world.get_actors())
        self._present = {actor.id for actor in present}
        self._newcomers.extend((0, actor) for actor in present)
        if self._additional:
            self._introduce()
        self._ask()
        self._observed_at = monotonic()
        return self

    def begin(self) -> None:
        """Begin to observe ticks."""
        self._callback = self._world.on_tick(self._on_tick)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.end("it is over")
        with suppress(*UNANSWERED):
            if self._callback is not None:
                self._world.remove_on_tick(self._callback)
        self._listener.close(is_gone=self.is_gone)
        sleep(_DRAIN)  # a client's thread that waits for Python's lock when the interpreter ends aborts the process

    def end(self, why: str, *, is_cut_short: bool = False) -> None:
        """End `observations` for a reason, in words; of several, the first one counts.

        They are cut short if the reason is that something is gone that was to be recorded.
        """
        if not self.why:
            self.why, self.is_cut_short = why, is_cut_short

    def until_signal(self) -> AbstractContextManager[None]:
        """Return a context in which SIGINT, SIGTERM and SIGHUP end `observations`, instead of the process."""
        return call_on_termination(lambda name: self.end(f"stopped by {name}"))

    def observations(self, idle: Callable[[], None] = lambda: None) -> Iterator[Observation]:
        """Yield the ticks until the end; `idle` is called whenever none has come for a moment. May raise `RecapError`."""
        held: deque[Observation] = deque()
        while not self.why:
            self._poll()
            most = _HELD
            try:
                held.append(self._observations.get(timeout=_PAUSE))
            except Empty:
                self._catch_up()
                most = 0
            while len(held) > most:
                yield self._completed(held.popleft())
            if not most:
                idle()
        with self._lock:  # no more are added
            held.extend(self._observations.queue)
        yield from map(self._completed, held)
        if self._error is not None:
            raise RecapError(f"{self.place}: {self._error}") from self._error

    @property
    def present(self) -> frozenset[int]:
        """The ids of the actors of the latest observed tick, including those that are left out."""
        return self._tracker.present

    @property
    def frame(self) -> int:
        """The number of the latest observed tick; 0 before the first one."""
        return self._frame

    @property
    def is_gone(self) -> bool:
        """Whether the server is gone, as far as is known: no request would be answered before its time is over."""
        return self.why == _GONE

    @property
    def place(self) -> str:
        """The address and the port of the server."""
        return f"{self._host}:{self._port}"

    def answer(self, question: Callable[[], T], default: T) -> T:
        """Return the server's answer; a default if the actor or the server is gone, which ends `observations`."""
        if self.is_gone:
            return default
        try:
            return question()
        except UNANSWERED:
            if not self._is_there():
                self.end(_GONE)
            return default

    def new_client(self) -> carla.Client:
        """Return a further client of the server, whose data arrive on connections and in a thread of its own."""
        client = carla.Client(self._host, self._port, 1)
        client.set_timeout(_FIRST_ANSWER)
        return client

    def _connect(self) -> None:
        if not self._is_there():
            raise RecapError(f"{self.place}: there is no CARLA server")
        self._client = carla.Client(self._host, self._port, 1)  # snapshots and collisions arrive in the same thread
        self._client.set_timeout(_FIRST_ANSWER)
        try:
            self._world = self._client.get_world()
            self._episode = self._world.id
            self.map = self._world.get_map()
        except UNANSWERED as error:
            raise RecapError(f"{self.place}: {single_line(error)}") from None
        self._client.set_timeout(ANSWER)

    def _is_there(self) -> bool:
        try:
            socket.create_connection((self._host, self._port), _CONNECTION).close()
        except (OSError, UnicodeError):  # the latter about a name such as a..b
            return False
        return True

    # --- in a thread of the client ---------------------------------------------------------------------------

    def _on_tick(self, snapshot: carla.WorldSnapshot) -> None:
        try:
            with self._lock:
                if not self.why:
                    self._observe(snapshot)
        except Exception as error:
            self._error = error
            self.end("an error")

    def _observe(self, snapshot: carla.WorldSnapshot) -> None:
        now, frame = monotonic(), snapshot.frame
        if snapshot.id != self._episode:
            return self.end(_ANOTHER_EPISODE)
        if frame <= self._frame or now - self._observed_at < self._interval or self._observations.full():
            return None
        if self._frame and not self._interval:
            self.missed += frame - self._frame - 1
        is_first, self._observed_at = not self._frame, now
        found = {actor.id: actor for actor in snapshot}
        came, gone = self._tracker.update(found)
        self._newcomers.extend((frame, actor) for actor in came if actor.id not in self._present)
        records: dict[str, Any] = {"destroyed": gone} if gone else {}
        if came:
            records |= self._tracker.introduction(came, found, attached=not is_first)
        records |= self._tracker.records(found, self._vehicle_lights)
        time = snapshot.timestamp
        self.times[frame] = time.elapsed_seconds
        self._frame = frame
        if len(self.times) > _WAITING:
            del self.times[next(iter(self.times))]
        self._observations.put(Observation(frame, time.elapsed_seconds, time.platform_timestamp, records))
        return None

    def _note_collision(self, frame: int, actor1: int, actor2: int) -> None:
        self._later.append((frame, "collisions", (actor1, actor2)))

    # --- in the thread that takes the observations -------------------------------------------------------------------------

    def _catch_up(self) -> None:
        """Observe the last tick before a pause, if it was left out."""
        if not self._interval or self.why:
            return
        with self._lock:
            before = copy(self._tracker)
            try:
                self._observe(self._world.get_snapshot())
            except UNANSWERED:  # the world has gone on meanwhile without an actor of the snapshot; the next one follows
                self._tracker = before

    def _poll(self) -> None:
        """Request other data when it is due, and check that the server is running."""
        now = monotonic()
        is_quiet = now - self._observed_at > _QUIET
        if now - self._asked_at < (_QUIET if is_quiet else _ASKING):
            return
        if is_quiet and not self._is_there():
            self.end(_GONE)
            return
        if is_quiet and self.answer(lambda: self._client.get_world().id, self._episode) != self._episode:
            self.end(_ANOTHER_EPISODE)
            return
        self._ask()
        self._asked_at = monotonic()

    def _ask(self) -> None:
        """Request the lights of vehicles, the weather and what else is not in snapshots; what fails is asked again later."""
        self.answer(self._ask_about_world, None)
        if not self.why:
            self.answer(self._ask_about_actors, None)

    def _ask_about_world(self) -> None:
        lights = self._world.get_vehicles_light_states()
        self._vehicle_lights = {id: int(state) for id, state in lights.items()}
        weather = self._world.get_weather()
        row = tuple(getattr(weather, name) for name in _WEATHER)
        if row != self._weather:
            self._weather = row
            self._later.append((0, "weather", row))

    def _ask_about_actors(self) -> None:
        if self._additional:
            for light in self._tracker.of(ActorKind.TRAFFIC_LIGHT).values():
                self._note_light_times(0, light)
        self._listener.update(self._tracker)

    def _introduce(self) -> None:
        """Request the data of new actors that are not in snapshots."""
        while self._newcomers and not self.why:
            frame, actor = self._newcomers.popleft()
            kind = actors.kind_of(actor.type_id)
            if kind == ActorKind.TRAFFIC_LIGHT:
                self.answer(partial(self._note_light_times, frame, actor), None)
            requests: dict[str, Callable[[Any], list[Any]]] = {}
            if kind in (ActorKind.TRAFFIC_LIGHT, ActorKind.TRAFFIC_SIGN):
                requests["trigger_volumes"] = actors.trigger_volume
            elif kind != ActorKind.SENSOR:
                requests["bounding_boxes"] = actors.bounding_box
            if kind == ActorKind.VEHICLE:
                requests["physics"] = actors.physics
            for name, request in requests.items():
                records: list[Any] = self.answer(partial(request, actor), [])
                self._later.extend((frame, name, record) for record in records)

    def _note_light_times(self, frame: int, light: carla.TrafficLight) -> None:
        times = actors.light_times(light)
        if self._light_times.get(light.id) != times:
            self._light_times[light.id] = times
            self._later.append((frame, "light_times", times))

    def _completed(self, observation: Observation) -> Observation:
        """Return an observation with the records that arrived later."""
        if self._additional:
            self._introduce()
        more: defaultdict[str, list[Any]] = defaultdict(list)
        for _ in range(len(self._later)):
            frame, name, record = self._later.popleft()
            if frame <= observation.frame:
                more[name].append(record)
            else:
                self._later.append((frame, name, record))
        if "collisions" in more:
            more["collisions"] = self._numbered(more["collisions"])
        observation.records |= more
        return observation

    def _numbered(self, collisions: list[tuple[int, int]]) -> list[tuple[int, int, int, bool, bool]]:
        """Return each pair once; repetitions use up a number, too, as in CARLA."""
        heroes = self._tracker.heroes
        rows: dict[tuple[int, int], tuple[int, int, int, bool, bool]] = {}
        for number, (actor1, actor2) in enumerate(collisions, self._collision_count):
            other = actor2 if actor2 in self._tracker.seen else NO_ACTOR
            rows.setdefault((actor1, other), (number, actor1, other, actor1 in heroes, other in heroes))
        self._collision_count += len(collisions)
        return list(rows.values())
