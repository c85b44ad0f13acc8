"""Datasets in the form of COCO: images of all cameras with boxes and masks, whose runs of pixels are encoded here."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.files.datasets import DatasetWriter, by_split, move
from carla_recap.files.labels import CLASSES
from carla_recap.sensors.encoding import jpeg

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from carla_recap.files.datasets import DatasetPart, LabelledFrame

_IMAGES: Final = "images"
_ANNOTATIONS: Final = "annotations"
_NUMBERS: Final = {"person": 1, "bicycle": 2, "car": 3, "motorcycle": 4, "bus": 6, "truck": 8}  # those of COCO itself
_PEOPLE: Final = ("person",)
_BITS: Final = 5  # of a number in a character of a mask
_MORE: Final = 1 << _BITS  # this bit says that further characters follow
_FIRST: Final = ord("0")
_LONGEST: Final = 7  # characters of a number


class CocoWriter(DatasetWriter):
    """Writes what RGB cameras see, with boxes and masks."""

    tables_of_part = (_IMAGES, _ANNOTATIONS)

    def begin(self) -> None:
        """Make the folders of the sensors."""
        self._images = self._annotations = 0
        for spec in self._sensors:
            (self._folder / _IMAGES / spec.id).mkdir(parents=True)

    def add(self, frame: LabelledFrame) -> None:
        """Write a moment."""
        for spec in self._sensors:
            self._add_image(frame, spec.id)

    def _add_image(self, frame: LabelledFrame, camera: str) -> None:
        image = frame.samples[camera].data
        height, width = image.shape[:2]
        file = f"{camera}/{frame.index:06}.jpg"
        (self._folder / _IMAGES / file).write_bytes(jpeg(image))
        self._images += 1
        about = {"recording": self._name, "camera": camera, "time": round(frame.time, 6)}
        self._tables.add(_IMAGES, id=self._images, file_name=f"{self._name}/{file}", width=width, height=height, **about)
        for label in frame.labels(camera):
            self._annotations += 1
            left, top = label.corner
            rows, columns = label.mask.shape
            self._tables.add(
                _ANNOTATIONS,
                id=self._annotations,
                image_id=self._images,
                category_id=_NUMBERS[label.actor.label.coco],
                bbox=[left, top, columns, rows],
                area=label.pixels,
                iscrowd=0,
                segmentation={"size": [height, width], "counts": encoded(label.mask, label.corner, height, width)},
                actor=label.actor.id,
                truncation=round(label.truncation, 3),
                visibility=round(label.visibility, 3),
            )

    @staticmethod
    def combine(parts: Sequence[DatasetPart], folder: Path) -> None:
        """Write a folder of images for each recording and camera, and a file of annotations for each split."""
        for part in parts:
            move(part.folder / _IMAGES, folder / _IMAGES / part.name)
        (folder / _ANNOTATIONS).mkdir()
        for split, those in by_split(parts).items():
            with (folder / _ANNOTATIONS / f"instances_{split}.json").open("w", encoding="utf-8") as file:
                about = {"info": {"description": "recordings of CARLA"}, "licenses": [], "categories": _categories()}
                file.write(json.dumps(about)[:-1])
                for table in (_IMAGES, _ANNOTATIONS):
                    lines = (json.dumps(row, ensure_ascii=False) for row in _numbered(those, table))
                    file.write(f', "{table}": [')
                    for number, line in enumerate(lines):
                        file.write(f"{',' if number else ''}\n{line}")
                    file.write("\n]")
                file.write("}\n")


def encoded(mask: NDArray[np.bool_], corner: tuple[int, int], height: int, width: int) -> str:
    """Return a mask as COCO encodes it: the lengths of runs of pixels, column by column, as text.

    Given is a part of the mask from a column and a row on; all other pixels of the image are 0.
    """
    left, top = corner
    edges = np.diff(np.pad(mask.T.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    (column, start), (_, stop) = np.nonzero(edges == 1), np.nonzero(edges == -1)
    begin = (left + column) * height + top + start
    end = (left + column) * height + top + stop
    apart = begin[1:] != end[:-1]  # a run goes on at the top of the next column
    begin, end = begin[np.append(True, apart)], end[np.append(apart, True)]
    ends = np.column_stack((begin, end)).ravel()
    if ends[-1] < height * width:
        ends = np.append(ends, height * width)
    return _as_text(np.diff(ends, prepend=0))


def _as_text(lengths: NDArray[np.int64]) -> str:
    """Return numbers as text: each but the first three less the one before the last, in groups of bits, lowest first."""
    numbers = lengths.copy()
    numbers[3:] -= lengths[1:-2]
    groups = numbers[:, None] >> (_BITS * np.arange(_LONGEST + 1))
    needed = 1 + (groups[:, 1:] != groups[:, -1:]).sum(axis=1)  # those above are copies of the sign
    bits = groups[:, :-1] & (_MORE - 1)
    last = bits[np.arange(len(numbers)), needed - 1]
    needed += ((last & (_MORE >> 1)) != 0) != (numbers < 0)  # the highest bit is read as the sign
    place = np.arange(_LONGEST)
    characters = bits + _FIRST + np.where(place < needed[:, None] - 1, _MORE, 0)
    return bytes(characters[place < needed[:, None]].astype(np.uint8)).decode("ascii")


def _categories() -> list[dict[str, Any]]:
    names = sorted({each.coco for each in CLASSES}, key=_NUMBERS.__getitem__)
    return [
        {"id": _NUMBERS[name], "name": name, "supercategory": "person" if name in _PEOPLE else "vehicle"} for name in names
    ]


def _numbered(parts: Sequence[DatasetPart], table: str) -> Iterator[dict[str, Any]]:
    """Yield the rows of a table of all parts, whose ids go on from part to part."""
    images = rows = 0
    for part in parts:
        count = 0
        for row in part.rows(table):
            count += 1
            row["id"] += rows
            if "image_id" in row:
                row["image_id"] += images
            yield row
        rows += count
        images += count if table == _IMAGES else sum(1 for _ in part.rows(_IMAGES))
