"""GNSS receivers: where they are on the earth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgpack
import numpy as np

from carla_recap.server.sensors.feed import Noise
from carla_recap.server.sensors.georeference import GeoReference

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.server.sensors.feed import Feed, Tell
    from carla_recap.sim.actors.actor import Actor


def gnss(sensor: Actor, tell: Tell) -> Feed:
    """Latitude and longitude in degrees, and altitude in m, with the bias and the noise that the attributes ask for."""
    reference = GeoReference.of(sensor.context.town.opendrive)
    noise = Noise(sensor, *([f"noise_{part}_{kind}" for part in ("lat", "lon", "alt")] for kind in ("bias", "stddev")))

    def frames() -> Iterable[bytes]:
        yield msgpack.packb(noise.upon(np.array(reference.locate(sensor.transform.location))))

    return frames
