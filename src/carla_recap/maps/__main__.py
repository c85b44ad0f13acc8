"""A process of its own for CARLA's parser, which ends the process on some files: OpenDRIVE comes in, lines go out."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import Final

from carla_recap.maps.drawing import draw
from carla_recap.maps.opendrive import read_opendrive
from carla_recap.maps.packing import pack

_MEMORY: Final = 4 << 30  # bytes


def main() -> int:
    """Read OpenDRIVE from the standard input, and write an .npz to the standard output, or else why not, in words."""
    with os.fdopen(os.dup(1), "wb") as answer:
        os.dup2(2, 1)  # the parser prints warnings
        _limit()
        try:
            lines = draw(read_opendrive(sys.stdin.buffer.read().decode("utf-8-sig", "replace")))
        except Exception as error:  # whatever the parser comes upon
            answer.write((str(error) or type(error).__name__).encode())
            return 1
        answer.write(pack(lines))
    return 0


def _limit() -> None:
    """Let this process end soon where a file asks for all memory there is, and leave no core file behind."""
    with suppress(ImportError):  # not on Windows
        import resource

        for what, most in ((resource.RLIMIT_AS, _MEMORY), (resource.RLIMIT_CORE, 0)):
            _, allowed = resource.getrlimit(what)
            limit = most if allowed == resource.RLIM_INFINITY else min(most, allowed)
            resource.setrlimit(what, (limit, limit))


if __name__ == "__main__":
    sys.exit(main())
