"""Places, directions and boxes in CARLA's axes: metres and degrees, left-handed: x forward, y right, z up."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import cos, dist, hypot, radians, sin


@dataclass(slots=True)
class Location:
    """A place in m.

    Attributes:
        x: Forward.
        y: To the right.
        z: Upwards.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    def distance(self, other: Location) -> float:
        """How far another place is, in m."""
        return dist((self.x, self.y, self.z), (other.x, other.y, other.z))


@dataclass(slots=True)
class Vector:
    """A direction with a length, such as a velocity in m/s or an impulse in kg m/s; axes as of a `Location`."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    def length(self) -> float:
        """How long it is, in the unit of its parts."""
        return hypot(self.x, self.y, self.z)


@dataclass(slots=True)
class Rotation:
    """How something is turned, in degrees: first rolled, then pitched, then yawed.

    Attributes:
        pitch: Positive lifts the nose.
        yaw: Positive turns right, from x to y.
        roll: Positive lifts the left side.
    """

    pitch: float = 0.0
    yaw: float = 0.0
    roll: float = 0.0


@dataclass(slots=True)
class Transform:
    """Where something is, and how it is turned."""

    location: Location = field(default_factory=Location)
    rotation: Rotation = field(default_factory=Rotation)

    def copy(self) -> Transform:
        """The same, to be changed without this one."""
        location, rotation = self.location, self.rotation
        return Transform(Location(location.x, location.y, location.z), Rotation(rotation.pitch, rotation.yaw, rotation.roll))

    def forward(self) -> Vector:
        """The direction of the nose, of length 1."""
        pitch, yaw = radians(self.rotation.pitch), radians(self.rotation.yaw)
        return Vector(cos(pitch) * cos(yaw), cos(pitch) * sin(yaw), sin(pitch))

    def transform(self, point: Location) -> Location:
        """A place in the world that is given in the axes of this transform, turned as Unreal Engine turns."""
        turn = self.rotation
        cp, cy, cr = cos(radians(turn.pitch)), cos(radians(turn.yaw)), cos(radians(turn.roll))
        sp, sy, sr = sin(radians(turn.pitch)), sin(radians(turn.yaw)), sin(radians(turn.roll))
        x, y, z = point.x, point.y, point.z
        return Location(
            self.location.x + cp * cy * x + (cy * sp * sr - sy * cr) * y - (cy * sp * cr + sy * sr) * z,
            self.location.y + cp * sy * x + (sy * sp * sr + cy * cr) * y + (cy * sr - sy * sp * cr) * z,
            self.location.z + sp * x - cp * sr * y + cp * cr * z,
        )


@dataclass(frozen=True, slots=True)
class Box:
    """A box around something.

    Attributes:
        location: Its centre, in the axes of what it is around.
        extent: Half of its length, width and height, in m.
    """

    location: Location
    extent: Vector
