"""Where cameras are: what they show of the followed actor, the horizon, and the road ahead."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from carla_recap.scene.instances import Instances
from carla_recap.show.video.camera_paths import Subject, Transparency, camera_path, camera_size, covered_by, pixels_per_metre
from tests.rendering.shapes import boxes

SIZE = (1280, 720)
CAR, BUS, WALKER = (2.3, 0.95, 0.75), (6.0, 1.4, 1.75), (0.25, 0.25, 0.93)


def subject(half: tuple[float, float, float] = CAR, heading: float = 0.0, **options: Any) -> Subject:
    yaw = math.radians(heading)
    rotation = np.array([(math.cos(yaw), -math.sin(yaw), 0), (math.sin(yaw), math.cos(yaw), 0), (0, 0, 1)])
    return Subject(
        np.array((10.0, 20.0, 1.0)),
        rotation,
        np.array(half),
        options.pop("body", rotation),
        heading,
        options.pop("speed", 0.0),
        **options,
    )


def test_a_walker_that_lies_covers_what_its_body_covers() -> None:
    lying = np.array([(0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)])  # its head is ahead
    standing, fallen = subject(WALKER, is_walker=True), subject(WALKER, is_walker=True, body=lying)
    camera = camera_path("chase", SIZE).camera(SimpleNamespace(time=0.0), instances(), standing)
    (_, top, _, bottom), (left, lying_top, right, lying_bottom) = (covered_by(camera, each) for each in (standing, fallen))
    assert lying_bottom - lying_top < 0.7 * (bottom - top)
    assert lying_top > top + 0.4 * (bottom - top)
    assert right > left


def instances(*centres: tuple[float, float, float], half: Any = CAR) -> Instances:
    return boxes(*centres, half=half, ids=range(1, len(centres) + 1))


def camera(view: Any, filmed: Subject | None, size: tuple[int, int] = SIZE, seen: Instances | None = None) -> Any:
    return camera_path(view, size).camera(SimpleNamespace(time=0.0), seen or instances(), filmed)  # type: ignore[arg-type]


def box(filmed: Subject) -> Any:
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (0, 2)]) * filmed.half
    return filmed.ground + corners @ filmed.rotation.T


@pytest.mark.parametrize("half", [CAR, BUS, WALKER])
@pytest.mark.parametrize("heading", [0.0, 117.0])
@pytest.mark.parametrize("size", [SIZE, (720, 1280), (400, 400)])
def test_chase_shows_the_actor_below_a_horizon_in_the_upper_third(half: Any, heading: float, size: Any) -> None:
    filmed = subject(half, heading)
    taken = camera("chase", filmed, size)
    x, y, depth = taken.project(box(filmed)).T
    assert (depth > 2).all()
    assert x.min() + x.max() == pytest.approx(size[0], abs=2)
    assert (x.min() > 0.2 * size[0]) & (y.max() < 0.95 * size[1])
    far = taken.project(np.array([taken.location + 1e6 * (filmed.rotation[:, 0] * (1, 1, 0))]))[0]
    assert far[:2] == pytest.approx((size[0] / 2, 0.31 * size[1]), abs=1)
    assert y.min() > far[1]  # the road ahead is seen over its roof


def test_chase_is_farther_from_what_is_larger() -> None:
    far = [np.linalg.norm(camera("chase", subject(half)).location - subject(half).ground) for half in (WALKER, CAR, BUS)]
    assert far[0] < 0.8 * far[1] < 0.45 * far[2]


def test_top_has_the_actor_below_the_middle_and_its_heading_upwards() -> None:
    filmed = subject(heading=70.0)
    taken = camera("top", filmed)
    here, ahead = taken.project(np.array([filmed.ground, filmed.ground + 5 * filmed.rotation[:, 0]]))
    assert here[:2] == pytest.approx((640, 360 + 0.16 * 720), abs=1)
    assert ahead[0] == pytest.approx(640, abs=1)
    scale = pixels_per_metre(taken, float(filmed.ground[2]))
    assert scale is not None
    assert here[1] - ahead[1] == pytest.approx(5 * scale, rel=1e-6)


def test_top_shows_more_at_speed_and_zooms_slowly() -> None:
    path = camera_path("top", SIZE)
    spans = []
    for time, speed in ((0.0, 0.0), (0.1, 20.0), (0.2, 20.0), (20.0, 20.0)):
        filmed = subject(speed=speed)
        scale = pixels_per_metre(path.camera(SimpleNamespace(time=time), instances(), filmed), 1.0)  # type: ignore[arg-type]
        spans.append(720 / scale)  # type: ignore[operator]
    assert spans[0] == pytest.approx(42)
    assert spans[0] < spans[1] < spans[2] < spans[0] + 8
    assert spans[3] == pytest.approx(86, abs=0.1)


@pytest.mark.parametrize(
    ("half", "options"), [(CAR, {}), (BUS, {}), (WALKER, {"is_walker": True}), ((1, 0.4, 0.75), {"two_wheeled": True})]
)
def test_driver_looks_ahead_from_within_the_height_of_the_actor(half: Any, options: Any) -> None:
    filmed = subject(half, 30.0, **options)
    taken = camera("driver", filmed)
    ahead, _, up = (taken.location - filmed.ground) @ filmed.rotation
    assert 0 < ahead < half[0] + 0.2
    assert half[2] < up < 2 * half[2]
    assert taken.rotation[:2, 0] / np.linalg.norm(taken.rotation[:2, 0]) == pytest.approx(filmed.rotation[:2, 0])


def test_without_an_actor_the_camera_shows_most_of_them() -> None:
    seen = instances(*((x, y, 0.5) for x in (100.0, 130.0) for y in (-50.0, -20.0)))
    for view in ("chase", "top", "driver"):
        x, y, depth = camera(view, None, seen=seen).project(seen.locations).T
        assert ((depth > 0) & (x > 0) & (x < 1280) & (y > 0) & (y < 720)).all()
    assert np.isfinite(camera("top", None).location).all()
    assert np.isfinite(camera("top", None, seen=instances((math.nan, 0, 0))).location).all()


def test_opacity_changes_slowly() -> None:
    filmed = subject()
    x, y, z = filmed.ground.tolist()
    seen = instances((x, y, z + 0.75), (x + 6.0, y, z + 0.05))
    taken, fading = camera("chase", filmed, seen=seen), Transparency()
    values = [float(fading.apply(taken, seen, 1, 1 / 30).opacity[0]) for _ in range(30)]
    assert 0.9 < values[0] < 1
    assert values == sorted(values, reverse=True)
    assert values[-1] == pytest.approx(0.4, abs=0.02)


@pytest.mark.parametrize(
    ("attributes", "size"),
    [
        ({"image_size_x": "640", "image_size_y": "480"}, (640, 480)),
        ({"image_size_x": "640"}, None),
        ({"image_size_x": "a", "image_size_y": "b"}, None),
        ({"image_size_x": "inf", "image_size_y": "inf"}, None),
    ],
)
def test_the_recorded_size_of_a_camera(attributes: dict[str, str], size: tuple[int, int] | None) -> None:
    assert camera_size(attributes) == size
