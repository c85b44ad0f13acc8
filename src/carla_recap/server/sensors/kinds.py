"""All kinds of sensors: how CARLA numbers what they send, and how far they are served."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from carla_recap.server.sensors import cameras, lidars
from carla_recap.server.sensors.collisions import collisions
from carla_recap.server.sensors.feed import silent
from carla_recap.server.sensors.gnss import gnss
from carla_recap.server.sensors.imu import imu
from carla_recap.server.sensors.obstacles import obstacles
from carla_recap.server.sensors.radar import radar

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carla_recap.server.sensors.feed import Make


class Support(StrEnum):
    """How far a sensor is served."""

    LIVE = "live"
    BLANK = "blank"
    SILENT = "silent"


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of sensor.

    Attributes:
        number: How CARLA numbers what it sends.
        support: How far it is served.
        what: What it tells, in a line for the documentation.
        make: What makes the feeds of such sensors.
        by_event: Whether it tells what happens at once, whatever its `sensor_tick` is.
    """

    number: int
    support: Support
    what: str
    make: Make = silent
    by_event: bool = False


_BOXES: Final = "the boxes of vehicles, walkers and props; neither the ground nor buildings"

KINDS: Final[Mapping[str, Kind]] = MappingProxyType(
    {
        "sensor.camera.cosmos_visualization": Kind(16, Support.BLANK, "grey", cameras.grey),
        "sensor.camera.depth": Kind(1, Support.BLANK, "all is 1,000 m away", cameras.depth),
        "sensor.camera.dvs": Kind(3, Support.BLANK, "no events", cameras.events),
        "sensor.camera.instance_segmentation": Kind(15, Support.BLANK, "all is unlabelled", cameras.unlabelled),
        "sensor.camera.normals": Kind(2, Support.BLANK, "grey", cameras.grey),
        "sensor.camera.optical_flow": Kind(8, Support.BLANK, "nothing moves", cameras.flow),
        "sensor.camera.rgb": Kind(13, Support.BLANK, "grey", cameras.grey),
        "sensor.camera.semantic_segmentation": Kind(14, Support.BLANK, "all is unlabelled", cameras.unlabelled),
        "sensor.lidar.ray_cast": Kind(11, Support.LIVE, f"{_BOXES}; no points are dropped", lidars.plain),
        "sensor.lidar.ray_cast_semantic": Kind(10, Support.LIVE, _BOXES, lidars.semantic),
        "sensor.other.collision": Kind(0, Support.LIVE, "each collision of its parent", collisions, by_event=True),
        "sensor.other.gnss": Kind(4, Support.LIVE, "where it is, by the map's geo-reference; with noise", gnss),
        "sensor.other.imu": Kind(5, Support.LIVE, "how its parent moves; with noise", imu),
        "sensor.other.lane_invasion": Kind(6, Support.LIVE, "found by the client itself"),
        "sensor.other.obstacle": Kind(7, Support.LIVE, f"{_BOXES}, but barriers", obstacles),
        "sensor.other.radar": Kind(9, Support.LIVE, _BOXES, radar),
        "sensor.other.rss": Kind(12, Support.SILENT, "needs a client that is built with RSS"),
        "sensor.other.v2x": Kind(20, Support.SILENT, "cooperative awareness messages"),
        "sensor.other.v2x_custom": Kind(21, Support.SILENT, "messages"),
    }
)
"""All sensors by the names of their blueprints."""
