"""The lanes, landmarks, crossings and stop lines of an OpenDRIVE file, read by `carla.Map`.

Units are m and radians; axes are right-handed: x forward, y left, z up.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.roads.opendrive import LIGHT, STOP

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

DRIVING: Final = "Driving"
NO_JUNCTION: Final = -1
_STEP: Final = 0.5  # m
_HALVINGS: Final = 12  # of a step, to find the end of a lane
_BEYOND: Final = 0.01  # m from the end of a lane to its successors
_PAINT: Final = "StopLine"


@dataclass(frozen=True, eq=False)
class LaneGeometry:
    """The course of a lane along a section of a road.

    Attributes:
        road: The id of the road.
        section: The index of the section of the road.
        id: The number of the lane, ascending to the left of the road's own direction; 0 is the line between 1 and -1.
        kind: The OpenDRIVE type, such as `Driving`.
        junction: The id of the junction, or `NO_JUNCTION`.
        stations: The distances along the road, ascending, (n,).
        centre: The points in the middle, (n, 3).
        left: The points of the left border, as seen in driving direction, (n, 3).
        right: The points of the border to the right.
        headings: The driving directions, (n,).
        reverse: Whether the driving direction is from the last point to the first, against that of the road.
        changes: Whether the markings allow to change to the lane on the left, and to the lane on the right.
        successors: The road, section and id of each lane that follows.
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
        """Whether the lane is for cars."""
        return self.kind == DRIVING

    def borders(self) -> Iterator[tuple[tuple[int, int, int], Floats]]:
        """Yield the two borders, each with a key that it shares with the neighbouring lane."""
        upper = self.id if self.id > 0 else self.id + 1
        higher, lower = (self.right, self.left) if self.reverse else (self.left, self.right)
        yield (self.road, self.section, upper), higher
        yield (self.road, self.section, upper - 1), lower


@dataclass(frozen=True)
class Landmark:
    """A traffic light or sign at a position where it applies; it may apply at several.

    Attributes:
        id: The id in the file.
        kind: The OpenDRIVE type, such as `opendrive.LIGHT`.
        value: The value, such as a speed.
        unit: The unit of the value.
        road: The road along which it applies.
        station: The distance along the road.
        lanes: The ranges of lanes for which it applies: first and last lane.
        ahead: Whether it applies in the direction of the road: True, False (against it), or None (in both directions).
        location: The position, (3,).
        heading: The direction that it faces.
    """

    id: str
    kind: str
    value: float
    unit: str
    road: int
    station: float
    lanes: tuple[tuple[int, int], ...]
    ahead: bool | None
    location: Floats
    heading: float


@dataclass
class Roads:
    """The content of an OpenDRIVE file.

    Attributes:
        lanes: The lanes for cars, and all lanes of their sections.
        crossings: Closed polygons.
        landmarks: Lights and signs.
        stop_lines: The stop lines that the file contains.
    """

    lanes: list[LaneGeometry] = field(default_factory=list)
    crossings: list[Floats] = field(default_factory=list)
    landmarks: list[Landmark] = field(default_factory=list)
    stop_lines: list[Floats] = field(default_factory=list)

    def stops(self) -> Iterator[Landmark]:
        """Return the landmarks at which vehicles may have to stop."""
        return (landmark for landmark in self.landmarks if landmark.kind in (LIGHT, STOP))


def read_opendrive(text: str) -> Roads:
    """Return the roads of an OpenDRIVE file.

    CARLA's parser raises, hangs or crashes on some invalid files.

    Args:
        text: The content of the file.
    """
    import carla

    # CARLA reads only those road markings whose names have this form.
    town = carla.Map("", text.replace(f'name="{_PAINT}"', f'name="Stencil_{_PAINT}"'))
    return Roads(
        [lane for road, section, stations in _sections(town) for lane in _lanes(town, road, section, stations)],
        _polygons(town.get_crosswalks()),
        [_landmark(landmark) for landmark in town.get_all_landmarks()],
        [_stop_line(mark) for mark in town.get_all_road_marks_of_type(_PAINT)],
    )


def _sections(town: Any) -> Iterator[tuple[int, int, list[float]]]:
    """Yield the sections of roads that have a lane for cars: road, section, and the stations at which to sample them."""
    stations = defaultdict(set)
    lanes: dict[tuple[int, int], int] = {}
    for waypoint in town.generate_waypoints(_STEP):
        key = waypoint.road_id, waypoint.section_id
        stations[key].add(waypoint.s)
        lanes[key] = waypoint.lane_id
    for (road, section), values in stations.items():
        last = max(values)
        end = _end(town, road, section, lanes[road, section], last)
        yield road, section, [*sorted(values), *([end] if end > last else [])]


def _end(town: Any, road: int, section: int, lane: int, within: float) -> float:
    """Return the station of the end of a section, given one less than a step before it."""
    beyond = within + 2 * _STEP
    for _ in range(_HALVINGS):
        middle = (within + beyond) / 2
        waypoint = town.get_waypoint_xodr(road, lane, middle)
        if waypoint is not None and waypoint.section_id == section:
            within = middle
        else:
            beyond = middle
    return within


def _lanes(town: Any, road: int, section: int, stations: list[float]) -> Iterator[LaneGeometry]:
    for side in (1, -1):
        for number in count(1):
            found = [town.get_waypoint_xodr(road, side * number, station) for station in stations]
            waypoints = [waypoint for waypoint in found if waypoint is not None and waypoint.section_id == section]
            if not waypoints:
                break
            if len(waypoints) > 1:
                yield _lane(waypoints)


def _lane(waypoints: list[Any]) -> LaneGeometry:
    first = waypoints[0]
    poses = [waypoint.transform for waypoint in waypoints]
    centre = _points(pose.location for pose in poses)
    headings = np.radians([-pose.rotation.yaw for pose in poses])
    widths = np.array([waypoint.lane_width for waypoint in waypoints])
    leftwards = np.stack((-np.sin(headings), np.cos(headings), np.zeros(len(headings))), axis=1)
    to_border = leftwards * widths[:, None] / 2
    ahead = np.array((np.cos(headings[0]), np.sin(headings[0]), 0.0))
    reverse = bool((centre[1] - centre[0]) @ ahead < 0)
    return LaneGeometry(
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


def _landmark(landmark: Any) -> Landmark:
    (location,) = _points([landmark.transform.location])
    return Landmark(
        landmark.id,
        landmark.type,
        landmark.value,
        landmark.unit,
        landmark.road_id,
        landmark.s,
        tuple(landmark.get_lane_validities()),
        {"Positive": True, "Negative": False}.get(str(landmark.orientation)),
        location,
        np.radians(-landmark.transform.rotation.yaw),
    )


def _stop_line(mark: Any) -> Floats:
    (middle,) = _points([mark.transform.location])
    heading = np.radians(-mark.transform.rotation.yaw)
    half = mark.length / 2 * np.array((np.cos(heading), np.sin(heading), 0.0))
    return np.array((middle - half, middle + half))


def _polygons(corners: Iterable[Any]) -> list[Floats]:
    """Return closed polygons from one list of corners, in which the last corner of each polygon repeats its first."""
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
