"""Recordings of tracks from elsewhere: CSV files with a row for each object at each time."""

from __future__ import annotations

import csv
import math
import stat
import warnings
from array import array
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np

from carla_recap.editing.author import create_recording
from carla_recap.editing.convert import check_destination, check_new
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.model.blueprints import blueprint_like
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.layout import MAX_COUNT
from carla_recap.model.lives import HERO
from carla_recap.model.motion import rates, steps_joined
from carla_recap.model.records import CM, NO_ACTOR, UE4, ActorKind, Spawn, attributes
from carla_recap.util.files import IS_LFS_POINTER, LFS_POINTER
from carla_recap.util.text import first_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from datetime import datetime

    from numpy.typing import NDArray

    from carla_recap.model.frame import Extent
    from carla_recap.model.layout import Records
    from carla_recap.util.arrays import Floats, Integers


TimeUnit = Literal["s", "ms", "us", "ns"]
LengthUnit = Literal["m", "cm", "ft"]
AngleUnit = Literal["deg", "rad"]
TrackAxes = Literal["right-handed", "carla"]
TrackPosition = Literal["center", "corner", "front"]
"""What x and y are of a box: the middle, the corner where both are least, or the middle of the side that it faces."""

ALIASES: Final[Mapping[str, tuple[str, ...]]] = {
    "time": ("time", "t", "timestamp", "elapsed", "total_nanos"),
    "id": ("id", "idx", "track_id", "trackid", "actor_id", "agent_id", "object_id", "vehicle_id"),
    "kind": ("kind", "class", "type", "agent_type", "object_type", "v_class"),
    "type_id": ("type_id", "blueprint"),
    "role_name": ("role_name",),
    "x": ("x", "pos_x", "xcenter", "x_center", "local_x"),
    "y": ("y", "pos_y", "ycenter", "y_center", "local_y"),
    "z": ("z", "pos_z"),
    "roll": ("roll",),
    "pitch": ("pitch",),
    "yaw": ("yaw", "heading", "psi_rad"),
    "vx": ("vx", "vel_x", "xvelocity", "v_x"),
    "vy": ("vy", "vel_y", "yvelocity", "v_y"),
    "vz": ("vz", "vel_z", "v_z"),
    "length": ("length", "v_length"),
    "width": ("width", "v_width"),
    "height": ("height",),
    "box_x": ("box_x",),
    "box_y": ("box_y",),
    "box_z": ("box_z",),
}
"""The columns, and the names by which each is found; upper and lower case are the same."""
REQUIRED: Final = ("time", "id", "x", "y")
FRAMES: Final = ("frame", "frame_id")
"""The names of a column of frames, which are times if their rate is known."""
KINDS: Final[Mapping[str, str]] = {
    **{name: name for name in ("vehicle", "car", "van", "truck", "bus", "motorcycle", "bicycle", "walker")},
    "truck_bus": "truck",
    "pedestrian": "walker",
    "2": "vehicle",  # as ASAM OSI numbers moving objects
    "3": "walker",
}
"""What the blueprint of each kind is chosen from, by its size; see `blueprint_like`. Others become props."""

_NGSIM_CLASSES: Final = {"1": "motorcycle", "2": "car", "3": "truck"}  # of a column `v_Class`
_SEPARATORS: Final = ",;\t"
_LONGEST_LINE: Final = 1 << 16  # bytes
_TEXT: Final = ("id", "kind", "type_id", "role_name")
_POSE: Final = ("x", "y", "z", "roll", "pitch", "yaw")
_BOX: Final = ("length", "width", "height", "box_x", "box_y", "box_z")
_ACTOR_KINDS: Final = {"vehicle": ActorKind.VEHICLE, "walker": ActorKind.WALKER}
_PER_SECOND: Final[Mapping[str, float]] = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
_PER_CENTIMETRE: Final[Mapping[str, float]] = {"m": CM, "cm": 1.0, "ft": 1 / 30.48}
_PROP: Final = "static.prop.box01"
_DAY: Final = 86_400.0  # s; a recording whose times begin later, or before 0, begins at 0
_LATEST: Final = 1e11  # s since 1970; later times are no dates
_LINES: Final = 20_000_000  # that are read at most
_LONGEST: Final = 1_000  # characters of an id, a kind, a blueprint or a role
_LARGEST: Final = float(np.finfo(np.float32).max) * (1 + 1e-9)  # that a recording can hold, which may have been rounded
_STANDSTILL: Final = 0.02  # m, and m/s; a shorter step and a lower velocity have no direction
_GAP: Final = 1.0  # s; an object that is missing for longer, in frames of others, has disappeared
_HEIGHT: Final = 1.5  # m; of a box whose height is not given
_IDS: Final = NO_ACTOR  # ids from here on are replaced


@dataclass(frozen=True)
class _Units:
    """The units and axes of a file."""

    time: TimeUnit | None
    length: LengthUnit
    angle: AngleUnit
    axes: TrackAxes
    rate: float | None

    def divisor(self, column: str, heading: str) -> float:
        """Return the number that a column is divided by to get CARLA's units and left-handed axes."""
        if column == "time":
            return self.rate or _PER_SECOND[self.time or ("ns" if heading == "total_nanos" else "s")]
        sign = -1.0 if self.axes == "right-handed" and column in ("y", "vy", "pitch", "yaw", "box_y") else 1.0
        if column in ("roll", "pitch", "yaw"):
            return sign * (1.0 if self.angle == "deg" else math.radians(1))
        return sign * _PER_CENTIMETRE[self.length] / (CM if column in ("vx", "vy", "vz") else 1.0)


@dataclass
class _Table:
    """The rows of a file that have a time and a position."""

    numbers: dict[str, Floats]  # the columns of numbers, (rows,), in CARLA's units, but for times; NaN where one is unknown
    second: float  # in the unit of times
    texts: dict[str, tuple[list[str], Integers]]  # the different texts of a column, in order, and which each row has
    lines: NDArray[np.uint32]  # the line of the file in which each row ends, (rows,), from 1
    left_out: array[int]  # the lines of other rows


def import_tracks(
    source: Path | str,
    destination: Path | str,
    *,
    map_name: str = "",
    date: datetime | float | None = None,
    columns: Mapping[str, str] | None = None,
    time_unit: TimeUnit | None = None,
    length_unit: LengthUnit = "m",
    angle_unit: AngleUnit = "deg",
    axes: TrackAxes = "right-handed",
    hero: str | None = None,
    rate: float | None = None,
    position: TrackPosition = "center",
    force: bool = False,
) -> Extent:
    """Write a recording of the tracks in a CSV file.

    Columns are found by their names (`ALIASES`): time, id, x and y are needed; z, roll, pitch, yaw, vx, vy, vz, length,
    width, height, kind, type_id (a blueprint) and role_name are optional. An object appears with its first row and
    disappears after its last one. Without a yaw it faces the direction of its motion, which it keeps while it stands.
    Velocities are recorded if they are given; with them, the change of the yaw per second. Times that begin before 0, or
    later than after a day, are shifted to 0. A number that is empty or not finite is unknown, and rows without a time, x or
    y are left out.

    Args:
        source: The CSV file, with a row of names at its top; commas, semicolons or tabs separate the columns.
        destination: The recording; its suffix says the format. It appears when it is complete.
        map_name: The name of the map.
        date: The beginning, as a time or in Unix seconds; None: the first time if times begin later than after a day, so
            that they are Unix times, else 0.
        columns: The names of columns that have others, such as `{"x": "east"}`.
        time_unit: The unit of times; None: s, of a column `total_nanos` ns.
        length_unit: The unit of positions, sizes and velocities (per second).
        angle_unit: The unit of angles.
        axes: "right-handed": x forward, y left, a positive yaw turns left; or "carla".
        hero: The id of the object with the role name hero.
        rate: The frames of a second: the times are the numbers of frames in a column `frame` or `frame_id`, or in the one
            that `columns` names.
        position: What x and y are of a box. With "corner", the columns width and height are its extents along x and y, as in
            highD; with "front", its length lies behind them, as in NGSIM.
        force: Overwrite an existing file.

    Returns:
        The extent of the recording.

    Raises:
        RecapError: The file is no such table, or the recording cannot be written.

    Warns:
        RecapWarning: Rows are left out, or frames are taken as times.
    """
    if rate is not None and not 0 < rate < math.inf:
        raise RecapError(f"rate: expected a number of frames per second above 0, found {rate!r}")
    for name, value, known in (
        ("time_unit", time_unit or "s", TimeUnit),
        ("length_unit", length_unit, LengthUnit),
        ("angle_unit", angle_unit, AngleUnit),
        ("axes", axes, TrackAxes),
        ("position", position, TrackPosition),
    ):
        if value not in get_args(known):
            raise RecapError(f"{name} must be one of {', '.join(get_args(known))}, not {value!r}")
    if rate is not None and time_unit is not None:
        raise RecapError("time_unit: expected none where a rate makes times of frames")
    check_new(destination, force=force)
    check_destination(source, destination, force=force)
    path = Path(source)
    units = _Units(time_unit, length_unit, angle_unit, axes, rate)
    columns = dict(columns or {})
    if rate is None and columns.get("time", "").lower() in FRAMES:
        warnings.warn(f"{path}: frames are taken as times; a rate says how many a second has", RecapWarning, stacklevel=2)
    table = _read(path, columns, units, position)
    if table.left_out:
        rows = f"{len(table.left_out)} row{'s' * (len(table.left_out) != 1)} without a time or a position left out"
        warnings.warn(f"{path}: {rows}, the first in line {table.left_out[0]}", RecapWarning, stacklevel=2)
    time = table.numbers["time"]
    first = time.min().item() / table.second
    if first < 0 or first > _DAY:
        with np.errstate(over="ignore"):
            time -= time.min()  # in its own unit, in which it is exact if it is a whole number
        if time.max() == math.inf:
            raise RecapError(f"{path}: more seconds between the first and the last time than can be counted")
    time /= table.second
    if date is None:
        date = first if rate is None and _DAY < first < _LATEST else 0
    if position == "corner":
        length, width = (_known(path, table, name) for name in ("length", "width"))
        table.numbers["x"] += length / 2
        table.numbers["y"] += width / 2 * (-1.0 if axes == "right-handed" else 1.0)
    tracks = _ImportedTracks(path, table, hero)
    if position == "front":
        length, yaw = _known(path, table, "length"), np.radians(table.numbers["yaw"])
        table.numbers["x"] -= length / 2 * np.cos(yaw)
        table.numbers["y"] -= length / 2 * np.sin(yaw)
    return tracks.write(destination, map_name, date)


def _known(path: Path, table: _Table, name: str) -> Floats:
    """Return a column of sizes, all of which must be known."""
    values = table.numbers[name]
    unknown = np.flatnonzero(~(values >= 0))
    if len(unknown):
        line = table.lines[unknown[0]]
        raise RecapError(f"{path}: line {line}: expected the {name} of a box whose middle is wanted, found none")
    return values


# --- reading -------------------------------------------------------------------------------------------------------------


def _rows(path: Path, file: IO[bytes]) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of a CSV file with the numbers of the lines in which they end, from 1."""
    start = file.read(_LONGEST_LINE)
    if start.startswith(LFS_POINTER):
        raise RecapError(f"{path}: {IS_LFS_POINTER}")
    file.seek(0)
    separator = max(_SEPARATORS, key=lambda each: start.partition(b"\n")[0].count(each.encode()))
    rows, begin = csv.reader(_lines(path, file), delimiter=separator, strict=True), 1
    try:
        for row in rows:
            yield rows.line_num, row
            begin = rows.line_num + 1
    except csv.Error as error:
        raise RecapError(f"{path}: line {begin}: is no row of a CSV file ({error})") from None


def _lines(path: Path, file: IO[bytes]) -> Iterator[str]:
    number = 0
    while line := file.readline(_LONGEST_LINE):
        number += 1
        if len(line) == _LONGEST_LINE:
            raise RecapError(f"{path}: line {number}: expected a line of less than {_LONGEST_LINE} bytes")
        if number > _LINES:
            raise RecapError(f"{path}: line {number}: at most {_LINES:,} lines are read")
        try:
            yield line.decode("utf-8-sig" if number == 1 else "utf-8")
        except UnicodeDecodeError:
            raise RecapError(f"{path}: line {number}: expected a CSV file, found bytes that are no UTF-8") from None


def _read(path: Path, given: Mapping[str, str], units: _Units, position: TrackPosition) -> _Table:
    """Return the rows of a file; see `import_tracks`."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise RecapError(f"{path}: is no regular file; expected a CSV file")
        with path.open("rb") as file:
            rows = _rows(path, file)
            _, header = next(rows, (0, None))
            if header is None:
                raise RecapError(f"{path}: is empty; a CSV file with a row of names at its top was expected")
            headings = [name.strip().lower() for name in header]
            positions = _positions(path, header, given, with_rate=units.rate is not None)
            needed = {"corner": ("width", "height"), "front": ("length",), "center": ()}[position]
            if not positions.keys() >= set(needed):
                raise RecapError(f"{path}: no column {' and '.join(needed)} for positions that are the {position} of a box")
            if position == "corner":
                positions["length"], positions["width"] = positions["width"], positions.pop("height")
            divisors = {name: units.divisor(name, headings[at]) for name, at in positions.items()}
            table = _parse(path, rows, positions, divisors, len(header))
    except OSError as error:
        raise RecapError(f"{path}: {error.strerror}") from None
    if "kind" in positions and headings[positions["kind"]] == "v_class":
        names, of_row = table.texts["kind"]
        table.texts["kind"] = [_NGSIM_CLASSES.get(name, name) for name in names], of_row
    return table


def _positions(path: Path, header: list[str], given: Mapping[str, str], *, with_rate: bool) -> dict[str, int]:
    unknown = [name for name in given if name not in ALIASES]
    if unknown:
        raise RecapError(f"there is no column {unknown[0]!r}; there are {', '.join(ALIASES)}")
    headings = [name.strip().lower() for name in header]
    by_name = {name: index for index, name in enumerate(headings)}
    positions = {}
    for column, known in ALIASES.items():
        aliases = FRAMES if column == "time" and with_rate else known
        wanted = (given[column].lower(),) if column in given else aliases
        match = next((alias for alias in wanted if alias in by_name), None)
        if match is not None and headings.count(match) > 1:
            raise RecapError(f"{path}: two columns are named {match}")
        if match is not None:
            positions[column] = by_name[match]
        elif column in given or column in REQUIRED:
            expected = given.get(column) or " or ".join(aliases[:3])
            shown = ", ".join(header[:12]) + (", …" if len(header) > 12 else "")
            hint = "; with a rate, its frames are times" if column == "time" and set(FRAMES) & set(headings) else ""
            raise RecapError(f"{path}: no column {expected} for {column}; it has {shown:.300}{hint}")
    return positions


def _parse(
    path: Path,
    rows: Iterator[tuple[int, list[str]]],
    positions: Mapping[str, int],
    divisors: Mapping[str, float],
    width: int,
) -> _Table:
    numbers = {name: array("d") for name in positions if name not in _TEXT}
    texts: dict[str, dict[str, int]] = {name: {} for name in positions if name in _TEXT}
    which = {name: array("q") for name in texts}
    limits = {name: math.inf if name == "time" else _LARGEST * abs(divisors[name]) for name in numbers}
    lines, left_out = array("I"), array("I")
    for line, row in rows:
        if not row:
            continue
        if len(row) != width:
            raise RecapError(f"{path}: line {line}: expected {width} values, found {len(row)}")
        values = {name: _number(path, line, name, row[positions[name]], limit) for name, limit in limits.items()}
        if math.isnan(values["time"] + values["x"] + values["y"]):
            left_out.append(line)
            continue
        lines.append(line)
        for name, value in values.items():
            numbers[name].append(value)
        for name, known in texts.items():
            text = row[positions[name]].strip()
            if len(text) > _LONGEST:
                raise RecapError(f"{path}: line {line}: {name}: expected at most {_LONGEST} characters, found {len(text)}")
            if not text and name == "id":
                raise RecapError(f"{path}: line {line}: the id is empty")
            which[name].append(known.setdefault(text, len(known)))
    if not which["id"]:
        raise RecapError(f"{path}: no rows {'with a time and a position ' if left_out else ''}below the names")
    second = divisors["time"]
    divisors = {**divisors, "time": 1.0}
    return _Table(
        {name: np.frombuffer(values) / divisors[name] + 0.0 for name, values in numbers.items()},  # no -0.0
        second,
        {name: (list(known), np.frombuffer(which[name], np.int64)) for name, known in texts.items()},
        np.frombuffer(lines, np.uint32),
        left_out,
    )


def _number(path: Path, line: int, name: str, text: str, limit: float) -> float:
    """Return a number of the last row; NaN if it is unknown."""
    try:
        value = float(text.strip() or "nan")
    except ValueError:
        raise RecapError(f"{path}: line {line}: {name}: expected a number, found {text[:40]!r}") from None
    if math.isinf(value):
        return math.nan
    if abs(value) > limit:
        raise RecapError(f"{path}: line {line}: {name} is {text[:40]}, which is too large")
    return value


# --- objects -------------------------------------------------------------------------------------------------------------


class _ImportedTracks:
    """The objects of a file: the rows of each, and what it looks like."""

    def __init__(self, path: Path, table: _Table, hero: str | None) -> None:
        self._numbers, self._texts = table.numbers, table.texts
        self._names, of_row = table.texts["id"]
        if hero is not None and hero not in self._names:
            raise RecapError(f"{path}: no object {hero}; ids are {first_of(self._names)}")
        self._hero = hero
        time = table.numbers["time"]
        order = np.lexsort((time, of_row))
        edges = np.searchsorted(of_row[order], np.arange(len(self._names) + 1))
        again = np.flatnonzero((np.diff(time[order]) <= 0) & (np.diff(of_row[order]) == 0))
        if len(again):
            row = order[again[0]]
            first, second = sorted(table.lines[order[again[0] : again[0] + 2]].tolist())
            name = self._names[of_row[row]]
            raise RecapError(f"{path}: lines {first} and {second}: object {name} has two rows at {time[row]:g} s")
        moments, counts = np.unique(time, return_counts=True)
        if (most := counts.max()) > MAX_COUNT:
            moment = moments[counts.argmax()]
            raise RecapError(f"{path}: {most} objects at {moment:g} s; a recording has at most {MAX_COUNT} at a time")
        self._ids = _actor_ids(self._names)
        self._first = order[edges[:-1]]
        track, frame = of_row[order], np.searchsorted(moments, time[order])
        missing = (np.diff(time[order]) > _GAP + SAME_TIME) & (np.diff(frame) > 1) | (np.diff(track) != 0)
        self._begins, self._ends = order[np.append(True, missing)], order[np.append(missing, True)]
        yaw = self._numbers.setdefault("yaw", np.full(len(time), np.nan))
        unknown = np.isin(np.arange(len(self._names)), of_row[np.isnan(yaw)]) & (np.diff(edges) > 1)
        for number in np.flatnonzero(unknown).tolist():
            self._face(order[edges[number] : edges[number + 1]])
        if "vx" in self._numbers and "vy" in self._numbers:  # of those that never move
            vx, vy = self._numbers["vx"], self._numbers["vy"]
            facing = np.isnan(yaw) & (np.hypot(vx, vy) >= _STANDSTILL)
            yaw[facing] = np.degrees(np.arctan2(vy, vx))[facing]
        for name in _POSE:
            np.nan_to_num(self._numbers.setdefault(name, np.zeros(len(time))), copy=False)
        places = np.stack([self._numbers[axis][order] * CM for axis in "xyz"])
        joined = steps_joined(time[order], places, actor=of_row[order])
        self._yaw_rates = np.zeros(len(time))  # degrees/s
        self._yaw_rates[order] = np.nan_to_num(rates(time[order], yaw[order], joined, period=360.0))

    def _face(self, rows: Integers) -> None:
        """Set the yaw of a track where it is missing: the direction of its motion, kept while it stands."""
        x, y, yaw = self._numbers["x"][rows] * CM, self._numbers["y"][rows] * CM, self._numbers["yaw"][rows]
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
        self._numbers["yaw"][rows] = np.where(np.isnan(yaw), moved, yaw)

    def _number(self, name: str, row: int) -> float:
        return self._numbers[name][row].item() if name in self._numbers else math.nan

    def _text(self, name: str, row: int) -> str:
        values, which = self._texts.get(name, ([], []))
        return values[int(which[row])] if values else ""

    def _looks(self, row: int) -> tuple[str, ActorKind]:
        """Return the blueprint and the kind of the actor that a row is about."""
        by_kind = KINDS.get(self._text("kind", row).lower() if "kind" in self._texts else "vehicle", "")
        blueprint = self._text("type_id", row)
        if by_kind:
            length, width = (self._number(name, row) * CM for name in ("length", "width"))
            number = int(self._texts["id"][1][row])
            blueprint = blueprint or blueprint_like(by_kind, length if length > 0 else math.nan, width, number)
            return blueprint, ActorKind.WALKER if by_kind == "walker" else ActorKind.VEHICLE
        blueprint = blueprint or _PROP
        return blueprint, _ACTOR_KINDS.get(blueprint.partition(".")[0], ActorKind.OTHER)

    def _spawn(self, row: int) -> Spawn:
        """Return the spawn of the object of a row, where that is."""
        number = int(self._texts["id"][1][row])
        name, id, first = self._names[number], self._ids[number].item(), self._first[number].item()
        blueprint, kind = self._looks(first)
        role = HERO if name == self._hero else self._text("role_name", first)
        given = {"role_name": role} if role else {}
        if name != str(id):
            given["track_id"] = name
        pose = {each: self._numbers[each][row].item() for each in _POSE}
        return Spawn(id, kind, **pose, type_id=blueprint, attributes=attributes(**given))

    def _box(self, number: int) -> tuple[float, ...] | None:
        """Return the bounding box of an object, as a record; None if its length or its width is unknown."""
        row = self._first[number].item()
        length, width, height, *center = (self._number(name, row) for name in _BOX)
        if not (length > 0 and width > 0):
            return None
        height = height if height > 0 else _HEIGHT / CM
        middle = (0.0, 0.0, 0.0 if self._looks(row)[1] == ActorKind.WALKER else height / 2)
        center = [default if math.isnan(value) else value for value, default in zip(center, middle, strict=True)]
        return (self._ids[number].item(), *center, length / 2, width / 2, height / 2)

    def write(self, destination: Path | str, map_name: str, date: datetime | float) -> Extent:
        """Write the recording."""
        time, (_, of_row) = self._numbers["time"], self._texts["id"]
        order = np.argsort(time, kind="stable")
        ids, moments = self._ids[of_row[order]], np.unique(time)
        columns = {"id": ids, **{name: self._numbers[name][order] for name in _POSE}}
        transforms = _by_moment(_records("transforms", columns), time[order], moments)
        axes = {axis: self._numbers[f"v{axis}"][order] for axis in "xyz" if f"v{axis}" in self._numbers}
        has_velocities = "x" in axes and "y" in axes
        known = ~np.isnan(axes["x"] + axes["y"]) if has_velocities else np.zeros(len(order), bool)
        if "z" in axes:
            axes["z"] = np.nan_to_num(axes["z"])
        moving = {"id": ids[known], **{axis: values[known] for axis, values in axes.items()}}
        moving["angular_z"] = self._yaw_rates[order][known]
        velocities = _by_moment(_records("velocities", moving), time[order][known], moments)
        boxes = {number: box for number in range(len(self._names)) if (box := self._box(number))}
        begins = self._begins[np.argsort(time[self._begins], kind="stable")]
        spawned = _by_moment(begins, time[begins], moments)
        ends = self._ends[np.argsort(time[self._ends], kind="stable")]
        destroyed = _by_moment(_records("destroyed", {"id": self._ids[of_row[ends]]}), time[ends], moments)
        additional = has_velocities or bool(boxes)
        with create_recording(destination, map_name=map_name, date=date, additional_data=additional) as recorder:
            gone: Records = []
            for moment in moments.tolist():
                records = {"transforms": next(transforms), "velocities": next(velocities), "destroyed": gone}
                new = next(spawned).tolist()
                records["spawned"] = [self._spawn(row) for row in new]
                records["bounding_boxes"] = [boxes[number] for number in of_row[new].tolist() if number in boxes]
                recorder.add_frame(moment, **{name: each for name, each in records.items() if len(each)})
                gone = next(destroyed)
            return recorder.extent


def _records(name: str, columns: dict[str, Any]) -> NDArray[np.void]:
    return np.asarray(UE4.named(name).records(columns))


def _by_moment(values: NDArray[Any], times: Floats, moments: Floats) -> Iterator[NDArray[Any]]:
    """Yield the values of each moment; they are in the order of their times."""
    edges = [*np.searchsorted(times, moments).tolist(), len(times)]
    return (values[start:stop] for start, stop in pairwise(edges))


def _actor_ids(names: list[str]) -> NDArray[np.uint32]:
    """Return an actor id for each name: the name itself, if all are such numbers, else 1 and up."""
    if all(name.isascii() and name.isdecimal() and name[0] != "0" and int(name[:12]) < _IDS for name in names):
        return np.array([int(name) for name in names], np.uint32)
    return np.arange(1, len(names) + 1, dtype=np.uint32)
