"""Data as scripts, which a page may load from the disk too: plain JSON, arrays of numbers in base64."""

from __future__ import annotations

import base64
import json
import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.export.style import OTHER, box_of, color_of, label_of, style_of
from carla_recap.queries.actors import BoundingBox

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from carla_recap.export.report.ground import Ground
    from carla_recap.export.report.tracks import Life, Tracks
    from carla_recap.export.style import Color

LONGEST: Final = 120  # characters of a name
_TURN: Final = 65536 / 360  # units of a yaw per degree


def script(name: str, value: Any) -> str:
    """A script that gives a value to a global name.

    Args:
        name: The name.
        value: Anything that JSON knows; a number that is none becomes null.
    """
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    # JSON in ASCII is a script, unless it ends one where somebody puts it into a page.
    return f"var {name}={text};\n".replace("<", "\\u003c")


def number(value: float, digits: int = 3) -> float | None:
    """A number that JSON can hold; None for what is not one."""
    return round(value, digits) if math.isfinite(value) else None


def shortened(text: str) -> str:
    """A name of a bearable length."""
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"


def hexadecimal(color: Color) -> str:
    """A colour as style sheets have it."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def life(life: Life) -> dict[str, Any]:
    """An actor, as the page knows it: the box is x, y and half extents in m, in its own axes."""
    actor = life.actor
    box = BoundingBox(0, 0, 0, *OTHER.extent) if actor is None else box_of(actor)
    return {
        "id": life.id,
        "kind": OTHER.name if actor is None else style_of(actor).name,
        "type": "" if actor is None else shortened(actor.type_id),
        "role": "" if actor is None else shortened(actor.role_name),
        "label": f"actor {life.id}" if actor is None else shortened(label_of(actor)),
        "hero": actor is not None and actor.is_hero,
        "color": hexadecimal(OTHER.color if actor is None else color_of(actor)),
        "box": [number(size) or 0 for size in (box.x, box.y, box.extent_x, box.extent_y)],
        "since": number(life.since),
        "until": None if life.until is None else number(life.until),
    }


def recording(tracks: Tracks) -> dict[str, Any]:
    """All ways, as columns.

    `tracks` has a row of five numbers for each stretch: the actor, the first and the last sample, where its rows begin in
    `x`, `y` and `yaw`, and how many they are: one for each sample, or a single one.
    """
    table, rows, begin = [], [], 0
    for track in tracks.tracks:
        table.append((track.life, track.first, track.last, begin, len(track.rows)))
        rows.append(track.rows)
        begin += len(track.rows)
    x, y, yaw = np.concatenate(rows).T if rows else np.zeros((3, 0))
    return {
        "times": column(tracks.times, "<f8"),
        "spans": [[number(start, 6), number(stop, 6)] for start, stop in tracks.spans],
        "actors": [life(one) for one in tracks.lives],
        "tracks": column(table, "<u4"),
        "x": column(x, "<f4"),
        "y": column(y, "<f4"),
        "yaw": column(np.rint(yaw % 360 * _TURN).astype(np.int64) & 0xFFFF, "<u2"),
        "lights": {
            "actor": column([life for life, _, _ in tracks.lights], "<u4"),
            "time": column([time for _, time, _ in tracks.lights], "<f8"),
            "state": column([state & 0xFF for _, _, state in tracks.lights], "u1"),
        },
    }


def layers(ground: Ground) -> dict[str, Any]:
    """The lines of the ground: of each layer all points, and how many each line has."""
    names = ("lanes", "junctions", "crossings", "borders", "stops")
    return {"width": ground.width, **{name: _layer(getattr(ground, name).lines) for name in names}}


def _layer(lines: Sequence[NDArray[np.float64]]) -> dict[str, str]:
    points = np.concatenate(lines) if lines else np.zeros((0, 2))
    return {"points": column(points, "<f4"), "lengths": column([len(line) for line in lines], "<u4")}


def column(values: ArrayLike, code: str) -> str:
    """Numbers in base64, as a numpy type code has them."""
    return base64.b64encode(np.asarray(values).astype(code).tobytes()).decode()
