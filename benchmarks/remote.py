"""Queries of a recording on a web server of this machine, each of whose answers takes 50 ms."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from benchmarks.measuring import Line, Subject
from carla_recap import open_recording
from tests.web import serve

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from carla_recap import Recording

DELAY: Final = 0.05  # s, for each request
REQUESTS: Final = 2
BYTES: Final = 1_000_000
QUERIES: Final[dict[str, Callable[[Recording], object]]] = {
    "collisions": lambda recording: list(recording.collisions()),
    "blocked": lambda recording: list(recording.blocked()),
    "incidents": lambda recording: list(recording.incidents()),
    "info": lambda recording: recording.info,
}


def remote(subject: Subject) -> Iterator[Line]:
    with serve(subject.mcap.parent.absolute()) as server:
        server.delay = DELAY
        url = f"{server.url}/{subject.mcap.name}"
        for name, query in QUERIES.items():
            taken = []
            for _ in range(3):
                server.reset()
                started = time.perf_counter()
                with open_recording(url) as recording:
                    query(recording)
                taken.append(time.perf_counter() - started)
            count = len(server.requests)
            read = f"{count} request{'s' if count > 1 else ''}, {server.sent / 1e6:.2f} MB"
            ok = count <= REQUESTS and server.sent <= BYTES
            yield Line(f"{name}, remote .mcap", f"{min(taken):.2f} s", read, f"≤ {REQUESTS}, {BYTES / 1e6:g} MB", ok)


ROWS: Final = (remote,)
