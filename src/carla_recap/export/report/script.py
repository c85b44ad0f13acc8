"""The data of the incident page as scripts, which load from the disk, too: JSON, with arrays of numbers in base64."""

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

    from carla_recap.export.report.base_map import BaseMap
    from carla_recap.export.report.samples import SampledActor, SampledReplay
    from carla_recap.export.style import Color

LONGEST: Final = 120  # characters of a name
_TURN: Final = 65536 / 360  # units of a yaw per degree


def script(name: str, value: Any) -> str:
    """Return a script that assigns a value to a global name.

    Args:
        name: The name.
        value: A value of JSON's types, without NaN or infinity.
    """
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    # "<" could end the script, if it is put into a page.
    return f"var {name}={text};\n".replace("<", "\\u003c")


def number(value: float, digits: int = 3) -> float | None:
    """Return a rounded number; None for NaN and infinity, which JSON does not have."""
    return round(value, digits) if math.isfinite(value) else None


def shortened(text: str) -> str:
    """Return a name, cut to `LONGEST` characters."""
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"


def hexadecimal(color: Color) -> str:
    """Return a colour in the notation of style sheets."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def actor_data(sampled: SampledActor) -> dict[str, Any]:
    """Return an actor; `box` is x, y and half extents in m, in its own axes."""
    actor = sampled.details
    box = BoundingBox(0, 0, 0, *OTHER.extent) if actor is None else box_of(actor)
    return {
        "id": sampled.id,
        "kind": OTHER.name if actor is None else style_of(actor).name,
        "type": "" if actor is None else shortened(actor.type_id),
        "role": "" if actor is None else shortened(actor.role_name),
        "label": f"actor {sampled.id}" if actor is None else shortened(label_of(actor)),
        "hero": actor is not None and actor.is_hero,
        "color": hexadecimal(OTHER.color if actor is None else color_of(actor)),
        "box": [number(size) or 0 for size in (box.x, box.y, box.extent_x, box.extent_y)],
        "since": number(sampled.since),
        "until": None if sampled.until is None else number(sampled.until),
    }


def recording_data(replay: SampledReplay) -> dict[str, Any]:
    """Return the samples as columns.

    `tracks` has a row of five numbers for each track: the actor, the first and the last sample, the index of its first row
    in `x`, `y` and `yaw`, and the number of its rows: one for each sample, or a single one.
    """
    table, rows, begin = [], [], 0
    for track in replay.tracks:
        table.append((track.actor, track.first, track.last, begin, len(track.rows)))
        rows.append(track.rows)
        begin += len(track.rows)
    x, y, yaw = np.concatenate(rows).T if rows else np.zeros((3, 0))
    return {
        "times": column(replay.times, "<f8"),
        "spans": [[number(start, 6), number(stop, 6)] for start, stop in replay.spans],
        "actors": [actor_data(actor) for actor in replay.actors],
        "tracks": column(table, "<u4"),
        "x": column(x, "<f4"),
        "y": column(y, "<f4"),
        "yaw": column(np.rint(yaw % 360 * _TURN).astype(np.int64) & 0xFFFF, "<u2"),
        "lights": {
            "actor": column([actor for actor, _, _ in replay.lights], "<u4"),
            "time": column([time for _, time, _ in replay.lights], "<f8"),
            "state": column([state & 0xFF for _, _, state in replay.lights], "u1"),
        },
    }


def base_map_data(base_map: BaseMap) -> dict[str, Any]:
    """Return the lines of a base map: the points of each layer, and the number of points of each line."""
    names = ("lanes", "junctions", "crossings", "borders", "stops")
    return {"width": base_map.width, **{name: _layer(getattr(base_map, name).lines) for name in names}}


def _layer(lines: Sequence[NDArray[np.float64]]) -> dict[str, str]:
    points = np.concatenate(lines) if lines else np.zeros((0, 2))
    return {"points": column(points, "<f4"), "lengths": column([len(line) for line in lines], "<u4")}


def column(values: ArrayLike, code: str) -> str:
    """Return numbers in base64, with the numpy type of a code."""
    return base64.b64encode(np.asarray(values).astype(code).tobytes()).decode()
