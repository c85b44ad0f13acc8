"""What is written on the pictures of a video: time, speed, controls, the light ahead, captions, and a scale."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.queries.kinds import KINDS
from carla_recap.scene.captions import caption_of
from carla_recap.scene.style import LIGHTS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from carla_recap.queries.incidents import Incident
    from carla_recap.show.video.encoding import Picture, Size

Rgba = tuple[int, int, int, int]
Rectangle = tuple[float, float, float, float]

_WHITE: Final[Rgba] = (255, 255, 255, 255)
_DIM: Final[Rgba] = (255, 255, 255, 170)
_TRACK: Final[Rgba] = (86, 90, 96, 200)  # opaque enough: shapes replace what is below them
_PANEL: Final[Rgba] = (14, 17, 22, 165)
_HOUSING: Final[Rgba] = (8, 9, 11, 255)
_UNLIT: Final[Rgba] = (62, 65, 70, 255)
_THROTTLE: Final[Rgba] = (70, 210, 110, 255)
_BRAKE: Final[Rgba] = (235, 64, 52, 255)
_STEER: Final[Rgba] = (120, 186, 255, 255)
_REFERENCE: Final = (1280, 720)  # the size in which the lengths below are given, in pixels
_GROWTH: Final = 0.75  # the exponent by which they grow with the size, so that small videos are still readable
_MARGIN: Final = 24
_RADIUS: Final = 12
_SMALLEST_TEXT: Final = 8
_SMALLEST: Final = 150  # pixels; less high or wide, a picture has nothing but the bar of its time
_SMOOTHING: Final = 4  # the factor by which round shapes are drawn larger
_SHADES: Final = 32  # of bars, per full length
_KMH: Final = 3.6  # in a m/s
_SCALES: Final = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000)  # m
_SCALE_WIDTH: Final = 0.14  # of the width of the picture, at most
_SHOWN: Final = 3.5  # s of the video for which a caption is shown, at least
_FADE: Final = 0.4  # s of the video, in which it fades
_PATIENCE: Final = 2.0  # s after which a long stop is mentioned
_NEAR: Final = 70.0  # m; incidents of others are mentioned if they are no farther away
_MOST: Final = 2  # captions at a time


class LightAhead(NamedTuple):
    """The traffic light ahead: its state, with CARLA's numbers, and its distance in m."""

    state: int
    distance: float


class Caption(NamedTuple):
    """The text about an incident, its kind, and its opacity from 0 to 1."""

    kind: str
    text: str
    opacity: float = 1.0


@dataclass(frozen=True)
class Readings:
    """What a picture shows in numbers."""

    time: float  # the elapsed seconds
    progress: float | None = None  # the part of the video that has passed, from 0 to 1; None: it is a single picture
    name: str = ""  # the name of the followed actor
    speed: float | None = None  # its speed in m/s, if known
    # throttle and brake from 0 to 1, steering from -1 (left) to 1, if recorded
    controls: tuple[float, float, float] | None = None
    light: LightAhead | None = None  # the traffic light ahead of it, if any
    captions: tuple[Caption, ...] = ()  # the incidents, the most important first
    pixels_per_metre: float | None = None  # the scale of a picture from above; None for other views
    # the pixels that the followed actor covers: left, top, right, bottom; None if it is not seen
    kept_free: Rectangle | None = None


class _Layer:
    """An image to be laid over pictures, as blue, green and red multiplied by alpha, and what remains of the picture."""

    def __init__(self, image: Any, opacity: float = 1.0) -> None:
        pixels = np.asarray(image, np.uint16)
        alpha = pixels[..., 3:] if opacity >= 1 else (pixels[..., 3:] * opacity).astype(np.uint16)
        self._colors = pixels[..., 2::-1] * alpha + 127
        self._rest = 255 - alpha
        self.height, self.width = pixels.shape[:2]

    def lay(self, picture: Picture, x: int, y: int) -> None:
        """Lay it over a picture with its upper left corner at a pixel; what is outside of the picture is left out."""
        left, top = max(x, 0), max(y, 0)
        part = picture[top : max(y + self.height, 0), left : max(x + self.width, 0), :3]
        rows, columns = slice(top - y, top - y + part.shape[0]), slice(left - x, left - x + part.shape[1])
        part[...] = (self._colors[rows, columns] + part * self._rest[rows, columns]) // 255


class _Room(NamedTuple):
    """What is free along an edge: from and up to a column of pixels; and the height of what covers its sides."""

    left: int
    right: int
    height: int


def _common(first: Rectangle, second: Rectangle | None) -> float:
    """Return the area that rectangles have in common."""
    if second is None:
        return 0.0
    sides = (min(first[axis + 2], second[axis + 2]) - max(first[axis], second[axis]) for axis in (0, 1))
    return math.prod(max(side, 0.0) for side in sides)


class Overlay:
    """Draws readings over the pictures of a video; marks are when its incidents happen, from 0 to 1, and their kinds."""

    def __init__(
        self, size: Size, *, map_name: str = "", speed: float = 1.0, marks: Sequence[tuple[float, str]] = ()
    ) -> None:
        self._width, self._height = size
        self._unit = min(side / whole for side, whole in zip(size, _REFERENCE, strict=True)) ** _GROWTH
        self._map_name = map_name
        self._speed = speed
        self._marks = marks
        self._layers: dict[str, tuple[object, _Layer]] = {}
        self._place: tuple[tuple[str, ...], int] = ((), -1)  # of the captions: their texts, and which of the places
        self._is_small = min(size) < _SMALLEST

    def draw(self, picture: Picture, readings: Readings) -> None:
        """Draw readings over a picture: blue, green, red, alpha, (height, width, 4)."""
        if readings.progress is not None:
            self._lay_progress(picture, readings.progress)
        if self._is_small:
            return
        margin = self._length(_MARGIN)
        right, bottom = self._width - margin, self._height - margin
        clock = self._kept("clock", round(readings.time, 1), lambda: self._clock(readings.time))
        clock.lay(picture, margin, margin)
        upper, lower = _Room(margin + clock.width, self._width, clock.height), _Room(0, self._width, 0)
        if readings.light is not None:
            state, distance = readings.light.state, round(readings.light.distance)
            layer = self._kept("light", (state, distance), lambda: self._light(state, distance))
            layer.lay(picture, right - layer.width, margin)
            upper = _Room(upper.left, right - layer.width, max(upper.height, layer.height))
        if readings.speed is not None or readings.controls is not None:
            key, speed, controls = _rounded(readings)
            layer = self._kept("panel", key, lambda: self._panel(readings.name, speed, controls))
            layer.lay(picture, margin, bottom - layer.height)
            lower = _Room(margin + layer.width, self._width, layer.height)
        if readings.pixels_per_metre is not None:
            metres, pixels = _scale(readings.pixels_per_metre, self._width)
            layer = self._kept("scale", (metres, pixels), lambda: self._scale_bar(metres, pixels))
            layer.lay(picture, right - layer.width, bottom - layer.height)
            lower = _Room(lower.left, right - layer.width, max(lower.height, layer.height))
        if readings.captions:
            self._lay_captions(picture, readings.captions, upper, lower, readings.kept_free)

    def _lay_captions(
        self, picture: Picture, captions: tuple[Caption, ...], upper: _Room, lower: _Room, kept_free: Rectangle | None
    ) -> None:
        """Lay captions over a picture, one above the other, where they do not hide the followed actor.

        They are in the lower middle, or beside or above what covers the lower corners, or the same at the upper edge.
        """
        gap, margin = self._length(8), self._length(_MARGIN)
        layers = [
            self._kept(f"caption {row}", caption, partial(self._caption, caption), caption.opacity)
            for row, caption in enumerate(captions)
        ]
        width, height = max(layer.width for layer in layers), sum(layer.height for layer in layers) + gap * (len(layers) - 1)
        places: list[tuple[float, int]] = []  # of the middle of their upper edge
        for room, edge, beyond in (
            (lower, self._height - margin - height, -lower.height - gap if lower.height else 0),
            (upper, margin, upper.height + gap),
        ):
            middles = self._width / 2, (room.left + room.right) / 2
            left, right = room.left + gap + width / 2, room.right - gap - width / 2
            places += [(middle, edge) for middle in middles if left <= middle <= right]
            places.append((self._width / 2, edge + beyond))
        hidden = [_common((x - width / 2, y, x + width / 2, y + height), kept_free) for x, y in places]
        texts = tuple(caption.text for caption in captions)
        place = self._place[1] if self._place[0] == texts else -1  # where they have been, which they leave only if they must
        if not 0 <= place < len(places) or hidden[place]:
            place = hidden.index(min(hidden))
        self._place = texts, place
        middle, y = places[place]
        for layer in layers:
            layer.lay(picture, round(middle - layer.width / 2), y)
            y += layer.height + gap

    def _kept(self, name: str, key: object, draw: Callable[[], Any], opacity: float = 1.0) -> _Layer:
        """Return a layer, which is drawn if it is not the latest of its name."""
        kept = self._layers.get(name)
        if kept is None or kept[0] != key:
            kept = self._layers[name] = key, _Layer(draw(), opacity)
        return kept[1]

    def _length(self, length: float) -> int:
        pixels: int = round(length * self._unit)
        return max(1, pixels)

    def _font(self, size: float) -> Any:
        return _font(max(_SMALLEST_TEXT, round(size * self._unit)))

    def _lay_progress(self, picture: Picture, progress: float) -> None:
        """Draw a line along the lower edge: the part of the video that has passed, with marks of its incidents."""
        height = self._length(5)
        line = picture[-height:, :, :3]
        line[...] = line * 0.55
        line[:, : round(progress * self._width)] = _WHITE[:3]
        half = self._length(2)
        for part, kind in self._marks:
            x = round(part * self._width)
            line[:, max(x - half, 0) : x + half] = _color(kind)[2::-1]

    def _clock(self, time: float) -> Any:
        font, small = self._font(30), self._font(15)
        text, pad = _clock_text(time), self._length(14)
        subtitle = self._map_name + (f"   {self._speed:g}x" if self._speed != 1 else "")
        width = max(_number_width(text, font), round(small.getlength(subtitle))) + 2 * pad
        height = self._length(68 if subtitle else 46)
        image, draw = _panel_image(width, height, self._length(_RADIUS))
        _draw_number(draw, (pad, self._length(34)), text, font, _WHITE)
        draw.text((pad, self._length(56)), subtitle, _DIM, small, anchor="ls")
        return image

    def _light(self, state: int, distance: int) -> Any:
        font = self._font(22)
        text, pad = f"{distance} m", self._length(12)
        lamp, gap = self._length(15), self._length(5)
        housing = (lamp + 2 * gap, 3 * lamp + 4 * gap)
        text_width = max(_number_width(text, font), _number_width("00 m", font))
        width, height = housing[0] + text_width + 3 * pad, housing[1] + 2 * self._length(9)
        image, draw = _panel_image(width, height, self._length(_RADIUS))
        lamps = _smooth_image(*housing, lambda draw, scale: _draw_lamps(draw, state, lamp * scale, gap * scale))
        image.alpha_composite(lamps, (pad, (height - housing[1]) // 2))
        _draw_number(draw, (2 * pad + housing[0], height // 2 + self._length(8)), text, font, _WHITE)
        return image

    def _panel(self, name: str, speed: int | None, controls: tuple[int, int, int] | None) -> Any:
        pad, width = self._length(16), self._length(268)
        head, row = self._length(92 if speed is not None else 40), self._length(21)
        height = head + (3 * row + self._length(10) if controls is not None else 0)
        image, draw = _panel_image(width, height, self._length(_RADIUS))
        small, label = self._font(15), self._font(13)
        draw.text((pad, self._length(27)), _fitting(name, small, width - 2 * pad), _DIM, small, anchor="ls")
        if speed is not None:
            baseline = self._length(76)
            end = _draw_number(draw, (pad, baseline), str(speed), self._font(50), _WHITE)
            draw.text((end + self._length(7), baseline), "km/h", _DIM, small, anchor="ls")
        if controls is None:
            return image
        left, thick = pad + self._length(72), self._length(7)
        length = width - pad - left
        bars = ("throttle", _THROTTLE), ("brake", _BRAKE), ("steer", _STEER)
        for index, ((text, color), value) in enumerate(zip(bars, controls, strict=True)):
            middle = head + index * row + row // 2 - self._length(1)
            draw.text((pad, middle), text, _DIM, label, anchor="lm")
            top, bottom = middle - thick // 2, middle - thick // 2 + thick - 1
            draw.rectangle((left, top, left + length, bottom), _TRACK)
            centre = left + length // 2 if text == "steer" else left
            reach = (length / 2 if text == "steer" else length) * value / _SHADES
            if value:
                left_edge, right_edge = sorted((centre, centre + round(reach)))
                draw.rectangle((left_edge, top, right_edge, bottom), color)
            if text == "steer":
                draw.rectangle((centre - 1, top - self._length(2), centre, bottom + self._length(2)), _DIM)
        return image

    def _caption(self, caption: Caption) -> Any:
        font, pad, dot = self._font(22), self._length(16), self._length(12)
        text = _fitting(caption.text, font, self._width - 2 * self._length(_MARGIN) - 3 * pad - dot)
        width, height = round(font.getlength(text)) + 3 * pad + dot, self._length(44)
        image, draw = _panel_image(width, height, self._length(_RADIUS))
        color = _color(caption.kind)
        spot = _smooth_image(dot, dot, lambda draw, scale: draw.ellipse((0, 0, dot * scale - 1, dot * scale - 1), color))
        image.alpha_composite(spot, (pad, (height - dot) // 2))
        draw.text((2 * pad + dot, height // 2 + self._length(8)), text, _WHITE, font, anchor="ls")
        return image

    def _scale_bar(self, metres: int, pixels: int) -> Any:
        font, pad, tick = self._font(15), self._length(12), self._length(7)
        text = f"{metres / 1000:g} km" if metres >= 1000 else f"{metres} m"
        width = max(pixels, round(font.getlength(text))) + 2 * pad
        height = self._length(44)
        image, draw = _panel_image(width, height, self._length(_RADIUS))
        draw.text((width // 2, self._length(20)), text, _WHITE, font, anchor="ms")
        left, thick, bottom = (width - pixels) // 2, self._length(2), self._length(33)
        draw.rectangle((left, bottom - thick, left + pixels - 1, bottom), _WHITE)
        for x in (left, left + pixels - thick):
            draw.rectangle((x, bottom - tick, x + thick - 1, bottom), _WHITE)
        return image


def _rounded(readings: Readings) -> tuple[object, int | None, tuple[int, int, int] | None]:
    """Return the readings of the panel as they are drawn: a key, the speed in km/h, and the bars in shades."""
    speed = None if readings.speed is None else min(round(readings.speed * _KMH), 999)
    controls = None
    if readings.controls is not None:
        throttle, brake, steer = (max(-1.0, min(1.0, value)) for value in readings.controls)
        controls = round(max(throttle, 0) * _SHADES), round(max(brake, 0) * _SHADES), round(steer * _SHADES)
    return (readings.name, speed, controls), speed, controls


def _scale(pixels_per_metre: float, width: int) -> tuple[int, int]:
    """Return a round length in m that is short enough for a bar, and its length in pixels."""
    fitting = [metres for metres in _SCALES if metres * pixels_per_metre <= _SCALE_WIDTH * width]
    metres = fitting[-1] if fitting else _SCALES[0]
    return metres, max(1, round(min(metres * pixels_per_metre, width)))


def _clock_text(time: float) -> str:
    minutes, seconds = divmod(round(time, 1), 60)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours}:{minutes:02}:{seconds:04.1f}" if hours else f"{minutes}:{seconds:04.1f}"


@cache
def _font(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size)


@cache
def _digit_width(font: Any) -> int:
    width: float = max(font.getlength(digit) for digit in "0123456789")
    return math.ceil(width)


def _number_width(text: str, font: Any) -> int:
    """Return the width of a text whose digits are all equally wide, so that it stands still while they change."""
    return sum(_digit_width(font) if char.isdigit() else math.ceil(font.getlength(char)) for char in text)


def _color(kind: str) -> Rgba:
    """Return the colour of a kind of incident."""
    red, green, blue = bytes.fromhex(KINDS[kind].dark.removeprefix("#"))
    return red, green, blue, 255


def _draw_number(draw: Any, start: tuple[int, int], text: str, font: Any, color: Rgba) -> int:
    """Draw a text whose digits are all equally wide, from a point on its baseline, and return where it ends."""
    x, y = start
    for char in text:
        width = _number_width(char, font)
        draw.text((x + (width - font.getlength(char)) / 2, y), char, color, font, anchor="ls")
        x += width
    return x


def _fitting(text: str, font: Any, width: int) -> str:
    """Return a text, shortened if it is wider than a number of pixels."""
    if font.getlength(text) <= width:
        return text
    while text and font.getlength(f"{text}...") > width:
        text = text[:-1]
    return f"{text.rstrip()}..." if text else ""


def _panel_image(width: int, height: int, radius: int) -> tuple[Any, Any]:
    """Return an image of a panel with round corners, and what draws on it."""
    from PIL import ImageDraw

    image = _panel_background(width, height, radius).copy()
    draw = ImageDraw.Draw(image)
    draw.fontmode = "L"
    return image, draw


@cache
def _panel_background(width: int, height: int, radius: int) -> Any:
    def shape(draw: Any, scale: int) -> None:
        draw.rounded_rectangle((0, 0, width * scale - 1, height * scale - 1), radius * scale, _PANEL)

    return _smooth_image(width, height, shape)


def _smooth_image(width: int, height: int, shape: Callable[[Any, int], None]) -> Any:
    """Return an image of a shape with smooth edges: it is drawn larger by a scale, and made smaller."""
    from PIL import Image, ImageDraw

    large = Image.new("RGBA", (width * _SMOOTHING, height * _SMOOTHING))
    shape(ImageDraw.Draw(large), _SMOOTHING)
    return large.resize((width, height), Image.Resampling.BOX)


def _draw_lamps(draw: Any, state: int, lamp: int, gap: int) -> None:
    draw.rounded_rectangle((0, 0, lamp + 2 * gap - 1, 3 * lamp + 4 * gap - 1), gap * 1.4, _HOUSING)
    for index in range(3):
        top = gap + index * (lamp + gap)
        color = (*LIGHTS[index][1], 255) if index == state else _UNLIT
        draw.ellipse((gap, top, gap + lamp - 1, top + lamp - 1), color)


class Captions:
    """The incidents that a video shows."""

    def __init__(
        self, incidents: Iterable[Incident], *, start: float, stop: float, speed: float = 1.0, followed: int | None = None
    ) -> None:
        self._start, self._stop = start, stop
        self._speed = speed
        self._followed = followed
        shown = [each for each in incidents if each.start <= stop + SAME_TIME and self._end(each) >= start]
        ranks = {kind: -rank for rank, kind in enumerate(KINDS)}
        shown.sort(key=lambda each: (self._concerns(each), ranks[each.kind], each.start), reverse=True)
        self._incidents = shown

    def marks(self) -> Iterator[tuple[float, str]]:
        """Yield the part of the video, from 0 to 1, at which each incident of the followed actor happens, and its kind."""
        length = self._stop - self._start
        for each in self._incidents:
            if length > 0 and self._start <= each.start <= self._stop and self._concerns(each):
                yield (each.start - self._start) / length, each.kind

    def at(self, time: float, is_near: Callable[[float, float], bool] | None = None) -> tuple[Caption, ...]:
        """Return the captions of a moment, the most important first: those of the followed actor before others."""
        found = []
        for each in self._incidents:
            begin, end = self._begin(each), self._end(each)
            if begin - SAME_TIME <= time <= end and (self._concerns(each) or is_near is None or is_near(each.x, each.y)):
                rest = (end - time) / self._speed
                opacity = min(1.0, (rest + 0.05) / _FADE)
                found.append(Caption(each.kind, caption_of(each), round(opacity, 1)))
        return tuple(found[:_MOST])

    def _concerns(self, incident: Incident) -> bool:
        return self._followed is None or self._followed in incident.actors

    def _begin(self, incident: Incident) -> float:
        return incident.start + (_PATIENCE if incident.kind == "blocked" else 0.0)

    def _end(self, incident: Incident) -> float:
        if incident.kind == "blocked" and self._followed in incident.actors:
            return incident.stop
        return max(self._begin(incident) + _SHOWN * self._speed, incident.stop if incident.kind == "hard braking" else 0.0)


def is_near(x: float, y: float) -> Callable[[float, float], bool]:
    """Return a function that returns whether a location is near another one; both are in m."""
    return lambda other_x, other_y: math.hypot(other_x - x, other_y - y) <= _NEAR
