"""Road maps: OpenDRIVE files as lines to draw, and as networks of lanes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.util.lazy import lazily

if TYPE_CHECKING:
    from carla_recap.roads.drawing import RoadMap, load_map
    from carla_recap.roads.find import find_map
    from carla_recap.roads.network import RoadNetwork
    from carla_recap.roads.surfaces import find_road_network, load_road_network

__all__ = ["RoadMap", "RoadNetwork", "find_map", "find_road_network", "load_map", "load_road_network"]

__getattr__, __dir__ = lazily(
    __name__,
    {
        "drawing": ("RoadMap", "load_map"),
        "find": ("find_map",),
        "network": ("RoadNetwork",),
        "surfaces": ("find_road_network", "load_road_network"),
    },
)
