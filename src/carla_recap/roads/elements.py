"""XML files of roads and routes, element by element, in little memory."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final
from xml.etree.ElementTree import Element, SubElement
from xml.parsers import expat

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


@dataclass(frozen=True, kw_only=True)
class DocumentShape:
    """The elements that are read of a kind of XML file, and their limits."""

    root: str  # the root element
    content: frozenset[str]  # the elements below it that are read
    known: frozenset[str]  # the elements within these that are read
    file: str  # the name of such a file in errors
    part: str  # the name of an element of the content in errors
    most: int  # the most elements of a file
    most_of_part: int  # the most elements of a part


OPENDRIVE: Final = DocumentShape(
    root="OpenDRIVE",
    content=frozenset(("road", "junction", "controller")),
    known=frozenset(
        (
            *("link", "predecessor", "successor", "type", "speed", "planView"),
            *("geometry", "line", "arc", "spiral", "poly3", "paramPoly3"),
            *("elevationProfile", "elevation", "lanes", "laneOffset", "laneSection", "left"),
            *("center", "right", "lane", "width", "roadMark", "objects"),
            *("object", "outlines", "outline", "cornerLocal", "cornerRoad", "signals", "signal"),
            *("signalReference", "positionInertial", "validity", "connection", "priority", "control"),
        )
    ),
    file="map",
    part="road or junction",
    most=4_000_000,  # CARLA's towns have up to 15,000 in a megabyte
    most_of_part=200_000,
)
"""Maps in OpenDRIVE."""

_BEFORE_DECLARATION: Final = re.compile(r"(?>\s+|<!--.*?-->)++(?=<\?xml\s)", re.DOTALL)
_CHUNK: Final = 1 << 16  # characters that are parsed at once
_MOST_OF_TAG: Final = 100  # attributes
_MOST_NAMES: Final = 10_000  # of elements and attributes, of a file; CARLA's towns have about 150
_LONGEST_TAG: Final = 1 << 20  # bytes
_LONGEST_PART: Final = 16 << 20  # bytes


def read_elements(text: str | Iterable[str], shape: DocumentShape = OPENDRIVE) -> Iterator[Element]:
    """Yield the elements of the content of a file, such as roads, with the known elements within them.

    A `ValueError` says that it is no such file, or what in it is too large.
    """
    reader = _Reader(shape)
    parts = (text,) if isinstance(text, str) else text
    for number, part in enumerate(parts):
        if number == 0 and (before := _BEFORE_DECLARATION.match(part)):  # CARLA's library reads that, too
            part = part[before.end() :]
        for start in range(0, len(part), _CHUNK):
            yield from reader.feed(part[start : start + _CHUNK])
    yield from reader.feed("", is_last=True)


class _Reader:
    def __init__(self, shape: DocumentShape) -> None:
        self._shape = shape
        self._names: dict[str, str] = {}
        self._parser = expat.ParserCreate("utf-8", None, self._names)
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.EntityDeclHandler = self._refuse_entity
        self._depth = self._count = self._of_part = self._fed = self._part_start = 0
        self._path: list[Element] = []  # from the part to the element that is read
        self._left_out = 0  # elements from the one that is unknown to the one that is read
        self._done: list[Element] = []

    def feed(self, text: str, *, is_last: bool = False) -> list[Element]:
        """Parse some text, and return what is complete."""
        data = text.encode("utf-8", "replace")
        self._fed += len(data)
        try:
            self._parser.Parse(data, is_last)
        except expat.ExpatError as error:
            raise ValueError(f"the XML is invalid: {error}") from None
        if self._fed - self._parser.CurrentByteIndex > _LONGEST_TAG:
            raise ValueError(f"tags of at most {_LONGEST_TAG >> 20} MB, and one is longer")
        if self._depth > 1 and self._fed - self._part_start > _LONGEST_PART:
            raise ValueError(f"at most {_LONGEST_PART >> 20} MB of a {self._shape.part}, and one has more")
        if len(self._names) > _MOST_NAMES:
            raise ValueError(f"at most {_MOST_NAMES:,} names of elements and attributes, and it has more")
        done, self._done = self._done, []
        return done

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._depth += 1
        self._count += 1
        self._of_part += 1
        shape = self._shape
        if self._of_part > shape.most_of_part:
            raise ValueError(f"at most {shape.most_of_part:,} elements in a {shape.part}, and one has more")
        if self._count > shape.most:
            raise ValueError(f"at most {shape.most:,} elements, and it has more")
        if len(attributes) > _MOST_OF_TAG:
            raise ValueError(f"at most {_MOST_OF_TAG} attributes of an element, and a {tag[:40]!r} has {len(attributes):,}")
        if self._depth == 1 and tag != shape.root:
            raise ValueError(f"the root element is {tag[:40]!r}")
        if self._depth == 2:
            self._of_part, self._part_start = 1, self._parser.CurrentByteIndex
            if tag in shape.content:
                self._path = [Element(tag, attributes)]
        elif self._path:
            if self._left_out or tag not in shape.known:
                self._left_out += 1
            else:
                self._path.append(SubElement(self._path[-1], tag, attributes))

    def _end(self, tag: str) -> None:
        self._depth -= 1
        if self._left_out:
            self._left_out -= 1
        elif self._path:
            element = self._path.pop()
            if not self._path:
                self._done.append(element)

    def _refuse_entity(self, *_: object) -> None:
        raise ValueError(f"it declares entities, which no {self._shape.file} does")
