"""What the process that casts rays runs: the lidars and radars of a rig; see `carla_recap.sensors.ray_process`."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.rendering.rays import RayScene, SurfaceHits
from carla_recap.replay.pose import LOCATION, MIRROR, rotations
from carla_recap.replay.selection import find
from carla_recap.scene.models import MODELS
from carla_recap.sensors.beams import LidarBeams, LidarReturns, RadarBeams, detections
from carla_recap.sensors.ray_process import MAX_STEP
from carla_recap.util.child import answer_requests

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from carla_recap.scene.instances import Instances
    from carla_recap.sensors.ray_process import Points, RayMoment, RaySetup
    from carla_recap.sensors.rig import SensorSpec
    from carla_recap.util.arrays import Floats

POINT: Final = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
"""A point of a lidar: x forward, y left, z up in m; the intensity from 0 to 1."""
SEMANTIC_POINT: Final = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("cosine", "<f4"), ("actor", "<u4"), ("tag", "<u4")]
)
"""A point of a semantic lidar: x forward, y left, z up in m; the cosine of the incident angle; the actor or 0; the tag."""
DETECTION: Final = np.dtype([("velocity", "<f4"), ("azimuth", "<f4"), ("altitude", "<f4"), ("depth", "<f4")])
"""A detection of a radar: velocity in m/s, positive away; angles to the left and upwards in radians; depth in m."""
_RAYS_OF_A_PART: Final = 1 << 16  # cast by one thread at a time
_MOST_THREADS: Final = 3  # that cast rays; more wait for Python's lock


class RaySensors:
    """The lidars and radars of a rig. Moments come in order of time."""

    def __init__(self, setup: RaySetup) -> None:
        for model in setup.models:
            MODELS.append(model)
        self._scene = RayScene(setup.tiles, MODELS)
        self._said: list[str] = []
        self._sensors = {spec.id: _SENSORS[spec.kind](spec, self._said.append) for spec in setup.specs}
        self._threads = ThreadPoolExecutor(min(os.cpu_count() or 1, _MOST_THREADS), "carla-recap-rays")

    def begin(self, moment: RayMoment) -> Callable[[], tuple[Points, list[str]]]:
        """Begin to cast the rays of a moment; return what waits for what sensors measure, by their ids, and warnings."""
        begun = []
        for id, pose in moment.due:
            sensor = self._sensors[id]
            rays, turn = sensor.rays(moment), MIRROR[:, None] * rotations(pose).T
            firsts = range(0, max(len(rays), 1), _RAYS_OF_A_PART)
            parts = [rays[first : first + _RAYS_OF_A_PART] for first in firsts]
            cast = [
                self._threads.submit(self._cast, pose[LOCATION], turn, part, sensor.reach, moment.instances)
                for part in parts
            ]
            begun.append((sensor, id, pose, rays, firsts, cast))

        def measured() -> tuple[Points, list[str]]:
            found = {
                id: sensor.measure(moment, pose, SurfaceHits.joined([part.result() for part in cast], firsts), rays)
                for sensor, id, pose, rays, firsts, cast in begun
            }
            said, self._said[:] = self._said[:], []
            return found, said

        return measured

    def _cast(self, place: Floats, turn: Floats, rays: Floats, reach: float, instances: Instances) -> SurfaceHits:
        return self._scene.cast(place, rays @ turn, reach, instances)


class _RaySensor(ABC):
    """A lidar or radar. Its moments come in order of time."""

    beams: LidarBeams | RadarBeams

    def __init__(self, spec: SensorSpec, warn: Callable[[str], None]) -> None:
        self._warn: Callable[[str], None] = lambda text: warn(f"sensor {spec.id!r}: {text}")
        self._interval = spec.number("sensor_tick")
        self.reach = spec.number("range")

    def rays(self, moment: RayMoment) -> Floats:
        """Return the directions of the rays in its axes, CARLA's, (n, 3)."""
        return self.beams.rays(min(max(moment.step, self._interval), MAX_STEP))

    @abstractmethod
    def measure(self, moment: RayMoment, pose: Floats, hits: SurfaceHits, directions: Floats) -> NDArray[np.void]:
        """Return what it measures."""


def _points(hits: SurfaceHits, directions: Floats, dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """Return the points of hits, right-handed; other fields are 0."""
    points = np.zeros(len(hits.ray), dtype)
    places = directions[hits.ray] * hits.distance[:, None] * MIRROR
    for axis, name in enumerate("xyz"):
        points[name] = places[:, axis]
    return points


class _Lidar(_RaySensor):
    def __init__(self, spec: SensorSpec, warn: Callable[[str], None]) -> None:
        super().__init__(spec, warn)
        self.beams, self._returns = LidarBeams(spec.number, self._warn), LidarReturns(spec.number)

    def measure(self, moment: RayMoment, pose: Floats, hits: SurfaceHits, directions: Floats) -> NDArray[np.void]:
        hits, intensity = self._returns.of(hits)
        points = _points(hits, directions, POINT)
        points["intensity"] = intensity
        return points


class _SemanticLidar(_RaySensor):
    def __init__(self, spec: SensorSpec, warn: Callable[[str], None]) -> None:
        super().__init__(spec, warn)
        self.beams = LidarBeams(spec.number, self._warn)

    def measure(self, moment: RayMoment, pose: Floats, hits: SurfaceHits, directions: Floats) -> NDArray[np.void]:
        points = _points(hits, directions, SEMANTIC_POINT)
        points["cosine"], points["actor"], points["tag"] = hits.cosine, hits.actor, hits.tag
        return points


class _Radar(_RaySensor):
    def __init__(self, spec: SensorSpec, warn: Callable[[str], None]) -> None:
        super().__init__(spec, warn)
        self.beams = RadarBeams(spec.number, self._warn)

    def measure(self, moment: RayMoment, pose: Floats, hits: SurfaceHits, directions: Floats) -> NDArray[np.void]:
        ids, velocities = moment.ids, moment.velocities
        rows, known = find(hits.actor, ids)
        assert moment.velocity is not None
        assert velocities is not None
        towards = np.zeros((len(hits.actor), 3))
        if len(ids):
            towards = np.where(known[:, None], velocities[rows], 0.0)
        turned = rotations(pose) * MIRROR[:, None] * MIRROR
        found = detections(hits, directions, turned, (towards - moment.velocity) * MIRROR)
        table = np.zeros(len(found), DETECTION)
        for column, name in enumerate(DETECTION.names or ()):
            table[name] = found[:, column]
        table["azimuth"] *= -1
        return table


_SENSORS: Final[Mapping[str, type[_RaySensor]]] = {
    "lidar": _Lidar,
    "semantic_lidar": _SemanticLidar,
    "radar": _Radar,
}


if __name__ == "__main__":
    answer_requests(lambda setup: RaySensors(setup).begin)
