"""Locations, vectors, rotations and boxes in CARLA's left-handed axes: x forward, y right, z up; metres and degrees."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import asin, atan2, cos, degrees, dist, hypot, radians, sin
from typing import Final

_Row = tuple[float, float, float]
_VERTICAL: Final = 1e-12  # 1 less the sine of a pitch that counts as straight up or down


@dataclass(slots=True)
class Location:
    """A location.

    Attributes:
        x: The coordinate forward, in m.
        y: The coordinate to the right, in m.
        z: The coordinate upwards, in m.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    def distance(self, other: Location) -> float:
        """Return the distance to another location in m."""
        return dist((self.x, self.y, self.z), (other.x, other.y, other.z))


@dataclass(slots=True)
class Vector:
    """A vector, such as a velocity in m/s or an impulse in N s.

    Attributes:
        x, y, z: The components, in the axes of a `Location`: x forward, y right, z up.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    def __mul__(self, factor: float) -> Vector:
        return Vector(factor * self.x, factor * self.y, factor * self.z)

    def length(self) -> float:
        """Return its length, in the unit of its components."""
        return hypot(self.x, self.y, self.z)


@dataclass(slots=True)
class Rotation:
    """A rotation in degrees: first roll, then pitch, then yaw.

    Attributes:
        pitch: The rotation about y; positive lifts the nose.
        yaw: The rotation about z; positive turns right, from x to y.
        roll: The rotation about x; positive lifts the left side.
    """

    pitch: float = 0.0
    yaw: float = 0.0
    roll: float = 0.0

    def matrix(self) -> tuple[_Row, _Row, _Row]:
        """Return the rotation matrix of Unreal Engine, by rows; its columns point forward, to the right and upwards."""
        cp, cy, cr = cos(radians(self.pitch)), cos(radians(self.yaw)), cos(radians(self.roll))
        sp, sy, sr = sin(radians(self.pitch)), sin(radians(self.yaw)), sin(radians(self.roll))
        return (
            (cp * cy, cy * sp * sr - sy * cr, -cy * sp * cr - sy * sr),
            (cp * sy, sy * sp * sr + cy * cr, cy * sr - sy * sp * cr),
            (sp, -cp * sr, cp * cr),
        )

    def combined(self, relative: Rotation) -> Rotation:
        """Return the rotation of something whose rotation is given in the axes of this one."""
        if not (relative.pitch or relative.yaw or relative.roll):
            return Rotation(self.pitch, self.yaw, self.roll)
        x, y, z = self.matrix()
        ahead, right, up = zip(*relative.matrix(), strict=True)
        rise = min(max(_dot(z, ahead), -1.0), 1.0)
        if abs(rise) > 1 - _VERTICAL:  # nose up or down: roll and yaw are the same, reported as yaw
            return Rotation(degrees(asin(rise)), degrees(atan2(-_dot(x, right), _dot(y, right))), 0.0)
        yaw, roll = atan2(_dot(y, ahead), _dot(x, ahead)), atan2(-_dot(z, right), _dot(z, up))
        return Rotation(degrees(asin(rise)), degrees(yaw), degrees(roll))


def _dot(one: _Row, other: _Row) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@dataclass(slots=True)
class Transform:
    """A location and a rotation.

    Attributes:
        location: The location, in m.
        rotation: The rotation, in degrees.
    """

    location: Location = field(default_factory=Location)
    rotation: Rotation = field(default_factory=Rotation)

    def copy(self) -> Transform:
        """Return a copy."""
        location, rotation = self.location, self.rotation
        return Transform(Location(location.x, location.y, location.z), Rotation(rotation.pitch, rotation.yaw, rotation.roll))

    def forward(self) -> Vector:
        """Return the forward direction, of length 1."""
        pitch, yaw = radians(self.rotation.pitch), radians(self.rotation.yaw)
        return Vector(cos(pitch) * cos(yaw), cos(pitch) * sin(yaw), sin(pitch))

    def transform(self, point: Location) -> Location:
        """Return the location in the world of a point given in the axes of this transform."""
        origin, x, y, z = self.location, point.x, point.y, point.z
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = self.rotation.matrix()
        return Location(
            origin.x + xx * x + xy * y + xz * z, origin.y + yx * x + yy * y + yz * z, origin.z + zx * x + zy * y + zz * z
        )

    def attached(self, relative: Transform) -> Transform:
        """Return the transform in the world of something whose transform is given in the axes of this one."""
        return Transform(self.transform(relative.location), self.rotation.combined(relative.rotation))


@dataclass(frozen=True, slots=True)
class Box:
    """A bounding box.

    Attributes:
        location: The centre, in the axes of what it bounds.
        extent: Half of the length, width and height, in m.
    """

    location: Location
    extent: Vector

    def heights(self, transform: Transform) -> tuple[float, float]:
        """Return the z of its lowest and of its highest point in m, around an actor with a transform."""
        _, _, (x, y, z) = transform.rotation.matrix()
        centre, extent = self.location, self.extent
        middle = transform.location.z + x * centre.x + y * centre.y + z * centre.z
        half = abs(x) * extent.x + abs(y) * extent.y + abs(z) * extent.z
        return middle - half, middle + half
