"""What runs in the process of CARLA's parser: OpenDRIVE comes in, lines go out."""

from __future__ import annotations

import sys

from carla_recap.maps.child import answer
from carla_recap.maps.drawing import draw
from carla_recap.maps.opendrive import read_opendrive
from carla_recap.maps.packing import pack

if __name__ == "__main__":
    sys.exit(answer(lambda text: pack(draw(read_opendrive(text)))))
