"""Recordings of tracks from elsewhere: CSV files with a row for each object at each time."""

from __future__ import annotations

import csv
import math
from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np

from carla_recap.editing.author import create_recording
from carla_recap.editing.convert import check_destination, check_new
from carla_recap.errors import RecapError
from carla_recap.model.records import CM, ActorKind, Spawn, attributes

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

    from carla_recap.model.frame import Extent

    Floats = NDArray[np.float64]
    Indices = NDArray[np.intp]

TimeUnit = Literal["s", "ms", "us", "ns"]
LengthUnit = Literal["m", "cm"]
AngleUnit = Literal["deg", "rad"]
TrackAxes = Literal["right-handed", "carla"]

ALIASES: Final[Mapping[str, tuple[str, ...]]] = {
    "time": ("time", "t", "timestamp", "elapsed", "total_nanos"),
    "id": ("id", "idx", "track_id", "trackid", "actor_id", "agent_id", "object_id"),
    "kind": ("kind", "class", "type", "agent_type", "object_type"),
    "type_id": ("type_id", "blueprint"),
    "role_name": ("role_name",),
    "x": ("x", "pos_x", "xcenter", "x_center"),
    "y": ("y", "pos_y", "ycenter", "y_center"),
    "z": ("z", "pos_z"),
    "roll": ("roll",),
    "pitch": ("pitch",),
    "yaw": ("yaw", "heading", "psi_rad"),
    "vx": ("vx", "vel_x", "xvelocity", "v_x"),
    "vy": ("vy", "vel_y", "yvelocity", "v_y"),
    "vz": ("vz", "vel_z", "v_z"),
    "length": ("length",),
    "width": ("width",),
    "height": ("height",),
    "box_x": ("box_x",),
    "box_y": ("box_y",),
    "box_z": ("box_z",),
}
"""The columns, and the names by which each is found; upper and lower case are the same."""
REQUIRED: Final = ("time", "id", "x", "y")
KINDS: Final[Mapping[str, str]] = {
    "vehicle": "vehicle.tesla.model3",
    "car": "vehicle.tesla.model3",
    "van": "vehicle.mercedes.sprinter",
    "truck": "vehicle.carlamotors.carlacola",
    "truck_bus": "vehicle.carlamotors.carlacola",
    "bus": "vehicle.mitsubishi.fusorosa",
    "motorcycle": "vehicle.kawasaki.ninja",
    "bicycle": "vehicle.diamondback.century",
    "walker": "walker.pedestrian.0001",
    "pedestrian": "walker.pedestrian.0001",
    "2": "vehicle.tesla.model3",  # as ASAM OSI numbers moving objects
    "3": "walker.pedestrian.0001",
}
"""The blueprint of each kind; others become props."""

_SEPARATORS: Final = ",;\t"
_LONGEST_LINE: Final = 1 << 16  # characters of the names that are looked at for the separator
_TEXT: Final = ("id", "kind", "type_id", "role_name")
_PER_SECOND: Final[Mapping[str, float]] = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
_PROP: Final = "static.prop.box01"
_DAY: Final = 86_400.0  # s; a recording whose times begin later, or before 0, begins at 0
_ROWS: Final = 50_000_000  # that are read at most
_LONGEST: Final = 1_000  # characters of an id, a kind, a blueprint or a role
_LARGEST: Final = 1e12  # of the unit of a column; a recording has floats of 32 bits
_LATEST: Final = 1e21  # s, ms, us or ns
_STANDSTILL: Final = 0.02  # m; a shorter step has no direction
_HEIGHT: Final = 1.5  # m; of a box whose height is not given
_IDS: Final = 1 << 31  # ids from here on are replaced


@dataclass
class _Columns:
    """The columns of a file that are used: numbers, (rows,), and texts by number."""

    numbers: dict[str, Floats] = field(default_factory=dict)
    texts: dict[str, list[str]] = field(default_factory=dict)


@dataclass
class _Track:
    """One object: the rows that it has, ascending by time, and its spawn."""

    rows: Indices
    spawn: Spawn
    box: tuple[float, ...] | None


def import_tracks(
    source: Path | str,
    destination: Path | str,
    *,
    map_name: str = "",
    columns: Mapping[str, str] | None = None,
    time_unit: TimeUnit | None = None,
    length_unit: LengthUnit = "m",
    angle_unit: AngleUnit = "deg",
    axes: TrackAxes = "right-handed",
    hero: str | None = None,
    force: bool = False,
) -> Extent:
    """Write a recording of the tracks in a CSV file.

    Columns are found by their names (`ALIASES`): time, id, x and y are needed; z, roll, pitch, yaw, vx, vy, vz, length,
    width, height, kind, type_id (a blueprint) and role_name are optional. An object appears with its first row and
    disappears after its last one. Without a yaw it faces the direction of its motion, which it keeps while it stands.
    Velocities are recorded if they are given. Times that begin before 0, or later than after a day, are shifted to 0.

    Args:
        source: The CSV file, with a row of names at its top; commas, semicolons or tabs separate the columns.
        destination: The recording; its suffix says the format. It appears when it is complete.
        map_name: The name of the map.
        columns: The names of columns that have others, such as `{"x": "east"}`.
        time_unit: The unit of times; None: s, of a column `total_nanos` ns.
        length_unit: The unit of positions, sizes and velocities (per second).
        angle_unit: The unit of angles.
        axes: "right-handed": x forward, y left, a positive yaw turns left; or "carla".
        hero: The id of the object with the role name hero.
        force: Overwrite an existing file.

    Returns:
        The extent of the recording.

    Raises:
        RecapError: The file is no such table, or the recording cannot be written.
    """
    for name, value, known in (
        ("time_unit", time_unit or "s", TimeUnit),
        ("length_unit", length_unit, LengthUnit),
        ("angle_unit", angle_unit, AngleUnit),
        ("axes", axes, TrackAxes),
    ):
        if value not in get_args(known):
            raise RecapError(f"{name} must be one of {', '.join(get_args(known))}, not {value!r}")
    check_new(destination, force=force)
    check_destination(source, destination, force=force)
    found, names = _read(Path(source), columns or {})
    if time_unit is None:
        time_unit = "ns" if names["time"].lower() == "total_nanos" else "s"
    _to_carla(found, _PER_SECOND[time_unit], length_unit, angle_unit, axes)
    tracks = _tracks(Path(source), found, hero)
    return _write(found, tracks, destination, map_name)


# --- reading -------------------------------------------------------------------------------------------------------------


def _read(path: Path, given: Mapping[str, str]) -> tuple[_Columns, dict[str, str]]:
    """Return the columns of a file, and the names that they have in it."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            first = file.readline(_LONGEST_LINE)
            file.seek(0)
            separator = max(_SEPARATORS, key=first.count)
            lines = csv.reader(file, delimiter=separator, strict=True)
            header = next(lines, None)
            if header is None:
                raise RecapError(f"{path}: is empty; a CSV file with a row of names at its top was expected")
            names, positions = _positions(path, header, given)
            return _parse(path, lines, positions, len(header)), names
    except OSError as error:
        raise RecapError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise RecapError(f"{path}: byte {error.start}: no UTF-8; a CSV file was expected") from None
    except csv.Error as error:
        raise RecapError(f"{path}: is no CSV file ({error})") from None


def _positions(path: Path, header: list[str], given: Mapping[str, str]) -> tuple[dict[str, str], dict[str, int]]:
    unknown = [name for name in given if name not in ALIASES]
    if unknown:
        raise RecapError(f"there is no column {unknown[0]!r}; there are {', '.join(ALIASES)}")
    headings = [name.strip().lower() for name in header]
    by_name = {name: index for index, name in enumerate(headings)}
    names, positions = {}, {}
    for column, aliases in ALIASES.items():
        wanted = (given[column].lower(),) if column in given else aliases
        match = next((alias for alias in wanted if alias in by_name), None)
        if match is not None and headings.count(match) > 1:
            raise RecapError(f"{path}: two columns are named {match}")
        if match is not None:
            names[column], positions[column] = match, by_name[match]
        elif column in given or column in REQUIRED:
            expected = given.get(column) or " or ".join(aliases[:3])
            shown = ", ".join(header[:12]) + (", …" if len(header) > 12 else "")
            raise RecapError(f"{path}: no column {expected} for {column}; it has {shown:.300}")
    return names, positions


def _parse(path: Path, lines: Iterable[list[str]], positions: Mapping[str, int], width: int) -> _Columns:
    numbers = {name: array("d") for name in positions if name not in _TEXT}
    texts: dict[str, list[str]] = {name: [] for name in positions if name in _TEXT}
    pooled: dict[str, str] = {}
    for number, line in enumerate(lines, 2):
        if not line:
            continue
        if len(line) != width:
            raise RecapError(f"{path}: line {number}: {len(line)} values, {width} were expected")
        if number > _ROWS:
            raise RecapError(f"{path}: line {number}: at most {_ROWS:,} lines are read")
        for name, values in numbers.items():
            text = line[positions[name]]
            try:
                value = float(text) if text else math.nan
            except ValueError:
                raise RecapError(f"{path}: line {number}: {name} is {text[:40]!r}; a number was expected") from None
            if abs(value) > (_LATEST if name == "time" else _LARGEST) and math.isfinite(value):
                raise RecapError(f"{path}: line {number}: {name} is {text[:40]}, which is too large")
            values.append(value if math.isfinite(value) else math.nan)
        for name, items in texts.items():
            text = line[positions[name]]
            if len(text) > _LONGEST:
                raise RecapError(
                    f"{path}: line {number}: {name} has {len(text)} characters; at most {_LONGEST} were expected"
                )
            items.append(pooled.setdefault(text, text))
        if not all(math.isfinite(numbers[name][-1]) for name in ("time", "x", "y")):
            raise RecapError(f"{path}: line {number}: time, x and y must be finite numbers")
        if not texts["id"][-1]:
            raise RecapError(f"{path}: line {number}: the id is empty")
    if not texts["id"]:
        raise RecapError(f"{path}: no rows below the names")
    return _Columns({name: np.frombuffer(values).copy() for name, values in numbers.items()}, texts)


def _to_carla(found: _Columns, per_second: float, length_unit: str, angle_unit: str, axes: str) -> None:
    """Convert the numbers to s, and to CARLA's cm, degrees, m/s and left-handed axes."""
    numbers = found.numbers
    numbers["time"] /= per_second
    first = numbers["time"].min()
    if first < 0 or first > _DAY:
        numbers["time"] -= first
    for name, values in numbers.items():
        if name in ("x", "y", "z", "length", "width", "height", "box_x", "box_y", "box_z") and length_unit == "m":
            values /= CM
        elif name in ("vx", "vy", "vz") and length_unit == "cm":
            values *= CM
        elif name in ("roll", "pitch", "yaw") and angle_unit == "rad":
            values[:] = np.degrees(values)
        if axes == "right-handed" and name in ("y", "vy", "pitch", "yaw", "box_y"):
            np.subtract(0.0, values, out=values)


# --- objects -------------------------------------------------------------------------------------------------------------


def _tracks(path: Path, found: _Columns, hero: str | None) -> list[_Track]:
    names: dict[str, int] = {}  # in the order of appearance
    indices = np.array([names.setdefault(name, len(names)) for name in found.texts["id"]])
    if hero is not None and hero not in names:
        raise RecapError(f"{path}: no object {hero}; ids are {', '.join(list(names)[:3])} …")
    time = found.numbers["time"]
    found.numbers.setdefault("yaw", np.full(len(time), np.nan))
    order = np.lexsort((time, indices))
    edges = np.searchsorted(indices[order], np.arange(len(names) + 1))
    numbers = _numbers(list(names))
    tracks = []
    for index, name in enumerate(names):
        rows = order[edges[index] : edges[index + 1]]
        twice = np.flatnonzero(np.diff(time[rows]) <= 0)
        if len(twice):
            raise RecapError(f"{path}: object {name} has two rows at {time[rows[twice[0]]]:g} s")
        _face(found.numbers, rows)
        tracks.append(_track(found, rows, name, numbers[name], is_hero=name == hero))
    return tracks


def _numbers(names: list[str]) -> dict[str, int]:
    """Return an actor id for each name: the name itself, if all are such numbers, else 1 and up."""
    if all(name.isascii() and name.isdecimal() and 0 < int(name[:12]) < _IDS and name[0] != "0" for name in names):
        return {name: int(name) for name in names}
    return {name: number for number, name in enumerate(names, 1)}


def _face(numbers: dict[str, Floats], rows: Indices) -> None:
    """Set the yaw of a track where it is missing: the direction of its motion, kept while it stands."""
    yaw = numbers["yaw"]
    known = np.isfinite(yaw[rows])
    if known.all():
        return
    x, y = numbers["x"][rows] * CM, numbers["y"][rows] * CM
    origin, moved = 0, np.full(len(rows), np.nan)
    for row in range(1, len(rows)):
        step = x[row] - x[origin], y[row] - y[origin]
        if math.hypot(*step) >= _STANDSTILL:
            moved[row - 1] = math.degrees(math.atan2(step[1], step[0]))
            origin = row
    valid = np.flatnonzero(np.isfinite(moved))
    if len(valid):
        latest = np.maximum.accumulate(np.where(np.isfinite(moved), np.arange(len(rows)), -1))
        moved = moved[np.where(latest < 0, valid[0], latest)]
    yaw[rows] = np.where(known, yaw[rows], np.nan_to_num(moved))


def _track(found: _Columns, rows: Indices, name: str, number: int, *, is_hero: bool) -> _Track:
    numbers, texts, first = found.numbers, found.texts, int(rows[0])
    kind = texts["kind"][first].strip().lower() if "kind" in texts else "vehicle"
    blueprint = (texts["type_id"][first] if "type_id" in texts else "") or KINDS.get(kind, _PROP)
    family = blueprint.partition(".")[0]
    actor_kind = {"vehicle": ActorKind.VEHICLE, "walker": ActorKind.WALKER}.get(family, ActorKind.OTHER)
    role = "hero" if is_hero else texts["role_name"][first] if "role_name" in texts else ""
    given = {"role_name": role} if role else {}
    if name != str(number):
        given["track_id"] = name
    x, y, z, roll, pitch, yaw = (float(value) for value in _pose(numbers, first).values())
    spawn = Spawn(number, actor_kind, x, y, z, roll, pitch, yaw, type_id=blueprint, attributes=attributes(**given))
    box = None
    length, width = (float(numbers[each][first]) if each in numbers else math.nan for each in ("length", "width"))
    if length > 0 and width > 0:
        height = float(numbers["height"][first]) if "height" in numbers else math.nan
        height = height if height > 0 else _HEIGHT / CM
        middle = 0.0 if actor_kind == ActorKind.WALKER else height / 2
        center = [float(numbers[each][first]) if each in numbers else 0.0 for each in ("box_x", "box_y")]
        center.append(float(numbers["box_z"][first]) if "box_z" in numbers else middle)
        box = (*np.nan_to_num(center).tolist(), length / 2, width / 2, height / 2)
    return _Track(rows, spawn, box)


def _pose(numbers: Mapping[str, Floats], rows: Any) -> dict[str, Any]:
    zeros = np.zeros(np.shape(rows))
    columns = {name: numbers[name][rows] if name in numbers else zeros for name in ("x", "y", "z", "roll", "pitch", "yaw")}
    return {name: np.nan_to_num(values) for name, values in columns.items()}


# --- writing -------------------------------------------------------------------------------------------------------------


def _write(found: _Columns, tracks: list[_Track], destination: Path | str, map_name: str) -> Extent:
    time = found.numbers["time"]
    ids = np.zeros(len(time), np.uint32)
    spawns: dict[float, list[_Track]] = {}
    ends: dict[float, list[int]] = {}
    for track in tracks:
        ids[track.rows] = track.spawn.id
        spawns.setdefault(float(time[track.rows[0]]), []).append(track)
        ends.setdefault(float(time[track.rows[-1]]), []).append(track.spawn.id)
    order = np.argsort(time, kind="stable")
    moments, starts = np.unique(time[order], return_index=True)
    columns = {"id": ids[order], **_pose(found.numbers, order)}
    moving = {axis: found.numbers[f"v{axis}"][order] for axis in "xyz" if f"v{axis}" in found.numbers}
    has_velocity: NDArray[np.bool_] | None = None
    if "x" in moving and "y" in moving:
        has_velocity = np.logical_and.reduce([np.isfinite(values) for values in moving.values()])
    has_boxes = any(track.box for track in tracks)
    with create_recording(
        destination, map_name=map_name, date=0, additional_data=has_velocity is not None or has_boxes
    ) as recorder:
        gone: list[int] = []
        for moment, start, stop in zip(moments.tolist(), starts, [*starts[1:], len(order)], strict=True):
            rows = slice(start, stop)
            records: dict[str, Any] = {"transforms": {name: values[rows] for name, values in columns.items()}}
            new = spawns.get(moment, [])
            if new:
                records["spawned"] = [track.spawn for track in new]
                boxes = [(track.spawn.id, *track.box) for track in new if track.box]
                if boxes:
                    records["bounding_boxes"] = boxes
            if gone:
                records["destroyed"] = {"id": gone}
            if has_velocity is not None and has_velocity[rows].any():
                known = has_velocity[rows]
                axes = {axis: values[rows][known] for axis, values in moving.items()}
                records["velocities"] = {"id": columns["id"][rows][known], **axes}
            recorder.add_frame(moment, **records)
            gone = ends.get(moment, [])
        return recorder.extent
