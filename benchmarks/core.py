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
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import carla_recap
from benchmarks.hour import DIRECTORY, RATE
from benchmarks.measuring import (
    COMMAND,
    Line,
    Run,
    Subject,
    at_least,
    at_most,
    convert,
    cut,
    fastest,
    line,
    medians,
    memory_line,
    recap,
    run,
    timed,
)
from carla_recap.output.text import text
from carla_recap.queries.info import info as info_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from carla_recap import Recording

    Query = Callable[[Recording], object]

TRAJECTORIES: Final = (
    "import sys; from carla_recap import open_recording; r = open_recording(sys.argv[1]); "
    "r.trajectory(r.heroes[0].id) if sys.argv[2] == 'one' else r.trajectories()"
)
STARTED: Final = 0.3  # s, for the start of such a process
NUMBER: Final = re.compile(r"(?<!\w)-?(?:\d+(?:\.\d+)?(?:e[+-]\d+)?|nan|inf)\b")
EVENTS: Final[dict[str, Query]] = {
    "collisions": lambda recording: "".join(text(recording.collisions())),
    "info": lambda recording: "".join(text(info_of(recording.reader))),
}
INTERVALS: Final[dict[str, Query]] = {
    "blocked": lambda recording: "".join(text(recording.blocked())),
    "incidents": lambda recording: list(recording.incidents()),
}
RULES: Final = ("red light", "wrong way", "off road", "stop sign", "speeding")


def log_to_mcap(subject: Subject) -> Iterator[Line]:
    yield from _conversion(".log → .mcap", subject, subject.log, subject.log.with_suffix(".mcap"), 1200)


def mcap_to_log(subject: Subject) -> Iterator[Line]:
    back = DIRECTORY / "back.log"
    yield from _conversion(".mcap → .log", subject, subject.mcap, back, 1500)
    equal = filecmp.cmp(subject.log, back, shallow=False)
    yield Line(".log → .mcap → .log", f"{back.stat().st_size:,} bytes", "", "equal", equal)
    back.unlink()


def size(subject: Subject) -> Iterator[Line]:
    yield _size(f"{subject.length}, 150 actors", subject.log, subject.mcap, 0.35)


def trajectories(subject: Subject) -> Iterator[Line]:
    """All trajectories, and one, as processes; the goals are those of an hour, or of the same share of it."""
    share = subject.hours
    for (name, path), all_goal, one_goal in zip(subject.both, (4.0, 6.0), (1.0, 2.0), strict=True):
        for which, goal, memory in (("all", all_goal, 1500 * share + 100 * (1 - share)), ("one", one_goal, 150)):
            what = f"{which} {'trajectories' if which == 'all' else 'trajectory'}, {name}"
            runs = [run(sys.executable, "-c", TRAJECTORIES, path, which) for _ in range(3)]
            limit = goal * share + STARTED * (1 - share)
            yield line(what, at_most(min(each.seconds for each in runs), "{:.2f} s", limit))
            yield memory_line(what, max(each.peak for each in runs), memory)


def collisions(subject: Subject) -> Iterator[Line]:
    yield from _events("collisions", subject)


def info(subject: Subject) -> Iterator[Line]:
    yield from _events("info", subject)


def blocked(subject: Subject) -> Iterator[Line]:
    """CARLA's distance, for which an MCAP file stores stationary intervals, and another one."""
    for name, path in subject.both:
        yield _each_frame(f"blocked, {name}", INTERVALS["blocked"], path, subject, 12)
    by_9_cm = partial(carla_recap.Recording.blocked, min_distance=9.0)
    yield _each_frame("blocked, by 9 cm, .mcap", lambda recording: list(by_9_cm(recording)), subject.mcap, subject, 12)


def incidents(subject: Subject) -> Iterator[Line]:
    for name, path in subject.both:
        yield _each_frame(f"incidents, {name}", INTERVALS["incidents"], path, subject, 20)


def differences(subject: Subject) -> Iterator[Line]:
    """The recording and its conversion, which are equal, and a copy in which all positions differ."""
    moved = DIRECTORY / "moved.log"
    _move(subject.log, moved)
    for what, other in (("diff, .log and .mcap", subject.mcap), ("diff, moved .log", moved)):
        taken = recap("diff", subject.log, other, codes=(0, 1))
        yield line(f"{what}, processor time", at_most(taken.cpu, "{:.1f} s", 14 * subject.hours + 2 * STARTED))
        yield memory_line(what, taken.peak, 700)
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
    def everything() -> str:
        return _use(lambda recording: "".join(text(info_of(recording.reader, all=True))), minute)[0]

    minute = cut(subject.log, 60 * RATE)
    numbers = sum(1 for _ in NUMBER.finditer(everything()))
    seconds = fastest(everything)
    each = at_most(seconds / numbers * 1e6, "{:.2f} µs a number", 0.25)
    yield line(f"info --all, {min(subject.seconds, 60):.0f} s", f"{seconds:.2f} s", each)


def start(subject: Subject) -> Iterator[Line]:
    """Queries of a small file as processes, in proportion to a process that only imports numpy."""
    log = cut(subject.log, 10 * RATE)
    mcap = log.with_suffix(".mcap")
    convert(log, mcap)
    compileall.compile_dir(Path(carla_recap.__file__).parent, quiet=2)  # as an installation does
    works = {"--help": ["--help"], **{f"collisions, 10 s, {path.suffix}": ["collisions", path] for path in (log, mcap)}}
    processes = [(sys.executable, "-c", "import numpy"), *((COMMAND, *arguments) for arguments in works.values())]
    numpy, *taken = medians(*(partial(run, *process) for process in processes))
    for what, seconds in zip(works, taken, strict=True):
        yield line(f"carla-recap {what}", f"{seconds * 1e3:.0f} ms", at_most(seconds / numpy, "{:.2f} x numpy", 1.3))


def real(subject: Subject) -> Iterator[Line]:
    """A recording of CARLA itself, in which most actors do not move."""
    if subject.real:
        mcap = DIRECTORY / "real.mcap"
        convert(subject.real, mcap)
        yield _size("CARLA's own", subject.real, mcap, 0.08)


def of_hero(subject: Subject) -> Iterator[Line]:
    """The measures of the hero against all."""
    yield _processor_time("measures of the hero", subject, lambda recording: recording.measures("hero"), 12.0)


def near_misses(subject: Subject) -> Iterator[Line]:
    """The near misses of all pairs; the paths of the hour's vehicles cross without any rules."""
    found = partial(carla_recap.Recording.incidents, kinds=["near miss"])
    yield _processor_time("near misses of all", subject, found, 12.0)


def rules(subject: Subject) -> Iterator[Line]:
    """What vehicles do in relation to the road in the hour, whose vehicles drive across the roads of the built-in town."""
    yield _processor_time("rules of the road", subject, broken_rules, 15.0)


def remote(subject: Subject) -> Iterator[Line]:
    """Queries of a recording on a web server of this machine, each of whose answers takes 50 ms."""
    from tests.web import serve

    with serve(subject.mcap.parent.absolute()) as server:
        server.delay = 0.05
        for name, query in (EVENTS | INTERVALS).items():
            taken = []
            for _ in range(3):
                server.reset()
                taken.append(timed(lambda: _use(query, f"{server.url}/{subject.mcap.name}")))  # noqa: B023
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


def broken_rules(recording: Recording) -> list[Any]:
    """Return the rules of the road that vehicles break in a recording, by the map of the built-in town."""
    from carla_recap.roads import find_road_network

    return list(recording.incidents(kinds=RULES, roads=find_road_network("Brickfield")))


def _use(query: Query, location: Path | str) -> tuple[Any, int | None]:
    """Return the answer to a query, and the bytes of the file that were read, if the reader counts them."""
    with carla_recap.open_recording(location) as recording:
        return query(recording), getattr(recording.reader, "bytes_read", None)


def _loop_over_headers(log: Path) -> None:
    """Read the packet headers of a CARLA log in a bare Python loop: the least that a query needs."""
    from carla_recap.formats.carla_log import LogReader, pack_header

    reader = LogReader(log)
    reader.close()
    offset = len(pack_header(reader.header))
    with (
        log.open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped,
        memoryview(mapped) as view,
    ):
        head, size = struct.Struct("<BI").unpack_from, len(view)
        while offset < size:
            _, length = head(view, offset)
            offset += 5 + length


def _processor_time(name: str, subject: Subject, query: Query, hour: float) -> Line:
    """The processor time of a query of the recording, whose goal is that of an hour, or of the same share of it."""
    recorded = subject.mcap  # which may be converted first
    seconds = timed(lambda: _use(query, recorded), time.process_time)
    each = f"{seconds / subject.frames * 1e6:.0f} µs a frame"
    return line(f"{name}, {subject.length}", at_most(seconds, "{:.1f} s", max(hour * subject.hours, 1.0)), each)


def _each_frame(what: str, query: Query, path: Path, subject: Subject, goal: float) -> Line:
    seconds = fastest(lambda: _use(query, path))
    return line(what, f"{seconds:.2f} s", at_most(seconds / subject.frames * 1e6, "{:.1f} µs a frame", goal))


def _conversion(what: str, subject: Subject, source: Path, target: Path, goal: int) -> Iterator[Line]:
    runs: list[Run] = [convert(source, target) for _ in range(3)]
    seconds = min(each.seconds for each in runs)
    yield line(what, f"{seconds:.2f} s", at_least(subject.seconds / seconds, "{:,.0f} x real time", goal))
    yield memory_line(what, max(each.peak for each in runs), 100)


def _size(what: str, log: Path, mcap: Path, goal: float) -> Line:
    sizes = mcap.stat().st_size, log.stat().st_size
    megabytes = " / ".join(f"{size / 1e6:.1f}" for size in sizes) + " MB"
    return line(f".mcap / .log, {what}", megabytes, at_most(sizes[0] / sizes[1], "{:.3f}", goal))


def _events(name: str, subject: Subject) -> Iterator[Line]:
    """A query that needs events only: by index in MCAP; in a log in proportion to a bare loop over the packet headers."""
    query, mcap = EVENTS[name], subject.mcap
    (seconds,) = medians(lambda: _use(query, mcap))
    yield line(f"{name}, .mcap", at_most(seconds * 1e3, "{:.0f} ms", 30))
    _, read = _use(query, mcap)
    assert read is not None
    yield line(f"{name}, .mcap, bytes read", f"{read:,}", at_most(100 * read / mcap.stat().st_size, "{:.2f} %", 1))
    rounds = [(timed(lambda: _use(query, subject.log)), timed(lambda: _loop_over_headers(subject.log))) for _ in range(3)]
    seconds, bare = map(min, zip(*rounds, strict=True))
    yield line(f"{name}, .log", f"{seconds * 1e3:.0f} ms", at_most(seconds / bare, "{:.2f} x bare loop", 0.5))
