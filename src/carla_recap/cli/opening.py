"""The recordings that arguments name, the parts of them that are meant, and the maps of their towns."""

from __future__ import annotations

import os
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Any, Final

import click

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.formats.base import Reader
    from carla_recap.formats.sources import TimeFragment
    from carla_recap.recording import Recording
    from carla_recap.roads import RoadMap
    from carla_recap.town.mesh import TownMesh

MOMENT: Final = 1e-3
"""The seconds of a recording that a picture shows."""

AROUND: Final = 5.0
"""The seconds before and after an incident, or a moment, that are shown."""

_PRINTED: Final = 0.06  # s by which a printed time may be after the end


@contextmanager
def opened_part(source: str, given: dict[str, Any]) -> Iterator[tuple[Recording, dict[str, Any]]]:
    """Open the recording that a source means, and yield it with the options of the part that is meant; see `timed`."""
    from carla_recap.recording import open_recording

    location, given = timed(source, given)
    with open_recording(location) as recording:
        yield recording, given


def timed(source: str, given: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return a source without the times at its end (`#t=12.1`), and options with the start and duration that are meant.

    A moment is shown with the seconds around it that clips of incidents have. What the options say, if it is not None,
    prevails.
    """
    from carla_recap.errors import RecapError

    location, times = _split(source)
    start, duration = given["start"], given["duration"]
    if times is None or start is not None:
        return location, given | {"start": start or 0.0, "duration": duration or 0.0}
    begin, end = max(times.start - AROUND, 0.0), times.start + AROUND
    if times.stop is None:
        _check_moment(location, times.start)
    else:
        begin, end = times.start, times.stop
    if not begin < end:
        raise RecapError(f"{source}: an end after {begin:g} s was expected")
    return location, given | {"start": begin, "duration": end - begin if duration is None else duration}


def moment(source: str, time: float | None) -> tuple[str, float]:
    """Return a source without the time at its end (`#t=12.1`), and the time that is meant: that of the option, if any."""
    location, times = _split(source)
    if time is None and times is None:
        raise click.MissingParameter("SRC#t=S says it, too.", param_hint="'--at'", param_type="option")
    return location, times.start if time is None and times is not None else time or 0.0


def printed(reader: Reader, time: float) -> float:
    """Return the time of the next frame if a time is what texts say of that, rounded, and there is no frame at it."""
    from carla_recap.model.frame import SAME_TIME
    from carla_recap.replay.player import ROUNDED

    found, later = reader.frame_at(time), reader.frame_at(time + ROUNDED)
    is_frame = found is not None and abs(found.elapsed - time) <= SAME_TIME
    is_next = later is not None and time < later.elapsed and round(later.elapsed, 2) == time
    return later.elapsed if later is not None and is_next and not is_frame else time


def _split(source: str) -> tuple[str, TimeFragment | None]:
    """Return a source without the times at its end, and these, if it has any."""
    from carla_recap.errors import RecapError
    from carla_recap.formats.sources import split_time

    location, times = split_time(source)
    name, mark, text = source.rpartition("#t=")
    if times is None and name and mark and not os.path.exists(source):  # noqa: PTH110 - which takes any text
        raise RecapError(f"{source}: {text!r} is no time; seconds were expected, such as #t=12.1, or #t=12.1,20")
    return location, times


def _check_moment(location: str, time: float) -> None:
    """Refuse a time after the end of a recording of this machine; others are not read twice."""
    from carla_recap.errors import RecapError
    from carla_recap.formats import open_reader
    from carla_recap.formats.sources import is_remote

    if is_remote(location):
        return
    with closing(open_reader(location)) as reader:
        end = reader.extent().duration
    if time > end + _PRINTED:
        raise RecapError(f"{location}: nothing at {time:g} s; the recording ends at {end:g} s")


def road_map_of(recording: Recording, path: str | None, start: float = 0.0, duration: float = 0.0) -> RoadMap | None:
    """Return the map of a recording's town; without one, what its vehicles have driven along in the shown part.

    None if that is not known either, or if an extra is missing; a warning says so.
    """
    from carla_recap.replay.recorded_map import load_map_of
    from carla_recap.roads import load_map

    return load_map_of(recording, path, load_map, lambda corridors: corridors, start, duration)


def town_of(recording: Recording, path: str | None, start: float = 0.0, duration: float = 0.0) -> TownMesh | None:
    """Return a recording's town as a mesh; see `road_map_of`."""
    from carla_recap.town.mesh import load_town_of

    return load_town_of(recording, path, start, duration)
