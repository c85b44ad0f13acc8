"""Recordings with what the sensors of a rig would have measured, and with the scene as Foxglove shows it."""

from __future__ import annotations

import warnings
from collections import Counter
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from heapq import merge
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.editing.clip import clip, clip_begin
from carla_recap.editing.convert import TopicCopy, check_destination
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.formats.mcap.container import message_topic
from carla_recap.formats.mcap.schema import LogClock
from carla_recap.formats.mcap.writer import McapWriter
from carla_recap.model.lives import HERO
from carla_recap.queries.roads import find_map_of
from carla_recap.queries.sensors import check_new
from carla_recap.recording import open_recording
from carla_recap.replay import Player
from carla_recap.roads import load_map
from carla_recap.scene.description import Uncut
from carla_recap.sensors.messages import SensorMessages
from carla_recap.sensors.options import SensingOptions
from carla_recap.sensors.ray_process import processes_for
from carla_recap.sensors.sensing import sensed_frames
from carla_recap.show.foxglove.ground import MAP
from carla_recap.show.foxglove.layouts import write_layouts
from carla_recap.show.foxglove.topics import LOG, STATES, TOPICS, RecordingMessages
from carla_recap.util.child import started_ahead
from carla_recap.util.text import number
from carla_recap.v1.sensors_pb2 import ActorEntry, ActorTable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from typing import Unpack

    from carla_recap.model.batch import Batch
    from carla_recap.model.lives import ActorLife, ActorName
    from carla_recap.recording import Recording
    from carla_recap.replay.player import Progress
    from carla_recap.sensors.messages import SensorMessage
    from carla_recap.sensors.options import SensingKeywords
    from carla_recap.sensors.rig import SensorRig
    from carla_recap.sensors.sensing import SensedFrame
    from carla_recap.show.foxglove.topics import TimedMessages

    TimedWrite = tuple[float, Callable[[], None]]  # elapsed seconds, and what writes what is of that time

ACTORS: Final = "/sensors/actors"
"""The topic of the table of all actors, by whose ids images of instances and semantic lidars name them."""
SUFFIX: Final = ".mcap"
"""The suffix of recordings with sensors."""
_SCENE: Final = "scene"  # the group of the scene's topics, which share chunks


class SensedFile(NamedTuple):
    """What was written."""

    frames: int
    seconds: float
    samples: Mapping[str, int]  # the number of samples of each sensor, by id
    layouts: Mapping[str, Path]  # the files of the layouts that show them, by viewer


def export_sensed(
    source: Recording,
    destination: Path | str,
    rig: SensorRig,
    *,
    video: bool = False,
    force: bool = False,
    progress: Progress | None = None,
    **options: Unpack[SensingKeywords],
) -> SensedFile:
    """Write a recording with what the sensors of a rig on one of its actors would have measured.

    The file is the recording itself, and beside it has the topics of an export to Foxglove and those of the sensors. Layouts
    for these are written beside it. A part of the recording is that of a clip, and the sensors see what has happened before,
    too, such as a walker that lies on the ground.

    Args:
        source: The recording.
        destination: The `.mcap` file; it appears when it is complete.
        rig: The sensors.
        video: Encode RGB images as H.264, instead of each as a JPEG.
        force: Overwrite the files if they exist.
        progress: Is given all scenes and the player, and passes the scenes on.
        options: Those of `sense`: the fields of `SensingOptions`.

    Raises:
        RecapError: There is no such time or actor, or no pose of it, the recording has a sensor of the same id, nothing can
            draw, or the file cannot be written.
        MissingExtra: An optional dependency is not installed.
        FormatError: The recording contradicts its format.

    Warns:
        RecapWarning: There is no map; no driver, so that images are missing; or the actor is absent for some of the time.
    """
    sensing = SensingOptions(**options)
    check_destination(source.location, destination, force=force)
    if Path(destination).suffix.lower() != SUFFIX:
        raise RecapError(f"{str(destination)!r} does not end in {SUFFIX}, the format of recordings with sensors")
    uncut = None
    with ExitStack() as stack:
        stack.enter_context(started_ahead(*processes_for(rig)))
        if sensing.start or sensing.duration:
            uncut = Uncut(source, clip_begin(source.reader, sensing.start))
            folder = stack.enter_context(TemporaryDirectory(prefix="carla-recap-"))
            part = Path(folder) / f"part{SUFFIX}"
            clip(source.location, part, start=sensing.start, duration=sensing.duration)
            location, source = source.location, stack.enter_context(open_recording(part))
            source.reader.location = location  # what errors name
        check_new(source.reader, (spec.id for spec in rig))
        moments = sensed_frames(source, rig, replace(sensing, start=0.0, duration=0.0), progress, uncut)
        stack.enter_context(closing(moments))
        messages = SensorMessages(rig, source.header, video=video)
        found = find_map_of(source.reader, sensing.road_map)
        player = Player(source, follow=sensing.actor)
        scenes = RecordingMessages(source, player, None if found is None else load_map(found), uncut=uncut)
        known = source.reader.further_topics()
        with McapWriter(destination, source.header, force=force) as writer:
            copy = TopicCopy(source.reader, writer, without=[*(topic.name for topic in TOPICS), ACTORS])
            for topic in messages.topics:
                if topic.name not in known:
                    writer.add_topic(topic)
            file = _SensedWriter(source, writer, messages, copy)
            file.write(scenes, moments)
            file.check_presence(sensing.actor)
        extent = source.reader.extent()
        layouts = write_layouts(destination, messages.topics)
        return SensedFile(extent.frames, extent.duration, file.samples, layouts)


class _SensedWriter:
    """Writes a recording, its scene, and samples, in step; counts the samples of each sensor, by id."""

    def __init__(self, source: Recording, writer: McapWriter, messages: SensorMessages, copy: TopicCopy) -> None:
        self.samples: Counter[str] = Counter()
        self._source = source
        self._writer = writer
        self._messages = messages
        self._copy = copy
        self._clock = LogClock(source.header)
        self._late: list[tuple[float, str, bytes]] = []  # of topics to which incidents add
        self._moments = self._absent = 0
        self._absent_from = 0.0
        for topic in TOPICS:
            writer.add_topic(topic, group="" if topic.name in (MAP, LOG, STATES) else _SCENE)
        writer.add_topic(message_topic(ACTORS, ActorTable))

    def write(self, scenes: RecordingMessages, moments: Iterable[SensedFrame]) -> None:
        """Write everything."""
        self._writer.write_message(ACTORS, 0.0, _table(self._source.actors.values()).SerializeToString())
        parts = self._frames(), self._scene_messages(scenes), self._samples(moments)
        for _, write in merge(*parts, key=itemgetter(0)):
            write()
        self._copy.write()
        self._add_scene(scenes.incidents())
        for time, topic, data in sorted(self._late, key=itemgetter(0)):
            self._writer.write_message(topic, time, data)
        for piece in self._source.reader.tail():
            self._writer.write_tail(piece)

    def check_presence(self, actor: ActorName) -> None:
        """Warn if the actor was absent, or its pose unknown, at some moments; raise `RecapError` if at all of them."""
        if self._absent:
            name = "the hero" if actor == HERO else f"actor {actor}"
            if self._absent == self._moments:
                text = f"expected a pose of {name}, to carry the rig, found none at any of {self._moments} moments"
                raise RecapError(f"{self._source.location}: {text}")
            times = f"{self._absent} of {self._moments} moments, first at {number(self._absent_from)} s"
            text = f"{self._source.location}: {name} is absent, or has no pose, at {times}: nothing is measured then"
            warnings.warn(text, RecapWarning, stacklevel=3)

    def _frames(self) -> Iterator[TimedWrite]:
        for batch in self._source.reader.batches():
            yield batch.elapsed[0].item(), partial(self._add_frames, batch)

    def _scene_messages(self, scenes: RecordingMessages) -> Iterator[TimedWrite]:
        for part in scenes.scenes():
            if len(part.elapsed):
                yield part.elapsed[0].item(), partial(self._add_scene, part)

    def _samples(self, moments: Iterable[SensedFrame]) -> Iterator[TimedWrite]:
        with closing(self._messages.encoded(moments)) as encoded:
            for moment, messages in encoded:
                yield moment.time, partial(self._add_samples, moment, messages)

    def _add_frames(self, batch: Batch) -> None:
        self._writer.write_batch(batch)
        self._copy.write(batch.elapsed[-1].item())

    def _add_scene(self, part: TimedMessages) -> None:
        for time, topic, data, _ in part.in_order():
            elapsed = self._clock.elapsed(time)
            if topic in (LOG, STATES):  # incidents come last, and are in order with the rest
                self._late.append((elapsed, topic, data))
            else:
                self._writer.write_message(topic, elapsed, data)

    def _add_samples(self, moment: SensedFrame, messages: Iterable[SensorMessage]) -> None:
        self._moments += 1
        if moment.carrier is None or not np.isfinite(moment.carrier_pose).all():
            self._absent_from = moment.time if not self._absent else self._absent_from
            self._absent += 1
        if self._clock.at(moment.time) is None:  # a time that no file can hold
            return
        self.samples.update([*moment.samples])
        for topic, elapsed, data in messages:
            self._writer.write_message(topic, elapsed, data)


def _table(actors: Iterable[ActorLife]) -> ActorTable:
    """Return the table of actors."""
    names = "id", "type_id", "kind", "role_name", "spawned_at", "destroyed_at"
    return ActorTable(actors=[ActorEntry(**{name: getattr(actor, name) for name in names}) for actor in actors])
