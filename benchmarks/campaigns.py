"""Campaigns: runs of 60 s by one worker and by two, and short runs on a cluster whose workers are killed."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import statistics
import time
from threading import Event, Thread
from typing import TYPE_CHECKING, Final

from benchmarks.hour import DIRECTORY, FRAMES
from benchmarks.measuring import Line, Subject

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from distributed import Client

    from carla_recap.fleet.campaign import FinishedRun

RUNS: Final = 40
SECONDS: Final = 60.0
VEHICLES: Final = 30
MANY: Final = 1000
KILL: Final = 10.0  # s between two kills
WORKERS: Final = 2  # of the cluster


def drive(world: object, vehicles: int = VEHICLES) -> None:
    """Spawn traffic; the campaign ticks on."""
    from carla_recap.sim.traffic import populate

    populate(world, vehicles, 0, hero=True)  # type: ignore[arg-type]


def campaign_workers(subject: Subject) -> Iterator[Line]:
    """The same runs by one worker and by two, without the start of the workers: the first runs of each do not count."""
    count = RUNS if subject.frames >= FRAMES else 4
    times, cpu, prepared = {}, {}, []
    for workers in (1, 2):
        before = _children_cpu()
        found = list(_timed(_folder(f"workers-{workers}"), count, workers))
        cpu[workers] = _children_cpu() - before
        times[workers] = found[-1][0] - found[workers - 1][0]
        prepared += [finished.report.preparing for _, finished in found]
    rate = {workers: (count - workers) / seconds for workers, seconds in times.items()}
    gain = rate[2] / rate[1]
    what = f"{count} runs of {SECONDS:g} s with {VEHICLES} vehicles"
    each = {workers: f"{used / count:.2f} s of processor time each" for workers, used in cpu.items()}
    yield Line(f"{what}, one worker", f"{times[1]:.0f} s", each[1], "", True)
    yield Line(f"{what}, two workers", f"{times[2]:.0f} s", each[2], "", True)
    yield Line("two workers instead of one", f"{gain:.2f} times as fast", "", "≥ 1.8 times", gain >= 1.8)
    start = statistics.median(prepared)
    most = f"at most {max(prepared):.2f} s"
    yield Line("start of a run, the town loaded", f"{start:.3f} s", most, "≤ 0.3 s", start <= 0.3)


def campaign_kills(subject: Subject) -> Iterator[Line]:
    """Short runs on a cluster of two workers, one of which is killed every 10 s."""
    import dask
    from distributed import LocalCluster

    from carla_recap.fleet.campaign import campaign
    from carla_recap.fleet.cluster import connect

    count = MANY if subject.frames >= FRAMES else 20
    folder, done, kills = _folder("cluster"), Event(), []
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


ROWS: Final = (campaign_workers, campaign_kills)


def _timed(folder: Path, count: int, workers: int) -> Iterator[tuple[float, FinishedRun]]:
    """Yield the runs of a campaign, each with the time at which it was known."""
    from carla_recap.fleet.campaign import campaign

    for finished in campaign(drive, seeds=range(count), out=folder, duration=SECONDS, jobs=workers):
        assert finished.report.error is None, finished.report.error
        yield time.perf_counter(), finished


def _kill(client: Client, done: Event, kills: list[int]) -> None:
    while not done.wait(KILL):
        workers = [*client.run(os.getpid).values()]
        if len(workers) == WORKERS:  # else the one that was killed last has not been started again
            os.kill(workers[0], signal.SIGKILL)
            kills.append(workers[0])


def _children_cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _folder(name: str) -> Path:
    folder = DIRECTORY / "campaigns" / name
    shutil.rmtree(folder, ignore_errors=True)
    return folder
