"""Tests of events and measures of the road: on a small map, and staged in the built-in town."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import NDArray

from carla_recap.formats import open_reader
from carla_recap.model.frame import Header
from carla_recap.model.lives import ActorLife
from carla_recap.model.records import Spawn, attributes
from carla_recap.queries.incidents import IncidentOptions, incidents
from carla_recap.queries.measures.definitions import MeasureValues
from carla_recap.queries.measures.road import TYPES, RoadEvent, RoadSearch
from carla_recap.queries.measures.road_signals import LightHistory
from carla_recap.queries.recorded_actors import actors
from carla_recap.roads.network import RoadNetwork
from carla_recap.roads.surfaces import build_network, find_road_network, load_road_network
from tests.queries.conftest import write
from tests.roads.straight_road import LIGHT_POSITION, STRAIGHT_ROAD
from tests.roads.towns import town
from tests.samples import SAMPLES, carla_log

Floats = NDArray[np.float64]
Pose = tuple[float, float, float]

TICK: Final = 0.05
RED, YELLOW, GREEN = 0, 1, 2
CAR, LIGHT, WALKER = 7, 3, 99
LENGTH: Final = 3.69  # m of a Mini


@pytest.fixture(scope="module")
def roads() -> RoadNetwork:
    return build_network(STRAIGHT_ROAD, "Straight")


class Drives:
    """Writes recordings of cars that drive along the straight road, and searches them."""

    def __init__(self, roads: RoadNetwork, path: Path) -> None:
        self.roads, self.path = roads, path
        self.extremes: dict[int, dict[str, tuple[float, float]]] = {}

    def __call__(
        self,
        *poses: Sequence[Pose] | Floats,
        lights: Callable[[float], int] = lambda _: GREEN,
        tick: float = TICK,
        aside: float = 0.0,
    ) -> list[RoadEvent]:
        """Return what cars do wrong that have a pose (x, y, heading in degrees) in each frame; a pedestrian stands by.

        The light is some metres aside of the one of the map.
        """
        x, y = LIGHT_POSITION
        spawned = [Spawn(LIGHT, 3, 100 * (x + aside), -100 * y, type_id="traffic.traffic_light")]
        spawned += [
            Spawn(CAR + number, 1, type_id="vehicle.mini.cooper_s", attributes=attributes(role_name="autopilot"))
            for number in range(len(poses))
        ]
        spawned.append(Spawn(WALKER, 2, type_id="walker.pedestrian.0001"))
        frames: list[dict[str, Any]] = []
        for index in range(len(poses[0])):
            at = [
                (CAR + number, 100 * px, -100 * py, 0.0, 0.0, 0.0, -yaw)
                for number, (px, py, yaw) in enumerate(each[index] for each in poses)
            ]
            at.append((WALKER, 0.0, 2000.0, 0.0, 0.0, 0.0, 0.0))
            time = index * tick
            frames.append({"transforms": at, "light_states": [(LIGHT, False, 0.0, lights(time + 1e-9))]})
        frames[0] = {"spawned": spawned, **frames[0]}
        write(self.path, frames, header=Header("Straight", 1_600_000_000), durations=[tick] * len(frames))
        with closing(open_reader(self.path)) as reader:
            return self.search(reader)

    def search(self, reader: Any) -> list[RoadEvent]:
        """Return what is found in a recording."""
        self.extremes = defaultdict(dict)

        def note(actor: ActorLife, name: str, found: MeasureValues) -> None:
            found = found.only(np.isfinite(found.value))
            if not len(found.value):
                return
            best, known = int(found.value.argmax()), self.extremes[actor.id].get(name, (0.0, 0.0))
            if found.value[best] > known[0]:
                self.extremes[actor.id][name] = float(found.value[best]), float(found.time[best])

        search = RoadSearch(reader, self.roads, actors(reader), note)
        for batch in reader.batches(TYPES):
            search.add(batch)
        return search.finish()


@pytest.fixture
def drives(roads: RoadNetwork, tmp_path: Path) -> Drives:
    return Drives(roads, tmp_path / "drive.log")


def path(xs: Sequence[float] | Floats, y: float, heading: float = 0.0) -> Floats:
    return np.array([(x, y, heading) for x in xs])


def along(speeds: Sequence[float] | Floats, x: float = 0.0, y: float = -1.75, heading: float = 0.0) -> Floats:
    """Poses of a car that has a speed in each frame."""
    way = np.cumsum(np.asarray(speeds)) * TICK
    return path(x + way * np.cos(np.radians(heading)), y, heading)


STEADY = np.full(200, 10.0)  # 10 s at 10 m/s, from x = 0 to x = 100 and beyond
EASTWARD = along(STEADY, x=50)  # the front is at the line at x = 100 after 4.8 s, the centre after 5 s


# --- which rules are broken ----------------------------------------------------------------------------------------------


def _west(speeds: Sequence[float], front: float = 12.0) -> Floats:
    """A car to the west, whose front begins some metres before the stop line at x = 120."""
    return along(speeds, x=120 + front + LENGTH / 2, y=1.75, heading=180)


def _swerve(far: float, seconds: float) -> Floats:
    """A car whose centre is at a distance outside the road for some seconds; the road ends at y = -4.5."""
    beside = round(seconds / TICK) + 1
    y = np.full(150, -1.75)
    y[40 : 40 + beside] = -4.5 - far
    return np.stack((np.arange(150) * 0.5, y, np.zeros(150)), axis=1)


def _overtaking(seconds: float) -> Floats:
    poses = along([8.0] * 100)
    poses[40 : 40 + round(seconds / TICK), 1] = 1.75
    return poses


def _at_sign(metres: float) -> Floats:
    """A car that stands with its front at a distance before the stop line, and then passes it."""
    front = np.concatenate((np.full(30, metres), np.linspace(metres, -10, 40)))
    return path(120 + LENGTH / 2 + front, 1.75, 180.0)


def _for(speed: float, seconds: float) -> Floats:
    return along([10.0] * 20 + [speed] * round(seconds / TICK) + [10.0] * 5)


def red_from(start: float, before: int = GREEN) -> Callable[[float], int]:
    return lambda time: RED if time >= start else before


ALWAYS_RED: Final = red_from(-1.0)
STANDS_BEFORE: Final = along([10.0] * 90 + [0.0] * 100 + [3.0] * 50, x=50)  # the front stands 3 m before the line
ACROSS: Final = along([10.0] * 100 + [0.0] * 100 + [10.0] * 50, x=50 - LENGTH / 4)  # with its front from 5 s to 10 s

DRIVES: Final[dict[str, tuple[Floats, Callable[[float], int], list[str]]]] = {
    "yellow": (EASTWARD, lambda _: YELLOW, []),
    "off": (EASTWARD, lambda _: 3, []),
    "unknown": (EASTWARD, lambda _: 4, []),
    "red after the front has crossed": (EASTWARD, red_from(4.85), []),
    "creeping over the line and waiting for green": (
        along([10.0] * 96 + [1.0] * 10 + [0.0] * 100 + [10.0] * 50, x=50),
        lambda time: RED if time < 9 else GREEN,
        [],
    ),
    "going on at red from across the line": (ACROSS, red_from(7.0), []),
    "the other direction": (along(STEADY, x=115, y=1.75, heading=180), ALWAYS_RED, []),
    "a teleport": (np.concatenate((path([60.0] * 40, -1.75), path([150.0] * 40, -1.75))), ALWAYS_RED, []),
    "standing before a stop sign at first": (_west([0.0] * 5 + [5.0] * 60, 1.5), ALWAYS_RED, []),
    "stopping 7.9 m before a stop sign": (_at_sign(7.9), ALWAYS_RED, []),
    "stopping at a stop sign": (_at_sign(0.1), ALWAYS_RED, []),
    "a moment off the road": (_swerve(1.0, 0.2), ALWAYS_RED, []),
    "the shoulder": (_swerve(-0.5, 2.0), ALWAYS_RED, []),
    "never on the road": (path(np.arange(0, 50, 0.5), -9.0), ALWAYS_RED, []),
    "reversing": (along([-3.0] * 60, x=40), ALWAYS_RED, []),
    "overtaking within a second": (_overtaking(0.9), ALWAYS_RED, []),
    "against the lane in a junction": (along([5.0] * 60, x=102, y=1.75), ALWAYS_RED, []),
    "a sign raises the limit": (along([20.0] * 45, x=52), lambda _: GREEN, []),
    "within the tolerance of a limit": (_for(15.0, 2.0), ALWAYS_RED, []),
    "too fast for a moment": (_for(20.0, 0.8), ALWAYS_RED, []),
    "red just before the front crosses": (EASTWARD, red_from(4.7, YELLOW), [f"runs a red light at 36 km/h (light {LIGHT})"]),
    "red again": (EASTWARD, lambda time: GREEN if 2 < time < 4 else RED, [f"runs a red light at 36 km/h (light {LIGHT})"]),
    "going on at red from before the line": (
        STANDS_BEFORE,
        red_from(7.0),
        [f"runs a red light at 11 km/h (light {LIGHT})"],
    ),
    "back and over the line again": (
        along([5.0] * 40 + [-5.0] * 40 + [5.0] * 60, x=95),
        ALWAYS_RED,
        [f"runs a red light at 18 km/h (light {LIGHT})"] * 2,
    ),
    "slowing down at a stop sign": (
        _west([6.0] * 30 + [1.0] * 60 + [6.0] * 30),
        ALWAYS_RED,
        ["passes a stop sign at 4 km/h without stopping"],
    ),
    "passing a stop sign": (_west([6.0] * 100), ALWAYS_RED, ["passes a stop sign at 22 km/h without stopping"]),
    "stopping 8.1 m before a stop sign": (_at_sign(8.1), ALWAYS_RED, ["passes a stop sign at 33 km/h without stopping"]),
    "the wrong way": (along([5.0] * 61, x=20, y=1.75), ALWAYS_RED, ["drives 15 m against the direction of its lane"]),
    "creeping off the road": (
        np.stack((np.full(200, 50.0), np.append([-1.75] * 40, np.linspace(-4.4, -5.6, 160)), np.zeros(200)), axis=1),
        ALWAYS_RED,
        ["leaves the road by 1.1 m"],
    ),
}


@pytest.mark.parametrize("name", DRIVES)
def test_which_rules_are_broken(drives: Drives, name: str) -> None:
    poses, lights, texts = DRIVES[name]
    assert [event.text for event in drives(poses, lights=lights)] == texts


# --- red lights ----------------------------------------------------------------------------------------------------------


def test_crossing_the_line_on_red_is_found_with_its_time(drives: Drives) -> None:
    (event,) = drives(EASTWARD, lights=ALWAYS_RED)
    assert (event.kind, event.actor.id) == ("red light", CAR)
    assert event.span == pytest.approx((5 - TICK - LENGTH / 2 / 10, 5 - TICK), abs=0.02)


def test_a_crossing_between_frames_far_apart_is_found_though_no_speed_follows_from_them(drives: Drives) -> None:
    (event,) = drives(path(50 + 15.0 * np.arange(12), -1.75), lights=ALWAYS_RED, tick=1.5)
    assert event.text == f"runs a red light (light {LIGHT})"
    assert event.span == pytest.approx((5 - LENGTH / 2 / 10, 5), abs=0.02)
    assert np.isnan(event.extreme[0])


@pytest.mark.parametrize(
    "poses",
    [np.array([(95 + 10 * t, -8 + 14 * t, 60.0) for t in np.arange(0, 1, TICK)]), along([-3.0] * 100, x=108)],
    ids=["askew", "in reverse"],
)
def test_crossing_the_line_otherwise_than_forwards_is_no_violation(drives: Drives, poses: Floats) -> None:
    assert "red light" not in [event.kind for event in drives(poses, lights=ALWAYS_RED)]


@pytest.mark.parametrize(("aside", "count"), [(3.0, 1), (-3.0, 1), (3.01, 0)])
def test_a_light_is_that_of_the_map_within_three_metres(drives: Drives, aside: float, count: int) -> None:
    assert len(drives(EASTWARD, lights=ALWAYS_RED, aside=aside)) == count


# --- stop signs, the edge of the road, the wrong way, and speed limits ---------------------------------------------------


@pytest.mark.parametrize("stands", [True, False])
def test_stopping_counts_though_a_part_begins_after_it(drives: Drives, stands: bool) -> None:
    drives(_west([6.0] * 36 + ([0.0] * 20 if stands else []) + [4.0] * 60))
    with closing(open_reader(drives.path)) as reader:
        part = IncidentOptions(kinds=["stop sign"], roads=drives.roads, start=(57 if stands else 37) * TICK)
        assert len(incidents(reader, part)) == (0 if stands else 1)


def test_leaving_the_road_is_found_with_its_distance(drives: Drives) -> None:
    (event,) = drives(_swerve(1.2, 1.0))
    assert (event.kind, event.text) == ("off road", "leaves the road by 1.2 m")
    assert event.span == pytest.approx((2.0, 3.0), abs=0.11)
    assert event.place[1] == pytest.approx(-5.7, abs=1e-3)
    assert drives(_swerve(0.2, 2.0)) == []
    assert drives.extremes[CAR]["distance_off_road"][0] == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize(("begin", "greatest"), [(62, [1.4]), (66, [1.0, 1.4])])
def test_two_excursions_half_a_second_apart_are_one(drives: Drives, begin: int, greatest: list[float]) -> None:
    """Samples are 0.1 s apart: the first excursion ends after 2.6 s, the second begins after 3.1 s or 3.3 s."""
    y = np.full(150, -1.75)
    y[40:54] = -4.5 - 0.8
    y[46:48] = -4.5 - 1.0
    y[begin : begin + 16] = -4.5 - 1.4
    events = drives(np.stack((np.arange(150) * 0.5, y, np.zeros(150)), axis=1))
    assert [event.extreme[0] for event in events] == pytest.approx(greatest, abs=1e-3)
    assert [event.span[0] for event in events] == pytest.approx([2.0, begin * TICK][: len(greatest)])
    assert events[0].extreme[1] == pytest.approx(2.3 if len(events) == 2 else begin * TICK)


def test_the_ways_against_the_lane_of_one_run_add_up(drives: Drives) -> None:
    poses = along([5.0] * 100, x=10, y=1.75)
    poses[50:56, 1] = -1.75  # back in its own lane for 0.3 s
    (event,) = drives(poses)
    assert event.kind == "wrong way"
    assert event.extreme[0] == pytest.approx(25 - 6 * 0.25, abs=0.6)
    assert event.extreme == drives.extremes[CAR]["distance_against_lane"]
    assert event.span == pytest.approx((0.1, 4.9), abs=0.11)
    assert event.extreme[1] == event.span[1]


def test_speeding_is_found_with_speed_and_limit(drives: Drives) -> None:
    (event,) = drives(along([20.0] * 40))  # 72 km/h where 50 are allowed
    assert (event.kind, event.text) == ("speeding", "drives 72 km/h where 50 km/h are allowed")
    assert drives.extremes[CAR]["speed_over_limit"][0] == pytest.approx(20 - 50 / 3.6, abs=0.01)


# --- incidents -----------------------------------------------------------------------------------------------------------


def test_broken_rules_are_incidents_where_they_are_asked_for(drives: Drives, roads: RoadNetwork) -> None:
    """Of a car that runs a red light and drives too fast."""
    drives(along([20.0] * 120), lights=ALWAYS_RED)
    with closing(open_reader(drives.path)) as reader:
        assert incidents(reader, IncidentOptions(roads=roads)) == []
        found = incidents(reader, IncidentOptions(kinds="all", roads=roads))
    assert [(row.kind, row.actors, row.type_ids) for row in found] == [
        ("speeding", (CAR,), ("vehicle.mini.cooper_s",)),
        ("red light", (CAR,), ("vehicle.mini.cooper_s",)),
    ]
    values = [(row.measure, round(row.value, 1), row.unit, round(row.threshold, 2)) for row in found]
    assert values[0] == ("speed_over_limit", 6.1, "m/s", 1.39)
    assert values[1][:3] == ("speed", 20.0, "m/s")
    assert found[1].time == found[1].start
    assert found[1].text == f"vehicle.mini.cooper_s ({CAR}) runs a red light at 72 km/h (light {LIGHT})"
    assert (found[1].x, found[1].y) == pytest.approx((100, -1.75), abs=2.5)


# --- recordings that are odd ---------------------------------------------------------------------------------------------


def test_poses_that_are_no_numbers_do_not_count(drives: Drives) -> None:
    poses = EASTWARD.copy()
    poses[30:60] = np.nan
    poses[100] = 1e30  # at the line
    (event,) = drives(poses, lights=ALWAYS_RED)
    assert (event.kind, event.extreme[0]) == ("red light", pytest.approx(10))


@pytest.mark.parametrize(
    ("cars", "tick", "kinds"),
    [
        (
            (
                EASTWARD,
                along([20.0] * 200),
                along([5.0] * 200, x=20, y=1.75),
                np.concatenate((_swerve(1.0, 3.0), _swerve(1, 0)))[:200],
            ),
            TICK,
            {"red light", "speeding", "wrong way", "off road"},
        ),
        (  # between frames far apart
            (along([120.0] * 30, x=5), along([60.0] * 30, x=5, y=1.75), _swerve(1.0, 5.0)[30:60]),
            0.7,
            {"off road", "wrong way"},
        ),
    ],
)
def test_neither_blocks_nor_the_format_change_anything(
    drives: Drives, monkeypatch: pytest.MonkeyPatch, cars: tuple[Floats, ...], tick: float, kinds: set[str]
) -> None:
    lights = ALWAYS_RED if "red light" in kinds else red_from(9e9)
    whole, extremes = drives(*cars, lights=lights, tick=tick), drives.extremes
    assert {event.kind for event in whole} == kinds
    as_mcap = Drives(drives.roads, drives.path.with_suffix(".mcap"))
    monkeypatch.setattr("carla_recap.queries.measures.motion_table._FRAMES", 7)
    for parts in (drives, as_mcap):
        assert parts(*cars, lights=lights, tick=tick) == whole
        assert parts.extremes == extremes


# --- traffic ------------------------------------------------------------------------------------------------------------


def test_law_abiding_traffic_breaks_no_rule() -> None:
    """Half a minute of it; `benchmarks/` has ten."""
    assert events_in(SAMPLES / "junction.mcap") == []


def test_who_gets_the_id_of_a_vehicle_on_the_road_has_not_left_it(drives: Drives) -> None:
    spawn = Spawn(CAR, 1, type_id="vehicle.mini.cooper_s", attributes=[])
    poses = [(50.0 + index, -1.75) if index < 50 else (50.0, 60.0) for index in range(100)]
    frames: list[dict[str, Any]] = [{"transforms": [(CAR, 100 * x, -100 * y, 0.0, 0.0, 0.0, 0.0)]} for x, y in poses]
    for index in (0, 50):
        frames[index]["spawned"] = [spawn]
    write(drives.path, frames, header=Header("Straight", 1_600_000_000), durations=[TICK] * len(frames))
    with closing(open_reader(drives.path)) as reader:
        assert drives.search(reader) == []


def events_in(recording: Path) -> list[RoadEvent]:
    """What is found in a recording of the built-in town."""
    roads = find_road_network("Brickfield")
    assert roads is not None
    with closing(open_reader(recording)) as reader:
        return Drives(roads, recording).search(reader)


@pytest.mark.parametrize("name", ["carla-0.9.10-lane-center.log", "carla-0.9.13-lane-center.log"])
def test_a_calm_drive_in_town01_breaks_no_rule(name: str) -> None:
    roads = load_road_network(town("Town01"))
    with closing(open_reader(carla_log(name))) as reader:
        assert Drives(roads, carla_log(name)).search(reader) == []
        assert len(LightHistory(reader, roads).signals) == 36  # all lights of the map are recorded
