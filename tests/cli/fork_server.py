"""A process that has imported the package, and forks one for each command: starting Python anew takes longer than most."""

from __future__ import annotations

import atexit
import gc
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

_LONGEST = 1 << 16  # bytes of a request
_IMPORTED = (
    *(f"carla_recap.cli.{path.stem}" for path in Path(__file__).parents[2].glob("src/carla_recap/cli/*.py")),
    "carla_recap.exports",
    "carla_recap.fleet.answers",
    "carla_recap.fleet.check",
    "carla_recap.fleet.destinations",
    "carla_recap.formats.mcap.writer",
    "carla_recap.queries.incidents",
    "carla_recap.queries.measures",
    "carla_recap.output.json",
    "carla_recap.output.table",
    "carla_recap.queries.score",
    "carla_recap.queries.summary",
    "carla_recap.recording",
    "carla_recap.show.page",
    "rich.console",
    "rich.progress",
)


class ForkServer:
    """A fork server, which ends with this process.

    Args:
        environment: The environment of all commands.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self.environment = dict(environment)
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            command = [sys.executable, __file__, str(theirs.fileno())]
            self._process = subprocess.Popen(
                command, env=self.environment, stdin=subprocess.DEVNULL, pass_fds=[theirs.fileno()]
            )
        atexit.register(self._close)

    def start(self, arguments: list[str], stdout: int, stderr: int, folder: Path | None = None) -> ForkedCommand:
        """Start a command.

        Args:
            arguments: The arguments.
            stdout: Where it prints, a file descriptor, which is closed here.
            stderr: Where it prints errors; see `stdout`.
            folder: Its working directory; None: that of this process.
        """
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            request = json.dumps([os.fspath(folder or Path.cwd()), *arguments]).encode()
            socket.send_fds(self._socket, [request], [stdout, stderr, theirs.fileno()])
        for each in {stdout, stderr}:
            os.close(each)
        return ForkedCommand(ours)

    def _close(self) -> None:
        self._socket.close()
        self._process.wait()


class ForkedCommand:
    """A command that runs in a forked process.

    Args:
        reply: Where its process id comes, and at the end its exit code.
    """

    def __init__(self, reply: socket.socket) -> None:
        self._reply = reply

    def wait(self, patience: float) -> int:
        """Return its exit code, negative for a signal.

        Args:
            patience: The time in s after which it is killed.

        Raises:
            TimeoutError: It has been killed.
        """
        with self._reply as reply:
            reply.settimeout(patience)
            pid = int(reply.recv(_LONGEST))
            try:
                return int(reply.recv(_LONGEST))
            except TimeoutError:
                os.kill(pid, signal.SIGKILL)
                raise


def _serve(server: socket.socket) -> None:
    """Fork for each request; return in a process that is to run a command, as if it had been started with its arguments."""
    for name in _IMPORTED:
        import_module(name)
    gc.freeze()
    while True:
        request, descriptors, _, _ = socket.recv_fds(server, _LONGEST, 3)
        if not request:
            os._exit(0)
        while _has_ended_child():
            pass
        if not os.fork():
            break
        for each in descriptors:
            os.close(each)
    server.close()
    stdout, stderr, reply = descriptors
    if pid := os.fork():
        _report(pid, *descriptors)
    os.close(reply)
    for number, each in enumerate((stdout, stderr), 1):
        os.dup2(each, number)
    for each in {stdout, stderr}:
        os.close(each)
    folder, *arguments = json.loads(request)
    sys.stdout.reconfigure(line_buffering=sys.stdout.isatty())
    os.chdir(folder)
    sys.argv = ["carla-recap", *arguments]


def _has_ended_child() -> bool:
    try:
        return os.waitpid(-1, os.WNOHANG)[0] > 0
    except ChildProcessError:
        return False


def _report(pid: int, stdout: int, stderr: int, reply: int) -> Any:
    """Send the number of a process and, when it has ended, its exit code."""
    os.close(stdout)
    os.close(stderr)
    os.write(reply, str(pid).encode())
    _, status = os.waitpid(pid, 0)
    os.write(reply, str(os.waitstatus_to_exitcode(status)).encode())
    os._exit(0)


if __name__ == "__main__":
    sys.path[0] = str(Path(sys.executable).parent)  # as of the installed command
    _serve(socket.socket(fileno=int(sys.argv[1])))
    from carla_recap.cli import main

    main()
