"""Random calls by three official clients, while a fourth one ticks: no client can stop the world of the others.

`python -m tests.server.sequences --seconds 900 --random` searches; `tests/server/test_sequences.py` makes a few calls.
"""

from __future__ import annotations

import argparse
import random
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, Final

import msgpack

from tests.server.client import serving

CLIENTS: Final = 3
LIMIT: Final = 30.0  # s, for a call of a client, and for a tick
PAUSE: Final = 0.01  # s, between two ticks while a call is made
WAITING: Final = 0.2  # s of the server's processor time for which one client may keep another waiting
FAULTS: Final = ("has failed", "a tick goes on without", "Traceback", "its control ends here")


class Clock:
    """The fourth client, which is as plain as can be: it ticks, and measures how long the server keeps it waiting."""

    def __init__(self, port: int, server: int) -> None:
        self._connection = socket.create_connection(("127.0.0.1", port), timeout=LIMIT)
        self._unpacker = msgpack.Unpacker()
        self._busy = Path(f"/proc/{server}/task/{server}/schedstat")
        self._number = 0
        self.longest = 0.0

    def call(self, name: str, *arguments: Any) -> Any:
        """Return the reply to a call, which must come within the limit."""
        self._number += 1
        self._connection.sendall(msgpack.packb([0, self._number, name, [[False], *arguments]]))
        while True:
            for reply in self._unpacker:
                assert reply[:2] == [1, self._number], f"{name}: {reply}"
                return reply
            self._unpacker.feed(self._connection.recv(1 << 20))

    def busy(self) -> float:
        """Return the processor time of the thread of the server that serves calls, in s."""
        return int(self._busy.read_text().split()[0]) / 1e9 if self._busy.exists() else 0.0

    def tick(self) -> None:
        """Tick; what has no answer to give must be answered soon."""
        before = self.busy()
        self.call("version")
        self.longest = max(self.longest, self.busy() - before)
        assert self.call("tick_cue")[2] is None

    def close(self) -> None:
        self._connection.close()


class CallingClient:
    """A process of `tests.server.random_calls`, which begins anew where a call has ended it."""

    def __init__(self, port: int, folder: Path) -> None:
        self._command = [sys.executable, "-m", "tests.server.random_calls", str(port), str(folder)]
        self._start()

    def _start(self) -> None:
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(self._command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True)

    def step(self, seed: int, clock: Clock) -> str:
        """Make a call, and tick meanwhile and afterwards; return what became of it."""
        said: list[str] = []
        assert self._process.stdin is not None
        reader = threading.Thread(target=self._ask, args=(seed, said))
        reader.start()
        end = time.monotonic() + LIMIT
        while reader.is_alive():
            clock.tick()
            reader.join(PAUSE)
            if time.monotonic() > end:
                self._process.kill()
                reader.join()
        clock.tick()
        outcome = said[0].strip()
        if not said[0].endswith("\n"):
            self.close()
            outcome += f" ends the client ({self._process.returncode}): seed {seed}"
            self._start()
        return outcome

    def _ask(self, seed: int, said: list[str]) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            print(seed, file=self._process.stdin, flush=True)
            said.append(self._process.stdout.readline())
        except BrokenPipeError:
            said.append("")

    def close(self) -> None:
        with self._process:  # which closes its pipes
            self._process.kill()


def run(
    seconds: float, seed: int, most: int = sys.maxsize, trace: Path | None = None
) -> tuple[Counter[str], tuple[float, int, str], list[str]]:
    """Make at most some random calls for some seconds, and write what became of each to a file, if any.

    Returns how often which method was called; the longest time that the server has kept the fourth client waiting, in s,
    with the seed and the method; and the lines of the server's log that report a fault of its own.
    """
    outcomes: Counter[str] = Counter()
    slowest = 0.0, 0, ""
    chosen, end = random.Random(seed), time.monotonic() + seconds
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        options = ("--recordings", folder / "recordings", "--confine", "--quality=low")
        process, port = stack.enter_context(serving(*options))
        lines: list[str] = []
        assert process.stderr is not None
        reader = threading.Thread(target=lambda log: lines.extend(log), args=(process.stderr,))
        reader.start()
        clock = stack.enter_context(closing(Clock(port, process.pid)))
        clients = [stack.enter_context(closing(CallingClient(port, folder / str(number)))) for number in range(CLIENTS)]
        while time.monotonic() < end and outcomes.total() < most:
            clock.longest, before = 0.0, len(lines)
            outcome = chosen.choice(clients).step(step_seed := chosen.randrange(1 << 32), clock)
            outcomes[outcome.split(":")[0]] += 1
            slowest = max(slowest, (clock.longest, step_seed, outcome))
            if trace is not None:
                with trace.open("a") as file:
                    print(f"{step_seed} {clock.longest:.3f} {outcome}", *lines[before:], sep="\n    ", file=file)
        assert process.poll() is None
        process.terminate()
        reader.join()
        assert process.wait() == 0
    return outcomes, slowest, [line for line in lines if any(fault in line for fault in FAULTS)]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.server.sequences", description=__doc__)
    parser.add_argument("--seconds", type=float, default=900.0, help="how long (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="the seed (default: %(default)s)")
    parser.add_argument("--trace", type=Path, help="file for what became of each call")
    parser.add_argument("--random", action="store_true", help="other calls in every run")
    options = parser.parse_args()
    seed = random.randrange(1 << 32) if options.random else options.seed
    outcomes, slowest, faults = run(options.seconds, seed, trace=options.trace)
    for outcome, count in sorted(outcomes.items()):
        print(f"{count:6} {outcome}")
    print(*faults, sep="")
    print(f"seed {seed}: {outcomes.total()} calls, {len(faults)} faults in the log, slowest: {slowest}")
    sys.exit(bool(faults) or slowest[0] > WAITING)


if __name__ == "__main__":
    main()
