"""Measure the speed and the sizes that docs/performance.md states, and print them as a table with their goals."""

from __future__ import annotations

import argparse
import sys
import traceback
from pathlib import Path

from benchmarks import core, exports, fleet, measures, remote, rendering, roads, server, simulator
from benchmarks.hour import FRAMES, cached
from benchmarks.measuring import Subject, in_new_process, measure

REAL = Path("../shared/data/carla-logs/carla-0.9.13-lane-center.log")
ROWS = (
    *core.ROWS,
    *fleet.ROWS,
    *remote.ROWS,
    *exports.ROWS,
    *rendering.ROWS,
    *simulator.ROWS,
    *server.ROWS,
    *roads.ROWS,
    *measures.ROWS,
)
WIDTHS = (46, 18, 18, 18, 8)


def main() -> None:
    names = [row.__name__ for row in ROWS]
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--frames", type=int, default=FRAMES, help="frames of the recording (default: %(default)s)")
    parser.add_argument("--only", action="append", choices=names, metavar="NAME", help=f"one of {', '.join(names)}")
    parser.add_argument(
        "--real",
        type=Path,
        default=REAL if REAL.exists() else None,
        metavar="LOG",
        help="a recording of CARLA itself (default: %(default)s)",
    )
    options = parser.parse_args()
    show_progress("making the recording")
    in_new_process(cached, options.frames)
    print_cells("what", "measured", "ratio", "goal", "met?")
    failed = False
    for row in ROWS:
        if options.only and row.__name__ not in options.only:
            continue
        show_progress(row.__name__)
        try:
            lines = in_new_process(measure, row, Subject(options.frames, options.real))
        except Exception:
            print_cells(row.__name__, "failed")
            traceback.print_exc()
            failed = True
            continue
        for line in lines:
            print_cells(
                line.what, line.measured, line.ratio, line.goal, "" if not line.goal else "ok" if line.ok else "MISSED"
            )
    sys.exit(failed)


def show_progress(what: str) -> None:
    """Print on a terminal what is measured now."""
    if sys.stderr.isatty():
        print(f"\r\033[K{what} …", end="", file=sys.stderr, flush=True)


def print_cells(*cells: str) -> None:
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)
    print("  ".join(cell.ljust(width) for cell, width in zip(cells, WIDTHS, strict=False)).rstrip(), flush=True)


if __name__ == "__main__":
    main()
