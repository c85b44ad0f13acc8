from carla_recap.roads.drawing import RoadMap as RoadMap
from carla_recap.roads.drawing import load_map as load_map
from carla_recap.roads.find import find_map as find_map
from carla_recap.roads.network import RoadNetwork as RoadNetwork
from carla_recap.roads.surfaces import find_road_network as find_road_network
from carla_recap.roads.surfaces import load_road_network as load_road_network
