"""Road maps: OpenDRIVE files as lines to draw."""

from carla_recap.maps.road_map import RoadMap, find_map, load_map

__all__ = ["RoadMap", "find_map", "load_map"]
