"""Labelled datasets of what rigs see: what the formats share.

The images and points of each recording are written as a part, in a process of its own; then the parts are put together.
"""

from __future__ import annotations

import json
import warnings
from abc import ABC, abstractmethod
from contextlib import closing, contextmanager
from dataclasses import dataclass, fields, replace
from functools import cached_property
from shutil import rmtree
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self

import numpy as np

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.files.labels import image_labels, labelled_actors
from carla_recap.model.lives import HERO
from carla_recap.rendering.camera import ImageKind
from carla_recap.replay import Played
from carla_recap.replay.pose import LOCATION, rotations
from carla_recap.sensors.kinds import SENSOR_TYPES
from carla_recap.sensors.options import SensingKeywords, SensingOptions
from carla_recap.sensors.rig import SensorRig, as_rig
from carla_recap.sensors.sensing import sensed_frames
from carla_recap.util.files import new_folder

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path
    from typing import Unpack

    from carla_recap.files.labels import ImageLabel, LabelledActor
    from carla_recap.recording import Recording
    from carla_recap.replay.player import Progress
    from carla_recap.sensors.rig import SensorSpec
    from carla_recap.sensors.sensing import Sample, SensedFrame
    from carla_recap.util.arrays import Floats


TRAIN: Final = "train"
"""The split that recordings are in unless another one is asked for."""
SPLITS: Final = (TRAIN, "val", "test")
"""The names of splits."""
OPTICAL: Final = np.array([(0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)])
"""The axes of images in those of a camera: the columns are right, down and forward."""

_PARTS: Final = ".parts"  # the folder of the parts, until they are put together
_MIRROR: Final = np.array((1.0, -1.0, 1.0, 1.0, -1.0, -1.0))  # of poses, from CARLA's axes to right-handed ones
_INSTANCES: Final = ":instances"  # after the id of a camera, that of the camera that tells actors apart; no id of a rig
_ELSEWHERE: Final = "--actor ID (in Python, actor=ID) puts the rig on another actor"
_LIDAR: Final = "lidar"


@dataclass(frozen=True)
class DatasetPart:
    """What was written of a recording."""

    name: str  # of the recording in the dataset
    folder: Path
    split: str = TRAIN  # that the recording is in

    def rows(self, table: str) -> Iterator[dict[str, Any]]:
        """Yield the rows of a table, as `PartTables` has written them."""
        with (self.folder / f"{table}.jsonl").open(encoding="utf-8") as file:
            for line in file:
                yield json.loads(line)


class PartTables:
    """The tables of a part by name, as a file with a JSON object in each line; a context manager."""

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
    """A moment of a recording with labels, of what the sensors measure."""

    has_labels = False  # whether an image of those that were asked about so far has labels

    def __init__(self, sensed: SensedFrame, index: int) -> None:
        assert sensed.carrier is not None
        self.index = index  # the number of labelled moments before it
        self.time = sensed.time  # in elapsed seconds
        self.samples = sensed.samples  # by the ids of the sensors
        self.carrier = sensed.carrier  # the id of the actor that carries the rig
        self.carrier_pose = sensed.carrier_pose  # in m and degrees, right-handed, (6,)
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
        found = image_labels(self.actors, sample.camera, self.samples[camera + _INSTANCES].data)
        self.has_labels = self.has_labels or bool(found)
        return found


class DatasetWriter(ABC):
    """Writes the part of a dataset that is of a recording, and puts parts together; a class for each format."""

    rate: ClassVar[float] = 10.0  # the usual moments per second
    kinds: ClassVar[tuple[str, ...]] = ()  # of sensors that the format has besides RGB cameras
    has_one: ClassVar[bool] = False  # whether it has one camera and one sensor of each kind; else all that the rig has
    tables_of_part: ClassVar[tuple[str, ...]]  # the names of the tables of a part

    def __init__(
        self, recording: Recording, sensors: Sequence[SensorSpec], name: str, folder: Path, tables: PartTables
    ) -> None:
        self._recording, self._sensors, self._name = recording, sensors, name
        self._folder, self._tables = folder, tables
        self.begin()

    @classmethod
    def options(cls) -> set[str]:
        """Return the names of the options of an export in this format."""
        return {"rig", *(each.name for each in fields(SensingOptions)), *(("camera",) if cls.has_one else ())}

    @classmethod
    def sensors_of(cls, rig: SensorRig, camera: str | None = None) -> list[SensorSpec]:
        """Return the sensors of a rig that the format has; the camera of formats that have one, None: the first one."""
        cameras = rig.rgb_cameras(None if camera is None else [camera])
        groups = [cameras, *([spec for spec in rig if spec.kind == kind] for kind in cls.kinds)]
        return [spec for group in groups for spec in (group[:1] if cls.has_one else group)]

    @abstractmethod
    def begin(self) -> None:
        """Make the folders of the sensors."""

    @abstractmethod
    def add(self, frame: LabelledFrame) -> None:
        """Write a moment."""

    def finish(self) -> None:
        """Write what is known only at the end."""
        return

    @staticmethod
    @abstractmethod
    def combine(parts: Sequence[DatasetPart], folder: Path) -> None:
        """Put parts together, whose files are moved, in the folder of the dataset."""


def write_part(
    dataset: type[DatasetWriter],
    recording: Recording,
    folder: Path,
    *,
    name: str,
    rig: SensorRig | Path | str | None = None,
    camera: str | None = None,
    progress: Progress | None = None,
    **options: Unpack[SensingKeywords],
) -> Played:
    """Write the part of a dataset that is of a recording: what a rig would have seen, with labels.

    The folder of the part is there and empty, and the recording has a name in the dataset. The rate is that of the format
    unless the options give one. Return the number of moments, and the seconds that they span. A `RecapWarning` says that no
    image has labels, a `RecapError` that there is no rig, or no such camera; see `sense` for others.
    """
    if rig is None:
        raise RecapError("a dataset needs a rig: --rig RIG.json (in Python, rig=...)")
    sensors = dataset.sensors_of(as_rig(rig), camera)
    sensing = SensingOptions(**SensingKeywords(rate=dataset.rate) | options)
    times: list[float] = []
    has_labels = False
    with PartTables(folder, dataset.tables_of_part) as tables:
        part = dataset(recording, sensors, name, folder, tables)
        for frame in labelled_frames(recording, sensors, sensing, progress):
            part.add(frame)
            times.append(frame.time)
            has_labels = has_labels or frame.has_labels
        part.finish()
    if not has_labels:
        text = f"no other road user is seen in any image, so that there are no labels; {_ELSEWHERE}"
        warnings.warn(f"{recording.location}: {text}", RecapWarning, stacklevel=3)
    return Played(len(times), times[-1] - times[0])


def labelled_frames(
    recording: Recording, sensors: Sequence[SensorSpec], options: SensingOptions, progress: Progress | None = None
) -> Iterator[LabelledFrame]:
    """Yield the moments of a recording with labels, at each of which all sensors measure, whatever their `sensor_tick`.

    A lidar turns once between two moments, with as many points as in a turn of its own. The options have a rate. A
    `RecapError` says that the actor is never there; see `sense` for others.
    """
    assert options.rate is not None
    rig = SensorRig(tuple(each for spec in sensors for each in _at_rate(spec, options.rate)))
    count = 0
    with closing(sensed_frames(recording, rig, options, progress)) as frames:
        for frame in frames:
            if frame.samples and not any(spec.id in frame.samples for spec in rig if spec.image is not None):
                raise RecapError(f"{recording.location}: there are no images to label, since cameras measure nothing")
            if len(frame.samples) == len(rig):
                yield LabelledFrame(frame, count)
                count += 1
    if not count:
        name = "the hero" if options.actor == HERO else f"actor {options.actor}"
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
    """Yield a folder for a dataset and one in it for parts, which is removed; the dataset appears at the end."""
    with new_folder(folder, force=force) as partial:
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
