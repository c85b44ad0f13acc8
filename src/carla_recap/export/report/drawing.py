"""A picture of an incident from above, as SVG."""

from __future__ import annotations

import html
import math
import re
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.export.report.base_map import ROAD_WIDTH, runs, thinned
from carla_recap.export.report.script import hexadecimal, shortened
from carla_recap.export.style import BACKGROUND, COLLISION, OTHER, box_of, color_of, label_of, light
from carla_recap.model.records import ActorKind
from carla_recap.queries.actors import BoundingBox

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from carla_recap.export.report.base_map import BaseMap, Lines
    from carla_recap.export.report.samples import SampledActor, SampledReplay
    from carla_recap.queries.incidents import Incident

    Floats = NDArray[np.float64]

WIDTH: Final = 640
HEIGHT: Final = 400
NARROWEST: Final = 38.0  # m from left to right, at least
WIDEST: Final = 400.0  # m, at most
_MARGIN: Final = 1.6  # times the extent of the actors involved
_NEAR: Final = 0.25  # m between points of a line

_ROAD: Final = "#262a34"
_LINE: Final = "#5b6272"
_STOP: Final = "#aab1c0"
_TEXT: Final = "#e9ecf3"
_CROSSING: Final = "#3a3f4c"
_UNDRAWN: Final = (ActorKind.SENSOR, ActorKind.TRAFFIC_LIGHT)
_UNPRINTABLE: Final = re.compile(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


def draw(incident: Incident, replay: SampledReplay, base_map: BaseMap, *, before: float, after: float) -> str:
    """Return a picture of the beginning of an incident, with the paths of the actors involved.

    Args:
        incident: The incident.
        replay: The poses of all actors.
        base_map: The lines below them.
        before: The seconds of the paths before the incident.
        after: The seconds of the paths after it.
    """
    return _Drawing(incident, replay, base_map, before, after).svg()


class _Drawing:
    """The parts of a picture; coordinates are metres from its middle, x to the right, y upwards."""

    def __init__(self, incident: Incident, replay: SampledReplay, base_map: BaseMap, before: float, after: float) -> None:
        self._incident = incident
        self._replay = replay
        self._base_map = base_map
        self._time = incident.start
        self._span = (incident.start - before, incident.start + after)
        self._poses = replay.poses(self._time)
        self._involved = [actor for actor in self._poses if replay.actors[actor].id in incident.actors]
        points = np.array([(incident.x, incident.y), *(self._poses[actor][:2] for actor in self._involved)])
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            points = np.zeros((1, 2))
        low, high = points.min(axis=0), points.max(axis=0)
        self._middle = (low + high) / 2
        across = max(high[0] - low[0], (high[1] - low[1]) * WIDTH / HEIGHT) * _MARGIN
        self._width = min(max(NARROWEST, across), WIDEST)
        self._height = self._width * HEIGHT / WIDTH
        self._scale = WIDTH / self._width

    def svg(self) -> str:
        head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}">'
        title = f"<title>{_escape(self._incident.text)}</title>"
        background = f'<rect width="{WIDTH}" height="{HEIGHT}" fill="{hexadecimal(BACKGROUND)}"/>'
        world = f'<g transform="translate({WIDTH / 2:g} {HEIGHT / 2:g}) scale({self._scale:.4f} {-self._scale:.4f})">'
        parts = (
            head,
            title,
            background,
            world,
            *self._roads(),
            *self._trails(),
            *self._boxes(),
            *self._lights(),
            *self._mark(),
            "</g>",
            *self._labels(),
            *self._scale_bar(),
            "</svg>",
        )
        return "\n".join(parts) + "\n"

    def _roads(self) -> Iterator[str]:
        base_map = self._base_map
        yield self._layer(base_map.lanes, f'stroke="{_ROAD}" stroke-width="{base_map.width}" stroke-linecap="round"')
        yield self._layer(base_map.junctions, fill=_ROAD)
        yield self._layer(base_map.crossings, fill=_CROSSING)
        yield self._layer(base_map.borders, f'stroke="{_LINE}" stroke-width="0.13"')
        yield self._layer(base_map.stops, f'stroke="{_STOP}" stroke-width="0.35"')

    def _trails(self) -> Iterator[str]:
        for actor in self._involved:
            stroke = f'stroke="{_color(self._replay.actors[actor])}" stroke-width="0.4" stroke-linecap="round"'
            start, stop = self._span
            yield self._lines(
                self._replay.paths(actor, self._time, stop), stroke + ' opacity="0.45" stroke-dasharray="0.1 1"'
            )
            yield self._lines(self._replay.paths(actor, start, self._time), stroke + ' opacity="0.9"')

    def _boxes(self) -> Iterator[str]:
        def rank(actor: int) -> tuple[bool, int]:
            details = self._replay.actors[actor].details
            return actor in self._involved, details.kind in (ActorKind.VEHICLE, ActorKind.WALKER) if details else 0

        for actor in sorted(self._poses, key=rank):
            x, y, yaw = self._poses[actor]
            x, y = x - self._middle[0], y - self._middle[1]
            details = self._replay.actors[actor].details
            is_near = max(abs(x) - self._width / 2, abs(y) - self._height / 2) < 10
            if is_near and not (details and details.kind in _UNDRAWN):
                yield self._box(self._replay.actors[actor], x, y, yaw, involved=actor in self._involved)

    def _box(self, actor: SampledActor, x: float, y: float, yaw: float, *, involved: bool) -> str:
        box = BoundingBox(0, 0, 0, *OTHER.extent) if actor.details is None else box_of(actor.details)
        length, width = 2 * box.extent_x, 2 * box.extent_y
        corner = min(length, width) * 0.2
        shape = f'x="{box.x - box.extent_x:.2f}" y="{box.y - box.extent_y:.2f}" width="{length:.2f}" height="{width:.2f}"'
        border = f' stroke="{_TEXT}" stroke-width="0.16"' if involved else ""
        drawn = f'<rect {shape} rx="{corner:.2f}"{border}/>'
        if actor.details is not None and actor.details.kind == ActorKind.VEHICLE:
            glass = box.x + 0.35 * box.extent_x, box.y - 0.8 * box.extent_y
            size = 0.3 * box.extent_x, 1.6 * box.extent_y
            drawn += f'<rect x="{glass[0]:.2f}" y="{glass[1]:.2f}" width="{size[0]:.2f}" height="{size[1]:.2f}" '
            drawn += f'rx="0.15" fill="{hexadecimal(BACKGROUND)}" opacity="0.6"/>'
        shade = "" if involved else ' opacity="0.7"'
        transform = f"translate({x:.2f} {y:.2f}) rotate({yaw:.1f})"
        return f'<g transform="{transform}" fill="{_color(actor)}"{shade}>{drawn}</g>'

    def _lights(self) -> Iterator[str]:
        for actor, state in self._replay.light_states(self._time).items():
            if actor not in self._poses:
                continue
            x, y = self._poses[actor][:2] - self._middle
            if max(abs(x) - self._width / 2, abs(y) - self._height / 2) < 1:
                color = hexadecimal(light(state)[1])
                yield f'<circle cx="{x:.2f}" cy="{y:.2f}" r="1.5" fill="{color}" opacity="0.25"/>'
                yield f'<circle cx="{x:.2f}" cy="{y:.2f}" r="0.7" fill="{color}"/>'

    def _mark(self) -> Iterator[str]:
        if self._incident.kind == "collision" and math.isfinite(self._incident.x + self._incident.y):
            x, y = np.array((self._incident.x, self._incident.y)) - self._middle
            color = hexadecimal(COLLISION)
            yield f'<circle cx="{x:.2f}" cy="{y:.2f}" r="3.4" fill="{color}" opacity="0.16"/>'
            yield f'<circle cx="{x:.2f}" cy="{y:.2f}" r="3.4" fill="none" stroke="{color}" stroke-width="0.3"/>'
            yield f'<path d="M{x - 0.8:.2f} {y - 0.8:.2f}l1.6 1.6m0 -1.6l-1.6 1.6" stroke="{color}" stroke-width="0.4"/>'

    def _labels(self) -> Iterator[str]:
        style = f'font-family="system-ui,sans-serif" font-size="21" font-weight="600" fill="{_TEXT}" text-anchor="middle"'
        halo = f'stroke="{hexadecimal(BACKGROUND)}" stroke-width="5" stroke-linejoin="round" paint-order="stroke"'
        above = sorted(self._involved, key=lambda actor: float(-self._poses[actor][1]))
        for index, actor in enumerate(above):
            details = self._replay.actors[actor].details
            right, up = (self._poses[actor][:2] - self._middle) * self._scale
            x, y = WIDTH / 2 + right, HEIGHT / 2 - up
            # The upper one is named above, the lower one below, so that names of neighbours stay apart.
            y += -4.2 * self._scale if index == 0 else 4.2 * self._scale + 16
            name = label_of(details) if details else f"actor {self._replay.actors[actor].id}"
            x, y = min(max(x, 110), WIDTH - 110), min(max(y, 24), HEIGHT - 12)
            yield f'<text x="{x:.0f}" y="{y:.0f}" {style} {halo}>{_escape(name)}</text>'

    def _scale_bar(self) -> Iterator[str]:
        """Yield a scale bar of 10 m or 100 m."""
        metres = 10 if self._width < 150 else 100
        right, low, width = WIDTH - 16, HEIGHT - 20, metres * self._scale
        yield f'<path d="M{right - width:.1f} {low}v6h{width:.1f}v-6" fill="none" stroke="{_STOP}" stroke-width="1.5"/>'
        text = f'font-family="system-ui,sans-serif" font-size="15" fill="{_STOP}" text-anchor="end"'
        yield f'<text x="{right}" y="{low - 6}" {text}>{metres} m</text>'

    def _layer(self, lines: Lines, style: str = "", fill: str = "none") -> str:
        reach = np.array((self._width, self._height)) / 2 + ROAD_WIDTH
        return self._lines(lines.within(self._middle - reach, self._middle + reach), style, fill)

    def _lines(self, lines: Iterable[Floats], style: str = "", fill: str = "none") -> str:
        """Return the visible parts of lines as one SVG path; filled lines are closed."""
        pieces: list[Floats] = []
        for line in lines:
            centred = line - self._middle
            pieces += [centred] if fill != "none" else self._visible(centred)
        close = "" if fill == "none" else "z"
        data = "".join("M" + "L".join(f"{x:.2f} {y:.2f}" for x, y in piece.tolist()) + close for piece in pieces)
        return f'<path d="{data}" fill="{fill}" stroke-linejoin="round" {style}/>' if data else ""

    def _visible(self, line: Floats) -> Iterator[Floats]:
        thin = thinned(line, _NEAR)
        reach = np.array((self._width, self._height)) / 2 + ROAD_WIDTH
        least, most = np.minimum(thin[:-1], thin[1:]), np.maximum(thin[:-1], thin[1:])
        crosses = ((least < reach) & (most > -reach)).all(axis=1)  # even with both ends far away
        return runs(thin, np.append(crosses, False))


def _color(actor: SampledActor) -> str:
    return hexadecimal(OTHER.color if actor.details is None else color_of(actor.details))


def _escape(text: str) -> str:
    return html.escape(_UNPRINTABLE.sub("?", shortened(text)))
