"""Where on the earth a place of a map is, as CARLA 0.9.16 has it.

CARLA takes the earth for a sphere, and every map for a transverse Mercator projection around its `lat_0` and `lon_0`; it
heeds nothing else of the geo-reference, and y counts northwards. `carla.Map.transform_to_geolocation` of the client says
the same.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import asin, atan2, cos, cosh, degrees, radians, sin, sinh
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from carla_recap.sim.geometry import Location

_RADIUS: Final = 6378137.0  # m, of the earth at its equator
_SCALE: Final = 0.9996  # of the projection at its central meridian, as of UTM
_NOWHERE: Final = (42.0, 2.0)  # degrees: where CARLA puts maps without a geo-reference that it understands
_TAG: Final = re.compile(r"<geoReference>\s*(?:<!\[CDATA\[)?(.*?)(?:\]\]>)?\s*</geoReference>", re.DOTALL)
_NUMBER: Final = r"{}=([-+]?[\d.]+(?:[eE][-+]?\d+)?)(?=\s|$)"


@dataclass(frozen=True, slots=True)
class GeoReference:
    """Where the origin of a map is, in degrees."""

    latitude: float
    longitude: float

    @classmethod
    def of(cls, opendrive: str) -> GeoReference:
        """That of an OpenDRIVE file."""
        tag = _TAG.search(opendrive)
        found = [re.search(_NUMBER.format(re.escape(key)), tag[1] if tag else "") for key in ("+lat_0", "+lon_0")]
        values = [float(match[1]) for match in found if match]
        return cls(*values) if len(values) == len(_NOWHERE) else cls(*_NOWHERE)

    def locate(self, place: Location) -> tuple[float, float, float]:
        """Latitude and longitude in degrees, and altitude in m, of a place in m."""
        east = place.x / (_SCALE * _RADIUS)
        north = place.y / (_SCALE * _RADIUS) + radians(self.latitude)
        latitude = degrees(asin(sin(north) / cosh(east)))
        longitude = degrees(radians(self.longitude) + atan2(sinh(east), cos(north)))
        return latitude, longitude, place.z
