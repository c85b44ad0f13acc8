"""A web server on this machine for tests of remote recordings: files with ranges, counted requests, and faults on demand."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Event, Lock, Thread
from urllib.parse import unquote, urlsplit
from urllib.request import Request, urlopen

import pytest

from tests.waiting import PATIENCE

obstore = pytest.importorskip("obstore", reason="the extra `remote` is not installed")


_RANGE = re.compile(r"bytes=(\d*)-(\d*)")


@dataclass
class FileServer:
    """A server of the files of a folder.

    Attributes:
        folder: The folder.
        url: The URL of the folder.
        requests: The requests so far: the path with its query, and the range.
        sent: The number of bytes of files that were sent so far.
        together: The most requests that were answered at the same time.
        delay: The time that each request takes, in s.
        crowd: The number of requests at the same time for which all but the very first one wait.
        ranges: Whether ranges are served; else whole files.
        refusal: The status of answers to ranges that count from the end; None to serve them.
        etags: Whether files have ETags; "weak" for weak ones.
        status: The status of every answer, instead of the file.
        failures: The number of requests that get that status; the others get the file.
        short: The bytes that are left out at the end of each range.
        admits: Whether the headers say so.
        limit: The number of requests after which connections are dropped without an answer.
    """

    folder: Path
    url: str = ""
    requests: list[tuple[str, str]] = field(default_factory=list)
    sent: int = 0
    together: int = 0
    delay: float = 0.0
    crowd: int = 0
    ranges: bool = True
    refusal: int | None = None
    etags: bool | str = True
    status: int | None = None
    failures: float = float("inf")
    short: int = 0
    admits: bool = False
    limit: float = float("inf")
    _lock: Lock = field(default_factory=Lock)
    _now: int = 0
    _crowded: Event = field(default_factory=Event)

    def reset(self) -> None:
        """Count from 0 again."""
        self.requests.clear()
        self.sent = self.together = 0


@contextmanager
def serve(folder: Path) -> Iterator[FileServer]:
    """Serve a folder on a free port of the loopback interface."""
    files = FileServer(folder)
    pause = Event()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            with files._lock:
                files.requests.append((self.path, self.headers.get("Range", "")))
                files._now += 1
                files.together = max(files.together, files._now)
                is_over = len(files.requests) > files.limit
                is_first = len(files.requests) == 1
                if files.crowd and files._now >= files.crowd:
                    files._crowded.set()
            try:
                if is_over:
                    self.close_connection = True
                    return
                pause.wait(files.delay)
                if files.crowd and not is_first:
                    files._crowded.wait(PATIENCE)
                self._answer()
            finally:
                with files._lock:
                    files._now -= 1

        def do_HEAD(self) -> None:
            if files.refusal is None:
                self.send_error(501)
                return
            path = files.folder / unquote(urlsplit(self.path).path).lstrip("/")
            self.send_response(200)
            self.send_header("Content-Length", str(path.stat().st_size))
            self.send_header("Last-Modified", self.date_time_string(int(path.stat().st_mtime)))
            self.end_headers()

        def _answer(self) -> None:
            path = files.folder / unquote(urlsplit(self.path).path).lstrip("/")
            failing = files.status is not None and len(files.requests) <= files.failures
            if failing or not path.is_file():
                self._send(files.status if failing and files.status else 404, {}, b"an answer of\nseveral lines")
                return
            status = path.stat()
            size = status.st_size
            headers = {"Last-Modified": self.date_time_string(int(status.st_mtime))}
            if files.etags:
                tag = f'"{status.st_ino:x}-{status.st_mtime_ns:x}-{size:x}"'
                headers["ETag"] = f"W/{tag}" if files.etags == "weak" else tag
                wanted = self.headers.get("If-Match")
                if wanted is not None and (wanted.startswith("W/") or wanted != headers["ETag"]):
                    self._send(412, {}, b"")
                    return
            found = _RANGE.fullmatch(self.headers.get("Range", "")) if files.ranges else None
            if found is None:
                self._send(200, headers, path.read_bytes())
                return
            if files.refusal is not None and not found[1]:
                self._send(files.refusal, {}, b"")
                return
            if not size:
                self._send(416, {"Content-Range": "bytes */0"}, b"")
                return
            first, last = found.groups()
            start = int(first) if first else max(size - int(last), 0)
            stop = min(int(last) + 1, size) if first and last else size
            sent = stop - start - files.short
            headers["Content-Range"] = f"bytes {start}-{(start + sent if files.admits else stop) - 1}/{size}"
            with path.open("rb") as file:
                file.seek(start)
                self._send(206, headers, file.read(sent))

        def _send(self, status: int, headers: dict[str, str], data: bytes) -> None:
            with files._lock:
                files.sent += len(data)
            self.send_response(status)
            for name, value in headers.items():
                self.send_header(name, value)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        def log_message(self, *_: object) -> None:
            pass

    class Server(ThreadingHTTPServer):
        daemon_threads = True
        request_queue_size = 128

        def handle_error(self, *_: object) -> None:  # a client may hang up
            pass

    server = Server(("127.0.0.1", 0), Handler)
    files.url = f"http://127.0.0.1:{server.server_port}"
    thread = Thread(target=server.serve_forever, args=(0.01,), name="web-server")
    thread.start()
    try:
        yield files
    finally:
        pause.set()
        server.shutdown()
        thread.join()
        server.server_close()


@contextmanager
def serve_bucket(name: str, folder: Path) -> Iterator[str]:
    """Serve the files of a folder as a bucket, by the protocol of S3; yield its URL. The environment has its keys.

    Args:
        name: The name of the bucket.
        folder: The files; each key is a path in the folder.
    """
    moto = pytest.importorskip("moto.server", reason="moto[server] is not installed")
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = moto.ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    try:
        host, port = server.get_host_and_port()
        urlopen(Request(f"http://{host}:{port}/{name}", method="PUT")).close()
        with pytest.MonkeyPatch.context() as patch:
            for variable in [variable for variable in os.environ if variable.startswith("AWS_")]:
                patch.delenv(variable)
            patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
            patch.setenv("AWS_ACCESS_KEY_ID", "key")
            patch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
            patch.setenv("AWS_REGION", "us-east-1")
            store = obstore.store.from_url(f"s3://{name}", client_options={"allow_http": True})
            for path in sorted(folder.rglob("*")):
                if path.is_file():
                    obstore.put(store, path.relative_to(folder).as_posix(), path.read_bytes())
            yield f"s3://{name}"
    finally:
        server.stop()
