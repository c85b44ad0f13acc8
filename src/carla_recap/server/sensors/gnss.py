"""GNSS receivers: where they are on the earth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgpack
import numpy as np

from carla_recap.server.sensors.feed import Noise
from carla_recap.server.sensors.georeference import GeoReference

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.server.host import Host
    from carla_recap.server.sensors.feed import Feed
    from carla_recap.sim.actors import Actor


def gnss(sensor: Actor, host: Host) -> Feed:
    """Latitude and longitude in degrees, and altitude in m, with the bias and the noise that the attributes ask for."""
    reference = GeoReference.of(host.world.town.opendrive)
    noise = Noise(sensor, *([f"noise_{part}_{kind}" for part in ("lat", "lon", "alt")] for kind in ("bias", "stddev")))

    def frames() -> Iterable[bytes]:
        yield msgpack.packb(noise.upon(np.array(reference.locate(sensor.transform.location))))

    return frames
