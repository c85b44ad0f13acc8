"""The table of measures: a row for each, which queries, rules, texts and documentation use."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np

from carla_recap.tables import Columns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from carla_recap.util.arrays import Booleans, Floats, Ids


@dataclass(frozen=True, slots=True)
class MeasureRow:
    """The extreme value of a measure of an actor in a recording, such as its least time to collision.

    Attributes:
        measure: The name, such as `time_to_collision`.
        actor: The id of the actor.
        type_id: Its blueprint.
        hero: Whether it is the hero.
        other: The id of the actor that the value is in relation to; None if there is none.
        other_type_id: Its blueprint; empty if there is none.
        value: The least or the greatest value, whichever is critical.
        unit: The unit of the value.
        time: When, in elapsed seconds.
    """

    measure: str
    actor: int
    type_id: str
    hero: bool
    other: int | None
    other_type_id: str
    value: float
    unit: str
    time: float


NO_OTHER: Final = -1
"""The id, and the row, of no actor."""


class MeasureValues(NamedTuple):
    """The values of a measure of an actor that count for its extreme, in the frames that have it; arrays of one length."""

    time: Floats  # elapsed seconds, ascending
    value: Floats  # NaN in a frame without one
    other: Ids  # of the actors that they are in relation to; -1 where there is none

    @classmethod
    def of(cls, time: Floats, value: Floats) -> MeasureValues:
        """Return values in relation to no other actor."""
        return cls(time, value, np.full(len(time), NO_OTHER))

    @classmethod
    def joined(cls, parts: Iterable[MeasureValues]) -> MeasureValues:
        """Return values of several times, in order of time."""
        none = cls(np.zeros(0), np.zeros(0), np.zeros(0, np.int64))
        time, value, other = (np.concatenate(columns) for columns in zip(none, *parts, strict=True))
        order = np.argsort(time, kind="stable")
        return cls(time[order], value[order], other[order])

    def only(self, rows: Booleans) -> MeasureValues:
        """Return the values in some of the frames."""
        return MeasureValues(self.time[rows], self.value[rows], self.other[rows])


@dataclass(frozen=True, repr=False)
class MeasureSeries(Columns):
    """The measures of an actor over time: arrays of one length, a value for each frame in which it is present.

    Attributes:
        time: Elapsed seconds.
        speed: The speed over the ground in m/s.
        acceleration: In m/s², below 0 when it brakes; NaN where it is unknown.
        jerk: In m/s³; NaN where it is unknown.
        gap: The least gap to another actor in m; inf without one within 100 m.
        nearest: The id of the actor that is this near; -1 without one.
        time_to_collision: The least time to collision in s; inf above 10 s.
        threat: The id of the actor that this is the time to; -1 without one.
        distance_headway: The distance to the leader in m, from bumper to bumper; inf without one.
        time_headway: The same as a time in s; inf at rest and in reverse.
        required_deceleration: The deceleration to avoid the leader in m/s².
        leader: The id of the leader; -1 without one.
    """

    time: Floats
    speed: Floats
    acceleration: Floats
    jerk: Floats
    gap: Floats
    nearest: Ids
    time_to_collision: Floats
    threat: Ids
    distance_headway: Floats
    time_headway: Floats
    required_deceleration: Floats
    leader: Ids

    def __len__(self) -> int:
        return len(self.time)

    def units(self) -> Mapping[str, str]:
        """See `Tabular.units`."""
        return {"time": "s"} | {name: measure.unit for name, measure in MEASURES.items() if hasattr(self, name)}


@dataclass(frozen=True)
class Measure:
    """A row of the table."""

    name: str
    unit: str
    extreme: Literal["least", "greatest"]  # which value is critical
    text: str  # the definition, as in docs/measures.md
    values: Callable[[MeasureSeries], Floats] | None = None  # that count, if they are not the column of its name
    _: KW_ONLY
    other: str = ""  # the column with the ids of the actors that the values are in relation to
    needs_roads: bool = False  # of the map
    two_sided: bool = False  # whether every value counts, so that a bound on the other side makes sense, as a least speed
    of_events: bool = False  # whether its values are those of events, such as crossing paths, not of all frames
    short: str = ""  # the short name, such as `ttc`, which files of rules and commands take, too

    @property
    def title(self) -> str:
        """The name in words, such as `time to collision`."""
        return self.name.replace("_", " ")

    @property
    def key(self) -> Callable[[float], float]:
        """What sorts values, the most critical first."""
        return (lambda value: value) if self.extreme == "least" else (lambda value: -value)

    def values_of(self, series: MeasureSeries) -> Floats | None:
        """Return the values that count; None if they are not found frame by frame."""
        return self.values(series) if self.values else getattr(series, self.name, None)


RELATIVE_SPEED: Final = Measure(
    "relative_speed", "m/s", "greatest", "the magnitude of the difference of both velocities just before the contact"
)
DURATION: Final = Measure("duration", "s", "greatest", "the duration")
"""Measures of incidents alone, which have no row in the answer of `measures`."""

_TABLE: Final = (
    Measure("gap", "m", "least", "the distance between the boxes; 0 if they overlap", other="nearest", two_sided=True),
    Measure(
        "time_to_collision",
        "s",
        "least",
        "the time until the boxes touch if both keep their velocity, up to 10 s [1, 2]; it counts if both also meet on the "
        "paths that they take, see below",
        other="threat",
        short="ttc",
    ),
    Measure(
        "distance_headway",
        "m",
        "least",
        "the distance to the leader, from bumper to bumper along the heading",
        other="leader",
        two_sided=True,
    ),
    Measure(
        "time_headway",
        "s",
        "least",
        "the same, divided by the speed along the heading; without a value at rest or in reverse [1]",
        other="leader",
        two_sided=True,
        short="thw",
    ),
    Measure(
        "required_deceleration",
        "m/s²",
        "greatest",
        "the squared difference of speeds along the heading over twice the distance to the leader (DRAC) [1]; it grows "
        "without bound before a contact",
        lambda series: np.where(series.leader >= 0, series.required_deceleration, np.nan),
        other="leader",
        short="drac",
    ),
    Measure(
        "post_encroachment_time",
        "s",
        "least",
        "where paths cross: the time between one leaving a spot and the other arriving there, up to 3 s; without a value if "
        "both are there at once (they touch in the 3 s before, after, or between), or follow each other [1, 5]",
        of_events=True,
        short="pet",
    ),
    Measure("speed", "m/s", "greatest", "the speed over the ground", two_sided=True),
    Measure(
        "acceleration",
        "m/s²",
        "greatest",
        "the slope of a line through the speeds within 0.125 s before and after",
        lambda series: np.where(series.acceleration > 0, series.acceleration, np.nan),
    ),
    Measure(
        "deceleration",
        "m/s²",
        "greatest",
        "the same where the speed falls, without its sign",
        lambda series: np.where(series.acceleration < 0, -series.acceleration, np.nan),
    ),
    Measure(
        "jerk",
        "m/s³",
        "greatest",
        "the slope of a line through the accelerations within 0.25 s before and after, without its sign",
        lambda series: np.abs(series.jerk),
    ),
    Measure(
        "driving_efficiency",
        "%",
        "least",
        "of a hero that is a vehicle: its mean speed in % of that of all vehicles of the role_name `background` on each "
        "twentieth of its path, the mean of these; [as Bench2Drive has it](scores.md#the-numbers-of-bench2drive)",
        of_events=True,
    ),
    Measure(
        "driving_smoothness",
        "%",
        "least",
        "of such a hero: the windows of 2 s in which accelerations, jerks, yaw rate and yaw acceleration are comfortable, "
        "in % of all; [as Bench2Drive has it](scores.md#the-numbers-of-bench2drive)",
        of_events=True,
    ),
    Measure(
        "speed_over_limit",
        "m/s",
        "greatest",
        "the speed over the ground minus the speed limit of the lane, where it is above 0",
        needs_roads=True,
    ),
    Measure(
        "distance_off_road",
        "m",
        "greatest",
        "how far the location of the vehicle is outside the road, up to 20 m",
        needs_roads=True,
    ),
    Measure(
        "distance_against_lane",
        "m",
        "greatest",
        "the distance driven against the direction of a lane without a break",
        needs_roads=True,
        of_events=True,
    ),
    Measure(
        "lateral_offset",
        "m",
        "greatest",
        "how far the location of the vehicle is beside the middle of the lane that it is on, to either side; not in "
        "junctions",
        needs_roads=True,
    ),
)
MEASURES: Final[Mapping[str, Measure]] = {measure.name: measure for measure in _TABLE}
"""The measures by name, in the order of the rows of an answer."""

SHORT_NAMES: Final = {measure.short: measure.name for measure in MEASURES.values() if measure.short}
"""The names of measures by short names."""
