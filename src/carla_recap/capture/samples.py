"""What sensors of CARLA's client send, as samples: arrays in the axes of recordings with sensors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.packets import pose
from carla_recap.rendering.camera import ImageKind
from carla_recap.replay.pose import ANGULAR_MIRROR, MIRROR, right_handed
from carla_recap.sensors.cameras import decoded
from carla_recap.sensors.ray_sensors import DETECTION, POINT, SEMANTIC_POINT
from carla_recap.sensors.sensing import FIX, INERTIA, Sample

if TYPE_CHECKING:
    import carla
    from numpy.typing import NDArray

    from carla_recap.sensors.rig import SensorSpec

_SMALL: Final = 256  # bytes that data of a few numbers count for
_DTYPES: Final = {"lidar": POINT, "semantic_lidar": SEMANTIC_POINT, "radar": DETECTION}  # as CARLA sends them, but for signs


class SensorFrame(NamedTuple):
    """What a sensor has sent for a tick: data of CARLA's client, or of a speedometer, m/s, with their size in bytes.

    The timestamp is in s since the episode began.
    """

    spec: SensorSpec
    frame: int
    timestamp: float
    transform: carla.Transform
    data: Any
    size: int

    @classmethod
    def of(cls, spec: SensorSpec, data: Any) -> SensorFrame:
        """Return what a sensor has sent, of which no byte is copied."""
        size = len(data.raw_data) if spec.kind in ("camera", *_DTYPES) else _SMALL
        return cls(spec, data.frame, data.timestamp, data.transform, data, size)

    @classmethod
    def of_speed(cls, spec: SensorSpec, snapshot: carla.WorldSnapshot, carrier: carla.ActorSnapshot) -> SensorFrame:
        """Return what a speedometer measures: the speed of its carrier, forward."""
        transform = carrier.get_transform()
        speed = carrier.get_velocity().dot(transform.get_forward_vector())
        return cls(spec, snapshot.frame, snapshot.timestamp.elapsed_seconds, transform, speed, _SMALL)

    def sample(self, elapsed: float, ids: NDArray[np.uint32]) -> Sample:
        """Return the data as a sample at some elapsed s; the ids are those of actors that can be in an image, ascending.

        A `RecapError` is raised if they are no data of such a sensor.
        """
        place = right_handed(np.array(pose(self.transform)))
        kind, data = self.spec.kind, self.data
        values: NDArray[Any]
        if kind == "camera":
            values = self._image(ids)
        elif kind in _DTYPES:
            values = self._rows(_DTYPES[kind])
        elif kind == "gnss":
            values = np.array((data.latitude, data.longitude, data.altitude), FIX)
        elif kind == "imu":
            felt, turning = (np.array((one.x, one.y, one.z)) for one in (data.accelerometer, data.gyroscope))
            values = np.array((felt * MIRROR, turning * ANGULAR_MIRROR, data.compass), INERTIA)
        else:
            values = np.array(data)
        return Sample(self.spec, elapsed, place, values)

    def _image(self, ids: NDArray[np.uint32]) -> NDArray[Any]:
        spec, data = self.spec, self.data
        width, height = int(spec.number("image_size_x")), int(spec.number("image_size_y"))
        is_flow = spec.image is ImageKind.FLOW
        dtype, channels = (np.dtype("<f4"), 2) if is_flow else (np.dtype(np.uint8), 4)
        if (data.width, data.height) != (width, height) or self.size != width * height * channels * dtype.itemsize:
            size = f"{data.width} x {data.height} pixels in {self.size} bytes"
            raise RecapError(f"sensor {spec.id!r}: an image of {size}; {width} x {height} pixels were expected")
        image: NDArray[Any] = np.ndarray((height, width, channels), dtype, data.raw_data)
        assert spec.image is not None
        return decoded(spec.image, image, ids)

    def _rows(self, dtype: np.dtype[np.void]) -> NDArray[np.void]:
        """Return points or detections, right-handed."""
        if self.size % dtype.itemsize:
            raise RecapError(f"sensor {self.spec.id!r}: {self.size} bytes; points of {dtype.itemsize} bytes were expected")
        rows = np.frombuffer(bytes(self.data.raw_data), dtype).copy()
        rows["azimuth" if dtype is DETECTION else "y"] *= -1
        return rows
