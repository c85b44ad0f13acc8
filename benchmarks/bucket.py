"""Commands on many small recordings in a bucket, by processes of this machine and on a Dask cluster: answers and memory.

`python -m benchmarks.bucket --count 10000` also says whether the answers of both are equal.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import psutil
from distributed import LocalCluster

from benchmarks.fleet import MEMORY, contents
from benchmarks.measuring import COMMAND, run_watched
from tests.web import serve_bucket

BUCKET: Final = "runs"
KINDS: Final = 4  # different recordings, which are repeated
WORKERS: Final = 4  # of the cluster
FEW: Final = 200  # recordings, at least, whose memory is compared with that of all: enough that each worker has some


def few(count: int) -> int:
    """Return how many of some recordings are read first, for comparison."""
    return max(count // 10, FEW)


def make(folder: Path, count: int) -> None:
    """Fill a folder with small simulations of 2 s, of which there are four; the first ones are in a folder of their own."""
    for number in range(count):
        path = folder / ("few" if number < few(count) else "others") / f"{number:05}.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        if number >= KINDS:
            path.hardlink_to(folder / "few" / f"{number % KINDS:05}.mcap")
            continue
        what = ["--vehicles", "3", "--walkers", "1", "--hero", "--duration", "2", "--seed", str(number), "-q"]
        subprocess.run([COMMAND, "record", path, *what], check=True)


def commands(source: str, work: Path) -> dict[str, list[Any]]:
    """Return the commands, by name; what they write is in a folder."""
    return {
        "index": [COMMAND, "index", source, work / "index.duckdb"],
        "collisions": [COMMAND, "collisions", "--json", source],
        "score --from-drive": [COMMAND, "score", "--from-drive", "--json", source],
        "convert": [COMMAND, "convert", "-q", "--to", "log", source, work / "converted"],
    }


def result(name: str, printed: bytes, work: Path) -> str:
    """Return a hash of what a command has answered or written."""
    found = hashlib.sha256(printed)
    if name == "index":
        found.update(repr(contents(work / "index.duckdb")).encode())
    if name == "convert":
        for path in sorted(work.joinpath("converted").rglob("*.log")):
            found.update(path.relative_to(work).as_posix().encode() + path.read_bytes())
    return found.hexdigest()


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bucket", description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="of recordings (default: %(default)s)")
    parser.add_argument("--only", action="append", choices=commands("", Path()), metavar="NAME")
    options = parser.parse_args()
    count, failed = options.count, False
    cluster_options = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "silence_logs": 50}
    os.environ["DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED"] = "False"  # it keeps what it has seen, 100 MB for each worker
    with TemporaryDirectory(prefix="bucket-") as name:
        work = Path(name)
        make(work / "recordings", count)
        with (
            serve_bucket(BUCKET, work / "recordings"),
            LocalCluster(n_workers=WORKERS, threads_per_worker=1, processes=True, **cluster_options) as cluster,
        ):
            beside = [psutil.Process(worker.pid) for worker in cluster.workers.values()]
            ways = {"2 processes": (["--jobs", 2], []), "4 on Dask": (["--dask", cluster.scheduler_address], beside)}
            for what in options.only or commands("", work):
                hashes, told = set(), []
                for way, (more, others) in ways.items():
                    peaks = []
                    for source in (f"s3://{BUCKET}/few", f"s3://{BUCKET}"):
                        room = work / "room"
                        room.mkdir()
                        printed, seconds, peak = run_watched([*commands(source, room)[what], *more], others)
                        peaks.append(peak)
                        found = result(what, printed, room)
                        shutil.rmtree(room)
                    hashes.add(found)
                    failed |= peaks[1] - peaks[0] > MEMORY
                    told.append(
                        f"{way} {seconds:.0f} s, {peaks[1] / 1e6:.0f} MB ({peaks[0] / 1e6:.0f} MB for {few(count):,})"
                    )
                failed |= len(hashes) > 1
                print(f"{what}: {'; '.join(told)}; {'equal' if len(hashes) == 1 else 'DIFFERENT'}", flush=True)
    sys.exit(failed)


if __name__ == "__main__":
    main()
