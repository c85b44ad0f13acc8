"""What an index contains of a recording: it is opened once, and its events are read once."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.fleet.index.tables import CHILDREN
from carla_recap.formats import open_reader
from carla_recap.formats.base import DigestPart
from carla_recap.model.batch import Batch
from carla_recap.model.frame import Frame
from carla_recap.model.lives import HERO, ROAD_USERS
from carla_recap.model.lives import TYPES as ACTOR_TYPES
from carla_recap.model.motion import place_in_metres
from carla_recap.model.stationary import MIN_DISTANCE
from carla_recap.queries.blocked import blocked
from carla_recap.queries.collisions import collisions
from carla_recap.queries.incidents import IncidentOptions, incidents
from carla_recap.queries.kinds import kinds_without_roads
from carla_recap.queries.measures import measures
from carla_recap.queries.recorded_actors import actors
from carla_recap.queries.score import ScoreOptions, route_for, score
from carla_recap.recording import Recording
from carla_recap.roads import find_road_network, load_road_network
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence

    from carla_recap.fleet.sources import SourceFile
    from carla_recap.formats.base import PartName, Reader
    from carla_recap.model.stationary import BlockedRow
    from carla_recap.queries.score import Route
    from carla_recap.roads.network import RoadNetwork

Tables = dict[str, list[tuple[Any, ...]]]
"""The rows of `CHILDREN`, by the name of the table."""

SHORTEST_STOP: Final = 10.0
"""The least duration of a stationary interval in an index, in s."""

_EVENTS: Final = frozenset((*ACTOR_TYPES, "collisions"))
_MOTION: Final = frozenset(("transforms", "velocities", "light_states"))
_SMALL: Final = 6000  # frames of a recording whose motion is kept in memory
_KEPT: Final = 256 << 20  # bytes of events, and of motion, that are kept in memory at most
_FRAME: Final = 1000  # bytes that a frame takes, beside those of its packets, about
_WHOLE: Final = {"sparse": False, "start": -math.inf, "stop": math.inf}  # the options of a read of all frames

_interval = attrgetter("id", "type_id", "start", "duration", "x", "y", "z")


def read_recording(
    source: SourceFile,
    *,
    measured: bool = False,
    road_map: str | None = None,
    routes: Sequence[Route] | None = None,
) -> tuple[dict[str, Any], Tables]:
    """Return the fields of a recording's row that its content determines, and the rows of `CHILDREN`.

    If it is `measured`, every frame is read, for measures and incidents of the road; else its events alone. The map may be a
    folder to look in, None: the usual ones. It is scored by the routes, if any. A `RecapError` says that it cannot be read.
    """
    try:
        with Recording(open_reader(source.location)) as recording:
            return _content(recording, measured, road_map, routes)
    except (RecapError, OSError, MemoryError):
        raise
    except Exception as error:  # a file that no check has foreseen must not end the reading of thousands
        raise RecapError(f"{source.location}: cannot be read: {type(error).__name__}: {error}") from error


def _content(
    recording: Recording, measured: bool, road_map: str | None, routes: Sequence[Route] | None
) -> tuple[dict[str, Any], Tables]:
    info, reader = recording.info, cast("Reader", _ReadOnce(recording.reader))
    found = actors(reader)
    roads = _roads(info.map_name, road_map) if measured else None
    kinds = None if not measured else "all" if roads is not None else kinds_without_roads()
    has_hero = any(actor.is_hero and actor.kind in ROAD_USERS for actor in found)
    rows: dict[str, Iterable[Any]] = {
        "actors": found,
        "stationary": map(_in_metres, blocked(reader, SHORTEST_STOP)),
        "collisions": collisions(reader),
        "incidents": incidents(reader, IncidentOptions(kinds=kinds, roads=roads)),
        "measures": measures(reader, HERO, roads=roads) if measured and has_hero else (),
        "sensors": recording.sensors,
    }
    fields = {
        "map": readable(info.map_name),
        "date": info.date and info.date.replace(tzinfo=None),
        "version": info.version,
        "frames": info.frames,
        "duration": info.duration,
        "additional_data": info.additional_data,
        "measured": measured,
        "roads_known": roads is not None,
        "actors": len(found),
        "heroes": sum(actor.is_hero for actor in found),
        "parameters": recording.header.parameters,
        "route_file": routes[0].path if routes else None,
        **(_scores(recording, routes, road_map) if routes else {}),
    }
    return fields, {table.name: list(map(table.cells_of, rows[table.name])) for table in CHILDREN}


def _scores(recording: Recording, routes: Sequence[Route], road_map: str | None) -> dict[str, Any]:
    """Return the columns of the score of a recording; none, and a warning, if it cannot be scored."""
    try:
        found = score(recording.reader, route_for(routes, recording.reader), ScoreOptions(road_map=road_map))
    except RecapError as error:
        warnings.warn(str(error), RecapWarning, stacklevel=2)
        return {}
    return {
        "score": found.score,
        "scenario": found.scenarios[0] if found.scenarios else None,
        "success": found.success,
        "driving_efficiency": found.efficiency,
        "driving_smoothness": found.smoothness,
    }


def _roads(map_name: str, road_map: str | None) -> RoadNetwork | None:
    if road_map is not None and not Path(road_map).is_dir():
        return load_road_network(road_map)
    return find_road_network(map_name, road_map)


def _in_metres(row: BlockedRow) -> BlockedRow:
    x, y, z = place_in_metres(row.x, row.y, row.z)
    return replace(row, x=x, y=y, z=z)


class _ReadOnce:
    """A reader of what several queries read: its events and stationary intervals, and the motion of a small recording."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader

    def __getattr__(self, name: str) -> Any:
        return getattr(self._reader, name)

    @cached_property
    def _events(self) -> list[Batch] | None:
        return _kept(map(Batch.of, self._reader.frames(_EVENTS, sparse=True)))

    @cached_property
    def _motion(self) -> list[Batch] | None:
        return _kept(self._reader.batches(_MOTION)) if self._reader.extent().frames <= _SMALL else None

    @cached_property
    def _stretches(self) -> DigestPart:
        rows = [_interval(row) for row in blocked(self._reader, SHORTEST_STOP)]
        return DigestPart((SHORTEST_STOP, MIN_DISTANCE), lambda: rows)

    def frames(self, types: Collection[str] | None = None, **options: Any) -> Iterator[Frame]:
        """See `Reader.frames`."""
        is_whole = _WHOLE | options == {**_WHOLE, "sparse": True}
        if types is None or not is_whole or not _EVENTS.issuperset(types) or self._events is None:
            yield from self._reader.frames(types, **options)
            return
        for batch in self._events:
            for frame in batch:
                packets = [packet for packet in frame.packets if packet.type is not None and packet.type.name in types]
                if packets:
                    yield Frame(frame.index, frame.id, frame.elapsed, frame.duration, packets, preamble=frame.preamble)

    def batches(self, types: Collection[str] | None = None, **options: Any) -> Iterator[Batch]:
        """See `Reader.batches`."""
        is_kept = types is not None and "transforms" in types and _MOTION.issuperset(types) and _WHOLE | options == _WHOLE
        return iter(self._motion) if is_kept and self._motion is not None else self._reader.batches(types, **options)

    def digest(self, part: PartName) -> DigestPart | None:
        """See `Reader.digest`."""
        return self._stretches if part == "stretches" else self._reader.digest(part)


def _kept(batches: Iterable[Batch]) -> list[Batch] | None:
    """Return batches as a list; None if their packets take more memory than `_KEPT`."""
    kept, size = [], 0
    for batch in batches:
        size += len(batch) * (_FRAME + sum(column.size for column in batch.columns))
        if size > _KEPT:
            return None
        kept.append(batch)
    return kept
