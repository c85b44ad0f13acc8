"""What is measured: one function per claim. Each runs in a process of its own, and yields lines of the table.

What depends on the machine is put in relation to something measured in the same run, where that makes sense.
"""

from __future__ import annotations

import filecmp
import mmap
import multiprocessing
import os
import re
import statistics
import struct
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from benchmarks.hour import DIRECTORY, RATE, cached

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from carla_recap import Recording
    from carla_recap.formats.base import Reader
    from carla_recap.queries.blocked import Blocked
    from carla_recap.queries.collisions import Collisions
    from carla_recap.queries.info import Info

    Query = Callable[[Reader], Collisions | Blocked | Info]

CONVERT: Final = "import sys; from carla_recap.editing.convert import convert; convert(*sys.argv[1:], force=True)"
TRAJECTORIES: Final = (
    "import sys; from carla_recap import open_recording; r = open_recording(sys.argv[1]); "
    "r.trajectory(r.heroes[0].id) if sys.argv[2] == 'one' else r.trajectories()"
)
STARTED: Final = 0.3  # s; to start such a process
RESTLESS_FRAMES: Final = 5000
NUMBER: Final = re.compile(r"(?<!\w)-?(?:\d+(?:\.\d+)?(?:e[+-]\d+)?|nan|inf)\b")
SMALL: Final = 10 * RATE  # frames of a small recording


@dataclass(frozen=True)
class Line:
    """A line of the table."""

    what: str
    measured: str
    ratio: str
    goal: str
    ok: bool


@dataclass(frozen=True)
class Subject:
    """What is measured: the synthetic hour, or a shorter one, and a real recording where there is one."""

    frames: int
    real: Path | None = None

    @property
    def log(self) -> Path:
        return cached(self.frames)

    @property
    def mcap(self) -> Path:
        return self.log.with_suffix(".mcap")

    @property
    def seconds(self) -> float:
        return self.frames / RATE

    def both(self) -> Iterator[tuple[str, Path]]:
        """The recording in either format; the MCAP file is made anew if the sources are newer."""
        yield ".log", self.log
        newest = max(source.stat().st_mtime for source in Path("src").rglob("*.py"))
        if not self.mcap.exists() or self.mcap.stat().st_mtime < newest:
            convert(self.log, self.mcap)
        yield ".mcap", self.mcap


def log_to_mcap(subject: Subject) -> Iterator[Line]:
    yield from _conversion(".log → .mcap", subject.seconds, subject.log, subject.mcap, 1200)


def mcap_to_log(subject: Subject) -> Iterator[Line]:
    back = DIRECTORY / "back.log"
    yield from _conversion(".mcap → .log", subject.seconds, subject.mcap, back, 1500)
    equal = filecmp.cmp(subject.log, back, shallow=False)
    yield Line(".log → .mcap → .log", f"{back.stat().st_size:,} bytes", "", "equal", equal)
    back.unlink()


def size(subject: Subject) -> Iterator[Line]:
    *_, (_, mcap) = subject.both()
    yield _size(f"{subject.seconds:,.0f} s, 150 actors", subject.log, mcap, 0.65)
    if subject.real:
        mcap = DIRECTORY / "real.mcap"
        convert(subject.real, mcap)
        yield _size(subject.real.stem, subject.real, mcap, 0.08)


def collisions(subject: Subject) -> Iterator[Line]:
    from carla_recap.queries.collisions import collisions

    yield from _query("collisions", collisions, subject)


def info(subject: Subject) -> Iterator[Line]:
    from carla_recap.queries.info import info

    yield from _query("info", info, subject)


def blocked(subject: Subject) -> Iterator[Line]:
    from carla_recap.queries.blocked import blocked

    asked = [(name, path, blocked) for name, path in subject.both()]
    asked.append(("by 9 cm, .mcap", subject.mcap, partial(blocked, min_distance=9.0)))  # which is not summed up
    for (name, path, query), goal in zip(asked, (10, 12, 12), strict=True):
        seconds = min(timed(partial(ask, query, path)) for _ in range(3))
        each = seconds / subject.frames * 1e6
        yield Line(f"blocked, {name}", f"{seconds:.2f} s", f"{each:.1f} µs/frame", f"≤ {goal} µs/frame", each <= goal)


def info_all(subject: Subject) -> Iterator[Line]:
    from carla_recap.queries.info import info

    everything = partial(info, all=True)
    minute = cut(subject.log, 60 * RATE)
    numbers = sum(1 for _ in NUMBER.finditer(ask(everything, minute)[0]))
    seconds = min(timed(partial(ask, everything, minute)) for _ in range(3))
    each = seconds / numbers * 1e6
    what = f"info --all, {min(subject.seconds, 60):.0f} s"
    yield Line(what, f"{seconds:.2f} s", f"{each:.2f} µs/number", "≤ 0.25 µs/number", each <= 0.25)


def start(subject: Subject) -> Iterator[Line]:
    small = cut(subject.log, SMALL)
    command = Path(sys.executable).with_name("carla-recap")
    bare, aid, query = medians(
        lambda: run(sys.executable, "-c", "pass"),
        lambda: run(command, "--help"),
        lambda: run(command, "collisions", small),
    )
    for what, seconds, goal in (
        ("carla-recap --help", aid, 0.15),
        ("carla-recap collisions, 10 s", query, 0.3),
    ):
        ratio = f"{seconds / bare:.1f} x python"
        yield Line(what, f"{seconds * 1e3:.0f} ms", ratio, f"< {goal * 1e3:.0f} ms", seconds < goal)


def trajectories(subject: Subject) -> Iterator[Line]:
    """All trajectories, and one, as whole processes; the goals are those of an hour, for as much of it as there is."""
    share = subject.seconds / 3600
    for (name, path), all_goal, one_goal in zip(subject.both(), (4.0, 6.0), (1.0, 2.0), strict=True):
        for what, which, goal, memory in (
            ("all trajectories", "all", all_goal, 1500e6 * share + 100e6),
            ("one trajectory", "one", one_goal, 150e6),
        ):
            runs = [run(sys.executable, "-c", TRAJECTORIES, path, which) for _ in range(3)]
            seconds, peak = min(one.seconds for one in runs), max(one.peak for one in runs)
            limit = goal * share + STARTED
            yield Line(f"{what}, {name}", f"{seconds:.2f} s", "", f"≤ {limit:.2f} s", seconds <= limit)
            yield Line(
                f"{what}, {name}, peak memory", f"{peak / 1e6:.0f} MB", "", f"≤ {memory / 1e6:.0f} MB", peak <= memory
            )


def incidents(subject: Subject) -> Iterator[Line]:
    for name, path in subject.both():
        each = _each(_incidents, path, subject.frames)
        yield Line(
            f"incidents, {name}", f"{each * subject.frames / 1e6:.2f} s", f"{each:.1f} µs/frame", "≤ 20 µs/frame", each <= 20
        )


def restless(subject: Subject) -> Iterator[Line]:
    """A recording in which each frame has another number of records than the one before, against one that holds still."""
    frames = min(subject.frames, RESTLESS_FRAMES)
    logs = [cached(frames, restless=restless) for restless in (False, True)]
    mcaps = [log.with_suffix(".mcap") for log in logs]
    back = DIRECTORY / "back.log"
    taken: dict[str, list[float]] = {}
    for log, mcap in zip(logs, mcaps, strict=True):
        taken.setdefault(".log → .mcap", []).append(convert(log, mcap).seconds / frames * 1e6)
        taken.setdefault(".mcap → .log", []).append(convert(mcap, back).seconds / frames * 1e6)
        equal = filecmp.cmp(log, back, shallow=False)
        back.unlink()
        for path in (log, mcap):
            for name, query in QUERIES.items():
                taken.setdefault(f"{name}, {path.suffix}", []).append(_each(query, path, frames))
    yield Line("restless, .log → .mcap → .log", "", "", "equal", equal)
    for what, (steady, odd) in taken.items():
        yield Line(f"restless, {what}", f"{odd:.1f} µs/frame", f"{odd / steady:.1f} x steady", "", True)


def real(subject: Subject) -> Iterator[Line]:
    """A recording of CARLA itself."""
    if not subject.real:
        return
    from carla_recap import open_recording

    mcap, back = DIRECTORY / "real.mcap", DIRECTORY / "back.log"
    with open_recording(subject.real) as recording:
        extent = recording.reader.extent()
    for what, seconds in (
        (".log → .mcap", convert(subject.real, mcap).seconds),
        (".mcap → .log", convert(mcap, back).seconds),
    ):
        yield Line(f"CARLA's own, {what}", f"{seconds:.2f} s", f"{extent.duration / seconds:,.0f} x real time", "", True)
    yield Line("CARLA's own, there and back", "", "", "equal", filecmp.cmp(subject.real, back, shallow=False))
    back.unlink()
    for path in (subject.real, mcap):
        for name, query in QUERIES.items():
            each = _each(query, path, extent.frames)
            yield Line(f"CARLA's own, {name}, {path.suffix}", f"{each:.1f} µs/frame", "", "", True)


def _incidents(recording: Recording) -> object:
    return recording.incidents()


def _collisions(recording: Recording) -> object:
    return list(recording.collisions())


def _blocked(recording: Recording) -> object:
    return recording.blocked(min_distance=9.0)  # which is not summed up


def _trajectory(recording: Recording) -> object:
    return recording.trajectory(recording.heroes[0].id) if recording.heroes else None


QUERIES: Final = {
    "collisions": _collisions,
    "blocked": _blocked,
    "incidents": _incidents,
    "trajectory": _trajectory,
}


def _each(query: Callable[[Recording], object], path: Path, frames: int) -> float:
    """Return the microseconds that a query takes for each frame of a recording."""
    from carla_recap import open_recording

    def ask() -> None:
        with open_recording(path) as recording:
            query(recording)

    return min(timed(ask) for _ in range(3)) / frames * 1e6


ROWS: Final = (
    log_to_mcap,
    mcap_to_log,
    size,
    collisions,
    info,
    blocked,
    info_all,
    trajectories,
    incidents,
    restless,
    real,
    start,
)


def measure(row: Callable[[Subject], Iterator[Line]], subject: Subject) -> list[Line]:
    return list(row(subject))


@dataclass(frozen=True)
class Run:
    """What a whole process took."""

    seconds: float
    peak: int


def run(*command: str | Path) -> Run:
    """Run a process to its end; its peak memory counts from at least what this process holds."""
    begin = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - begin
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, [str(part) for part in command])
    return Run(seconds, usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024))


def convert(source: Path, target: Path) -> Run:
    """Convert a recording in a process of its own; to remove what is in its place does not count."""
    target.unlink(missing_ok=True)
    return run(sys.executable, "-c", CONVERT, source, target)


def in_new_process(work: Callable[..., Any], *arguments: Any) -> Any:
    """Let a fresh process do some work, so that its memory and caches are no other's."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(work, *arguments).result()


def timed(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def medians(*works: Callable[[], object], times: int = 9) -> list[float]:
    """Seconds that some works take, run in turns after a first round that does not count."""
    rounds = [[timed(work) for work in works] for _ in range(times + 1)][1:]
    return [statistics.median(taken) for taken in zip(*rounds, strict=True)]


def ask(query: Query, path: Path) -> tuple[str, int | None]:
    """The text of a query, and how many bytes of the file it took, if the reader counts them."""
    from carla_recap.formats import open_reader
    from carla_recap.queries.output.text import text

    reader = open_reader(path)
    try:
        answer = "".join(text(query(reader)))
        return answer, getattr(reader, "bytes_read", None)
    finally:
        reader.close()


def hop(path: Path, at: int) -> None:
    """The least that a scan of a CARLA log can do in Python: hop from packet header to packet header."""
    with (
        path.open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped,
        memoryview(mapped) as view,
    ):
        head, size = struct.Struct("<BI").unpack_from, len(view)
        while at < size:
            _, length = head(view, at)
            at += 5 + length


def cut(log: Path, frames: int) -> Path:
    """The first frames of a log, as a log."""
    from carla_recap.formats.carla_log import LogReader, LogWriter

    path = DIRECTORY / f"cut-{frames}.log"
    reader = LogReader(log)
    with LogWriter(path, reader.header) as writer:
        for frame in islice(reader.frames(), frames):
            writer.write(frame)
    reader.close()
    return path


def _conversion(what: str, seconds: float, source: Path, target: Path, goal: int) -> Iterator[Line]:
    runs = [convert(source, target) for _ in range(3)]
    best = min(run.seconds for run in runs)
    peak = max(run.peak for run in runs) / 1e6
    factor = seconds / best
    yield Line(what, f"{best:.2f} s", f"{factor:,.0f} x real time", f"≥ {goal:,} x", factor >= goal)
    yield Line(f"{what}, peak memory", f"{peak:.0f} MB", "", "≤ 100 MB", peak <= 100)


def _size(what: str, log: Path, mcap: Path, goal: float) -> Line:
    sizes = mcap.stat().st_size, log.stat().st_size
    ratio = sizes[0] / sizes[1]
    megabytes = " / ".join(f"{size / 1e6:.1f}" for size in sizes) + " MB"
    return Line(f".mcap / .log, {what}", megabytes, f"{ratio:.3f}", f"≤ {goal}", ratio <= goal)


def _query(name: str, query: Query, subject: Subject) -> Iterator[Line]:
    """A query that needs only events: by the index in MCAP, no dearer than the packets' headers in a log."""
    from carla_recap.formats.carla_log import LogReader, pack_header

    *_, (_, mcap) = subject.both()
    (seconds,) = medians(lambda: ask(query, mcap))
    yield Line(f"{name}, .mcap", f"{seconds * 1e3:.1f} ms", "", "< 30 ms", seconds < 0.03)
    _, read = ask(query, mcap)
    if read is not None:
        share = read / mcap.stat().st_size
        yield Line(f"{name}, .mcap, bytes read", f"{read:,}", f"{share:.2%}", "≤ 1 %", share <= 0.01)
    reader = LogReader(subject.log)
    begin = len(pack_header(reader.header))
    reader.close()
    rounds = [(timed(lambda: ask(query, subject.log)), timed(lambda: hop(subject.log, begin))) for _ in range(3)]
    seconds, bare = map(min, zip(*rounds, strict=True))
    ratio = seconds / bare
    yield Line(f"{name}, .log", f"{seconds * 1e3:.0f} ms", f"{ratio:.2f} x bare loop", "≤ 0.5 x", ratio <= 0.5)
