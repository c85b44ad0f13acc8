"""A WebSocket to which Foxglove connects: it plays a recording by its own timeline, or shows a running world.

The messages are those of an export; Foxglove's SDK only sends them. What viewers request arrives in threads of the SDK, and
is done in the thread that sends.
"""

from __future__ import annotations

import logging
import math
from bisect import bisect_left
from heapq import merge
from itertools import chain
from operator import attrgetter
from threading import Event, Lock, Thread
from time import monotonic
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.formats.mcap.schema import SECOND, LogClock
from carla_recap.model.frame import SAME_TIME
from carla_recap.replay import Player
from carla_recap.replay.follow import HERO
from carla_recap.roads.surfaces import road_network_of_map
from carla_recap.scene.ahead import stop_points
from carla_recap.scene.captions import PlayedIncidents
from carla_recap.scene.follow import LiveFollow
from carla_recap.show.foxglove.ground import MAP, map_message, town_around
from carla_recap.show.foxglove.messages import timestamps
from carla_recap.show.foxglove.topics import (
    LOG,
    RATE,
    SLACK,
    STATES,
    TOPICS,
    SceneMessages,
    Sent,
    incident_messages,
    passed_topics,
)
from carla_recap.town.mesh import town_of_map
from carla_recap.util.signals import unwind_on_termination

try:
    import foxglove
    from foxglove.websocket import Capability, PlaybackCommand, PlaybackState, PlaybackStatus, ServerListener
except ImportError:
    raise MissingExtra("a connection of Foxglove", "foxglove-live") from None

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from types import TracebackType

    from foxglove.websocket import ChannelView, Client, PlaybackControlRequest

    from carla_recap.formats.base import Topic
    from carla_recap.model.frame import Frame, Header
    from carla_recap.recording import Recording
    from carla_recap.replay import Follow
    from carla_recap.replay.player import Progress
    from carla_recap.roads import RoadMap
    from carla_recap.util.arrays import Floats

PORT: Final = 8765
"""The port that Foxglove suggests."""

_HOST: Final = "127.0.0.1"
_LEAD: Final = 5.0  # s before a moment that is sought, in which the view of the followed actor becomes calm
_STEP: Final = 0.02  # s of real time between two sendings
_LONGEST: Final = 0.25  # s of real time that pass between them at most; a machine that is slower plays more slowly
_PAUSE: Final = 0.25  # s; the longest wait for a request
_GRACE: Final = 2.0  # s; the SDK waits for viewers that do not read, or have connected without a word, as long as they stay
_FASTEST: Final = 100.0
_WHOLE_AFTER: Final = 10 * SECOND
_MOST_WAITING: Final = 1024  # messages that wait for a slow viewer, which loses older ones


class FoxgloveServer:
    """Sends messages to all viewers that are connected, during a `with` block; it listens on the loopback alone.

    Viewers play a recording by its timeline; without one, what is sent is live. Further topics are those beside the ones of
    scenes, such as those of sensors. A `RecapError` says that the port is in use; 0 is any free one.
    """

    def __init__(self, name: str, port: int = PORT, timeline: Timeline | None = None, further: Sequence[Topic] = ()) -> None:
        self._timeline = timeline
        self._requests = _Requests(timeline)
        self._latest: dict[str, tuple[int, bytes]] = {}  # of each topic
        self._whole_at: dict[str, int] = {}  # when a message of each topic is sent whole again, in ns since 1970
        self._time: int | None = None
        logging.getLogger("foxglove").setLevel(logging.CRITICAL)  # viewers may leave without a word
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name=name,
                host=_HOST,
                port=port,
                context=self._context,
                server_listener=self._requests,
                capabilities=[Capability.Time],
                playback_time_range=None if timeline is None else (timeline.start, timeline.stop),
                message_backlog_size=_MOST_WAITING,
            )
        except (OSError, RuntimeError) as error:
            reason = str(error).rpartition(": ")[2].partition(" (os error")[0]
            raise RecapError(f"{_HOST}:{port}: Foxglove cannot connect to it: {reason}") from None
        self._channels = {
            topic.name: foxglove.Channel(
                topic.name,
                schema=foxglove.Schema(name=topic.message, encoding="protobuf", data=topic.schema()),
                message_encoding="protobuf",
                context=self._context,
            )
            for topic in (*TOPICS, *further)
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        stopping = Thread(target=self._server.stop, daemon=True)
        stopping.start()
        stopping.join(_GRACE)

    @property
    def address(self) -> str:
        """The address that Foxglove is given."""
        return f"ws://{_HOST}:{self._server.port}"

    def send(self, sent: Sent) -> None:
        """Send a message, which becomes the latest one of its topic: its change, but all of it now and then.

        A viewer that has lost messages shows all again then.
        """
        time, topic, data, change = sent
        self._latest[topic] = time, data
        if change is None or time >= self._whole_at.get(topic, 0):
            self._whole_at[topic], change = time + _WHOLE_AFTER, data
        self._channels[topic].log(change, log_time=time)

    def begin(self, latest: dict[str, Sent]) -> None:
        """Send the latest message of each topic at another moment."""
        self._latest.clear()
        self._whole_at.clear()
        for sent in latest.values():
            self.send(sent)

    def wait(self, seconds: float) -> None:
        """Wait for a request of a viewer."""
        self._requests.requested.wait(seconds)
        self._requests.requested.clear()

    def welcome(self) -> None:
        """Send the latest messages of topics that have new subscribers, and the state; other viewers show them again."""
        wanted = self._requests.take_topics()
        for topic in wanted & self._latest.keys() - {LOG}:  # each message on it is shown, not the latest one
            time, data = self._latest[topic]
            self._channels[topic].log(data, log_time=time)
        if wanted and self._timeline is not None:
            self.show(self._timeline.state())
        elif wanted and self._time is not None:
            self.show_time(self._time)

    def show(self, state: PlaybackState) -> None:
        """Tell viewers where playback is."""
        self._server.broadcast_playback_state(state)
        self.show_time(state.current_time)

    def show_time(self, time: int) -> None:
        """Tell viewers the time, in ns since 1970, by which they show messages."""
        self._time = time
        self._server.broadcast_time(time)


class Timeline:
    """Where playback is between two moments, in ns since 1970; viewers change it in threads of theirs. It begins paused."""

    def __init__(self, start: int, stop: int) -> None:
        self.start, self.stop = start, stop
        self._lock = Lock()
        self._now: float = start
        self.speed = 1.0  # the seconds of the recording that are played in a second
        self.is_playing = self._ended = False
        self._sought = True  # whether the messages of another moment follow

    def pause(self) -> None:
        """Stop the time."""
        with self._lock:
            self.is_playing = False

    def request(self, request: PlaybackControlRequest) -> PlaybackState:
        """Do what a viewer requests, and return the new state."""
        with self._lock:
            seek = request.seek_time
            self.is_playing = request.playback_command == PlaybackCommand.Play
            if seek is None and self.is_playing and self._now >= self.stop:
                seek = self.start
            if seek is not None:
                self._now, self._sought = min(max(seek, self.start), self.stop), True
            self._ended = False
            if 0 < request.playback_speed < math.inf:
                self.speed = min(request.playback_speed, _FASTEST)
            return self._state(did_seek=seek is not None, request=request.request_id)

    def advance(self, seconds: float) -> tuple[int, bool]:
        """Let real time pass; return the moment, and whether it was sought since the last call, when time does not pass."""
        with self._lock:
            if self.is_playing and not self._sought:
                self._now = min(self._now + seconds * self.speed * SECOND, self.stop)
            sought, self._sought = self._sought, False
            return int(self._now), sought

    def end(self) -> bool:
        """Return whether playback has come to the end, and end it."""
        with self._lock:
            self._ended = self.is_playing and self._now >= self.stop and not self._sought
            self.is_playing = self.is_playing and not self._ended
            return self._ended

    def state(self) -> PlaybackState:
        """Return the state, for viewers that have not changed it."""
        with self._lock:
            return self._state()

    def _state(self, *, did_seek: bool = False, request: str | None = None) -> PlaybackState:
        status = (
            PlaybackStatus.Ended if self._ended else PlaybackStatus.Playing if self.is_playing else PlaybackStatus.Paused
        )
        return PlaybackState(status, int(self._now), self.speed, did_seek, request)


class _Requests(ServerListener):
    """Takes the requests of viewers, in threads of the SDK; `requested` is set by each request of playback."""

    def __init__(self, timeline: Timeline | None) -> None:
        self._timeline = timeline
        self._lock = Lock()
        self.requested = Event()
        self._topics: set[str] = set()
        self._subscriptions = 0

    def take_topics(self) -> set[str]:
        """Return the topics to which clients have subscribed since the last call."""
        with self._lock:
            topics, self._topics = self._topics, set()
        return topics

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        with self._lock:
            self._subscriptions += 1
            self._topics.add(channel.topic)

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        with self._lock:
            self._subscriptions -= 1
            is_alone = not self._subscriptions
        if is_alone and self._timeline is not None:
            self._timeline.pause()

    def on_playback_control_request(self, playback_control_request: PlaybackControlRequest) -> PlaybackState | None:
        state = None if self._timeline is None else self._timeline.request(playback_control_request)
        self.requested.set()
        return state


def serve_recording(
    source: Recording,
    *,
    port: int = PORT,
    follow: Follow | None = None,
    start: float = 0.0,
    duration: float = 0.0,
    road_map: RoadMap | None = None,
    progress: Progress | None = None,
    ready: Callable[[str], object] = print,
) -> None:
    """Let Foxglove play a recording, until Ctrl-C is pressed; for the arguments, see `export_foxglove`.

    Its scenes are gone through once before, to find incidents. `ready` gets the address as soon as viewers can connect; the
    port 0 is any free one. A `RecapError` says that the actor or the time does not exist, or the port is in use.
    """
    played = _PlayedRecording(source, follow, start, duration, road_map, progress)
    timeline = Timeline(*played.span)
    name = source.reader.path.name
    try:
        with unwind_on_termination(), FoxgloveServer(name, port, timeline, played.further) as server:
            ready(server.address)
            _play(played, timeline, server)
    except (KeyboardInterrupt, BrokenPipeError):  # the latter: the output of `ready` is closed
        return


def _play(played: _PlayedRecording, timeline: Timeline, server: FoxgloveServer) -> None:
    """Send the messages of a recording by a timeline, for ever."""
    messages: Iterator[Sent] = iter(())
    waiting: Sent | None = None
    before, has_played = monotonic(), False
    while True:
        now = monotonic()
        moment, sought = timeline.advance(min(now - before, _LONGEST) if has_played else 0.0)
        before = now
        if sought:
            messages = played.messages(moment, lambda: RATE / max(timeline.speed, 1.0))
            latest: dict[str, Sent] = {}
            waiting = next(messages, None)
            while waiting is not None and waiting.time <= moment:
                latest[waiting.topic] = waiting
                waiting = next(messages, None)
            server.begin(latest)
        else:
            while waiting is not None and waiting.time <= moment:
                server.send(waiting)
                waiting = next(messages, None)
        server.welcome()
        if timeline.end():
            server.show(timeline.state())
        elif sought or timeline.is_playing:
            server.show_time(moment)
        has_played = timeline.is_playing
        server.wait(_STEP if has_played else _PAUSE)


class _PlayedRecording:
    """A recording that is played from any moment on.

    Its span is between two moments in ns since 1970; its further topics are those beside the ones of scenes.
    """

    def __init__(
        self,
        source: Recording,
        follow: Follow | None,
        start: float,
        duration: float,
        road_map: RoadMap | None,
        progress: Progress | None,
    ) -> None:
        self._source = source
        player = Player(source, start=start, duration=duration, follow=follow)
        self._start, self._stop, self._followed = player.start, player.stop, player.followed
        town = town_around(road_map, player, source)
        self._stops = stop_points(source.reader)
        self._clock = clock = LogClock(source.reader.header)
        first, last = clock.at(player.start), clock.at(player.stop)
        if first is None or last is None:
            raise RecapError(f"{source.location}: its times cannot be shown; they end at {player.stop:g} s")
        self.span = first, last
        self.further = passed_topics(source.reader)
        self._map = map_message(town, timestamps(np.array([first], np.uint64))[0])
        roads = road_network_of_map(road_map) if town is not None else None
        incidents = PlayedIncidents(player, roads)
        # As a view, the times of a batch would keep all of it in memory.
        seconds: Floats = np.concatenate([batch.time.copy() for batch in player.batches(progress)])
        times = np.array([clock.at(time) or 0 for time in seconds.tolist()], np.uint64)
        self._incidents = sorted(incident_messages(incidents.found(), seconds, times).in_order(), key=attrgetter("time"))

    def messages(self, moment: int, rate: Callable[[], float]) -> Iterator[Sent]:
        """Yield the messages from some time before a moment on, in the order of time; of sensors, the latest ones then, too.

        The moment is in ns since 1970; `rate` returns how many scenes are shown in a second of the recording.
        """
        elapsed = self._clock.elapsed(moment)
        begin = max(elapsed - _LEAD, self._start)
        first = bisect_left(self._incidents, moment, key=attrgetter("time"))
        states = [sent for sent in self._incidents[:first] if sent.topic == STATES][-1:]
        parts = self._scenes(begin, rate), self._further(elapsed, rate), [*states, *self._incidents[first:]]
        return merge(*parts, key=attrgetter("time"))

    def _further(self, begin: float, rate: Callable[[], float]) -> Iterator[Sent]:
        """Yield the further messages: the latest ones at a time, then those that follow, fewer while it plays faster."""
        reader, names = self._source.reader, [topic.name for topic in self.further]
        if not names:
            return
        due: dict[str, float] = {}
        latest = reader.latest_messages(names, begin)
        for topic, elapsed, data in chain(latest, reader.further_messages(names, begin, self._stop + 2 * SAME_TIME)):
            time, shown = self._clock.at(elapsed), rate()
            if time is not None and (shown >= RATE or elapsed >= due.get(topic, -math.inf)):
                due[topic] = elapsed + SLACK / shown
                yield Sent(time, topic, data)

    def _scenes(self, begin: float, rate: Callable[[], float]) -> Iterator[Sent]:
        player = Player(self._source, start=begin, duration=max(self._stop - begin, 0.0))
        messages = SceneMessages(self._source.reader.header, self._followed, None, self._stops)
        messages.describer.recall(player)
        for batch in player.batches():
            for part in messages.of(batch):
                messages.rate = rate()
                for sent in part.in_order():
                    yield sent._replace(data=self._map) if sent.topic == MAP else sent
        yield from messages.end().in_order()


class FoxgloveView:
    """Shows the frames of a running simulation as they come; for the actor to follow, see `LiveFollow`."""

    def __init__(
        self, server: FoxgloveServer, header: Header, follow: Follow = HERO, road_map: RoadMap | None = None
    ) -> None:
        self._server = server
        self._follow = LiveFollow(follow)
        self._messages = SceneMessages(header, None, town_of_map(road_map), self._follow.stops)

    def enter(self, frame: Frame) -> None:
        """Add a frame."""
        scene, chosen = self._follow.scene(frame)
        if chosen is not None:
            self._messages.follow(chosen)
        for part in self._messages.of(scene.batch):
            for sent in part.in_order():
                self._server.send(sent)
            self._server.show_time(int(part.times[-1]))

    def flush(self) -> None:
        """Send what new viewers need."""
        self._server.welcome()

    def close(self) -> None:
        """Show the last frame."""
        for sent in self._messages.end().in_order():
            self._server.send(sent)
