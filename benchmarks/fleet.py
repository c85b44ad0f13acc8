"""Many recordings: 5,000 copies of the samples, 50 of them broken in one of ten ways."""

from __future__ import annotations

import random
import shutil
import subprocess
import time
from typing import TYPE_CHECKING, Any, Final

from benchmarks.campaign import make
from benchmarks.hour import DIRECTORY, FRAMES
from benchmarks.measuring import COMMAND, Line, Subject, cpu_time

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

MOST: Final = 5000
BROKEN: Final = 100  # recordings, one of which is broken
KILLED: Final = 1000
KILLS: Final = 10
MEMORY: Final = 60e6  # bytes, which ten times as many recordings may take in addition


def indexing(subject: Subject) -> Iterator[Line]:
    """An index is written, its recordings are found unchanged, and SQL joins its tables."""
    runs, count = _campaign(subject)
    index = _new_index()
    lines, seconds, cpu = _run("index", runs, index)
    rate, failed = count / seconds, count // BROKEN
    ratio = f"{cpu / count * 1e3:.1f} ms of processor time each"
    yield Line(f"{count:,} recordings indexed", f"{rate:.0f} a second", ratio, "≥ 120 /s", rate >= 120)
    expected = f"{count:,} recordings: {count - failed:,} read, {failed} failed, 0 unchanged"
    yield Line("of these", lines[-1].partition(": ")[2], "", f"{failed} errors named", lines[-1].endswith(expected))
    size = index.stat().st_size
    yield Line("the index", f"{size / 1e6:.1f} MB", f"{size / count:.0f} bytes each", "", True)
    _, seconds, _ = _run("index", runs, index)
    yield Line(f"{count:,} unchanged recordings", f"{seconds:.1f} s", "", "≤ 5 s", seconds <= 5)
    query = "select map, count(*) from recordings anti join collisions using (recording) group by map"
    _, seconds, _ = _run("sql", index, query)
    yield Line("a question in SQL", f"{seconds:.1f} s", "", "≤ 3 s", seconds <= 3)


def index_kills(subject: Subject) -> Iterator[Line]:
    """A process that writes an index is killed ten times at random moments, and then ends."""
    runs, count = _campaign(subject, KILLED)
    expected, index = _new_index("expected"), _new_index()
    _, seconds, _ = _run("index", runs, expected)
    rng = random.Random(5)
    for _ in range(KILLS):
        process = subprocess.Popen([COMMAND, "index", runs, index], stderr=subprocess.DEVNULL)
        try:
            process.wait(rng.uniform(0.2, 0.4) * max(seconds, 5.0))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    lines, _, _ = _run("index", runs, index)
    left = lines[-1].rpartition(": ")[2]
    equal = contents(index) == contents(expected)
    yield Line(f"{count:,} recordings, {KILLS} kills", f"at the end {left}", "", "equal tables", equal)


def many_collisions(subject: Subject) -> Iterator[Line]:
    runs, count = _campaign(subject)
    _, seconds, cpu = _run("collisions", "--json", runs)
    rate = count / seconds
    ratio = f"{cpu / count * 1e3:.1f} ms of processor time each"
    yield Line(f"collisions of {count:,} recordings", f"{rate:.0f} a second", ratio, "≥ 500 /s", rate >= 500)


def many_memory(subject: Subject) -> Iterator[Line]:
    """The peak memory of the commands' processes, workers included, for ten times as many recordings."""
    runs, count = _campaign(subject)
    few = runs.with_name(f"campaign-{count // 10}")
    if not few.exists():
        make(few, count // 10)
    for what in ("collisions", "index"):
        peaks = []
        for folder in (few, runs):
            command = [COMMAND, what, "--jobs", "2", folder, *([_new_index()] if what == "index" else ["--json"])]
            peaks.append(_peak(command))
        small, large = peaks
        more = large - small
        ratio = f"{small / 1e6:.0f} MB for {count // 10:,}"
        yield Line(f"{what} of {count:,}, peak memory", f"{large / 1e6:.0f} MB", ratio, "+ ≤ 60 MB", more <= MEMORY)


ROWS: Final = (indexing, index_kills, many_collisions, many_memory)


def _campaign(subject: Subject, most: int = MOST) -> tuple[Path, int]:
    """Return the folder of a campaign, and the number of its recordings, which are few in a short run of all benchmarks."""
    count = most if subject.frames >= FRAMES else BROKEN
    folder = DIRECTORY / f"campaign-{count}"
    if not folder.exists():
        unfinished = folder.with_suffix(".unfinished")
        shutil.rmtree(unfinished, ignore_errors=True)
        make(unfinished, count, count // BROKEN)
        unfinished.rename(folder)
    return folder, count


def _new_index(name: str = "index") -> Path:
    index = DIRECTORY / f"{name}.duckdb"
    index.unlink(missing_ok=True)
    return index


def _run(*arguments: Any) -> tuple[list[str], float, float]:
    """Run a command that may fail; return the lines on stderr, the seconds, and the processors' seconds."""
    done = None

    def run() -> None:
        nonlocal done
        done = subprocess.run([COMMAND, *arguments], capture_output=True, text=True, check=False)

    begin = time.perf_counter()
    cpu = cpu_time(run)
    assert done is not None
    assert done.returncode in (0, 2), done.stderr
    return done.stderr.splitlines(), time.perf_counter() - begin, cpu


def _peak(command: list[Any]) -> int:
    """Return the peak of the memory of a command and its workers together, in bytes, sampled 20 times a second."""
    import psutil

    peak = 0
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        watched = psutil.Process(process.pid)
        while process.poll() is None:
            memory = 0
            try:
                for each in (watched, *watched.children(recursive=True)):
                    memory += each.memory_info().rss
            except psutil.NoSuchProcess:
                pass
            peak = max(peak, memory)
            time.sleep(0.05)
    return peak


def contents(index: Path) -> dict[str, list[str]]:
    """Return the rows of all tables of an index as texts, in an order of their own."""
    from carla_recap import open_index
    from carla_recap.fleet.index.tables import TABLES

    opened = open_index(index)
    return {name: sorted(map(repr, opened.table(name).to_pylist())) for name in TABLES}
