"""Answers as JSON."""

from __future__ import annotations

import math
from dataclasses import asdict, fields
from json import JSONEncoder
from typing import TYPE_CHECKING, Any, Final

from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.queries.output.text import AnyAnswer


def json(answer: AnyAnswer) -> Iterator[str]:
    """Yield an answer as one JSON object, in pieces; its `rows` have the fields and units of the row's class.

    Numbers that are not finite become null.
    """
    header = {
        "version": answer.header.version,
        "map": readable(answer.header.map_name),
        "date": answer.header.date,
    }
    yield encoded(header)[:-1] + ', "rows": ['
    names = [field.name for field in fields(answer.row_type)]
    separator = "\n"
    for row in answer:
        yield separator + encoded({name: getattr(row, name) for name in names})
        separator = ",\n"
    extent = answer.extent
    footer = {"frames": extent.frames, "last_frame": extent.last_id, "duration": extent.duration}
    yield "\n], " + encoded(footer)[1:] + "\n"


_STRICT: Final = JSONEncoder(allow_nan=False, default=asdict)


def encoded(value: dict[str, Any]) -> str:
    """Return an object as JSON; numbers that are not finite become null."""
    try:
        return _STRICT.encode(value)
    except ValueError:
        return _STRICT.encode(_finite(value))


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    return [_finite(item) for item in value] if isinstance(value, list) else value
