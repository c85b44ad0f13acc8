"""Labelled datasets of what rigs see: what the formats share.

The images and points of each recording are written as a part, in a process of its own; then the parts are put together.
"""

from __future__ import annotations

import json
import math
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from shutil import rmtree
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.files.labels import image_labels, labelled_actors
from carla_recap.model.actors import HERO
from carla_recap.rendering.camera import ImageKind
from carla_recap.replay import Played
from carla_recap.replay.pose import LOCATION, rotations
from carla_recap.sensors.kinds import SENSOR_TYPES
from carla_recap.sensors.rig import SensorRig, SensorSpec
from carla_recap.sensors.sensing import sense
from carla_recap.util.files import check_folder, new_folder
from carla_recap.util.text import first_of, visible

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from carla_recap.files.labels import ImageLabel, LabelledActor
    from carla_recap.model.actors import ActorName
    from carla_recap.recording import Recording
    from carla_recap.rendering.camera import Quality
    from carla_recap.replay.player import Progress
    from carla_recap.sensors.sensing import Sample, SensedFrame

    Floats = NDArray[np.float64]
    Combine = Callable[[Sequence["DatasetPart"], Path], None]
    """A function that puts parts together: it gets them and the folder of the dataset."""

TRAIN: Final = "train"
"""The split that recordings are in unless another one is asked for."""
SPLITS: Final = (TRAIN, "val", "test")
"""The names of splits."""
OPTICAL: Final = np.array([(0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)])
"""The axes of images in those of a camera: the columns are right, down and forward."""

_PARTS: Final = ".parts"  # the folder of the parts, until they are put together
_MIRROR: Final = np.array((1.0, -1.0, 1.0, 1.0, -1.0, -1.0))  # of poses, from CARLA's axes to right-handed ones
_INSTANCES: Final = ":instances"  # after the id of a camera, that of the camera that tells actors apart; no id of a rig
_LISTED: Final = 16  # ids that an error lists
_LIDAR: Final = "lidar"
_RADAR: Final = "radar"


@dataclass(frozen=True)
class DatasetPart:
    """What was written of a recording.

    Attributes:
        name: The name of the recording in the dataset.
        folder: The folder.
        split: The split that the recording is in.
    """

    name: str
    folder: Path
    split: str = TRAIN

    def rows(self, table: str) -> Iterator[dict[str, Any]]:
        """Yield the rows of a table, as `PartTables` has written them."""
        with (self.folder / f"{table}.jsonl").open(encoding="utf-8") as file:
            for line in file:
                yield json.loads(line)


class PartTables:
    """The tables of a part, as a file with a JSON object in each line; a context manager.

    Args:
        folder: The folder of the part.
        names: The names of the tables.
    """

    def __init__(self, folder: Path, names: Iterable[str]) -> None:
        self._files = {name: (folder / f"{name}.jsonl").open("w", encoding="utf-8") for name in names}

    def add(self, table: str, **row: Any) -> None:
        """Add a row to a table."""
        self._files[table].write(json.dumps(row, ensure_ascii=False, separators=(",", ":")) + "\n")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for file in self._files.values():
            file.close()


class LabelledFrame:
    """A moment of a recording with labels.

    Args:
        sensed: What the sensors measure.
        index: The number of labelled moments before it.

    Attributes:
        index: See above.
        time: The moment, in elapsed seconds.
        samples: The samples by the ids of the sensors.
        carrier: The id of the actor that carries the rig.
        carrier_pose: Its pose in m and degrees, right-handed, (6,).
    """

    def __init__(self, sensed: SensedFrame, index: int) -> None:
        assert sensed.carrier is not None
        self.index = index
        self.time = sensed.time
        self.samples = sensed.samples
        self.carrier = sensed.carrier
        self.carrier_pose = sensed.carrier_pose
        self._sensed = sensed

    @cached_property
    def actors(self) -> list[LabelledActor]:
        """The road users, seen or not, but for the carrier, by ascending ids."""
        return labelled_actors(self._sensed)

    def type_of(self, id: int) -> str:
        """Return the blueprint of an actor."""
        return self._sensed.scene.actors[id].type_id

    def labels(self, camera: str) -> list[ImageLabel]:
        """Return the labels in the image of a camera."""
        sample = self.samples[camera]
        return image_labels(self.actors, sample.camera, self.samples[camera + _INSTANCES].data)


def rig_of(rig: SensorRig | Path | str | None, camera: str | None = None) -> SensorRig:
    """Return the rig of a dataset.

    Args:
        rig: The rig, or its file.
        camera: The id of a camera that it must have.

    Raises:
        RecapError: There is none, or it has no RGB camera, or not that one.
    """
    if rig is None:
        raise RecapError("a dataset needs a rig: --rig RIG.json (in Python, rig=...)")
    found = rig if isinstance(rig, SensorRig) else SensorRig.load(rig)
    where = "rig" if isinstance(rig, SensorRig) else str(rig)
    ids = [spec.id for spec in cameras_of(found)]
    if not ids:
        raise RecapError(f"{where}: has no sensor.camera.rgb; one at least was expected")
    if camera is not None and camera not in ids:
        raise RecapError(f"{where}: has no RGB camera {visible(camera)!r}; one of {first_of(ids, _LISTED)} was expected")
    return found


def cameras_of(rig: SensorRig) -> list[SensorSpec]:
    """Return the RGB cameras of a rig."""
    return [spec for spec in rig if spec.image is ImageKind.RGB]


def lidars_of(rig: SensorRig) -> list[SensorSpec]:
    """Return the lidars of a rig whose points have an intensity."""
    return [spec for spec in rig if spec.kind == _LIDAR]


def radars_of(rig: SensorRig) -> list[SensorSpec]:
    """Return the radars of a rig."""
    return [spec for spec in rig if spec.kind == _RADAR]


def labelled_frames(
    recording: Recording,
    sensors: Sequence[SensorSpec],
    *,
    actor: ActorName = HERO,
    start: float = 0.0,
    duration: float = 0.0,
    rate: float,
    road_map: Path | str | None = None,
    quality: Quality = "epic",
    progress: Progress | None = None,
) -> Iterator[LabelledFrame]:
    """Yield the moments of a recording with labels, at each of which all sensors measure, whatever their `sensor_tick`.

    A lidar turns once between two moments, with as many points as in a turn of its own.

    Args:
        recording: The recording; it must stay open.
        sensors: The sensors.
        actor: See `sense`.
        start: See `sense`.
        duration: The seconds of the recording; 0: all of the rest.
        rate: The moments per second.
        road_map: See `sense`.
        quality: See `sense`.
        progress: See `sense`.

    Raises:
        RecapError: See `sense`; or the actor is never there.
    """
    if not 0 < rate < math.inf:
        raise RecapError(f"a rate of {rate:g} per second; a number above 0 was expected")
    rig = SensorRig(tuple(each for spec in sensors for each in _at_rate(spec, rate)))
    frames = sense(
        recording,
        rig,
        actor=actor,
        start=start,
        duration=duration or math.inf,
        rate=rate,
        road_map=road_map,
        quality=quality,
        progress=progress,
    )
    count = 0
    for frame in frames:
        if frame.samples and not any(spec.id in frame.samples for spec in rig if spec.image is not None):
            raise RecapError(f"{recording.location}: there are no images to label, since cameras measure nothing")
        if len(frame.samples) == len(rig):
            yield LabelledFrame(frame, count)
            count += 1
    if not count:
        name = "the hero" if actor == HERO else f"actor {actor}"
        raise RecapError(f"{recording.location}: {name} is at no place in this time; there is nothing to label")


def _at_rate(spec: SensorSpec, rate: float) -> list[SensorSpec]:
    """Return a sensor that measures at each moment; with an RGB camera, one at its place that tells actors apart."""
    always = {"sensor_tick": 1 / rate}
    if spec.kind == _LIDAR and spec.number("rotation_frequency") > 0:
        points = spec.number("points_per_second") * rate / spec.number("rotation_frequency")
        always |= {"rotation_frequency": rate, "points_per_second": points}
    found = [replace(spec, attributes={**spec.attributes, **always})]
    if spec.image is ImageKind.RGB:
        type = SENSOR_TYPES["sensor.camera.instance_segmentation"]
        attributes = {name: found[0].attributes[name] for name in type.attributes}
        found.append(replace(spec, id=spec.id + _INSTANCES, type=type.name, attributes=attributes))
    return found


def played(times: Sequence[float]) -> Played:
    """Return how many moments there are, and the seconds that they span."""
    return Played(len(times), times[-1] - times[0] if times else 0.0)


def mount_of(spec: SensorSpec) -> tuple[Floats, Floats]:
    """Return the location of a sensor in the axes of its carrier, right-handed, in m, (3,), and its rotation, (3, 3)."""
    pose = np.array((spec.x, spec.y, spec.z, spec.roll, spec.pitch, spec.yaw)) * _MIRROR
    return pose[LOCATION], rotations(pose)


def intrinsics(sample: Sample) -> Floats:
    """Return the matrix that takes points in the axes of an image, in m, to pixels, (3, 3)."""
    camera = sample.camera
    focal = camera.focal_length
    return np.array([(focal, 0.0, camera.width / 2), (0.0, focal, camera.height / 2), (0.0, 0.0, 1.0)])


def world_points(sample: Sample) -> Floats:
    """Return the points of a lidar in the world, in m, (n, 3)."""
    points = np.stack([sample.data[axis] for axis in "xyz"], axis=1).astype(np.float64)
    found: Floats = points @ rotations(sample.pose).T + sample.pose[LOCATION]
    return found


@contextmanager
def dataset_folder(folder: Path | str, *, force: bool) -> Iterator[tuple[Path, Path]]:
    """Yield a folder for a dataset and one in it for parts, which is removed; the dataset appears at the end of the block.

    Raises:
        RecapError: See `check_folder` and `new_folder`.
    """
    check_folder(folder, force=force)
    with new_folder(folder) as partial:
        parts = partial / _PARTS
        parts.mkdir()
        yield partial, parts
        rmtree(parts)


def move(source: Path, destination: Path) -> None:
    """Move a file or a folder within a dataset."""
    destination.parent.mkdir(parents=True, exist_ok=True)
    source.rename(destination)


def by_split(parts: Iterable[DatasetPart]) -> Mapping[str, list[DatasetPart]]:
    """Return the parts of each split that has any, in the order of the parts."""
    found: dict[str, list[DatasetPart]] = {}
    for part in parts:
        found.setdefault(part.split, []).append(part)
    return found
