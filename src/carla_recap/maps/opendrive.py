"""The one place where `carla.Map` is used: the lanes of an OpenDRIVE file, and what is painted across them.

All is in m and radians, right-handed: x forward, y left, z up.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, Any, Final

import carla
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

DRIVING: Final = "Driving"
NO_JUNCTION: Final = -1
_STEP: Final = 0.5  # m
_HALVINGS: Final = 12  # of a step, to find where a lane ends
LIGHT: Final = "1000001"
STOP: Final = "206"
YIELD: Final = "205"
SPEED_LIMIT: Final = "274"
_BEYOND: Final = 0.01  # m: this far after its end, a lane's successors are found
_PAINT: Final = "StopLine"


@dataclass(frozen=True, eq=False)
class Lane:
    """A lane along a section of a road.

    Attributes:
        road: The id of the road.
        section: Which section of the road, counted from 0.
        id: The number of the lane, ascending to the left of the road's own direction; 0 is the line between 1 and -1.
        kind: What it is for, such as `Driving`.
        junction: The id of the junction, `NO_JUNCTION` outside of all.
        stations: How far along the road, ascending, (n,).
        centre: The points in the middle, (n, 3).
        left: The points of the border to the left of who drives there, (n, 3).
        right: The points of the border to the right.
        headings: The direction in which one drives there, (n,).
        reverse: Whether one drives against the road's own direction, from the last point to the first.
        changes: Whether the marks allow to change to the lane on the left, and on the right, of who drives there.
        successors: The lanes at its end, by road, section and id.
    """

    road: int
    section: int
    id: int
    kind: str
    junction: int
    stations: Floats
    centre: Floats
    left: Floats
    right: Floats
    headings: Floats
    reverse: bool
    changes: tuple[bool, bool]
    successors: tuple[tuple[int, int, int], ...]

    @property
    def is_driving(self) -> bool:
        """Whether it is for cars."""
        return self.kind == DRIVING

    def borders(self) -> Iterator[tuple[tuple[int, int, int], Floats]]:
        """The two borders, each under a name that is the same for the lane beyond."""
        upper = self.id if self.id > 0 else self.id + 1
        higher, lower = (self.right, self.left) if self.reverse else (self.left, self.right)
        yield (self.road, self.section, upper), higher
        yield (self.road, self.section, upper - 1), lower


@dataclass(frozen=True)
class Sign:
    """A traffic light or sign, where it is in force; one that is so in several places is there several times.

    Attributes:
        id: The id in the file.
        kind: Its number, such as `LIGHT`.
        value: What is on it, such as a speed.
        unit: The unit of that.
        road: The road along which it is in force.
        station: How far along the road.
        lanes: The lanes that it is for: from … to …, both included.
        ahead: Whether it is for those who drive along the road's own direction: True, False, or None for both.
        place: Where it stands, (3,).
        heading: The way it is turned.
    """

    id: str
    kind: str
    value: float
    unit: str
    road: int
    station: float
    lanes: tuple[tuple[int, int], ...]
    ahead: bool | None
    place: Floats
    heading: float


@dataclass
class Roads:
    """What a town is made of.

    Attributes:
        lanes: All lanes beside those for cars, and these.
        crossings: Closed polygons.
        signs: Lights and signs.
        painted: The stop lines that are in the file.
    """

    lanes: list[Lane] = field(default_factory=list)
    crossings: list[Floats] = field(default_factory=list)
    signs: list[Sign] = field(default_factory=list)
    painted: list[Floats] = field(default_factory=list)

    def stops(self) -> Iterator[Sign]:
        """Where one has to stop."""
        return (sign for sign in self.signs if sign.kind in (LIGHT, STOP))


def read_opendrive(text: str) -> Roads:
    """The roads of an OpenDRIVE file.

    CARLA's parser raises, hangs or ends the process on some files that are not sound.

    Args:
        text: What is in the file.
    """
    # CARLA keeps such paintings on the road only that have a name of this form.
    town = carla.Map("", text.replace(f'name="{_PAINT}"', f'name="Stencil_{_PAINT}"'))
    return Roads(
        [lane for road, section, stations in _sections(town) for lane in _lanes(town, road, section, stations)],
        _polygons(town.get_crosswalks()),
        [_sign(landmark) for landmark in town.get_all_landmarks()],
        [_painted_line(mark) for mark in town.get_all_road_marks_of_type(_PAINT)],
    )


def _sections(town: Any) -> Iterator[tuple[int, int, list[float]]]:
    """The sections of roads that have a lane for cars: road, section, and where to sample them."""
    stations = defaultdict(set)
    lanes: dict[tuple[int, int], int] = {}
    for waypoint in town.generate_waypoints(_STEP):
        place = waypoint.road_id, waypoint.section_id
        stations[place].add(waypoint.s)
        lanes[place] = waypoint.lane_id
    for (road, section), values in stations.items():
        last = max(values)
        end = _end(town, road, section, lanes[road, section], last)
        yield road, section, [*sorted(values), *([end] if end > last else [])]


def _end(town: Any, road: int, section: int, lane: int, within: float) -> float:
    """Where a section ends, given a place less than a step before."""
    beyond = within + 2 * _STEP
    for _ in range(_HALVINGS):
        middle = (within + beyond) / 2
        waypoint = town.get_waypoint_xodr(road, lane, middle)
        if waypoint is not None and waypoint.section_id == section:
            within = middle
        else:
            beyond = middle
    return within


def _lanes(town: Any, road: int, section: int, stations: list[float]) -> Iterator[Lane]:
    for side in (1, -1):
        for number in count(1):
            found = [town.get_waypoint_xodr(road, side * number, station) for station in stations]
            waypoints = [waypoint for waypoint in found if waypoint is not None and waypoint.section_id == section]
            if not waypoints:
                break
            if len(waypoints) > 1:
                yield _lane(waypoints)


def _lane(waypoints: list[Any]) -> Lane:
    first = waypoints[0]
    poses = [waypoint.transform for waypoint in waypoints]
    centre = _points(pose.location for pose in poses)
    headings = np.radians([-pose.rotation.yaw for pose in poses])
    widths = np.array([waypoint.lane_width for waypoint in waypoints])
    leftwards = np.stack((-np.sin(headings), np.cos(headings), np.zeros(len(headings))), axis=1)
    to_border = leftwards * widths[:, None] / 2
    ahead = np.array((np.cos(headings[0]), np.sin(headings[0]), 0.0))
    reverse = bool((centre[1] - centre[0]) @ ahead < 0)
    return Lane(
        first.road_id,
        first.section_id,
        first.lane_id,
        str(first.lane_type),
        first.junction_id if first.is_junction else NO_JUNCTION,
        np.array([waypoint.s for waypoint in waypoints]),
        centre,
        centre + to_border,
        centre - to_border,
        headings,
        reverse,
        _changes(waypoints[len(waypoints) // 2]),
        tuple((end.road_id, end.section_id, end.lane_id) for end in waypoints[0 if reverse else -1].next(_BEYOND)),
    )


def _changes(waypoint: Any) -> tuple[bool, bool]:
    allowed = str(waypoint.lane_change)
    return allowed in ("Left", "Both"), allowed in ("Right", "Both")


def _sign(landmark: Any) -> Sign:
    (place,) = _points([landmark.transform.location])
    return Sign(
        landmark.id,
        landmark.type,
        landmark.value,
        landmark.unit,
        landmark.road_id,
        landmark.s,
        tuple(landmark.get_lane_validities()),
        {"Positive": True, "Negative": False}.get(str(landmark.orientation)),
        place,
        np.radians(-landmark.transform.rotation.yaw),
    )


def _painted_line(mark: Any) -> Floats:
    (middle,) = _points([mark.transform.location])
    heading = np.radians(-mark.transform.rotation.yaw)
    half = mark.length / 2 * np.array((np.cos(heading), np.sin(heading), 0.0))
    return np.array((middle - half, middle + half))


def _polygons(corners: Iterable[Any]) -> list[Floats]:
    """Closed polygons, out of a list of their corners in which each ends with the corner that it began with."""
    polygons, open_polygon = [], np.empty((0, 3))
    for corner in _points(corners):
        open_polygon = np.concatenate((open_polygon, corner[None]))
        if len(open_polygon) > 2 and np.array_equal(open_polygon[0], corner):
            polygons.append(open_polygon)
            open_polygon = np.empty((0, 3))
    return polygons


def _points(locations: Iterable[Any]) -> Floats:
    points = [(location.x, -location.y, location.z) for location in locations]
    return np.array(points, np.float64).reshape(-1, 3)
