"""Answers as JSON."""

from __future__ import annotations

import math
from dataclasses import asdict, is_dataclass
from json import JSONEncoder
from typing import TYPE_CHECKING, Any, Final

from carla_recap.queries.info import Info
from carla_recap.queries.sensors import RecordedSensor, sensors
from carla_recap.tables import column_names
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from carla_recap.model.frame import Extent, Header
    from carla_recap.output.text import AnyAnswer


def json(answer: AnyAnswer, warnings: Sequence[str] | None = None) -> Iterator[str]:
    """Yield an answer as one JSON object, in pieces; its `rows` have the fields and units of the row's class.

    That of info also lists the sensors whose data the recording has. Numbers that are not finite become null.
    """
    yield encoded(_header(answer.header))[:-1] + ', "rows": '
    yield from array_of(rows(answer))
    about = _extent(answer.extent)
    if isinstance(answer, Info):
        names = column_names(RecordedSensor)
        about["sensors"] = [{name: getattr(sensor, name) for name in names} for sensor in sensors(answer.source)]
    yield ", " + encoded(about if warnings is None else {**about, "warnings": list(warnings)})[1:] + "\n"


def array_of(values: Iterable[str]) -> Iterator[str]:
    """Yield a list of values that are JSON already, a line each."""
    separator = "[\n"
    for value in values:
        yield separator + value
        separator = ",\n"
    yield "[\n]" if separator == "[\n" else "\n]"


def rows(answer: AnyAnswer, **more: Any) -> Iterator[str]:
    """Yield each row of an answer as a JSON object, with more fields in front."""
    names = column_names(answer.row_type)
    for row in answer:
        yield encoded({**more, **{name: getattr(row, name) for name in names}})


def facts(header: Header | None, extent: Extent | None) -> dict[str, Any]:
    """Return what the answer of one recording says about it beside the rows, as values for JSON; None where unknown."""
    none = dict.fromkeys(("version", "map", "date", "frames", "last_frame", "duration"))
    return {**none, **(_header(header) if header else {}), **(_extent(extent) if extent else {})}


def _header(header: Header) -> dict[str, Any]:
    return {"version": header.version, "map": readable(header.map_name), "date": header.date}


def _extent(extent: Extent) -> dict[str, Any]:
    return {"frames": extent.frames, "last_frame": extent.last_id, "duration": extent.duration}


_STRICT: Final = JSONEncoder(allow_nan=False, default=asdict)


def encoded(value: dict[str, Any]) -> str:
    """Return a JSON object; numbers that are not finite become null."""
    try:
        return _STRICT.encode(value)
    except ValueError:
        return _STRICT.encode(_finite(value))


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    return [_finite(item) for item in value] if isinstance(value, (list, tuple)) else value
