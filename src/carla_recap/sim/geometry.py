"""Places, directions and boxes in CARLA's axes: metres and degrees, left-handed: x forward, y right, z up."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import asin, atan2, cos, degrees, dist, hypot, radians, sin
from typing import Final

_Row = tuple[float, float, float]
_UPRIGHT: Final = 1e-12  # so near to 1 is the sine of a pitch that is straight up or down


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

    def matrix(self) -> tuple[_Row, _Row, _Row]:
        """As Unreal Engine turns, row by row: the columns point forward, to the right and upwards."""
        cp, cy, cr = cos(radians(self.pitch)), cos(radians(self.yaw)), cos(radians(self.roll))
        sp, sy, sr = sin(radians(self.pitch)), sin(radians(self.yaw)), sin(radians(self.roll))
        return (
            (cp * cy, cy * sp * sr - sy * cr, -cy * sp * cr - sy * sr),
            (cp * sy, sy * sp * sr + cy * cr, cy * sr - sy * sp * cr),
            (sp, -cp * sr, cp * cr),
        )

    def turned(self, further: Rotation) -> Rotation:
        """How something is turned that is turned further in the axes of what is turned like this."""
        if not (further.pitch or further.yaw or further.roll):
            return Rotation(self.pitch, self.yaw, self.roll)
        x, y, z = self.matrix()
        ahead, right, up = zip(*further.matrix(), strict=True)
        rise = min(max(_dot(z, ahead), -1.0), 1.0)
        if abs(rise) > 1 - _UPRIGHT:  # nose up or down: roll and yaw are one, and called yaw
            return Rotation(degrees(asin(rise)), degrees(atan2(-_dot(x, right), _dot(y, right))), 0.0)
        yaw, roll = atan2(_dot(y, ahead), _dot(x, ahead)), atan2(-_dot(z, right), _dot(z, up))
        return Rotation(degrees(asin(rise)), degrees(yaw), degrees(roll))


def _dot(one: _Row, other: _Row) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


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
        """A place in the world that is given in the axes of this transform."""
        at, x, y, z = self.location, point.x, point.y, point.z
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = self.rotation.matrix()
        return Location(at.x + xx * x + xy * y + xz * z, at.y + yx * x + yy * y + yz * z, at.z + zx * x + zy * y + zz * z)

    def attached(self, relative: Transform) -> Transform:
        """Where something is in the world that is fixed to what this is the transform of, and given in its axes."""
        return Transform(self.transform(relative.location), self.rotation.turned(relative.rotation))


@dataclass(frozen=True, slots=True)
class Box:
    """A box around something.

    Attributes:
        location: Its centre, in the axes of what it is around.
        extent: Half of its length, width and height, in m.
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
