"""The curves of roads: as by hand, in fine steps, and as in CARLA's library."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from carla_recap.roads.curves import PARAMETERS, Curve, double
from carla_recap.roads.lanes import TownRoads
from carla_recap.roads.opendrive import read_opendrive
from tests.roads.towns import lane, opendrive, road, section
from tests.twins import curves as by_hand

FAR, TURNED = 0.05, math.radians(0.5)


@st.composite
def shapes(draw: st.DrawFn, sharp: float, least: float) -> tuple[str, tuple[float, ...], float, str]:
    """Draw a kind of curve, its parameters, its length, and what it says of its range.

    It is about as sharp as some 1/m; a parametric cubic has at least some ratio of the length that it says, beyond which it
    goes on straight, as CARLA has it.
    """
    kind = draw(st.sampled_from(sorted(PARAMETERS)))
    length = draw(st.floats(2.0 if kind == "poly3" else 1.0, 200.0))  # of a shorter cubic, CARLA has five points
    bend = st.floats(-sharp, sharp)
    if kind in ("line", "arc", "spiral"):
        parameters = tuple(draw(bend) for _ in PARAMETERS[kind])
        assume(all(abs(value) > 1e-3 for value in parameters))  # beyond, single precision is too coarse in CARLA
        assume(kind != "spiral" or abs(parameters[1] - parameters[0]) > 1e-3)
        return kind, parameters, length, ""
    given = draw(st.sampled_from(("arcLength", "normalized", ""))) if kind == "paramPoly3" else ""
    bent = min(1 / length, sharp)
    v = (0.0, draw(st.floats(-0.5, 0.5)), draw(st.floats(-0.5, 0.5)) * bent, draw(st.floats(-0.3, 0.3)) * bent / length)
    if kind == "poly3":
        return kind, v, length, ""
    u = (0.0, draw(st.floats(least, 1.6)), draw(st.floats(-0.2, 0.2)) * bent * (least < 1), 0.0)
    p = 1.0 if given == "arcLength" else length
    return kind, tuple(value * p ** (power % 4) for power, value in enumerate((*u, *v))), length, given


def written(kind: str, parameters: tuple[float, ...], length: float, given: str) -> str:
    """A map with a road that is this curve, with a narrow lane."""
    values = " ".join(f'{name}="{value!r}"' for name, value in zip(PARAMETERS[kind], parameters, strict=True))
    given = f'pRange="{given}"' if given else ""
    shape = f"<{kind} {values} {given}/>"
    return opendrive(
        road(x=20, y=-30, heading=0.7, length=repr(length), shape=shape, sections=section(0, right=lane(-1, 0.2)))
    )


def end_of(kind: str, length: float, given: str) -> float:
    return 1.0 if kind == "paramPoly3" and given != "arcLength" else length


@given(shapes(0.05, 1.0))
def test_curves_are_as_in_fine_steps(shape: tuple[str, tuple[float, ...], float, str]) -> None:
    kind, parameters, length, given = shape
    end = end_of(kind, length, given)
    along = np.linspace(0.0, length, 23)
    x, y, headings = Curve(0.0, 0.0, 0.0, 0.0, length, kind, parameters, end).at(along, double)
    u, v, turn = by_hand.places(kind, parameters, length, end, along)
    assert np.hypot(x - u, y - v).max() < FAR
    assert np.abs((headings - turn + np.pi) % (2 * np.pi) - np.pi).max() < TURNED


@given(shapes(0.5, 0.6))
def test_curves_are_as_in_the_library_of_carla(shape: tuple[str, tuple[float, ...], float, str]) -> None:
    carla: Any = pytest.importorskip("carla")
    text = written(*shape)
    (course,) = TownRoads(read_opendrive(text)).lanes
    town = carla.Map("", text)
    for index in np.linspace(0, len(course.stations) - 1, 9).astype(int):
        place = town.get_waypoint_xodr(1, -1, float(course.stations[index])).transform
        x, y, _ = course.centre[index]
        assert math.hypot(place.location.x - x, -place.location.y - y) < FAR
        turned = math.radians(place.rotation.yaw) + course.headings[index]
        assert abs((turned + math.pi) % (2 * math.pi) - math.pi) < TURNED


@pytest.mark.parametrize("given", ["", "normalized"])
def test_the_distance_along_a_parametric_cubic_is_that_along_the_curve(given: str) -> None:
    """The bend is one of SUMO's, whose parameter is no distance."""
    sumo = (0.0, 22.052, -18.79046, 0.0, 0.0, 0.0, -36.47944, 0.0)
    along = np.linspace(0.0, 39.0, 157)
    x, y, _ = Curve(0.0, 0.0, 0.0, 0.0, 39.89, "paramPoly3", sumo, end_of("paramPoly3", 39.89, given)).at(along, double)
    assert np.hypot(np.diff(x), np.diff(y)) == pytest.approx(np.diff(along), abs=0.01)


@pytest.mark.parametrize(
    ("kind", "parameters"), [("arc", (0.0,)), ("spiral", (0.02, 0.02)), ("spiral", (0.0, 0.0)), ("paramPoly3", (0.0,) * 8)]
)
def test_curves_for_which_carla_has_no_number_have_one(kind: str, parameters: tuple[float, ...]) -> None:
    at = Curve(0.0, 0.0, 0.0, 0.0, 50.0, kind, parameters, 1.0).at(np.array([0.0, 25.0, 50.0]), double)
    assert np.isfinite(at).all()
    if kind != "paramPoly3":
        curvature = parameters[0]
        assert at[2] == pytest.approx([0, 25 * curvature, 50 * curvature])
