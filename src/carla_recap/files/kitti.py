"""Datasets in the layout of KITTI's object detection: images of a camera, points of a lidar, labels, calibration.

Axes of the camera: x right, y down, z forward; of the lidar: x forward, y left, z up. Units are m, radians and pixels.
"""

from __future__ import annotations

import csv
import math
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.files.datasets import (
    OPTICAL,
    PartTables,
    by_split,
    cameras_of,
    intrinsics,
    labelled_frames,
    lidars_of,
    mount_of,
    move,
    played,
    rig_of,
)
from carla_recap.model.actors import HERO
from carla_recap.replay.pose import LOCATION, rotations
from carla_recap.sensors.encoding import png

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from carla_recap.files.datasets import DatasetPart
    from carla_recap.files.labels import ImageLabel
    from carla_recap.model.actors import ActorName
    from carla_recap.recording import Recording
    from carla_recap.rendering.camera import Quality
    from carla_recap.replay import Played
    from carla_recap.replay.player import Progress
    from carla_recap.sensors.rig import SensorRig, SensorSpec
    from carla_recap.sensors.sensing import Sample

    Floats = NDArray[np.float64]

_IMAGES: Final = "image_2"
_POINTS: Final = "velodyne"
_LABELS: Final = "label_2"
_CALIBRATION: Final = "calib"
_SUFFIXES: Final = {_IMAGES: "png", _POINTS: "bin", _LABELS: "txt", _CALIBRATION: "txt"}
_VISIBLE: Final = (0.8, 0.4)  # the least visibility of what is fully and of what is partly visible
_FRAMES: Final = "frames"


def write_kitti(
    recording: Recording,
    folder: Path,
    *,
    rig: SensorRig | Path | str | None = None,
    camera: str | None = None,
    actor: ActorName = HERO,
    start: float = 0.0,
    duration: float = 0.0,
    rate: float = 10.0,
    opendrive: Path | str | None = None,
    quality: Quality = "epic",
    name: str = "",
    progress: Progress | None = None,
) -> Played:
    """Write what a camera and the first lidar of a rig see of a recording, with labels, as a part of a dataset.

    Args:
        recording: The recording.
        folder: The folder of the part, which is there.
        rig: The rig, or its file.
        camera: The id of the camera; None: the first one.
        actor: The actor that carries the rig: an id or "hero".
        start: The elapsed seconds to begin at; negative: before the end.
        duration: The seconds of the recording; 0: all of the rest.
        rate: The moments per second.
        opendrive: The map of the town, an OpenDRIVE file.
        quality: The quality of images: "low" has neither shadows nor smooth edges, "epic" has both.
        name: The name of the recording in the dataset.
        progress: Is given the stream of scenes and their player, and passes the scenes on.

    Returns:
        The number of moments, and the seconds that they span.

    Raises:
        RecapError: The rig has no such camera; see `sense` for others.
        MissingExtra: An optional dependency is not installed.
    """
    rig = rig_of(rig, camera)
    seen = next(spec for spec in cameras_of(rig) if camera in (None, spec.id))
    lidar = next(iter(lidars_of(rig)), None)
    for kind, suffix in _SUFFIXES.items():
        if suffix != "bin" or lidar is not None:
            (folder / kind).mkdir()
    frames = labelled_frames(
        recording,
        [seen] if lidar is None else [seen, lidar],
        actor=actor,
        start=start,
        duration=duration,
        rate=rate,
        road_map=opendrive,
        quality=quality,
        progress=progress,
    )
    times = []
    with PartTables(folder, [_FRAMES]) as tables:
        for frame in frames:
            stem = f"{frame.index:06}"
            sample = frame.samples[seen.id]
            (folder / _IMAGES / f"{stem}.png").write_bytes(png(sample.data))
            lines = [_line(label, sample) for label in frame.labels(seen.id)]
            (folder / _LABELS / f"{stem}.txt").write_text("".join(lines), "ascii")
            (folder / _CALIBRATION / f"{stem}.txt").write_text(_calibration(sample, lidar), "ascii")
            if lidar is not None:
                (folder / _POINTS / f"{stem}.bin").write_bytes(frame.samples[lidar.id].data.tobytes())
            tables.add(_FRAMES, time=round(frame.time, 6))
            times.append(frame.time)
    return played(times)


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


def combine_kitti(parts: Sequence[DatasetPart], folder: Path) -> None:
    """Put parts together: their frames are numbered in the order of the parts.

    `ImageSets` has the numbers of each split, and `recordings.csv` says of each where it comes from.

    Args:
        parts: The parts, whose files are moved.
        folder: The folder of the dataset.
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
