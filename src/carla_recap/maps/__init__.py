"""The map of a town: an OpenDRIVE file as lines that a viewer can draw."""

from carla_recap.maps.road_map import RoadMap, find_map, load_map

__all__ = ["RoadMap", "find_map", "load_map"]
