from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carla_recap.errors import RecapWarning
from carla_recap.queries.measures.encroachment import CrossingSearch, Encounter
from carla_recap.queries.measures.motion_table import MotionTable
from tests.queries.measures.conftest import motion_table


class Path(NamedTuple):
    """A straight path of a box: the centre in m and the heading in radians at each time."""

    x: np.ndarray
    y: np.ndarray
    yaw: np.ndarray


def path(x: float, y: float, heading: float, speed: float, seconds: float = 6.0) -> Path:
    time, yaw = np.arange(0, seconds, 0.05), math.radians(heading)
    return Path(x + speed * math.cos(yaw) * time, y + speed * math.sin(yaw) * time, yaw + 0 * time)


def post_encroachment_time(one: Path, other: Path, start: float = 0.0) -> float:
    """The least time between one box of 4 m by 2 m leaving a spot and the other arriving there, up to 3 s; else inf."""
    x, y, yaw = map(np.stack, zip(one, other, strict=True))
    table = motion_table(start + 0.05 * np.arange(x.shape[1]), x, y, yaw=yaw, vx=10.0)
    search = CrossingSearch(3.0)
    search.add(table, np.ones(2, np.bool_))
    return min((each.post_encroachment_time for each in search.finish()), default=math.inf)


EAST = path(-20, 0, 0, 10)


def test_crossings_are_found_at_any_time() -> None:
    """As in a recording whose seconds are those since 1970."""
    found = [post_encroachment_time(EAST, path(0, -28, 90, 10), start) for start in (0.0, 1.7e9)]
    assert found == [pytest.approx(0.2, abs=0.01)] * 2
    with pytest.warns(RecapWarning, match="no crossings are found behind 1e"):
        post_encroachment_time(EAST, path(0, -28, 90, 10), 2e10)


@settings(max_examples=40, deadline=None)
@given(st.floats(4, 14), st.floats(4, 14), st.floats(45, 135), st.floats(-40, -8))
def test_it_is_the_entry_of_the_second_less_the_exit_of_the_first(v1: float, v2: float, turn: float, start: float) -> None:
    """By points on a fine grid in the shared area, each with the times at which the boxes cover it."""
    one = path(-15, 0, 0, v1, seconds=8)
    angle = math.radians(turn)
    other = path(start * math.cos(angle), start * math.sin(angle), turn, v2, seconds=8)
    points = np.stack(np.meshgrid(np.linspace(-4, 4, 161), np.linspace(-1, 1, 41)), axis=-1).reshape(-1, 2)
    spans = []
    for box, speed in ((one, v1), (other, v2)):
        yaw = box.yaw[0]
        along = (points - (box.x[0], box.y[0])) @ (math.cos(yaw), math.sin(yaw))
        across = (points - (box.x[0], box.y[0])) @ (-math.sin(yaw), math.cos(yaw))
        covered = np.abs(across) <= 1
        spans.append((np.where(covered, (along - 2) / speed, np.nan), np.where(covered, (along + 2) / speed, np.nan)))
    (enter1, leave1), (enter2, leave2) = spans
    later = np.fmax(enter2 - leave1, enter1 - leave2)
    expected = math.inf if not (later > 0).all() and (later <= 0).any() else float(np.nanmin(later))
    found = post_encroachment_time(one, other)
    if expected < 2.8:
        assert found == pytest.approx(expected, abs=0.1)
    elif expected == math.inf:
        assert found == math.inf or found < 0.1


def crossing(time: np.ndarray, **changed: Any) -> MotionTable:
    """Two cars at 10 m/s: one to the east is at the origin after 5 s, one to the north after 7 s; 1.4 s are between them."""
    still, east, north = np.zeros(len(time)), 10 * (time - 5), 10 * (time - 7)
    turned, heights = [[0.0], [np.pi / 2]], np.array([1.5, 2.5])
    ways = [east, still], [still, north]
    return replace(motion_table(time, *ways, 0.0, turned, [[10.0], [0.0]], [[0.0], [10.0]], height=heights), **changed)


def found_in(table: MotionTable, longest: float = 3.0) -> list[Encounter]:
    """Return the crossings in all frames."""
    search = CrossingSearch(longest)
    search.add(table, np.array([True, True]))
    return search.finish()


TIME = np.arange(0, 14, 0.05)


@pytest.mark.parametrize("rate", [2, 3, 5, 10, 20, 30, 100])
def test_the_frame_rate_changes_nothing(rate: int) -> None:
    (found,) = found_in(crossing(np.arange(0, 14, 1 / rate)))
    assert found.post_encroachment_time == pytest.approx(1.4, abs=0.011)


def raised(dz: float) -> MotionTable:
    """Boxes of 1.5 m and 2.5 m height touch up to 2 m between their centres."""
    return crossing(TIME, z=np.stack([np.full(len(TIME), 5.0), np.full(len(TIME), 5.0 + dz)]))


def slowed(actor: int, speed: float) -> MotionTable:
    table = crossing(TIME)
    (table.vx, table.vy)[actor][actor] = speed
    return table


def turned(angle: float) -> MotionTable:
    """The second one comes at an angle in degrees."""
    yaw, way, table = math.radians(angle), 10 * (TIME - 7), crossing(TIME)
    table.x[1], table.y[1], table.yaw[1] = way * math.cos(yaw), way * math.sin(yaw), yaw
    return table


def touching(moment: float) -> MotionTable:
    """The first one leaves from 4.7 s to 5.3 s, the second one arrives from 6.7 s to 7.3 s, and they touch once."""
    table, frame = crossing(TIME), round(moment * 20)
    table.x[0, frame], table.y[0, frame] = table.x[1, frame] + 1, table.y[1, frame] + 1
    return table


@pytest.mark.parametrize(
    ("changed", "some"),
    [
        *((raised(dz), abs(dz) <= 2) for dz in (2.0, -2.0, 2.001, -2.001)),
        *((slowed(actor, speed), speed >= 1) for actor in (0, 1) for speed in (1.0, 0.999)),
        *((turned(angle), 30 <= angle <= 150) for angle in (29.9, 30.1, 149.9, 150.1, -29.9)),
        *((touching(moment), some) for moment, some in ((1.5, True), (2.4, False), (9.6, False), (10.45, True))),
    ],
)
def test_what_is_a_crossing(changed: MotionTable, some: bool) -> None:
    assert (len(found_in(changed)) > 0) == some
