"""Measure speed and sizes, and print them as a table with their goals; `--markdown` writes docs/performance.md."""

from __future__ import annotations

import argparse
import os
import sys
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks import core, exports, fleet, page, rendering, scores, server, simulator
from benchmarks.hour import FRAMES, cached
from benchmarks.measuring import Missing, Subject, in_new_process, measure
from benchmarks.results import RESULTS, Result, current_conditions, load, save

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from benchmarks.measuring import Line

    Row = Callable[[Subject], Iterator[Line]]

REAL = Path("../shared/data/carla-logs/carla-0.9.13-lane-center.log")
ROWS = (
    *core.ROWS,
    *fleet.ROWS,
    *exports.ROWS,
    *rendering.ROWS,
    *simulator.ROWS,
    *server.ROWS,
    *scores.ROWS,
)
WIDTHS = (46, 18, 18, 18, 8)
CALM = 0.5  # processes that use a processor


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
    parser.add_argument(
        "--markdown",
        action="store_true",
        help=f"store what is measured in benchmarks/{RESULTS.name}, and write docs/performance.md of all stored results",
    )
    options = parser.parse_args()
    if options.markdown and options.frames != FRAMES:
        parser.error(f"--markdown needs the whole recording of {FRAMES:,} frames")
    warn_of_load()
    show_progress("making the recording")
    in_new_process(cached, options.frames)
    subject = Subject(options.frames, options.real)
    begin, failed = time.monotonic(), False
    try:
        rows = [row for row in ROWS if not options.only or row.__name__ in options.only]
        failed = measure_rows(rows, subject, RESULTS if options.markdown else None)
    finally:
        if options.markdown:
            page.main()
    print(f"{(time.monotonic() - begin) / 60:.1f} min", file=sys.stderr)
    sys.exit(failed)


def measure_rows(rows: Iterable[Row], subject: Subject, stored: Path | None = None) -> bool:
    """Measure and print rows, and store each at once in a file of results; return whether one failed."""
    conditions, failed = current_conditions(), False
    print_cells("what", "measured", "ratio", "goal", "met?")
    for row in rows:
        show_progress(row.__name__)
        try:
            lines = in_new_process(measure, row, subject)
        except Missing as missing:
            print_cells(row.__name__, f"left out: {missing} is not installed")
            continue
        except Exception:
            print_cells(row.__name__, "failed")
            traceback.print_exc()
            failed = True
            continue
        for line in lines:
            print_cells(
                line.what, line.measured, line.ratio, line.goal, "" if not line.goal else "ok" if line.ok else "MISSED"
            )
        if not lines:
            print_cells(row.__name__, "left out: a file that it needs is missing")
        elif stored:
            results = load(stored)
            results[row.__name__] = Result(conditions, tuple(lines))
            save({row.__name__: results[row.__name__] for row in ROWS if row.__name__ in results}, stored)
    return failed


def warn_of_load() -> None:
    if hasattr(os, "getloadavg") and (load_average := os.getloadavg()[0]) > CALM:
        print(f"the machine is busy (load {load_average:.1f}): other work makes the figures worse", file=sys.stderr)


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
