"""Many recordings: 5,000 copies of the samples, 50 of them broken in one of ten ways; and a campaign of many runs."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, Final

from benchmarks.campaign import make
from benchmarks.hour import DIRECTORY, FRAMES
from benchmarks.measuring import COMMAND, Line, Subject, cpu_time, run_watched

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from distributed import Client

    from carla_recap.sim.world import World

MOST: Final = 5000
BROKEN: Final = 100  # recordings, one of which is broken
RUNS: Final = 1000
KILL: Final = 10.0  # s between two kills
WORKERS: Final = 2  # of the cluster
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
            peaks.append(run_watched(command, codes=(0, 2))[2])
        small, large = peaks
        more = large - small
        ratio = f"{small / 1e6:.0f} MB for {count // 10:,}"
        yield Line(f"{what} of {count:,}, peak memory", f"{large / 1e6:.0f} MB", ratio, "+ ≤ 60 MB", more <= MEMORY)


def drive(world: World, vehicles: int) -> None:
    """Spawn traffic; the campaign ticks on."""
    from carla_recap.sim.traffic import populate

    populate(world, vehicles, 0, hero=True)


def campaign_kills(subject: Subject) -> Iterator[Line]:
    """Short runs on a cluster of two workers, one of which is killed every 10 s."""
    import dask
    from distributed import LocalCluster

    from carla_recap.fleet.campaign import campaign
    from carla_recap.fleet.cluster import connect

    count = RUNS if subject.frames >= FRAMES else 20
    folder, done, kills = DIRECTORY / "cluster", Event(), []
    shutil.rmtree(folder, ignore_errors=True)
    options = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "silence_logs": 30}
    patience = {"distributed.deploy.lost-worker-timeout": "10 minutes"}  # else a slow machine closes the cluster
    with (
        dask.config.set(patience),
        LocalCluster(n_workers=WORKERS, threads_per_worker=1, processes=True, **options) as cluster,
        connect(cluster.scheduler_address) as client,
    ):
        killer = Thread(target=_kill, args=(client, done, kills))
        killer.start()
        try:
            begin = time.perf_counter()
            given = {"vehicles": [5]}
            found = list(campaign(drive, seeds=range(count), params=given, out=folder, duration=2.0, client=client))
            seconds = time.perf_counter() - begin
        finally:
            done.set()
            killer.join()
    there = len(list(folder.glob("*.mcap")))
    failed = sum(finished.report.error is not None for finished in found)
    is_whole = there == count == len({finished.run.name for finished in found}) and not failed
    what = f"{count:,} runs on Dask, {len(kills)} workers killed"
    yield Line(what, f"{there:,} recordings, {failed} failed", f"{seconds:.0f} s", "all there, none twice", is_whole)


def _kill(client: Client, done: Event, kills: list[int]) -> None:
    while not done.wait(KILL):
        workers = [*client.run(os.getpid).values()]
        if len(workers) == WORKERS:  # else the one that was killed last has not been started again
            os.kill(workers[0], signal.SIGKILL)
            kills.append(workers[0])


ROWS: Final = (indexing, many_collisions, many_memory, campaign_kills)


def _campaign(subject: Subject) -> tuple[Path, int]:
    """Return the folder of a campaign, and the number of its recordings, which are few in a short run of all benchmarks."""
    count = MOST if subject.frames >= FRAMES else BROKEN
    folder = DIRECTORY / f"campaign-{count}"
    if not folder.exists():
        unfinished = folder.with_suffix(".unfinished")
        shutil.rmtree(unfinished, ignore_errors=True)
        make(unfinished, count, count // BROKEN)
        unfinished.rename(folder)
    return folder, count


def _new_index() -> Path:
    index = DIRECTORY / "index.duckdb"
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


def contents(index: Path) -> dict[str, list[str]]:
    """Return the rows of all tables of an index as texts, in an order of their own."""
    from carla_recap import open_index
    from carla_recap.fleet.index.tables import TABLES

    opened = open_index(index)
    return {name: sorted(map(repr, opened.table(name).to_pylist())) for name in TABLES}
