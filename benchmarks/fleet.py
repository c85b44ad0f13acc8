"""Many recordings: 5,000 copies of the samples, 50 of them broken in one of ten ways; and a campaign of many runs."""

from __future__ import annotations

import os
import shutil
import signal
import time
from contextlib import contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING, Any, Final

from benchmarks.campaign import make
from benchmarks.hour import DIRECTORY, FRAMES
from benchmarks.measuring import Line, Run, Subject, at_least, at_most, line, recap

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from distributed import Client

    from carla_recap.sim.world import World

MOST: Final = 5000
BROKEN: Final = 100  # recordings, one of which is broken
RUNS: Final = 1000
KILL: Final = 10.0  # s between two kills
MEMORY: Final = 60e6  # bytes, which ten times as many recordings may take in addition


def indexing(subject: Subject) -> Iterator[Line]:
    """An index is written, its recordings are found unchanged, and SQL joins its tables."""
    runs, count = _campaign(subject)
    index = _new_index()
    yield _rate(f"{count:,} recordings indexed", _run("index", runs, index), count, 120)
    size = index.stat().st_size
    yield line("the index", f"{size / 1e6:.1f} MB", f"{size / count:.0f} bytes each")
    yield line(f"{count:,} unchanged recordings", at_most(_run("index", runs, index).seconds, "{:.1f} s", 5))
    query = "select map, count(*) from recordings anti join collisions using (recording) group by map"
    yield line("a question in SQL", at_most(_run("sql", index, query).seconds, "{:.1f} s", 3))


def many_collisions(subject: Subject) -> Iterator[Line]:
    runs, count = _campaign(subject)
    yield _rate(f"collisions of {count:,} recordings", _run("collisions", "--json", runs), count, 500)


def many_memory(subject: Subject) -> Iterator[Line]:
    """The peak memory of the commands' processes, workers included, for ten times as many recordings."""
    runs, count = _campaign(subject)
    few = runs.with_name(f"campaign-{count // 10}")
    if not few.exists():
        make(few, count // 10)
    for what in ("collisions", "index"):
        small, large = (
            _run(what, "--jobs", 2, folder, *([_new_index()] if what == "index" else ["--json"]), watch=()).peak
            for folder in (few, runs)
        )
        ratio = f"{small / 1e6:.0f} MB for {count // 10:,}"
        ok = large - small <= MEMORY
        yield Line(f"{what} of {count:,}, peak memory", f"{large / 1e6:.0f} MB", ratio, "+ ≤ 60 MB", ok)


def drive(world: World, vehicles: int) -> None:
    """Spawn traffic; the campaign ticks on."""
    from carla_recap.sim.traffic import populate

    populate(world, vehicles, 0, hero=True)


def campaign_kills(subject: Subject) -> Iterator[Line]:
    """Short runs on a cluster of two workers, one of which is killed every 10 s."""
    from carla_recap.fleet.campaign import campaign
    from carla_recap.fleet.cluster import connect

    count = RUNS if subject.frames >= FRAMES else 20
    folder, done, kills = DIRECTORY / "cluster", Event(), []
    shutil.rmtree(folder, ignore_errors=True)
    with local_cluster(2) as cluster, connect(cluster.scheduler_address) as client:
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
        if len(workers) > 1:  # else the one that was killed last has not been started again
            os.kill(workers[0], signal.SIGKILL)
            kills.append(workers[0])


ROWS: Final = (indexing, many_collisions, many_memory, campaign_kills)


@contextmanager
def local_cluster(workers: int) -> Iterator[Any]:
    """Start a cluster of Dask on this machine."""
    import dask
    from distributed import LocalCluster

    settings = {
        "distributed.deploy.lost-worker-timeout": "10 minutes",  # else a slow machine closes the cluster
        "distributed.worker.profile.enabled": False,  # it keeps what it has seen, 100 MB for each worker
    }
    options = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "silence_logs": 50}
    with (
        dask.config.set(settings),
        LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, **options) as cluster,
    ):
        yield cluster


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


def _run(*arguments: Any, **options: Any) -> Run:
    """Run a command, some of whose recordings cannot be read."""
    return recap(*arguments, codes=(0, 2), **options)


def _rate(what: str, taken: Run, count: int, least: float) -> Line:
    each = f"{taken.cpu / count * 1e3:.1f} ms of processor time each"
    return line(what, at_least(count / taken.seconds, "{:.0f} a second", least), each)
