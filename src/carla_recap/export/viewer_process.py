"""Rerun's viewer as a process of its own, which ends with the block that uses it."""

from __future__ import annotations

import os
import re
import subprocess
import threading
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final, Self, TypeVar

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.util.processes import terminate
from carla_recap.util.signals import unwind_on_termination

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import TracebackType

    T = TypeVar("T")

HOST: Final = "127.0.0.1"
PATIENCE: Final = 60.0
"""Seconds after which a viewer that does not answer is given up."""

LISTENING: Final = re.compile(r"Listening for gRPC connections on [\d.]+:(\d+)")
HOSTING: Final = re.compile(r"Hosting a web-viewer at http://[\d.]+:(\d+)")

_NO_GRAPHICS: Final = re.compile(r"graphics adapter|render context|render state")
_REASON: Final = re.compile(r"panicked at '(.*)'|ERROR \S+ (.*)|^Error: (.*)", re.MULTILINE)
_BINARIES: Final = ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun")
_PAUSE: Final = 0.02  # s
_GRACE: Final = 5.0  # s


class Program:
    """Rerun's viewer, while a `with` block runs; however the block ends, it ends too.

    It sends no usage data, and listens on the loopback alone, at a port that is free.

    Args:
        arguments: Those of the command line.
        quiet: Whether it shows no notices, other than errors.

    Raises:
        MissingExtra: There is no viewer.
    """

    def __init__(self, *arguments: Path | str, quiet: bool = True) -> None:
        self._command = [_binary(), *arguments, "--bind", HOST, "--port", "0"]
        self._environment = {**os.environ, "CI": "1", "NO_COLOR": "1"}  # without usage data, and without colours in the log
        if quiet:
            self._environment["RUST_LOG"] = "error,re_grpc_server=info,re_sdk::web_viewer=info"

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(unwind_on_termination())
            self._process = self._start(Path(stack.enter_context(TemporaryDirectory(prefix="carla-recap-"))))
            stack.callback(self._end)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._stack.close()

    @property
    def pid(self) -> int:
        """The id of the process."""
        return self._process.pid

    @property
    def is_running(self) -> bool:
        """Whether it has not been closed yet."""
        return self._process.poll() is None

    def wait(self) -> None:
        """Wait until it is closed.

        Raises:
            RecapError: It failed.
        """
        if self._process.wait():
            raise self._failure()

    def wait_for(self, what: str, condition: Callable[[], T | None]) -> T:
        """Ask again and again, until there is an answer.

        Args:
            what: What is waited for, in words.
            condition: Is asked, while the viewer runs.

        Raises:
            RecapError: The viewer ended, or there is no answer within `PATIENCE`.
        """
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            answer = condition()
            if answer:
                return answer
            self.check()
            time.sleep(_PAUSE)
        raise RecapError(f"the Rerun viewer: no {what} within {PATIENCE:g} s{self._reason()}")

    def port(self, announced: re.Pattern[str]) -> int:
        """A port on which it listens.

        Args:
            announced: What it says of it: `LISTENING` or `HOSTING`.

        Raises:
            RecapError: It ended, or does not say so within `PATIENCE`.
        """
        return int(self.wait_for("open port", lambda: announced.search(self._said()))[1])

    def check(self) -> None:
        """See that it runs.

        Raises:
            RecapError: It ended.
        """
        if self._process.poll() is not None:
            raise self._failure()

    @contextmanager
    def answering(self) -> Iterator[None]:
        """Talk to it; one that does not answer within `PATIENCE` is killed, for its client would wait forever.

        Raises:
            RecapError: It does not answer, or with an error.
        """
        watchdog = threading.Timer(PATIENCE, self._process.kill)
        watchdog.daemon = True
        watchdog.start()
        try:
            yield
        except (OSError, RuntimeError) as error:
            if watchdog.finished.is_set():
                raise RecapError(f"the Rerun viewer does not answer within {PATIENCE:g} s") from None
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_PAUSE)
            self.check()
            raise RecapError(f"the Rerun viewer answers: {str(error).partition(' (')[0]}") from None
        finally:
            watchdog.cancel()

    def _start(self, folder: Path) -> subprocess.Popen[bytes]:
        """Start it with a folder for what it says, and for temporary files that it would leave behind."""
        self._log = folder / "log"
        environment = {**self._environment, **dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))}
        with self._log.open("wb") as log:
            try:
                return subprocess.Popen(self._command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment)
            except OSError as error:
                raise RecapError(f"{self._command[0]}: cannot be started: {error.strerror}") from None

    def _failure(self) -> RecapError:
        if _NO_GRAPHICS.search(self._said()):
            return RecapError(
                "the Rerun viewer found no graphics driver; without a GPU, Mesa's Vulkan driver draws: "
                "apt-get install mesa-vulkan-drivers"
            )
        return RecapError(f"the Rerun viewer ended with exit code {self._process.returncode}{self._reason()}")

    def _reason(self) -> str:
        found = _REASON.search(self._said())
        return f": {next(filter(None, found.groups()), '').rpartition(': ')[2]}" if found else ""

    def _said(self) -> str:
        return self._log.read_text("utf-8", "replace")

    def _end(self) -> None:
        terminate(self._process, _GRACE)


def _binary() -> Path:
    """The program itself: the script of the same name on the PATH would leave it behind when it is ended."""
    try:
        import rerun_cli
    except ImportError:
        raise MissingExtra("the Rerun viewer", "rerun") from None
    folder = Path(rerun_cli.__path__[0])
    for name in _BINARIES:
        if (folder / name).is_file():
            return folder / name
    raise RecapError(f"{folder}: has no Rerun viewer")
