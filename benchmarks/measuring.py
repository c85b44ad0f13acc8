"""What all benchmarks use: the measured recordings, times and memory of work and of processes, lines of the table."""

from __future__ import annotations

import multiprocessing
import os
import statistics
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from benchmarks.hour import DIRECTORY, RATE, cached

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

COMMAND: Final = Path(sys.executable).with_name("carla-recap")
DATA: Final = Path("../shared/data")
"""Recordings and maps of CARLA itself, which are not part of this repository."""
TOWN: Final = DATA / "maps" / "Town01.xodr"


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
    ratio: str = ""
    goal: str = ""
    ok: bool = True


class Aim(NamedTuple):
    """A figure with the goal that developers aim at."""

    text: str
    goal: str
    ok: bool


def at_most(value: float, form: str, limit: float) -> Aim:
    """Return a figure, as a form such as `{:.1f} s` writes it, that is to be small."""
    return Aim(form.format(value), f"≤ {form.format(limit)}", bool(value <= limit))


def at_least(value: float, form: str, limit: float) -> Aim:
    """Return a figure that is to be great; see `at_most`."""
    return Aim(form.format(value), f"≥ {form.format(limit)}", bool(value >= limit))


def line(what: str, measured: str | Aim, ratio: str | Aim = "") -> Line:
    """Return a line, of which one figure at most has a goal."""
    texts = [each.text if isinstance(each, Aim) else each for each in (measured, ratio)]
    goal, ok = next((each[1:] for each in (measured, ratio) if isinstance(each, Aim)), ("", True))
    return Line(what, *texts, goal, ok)


def memory_line(what: str, peak: float, limit: float, ratio: str = "") -> Line:
    """Return a line of a peak of memory in bytes, whose limit is in MB."""
    return line(f"{what}, peak memory", at_most(peak / 1e6, "{:,.0f} MB", limit), ratio)


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
    def hours(self) -> float:
        return self.seconds / 3600

    @property
    def length(self) -> str:
        return f"{self.seconds:,.0f} s"


class Run(NamedTuple):
    """What a process took."""

    seconds: float
    cpu: float  # s of processors, with those of its child processes
    peak: int  # bytes of memory
    out: bytes = b""
    errors: str = ""


def run(*command: Any, watch: Iterable[Any] | None = None, codes: tuple[int, ...] = (0,)) -> Run:
    """Run a process to its end; its peak memory is at least the memory of this process.

    With `watch`, processes of psutil, it is that of the process, its child processes and these, together.
    """
    with TemporaryFile() as out, TemporaryFile() as errors:
        begin = time.perf_counter()
        process = subprocess.Popen(list(map(str, command)), stdout=out, stderr=errors)
        with _watched(process.pid, watch) as peaks:
            _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        for file in (out, errors):
            file.seek(0)
        text = errors.read().decode()
        if process.returncode not in codes:
            raise subprocess.CalledProcessError(process.returncode, process.args, stderr=text)
        own = usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
        return Run(seconds, usage.ru_utime + usage.ru_stime, max([own, *peaks]), out.read(), text)


@contextmanager
def _watched(pid: int, beside: Iterable[Any] | None) -> Iterator[list[int]]:
    """Look at the memory of a process, its child processes and others, together, 20 times a second."""
    if beside is None:
        yield []
        return
    import psutil

    done, peaks, beside = Event(), [0], list(beside)

    def look() -> None:
        while not done.wait(0.05):
            with suppress(psutil.NoSuchProcess):
                watched = psutil.Process(pid)
                each = (watched, *watched.children(recursive=True), *beside)
                peaks[0] = max(peaks[0], sum(process.memory_info().rss for process in each))

    thread = Thread(target=look)
    thread.start()
    try:
        yield peaks
    finally:
        done.set()
        thread.join()


def recap(*arguments: Any, times: int = 1, **options: Any) -> Run:
    """Run a command of the package several times; return the shortest times and the highest peak."""
    runs = [run(COMMAND, *arguments, **options) for _ in range(times)]
    return runs[-1]._replace(
        seconds=min(each.seconds for each in runs), cpu=min(each.cpu for each in runs), peak=max(each.peak for each in runs)
    )


def convert(source: Path, target: Path) -> Run:
    """Convert a recording in another process; the time to remove an existing target is not included."""
    target.unlink(missing_ok=True)
    return recap("convert", "-q", source, target)


def in_new_process(work: Callable[..., Any], *arguments: Any) -> Any:
    """Run some work in a new process, so that its memory and caches do not depend on other work."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(work, *arguments).result()


def timed(work: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    begin = clock()
    work()
    return clock() - begin


def fastest(work: Callable[[], object], times: int = 3, clock: Callable[[], float] = time.perf_counter) -> float:
    return min(timed(work, clock) for _ in range(times))


def medians(*works: Callable[[], object], times: int = 9) -> list[float]:
    """Return the median seconds of several works, which alternate; a first round is not included."""
    rounds = [[timed(work) for work in works] for _ in range(times + 1)][1:]
    return [statistics.median(taken) for taken in zip(*rounds, strict=True)]


def cut(log: Path, frames: int) -> Path:
    """Write the first frames of a log as a log."""
    from carla_recap import clip

    path = DIRECTORY / f"cut-{frames}.log"
    clip(log, path, start=0.0, duration=frames / RATE, force=True)
    return path


def measure(row: Callable[[Subject], Iterator[Line]], subject: Subject) -> list[Line]:
    return list(row(subject))
