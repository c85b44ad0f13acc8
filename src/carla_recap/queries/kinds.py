"""The table of kinds of incidents: a row for each, which queries, rules, texts, the incident page and videos use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

from carla_recap.errors import RecapError
from carla_recap.queries.detectors import (
    CollisionIncidents,
    HardBrakingIncidents,
    LongStopIncidents,
    NearMissIncidents,
    RoadIncidents,
)
from carla_recap.queries.measures.definitions import DURATION, MEASURES, RELATIVE_SPEED, Measure

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from carla_recap.queries.detectors import Detector


@dataclass(frozen=True, kw_only=True)
class IncidentKind:
    """A row of the table."""

    name: str  # in data, such as `near miss`
    singular: str  # in texts, such as `long stop`
    plural: str
    text: str  # the definition, as in docs/incidents.md
    measures: tuple[Measure, ...]  # that its incidents have
    dark: str  # its colour on dark ground, such as `#ff5f5f`
    light: str  # that on light ground
    detector: type[Detector]  # what finds it; one detector may find several kinds

    @property
    def every_frame(self) -> bool:
        """Whether every frame is read to find it, so that it is looked for only if it is asked for."""
        return self.detector.every_frame

    @property
    def needs_roads(self) -> bool:
        """Whether it needs the roads of the map."""
        return self.detector.needs_roads

    @property
    def option(self) -> str:
        """The name as it is written in options and in names of files, such as `near-miss`."""
        return self.name.replace(" ", "-")


KINDS: Final[Mapping[str, IncidentKind]] = {
    kind.name: kind
    for kind in (
        IncidentKind(
            name="collision",
            singular="collision",
            plural="collisions",
            text="all frames of one contact between two actors; its duration is 0 if it is in one frame only",
            measures=(RELATIVE_SPEED,),
            dark="#ff5f5f",
            light="#cf2230",
            detector=CollisionIncidents,
        ),
        IncidentKind(
            name="red light",
            singular="red light run",
            plural="red light runs",
            text="the front of a vehicle crosses the stop line of a traffic light that is red, and the vehicle goes on: its "
            "location crosses the line, too, before the light changes; the heading differs from that of the lane by 45 "
            "degrees at most",
            measures=(MEASURES["speed"],),
            dark="#ff6fa5",
            light="#b3125f",
            detector=RoadIncidents,
        ),
        IncidentKind(
            name="wrong way",
            singular="drive in the wrong direction",
            plural="drives in the wrong direction",
            text="a vehicle drives faster than 1 m/s against the direction of the lane below it for 1 s or more, and its "
            "heading differs from that direction by more than 120 degrees; not in junctions, where lanes cross",
            measures=(MEASURES["distance_against_lane"],),
            dark="#ff8a66",
            light="#a8380f",
            detector=RoadIncidents,
        ),
        IncidentKind(
            name="off road",
            singular="departure from the road",
            plural="departures from the road",
            text="the location of a vehicle that was on the road is more than 0.3 m outside it for 0.5 s or more",
            measures=(MEASURES["distance_off_road"],),
            dark="#d6b36a",
            light="#7a5a12",
            detector=RoadIncidents,
        ),
        IncidentKind(
            name="stop sign",
            singular="stop sign run",
            plural="stop sign runs",
            text="front and location of a vehicle cross the stop line of a stop sign, and it was not slower than 0.5 m/s "
            "when its front was within 8 m before the line",
            measures=(MEASURES["speed"],),
            dark="#f08fd6",
            light="#96308a",
            detector=RoadIncidents,
        ),
        IncidentKind(
            name="near miss",
            singular="near miss",
            plural="near misses",
            text="two actors almost collide; see [near misses](measures.md#near-misses)",
            measures=(MEASURES["time_to_collision"], MEASURES["post_encroachment_time"]),
            dark="#ffd24d",
            light="#806300",
            detector=NearMissIncidents,
        ),
        IncidentKind(
            name="hard braking",
            singular="hard braking",
            plural="hard braking",
            text="a vehicle decelerates by 6 m/s² or more, up to the 34.3 m/s² of CARLA's tyres, for at least 0.3 s, or "
            "loses as much speed as that, 1.8 m/s, in less",
            measures=(MEASURES["deceleration"],),
            dark="#ffa24d",
            light="#b45a00",
            detector=HardBrakingIncidents,
        ),
        IncidentKind(
            name="speeding",
            singular="speeding",
            plural="speeding",
            text="a vehicle drives more than 5 km/h faster than the limit for 1 s or more",
            measures=(MEASURES["speed_over_limit"],),
            dark="#5cc8ff",
            light="#0b6fa8",
            detector=RoadIncidents,
        ),
        IncidentKind(
            name="blocked",
            singular="long stop",
            plural="long stops",
            text="a vehicle or walker stands still for at least 30 s",
            measures=(DURATION,),
            dark="#b9a0ff",
            light="#6a45c9",
            detector=LongStopIncidents,
        ),
    )
}
"""The kinds of incidents by name, the most important first."""


ALL: Final = "all"
"""The word for all kinds."""


def kind_named(text: str) -> IncidentKind:
    """Return a kind by its name, with spaces, hyphens or underscores; a `RecapError` if there is none."""
    found = KINDS.get(" ".join(text.replace("-", " ").replace("_", " ").split()).lower())
    if found is None:
        raise RecapError(f"{text!r} is no kind of incident; there are {', '.join(kind.option for kind in KINDS.values())}")
    return found


def kinds_named(kinds: Collection[str] | Literal["all"] | None) -> frozenset[str]:
    """Return the names of kinds; None: those that are found without reading every frame; "all", alone or among them: all.

    A `RecapError` says that there is no such kind.
    """
    if kinds is None:
        return frozenset(name for name, kind in KINDS.items() if not kind.every_frame)
    wanted = (kinds,) if isinstance(kinds, str) else kinds
    named = frozenset(kind_named(kind).name for kind in wanted if kind != ALL)
    return frozenset(KINDS) if ALL in wanted else named


def kinds_without_roads() -> frozenset[str]:
    """Return the names of the kinds that need no roads."""
    return frozenset(name for name, kind in KINDS.items() if not kind.needs_roads)
