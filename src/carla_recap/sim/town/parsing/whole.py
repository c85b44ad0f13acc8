"""All parts of a town."""

from __future__ import annotations

import numpy as np

from carla_recap.maps.opendrive import read_opendrive
from carla_recap.sim.town.parsing.ground import barriers
from carla_recap.sim.town.parsing.junctions import parse_junctions
from carla_recap.sim.town.parsing.lanes import limit_speeds, parse_lanes
from carla_recap.sim.town.parsing.packing import Parsed
from carla_recap.sim.town.parsing.records import read_records
from carla_recap.sim.town.parsing.signals import parse_signals
from carla_recap.sim.town.parsing.walks import parse_walks


def parse(text: str) -> Parsed:
    """The parts of the town of an OpenDRIVE file.

    Args:
        text: What is in the file.

    Raises:
        ValueError: It is no town.
    """
    with np.errstate(all="ignore"):
        roads = read_opendrive(text)
        records = read_records(text)
        lanes = parse_lanes(roads)
        signals = parse_signals(roads, lanes, records)
        limit_speeds(lanes, signals, records)
        junctions = parse_junctions(lanes, signals, records)
        walks = parse_walks(roads)
        fences = barriers(roads.lanes)
    return Parsed(
        {
            "lanes": [lane.rows for lane in lanes],
            "sidewalks": walks.sidewalks,
            "crossings": walks.crossings,
            "walks": [np.array(walks.nodes).reshape(-1, 3)],
            "barriers": fences,
        },
        {
            "lanes": [lane.row for lane in lanes],
            "signals": signals,
            "junctions": junctions,
            "walk_edges": [{"nodes": edge, "crossing": crossing} for edge, crossing in walks.edges.items()],
        },
    )
