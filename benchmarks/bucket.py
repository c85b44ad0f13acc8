"""Commands on many small recordings in a bucket, by processes of this machine and on a Dask cluster: answers and memory.

`python -m benchmarks.bucket --count 10000` also says whether the answers of both are equal.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import shutil
import subprocess
import sys
import time
import zlib
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, ClassVar, Final
from urllib.parse import parse_qs, unquote, urlsplit

import psutil
from distributed import LocalCluster

from benchmarks.fleet import MEMORY, contents
from benchmarks.measuring import COMMAND

if TYPE_CHECKING:
    from collections.abc import Iterator
    from multiprocessing.connection import Connection

BUCKET: Final = "runs"
KINDS: Final = 4  # different recordings, which are repeated
WORKERS: Final = 4  # of the cluster
FEW: Final = 200  # recordings, at least, whose memory is compared with that of all: enough that each worker has some
DATE: Final = "Thu, 01 Jan 2026 00:00:00 GMT"


class _Bucket(BaseHTTPRequestHandler):
    """Answers what S3 does to listings and reads of objects, which are copies of some files; a page has 1,000 objects."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    objects: ClassVar[dict[str, bytes]] = {}

    def do_GET(self) -> None:
        url = urlsplit(self.path)
        key = unquote(url.path).removeprefix(f"/{BUCKET}").lstrip("/")
        query = {name: values[0] for name, values in parse_qs(url.query).items()}
        if "list-type" in query:
            self._list(query.get("prefix", ""), query.get("continuation-token", ""))
            return
        content = self.objects.get(key)
        if content is None:
            self._send(404, b"")
            return
        headers = {"ETag": f'"{zlib.crc32(content):x}"', "Last-Modified": DATE}
        found = re.fullmatch(r"bytes=(\d*)-(\d*)", self.headers.get("Range", ""))
        if found is None:
            self._send(200, content, **headers)
            return
        first, last = found.groups()
        start = int(first) if first else max(len(content) - int(last), 0)
        stop = min(int(last) + 1, len(content)) if first and last else len(content)
        self._send(206, content[start:stop], **headers, **{"Content-Range": f"bytes {start}-{stop - 1}/{len(content)}"})

    def _list(self, prefix: str, after: str) -> None:
        keys = sorted(key for key in self.objects if key.startswith(prefix) and key > after)
        page, others = keys[:1000], keys[1000:]
        listed = "".join(
            f"<Contents><Key>{key}</Key><LastModified>2026-01-01T00:00:00.000Z</LastModified>"
            f'<ETag>"{zlib.crc32(self.objects[key]):x}"</ETag><Size>{len(self.objects[key])}</Size></Contents>'
            for key in page
        )
        more = f"<NextContinuationToken>{page[-1]}</NextContinuationToken>" if others else ""
        text = f"<IsTruncated>{str(bool(others)).lower()}</IsTruncated>{more}{listed}"
        self._send(200, f"<ListBucketResult><Name>{BUCKET}</Name>{text}</ListBucketResult>".encode())

    def _send(self, status: int, content: bytes, **headers: str) -> None:
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        pass


def few(count: int) -> int:
    """Return how many of some recordings are read first, for comparison."""
    return max(count // 10, FEW)


def _serve(folder: Path, count: int, port: Connection) -> None:
    contents = [path.read_bytes() for path in sorted(folder.iterdir())]
    for number in range(count):
        part = "few" if number < few(count) else "others"
        _Bucket.objects[f"{part}/{number:05}.mcap"] = contents[number % len(contents)]
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Bucket)
    port.send(server.server_port)
    server.serve_forever()


@contextmanager
def bucket(folder: Path, count: int) -> Iterator[None]:
    """Serve recordings as a bucket in another process; the environment has its address and keys."""
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    server = context.Process(target=_serve, args=(folder, count, theirs), daemon=True)
    server.start()
    os.environ |= {"AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret", "AWS_REGION": "us-east-1"}
    os.environ["AWS_ENDPOINT_URL"] = f"http://127.0.0.1:{ours.recv()}"
    try:
        yield
    finally:
        server.kill()
        server.join()


def samples(folder: Path) -> None:
    """Record small simulations of 2 s."""
    folder.mkdir()
    for seed in range(KINDS):
        what = ["--vehicles", "3", "--walkers", "1", "--hero", "--duration", "2", "--seed", str(seed), "-q"]
        subprocess.run([COMMAND, "record", folder / f"{seed}.mcap", *what], check=True)


def answer(command: list[Any], beside: list[psutil.Process]) -> tuple[bytes, float, int]:
    """Return what a command prints, its seconds, and the peak of its memory and that of its workers and of others."""
    peak = 0
    begin = time.perf_counter()
    with TemporaryDirectory() as folder, Path(folder, "out").open("wb") as out:
        with subprocess.Popen(list(map(str, command)), stdout=out) as process:
            watched = psutil.Process(process.pid)
            while process.poll() is None:
                memory = 0
                try:
                    for each in (watched, *watched.children(recursive=True), *beside):
                        memory += each.memory_info().rss
                except psutil.NoSuchProcess:
                    pass
                peak = max(peak, memory)
                time.sleep(0.05)
        seconds = time.perf_counter() - begin
        if process.returncode:
            raise SystemExit(f"{command}: exit code {process.returncode}")
        return Path(folder, "out").read_bytes(), seconds, peak


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
        samples(work / "samples")
        with (
            bucket(work / "samples", count),
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
                        printed, seconds, peak = answer([*commands(source, room)[what], *more], others)
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
