"""What stands or moves on the way ahead: vehicles, walkers and things, as boxes, whoever drives them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

SAMPLES: Final = 28
_CLOSER_NEARBY: Final = 1.5  # exponent that puts the places of a way closer together near the vehicle
_HEADROOM: Final = 4.0  # m above the road: what is higher is not in the way
_CLEARANCE: Final = 0.2  # m: what is lower lies between the wheels
_BUMPER: Final = 0.3  # m behind the front end, where the way ahead begins


@dataclass(frozen=True)
class Boxes:
    """Upright boxes on the plane; arrays with a value for each.

    Attributes:
        x: Of the middle.
        y: Of the middle.
        heading: In radians.
        half_length: Along the heading, in m.
        half_width: Across.
        velocity_x: In m/s.
        velocity_y: In m/s.
        low: The z of the bottom, in m.
        high: The z of the top, in m.
    """

    x: Floats
    y: Floats
    heading: Floats
    half_length: Floats
    half_width: Floats
    velocity_x: Floats
    velocity_y: Floats
    low: Floats
    high: Floats

    def __len__(self) -> int:
        return len(self.x)

    def swept(self, seconds: Floats) -> Boxes:
        """The boxes that hold these over some time, if they go on straight on."""
        along = self.velocity_x * np.cos(self.heading) + self.velocity_y * np.sin(self.heading)
        half = along * seconds / 2
        return Boxes(
            self.x + half * np.cos(self.heading),
            self.y + half * np.sin(self.heading),
            self.heading,
            self.half_length + np.abs(half),
            self.half_width,
            self.velocity_x,
            self.velocity_y,
            self.low,
            self.high,
        )


def join(*parts: Boxes) -> Boxes:
    """All boxes in one."""
    return Boxes(*(np.concatenate([getattr(part, name) for part in parts]) for name in Boxes.__dataclass_fields__))


@dataclass(frozen=True)
class Ways:
    """The ways ahead of some vehicles, as places along them; arrays of (vehicles, SAMPLES).

    Attributes:
        distance: From the middle of the vehicle, along the way, in m.
        x: Of the places.
        y: Of the places.
        heading: Of the way there, in radians.
    """

    distance: Floats
    x: Floats
    y: Floats
    heading: Floats


def distances(half_length: Floats, horizon: Floats) -> Floats:
    """Where to look, for `Ways.distance`, given how far ahead of the front end to look."""
    share = np.linspace(0, 1, SAMPLES) ** _CLOSER_NEARBY
    return (half_length - _BUMPER)[:, None] + horizon[:, None] * share


@dataclass(frozen=True)
class Hits:
    """What is on the ways of some vehicles; arrays with a value for each pair, ascending by vehicle.

    Attributes:
        vehicle: The vehicle: a row of the ways.
        box: What is on its way: the number of a box.
        gap: From the front end to that, along the way, in m; negative where they overlap.
        speed: How fast that moves along the way, in m/s.
        place: The number of the place on the way that it is at.
    """

    vehicle: Integers
    box: Integers
    gap: Floats
    speed: Floats
    place: Integers

    def at_height(self, road: Floats, boxes: Boxes) -> Hits:
        """Return the hits that are not above or below the way, nor so low that vehicles pass over them.

        Args:
            road: The z of the road at each hit, in m.
            boxes: The boxes.
        """
        kept = (boxes.low[self.box] < road + _HEADROOM) & (boxes.high[self.box] > road + _CLEARANCE)
        return self if kept.all() else Hits(*(getattr(self, name)[kept] for name in Hits.__dataclass_fields__))


def look(ways: Ways, own: Integers, boxes: Boxes, room: Floats) -> Hits:
    """Find what is on the ways ahead.

    Args:
        ways: The ways.
        own: The boxes of the vehicles themselves, (vehicles,).
        boxes: All boxes that matter.
        room: How much free way is needed to each side of the middle, by vehicle, in m.
    """
    vehicle, box = _near(ways, boxes, room)
    other = box != own[vehicle]
    vehicle, box = vehicle[other], box[other]
    x, y = ways.x[vehicle] - boxes.x[box, None], ways.y[vehicle] - boxes.y[box, None]
    cos, sin = np.cos(boxes.heading[box])[:, None], np.sin(boxes.heading[box])[:, None]
    beyond = np.maximum(np.abs(x * cos + y * sin) - boxes.half_length[box, None], 0)
    beside = np.maximum(np.abs(y * cos - x * sin) - boxes.half_width[box, None], 0)
    inside = beyond * beyond + beside * beside < (room * room)[vehicle, None]
    place = inside.argmax(axis=1)
    found = inside[np.arange(len(vehicle)), place]
    vehicle, box, place = vehicle[found], box[found], place[found]
    heading = ways.heading[vehicle, place]
    cos, sin = np.cos(heading), np.sin(heading)
    ahead = (boxes.x[box] - ways.x[vehicle, place]) * cos + (boxes.y[box] - ways.y[vehicle, place]) * sin
    turn = boxes.heading[box] - heading
    reach = boxes.half_length[box] * np.abs(np.cos(turn)) + boxes.half_width[box] * np.abs(np.sin(turn))
    middle = ways.distance[vehicle, place]
    gap = middle + ahead - reach - (ways.distance[vehicle, 0] + _BUMPER)
    speed = boxes.velocity_x[box] * cos + boxes.velocity_y[box] * sin
    in_front = middle + ahead > 0  # what is beside, and not farther ahead than the vehicle itself, has to give way
    return Hits(vehicle[in_front], box[in_front], gap[in_front], speed[in_front], place[in_front])


def _near(ways: Ways, boxes: Boxes, room: Floats) -> tuple[Integers, Integers]:
    """Pairs of vehicles and boxes that are near enough to be looked at: ways, ascending, and boxes."""
    left, right, low, high = ways.x.min(axis=1), ways.x.max(axis=1), ways.y.min(axis=1), ways.y.max(axis=1)
    reach = np.hypot(boxes.half_length, boxes.half_width)
    most = float(reach.max(initial=0))
    order = np.argsort(boxes.x, kind="stable")
    x = boxes.x[order]
    begin = np.searchsorted(x, left - room - most)
    counts = np.searchsorted(x, right + room + most) - begin
    vehicle = np.repeat(np.arange(len(counts)), counts)
    box = order[np.arange(counts.sum()) + np.repeat(begin - (np.cumsum(counts) - counts), counts)]
    near = reach[box] + room[vehicle]
    y = boxes.y[box]
    close = (y > low[vehicle] - near) & (y < high[vehicle] + near)
    return vehicle[close], box[close]
