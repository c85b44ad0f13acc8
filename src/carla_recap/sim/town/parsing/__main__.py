"""The child process that parses a town."""

from __future__ import annotations

import sys

import numpy as np

from carla_recap.roads.carla_map import read_opendrive
from carla_recap.roads.parsing import run_child
from carla_recap.sim.town.parsing.junctions import parse_junctions, parse_signals
from carla_recap.sim.town.parsing.packing import Parsed, to_bytes
from carla_recap.sim.town.parsing.roads import limit_speeds, parse_lanes, read_records
from carla_recap.sim.town.parsing.sidewalks import barriers, parse_walks


def parse(text: str) -> Parsed:
    """Return the parsed town of an OpenDRIVE file.

    Args:
        text: The content of the file.

    Raises:
        ValueError: It contains no town.
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


if __name__ == "__main__":
    sys.exit(run_child(lambda text: to_bytes(parse(text))))
