"""The table of infractions: what each is, and what it costs by the formulas of CARLA's Leaderboard."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, get_args

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

Formula = Literal["1.0", "2.0", "2.1"]
"""The version of the Leaderboard whose formula counts."""

FORMULAS: Final[tuple[Formula, ...]] = get_args(Formula)


@dataclass(frozen=True, kw_only=True)
class InfractionKind:
    """A row of the table."""

    name: str  # as in the Leaderboard's results
    label: str  # the heading of its column there
    text: str  # the definition
    factor: float | None = None  # of the penalty in 1.0 and 2.0; None: the penalty is the same
    coefficient: float | None = None  # of the sum in 2.1; None: the factor counts there, too
    since: Formula = "1.0"  # the first version that has this kind
    ends: str = ""  # the reason that the Leaderboard gives for a route that it ends; empty if the route goes on

    def counts(self, formula: Formula) -> bool:
        """Return whether a version of the Leaderboard has this kind."""
        return FORMULAS.index(self.since) <= FORMULAS.index(formula)


@dataclass(frozen=True, slots=True)
class Infraction:
    """A rule that the hero has broken.

    Attributes:
        kind: The name of its kind, a row of the table.
        time: The elapsed seconds.
        x, y, z: The position of the hero at that time in m, right-handed; of a collision, that in the frame before, as in
            the text.
        actor: The id of the other actor, light or sign; None without one.
        type_id: The blueprint of that actor; empty for an unknown one.
        share: The share that counts: 1, or that of the route outside its lanes, or by how much the speed is too low.
        text: The message in the Leaderboard's results.
    """

    kind: str
    time: float
    x: float
    y: float
    z: float
    actor: int | None
    type_id: str
    share: float
    text: str

    @property
    def link(self) -> str:
        """The fragment of the moment, to be appended to the URL of an incident page or to the recording in a command."""
        return f"#t={self.time:.2f}"


INFRACTIONS: Final[Mapping[str, InfractionKind]] = {
    kind.name: kind
    for kind in (
        InfractionKind(
            name="collisions_pedestrian",
            label="Collisions with pedestrians",
            text="the hero, at 0.1 m/s or more, touches a walker; not the one that it touched in the 5 s before, and not "
            "within 5 m of where it had the collision before, unless it was farther away in between",
            factor=0.5,
            coefficient=1.0,
        ),
        InfractionKind(
            name="collisions_vehicle",
            label="Collisions with vehicles",
            text="the same with a vehicle",
            factor=0.6,
            coefficient=0.7,
        ),
        InfractionKind(
            name="collisions_layout",
            label="Collisions with layout",
            text="the same with a static object, such as a building, a traffic light or a prop",
            factor=0.65,
            coefficient=0.6,
        ),
        InfractionKind(
            name="red_light",
            label="Red lights infractions",
            text="the stop line of a traffic light is under the rear of the hero while the light is red: between 0.4 of its "
            "length behind its middle and 1 m behind its rear end",
            factor=0.7,
            coefficient=0.4,
        ),
        InfractionKind(
            name="stop_infraction",
            label="Stop sign infractions",
            text="the middle of the hero crosses the stop line of a stop sign, and the hero was not slower than 0.1 m/s on "
            "the last 6 m before it",
            factor=0.8,
            coefficient=0.25,
        ),
        InfractionKind(
            name="outside_route_lanes",
            label="Off-road infractions",
            text="along a part of the route, the hero is more than 0.5 m outside the nearest lane for cars or for parking, "
            "or on a lane of the other direction; once for a route, with the share of the driven route that these parts are",
            factor=0.0,
        ),
        InfractionKind(
            name="route_dev",
            label="Route deviations",
            text="the hero is 30 m or more from the route, or more than 15 m from it along more than 30 % of the route",
            ends="Agent deviated from the route",
        ),
        InfractionKind(
            name="route_timeout",
            label="Route timeouts",
            text="the hero needs more than 300 s and the time in which it would drive what it has driven of the route at a "
            "tenth of the speed limit",
            ends="Agent timed out",
        ),
        InfractionKind(
            name="vehicle_blocked",
            label="Agent blocked",
            text="the hero is slower than 0.1 m/s for more than 180 s",
            ends="Agent got blocked",
        ),
        InfractionKind(
            name="yield_emergency_vehicle_infractions",
            label="Yield emergency vehicles infractions",
            text="an emergency vehicle of a scenario is behind the hero when it disappears, or at the end of the route",
            factor=0.7,
            coefficient=0.4,
            since="2.0",
        ),
        InfractionKind(
            name="scenario_timeouts",
            label="Scenario timeouts",
            text="a scenario lasts too long; a recording does not say when scenarios begin and end, so that none is found",
            factor=0.7,
            coefficient=0.4,
            since="2.0",
        ),
        InfractionKind(
            name="min_speed_infractions",
            label="Min speed infractions",
            text="on a quarter of the route, the mean speed of the hero is less than that of all background vehicles; the "
            "share is the missing part of that speed; the evaluator counts the last quarter twice",
            factor=0.7,
            coefficient=0.4,
            since="2.0",
        ),
    )
}
"""The kinds of infractions by name, in the order of the Leaderboard's columns."""


def penalty_of(infractions: Iterable[Infraction], formula: Formula) -> float:
    """Return the factor by which infractions reduce a score.

    In 1.0 and 2.0 it is the product of those of all infractions; in 2.1, the reciprocal of 1 and the sum of their
    coefficients, times the share of the route within its lanes.
    """
    factor, added = 1.0, 0.0
    for infraction in infractions:
        kind = INFRACTIONS[infraction.kind]
        if formula == "2.1" and kind.coefficient is not None:
            added += kind.coefficient * infraction.share
        elif kind.factor is not None and kind.counts(formula):
            factor *= 1 - (1 - kind.factor) * min(infraction.share, 1.0)
    return factor / (1 + added)
