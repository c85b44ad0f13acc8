"""The numbers of Bench2Drive, of drives made by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carla_recap import open_recording
from carla_recap.queries.measures.drives import COMFORT, comfort, comfort_values
from carla_recap.queries.score import ABILITIES, Infraction, Route, Score, abilities, bench2drive
from tests.queries.score.drives import HERO, OTHER, Drives, at_speed, vehicle, westward


@pytest.fixture
def drives(tmp_path: Path) -> Drives:
    return Drives(tmp_path / "drive.mcap")


FRAMES = np.arange(0, 8, 0.05)  # s: four windows, whose last one lacks a sample at most


def outside(time: Any, velocity: Any, yaw: Any) -> dict[str, float]:
    """Return the windows in % in which each quantity is outside its bounds, without those in which it never is."""
    found = comfort(time, velocity, yaw)
    assert found is not None
    assert found.smoothness <= min(found.within.values())
    return {name: 100 - share for name, share in found.within.items() if share < 100}


def straight(speed: Any) -> tuple[Any, Any, Any]:
    return FRAMES, np.stack((speed, 0 * speed), axis=1), np.zeros(len(speed))


def turning(speed: float, yaw: Any) -> tuple[Any, Any, Any]:
    return FRAMES, speed * np.stack((np.cos(yaw), np.sin(yaw)), axis=1), yaw


@pytest.mark.parametrize(
    ("motion", "expected"),
    [
        (straight(np.full(len(FRAMES), 12.0)), {}),
        (straight(40 + 2.3 * FRAMES), {}),
        (straight(40 + 2.5 * FRAMES), {"longitudinal_acceleration": 100}),
        (straight(40 - 4.0 * FRAMES), {}),
        (straight(40 - 4.1 * FRAMES), {"longitudinal_acceleration": 100}),
        (turning(8.0, 8.0 / 16.0 * FRAMES), {}),  # 4 m/s² and 0.5 rad/s
        (turning(8.0, np.remainder(0.5 * FRAMES + np.pi, 2 * np.pi) - np.pi), {}),  # past 180 degrees
        (turning(10.0, 10.0 / 16.0 * FRAMES), {"lateral_acceleration": 100}),  # 6.25 m/s²
        (turning(4.0, FRAMES), {"yaw_rate": 100}),  # 1 rad/s and 4 m/s²
        (turning(-4.0, -FRAMES), {"yaw_rate": 100}),
        # Braking with 5 m/s² from 2.5 to 3.5 s is in the second of four windows; it begins and ends with a jerk.
        (
            straight(20 - 5 * np.clip(FRAMES - 2.5, 0, 1)),
            {"longitudinal_acceleration": 25, "longitudinal_jerk": 25, "jerk": 25},
        ),
    ],
)
def test_quantities_have_bounds_and_a_window_counts_as_a_whole(motion: Any, expected: dict[str, float]) -> None:
    assert outside(*motion) == pytest.approx(expected)


def out(along: Any, aside: Any, turning: Any) -> set[str]:
    """Return what is out of bounds in a window of samples of accelerations and yaw rates."""
    values = comfort_values(*(np.broadcast_to(each, np.shape(along)) for each in (along, aside, turning)))
    bounds = COMFORT.items()
    return {name for name, (least, most) in bounds if not ((values[name] > least) & (values[name] < most)).all()}


@pytest.mark.parametrize("sign", [1, -1])
def test_slopes_have_bounds(sign: int) -> None:
    """An even growth over ten samples, or six, with nothing else out of bounds."""
    ten, six = sign * 0.1 * (np.arange(10) - 4.5), 0.1 * np.arange(6)
    assert out(4.0 * ten, 3.0, 0.0) == set()
    assert out(4.3 * ten, 3.0, 0.0) == {"longitudinal_jerk"}
    assert out(0 * six, sign * 8.2 * six, 0.0) == set()
    assert out(0 * six, sign * 8.5 * six, 0.0) == {"jerk"}
    assert out(0 * ten, 0.0, 1.8 * ten) == set()
    assert out(0 * ten, 0.0, 2.0 * ten) == {"yaw_acceleration"}


def test_what_says_nothing_about_comfort() -> None:
    time, velocity, yaw = straight(np.full(len(FRAMES), 12.0))
    assert comfort(time[:3], velocity[:3], yaw[:3]) is None  # 0.1 s
    assert comfort(time[:5], velocity[:5], yaw[:5]) is not None
    assert comfort(time[:0], velocity[:0], yaw[:0]) is None
    assert comfort(time * 400, velocity, yaw) is None  # a frame in 20 s
    assert comfort(time, np.full_like(velocity, np.nan), yaw) is None
    velocity[40:44] = np.nan
    assert outside(time, velocity, yaw) == {}
    time = np.append(time, [np.nan, np.inf])
    assert outside(time, np.vstack((velocity, velocity[-2:])), np.append(yaw, [0, 0])) == {}


def beside(speeds: list[float], role: str = "background", speed: float = 8.0) -> dict[int, Any]:
    return {OTHER: (vehicle(OTHER, role), westward([speed] * len(speeds), y=5.25))}


def test_efficiency_is_the_speed_against_the_traffic(drives: Drives) -> None:
    """The hero drives 10 m/s on the first half, and 6 m/s on the second; a vehicle of the traffic has 8 m/s beside it."""
    speeds = at_speed(10, 50) + at_speed(6, 51)
    traffic = beside(speeds)
    found = drives(westward(speeds), others=traffic)
    assert found.efficiency == pytest.approx((10 * 125 + 11 * 75) / 21, abs=1.5)  # the last of twenty parts counts twice
    assert found.smoothness is not None
    assert found.smoothness < 100
    assert drives(westward(speeds), others=beside(speeds, "parked")).efficiency is None
    assert drives(westward(speeds), others=beside(speeds, speed=0.5)).efficiency is None  # above 1,000 %


def test_measures_have_the_numbers_too(drives: Drives) -> None:
    speeds = at_speed(10, 50) + at_speed(6, 51)
    traffic = beside(speeds)
    found = drives(westward(speeds), others=traffic, route=None)
    with open_recording(drives.path) as recording:
        rows = {(row.actor, row.measure): (row.value, row.unit, row.time) for row in recording.measures("all")}
        assert rows[HERO, "driving_efficiency"] == (found.efficiency, "%", found.stop)
        assert rows[HERO, "driving_smoothness"] == (found.smoothness, "%", found.stop)
        assert (OTHER, "driving_smoothness") not in rows
        part = {row.measure: row.time for row in recording.measures("hero", start=1.0, stop=4.0)}
        assert part["driving_smoothness"] == pytest.approx(3.95)


def test_a_route_with_a_slow_quarter_is_a_success(drives: Drives) -> None:
    speeds = at_speed(6, 101)
    traffic = beside(speeds)
    found = drives(westward(speeds), others=traffic)
    assert found.status == "Completed"
    assert {each.kind for each in found.infractions} == {"min_speed_infractions"}
    assert found.success is True
    assert drives(westward(at_speed(10, 50))).success is False
    assert drives(westward(speeds), route=None).success is None
    assert len({found, found}) == 1
    hit = {OTHER: (vehicle(OTHER, "parked"), [(200.0, 1.75, 0.0)] * len(speeds))}
    assert drives(westward(speeds), others=hit, touches=[(60, OTHER)]).success is False


def scored(scenario: str, *kinds: str, completion: float = 100.0, junction: float | None = None) -> Score:
    infractions = tuple(Infraction(kind, 1.0, 0.0, 0.0, 0.0, None, "", 1.0, "") for kind in kinds)
    status = "Failed" if completion < 100 else "Completed"
    numbers = (completion, completion, 1.0, infractions, 100.0, 100.0, 0.0, 10.0)
    return Score("a.mcap", "1", 0, "Town01", "2.0", status, *numbers, (scenario,), 120.0, 50.0, {}, junction)


def test_abilities_are_those_of_the_first_scenario() -> None:
    found = abilities([scored("Accident"), scored("Accident", "red_light"), scored("EnterActorFlow"), scored("Unknown")])
    assert [(each.name, each.passed, each.routes) for each in found] == [
        ("Overtaking", 1, 2),
        ("Merging", 1, 1),
        ("Emergency_Brake", 0, 0),
        ("Give_Way", 0, 0),
        ("Traffic_Signs", 1, 1),
    ]
    assert list(ABILITIES) == [each.name for each in found]


@pytest.mark.parametrize(
    ("kinds", "completion", "junction", "passed"),
    [
        (("collisions_vehicle",), 60.0, 40.0, 1),
        (("collisions_vehicle",), 40.0, 40.0, 0),
        (("collisions_vehicle",), 60.0, None, 0),
        (("red_light",), 60.0, 40.0, 0),
        (("stop_infraction",), 100.0, 40.0, 0),
    ],
)
def test_signs_count_up_to_the_first_junction(
    kinds: tuple[str, ...], completion: float, junction: float | None, passed: int
) -> None:
    found = abilities([scored("T_Junction", *kinds, completion=completion, junction=junction)])
    assert [each for each in found if each.routes] == [("Traffic_Signs", passed, 1)]


def test_the_junction_is_that_of_the_route(drives: Drives) -> None:
    """The junction begins at x = 132.5, behind 23 points each metre, which Bench2Drive takes for passed 8 points later."""
    route = Route("1", "Brickfield", np.array([(155.0, 1.75, 0.0), (80.0, 1.75, 0.0)]))
    found = drives(westward(at_speed(10, 75), start=155.0), route=route)
    assert found.junction == pytest.approx(100 * (23 + 8) / 76, abs=3)
    assert drives(westward(at_speed(10, 101))).junction is None


def test_numbers_of_many_are_means() -> None:
    assert bench2drive([scored("Accident"), scored("Accident", "red_light")]) == {
        "success_rate": 50.0,
        "driving_efficiency": 120.0,
        "driving_smoothness": 50.0,
        "abilities": {"Overtaking": 50.0, "mean": 50.0},
    }
    nothing = {"success_rate": None, "driving_efficiency": None, "driving_smoothness": None, "abilities": {"mean": None}}
    assert bench2drive([]) == nothing
