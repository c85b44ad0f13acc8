"""Rerun's viewer: as a child process, and a recording in its window or in a browser on this machine."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final, Self, TypeVar
from urllib.parse import urlencode

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.recording import Recording
from carla_recap.replay.follow import find_followed
from carla_recap.show.rerun.export import export_rerun
from carla_recap.util.processes import terminate
from carla_recap.util.signals import unwind_on_termination

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from carla_recap.formats.base import Reader
    from carla_recap.replay.follow import Follow
    from carla_recap.replay.player import Progress
    from carla_recap.roads import RoadMap
    from carla_recap.show.rerun.blueprint import View

    T = TypeVar("T")

HOST: Final = "127.0.0.1"
TIMEOUT: Final = 60.0
"""The longest time for an answer of the viewer, in seconds."""

GRPC_PORT: Final = re.compile(r"Listening for gRPC connections on [\d.]+:(\d+)")
WEB_PORT: Final = re.compile(r"Hosting a web-viewer at http://[\d.]+:(\d+)")

_NO_GRAPHICS: Final = re.compile(r"graphics adapter|render context|render state")
_REASON: Final = re.compile(r"panicked at '(.*)'|ERROR \S+ (.*)|^Error: (.*)", re.MULTILINE)
_BINARIES: Final = ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun")
_PAUSE: Final = 0.02  # s between checks
_GRACE: Final = 5.0  # s to end by itself


class RerunViewer:
    """Rerun's viewer as a child process, which runs during a `with` block, with arguments of its command line.

    It sends no usage data, and listens on the loopback alone, at a free port; `quiet`, it shows errors only. A
    `MissingExtra` says that there is no viewer.
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
            stack.callback(terminate, self._process, _GRACE)
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
        """Whether it is still running."""
        return self._process.poll() is None

    def wait(self) -> None:
        """Wait until it ends."""
        if self._process.wait():
            raise self._failure()

    def wait_for(self, what: str, condition: Callable[[], T | None]) -> T:
        """Wait until a condition returns a value that is true, and return the value; a `RecapError` after `TIMEOUT`."""
        deadline = time.monotonic() + TIMEOUT
        while time.monotonic() < deadline:
            answer = condition()
            if answer:
                return answer
            self.check()
            time.sleep(_PAUSE)
        raise RecapError(f"the Rerun viewer: no {what} within {TIMEOUT:g} s{self._reason()}")

    def port(self, announced: re.Pattern[str]) -> int:
        """Return a port on which it listens, as its log announces it: `GRPC_PORT` or `WEB_PORT`."""
        return int(self.wait_for("open port", lambda: announced.search(self._output()))[1])

    def check(self) -> None:
        """Check that it is running."""
        if self._process.poll() is not None:
            raise self._failure()

    def _start(self, folder: Path) -> subprocess.Popen[bytes]:
        """Start it with a folder for its log and for its temporary files, which it does not remove."""
        self._log = folder / "log"
        environment = {**self._environment, **dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))}
        with self._log.open("wb") as log:
            try:
                return subprocess.Popen(self._command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment)
            except OSError as error:
                raise RecapError(f"{self._command[0]}: cannot be started: {error.strerror}") from None

    def _failure(self) -> RecapError:
        if _NO_GRAPHICS.search(self._output()):
            return RecapError(
                "the Rerun viewer found no graphics driver; without a GPU, Mesa's Vulkan driver draws: "
                "apt-get install mesa-vulkan-drivers"
            )
        return RecapError(f"the Rerun viewer ended with exit code {self._process.returncode}{self._reason()}")

    def _reason(self) -> str:
        found = _REASON.search(self._output())
        return f": {next(filter(None, found.groups()), '').rpartition(': ')[2]}" if found else ""

    def _output(self) -> str:
        return self._log.read_text("utf-8", "replace")


def view(
    source: Recording | Reader,
    *,
    web: bool = False,
    web_port: int = 0,
    follow: Follow | None = None,
    start: float = 0.0,
    duration: float = 0.0,
    view: View = "chase",
    road_map: RoadMap | None = None,
    progress: Progress | None = None,
    ready: Callable[[str], object] = print,
) -> None:
    """Show a recording until the viewer is closed or Ctrl-C is pressed; for the other arguments, see `export_rerun`.

    With `web`, the viewer is served to a browser, on the loopback alone, at a port, 0: any free one; `ready` gets the
    address. A `RecapError` says that the actor or the time does not exist, there is no display, or the viewer failed.
    """
    reader = source.reader if isinstance(source, Recording) else source
    _binary()  # which may be missing
    if not web and not has_display():
        if follow is not None:
            find_followed(reader, follow)  # an unknown actor is the first thing to mend
        raise RecapError("there is no display for the Rerun viewer; --web serves it to a browser")
    with TemporaryDirectory(prefix="carla-recap-") as folder:
        path = Path(folder) / f"{reader.path.stem[:200]}.rrd"
        export_rerun(
            reader, path, follow=follow, start=start, duration=duration, view=view, road_map=road_map, progress=progress
        )
        try:
            if web:
                with RerunViewer("--serve-web", "--web-viewer-port", str(web_port), path) as process:
                    data = urlencode({"url": f"rerun+http://{HOST}:{process.port(GRPC_PORT)}/proxy", "theme": "dark"})
                    ready(f"http://{HOST}:{process.port(WEB_PORT)}/?{data}")
                    process.wait()
            else:
                with RerunViewer(path, quiet=False) as process:
                    process.wait()
        except (KeyboardInterrupt, BrokenPipeError):  # the latter: the output of `ready` is closed
            return


def has_display() -> bool:
    """Return whether a window can be opened."""
    if not sys.platform.startswith("linux"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"))


def _binary() -> Path:
    """Return the program itself; the script `rerun` on the PATH would leave it running when terminated."""
    try:
        import rerun_cli
    except ImportError:
        raise MissingExtra("the Rerun viewer", "rerun") from None
    folder = Path(rerun_cli.__path__[0])
    for name in _BINARIES:
        if (folder / name).is_file():
            return folder / name
    raise RecapError(f"{folder}: has no Rerun viewer")
