"""Measures the speed and the sizes that the README claims, and prints a table."""

from __future__ import annotations

import argparse
import sys
import traceback
from pathlib import Path

from benchmarks import exports, rows, server, simulator
from benchmarks.hour import FRAMES, cached
from benchmarks.rows import Subject, in_new_process, measure

REAL = Path("../shared/data/carla-logs/carla-0.9.13-lane-center.log")
ROWS = (*rows.ROWS, *exports.ROWS, *simulator.ROWS, *server.ROWS)
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
        help="a real recording, for its size as MCAP (default: %(default)s)",
    )
    options = parser.parse_args()
    tell("making the recording")
    in_new_process(cached, options.frames)
    show("what", "measured", "ratio", "must reach", "ok?")
    crashed = False
    for row in ROWS:
        if options.only and row.__name__ not in options.only:
            continue
        tell(row.__name__)
        try:
            lines = in_new_process(measure, row, Subject(options.frames, options.real))
        except Exception:
            show(row.__name__, "crashed")
            traceback.print_exc()
            crashed = True
            continue
        for line in lines:
            show(line.what, line.measured, line.ratio, line.goal, "ok" if line.ok else "MISSED")
    sys.exit(crashed)


def tell(what: str) -> None:
    """Say what is going on, to a person."""
    if sys.stderr.isatty():
        print(f"\r\033[K{what} …", end="", file=sys.stderr, flush=True)


def show(*cells: str) -> None:
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)
    print("  ".join(cell.ljust(width) for cell, width in zip(cells, WIDTHS, strict=False)).rstrip(), flush=True)


if __name__ == "__main__":
    main()
