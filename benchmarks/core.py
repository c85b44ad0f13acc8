"""Conversion, queries, tables and start-up: a function for each group of lines, each run in a process of its own.

Where it makes sense, a time is compared with something else that is measured in the same run.
"""

from __future__ import annotations

import compileall
import filecmp
import mmap
import re
import struct
import sys
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

import carla_recap
from benchmarks.hour import DIRECTORY, RATE
from benchmarks.measuring import COMMAND, Line, Subject, best, convert, cpu_time, cut, medians, run, timed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from carla_recap import Recording
    from carla_recap.formats.base import Reader
    from carla_recap.queries.blocked import Blocked
    from carla_recap.queries.collisions import Collisions
    from carla_recap.queries.info import Info
    from carla_recap.queries.measures.road import RoadEvent

    Query = Callable[[Reader], Collisions | Blocked | Info]

TRAJECTORIES: Final = (
    "import sys; from carla_recap import open_recording; r = open_recording(sys.argv[1]); "
    "r.trajectory(r.heroes[0].id) if sys.argv[2] == 'one' else r.trajectories()"
)
DIFFERENCES: Final = """
import sys
from carla_recap import open_recording
open_recording(sys.argv[1]).diff(open_recording(sys.argv[2])).summary
"""
STARTED: Final = 0.3  # s, for the start of such a process
NUMBER: Final = re.compile(r"(?<!\w)-?(?:\d+(?:\.\d+)?(?:e[+-]\d+)?|nan|inf)\b")
SMALL: Final = 10 * RATE  # frames of a small recording
QUERIES: Final[dict[str, Callable[[Recording], object]]] = {
    "collisions": lambda recording: list(recording.collisions()),
    "blocked": lambda recording: list(recording.blocked()),
    "incidents": lambda recording: list(recording.incidents()),
    "info": lambda recording: recording.info,
}


def log_to_mcap(subject: Subject) -> Iterator[Line]:
    yield from _conversion(".log → .mcap", subject.seconds, subject.log, subject.log.with_suffix(".mcap"), 1200)


def mcap_to_log(subject: Subject) -> Iterator[Line]:
    back = DIRECTORY / "back.log"
    yield from _conversion(".mcap → .log", subject.seconds, subject.mcap, back, 1500)
    equal = filecmp.cmp(subject.log, back, shallow=False)
    yield Line(".log → .mcap → .log", f"{back.stat().st_size:,} bytes", "", "equal", equal)
    back.unlink()


def size(subject: Subject) -> Iterator[Line]:
    yield _size(f"{subject.length}, 150 actors", subject.log, subject.mcap, 0.35)


def trajectories(subject: Subject) -> Iterator[Line]:
    """All trajectories, and one, as processes; the goals are those of an hour, or of the same share of it."""
    share = subject.seconds / 3600
    for (name, path), all_goal, one_goal in zip(subject.both, (4.0, 6.0), (1.0, 2.0), strict=True):
        for what, which, goal, memory in (
            ("all trajectories", "all", all_goal, 1500e6 * share + 100e6 * (1 - share)),
            ("one trajectory", "one", one_goal, 150e6),
        ):
            taken = best(partial(run, sys.executable, "-c", TRAJECTORIES, path, which))
            limit = goal * share + STARTED * (1 - share)
            yield Line(f"{what}, {name}", f"{taken.seconds:.2f} s", "", f"≤ {limit:.2f} s", taken.seconds <= limit)
            yield _memory(f"{what}, {name}", taken.peak, memory)


def collisions(subject: Subject) -> Iterator[Line]:
    from carla_recap.queries.collisions import collisions

    yield from _query("collisions", collisions, subject)


def info(subject: Subject) -> Iterator[Line]:
    from carla_recap.queries.info import info

    yield from _query("info", info, subject)


def blocked(subject: Subject) -> Iterator[Line]:
    """CARLA's distance, for which an MCAP file stores stationary intervals, and another one."""
    from carla_recap.queries.blocked import blocked

    asked = [(name, path, blocked) for name, path in subject.both]
    other = partial(blocked, min_distance=9.0)
    asked += [(f"by 9 cm, {name}", path, other) for name, path in subject.both]
    for (name, path, query), goal in zip(asked, (10, 12, 10, 12), strict=True):
        seconds = min(timed(partial(ask, query, path)) for _ in range(3))
        each = seconds / subject.frames * 1e6
        yield Line(f"blocked, {name}", f"{seconds:.2f} s", f"{each:.1f} µs a frame", f"≤ {goal} µs a frame", each <= goal)


def incidents(subject: Subject) -> Iterator[Line]:
    for name, path in subject.both:
        each = min(timed(partial(_use, QUERIES["incidents"], path)) for _ in range(3)) / subject.frames * 1e6
        total = f"{each * subject.frames / 1e6:.2f} s"
        yield Line(f"incidents, {name}", total, f"{each:.1f} µs a frame", "≤ 20 µs a frame", each <= 20)


def differences(subject: Subject) -> Iterator[Line]:
    """The recording and its conversion, which are equal, and a copy in which all positions differ."""
    moved = DIRECTORY / "moved.log"
    _move(subject.log, moved)
    for what, other in ((".log and .mcap", subject.mcap), ("moved .log", moved)):
        peaks: list[int] = []
        seconds = cpu_time(lambda: peaks.append(run(sys.executable, "-c", DIFFERENCES, subject.log, other).peak))  # noqa: B023
        limit = 14 * subject.seconds / 3600 + 2 * STARTED
        yield Line(f"diff, {what}, processor time", f"{seconds:.1f} s", "", f"≤ {limit:.1f} s", seconds <= limit)
        yield _memory(f"diff, {what}", peaks[0], 700e6)
    moved.unlink()


def _move(source: Path, destination: Path) -> None:
    """Write a recording with all actors 0.3 to 0.5 m aside."""
    from carla_recap.formats import create_writer, open_reader
    from carla_recap.model.batch import Batch, Column, packed

    def moved(column: Column) -> Column:
        if column.type is None or column.type.name != "transforms" or not column.records.size:
            return column
        records = column.records.copy()
        records["x"] += 30 + 20 * np.sin(records["y"])
        return packed(column.type, records)

    reader = open_reader(source)
    with create_writer(destination, reader.header) as writer:
        for batch in reader.batches():
            columns = [moved(column) for column in batch.columns]
            writer.write_batch(Batch(batch.index, batch.id, batch.elapsed, batch.duration, columns, preamble=batch.preamble))
    reader.close()


def info_all(subject: Subject) -> Iterator[Line]:
    from carla_recap.queries.info import info

    everything = partial(info, all=True)
    minute = cut(subject.log, 60 * RATE)
    numbers = sum(1 for _ in NUMBER.finditer(ask(everything, minute)[0]))
    seconds = min(timed(partial(ask, everything, minute)) for _ in range(3))
    each = seconds / numbers * 1e6
    what = f"info --all, {min(subject.seconds, 60):.0f} s"
    yield Line(what, f"{seconds:.2f} s", f"{each:.2f} µs a number", "≤ 0.25 µs a number", each <= 0.25)


def start(subject: Subject) -> Iterator[Line]:
    """Queries of a small file as processes, in proportion to a process that only imports numpy."""
    log = cut(subject.log, SMALL)
    mcap = log.with_suffix(".mcap")
    convert(log, mcap)
    compileall.compile_dir(Path(carla_recap.__file__).parent, quiet=2)  # as an installation does
    works = {
        "--help": partial(run, COMMAND, "--help"),
        "collisions, 10 s, .log": partial(run, COMMAND, "collisions", log),
        "collisions, 10 s, .mcap": partial(run, COMMAND, "collisions", mcap),
        "blocked, 10 s, .log": partial(run, COMMAND, "blocked", log),
    }
    numpy, *taken = medians(partial(run, sys.executable, "-c", "import numpy"), *works.values())
    for what, seconds in zip(works, taken, strict=True):
        ratio = seconds / numpy
        yield Line(f"carla-recap {what}", f"{seconds * 1e3:.0f} ms", f"{ratio:.2f} x numpy", "≤ 1.3 x", ratio <= 1.3)


def real(subject: Subject) -> Iterator[Line]:
    """A recording of CARLA itself, in which most actors do not move."""
    if subject.real:
        mcap = DIRECTORY / "real.mcap"
        convert(subject.real, mcap)
        yield _size("CARLA's own", subject.real, mcap, 0.08)


def of_hero(subject: Subject) -> Iterator[Line]:
    """The measures of the hero against all."""
    yield _asked("measures of the hero", subject, lambda recording: recording.measures("hero"), 12.0)


def near_misses(subject: Subject) -> Iterator[Line]:
    """The near misses of all pairs; the paths of the hour's vehicles cross without any rules."""
    yield _asked("near misses of all", subject, lambda recording: recording.incidents(kinds=["near miss"]), 12.0)


def rules(subject: Subject) -> Iterator[Line]:
    """What vehicles do in relation to the road in the hour, whose vehicles drive across the roads of the built-in town."""
    yield _asked("rules of the road", subject, lambda recording: broken_rules(recording.reader), 15.0)


def remote(subject: Subject) -> Iterator[Line]:
    """Queries of a recording on a web server of this machine, each of whose answers takes 50 ms."""
    from carla_recap import open_recording
    from tests.web import serve

    with serve(subject.mcap.parent.absolute()) as server:
        server.delay = 0.05
        url = f"{server.url}/{subject.mcap.name}"
        for name, query in QUERIES.items():
            taken = []
            for _ in range(3):
                server.reset()
                begin = time.perf_counter()
                with open_recording(url) as recording:
                    query(recording)
                taken.append(time.perf_counter() - begin)
            count = len(server.requests)
            read = f"{count} request{'s' if count > 1 else ''}, {server.sent / 1e6:.2f} MB"
            ok = count <= 2 and server.sent <= 1_000_000
            yield Line(f"{name}, remote .mcap", f"{min(taken):.2f} s", read, "≤ 2, 1 MB", ok)


ROWS: Final = (
    log_to_mcap,
    mcap_to_log,
    size,
    trajectories,
    collisions,
    info,
    blocked,
    incidents,
    differences,
    info_all,
    start,
    real,
    of_hero,
    near_misses,
    rules,
    remote,
)


def ask(query: Query, path: Path) -> tuple[str, int | None]:
    """Return the text of a query, and the bytes of the file that were read, if the reader counts them."""
    from carla_recap.formats import open_reader
    from carla_recap.output.text import text

    reader = open_reader(path)
    try:
        answer = "".join(text(query(reader)))
        return answer, getattr(reader, "bytes_read", None)
    finally:
        reader.close()


def loop_over_headers(log: Path, offset: int) -> None:
    """Read the packet headers of a CARLA log in a bare Python loop, from an offset on: the least that a query needs."""
    with (
        log.open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped,
        memoryview(mapped) as view,
    ):
        head, size = struct.Struct("<BI").unpack_from, len(view)
        while offset < size:
            _, length = head(view, offset)
            offset += 5 + length


def _header_size(log: Path) -> int:
    from carla_recap.formats.carla_log import LogReader, pack_header

    reader = LogReader(log)
    reader.close()
    return len(pack_header(reader.header))


def _use(use: Callable[[Recording], object], path: Path) -> object:
    from carla_recap import open_recording

    with open_recording(path) as recording:
        return use(recording)


def _asked(name: str, subject: Subject, query: Callable[[Recording], object], hour: float) -> Line:
    """The processor time of a query of the recording, whose goal is that of an hour, or of the same share of it."""
    recorded = subject.mcap  # which may be converted first
    seconds = cpu_time(lambda: _use(query, recorded))
    goal = max(hour * subject.seconds / 3600, 1.0)
    each = f"{seconds / subject.frames * 1e6:.0f} µs a frame"
    return Line(f"{name}, {subject.length}", f"{seconds:.1f} s", each, f"≤ {goal:.0f} s", seconds <= goal)


def broken_rules(reader: Reader) -> list[RoadEvent]:
    """Return the rules of the road that vehicles break in a recording of the built-in town."""
    from carla_recap.queries.measures.road import TYPES, RoadSearch
    from carla_recap.queries.recorded_actors import actors
    from carla_recap.roads import find_road_network

    roads = find_road_network("Brickfield")
    assert roads is not None
    search = RoadSearch(reader, roads, actors(reader))
    for batch in reader.batches(TYPES):
        search.add(batch)
    return search.finish()


def _conversion(what: str, seconds: float, source: Path, target: Path, goal: int) -> Iterator[Line]:
    taken = best(partial(convert, source, target))
    factor = seconds / taken.seconds
    yield Line(what, f"{taken.seconds:.2f} s", f"{factor:,.0f} x real time", f"≥ {goal:,} x", factor >= goal)
    yield _memory(what, taken.peak, 100e6)


def _memory(what: str, peak: int, goal: float) -> Line:
    return Line(f"{what}, peak memory", f"{peak / 1e6:.0f} MB", "", f"≤ {goal / 1e6:,.0f} MB", peak <= goal)


def _size(what: str, log: Path, mcap: Path, goal: float) -> Line:
    sizes = mcap.stat().st_size, log.stat().st_size
    ratio = sizes[0] / sizes[1]
    megabytes = " / ".join(f"{size / 1e6:.1f}" for size in sizes) + " MB"
    return Line(f".mcap / .log, {what}", megabytes, f"{ratio:.3f}", f"≤ {goal}", ratio <= goal)


def _query(name: str, query: Query, subject: Subject) -> Iterator[Line]:
    """A query that needs events only: by index in MCAP; in a log in proportion to a bare loop over the packet headers."""
    mcap = subject.mcap
    (seconds,) = medians(lambda: ask(query, mcap))
    yield Line(f"{name}, .mcap", f"{seconds * 1e3:.0f} ms", "", "< 30 ms", seconds < 0.03)
    _, read = ask(query, mcap)
    if read is not None:
        share = read / mcap.stat().st_size
        yield Line(f"{name}, .mcap, bytes read", f"{read:,}", f"{100 * share:.2f} %", "≤ 1 %", share <= 0.01)
    loop = partial(loop_over_headers, subject.log, _header_size(subject.log))
    rounds = [(timed(lambda: ask(query, subject.log)), timed(loop)) for _ in range(3)]
    seconds, bare = map(min, zip(*rounds, strict=True))
    ratio = seconds / bare
    yield Line(f"{name}, .log", f"{seconds * 1e3:.0f} ms", f"{ratio:.2f} x bare loop", "≤ 0.5 x", ratio <= 0.5)
