"""Commands on many small recordings in a bucket, by processes of this machine and on a Dask cluster: answers and memory.

`python -m benchmarks.bucket --count 10000` also says whether the answers of both are equal.
"""

from __future__ import annotations

import argparse
import hashlib
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import psutil

from benchmarks.fleet import MEMORY, local_cluster
from benchmarks.measuring import recap
from tests.fleet.indexes import contents
from tests.web import serve_bucket

KINDS: Final = 4  # different recordings, which are repeated
FEW: Final = 200  # recordings, at least, whose memory is compared with that of all: enough that each worker has some
COMMANDS: Final[dict[str, list[Any]]] = {
    "index": ["index", "SOURCE", "OUT"],
    "collisions": ["collisions", "--json", "SOURCE"],
    "score --from-drive": ["score", "--from-drive", "--json", "SOURCE"],
    "convert": ["convert", "-q", "--to", "log", "SOURCE", "OUT"],
}


def make(folder: Path, count: int, few: int) -> None:
    """Fill a folder with small simulations of 2 s, of which there are four; the first ones are in a folder of their own."""
    for number in range(count):
        path = folder / ("few" if number < few else "others") / f"{number:05}.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        if number >= KINDS:
            path.hardlink_to(folder / "few" / f"{number % KINDS:05}.mcap")
        else:
            recap("record", path, "--vehicles", 3, "--walkers", 1, "--hero", "--duration", 2, "--seed", number, "-q")


def result(printed: bytes, out: Path) -> str:
    """Return a hash of what a command has answered or written, which is removed."""
    found = hashlib.sha256(printed)
    if out.is_dir():
        for path in sorted(out.rglob("*.log")):
            found.update(path.relative_to(out).as_posix().encode() + path.read_bytes())
        shutil.rmtree(out)
    elif out.exists():
        found.update(repr(contents(out)).encode())
        out.unlink()
    return found.hexdigest()


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bucket", description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="of recordings (default: %(default)s)")
    parser.add_argument("--only", action="append", choices=COMMANDS, metavar="NAME")
    options = parser.parse_args()
    few, failed = max(options.count // 10, FEW), False
    with TemporaryDirectory(prefix="bucket-") as name:
        make(Path(name, "recordings"), options.count, few)
        with serve_bucket("runs", Path(name, "recordings")), local_cluster(4) as cluster:
            workers = [psutil.Process(worker.pid) for worker in cluster.workers.values()]
            ways = {"2 processes": (["--jobs", 2], []), "4 on Dask": (["--dask", cluster.scheduler_address], workers)}
            for what in options.only or COMMANDS:
                hashes, told = set(), []
                for way, (more, beside) in ways.items():
                    peaks = []
                    for source in ("s3://runs/few", "s3://runs"):
                        places = {"SOURCE": source, "OUT": Path(name, "out")}
                        taken = recap(*(places.get(part, part) for part in COMMANDS[what]), *more, watch=beside)
                        found = result(taken.out, places["OUT"])
                        peaks.append(taken.peak)
                    hashes.add(found)
                    failed |= peaks[1] - peaks[0] > MEMORY
                    small, large = (f"{peak / 1e6:.0f} MB" for peak in peaks)
                    told.append(f"{way} {taken.seconds:.0f} s, {large} ({small} for {few:,})")
                failed |= len(hashes) > 1
                print(f"{what}: {'; '.join(told)}; {'equal' if len(hashes) == 1 else 'DIFFERENT'}", flush=True)
    sys.exit(failed)


if __name__ == "__main__":
    main()
