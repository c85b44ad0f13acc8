"""A clip of each incident of a recording, with an .rrd for Rerun's viewer and a video."""

from __future__ import annotations

import math
import warnings
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from carla_recap.editing.clip import ClipCutter, origin
from carla_recap.editing.convert import check_destination
from carla_recap.errors import MissingExtra, RecapError, RecapWarning
from carla_recap.formats import SUFFIXES, open_reader
from carla_recap.model.frame import SAME_TIME
from carla_recap.queries.incidents import IncidentOptions, incidents
from carla_recap.queries.kinds import KINDS
from carla_recap.queries.recorded_actors import actors
from carla_recap.recording import Recording, open_recording
from carla_recap.scene.captions import with_all_kinds
from carla_recap.util.files import check_folder, new_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from carla_recap.queries.incidents import Incident, Incidents
    from carla_recap.roads import RoadMap
    from carla_recap.show.video.film import Town

COLLISIONS: Final = IncidentOptions(kinds=("collision",))
LONGEST: Final = 60.0
"""The length of the clip of a longer incident, in seconds from the start of the incident."""


class IncidentClip(NamedTuple):
    """The files of an incident, whose times are those of the source."""

    incident: Incident
    recording: Path  # the clip
    rrd: Path | None  # the clip for Rerun's viewer; None if no .rrd files are written
    video: Path | None = None  # the clip as an .mp4; None if no videos are written


def clips(
    source: Path | str,
    folder: Path | str,
    options: IncidentOptions = COLLISIONS,
    *,
    before: float = 5.0,
    after: float = 5.0,
    suffix: str = ".mcap",
    rerun: bool | None = None,
    video: bool = False,
    road_map: RoadMap | None = None,
    town: Town | None = None,
    limit: int = 100,
    force: bool = False,
    progress: Callable[[Sequence[Incident]], Iterable[Incident]] | None = None,
) -> list[IncidentClip]:
    """Write a clip of each incident, and an .rrd and a video that follow the first of its actors that is present.

    Args:
        source: A recording of any format, or its URL.
        folder: A new folder, or an empty one. It appears when it is complete. The names of the files contain the kind of
            the incident, its time and the ids of its actors: `01-collision-21.3s-105-110.mcap`.
        options: Which incidents to find, see `carla_recap.queries.incidents`; by default collisions. Of actors that stood
            still for long, a clip shows the first 60 s.
        before: The seconds of a clip before the incident.
        after: The seconds of a clip after the incident.
        suffix: The format of the clips: .mcap or .log.
        rerun: Write the .rrd files; None: if Rerun is installed.
        video: Write the videos.
        road_map: The map of the town, to be drawn in the .rrd files.
        town: The town in the videos, or a function that loads it; None: roads where vehicles have driven.
        limit: The largest number of clips, those of the first incidents; a warning reports more incidents.
        force: Write into a folder that is not empty, over files of the same names.
        progress: Gets the incidents, and yields them.

    Raises:
        RecapError: The folder is not empty, a time or suffix is invalid, or the source is damaged.
        MissingExtra: `rerun` is true, and Rerun is not installed; or `video` is, and what it needs is not installed.
    """
    if rerun is not False:
        from carla_recap.show.rerun import check_rerun
        from carla_recap.show.rerun.export import export_rerun

        try:
            check_rerun()  # first of all: it may be missing
        except MissingExtra:
            if rerun:
                raise
        else:
            rerun = True
    if video:
        from carla_recap.show.video import export_video
        from carla_recap.show.video.encoding import check_packages
        from carla_recap.show.video.film import opened_renderer

        check_packages(".mp4")
    if not (0 <= before < math.inf and 0 <= after < math.inf):
        raise RecapError(
            f"clips from {before:g} s before to {after:g} s after an incident cannot be cut; 0 or more were expected"
        )
    if suffix not in SUFFIXES:
        raise RecapError(f"unknown format {suffix!r} of clips; the suffix must be one of {', '.join(SUFFIXES)}")
    check_folder(folder, force=force)
    reader = open_reader(source)
    try:
        answer = incidents(reader, options)
        shown = with_all_kinds(reader, options) if rerun or video else None
        found = _choose(answer, limit, reader.location)
        targets = [Path(folder, name) for name in _names(found, suffix)]
        for target in targets:
            check_destination(source, target, force=force)
        cutter, written = ClipCutter(reader), []
        with new_folder(folder) as room, ExitStack() as stack:
            renderer = None
            if video and found:
                renderer = stack.enter_context(opened_renderer(None, town, Recording(reader))).result()
            for incident, target in zip(progress(found) if progress else found, targets, strict=False):
                first = cutter.first_frame(max(0.0, incident.start - before))
                cutter.write(room / target.name, first, min(incident.stop, incident.start + LONGEST) + after)
                rrd = target.with_suffix(".rrd") if rerun else None
                film = target.with_suffix(".mp4") if renderer is not None else None
                if rrd is not None or film is not None:
                    with open_recording(room / target.name) as recording:
                        recording.reader.path = target  # its path when the folder is complete
                        recording.reader.location = str(target)
                        followed = _followed(incident, recording, incident.start - origin(first))
                        if rrd is not None:
                            export_rerun(recording, room / rrd.name, follow=followed, road_map=road_map, incidents=shown)
                        if film is not None:
                            export_video(recording, room / film.name, follow=followed, renderer=renderer, incidents=shown)
                written.append(IncidentClip(incident, target, rrd, film))
        return written
    finally:
        reader.close()


def _choose(answer: Incidents, limit: int, source: str) -> list[Incident]:
    """Return the first incidents, up to a limit, among those within the times of the recording."""
    found = [incident for incident in answer if 0 <= incident.start <= answer.extent.duration and incident.stop < math.inf]
    if len(found) > limit:
        warnings.warn(f"{source}: only the first {limit} of {len(found)} incidents get a clip", RecapWarning, stacklevel=3)
    return found[:limit]


def _names(found: Sequence[Incident], suffix: str) -> Iterator[str]:
    """Yield names of files, in the order of the incidents."""
    width = max(2, len(str(len(found))))
    for number, incident in enumerate(found, 1):
        words = (f"{number:0{width}}", KINDS[incident.kind].option, f"{incident.start:.1f}s", *map(str, incident.actors))
        yield "-".join(words) + suffix


def _followed(incident: Incident, recording: Recording, time: float) -> int | None:
    """Return the first actor of an incident that a clip contains up to a time, or None."""
    present = {actor.id for actor in actors(recording.reader) if actor.spawned_at <= time + SAME_TIME}
    return next((id for id in incident.actors if id in present), None)
