"""The tables of an index: their columns, types and units."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final

from carla_recap.model.lives import BoundingBox  # noqa: TC001 - the columns are made of the type hints
from carla_recap.model.stationary import BlockedRow
from carla_recap.queries.collisions import CollisionRow, Collisions
from carla_recap.queries.incidents import Incident, Incidents
from carla_recap.queries.measures import MeasureRow
from carla_recap.queries.sensors import RecordedSensor, RecordedSensors
from carla_recap.tables import column_types

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import pyarrow as pa

RECORDING: Final = "recording"
"""The column of the recording that a row belongs to: an absolute path, or a URL."""


@dataclass(frozen=True, slots=True)
class RecordingRow:
    """A recording that was read, or could not be."""

    size: int | None  # its size in bytes
    modified: datetime | None  # the time of its last change, in UTC
    etag: str | None  # what identifies its content in an object store, without quotes
    error: str | None  # why it cannot be read; None if it can
    warning: str | None  # the warnings of its reading; None without any
    map: str | None = None  # the name of the map
    date: datetime | None = None  # the time of its beginning, in UTC; None if the file's date is out of range
    version: int | None = None  # the version of CARLA's format
    frames: int | None = None  # the number of frames
    duration: float | None = None  # the elapsed time of the last frame, in s
    additional_data: bool | None = None  # whether the first frame has additional data, such as velocities
    measured: bool | None = None  # whether every frame was read, for its measures
    roads_known: bool | None = None  # whether its map was found then, so that its rules of the road were judged, too
    actors: int | None = None  # the number of actors
    heroes: int | None = None  # the number of heroes
    parameters: dict[str, str] | None = None  # what the simulation was run with; see `Header.parameters`
    route_file: str | None = None  # the route file by which it was scored; None: it was not
    score: float | None = None  # its driving score; None if it could not be scored, which `warning` says
    scenario: str | None = None  # the type of the first scenario of its route; None without one
    success: bool | None = None  # whether it is a success by Bench2Drive
    driving_efficiency: float | None = None  # Bench2Drive's driving efficiency in %; None without background vehicles
    driving_smoothness: float | None = None  # Bench2Drive's driving smoothness in %

    @property
    def lacks_roads(self) -> bool:
        """Whether it was measured without its roads."""
        return bool(self.measured) and not self.roads_known


@dataclass(frozen=True, slots=True)
class ActorRow:
    """An actor; its fields are those of `ActorLife`, and whether it is the hero."""

    id: int
    type_id: str
    kind: str
    role_name: str
    hero: bool
    spawned_at: float
    destroyed_at: float | None
    parent: int | None
    attributes: dict[str, str]
    bounding_box: BoundingBox | None


@dataclass(frozen=True)
class IndexTable:
    """A table of an index."""

    name: str
    row_type: type[Any]  # the dataclass of its rows
    units: Mapping[str, str]  # of columns

    @cached_property
    def hints(self) -> dict[str, Any]:
        """The types of the columns that are fields of its rows, as type hints."""
        return column_types(self.row_type)

    @cached_property
    def cells_of(self) -> Callable[[Any], tuple[Any, ...]]:
        """A function that returns the values of one of its rows, or of an `ActorLife`."""
        renamed = {"hero": "is_hero"} if self.row_type is ActorRow else {}
        return attrgetter(*(renamed.get(name, name) for name in self.hints))

    @cached_property
    def schema(self) -> pa.Schema:
        """Its Arrow schema; the metadata of columns contain their units."""
        import pyarrow as pa

        from carla_recap.tables.arrow import type_of

        def field(name: str, kind: pa.DataType) -> pa.Field:
            return pa.field(name, kind, metadata={"unit": self.units[name]} if name in self.units else None)

        def arrow_type(kind: Any) -> pa.DataType:
            return pa.timestamp("us") if kind in (datetime, datetime | None) else type_of(kind)

        named = [field(name, arrow_type(kind)) for name, kind in self.hints.items()]
        return pa.schema([field(RECORDING, pa.string()), *named])


RECORDINGS: Final = IndexTable(
    "recordings", RecordingRow, {"size": "bytes", "duration": "s", "driving_efficiency": "%", "driving_smoothness": "%"}
)
CHILDREN: Final = (
    IndexTable("actors", ActorRow, {"spawned_at": "s", "destroyed_at": "s", "bounding_box": "m"}),
    IndexTable("collisions", CollisionRow, Collisions.row_units),
    IndexTable("stationary", BlockedRow, {"start": "s", "duration": "s", "x": "m", "y": "m", "z": "m"}),
    IndexTable("incidents", Incident, Incidents.row_units),
    IndexTable("measures", MeasureRow, {"time": "s"}),
    IndexTable("sensors", RecordedSensor, RecordedSensors.row_units),
)
"""The tables of what is in recordings."""
TABLES: Final = {table.name: table for table in (RECORDINGS, *CHILDREN)}
"""All tables by name."""
