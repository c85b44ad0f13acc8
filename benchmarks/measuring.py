"""What all benchmarks use: the measured recordings, times and memory of work and of processes, lines of the table."""

from __future__ import annotations

import multiprocessing
import os
import resource
import statistics
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, Final

from benchmarks.hour import DIRECTORY, RATE, cached

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

COMMAND: Final = Path(sys.executable).with_name("carla-recap")
CONVERT: Final = "import sys; from carla_recap.editing.convert import convert; convert(*sys.argv[1:], force=True)"


@dataclass(frozen=True)
class Line:
    """A line of the table.

    Attributes:
        what: The name of what is measured, which no other line has.
        measured: The figure with its unit.
        ratio: The same in proportion to something else, or another figure.
        goal: What developers aim at.
        ok: Whether the goal is met.
    """

    what: str
    measured: str
    ratio: str
    goal: str
    ok: bool


class Missing(Exception):
    """A program that a row needs is not installed; the message is its name."""


@dataclass(frozen=True)
class Subject:
    """The measured recordings: the synthetic hour, or a shorter one, and a recording of CARLA if there is one."""

    frames: int
    real: Path | None = None

    @property
    def log(self) -> Path:
        return cached(self.frames)

    @property
    def mcap(self) -> Path:
        """The recording as MCAP; it is converted again if the sources are newer."""
        path = self.log.with_suffix(".mcap")
        newest = max((source.stat().st_mtime for source in Path("src").rglob("*.py")), default=0.0)
        if not path.exists() or path.stat().st_mtime < newest:
            convert(self.log, path)
        return path

    @property
    def both(self) -> tuple[tuple[str, Path], tuple[str, Path]]:
        """The recording in either format, with the name of the format."""
        return (".log", self.log), (".mcap", self.mcap)

    @property
    def seconds(self) -> float:
        return self.frames / RATE

    @property
    def length(self) -> str:
        return f"{self.seconds:,.0f} s"


@dataclass(frozen=True)
class Run:
    """Seconds and peak memory, in bytes, of a process."""

    seconds: float
    peak: int


def run(*command: str | Path) -> Run:
    """Run a process to its end; its peak memory is at least the memory of this process."""
    begin = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    seconds = time.perf_counter() - begin
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, [str(part) for part in command])
    return Run(seconds, usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024))


def run_watched(command: list[Any], beside: Iterable[Any] = (), codes: tuple[int, ...] = (0,)) -> tuple[bytes, float, int]:
    """Return what a command prints, its seconds, and the peak memory of it, its child processes and others, together.

    The memory is looked at 20 times a second.
    """
    import psutil

    peak, begin = 0, time.perf_counter()
    with TemporaryFile() as out:
        with subprocess.Popen(list(map(str, command)), stdout=out, stderr=subprocess.DEVNULL) as process:
            watched = psutil.Process(process.pid)
            while process.poll() is None:
                with suppress(psutil.NoSuchProcess):
                    processes = (watched, *watched.children(recursive=True), *beside)
                    peak = max(peak, sum(each.memory_info().rss for each in processes))
                time.sleep(0.05)
        seconds = time.perf_counter() - begin
        if process.returncode not in codes:
            raise subprocess.CalledProcessError(process.returncode, process.args)
        out.seek(0)
        return out.read(), seconds, peak


def best(work: Callable[[], Run], times: int = 3) -> Run:
    """Return the shortest time and the highest peak of several runs."""
    runs = [work() for _ in range(times)]
    return Run(min(each.seconds for each in runs), max(each.peak for each in runs))


def convert(source: Path, target: Path) -> Run:
    """Convert a recording in another process; the time to remove an existing target is not included."""
    target.unlink(missing_ok=True)
    return run(sys.executable, "-c", CONVERT, source, target)


def in_new_process(work: Callable[..., Any], *arguments: Any) -> Any:
    """Run some work in a new process, so that its memory and caches do not depend on other work."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(work, *arguments).result()


def timed(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def cpu_time(work: Callable[[], object]) -> float:
    """Return the processor time of some work in s, threads and ended child processes included."""
    begin = _cpu_time()
    work()
    return _cpu_time() - begin


def _cpu_time() -> float:
    usages = [resource.getrusage(which) for which in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def medians(*works: Callable[[], object], times: int = 9) -> list[float]:
    """Return the median seconds of several works, which alternate; a first round is not included."""
    rounds = [[timed(work) for work in works] for _ in range(times + 1)][1:]
    return [statistics.median(taken) for taken in zip(*rounds, strict=True)]


def cut(log: Path, frames: int) -> Path:
    """Write the first frames of a log as a log."""
    from carla_recap.formats.carla_log import LogReader, LogWriter

    path = DIRECTORY / f"cut-{frames}.log"
    reader = LogReader(log)
    with LogWriter(path, reader.header) as writer:
        for frame in islice(reader.frames(), frames):
            writer.write(frame)
    reader.close()
    return path


def measure(row: Callable[[Subject], Iterator[Line]], subject: Subject) -> list[Line]:
    return list(row(subject))
