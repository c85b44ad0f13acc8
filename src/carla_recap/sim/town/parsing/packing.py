"""Serialization of a parsed town: lines as arrays, the rest as JSON, in the bytes of an .npz."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.roads.parsing import pack, unpack

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_FACTS: Final = "facts"


@dataclass(frozen=True)
class Parsed:
    """A parsed OpenDRIVE file.

    Attributes:
        lines: Lists of arrays by name: of `lanes`, rows of x, y, z, heading, width; of all others, of x, y, z.
        facts: Lists of rows by name: the fields of a class of the town, by their names, but for those that are lines.
    """

    lines: dict[str, list[Floats]]
    facts: dict[str, list[dict[str, Any]]]


def to_bytes(parsed: Parsed) -> bytes:
    """Return a parsed town as bytes."""
    text = np.frombuffer(json.dumps(parsed.facts).encode(), np.uint8)
    return pack({**parsed.lines, _FACTS: [text]})


def from_bytes(data: bytes) -> Parsed:
    """Return the parsed town in some bytes."""
    lines = unpack(data)
    (text,) = lines.pop(_FACTS)
    return Parsed(lines, json.loads(text.tobytes()))
