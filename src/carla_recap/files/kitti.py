"""Datasets in the layout of KITTI's object detection: images of a camera, points of a lidar, labels, calibration.

Axes of the camera: x right, y down, z forward; of the lidar: x forward, y left, z up. Units are m, radians and pixels.
"""

from __future__ import annotations

import csv
import math
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.files.datasets import OPTICAL, DatasetWriter, by_split, intrinsics, mount_of, move
from carla_recap.replay.pose import LOCATION, rotations
from carla_recap.sensors.encoding import png

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from carla_recap.files.datasets import DatasetPart, LabelledFrame
    from carla_recap.files.labels import ImageLabel
    from carla_recap.sensors.rig import SensorSpec
    from carla_recap.sensors.sensing import Sample

_IMAGES: Final = "image_2"
_POINTS: Final = "velodyne"
_LABELS: Final = "label_2"
_CALIBRATION: Final = "calib"
_SUFFIXES: Final = {_IMAGES: "png", _POINTS: "bin", _LABELS: "txt", _CALIBRATION: "txt"}
_VISIBLE: Final = (0.8, 0.4)  # the least visibility of what is fully and of what is partly visible
_FRAMES: Final = "frames"


class KittiWriter(DatasetWriter):
    """Writes what a camera and a lidar see."""

    kinds = ("lidar",)
    has_one = True
    tables_of_part = (_FRAMES,)

    def begin(self) -> None:
        """Make the folders of the sensors."""
        self._camera, *lidars = self._sensors
        self._lidar = lidars[0] if lidars else None
        for kind, suffix in _SUFFIXES.items():
            if suffix != "bin" or lidars:
                (self._folder / kind).mkdir()

    def add(self, frame: LabelledFrame) -> None:
        """Write a moment."""
        sample = frame.samples[self._camera.id]
        lines = [_line(label, sample) for label in frame.labels(self._camera.id)]
        files = {
            _IMAGES: png(sample.data),
            _LABELS: "".join(lines).encode("ascii"),
            _CALIBRATION: _calibration(sample, self._lidar).encode("ascii"),
        }
        if self._lidar is not None:
            files[_POINTS] = frame.samples[self._lidar.id].data.tobytes()
        for kind, content in files.items():
            (self._folder / kind / f"{frame.index:06}.{_SUFFIXES[kind]}").write_bytes(content)
        self._tables.add(_FRAMES, time=round(frame.time, 6))

    @staticmethod
    def combine(parts: Sequence[DatasetPart], folder: Path) -> None:
        """Number the frames in the order of the parts.

        `ImageSets` has the numbers of each split, and `recordings.csv` says of each where it comes from.
        """
        (folder / "ImageSets").mkdir()
        first: dict[str, int] = {}
        count = 0
        with (folder / "recordings.csv").open("w", encoding="utf-8", newline="") as file:
            table = csv.writer(file)
            table.writerow(("frame", "recording", "time", "split"))
            for part in parts:
                first[part.name] = count
                for index, row in enumerate(part.rows(_FRAMES)):
                    for kind, suffix in _SUFFIXES.items():
                        source = part.folder / kind / f"{index:06}.{suffix}"
                        if source.exists():
                            move(source, folder / "training" / kind / f"{count:06}.{suffix}")
                    table.writerow((f"{count:06}", part.name, row["time"], part.split))
                    count += 1
        for split, those in by_split(parts).items():
            numbers = (first[part.name] + index for part in those for index, _ in enumerate(part.rows(_FRAMES)))
            lines = "".join(f"{number:06}\n" for number in numbers)
            (folder / "ImageSets" / f"{split}.txt").write_text(lines, "ascii")


def _line(label: ImageLabel, sample: Sample) -> str:
    """Return the line of a label: 15 columns."""
    actor = label.actor.upright()
    axes = rotations(sample.pose) @ OPTICAL
    length, width, height = 2 * actor.half_extents
    bottom = actor.center - actor.rotation[:, 2] * actor.half_extents[2]
    x, y, z = (bottom - sample.pose[LOCATION]) @ axes
    forward = actor.rotation[:, 0] @ axes
    rotation = -math.atan2(forward[2], forward[0])
    alpha = math.remainder(rotation - math.atan2(x, z), math.tau)
    fully, partly = _VISIBLE
    occluded = 0 if label.visibility >= fully else 1 if label.visibility >= partly else 2
    numbers = (alpha, *label.box, height, width, length, x, y, z, rotation)
    written = " ".join(f"{number:.2f}" for number in numbers)
    return f"{label.actor.label.kitti} {label.truncation:.2f} {occluded} {written}\n"


def _calibration(sample: Sample, lidar: SensorSpec | None) -> str:
    """Return the calibration of a camera and a lidar, in the names of KITTI."""
    projection = np.hstack((intrinsics(sample), np.zeros((3, 1))))
    location, rotation = mount_of(sample.spec)
    axes = rotation @ OPTICAL
    place, turned = mount_of(lidar) if lidar is not None else (location, rotation)
    matrices = {
        **{f"P{number}": projection for number in range(4)},
        "R0_rect": np.eye(3),
        "Tr_velo_to_cam": np.column_stack((axes.T @ turned, axes.T @ (place - location))),
        "Tr_imu_to_velo": np.column_stack((turned.T, -turned.T @ place)),
    }
    return "".join(f"{name}: {' '.join(f'{value:.12e}' for value in matrix.flat)}\n" for name, matrix in matrices.items())
