"""The data of the incident page as scripts and columns, which load from the disk, too; and the page as one file."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
import struct
import zlib
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.queries.kinds import KINDS
from carla_recap.scene.appearance import recorded_color
from carla_recap.scene.materials import Tag
from carla_recap.scene.style import color_of, label_of, style_of
from carla_recap.show.page.base_map import LAYERS, PATH_WIDTH

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from carla_recap.scene.appearance import Look
    from carla_recap.scene.materials import Color
    from carla_recap.show.page.base_map import BaseMap
    from carla_recap.show.page.images import PageImages
    from carla_recap.show.page.samples import Change, MeasuredActor, SampledActor, SampledReplay

LEVEL: Final = 6  # of compression
_LARGEST: Final = 2.0**30  # units; larger columns get a larger unit
LONGEST: Final = 120  # characters of a name
LENGTH_UNIT: Final = 0.002  # m
TIME_UNIT: Final = 1e-5  # s
MAP_UNIT: Final = 0.02  # m
SPEED_UNIT: Final = 0.01  # m/s
MEASURED_UNITS: Final = {
    "acceleration": 0.02,
    "gap": 0.05,
    "ttc": 0.05,
    "throttle": 0.01,
    "brake": 0.01,
    "steer": 0.01,
    "light": 1.0,
    "distance": 0.5,
}
"""The precision of what is plotted, in the units of `MeasuredActor`."""
_MOST: Final = 100.0  # of a value that is plotted, without its sign
_UNKNOWN: Final = -128.0
_TURN: Final = 16384 / 360  # units of a yaw per degree
_LONG: Final = 2.65  # m, half the length from which a vehicle is drawn as a truck
_CYCLES: Final = (Tag.MOTORCYCLE, Tag.BICYCLE, Tag.RIDER)
_STYLE: Final = re.compile(r'<link rel="stylesheet" href="([^"]+)">\n')
_SCRIPT: Final = re.compile(r'<script src="([^"]+)" defer></script>\n')
_POLICY: Final = re.compile(r'content="default-src [^"]*"')


class Packer:
    """Collects columns; `pack` returns them with a value of JSON's types that refers to them.

    The text is base64 of a zlib stream: the length of the JSON as uint32, the JSON, the bytes of the columns. In the JSON, a
    column is an object with the key "column": the offset of its bytes, the number of its values, the number of bytes of
    each, its unit, and the number of times that differences were taken. The values are multiples of the unit, differences
    from the one before, zigzag-encoded, and stored as planes: the lowest bytes of all values, then the next ones.
    """

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0

    def column(self, values: ArrayLike, unit: float = 1.0, *, order: int = 1) -> dict[str, list[float]]:
        """Add a column of finite numbers, and return the reference to it.

        The unit is the precision; numbers of more than a thousand million units get a larger one. Differences are taken
        0 times of numbers that do not continue each other, once of those that do, twice of those that change steadily.
        """
        numbers = np.asarray(values, np.float64)
        unit = max(unit, float(np.abs(numbers).max(initial=0.0)) / _LARGEST)
        whole = np.rint(numbers / unit).astype(np.int64)
        for _ in range(order):
            whole = np.diff(whole, prepend=np.int64(0))
        wrapped = whole.astype(np.int32)  # the reader's sums wrap as well
        zigzag = ((wrapped << 1) ^ (wrapped >> 31)).astype("<u4")
        planes = max(1, (int(zigzag.max(initial=0)).bit_length() + 7) // 8)
        self._add(zigzag.view(np.uint8).reshape(-1, 4).T[:planes].tobytes())
        return {"column": [self._size - planes * len(zigzag), len(zigzag), planes, unit, order]}

    def _add(self, part: bytes) -> None:
        self._parts.append(part)
        self._size += len(part)

    def pack(self, value: Any) -> str:
        """Return a value of JSON's types, without NaN or infinity, with the columns, as text."""
        head = json.dumps(value, separators=(",", ":"), allow_nan=False).encode()
        content = b"".join((struct.pack("<I", len(head)), head, *self._parts))
        return base64.b64encode(zlib.compress(content, LEVEL)).decode()


def script(name: str, value: Any) -> str:
    """Return a script that assigns a value to a global name.

    The value is of JSON's types, without NaN or infinity.
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


_ICONS: Final = {
    "collision": "M4.5 4.5l7 7m0-7l-7 7",
    "red light": "M5.5 2.5h5v11h-5zM8 5.2v.1M8 8v.1M8 10.8v.1",
    "wrong way": "M13 8H3.5M7 4.5L3.5 8 7 11.5",
    "off road": "M5 13.5V9c0-2 1-3 3-3h4M9.5 3.5L12 6 9.5 8.5",
    "stop sign": "M6 3h4l3 3v4l-3 3H6l-3-3V6z",
    "near miss": "M3.5 3.5l3 3M12.5 12.5l-3-3M12.5 3.5l-3 3M3.5 12.5l3-3",
    "hard braking": "M4 4l4 4 4-4M4 8.5l4 4 4-4",
    "speeding": "M3 11.5a5.2 5.2 0 0 1 10 0M8 11.5l3-4",
    "blocked": "M5.5 4v8M10.5 4v8",
}
"""The icons of kinds of incidents by name: paths in a square of 16 units."""
_OTHER_ICON: Final = "M8 4v5M8 11.5v.1"


def kind_data() -> dict[str, Any]:
    """Return what the page shows of each kind of incident, by name, the most important first."""
    return {
        kind.name: {
            "name": kind.singular[:1].upper() + kind.singular[1:],
            "many": kind.plural[:1].upper() + kind.plural[1:],
            "icon": _ICONS.get(kind.name, _OTHER_ICON),
            "dark": kind.dark,
            "light": kind.light,
        }
        for kind in KINDS.values()
    }


def actor_data(sampled: SampledActor) -> dict[str, Any]:
    """Return an actor; `box` is x, y and half extents in m, in its own axes."""
    actor, look = sampled.actor, sampled.look
    (x, y, _), (length, width, _) = look.center, look.half_extents
    paint = recorded_color(actor.attributes) if actor.kind == "vehicle" else None
    return {
        "id": actor.id,
        "kind": style_of(actor).name,
        "type": shortened(actor.type_id),
        "role": shortened(actor.role_name),
        "label": shortened(label_of(actor)),
        "hero": actor.is_hero,
        "color": hexadecimal(color_of(actor)),
        "paint": None if paint is None else hexadecimal(paint),
        "shape": _shape(look),
        "box": [number(size) or 0 for size in (x, y, length, width)],
        "since": number(actor.spawned_at),
        "until": None if sampled.until is None else number(sampled.until),
    }


def _shape(look: Look) -> str:
    """Return the outline to draw: car, truck, cycle, walker or box."""
    if look.tag == Tag.PEDESTRIANS:
        return "walker"
    if look.tag in _CYCLES:
        return "cycle"
    if look.tag in (Tag.TRUCK, Tag.BUS) or (look.tag == Tag.CAR and look.half_extents[0] > _LONG):
        return "truck"
    return "car" if look.tag == Tag.CAR else "box"


def recording_data(replay: SampledReplay, measured: Iterable[MeasuredActor], packer: Packer) -> dict[str, Any]:
    """Return the samples and what is plotted of some actors, with columns for the numbers.

    `tracks` has five columns, with a row for each track: the actor, the first and the last sample, the index of its first
    row in `x`, `y`, `yaw` and `speed`, and the number of its rows: one for each sample, or a single one. A yaw of 16384 is
    a full turn; a speed is in m/s, or -1 if it is unknown.
    """
    table, rows, begin = [], [], 0
    for track in replay.tracks:
        table.append((track.actor, track.first, track.last, begin, len(track.rows)))
        speeds = np.nan_to_num(track.rows[:, 3], nan=-1.0, posinf=-1.0)
        turned = np.column_stack((track.rows[:, :2], np.unwrap(track.rows[:, 2] % 360, period=360), speeds))
        rows.append(turned)
        begin += len(track.rows)
    x, y, yaw, speed = np.concatenate(rows).T if rows else np.zeros((4, 0))
    columns = np.array(table, np.float64).reshape(-1, 5).T
    return {
        "times": packer.column(replay.times, TIME_UNIT, order=2),
        "spans": [[number(start, 6), number(stop, 6)] for start, stop in replay.spans],
        "actors": [actor_data(actor) for actor in replay.actors],
        "tracks": [packer.column(each) for each in columns],
        "x": packer.column(x, LENGTH_UNIT, order=2),
        "y": packer.column(y, LENGTH_UNIT, order=2),
        "yaw": packer.column(np.rint(yaw * _TURN), order=2),
        "speed": packer.column(speed, SPEED_UNIT),
        "measured": [measured_data(each, packer) for each in measured],
        "lights": _changes(replay.lights, packer),
        "lying": _changes(replay.lying, packer),
        "lamps": _changes(replay.lamps, packer),
        "marks": [[number(time, 5), places.round(2).tolist()] for time, places in replay.marks],
    }


def _changes(changes: Sequence[Change], packer: Packer) -> dict[str, Any]:
    actors, times, values = np.array(changes, np.float64).reshape(-1, 3).T
    return {
        "actor": packer.column(actors),
        "time": packer.column(times, TIME_UNIT),
        "value": packer.column(values, order=0),
    }


def measured_data(measured: MeasuredActor, packer: Packer) -> dict[str, Any]:
    """Return what is plotted of an actor at each sample, beside its speed; what is never known is left out.

    Values are from -100 to 100, and -128 where they are unknown.
    """
    found: dict[str, Any] = {"id": measured.id, "leader": packer.column(measured.leader)}
    for name, values in measured.values.items():
        if (known := np.isfinite(values)).any():
            found[name] = packer.column(np.where(known, np.clip(values, -_MOST, _MOST), _UNKNOWN), MEASURED_UNITS[name])
    return found


def base_map_data(base_map: BaseMap, packer: Packer) -> dict[str, Any]:
    """Return a base map: the lines of its surfaces and paths, and for each group of outlines, its layer and its size."""
    rings = [ring for group in base_map.surfaces for ring in group.rings]
    names = list(LAYERS)
    return {
        "width": PATH_WIDTH,
        "paths": _lines(base_map.paths, packer),
        "layers": names,
        "layer": packer.column([names.index(group.layer) for group in base_map.surfaces]),
        "rings": packer.column([len(group.rings) for group in base_map.surfaces]),
        "surfaces": _lines(rings, packer),
    }


def _lines(lines: Sequence[NDArray[np.float64]], packer: Packer) -> dict[str, Any]:
    """Return lines: x and y of all points, and the number of points of each line."""
    x, y = np.concatenate(lines).T if lines else np.zeros((2, 0))
    return {
        "x": packer.column(x, MAP_UNIT),
        "y": packer.column(y, MAP_UNIT),
        "lengths": packer.column([len(line) for line in lines]),
    }


def image_data(images: PageImages) -> dict[str, Any]:
    """Return the images of a camera, as base64."""
    return {
        "camera": shortened(images.camera),
        "size": images.size,
        "longest": number(images.longest),
        "times": [number(time) for time in images.times],
        "images": [base64.b64encode(image).decode() for image in images.images],
    }


def single_page(folder: Path, data: Mapping[str, str]) -> str:
    """Return the page of a folder as one document, which loads nothing and runs nothing but its own scripts.

    `data` has the texts of the scripts that are not in the folder, by address.
    """
    page = (folder / "index.html").read_text("utf-8")
    styles = "\n".join((folder / name).read_text("utf-8") for name in _STYLE.findall(page))
    names = _SCRIPT.findall(page)
    scripts = [data[name] if name in data else (folder / name).read_text("utf-8") for name in names]
    scripts = [text for text in scripts if "</script" not in text.lower() and "<!--" not in text]
    assert len(scripts) == len(names), "a script would end early"
    policy = (
        f"default-src 'none'; script-src {' '.join(map(hash_source, scripts))}; style-src {hash_source(styles)}; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
    page = _SCRIPT.sub("", _STYLE.sub("", page))
    page = _POLICY.sub(lambda _: f'content="{policy}"', page)
    page = page.replace("</head>", f"<style>{styles}</style>\n</head>")
    return page.replace("</body>", "".join(f"<script>{text}</script>\n" for text in scripts) + "</body>")


def data_address(content: bytes, kind: str) -> str:
    """Return the address that contains a file."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def hash_source(text: str) -> str:
    """Return the source expression of a content security policy that permits a text."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
