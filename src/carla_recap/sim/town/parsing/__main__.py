"""What runs in that process: OpenDRIVE comes in, a parsed town goes out."""

from __future__ import annotations

import sys

from carla_recap.maps.child import answer
from carla_recap.sim.town.parsing.packing import to_bytes
from carla_recap.sim.town.parsing.whole import parse

if __name__ == "__main__":
    sys.exit(answer(lambda text: to_bytes(parse(text))))
