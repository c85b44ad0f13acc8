"""Road maps: OpenDRIVE files as lines to draw, and as networks of lanes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.util.lazy import lazily

if TYPE_CHECKING:
    from carla_recap.maps.network import find_road_network, load_road_network
    from carla_recap.maps.road_map import RoadMap, find_map, load_map

__all__ = ["RoadMap", "find_map", "find_road_network", "load_map", "load_road_network"]

__getattr__, __dir__ = lazily(
    __name__,
    {
        "network": ("find_road_network", "load_road_network"),
        "road_map": ("RoadMap", "find_map", "load_map"),
    },
)
