"""Clips: a stretch of a recording as a recording of its own; one, or one for each incident."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from carla_recap.editing.convert import check_destination
from carla_recap.editing.initial_state import Lasting
from carla_recap.errors import MissingExtra, RecapError, RecapWarning
from carla_recap.formats import SUFFIXES, create_writer, open_reader
from carla_recap.model.batch import Batch
from carla_recap.model.frame import LAST_FRAME_DURATION, SAME_TIME, Extent, Frame
from carla_recap.queries.actors import actors
from carla_recap.queries.incidents import HARD, incidents
from carla_recap.recording import open_recording
from carla_recap.replay.player import Player
from carla_recap.util.files import check_folder, new_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from carla_recap.editing.convert import Progress
    from carla_recap.formats.base import Reader
    from carla_recap.maps import RoadMap
    from carla_recap.model.frame import Header
    from carla_recap.queries.incidents import Incident, Incidents
    from carla_recap.recording import Recording

LONGEST: Final = 60.0
"""Of an incident that is longer, the clip has so many seconds from its start."""

_LATEST_DATE: Final = (1 << 63) - 1


def clip(
    source: Path | str,
    destination: Path | str,
    *,
    start: float,
    duration: float = 0.0,
    force: bool = False,
    progress: Progress | None = None,
) -> Extent:
    """Write a stretch of a recording as a recording of its own.

    The first frame is the one at or before the start, the last one that at or before the end. Elapsed times and frame
    numbers begin anew, at 0 and at 1; the date is that of the first frame, in whole seconds. Actors keep their ids.

    Should the clock of the source jump back to before the start, the frames there are left out.

    The first frame tells, besides its own records, what is still true of earlier ones: of all actors that are there their
    spawns (with the pose that they have by then), parents, boxes, volumes, physics and open doors, the states and times of
    traffic lights, the weather, and the lamps; and who has been destroyed, for there may still be transforms of them. In
    all other frames the packets are those of the source, byte for byte; so the clocks in them (platform_time, visual_time)
    go on as they did. But a parent that an actor was given some time after its spawn is told in the second frame, for
    one that is told together with the spawn says that the pose of the spawn is in the parent's axes.

    Args:
        source: A recording of any format.
        destination: Where to write; the suffix says the format. It appears when it is complete.
        start: Where to begin, in elapsed seconds; negative: so long before the end.
        duration: How many seconds; 0: all of the rest.
        force: Overwrite what is there.
        progress: As in `convert`; is given the batches of the clip, and the reader of the source.

    Returns:
        How far the clip goes.

    Raises:
        RecapError: The start lies outside the recording, the source is damaged, or the destination cannot be written.
    """
    check_destination(source, destination, force=force)
    reader = open_reader(source)
    try:
        window = Player(reader, start=start, duration=duration)
        first = _first_frame(reader, window.start)
        return _write(Lasting(reader), destination, first, window.stop if duration else math.inf, progress)
    finally:
        reader.close()


class IncidentClip(NamedTuple):
    """What was written for an incident.

    Attributes:
        incident: The incident; its times are those of the source.
        recording: The clip.
        rrd: The clip as Rerun's viewer opens it; None where that was not asked for.
    """

    incident: Incident
    recording: Path
    rrd: Path | None


def clips(
    source: Path | str,
    folder: Path | str,
    *,
    collisions: bool = True,
    blocked: bool = False,
    braking: bool = False,
    min_time: float = 30.0,
    min_distance: float = 10.0,
    deceleration: float = HARD,
    before: float = 5.0,
    after: float = 5.0,
    suffix: str = ".mcap",
    rerun: bool | None = None,
    road_map: RoadMap | None = None,
    limit: int = 100,
    force: bool = False,
    progress: Callable[[Sequence[Incident]], Iterable[Incident]] | None = None,
) -> list[IncidentClip]:
    """Write a clip of each incident, and an .rrd that follows its first actor, or of its actors the first that is there.

    Args:
        source: A recording of any format.
        folder: Where to write: a new folder, or an empty one. It appears when it is complete. The names of the files tell
            what they show: `01-collision-21.3s-105-110.mcap`, with the ids of the actors.
        collisions: Of each collision.
        blocked: Of each vehicle and walker that stood still for long; see `LONGEST`.
        braking: Of each vehicle that braked hard.
        min_time: How long one must stand still to be blocked, in seconds.
        min_distance: The distance at which an actor has moved, in cm.
        deceleration: From which deceleration on braking is hard, in m/s².
        before: How many seconds before an incident a clip begins.
        after: How many seconds after it a clip ends.
        suffix: The format of the clips: .mcap or .log.
        rerun: Write the .rrd files; None: if Rerun is installed.
        road_map: The map of the town, to be drawn in the .rrd files.
        limit: Of more incidents than that, only the first ones get a clip; a warning says so.
        force: Write into a folder that is not empty, over files of the same names.
        progress: Is given the incidents, and passes them on.

    Raises:
        RecapError: The folder is not empty, a time or suffix makes no sense, or the source is damaged.
        MissingExtra: The .rrd files were asked for, and Rerun is not installed.
    """
    if rerun is not False:
        try:
            from carla_recap.export.rerun import export_rerun  # before any work is done, should it be missing
        except MissingExtra:
            if rerun:
                raise
        else:
            rerun = True
    if not (0 <= before < math.inf and 0 <= after < math.inf):
        raise RecapError(
            f"clips from {before:g} s before to {after:g} s after an incident cannot be cut; 0 or more were expected"
        )
    if suffix not in SUFFIXES:
        raise RecapError(f"unknown format {suffix!r} of clips; the suffix must be one of {', '.join(SUFFIXES)}")
    check_folder(folder, force=force)
    reader = open_reader(source)
    try:
        answer = incidents(
            reader,
            collisions=collisions,
            blocked=blocked,
            braking=braking,
            min_time=min_time,
            min_distance=min_distance,
            deceleration=deceleration,
        )
        found = _choose(answer, limit, reader.path)
        targets = [Path(folder, name) for name in _names(found, suffix)]
        for target in targets:
            check_destination(source, target, force=force)
        lasting, written = Lasting(reader), []
        with new_folder(folder) as room:
            for incident, target in zip(progress(found) if progress else found, targets, strict=False):
                first = _first_frame(reader, max(0.0, incident.start - before))
                _write(lasting, room / target.name, first, min(incident.stop, incident.start + LONGEST) + after)
                rrd = target.with_suffix(".rrd") if rerun else None
                if rrd is not None:
                    with open_recording(room / target.name) as recording:
                        recording.reader.path = target  # where it will be when somebody reads of it
                        followed = _followed(incident, recording, incident.start - _origin(first))
                        export_rerun(recording, room / rrd.name, follow=followed, road_map=road_map)
                written.append(IncidentClip(incident, target, rrd))
        return written
    finally:
        reader.close()


def _choose(answer: Incidents, limit: int, source: Path) -> list[Incident]:
    """The incidents that get a clip: those at times that the recording has, up to some number."""
    found = [incident for incident in answer if 0 <= incident.start <= answer.extent.duration and incident.stop < math.inf]
    if len(found) > limit:
        warnings.warn(f"{source}: only the first {limit} of {len(found)} incidents get a clip", RecapWarning, stacklevel=3)
    return found[:limit]


def _names(found: Sequence[Incident], suffix: str) -> Iterator[str]:
    """Names of files, in the order of the incidents."""
    width = max(2, len(str(len(found))))
    for number, incident in enumerate(found, 1):
        kind = incident.kind.replace(" ", "-")
        yield "-".join((f"{number:0{width}}", kind, f"{incident.start:.1f}s", *map(str, incident.actors))) + suffix


def _followed(incident: Incident, recording: Recording, time: float) -> int | None:
    """Of an incident's actors the first that a clip has had until a time; None where it has had none of them."""
    come = {actor.id for actor in actors(recording.reader) if actor.spawned_at <= time + SAME_TIME}
    return next((id for id in incident.actors if id in come), None)


def _write(lasting: Lasting, destination: Path | str, first: Frame, stop: float, progress: Progress | None = None) -> Extent:
    reader, origin = lasting.source, _origin(first)
    batches: Iterable[Batch] = map(Batch.of, _renumbered(_frames(lasting, first, stop), origin))
    extent = Extent()
    with create_writer(destination, _moved(reader.header, origin)) as writer:
        for batch in progress(batches, reader) if progress else batches:
            writer.write_batch(batch)
            last = batch.frame(-1)
            extent = Extent(last.index + 1, last.id, last.elapsed)
    return extent


def _origin(first: Frame) -> float:
    """The elapsed seconds at which a clip begins."""
    return first.elapsed if math.isfinite(first.elapsed) else 0.0


def _first_frame(reader: Reader, start: float) -> Frame:
    found = reader.frame_at(start)
    if found is None or found.preamble:
        found = next((frame for frame in reader.frames() if not frame.preamble), None)
    if found is None:
        raise RecapError(f"{reader.path}: the recording has no frames")
    return found


def _frames(lasting: Lasting, first: Frame, stop: float) -> Iterator[Frame]:
    yield lasting.begin(first)
    start = first.elapsed if math.isfinite(first.elapsed) else -math.inf
    # The stop is part of the clip, as are frames within `SAME_TIME` of it.
    for frame in lasting.source.frames(start=start, stop=stop + 2 * SAME_TIME):
        if frame.index > first.index:
            yield lasting.go_on(frame)


def _renumbered(frames: Iterable[Frame], origin: float) -> Iterator[Frame]:
    """Frames that count from 0 s and from 1; the last one without a duration, as CARLA leaves it."""
    latest = None
    for index, frame in enumerate(frames):
        if latest is not None:
            yield latest
        latest = Frame(index, index + 1, frame.elapsed - origin, frame.duration, frame.packets)
    if latest is not None:
        latest.duration = LAST_FRAME_DURATION
        yield latest


def _moved(header: Header, seconds: float) -> Header:
    """A header with a later date."""
    date = header.date + math.floor(seconds)
    if date == header.date or not -_LATEST_DATE <= date <= _LATEST_DATE:
        return header
    return replace(header, date=date, raw=None)
