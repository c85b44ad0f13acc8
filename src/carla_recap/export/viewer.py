"""A recording in Rerun's viewer: in a window, or in a browser on this machine."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING
from urllib.parse import urlencode

from carla_recap.errors import RecapError
from carla_recap.export.rerun import View, export_rerun
from carla_recap.export.viewer_process import HOST, HOSTING, LISTENING, Program
from carla_recap.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.formats.base import Reader
    from carla_recap.maps import RoadMap
    from carla_recap.replay.follow import Follow
    from carla_recap.replay.player import Progress


def view(
    source: Recording | Reader,
    *,
    web: bool = False,
    follow: Follow | None = None,
    start: float = 0.0,
    duration: float = 0.0,
    view: View = "chase",
    road_map: RoadMap | None = None,
    progress: Progress | None = None,
    ready: Callable[[str], object] = print,
) -> None:
    """Show a recording, until the viewer is closed or Ctrl-C is pressed.

    Args:
        source: The recording.
        web: Serve the viewer to a browser, on the loopback alone; else open its window.
        follow: Whom the camera follows, and so on: see `export_rerun`.
        start: Where to begin.
        duration: How many seconds.
        view: Which camera is shown first.
        road_map: The map of the town.
        progress: Is given the stream of scenes and their player, and passes the scenes on.
        ready: Is given the address for the browser, once it answers.

    Raises:
        RecapError: There is no such actor or time, there is no display, or the viewer failed.
        MissingExtra: There is no viewer.
        FormatError: The file contradicts its format.
    """
    reader = source.reader if isinstance(source, Recording) else source
    if not web and not has_display():
        raise RecapError("there is no display for the Rerun viewer; --web serves it to a browser")
    with TemporaryDirectory(prefix="carla-recap-") as folder:
        path = Path(folder) / f"{reader.path.stem[:200]}.rrd"
        export_rerun(
            reader, path, follow=follow, start=start, duration=duration, view=view, road_map=road_map, progress=progress
        )
        try:
            if web:
                _serve(path, ready)
            else:
                _open(path)
        except (KeyboardInterrupt, BrokenPipeError):  # the latter: nobody reads the address any more
            return


def _open(path: Path) -> None:
    with Program(path, quiet=False) as program:
        program.wait()


def _serve(path: Path, ready: Callable[[str], object]) -> None:
    with Program("--serve-web", "--web-viewer-port", "0", path) as program:
        data = urlencode({"url": f"rerun+http://{HOST}:{program.port(LISTENING)}/proxy", "theme": "dark"})
        ready(f"http://{HOST}:{program.port(HOSTING)}/?{data}")
        program.wait()


def has_display() -> bool:
    """Whether a window can be opened."""
    if not sys.platform.startswith("linux"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"))
