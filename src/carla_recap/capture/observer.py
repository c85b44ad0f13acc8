"""Sees the world of a server from tick to tick, as one more of its clients: it never ticks, and changes nothing.

Snapshots come in a thread of CARLA's client, and are read there, while what they say is what the client knows. All else
is asked of the server now and then, by whoever takes the sights.
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
from time import monotonic
from typing import TYPE_CHECKING, Any, Final, Self

import carla

from carla_recap.capture import describing
from carla_recap.capture.asking import UNANSWERED, readable
from carla_recap.capture.cast import Cast
from carla_recap.capture.contacts import Contacts
from carla_recap.errors import RecapError
from carla_recap.records import NO_ACTOR, UE4, ActorKind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import TracebackType

HOST: Final = "127.0.0.1"
PORT: Final = 2000
"""Where CARLA's servers listen by default."""

_GREETING: Final = 10.0  # s, within which the server must answer at first
_ANSWER: Final = 2.0  # s, within which it must answer later; else it is asked again
_REACHED: Final = 2.0  # s, within which it must take a connection
_QUIET: Final = 1.0  # s; when no tick came for so long, we look whether the server is there
_ASKING: Final = 0.1  # s between questions to the server
_PAUSE: Final = 0.05  # s
_WAITING: Final = 4096  # so many sights may wait; of what comes then, nothing is seen
_HELD: Final = 4  # so many sights are held back, for contacts come by other ways
_GONE: Final = "the server is gone"
_ANOTHER_EPISODE: Final = "the server has begun another episode"
_WEATHER: Final = tuple(UE4.named("weather").layout.fields)


@dataclass(slots=True, eq=False)
class Sight:
    """What is seen of a tick.

    Attributes:
        frame: The number of the frame.
        time: Seconds since the episode began.
        real_time: Seconds of the server's own clock.
        records: What a recording tells of it, by type.
    """

    frame: int
    time: float
    real_time: float
    records: dict[str, Any]


class Observer:
    """Watches a server, while a `with` block runs.

    Args:
        host: Where the server is.
        port: Its port.
        additional_data: See velocities, boxes, physics and the times of lights, too.
        attach: Whether heroes without a collision sensor get one until the end; else only contacts that others' sensors
            tell of are seen.
        interval: Leave out ticks that come within so many seconds, of the wall's clock, after one that was seen.

    Attributes:
        missed: How many ticks were not seen that should have been.
        why: Why it has ended, in words; "" as long as it has not.
        map: The map.

    Raises:
        RecapError: On entry: there is no server.
    """

    map: carla.Map

    def __init__(
        self, host: str, port: int, *, additional_data: bool = False, attach: bool = False, interval: float = 0.0
    ) -> None:
        self.missed = 0
        self.why = ""
        self._host, self._port = host, port
        self._additional = additional_data
        self._attach = attach
        self._interval = interval
        self._lock = Lock()
        self._error: Exception | None = None
        self._sights: Queue[Sight] = Queue(_WAITING)
        self._later: deque[tuple[int, str, Any]] = deque()  # from which frame on it can be told, of what type, and what
        self._newcomers: deque[tuple[int, carla.Actor]] = deque()  # with the frame in which they came
        self._vehicle_lights: dict[int, int] = {}
        self._light_times: dict[int, tuple[float, ...]] = {}
        self._weather: tuple[float, ...] = ()
        self._contacts_told = 0
        self._frame = 0
        self._seen_at = self._asked_at = 0.0

    def __enter__(self) -> Self:
        self._connect()
        self._cast = Cast(self._world, additional_data=self._additional)
        self._contacts = Contacts(self._world, self._note_contact, attach=self._attach)
        actors = readable(self._world.get_actors())
        self._present = {actor.id for actor in actors}
        self._newcomers.extend((0, actor) for actor in actors)
        if self._additional:
            self._introduce()
        self._ask()
        self._callback = self._world.on_tick(self._on_tick)
        self._seen_at = monotonic()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.end("it is over")
        with suppress(*UNANSWERED):
            self._world.remove_on_tick(self._callback)
        self._contacts.close()

    def end(self, why: str) -> None:
        """Let `sights` come to their end; of several reasons, the first one counts."""
        self.why = self.why or why

    def sights(self, idle: Callable[[], None] = lambda: None) -> Iterator[Sight]:
        """What is seen, tick by tick, until the end.

        Args:
            idle: Is called whenever nothing has come for a moment.

        Raises:
            RecapError: The server tells what cannot be understood.
        """
        held: deque[Sight] = deque()
        while not self.why:
            self._tend()
            most = _HELD
            try:
                held.append(self._sights.get(timeout=_PAUSE))
            except Empty:
                self._catch_up()
                most = 0
            while len(held) > most:
                yield self._completed(held.popleft())
            if not most:
                idle()
        with self._lock:  # no more of them come
            held.extend(self._sights.queue)
        yield from map(self._completed, held)
        if self._error is not None:
            raise RecapError(f"{self._place}: {self._error}") from self._error

    @property
    def _place(self) -> str:
        return f"{self._host}:{self._port}"

    def _connect(self) -> None:
        if not self._is_there():
            raise RecapError(f"{self._place}: there is no CARLA server")
        self._client = carla.Client(self._host, self._port, 1)  # snapshots and contacts come in the same thread
        self._client.set_timeout(_GREETING)
        try:
            self._world = self._client.get_world()
            self._episode = self._world.id
            self.map = self._world.get_map()
        except UNANSWERED as error:
            raise RecapError(f"{self._place}: {' '.join(str(error).split())}") from None
        self._client.set_timeout(_ANSWER)

    def _is_there(self) -> bool:
        try:
            socket.create_connection((self._host, self._port), _REACHED).close()
        except OSError:
            return False
        return True

    # --- in a thread of the client ---------------------------------------------------------------------------

    def _on_tick(self, snapshot: carla.WorldSnapshot) -> None:
        try:
            with self._lock:
                if not self.why:
                    self._see(snapshot)
        except Exception as error:
            self._error = error
            self.end("an error")

    def _see(self, snapshot: carla.WorldSnapshot) -> None:
        now, frame = monotonic(), snapshot.frame
        if snapshot.id != self._episode:
            return self.end(_ANOTHER_EPISODE)
        if frame <= self._frame or now - self._seen_at < self._interval or self._sights.full():
            return None
        if self._frame and not self._interval:
            self.missed += frame - self._frame - 1
        is_first, self._frame, self._seen_at = not self._frame, frame, now
        found = {actor.id: actor for actor in snapshot}
        came, gone = self._cast.follow(found)
        self._newcomers.extend((frame, actor) for actor in came if actor.id not in self._present)
        told: dict[str, Any] = {"destroyed": gone} if gone else {}
        if came:
            told |= self._cast.introduced(came, found, attached=not is_first)
        told |= self._cast.records(found, self._vehicle_lights)
        time = snapshot.timestamp
        self._sights.put(Sight(frame, time.elapsed_seconds, time.platform_timestamp, told))
        return None

    def _note_contact(self, frame: int, actor1: int, actor2: int) -> None:
        self._later.append((frame, "collisions", (actor1, actor2)))

    # --- by whoever takes the sights -------------------------------------------------------------------------

    def _catch_up(self) -> None:
        """See the last tick before a pause, if it was left out."""
        if not self._interval or self.why:
            return
        with self._lock:
            before = copy(self._cast)
            try:
                self._see(self._world.get_snapshot())
            except UNANSWERED:  # the world has gone on meanwhile, without somebody of the snapshot; the next one tells
                self._cast = before

    def _tend(self) -> None:
        """Look after what is told seldom, when it is time for that, and whether the server is there."""
        now = monotonic()
        is_quiet = now - self._seen_at > _QUIET
        if now - self._asked_at < (_QUIET if is_quiet else _ASKING):
            return
        if is_quiet and not self._is_there():
            self.end(_GONE)
            return
        if is_quiet and self._answer(lambda: self._client.get_world().id, self._episode) != self._episode:
            self.end(_ANOTHER_EPISODE)
            return
        self._ask()
        self._asked_at = monotonic()

    def _ask(self) -> None:
        with suppress(*UNANSWERED):  # the server does not answer; it will be asked again
            lights = self._world.get_vehicles_light_states()
            self._vehicle_lights = {id: int(state) for id, state in lights.items()}
            weather = self._world.get_weather()
            row = tuple(getattr(weather, name) for name in _WEATHER)
            if row != self._weather:
                self._weather = row
                self._later.append((0, "weather", row))
        with suppress(*UNANSWERED):  # an actor is gone, and will be known to be
            if self._additional:
                for light in self._cast.of(ActorKind.TRAFFIC_LIGHT).values():
                    self._note_light_times(0, light)
            self._contacts.attend(self._cast)

    def _answer(self, question: Callable[[], Any], default: Any) -> Any:
        """What the server answers; a default where it does not, as an actor is gone, or all of the server."""
        try:
            return question()
        except UNANSWERED:
            if not self._is_there():
                self.end(_GONE)
            return default

    def _introduce(self) -> None:
        """Tell what the server has to be asked of each newcomer."""
        while self._newcomers and not self.why:
            frame, actor = self._newcomers.popleft()
            kind = describing.kind_of(actor.type_id)
            if kind == ActorKind.TRAFFIC_LIGHT:
                self._answer(partial(self._note_light_times, frame, actor), None)
            tellers: dict[str, Callable[[Any], list[Any]]] = {}
            if kind in (ActorKind.TRAFFIC_LIGHT, ActorKind.TRAFFIC_SIGN):
                tellers["trigger_volumes"] = describing.trigger_volume
            elif kind != ActorKind.SENSOR:
                tellers["bounding_boxes"] = describing.box
            if kind == ActorKind.VEHICLE:
                tellers["physics"] = lambda vehicle: [describing.physics(vehicle)]
            for name, teller in tellers.items():
                self._later.extend((frame, name, record) for record in self._answer(partial(teller, actor), []))

    def _note_light_times(self, frame: int, light: carla.TrafficLight) -> None:
        times = describing.light_times(light)
        if self._light_times.get(light.id) != times:
            self._light_times[light.id] = times
            self._later.append((frame, "light_times", times))

    def _completed(self, sight: Sight) -> Sight:
        """A sight, with what came later."""
        if self._additional:
            self._introduce()
        more: defaultdict[str, list[Any]] = defaultdict(list)
        for _ in range(len(self._later)):
            frame, name, record = self._later.popleft()
            if frame <= sight.frame:
                more[name].append(record)
            else:
                self._later.append((frame, name, record))
        if "collisions" in more:
            more["collisions"] = self._numbered(more["collisions"])
        sight.records |= more
        return sight

    def _numbered(self, contacts: list[tuple[int, int]]) -> list[tuple[int, int, int, bool, bool]]:
        """Each pair once; repetitions use up a number, too, as with CARLA."""
        heroes = self._cast.heroes
        rows: dict[tuple[int, int], tuple[int, int, int, bool, bool]] = {}
        for number, (actor1, actor2) in enumerate(contacts, self._contacts_told):
            other = actor2 if actor2 in self._cast.seen else NO_ACTOR
            rows.setdefault((actor1, other), (number, actor1, other, actor1 in heroes, other in heroes))
        self._contacts_told += len(contacts)
        return list(rows.values())
