"""All topics, and their messages for each batch of scenes."""

from __future__ import annotations

import math
from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.formats.base import LATCHED
from carla_recap.formats.mcap.container import message_topic
from carla_recap.formats.mcap.schema import LogClock
from carla_recap.replay import Played
from carla_recap.roads.surfaces import road_network_of_map
from carla_recap.scene.ahead import stop_points
from carla_recap.scene.captions import EventText, Level, PlayedIncidents, incident_lines
from carla_recap.scene.description import SceneDescriber
from carla_recap.scene.follow import FollowedActor
from carla_recap.scene.state_lanes import incident_lanes, verdict_lanes
from carla_recap.show.foxglove import actor_entities, bodies, followed
from carla_recap.show.foxglove.ground import MAP, MARKS, map_message, mark_messages, town_around
from carla_recap.show.foxglove.messages import FrameTransforms, Log, SceneUpdate, ShownScenes, single, timestamps
from carla_recap.v1.followed_pb2 import Followed, ShownLights, ShownState, ShownStates

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from google.protobuf.message import Message

    from carla_recap.formats.base import Reader, Topic
    from carla_recap.model.frame import Header
    from carla_recap.queries.incidents import Incident, IncidentOptions
    from carla_recap.queries.verdicts import Verdict
    from carla_recap.recording import Recording
    from carla_recap.replay import Player
    from carla_recap.replay.player import Progress
    from carla_recap.replay.scene import SceneBatch
    from carla_recap.roads import RoadMap
    from carla_recap.scene.ahead import StopPoints
    from carla_recap.scene.captions import Line
    from carla_recap.scene.description import SceneDescription, Uncut
    from carla_recap.scene.follow import FollowedSeries
    from carla_recap.scene.state_lanes import StateLane
    from carla_recap.show.foxglove.messages import Times, TopicMessages
    from carla_recap.town.mesh import TownMesh
    from carla_recap.util.arrays import Floats, Indices

LOG: Final = "/log"
STATES: Final = "/states"
_PROTOBUF: Final = "protobuf"

_MESSAGES: Final[dict[str, type[Message]]] = {
    MAP: SceneUpdate,
    bodies.VEHICLES: SceneUpdate,
    bodies.WALKERS: SceneUpdate,
    bodies.OTHERS: SceneUpdate,
    bodies.LAMPS: SceneUpdate,
    bodies.SIGNALS: SceneUpdate,
    MARKS: SceneUpdate,
    followed.AHEAD: SceneUpdate,
    followed.TRANSFORMS: FrameTransforms,
    actor_entities.MOVED: FrameTransforms,
    actor_entities.STILL: FrameTransforms,
    followed.HERO: Followed,
    followed.LIGHTS: ShownLights,
    LOG: Log,
    STATES: ShownStates,
}


TOPICS: Final = [
    message_topic(name, type, {} if name in (LOG, followed.HERO) else {LATCHED: "1"}) for name, type in _MESSAGES.items()
]
"""All topics."""

RATE: Final = 20.0
"""The number of scenes shown per second, at most."""
SLACK: Final = 0.9
"""The part of the time between two shown scenes after which the next one is shown: frames do not come quite evenly."""

_MOST_BYTES: Final = 1 << 29  # of the messages with models in a file, each of which has all that its topic shows
_TOGETHER: Final = 128  # scenes whose messages are made at once
_LEVELS: Final = {Level.DEBUG: Log.DEBUG, Level.INFO: Log.INFO, Level.WARNING: Log.WARNING, Level.ERROR: Log.ERROR}


def passed_topics(reader: Reader) -> list[Topic]:
    """Return the topics of a recording that Foxglove gets beside those of its scenes, such as those of sensors."""
    own = {topic.name for topic in TOPICS}
    found = [each.topic for name, each in reader.further_topics().items() if name not in own]
    return [topic for topic in found if topic.message and topic.encoding == topic.schema_encoding == _PROTOBUF]


class Sent(NamedTuple):
    """A message: its time in ns since 1970, its topic, and its data; see `TopicMessages` for the change."""

    time: int
    topic: str
    data: bytes
    change: bytes | None = None


class TimedMessages(NamedTuple):
    """Messages of several topics."""

    messages: list[TopicMessages]  # the messages; the rows of each topic are positions in `times`
    times: Times  # the moments of scenes, in ns since 1970
    elapsed: Floats  # the same in elapsed seconds

    def in_order(self) -> Iterator[Sent]:
        """Yield the messages in the order of time."""
        found = [(some.topic, row, some.change) for some in self.messages for row in some.data]
        rows = np.concatenate([some.rows for some in self.messages]) if self.messages else np.zeros(0, np.intp)
        for index in np.argsort(rows, kind="stable").tolist():
            topic, data, change = found[index]
            yield Sent(int(self.times[rows[index]]), topic, data.tobytes(), change)


class SceneMessages:
    """Makes the messages of scenes, which have to come in order; with events, they are shown beside the `rate` per second.

    The town is given if it is known; for the stops, of which more may be added later, see `carla_recap.scene.ahead`, for the
    most bytes `ActorEntities`.
    """

    def __init__(
        self,
        header: Header,
        follow: int | None,
        town: TownMesh | None,
        stops: StopPoints | None = None,
        most_bytes: float = math.inf,
    ) -> None:
        self._clock = LogClock(header)
        self._stops = {} if stops is None else stops
        self._followed = FollowedActor(follow, self._stops)
        self._town = town
        self.describer = SceneDescriber()
        self._entities = actor_entities.ActorEntities(most_bytes)
        self._motion = followed.FollowedMotion()
        self._frames = followed.ViewFrames()
        self._lights = followed.LightMessages()
        self._text = EventText()
        self._due = -math.inf  # the elapsed time of the next scene to show
        self._last: tuple[SceneDescription, Times, FollowedSeries] | None = None
        self._shown = False  # whether the last scene is shown
        self.rate = RATE

    def follow(self, id: int) -> None:
        """Follow another actor from the next scene on."""
        self._followed = FollowedActor(id, self._stops)

    def of(self, batch: SceneBatch) -> Iterator[TimedMessages]:
        """Yield the messages of scenes, which follow those before."""
        for start in range(0, len(batch), _TOGETHER):
            part = batch if len(batch) <= _TOGETHER else batch[start : start + _TOGETHER]
            times = self._times_of(part)
            series = self._followed.series(part)
            description = self.describer.describe(part)
            messages = list(self._messages(description, times, series))
            self._last = description, times, series
            yield TimedMessages(messages, times, part.time)

    def end(self) -> TimedMessages:
        """Return the messages that show the last scene, as far as it is not shown yet."""
        if self._last is None:
            return TimedMessages([], np.zeros(0, np.uint64), np.zeros(0))
        description, times, series = self._last
        batch = description.batch
        row, elapsed = len(batch) - 1, batch.time[-1].item()
        messages: list[TopicMessages] = []
        if not self._shown:
            messages += self._show(description, np.array([row]), times, series)
        if self._lights.latest.elapsed != elapsed:
            self._lights.latest.elapsed = elapsed
            messages.append(single(followed.LIGHTS, row, self._lights.latest))
        return TimedMessages(messages, times, batch.time)

    def _messages(self, description: SceneDescription, times: Times, series: FollowedSeries) -> Iterator[TopicMessages]:
        """Yield the messages of scenes, given the time of each in ns since 1970, and the followed actor in them."""
        batch = description.batch
        if self._last is None:
            yield single(MAP, 0, map_message(self._town, timestamps(times[:1])[0]))
        for line in self._text.lines(batch.scene(0)):
            yield _log_line(line, 0, times)
        if self._followed.id is not None:
            yield from self._motion.messages(batch, self._followed.id, series)
        yield from mark_messages(description, timestamps(times))
        rows = self._choose(batch)
        if len(rows):
            yield from self._show(description, rows, times, series)

    def _choose(self, batch: SceneBatch) -> Indices:
        """Return the positions of the scenes that are shown."""
        rows = []
        for row, time in enumerate(batch.time.tolist()):
            self._shown = not time < self._due or (not row and bool(batch.events))
            if self._shown:
                self._due = time + SLACK / self.rate
                rows.append(row)
        return np.array(rows, np.intp)

    def _show(
        self, description: SceneDescription, rows: Indices, times: Times, series: FollowedSeries
    ) -> Iterator[TopicMessages]:
        """Yield the messages of the scenes that are shown, given the followed actor in the batch."""
        scenes = ShownScenes(description, rows, timestamps(times[rows]), series.take(rows))
        for part in (self._frames, self._entities, self._lights):
            yield from part.messages(scenes)

    def _times_of(self, batch: SceneBatch) -> Times:
        times = self._clock.times_of(batch.time)
        if times is None:
            return np.array([self._clock.times(time)[0] for time in batch.time.tolist()], np.uint64)
        return times[:, 0]


class RecordingMessages:
    """Makes the messages of a recording: first of its scenes, then of its incidents, whose times begin again.

    Without options, incidents of all kinds are found, those against the rules of the road if the map is given. `uncut` is
    what the recording is a clip of, if that is known.
    """

    def __init__(
        self,
        source: Recording,
        player: Player,
        road_map: RoadMap | None,
        incidents: IncidentOptions | None = None,
        uncut: Uncut | None = None,
        verdicts: Sequence[Verdict] = (),
    ) -> None:
        self._verdicts = verdicts
        town = town_around(road_map, player, source)
        self._player = player
        header, stops = source.reader.header, stop_points(source.reader)
        self._messages = SceneMessages(header, player.followed, town, stops, _MOST_BYTES)
        self._incidents = PlayedIncidents(player, road_network_of_map(road_map) if town is not None else None, incidents)
        if uncut is None:
            self._messages.describer.recall(player)
        else:
            self._messages.describer.recall_uncut(uncut)
        self._elapsed, self._times = [np.zeros(0)], [np.zeros(0, np.uint64)]

    def scenes(self, progress: Progress | None = None) -> Iterator[TimedMessages]:
        """Yield the messages of all scenes, in the order of time."""
        for batch in self._player.batches(progress):
            for part in self._messages.of(batch):
                yield part
                self._elapsed.append(part.elapsed.copy())  # which, as a view, would keep all of the recording in memory
                self._times.append(part.times)
        yield self._messages.end()

    def incidents(self) -> TimedMessages:
        """Return the messages of the incidents and verdicts, after those of the scenes."""
        elapsed, times = np.concatenate(self._elapsed), np.concatenate(self._times)
        return incident_messages(self._incidents.found(), elapsed, times, self._verdicts)

    @property
    def played(self) -> Played:
        """How many scenes there were, and the seconds that they span."""
        elapsed = np.concatenate(self._elapsed)
        return Played(len(elapsed), (elapsed[-1] - elapsed[0]).item() if len(elapsed) else 0.0)


def incident_messages(
    found: Iterable[Incident], elapsed: Floats, times: Times, verdicts: Sequence[Verdict] = ()
) -> TimedMessages:
    """Return the incidents of some scenes as text, each at the scene at which it began, and as states, with verdicts."""
    found = list(found)
    messages = [_log_line(line, row, times) for row, line in incident_lines(found, elapsed)]
    lanes = {"incidents": incident_lanes(found, elapsed), "verdicts": verdict_lanes(verdicts, elapsed)}
    messages += _states(lanes, elapsed)
    return TimedMessages(messages, times, elapsed)


def _states(lanes: dict[str, list[StateLane]], elapsed: Floats) -> Iterator[TopicMessages]:
    """Yield the states of lanes whenever one of them changes, and at the last scene."""
    changes = [
        (row, name, index, text) for name in lanes for index, lane in enumerate(lanes[name]) for row, text in lane.states
    ]
    now = {name: [ShownState(name=lane.name) for lane in lanes[name]] for name in lanes}
    for row, those in groupby(sorted([*changes, (len(elapsed) - 1, "", 0, "")]), key=itemgetter(0)):
        for _, name, index, text in those:
            if name:
                now[name][index].text = text
        yield single(STATES, row, ShownStates(elapsed=elapsed[row].item(), **now))


def _log_line(line: Line, row: int, times: Times) -> TopicMessages:
    message = Log(level=_LEVELS[line.level], name=line.subject, message=line.text)
    message.timestamp.FromNanoseconds(int(times[row]))
    return single(LOG, row, message)
