"""What is written on pictures: where, in which colours, and how long the bars are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("PIL", reason="the extra `video` is not installed")

from carla_recap.scene.style import LIGHTS
from carla_recap.show.video.overlay import Caption, LightAhead, Overlay, Readings

SIZE = (1280, 720)
GREY = 90
FULL = Readings(
    24.6, 0.5, "hero 100", 12.0, (0.5, 1.0, -0.5), LightAhead(0, 38.0), (Caption("collision", "Hero hits a wall"),), 20.0
)


def drawn(readings: Readings, size: tuple[int, int] = SIZE, **options: Any) -> Any:
    """Return a grey picture with readings, as red, green, blue."""
    picture = np.full((size[1], size[0], 4), GREY, np.uint8)
    Overlay(size, **options).draw(picture, readings)
    assert (picture[..., 3] == GREY).all()
    return picture[..., 2::-1]


def near(picture: Any, color: tuple[int, int, int], tolerance: int = 10) -> Any:
    """Return which pixels have nearly a colour."""
    return (np.abs(picture.astype(int) - color) <= tolerance).all(axis=-1)


def changed(picture: Any) -> tuple[slice, slice]:
    rows, columns = np.nonzero((picture != GREY).any(axis=-1))
    return slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)


def widths(picture: Any, color: tuple[int, int, int]) -> int:
    """Return the width of what has a colour in the lower left panel."""
    columns = np.flatnonzero(near(picture[540:700, :300], color).any(axis=0))
    return int(columns[-1] - columns[0] + 1) if len(columns) else 0


def test_the_middle_stays_free() -> None:
    picture = drawn(FULL, map_name="Town01", speed=0.5, marks=[(0.2, "collision")])
    assert (picture[120:540, 300:1000] == GREY).all()


@pytest.mark.parametrize("size", [SIZE, (640, 360), (360, 640)])
@pytest.mark.parametrize("middle", [0.3, 0.65, 0.85])
def test_captions_leave_the_followed_actor_free(size: tuple[int, int], middle: float) -> None:
    x, y = size[0] // 2, round(middle * size[1])
    kept_free = (x - 20, y - 40, x + 20, y + 40)
    captions = (Caption("blocked", "Mercedes Sprinter (42) stands still for 44 s"), Caption("blocked", "Hero stands still"))
    readings = replace(FULL, captions=captions, progress=None)
    without, picture = (drawn(replace(readings, captions=shown, kept_free=kept_free), size) for shown in ((), captions))
    is_caption = (picture != without).any(axis=-1)
    assert is_caption.any()
    assert not is_caption[y - 40 : y + 40, x - 20 : x + 20].any()


def test_captions_leave_their_place_when_the_followed_actor_comes_there() -> None:
    overlay, readings = Overlay(SIZE), replace(FULL, captions=(Caption("blocked", "Hero stands still"),), progress=None)
    picture = np.full((SIZE[1], SIZE[0], 4), GREY, np.uint8)
    overlay.draw(picture.copy(), readings)
    x, y = SIZE[0] // 2, SIZE[1] - 60  # a corner of it below the caption
    readings = replace(readings, kept_free=(x - 20, y - 200, x + 20, y + 5))
    without = picture.copy()
    Overlay(SIZE).draw(without, replace(readings, captions=()))
    overlay.draw(picture, readings)
    assert (picture != without).any()
    assert (picture == without)[y - 200 : y + 5, x - 20 : x + 20].all()


def test_bars_are_as_long_as_the_controls() -> None:
    def bar(throttle: float, brake: float) -> tuple[int, int]:
        picture = drawn(Readings(0.0, controls=(throttle, brake, 0.0), speed=0.0))
        return widths(picture, (70, 210, 110)), widths(picture, (235, 64, 52))

    whole = bar(1.0, 1.0)
    assert whole[0] == whole[1] > 100
    half, quarter = bar(0.5, 0.25)
    assert half == pytest.approx(whole[0] / 2, abs=2)
    assert quarter == pytest.approx(whole[0] / 4, abs=2)
    assert bar(0.0, 0.0) == (0, 0)
    assert bar(7.0, -7.0) == (whole[0], 0)


def test_steering_to_the_left_is_left_of_the_middle() -> None:
    def columns(steer: float) -> Any:
        return np.flatnonzero(near(drawn(Readings(0.0, controls=(0, 0, steer)))[540:700], (120, 186, 255)).any(axis=0))

    left, right = columns(-1.0), columns(1.0)
    assert left.max() <= right.min() + 1
    assert len(left) == pytest.approx(len(right), abs=2)


@pytest.mark.parametrize("state", [0, 1, 2, 3])
def test_the_light_ahead_has_its_color_at_its_height(state: int) -> None:
    picture = drawn(Readings(0.0, light=LightAhead(state, 38.0)))[:150, 1000:]
    lit = [np.nonzero(near(picture, LIGHTS[each][1])) for each in range(3)]
    assert [len(rows) > 30 for rows, _ in lit] == [each == state for each in range(3)]
    assert state == 3 or lit[state][0].mean() == pytest.approx(45 + 20 * state, abs=5)


@pytest.mark.parametrize(("pixels_per_metre", "metres"), [(16.0, 10), (17.95, 5), (0.4, 200)])
def test_the_scale_bar_is_as_long_as_it_says(pixels_per_metre: float, metres: int) -> None:
    picture = drawn(Readings(0.0, pixels_per_metre=pixels_per_metre))
    white = near(picture[600:, 900:], (255, 255, 255), 3)
    longest = max(np.ptp(np.flatnonzero(row)) + 1 if row.any() else 0 for row in white)
    assert longest == pytest.approx(metres * pixels_per_metre, abs=1)


def test_the_line_of_time_has_marks_of_incidents() -> None:
    picture = drawn(Readings(0.0, progress=0.5), marks=[(0.75, "collision")])
    line = picture[-2]
    assert near(line[:630], (255, 255, 255)).all()
    assert not near(line[650:950], (255, 255, 255)).any()
    assert np.flatnonzero(near(line, (255, 95, 95))).mean() == pytest.approx(960, abs=3)


def test_a_caption_that_is_too_wide_is_above_the_panels() -> None:
    def lowest(text: str) -> int:
        picture = drawn(replace(FULL, captions=(Caption("collision", text),)))[:700, 320:960]
        return int(np.flatnonzero((picture != GREY).any(axis=(1, 2))).max())

    assert lowest("Hero hits " + "a long wall, " * 12) < 545 < lowest("Hero hits a wall")


def test_captions_fade() -> None:
    def brightness(opacity: float) -> int:
        return int(drawn(Readings(0.0, captions=(Caption("collision", "Hit", opacity),)))[600:].max())

    assert brightness(1.0) == 255 > brightness(0.4) > GREY


@pytest.mark.parametrize("size", [(64, 64), (150, 90), (333, 517), (3840, 2160)])
def test_any_size_is_drawn_on(size: tuple[int, int]) -> None:
    picture = drawn(replace(FULL, name="n" * 200, time=1e7, speed=1e9), size, map_name="M" * 300)
    assert picture.shape == (size[1], size[0], 3)
