"""The table of measures: a row for each, which queries, rules, texts and documentation use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

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
        time_headway: The same as a time in s; inf at rest.
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


@dataclass(frozen=True, kw_only=True)
class Measure:
    """A row of the table."""

    name: str
    unit: str
    extreme: Literal["least", "greatest"]  # which value is critical
    text: str  # the definition, as in docs/measures.md
    values: Callable[[MeasureSeries], Floats] | None = None  # that count, unless they are not found frame by frame
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


def _named(measures: Iterable[Measure]) -> Mapping[str, Measure]:
    return {measure.name: measure for measure in measures}


def _where(condition: Any, values: Any) -> Floats:
    return np.where(condition, values, np.nan)


RELATIVE_SPEED: Final = Measure(
    name="relative_speed",
    unit="m/s",
    extreme="greatest",
    text="the magnitude of the difference of both velocities just before the contact",
)
DURATION: Final = Measure(name="duration", unit="s", extreme="greatest", text="the duration")
"""Measures of incidents alone, which have no row in the answer of `measures`."""

MEASURES: Final = _named(
    (
        Measure(
            name="gap",
            unit="m",
            extreme="least",
            text="the distance between the boxes; 0 if they overlap",
            values=lambda series: series.gap,
            other="nearest",
            two_sided=True,
        ),
        Measure(
            name="time_to_collision",
            short="ttc",
            unit="s",
            extreme="least",
            text="the time until the boxes touch if both keep their velocity, up to 10 s [1, 2]; it counts if both also "
            "meet on the paths that they take, see below",
            values=lambda series: series.time_to_collision,
            other="threat",
        ),
        Measure(
            name="distance_headway",
            unit="m",
            extreme="least",
            text="the distance to the leader, from bumper to bumper along the heading",
            values=lambda series: series.distance_headway,
            other="leader",
            two_sided=True,
        ),
        Measure(
            name="time_headway",
            short="thw",
            unit="s",
            extreme="least",
            text="the same, divided by the speed; without a value at rest [1]",
            values=lambda series: series.time_headway,
            other="leader",
            two_sided=True,
        ),
        Measure(
            name="required_deceleration",
            short="drac",
            unit="m/s²",
            extreme="greatest",
            text="the squared difference of speeds over twice the distance to the leader (DRAC) [1]; it grows without "
            "bound before a contact",
            values=lambda series: _where(series.leader >= 0, series.required_deceleration),
            other="leader",
        ),
        Measure(
            name="post_encroachment_time",
            short="pet",
            unit="s",
            extreme="least",
            of_events=True,
            text="where paths cross: the time between one leaving a spot and the other arriving there, up to 3 s; without a "
            "value if both are there at once (they touch in the 3 s before, after, or between), or follow each other [1, 5]",
        ),
        Measure(
            name="speed",
            unit="m/s",
            extreme="greatest",
            text="the speed over the ground",
            values=lambda series: series.speed,
            two_sided=True,
        ),
        Measure(
            name="acceleration",
            unit="m/s²",
            extreme="greatest",
            text="the slope of a line through the speeds within 0.125 s before and after",
            values=lambda series: _where(series.acceleration > 0, series.acceleration),
        ),
        Measure(
            name="deceleration",
            unit="m/s²",
            extreme="greatest",
            text="the same where the speed falls, without its sign",
            values=lambda series: _where(series.acceleration < 0, -series.acceleration),
        ),
        Measure(
            name="jerk",
            unit="m/s³",
            extreme="greatest",
            text="the slope of a line through the accelerations within 0.25 s before and after, without its sign",
            values=lambda series: np.abs(series.jerk),
        ),
        Measure(
            name="driving_efficiency",
            unit="%",
            extreme="least",
            of_events=True,
            text="of a hero that is a vehicle: its mean speed in % of that of all vehicles of the role_name `background` on "
            "each twentieth of its path, the mean of these; [as Bench2Drive has it](scores.md#the-numbers-of-bench2drive)",
        ),
        Measure(
            name="driving_smoothness",
            unit="%",
            extreme="least",
            of_events=True,
            text="of such a hero: the windows of 2 s in which accelerations, jerks, yaw rate and yaw acceleration are "
            "comfortable, in % of all; [as Bench2Drive has it](scores.md#the-numbers-of-bench2drive)",
        ),
        Measure(
            name="speed_over_limit",
            unit="m/s",
            extreme="greatest",
            text="the speed over the ground minus the speed limit of the lane, where it is above 0",
            needs_roads=True,
        ),
        Measure(
            name="distance_off_road",
            unit="m",
            extreme="greatest",
            text="how far the location of the vehicle is outside the road, up to 20 m",
            needs_roads=True,
        ),
        Measure(
            name="distance_against_lane",
            unit="m",
            extreme="greatest",
            text="the distance driven against the direction of a lane without a break",
            needs_roads=True,
            of_events=True,
        ),
        Measure(
            name="lateral_offset",
            unit="m",
            extreme="greatest",
            text="how far the location of the vehicle is beside the middle of the lane that it is on, to either side; not "
            "in junctions",
            needs_roads=True,
        ),
    )
)
"""The measures by name, in the order of the rows of an answer."""

SHORT_NAMES: Final = {measure.short: measure.name for measure in MEASURES.values() if measure.short}
"""The names of measures by short names."""
