"""The tables of an index: their columns, types and units."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

from carla_recap.model.lives import BoundingBox  # noqa: TC001 - the columns are made of the type hints
from carla_recap.queries.collisions import CollisionRow, Collisions
from carla_recap.queries.incidents import Incident, Incidents
from carla_recap.queries.measures import MeasureRow
from carla_recap.queries.sensors import RecordedSensor, RecordedSensors
from carla_recap.tables import column_types

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pyarrow as pa

RECORDING: Final = "recording"
"""The column of the recording that a row belongs to: an absolute path, or a URL."""


@dataclass(frozen=True, slots=True)
class RecordingRow:
    """A recording that was read, or could not be.

    Attributes:
        size: Its size in bytes.
        modified: The time of its last change, in UTC.
        etag: What identifies its content in an object store, without quotes.
        error: Why it cannot be read; None if it can.
        warning: The warnings of its reading; None without any.
        map: The name of the map.
        date: The time of its beginning, in UTC; None if the file's date is out of range.
        version: The version of CARLA's format.
        frames: The number of frames.
        duration: The elapsed time of the last frame, in s.
        additional_data: Whether the first frame has additional data, such as velocities.
        measured: Whether every frame was read, for its measures.
        roads_known: Whether its map was found then, so that its rules of the road were judged, too.
        actors: The number of actors.
        heroes: The number of heroes.
        parameters: What the simulation was run with; see `Header.parameters`.
        route_file: The route file by which it was scored; None: it was not.
        score: Its driving score; None if it could not be scored, which `warning` says.
        scenario: The type of the first scenario of its route; None without one.
        success: Whether it is a success by Bench2Drive.
        driving_efficiency: Bench2Drive's driving efficiency in %; None without background vehicles.
        driving_smoothness: Bench2Drive's driving smoothness in %.
    """

    size: int | None
    modified: datetime | None
    etag: str | None
    error: str | None
    warning: str | None
    map: str | None = None
    date: datetime | None = None
    version: int | None = None
    frames: int | None = None
    duration: float | None = None
    additional_data: bool | None = None
    measured: bool | None = None
    roads_known: bool | None = None
    actors: int | None = None
    heroes: int | None = None
    parameters: dict[str, str] | None = None
    route_file: str | None = None
    score: float | None = None
    scenario: str | None = None
    success: bool | None = None
    driving_efficiency: float | None = None
    driving_smoothness: float | None = None

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


@dataclass(frozen=True, slots=True)
class StationaryRow:
    """An interval in which an actor does not move; the position is in m, right-handed."""

    start: float
    duration: float
    id: int
    type_id: str
    x: float
    y: float
    z: float


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
    IndexTable("stationary", StationaryRow, {"start": "s", "duration": "s", "x": "m", "y": "m", "z": "m"}),
    IndexTable("incidents", Incident, Incidents.row_units),
    IndexTable("measures", MeasureRow, {"time": "s"}),
    IndexTable("sensors", RecordedSensor, RecordedSensors.row_units),
)
"""The tables of what is in recordings."""
TABLES: Final = {table.name: table for table in (RECORDINGS, *CHILDREN)}
"""All tables by name."""
