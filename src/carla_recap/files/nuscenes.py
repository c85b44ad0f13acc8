"""Datasets in the schema of nuScenes: cameras, lidars and radars, boxes in the world, and 13 tables.

Axes of the world, the carrier and the lidars are right-handed: x forward, y left, z up; those of cameras are x right,
y down, z forward. Units are m, s and microseconds; rotations are quaternions w, x, y, z.
"""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import dataclass, field
from hashlib import md5
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.files.datasets import OPTICAL, SPLITS, DatasetWriter, intrinsics, mount_of, move, world_points
from carla_recap.files.labels import CLASSES
from carla_recap.replay.pose import LOCATION, quaternions_of, rotations
from carla_recap.sensors.encoding import jpeg, png

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from carla_recap.files.datasets import DatasetPart, LabelledFrame
    from carla_recap.files.labels import LabelledActor
    from carla_recap.sensors.sensing import Sample
    from carla_recap.util.arrays import Floats


VERSION: Final = "v1.0-carla"
"""The folder of the tables, which is the version that nuscenes-devkit is asked for."""
TABLES: Final = (
    "attribute",
    "calibrated_sensor",
    "category",
    "ego_pose",
    "instance",
    "log",
    "map",
    "sample",
    "sample_annotation",
    "sample_data",
    "scene",
    "sensor",
    "visibility",
)
"""The names of the tables."""

_SAMPLES: Final = "samples"
_LEVELS: Final = {"1": (0, 40), "2": (40, 60), "3": (60, 80), "4": (80, 100)}  # percent that is visible
_STEPS: Final = 255.0  # of the intensity of a lidar
_MAP_SIZE: Final = 8  # pixels
_RADAR_POINT: Final = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z")),
        ("dyn_prop", "i1"),
        ("id", "<i2"),
        *((name, "<f4") for name in ("rcs", "vx", "vy", "vx_comp", "vy_comp")),
        *((name, "i1") for name in ("is_quality_valid", "ambig_state", "x_rms", "y_rms", "invalid_state", "pdh0", "vx_rms")),
        ("vy_rms", "i1"),
    ]
)
_UNAMBIGUOUS: Final = 3  # of `ambig_state`


def _token(*parts: object) -> str:
    """Return the token of what is called by some words and numbers."""
    return md5("\n".join(map(str, parts)).encode("utf-8", "surrogateescape"), usedforsecurity=False).hexdigest()


@dataclass
class _Instance:
    """A road user of a scene: its category, the number of its annotations, and the tokens of the first and the last."""

    category: str
    count: int = 0
    first: str = ""
    last: str = ""


@dataclass
class _Keyframe:
    """A sample that waits for the next one, whose tokens it has."""

    index: int
    timestamp: int
    annotations: dict[int, dict[str, Any]] = field(default_factory=dict)
    data: dict[str, dict[str, Any]] = field(default_factory=dict)


class NuScenesWriter(DatasetWriter):
    """Writes what RGB cameras, lidars and radars see as a scene.

    Road users have a box at the moments at which a camera has a pixel or a lidar has a point of them.
    """

    rate = 2.0
    kinds = ("lidar", "radar")
    tables_of_part = TABLES

    def begin(self) -> None:
        """Make the folders of the sensors."""
        self._times: list[float] = []
        self._scene = _token("scene", self._name)
        self._instances: dict[str, _Instance] = {}
        self._waiting: _Keyframe | None = None
        for spec in self._sensors:
            (self._folder / _SAMPLES / spec.id).mkdir(parents=True)

    def add(self, frame: LabelledFrame) -> None:
        """Write a moment."""
        if not self._times:
            self._add_sensors(frame)
        self._times.append(frame.time)
        moment = _Keyframe(frame.index, round((self._recording.header.date + frame.time) * 1e6))
        points = [world_points(frame.samples[spec.id]) for spec in self._sensors if spec.kind == "lidar"]
        detections = [_radar_points(frame.samples[spec.id]) for spec in self._sensors if spec.kind == "radar"]
        for spec in self._sensors:
            self._add_data(frame.samples[spec.id], frame, moment)
        seen: dict[int, float] = {}
        for spec in self._sensors:
            if spec.image is not None:
                for label in frame.labels(spec.id):
                    seen[label.actor.id] = max(seen.get(label.actor.id, 0.0), label.visibility)
        for actor in frame.actors:
            hits = sum(actor.hits(each) for each in points)
            if hits or actor.id in seen:
                echoes = sum(actor.hits(each) for each in detections)
                moment.annotations[actor.id] = self._annotation(actor, frame, moment, seen.get(actor.id, 0.0), hits, echoes)
        self._release(moment)
        self._waiting = moment

    def finish(self) -> None:
        """Write the last moment, and what is known only at the end."""
        self._release(None)
        for token, instance in self._instances.items():
            self._tables.add(
                "instance",
                token=token,
                category_token=_token("category", instance.category),
                nbr_annotations=instance.count,
                first_annotation_token=instance.first,
                last_annotation_token=instance.last,
            )
        header, count = self._recording.header, len(self._times)
        log = _token("log", self._name)
        self._tables.add(
            "scene",
            token=self._scene,
            log_token=log,
            nbr_samples=count,
            first_sample_token=self._sample(0),
            last_sample_token=self._sample(count - 1),
            name=self._name,
            description=f"{header.map_name}, from {self._times[0]:g} s to {self._times[-1]:g} s",
        )
        date = np.datetime64(int(header.date), "s").astype("datetime64[D]")
        self._tables.add("log", token=log, logfile=self._name, vehicle="", date_captured=str(date), location=header.map_name)

    @staticmethod
    def combine(parts: Sequence[DatasetPart], folder: Path) -> None:
        """Write the tables with a scene for each recording, whose split is in `splits.json`."""
        (folder / VERSION).mkdir()
        for part in parts:
            for source in sorted((part.folder / _SAMPLES).iterdir()):
                move(source, folder / _SAMPLES / source.name / part.name)
        image = f"maps/{_token('map')}.png"
        (folder / "maps").mkdir()
        (folder / image).write_bytes(png(np.zeros((_MAP_SIZE, _MAP_SIZE), np.uint8)))
        logs = [row["token"] for part in parts for row in part.rows("log")]
        fixed: dict[str, list[dict[str, Any]]] = {
            "category": [
                {"token": _token("category", name), "name": name, "description": "", "index": index}
                for index, name in enumerate(sorted({each.nuscenes for each in CLASSES}), 1)
            ],
            "visibility": [
                {"token": level, "level": f"v{least}-{most}", "description": f"{least} to {most} % are visible"}
                for level, (least, most) in _LEVELS.items()
            ],
            "map": [{"token": _token("map"), "log_tokens": logs, "category": "semantic_prior", "filename": image}],
        }
        with ExitStack() as stack:
            for table in TABLES:
                rows = fixed[table] if table in fixed else _rows(parts, table)
                file = stack.enter_context((folder / VERSION / f"{table}.json").open("w", encoding="utf-8"))
                file.write("[")
                for number, row in enumerate(rows):
                    file.write(f"{',' if number else ''}\n{json.dumps(row, ensure_ascii=False)}")
                file.write("\n]\n")
        splits = {name: [part.name for part in parts if part.split == name] for name in SPLITS}
        (folder / VERSION / "splits.json").write_text(json.dumps(splits, ensure_ascii=False, indent=1) + "\n", "utf-8")

    def _sample(self, index: int) -> str:
        return _token("sample", self._name, index)

    def _add_sensors(self, frame: LabelledFrame) -> None:
        """Write where the sensors are."""
        for spec in self._sensors:
            location, rotation = mount_of(spec)
            matrix: list[list[float]] = []
            if spec.image is not None:
                rotation, matrix = rotation @ OPTICAL, intrinsics(frame.samples[spec.id]).tolist()
            modality = "camera" if spec.image is not None else spec.kind
            self._tables.add("sensor", token=_token("sensor", spec.id), channel=spec.id, modality=modality)
            self._tables.add(
                "calibrated_sensor",
                token=_token("calibrated", self._name, spec.id),
                sensor_token=_token("sensor", spec.id),
                translation=location.tolist(),
                rotation=_quaternion(rotation),
                camera_intrinsic=matrix,
            )

    def _add_data(self, sample: Sample, frame: LabelledFrame, moment: _Keyframe) -> None:
        """Write the file of a sample, and begin its row."""
        spec = sample.spec
        height = width = 0
        if spec.image is not None:
            content, suffix = jpeg(sample.data), "jpg"
            height, width = sample.data.shape[:2]
        elif spec.kind == "lidar":
            content, suffix = _lidar_file(sample), "pcd.bin"
        else:
            content, suffix = _radar_file(sample), "pcd"
        file = f"{spec.id}/{moment.timestamp}.{suffix}"
        (self._folder / _SAMPLES / file).write_bytes(content)
        token = _token("data", self._name, spec.id, frame.index)
        location, rotation = frame.carrier_pose[LOCATION], rotations(frame.carrier_pose)
        self._tables.add(
            "ego_pose",
            token=token,
            timestamp=moment.timestamp,
            translation=location.tolist(),
            rotation=_quaternion(rotation),
        )
        moment.data[spec.id] = {
            "token": token,
            "sample_token": self._sample(frame.index),
            "ego_pose_token": token,
            "calibrated_sensor_token": _token("calibrated", self._name, spec.id),
            "filename": f"{_SAMPLES}/{spec.id}/{self._name}/{moment.timestamp}.{suffix}",
            "fileformat": suffix.partition(".")[0],
            "width": width,
            "height": height,
            "timestamp": moment.timestamp,
            "is_key_frame": True,
            "prev": self._waiting.data[spec.id]["token"] if self._waiting else "",
        }

    def _annotation(
        self, actor: LabelledActor, frame: LabelledFrame, moment: _Keyframe, visibility: float, hits: int, echoes: int
    ) -> dict[str, Any]:
        """Return the row of a road user at a moment, but for the next one."""
        instance = _token("instance", self._name, actor.id, frame.type_of(actor.id))
        token = _token("annotation", instance, moment.index)
        about = self._instances.setdefault(instance, _Instance(actor.label.nuscenes))
        about.count += 1
        about.first, about.last = about.first or token, token
        before = self._waiting.annotations.get(actor.id) if self._waiting else None
        length, width, height = (2 * actor.half_extents).tolist()
        level = next(level for level, (_, most) in _LEVELS.items() if 100 * visibility <= most)
        return {
            "token": token,
            "sample_token": self._sample(moment.index),
            "instance_token": instance,
            "visibility_token": level,
            "attribute_tokens": [],
            "translation": actor.center.tolist(),
            "size": [width, length, height],
            "rotation": _quaternion(actor.rotation),
            "prev": before["token"] if before and before["instance_token"] == instance else "",
            "num_lidar_pts": hits,
            "num_radar_pts": echoes,
        }

    def _release(self, following: _Keyframe | None) -> None:
        """Write the moment that waits, now that the next one is known."""
        moment = self._waiting
        if moment is None:
            return
        self._tables.add(
            "sample",
            token=self._sample(moment.index),
            timestamp=moment.timestamp,
            scene_token=self._scene,
            prev=self._sample(moment.index - 1) if moment.index else "",
            next=self._sample(moment.index + 1) if following else "",
        )
        for id, row in moment.data.items():
            self._tables.add("sample_data", **row, next=following.data[id]["token"] if following else "")
        for number, row in moment.annotations.items():
            after = following.annotations.get(number) if following else None
            follows = after is not None and after["prev"] == row["token"]
            self._tables.add("sample_annotation", **row, next=after["token"] if after and follows else "")


def _quaternion(matrix: Floats) -> list[float]:
    """Return a rotation as a quaternion w, x, y, z."""
    x, y, z, w = quaternions_of(matrix).tolist()
    return [w, x, y, z]


def _lidar_file(sample: Sample) -> bytes:
    """Return the points of a lidar: x, y, z, the intensity from 0 to 255, and the channel, from the lowest one."""
    points, number = sample.data, sample.spec.number
    rows = np.empty((len(points), 5), "<f4")
    for column, axis in enumerate("xyz"):
        rows[:, column] = points[axis]
    rows[:, 3] = points["intensity"] * _STEPS
    channels, low, high = number("channels"), number("lower_fov"), number("upper_fov")
    pitch = np.degrees(np.arctan2(rows[:, 2], np.hypot(rows[:, 0], rows[:, 1])))
    step = (high - low) / (channels - 1) if channels > 1 else 0.0
    rows[:, 4] = np.clip(np.rint((pitch - low) / step), 0, channels - 1) if step else 0.0
    return rows.tobytes()


def _radar_points(sample: Sample) -> Floats:
    """Return the detections of a radar as points in the world, in m, (n, 3)."""
    found: Floats = _directions(sample) * sample.data["depth"][:, None] @ rotations(sample.pose).T + sample.pose[LOCATION]
    return found


def _directions(sample: Sample) -> Floats:
    azimuth, altitude = (sample.data[name].astype(np.float64) for name in ("azimuth", "altitude"))
    return np.stack((np.cos(altitude) * np.cos(azimuth), np.cos(altitude) * np.sin(azimuth), np.sin(altitude)), axis=1)


def _radar_file(sample: Sample) -> bytes:
    """Return the detections of a radar as a PCD file, whose fields are those of nuScenes; velocities are along the ray.

    In those that are compensated, what stands in the world has none.
    """
    points = np.zeros(len(sample.data), _RADAR_POINT)
    directions = _directions(sample)
    places = directions * sample.data["depth"][:, None]
    own = np.zeros(3) if sample.velocity is None else sample.velocity @ rotations(sample.pose)
    relative = directions * sample.data["velocity"][:, None]
    compensated = relative + directions * (directions @ own)[:, None]
    for axis, name in enumerate("xyz"):
        points[name] = places[:, axis]
    for axis, name in enumerate(("vx", "vy")):
        points[name], points[f"{name}_comp"] = relative[:, axis], compensated[:, axis]
    points["id"] = np.arange(len(points)) % (1 << 15)
    points["is_quality_valid"], points["ambig_state"] = 1, _UNAMBIGUOUS
    types = [_RADAR_POINT[name] for name in _RADAR_POINT.names or ()]
    header = (
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        f"FIELDS {' '.join(_RADAR_POINT.names or ())}",
        f"SIZE {' '.join(str(each.itemsize) for each in types)}",
        f"TYPE {' '.join(each.kind.upper() for each in types)}",
        f"COUNT {' '.join('1' for _ in types)}",
        f"WIDTH {len(points)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(points)}",
        "DATA binary",
    )
    # The devkit expects something behind the last point.
    return "".join(f"{line}\n" for line in header).encode("ascii") + points.tobytes() + b"\n"


def _rows(parts: Iterable[DatasetPart], table: str) -> Iterator[dict[str, Any]]:
    """Yield the rows of a table of all parts; of sensors, which parts may have in common, each once."""
    known: set[str] = set()
    for part in parts:
        for row in part.rows(table):
            if table == "sensor":
                if row["token"] in known:
                    continue
                known.add(row["token"])
            yield row
