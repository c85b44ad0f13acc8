"""Shows a server's world in Rerun's viewer or in Foxglove while it goes on.

It is a client of its own, in a process of its own: a slow viewer never delays the world. It shows at most `RATE` ticks in a
second, and leaves out the others.
"""

from __future__ import annotations

import math
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from typing import TYPE_CHECKING, Final

from carla_recap.capture.observer import HOST, PORT, Observer
from carla_recap.capture.recording import header_of, live_frames, until
from carla_recap.editing.convert import check_free
from carla_recap.errors import RecapError
from carla_recap.replay.follow import HERO, Follow
from carla_recap.roads import RoadMap, load_map
from carla_recap.show.rerun import check_rerun
from carla_recap.show.rerun.viewer import GRPC_PORT, RerunViewer, has_display
from carla_recap.show.rerun.viewer import HOST as LOOPBACK

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager

    import carla

    from carla_recap.model.frame import Header
    from carla_recap.show.foxglove.websocket import FoxgloveServer, FoxgloveView
    from carla_recap.show.rerun.blueprint import View
    from carla_recap.show.rerun.writer import LiveView

RATE: Final = 30.0
"""The most ticks that are shown in a second of real time."""

_FLUSH: Final = 0.1  # s between updates of the viewer
_SUFFIX: Final = ".rrd"
_ADDRESS: Final = "rerun+http"


def watch(
    to: Path | str | None = None,
    *,
    host: str = HOST,
    port: int = PORT,
    duration: float = math.inf,
    follow: Follow = HERO,
    view: View = "chase",
    force: bool = False,
    foxglove_port: int | None = None,
    ready: Callable[[str], object] = print,
) -> str:
    """Show the world of a CARLA server, until the viewer is closed, the server has gone, or Ctrl-C is pressed.

    It also ends after a duration, if one is given. The world is not changed.
    Collisions are shown if a collision sensor reports them.

    Args:
        to: An .rrd, or the address of a viewer that listens: `rerun+http://127.0.0.1:9876/proxy`; else a viewer is opened.
        host: The address of the server.
        port: Its port.
        duration: The simulated seconds after which it ends.
        follow: The actor that the camera follows as soon as it is present: an id, or "hero".
        view: The camera that is shown first.
        force: Overwrite an existing file.
        foxglove_port: The port of a WebSocket to which Foxglove connects instead, 0: any free one; None: no such WebSocket.
        ready: Gets its address as soon as viewers can connect.

    Returns:
        The reason of the end, in words.

    Raises:
        RecapError: There is no server, no display, or the file cannot be written.
        MissingExtra: There is no viewer.
    """
    with ExitStack() as stack:
        server: FoxgloveServer | None = None
        if foxglove_port is None:
            check_target(to, force=force)
        else:
            from carla_recap.show.foxglove.websocket import FoxgloveServer

            server = stack.enter_context(FoxgloveServer(f"{host}:{port}", foxglove_port))
        observer = stack.enter_context(Observer(host, port, additional_data=True, interval=1 / RATE))
        observer.begin()
        stack.enter_context(observer.until_signal())
        road_map = _road_map(observer.map)
        header = header_of(observer)
        opened: AbstractContextManager[tuple[LiveView | FoxgloveView, Callable[[], bool]]]
        if server is None:
            opened = _in_rerun(to, header, f"{host}:{port}", follow, view, road_map)
        else:
            opened = _in_foxglove(server, header, follow, road_map, ready)
        with opened as (live, is_open):

            def show() -> None:
                live.flush()
                if not is_open():
                    observer.end("the viewer was closed")

            due = 0.0
            observations = until(duration, observer, observer.observations(idle=show))
            for frame in live_frames(observations, additional_data=True):
                live.enter(frame)
                if monotonic() >= due:
                    show()
                    due = monotonic() + _FLUSH
            live.close()
    return observer.why


def check_target(to: Path | str | None, foxglove_port: int | None = None, *, force: bool) -> None:
    """Check that the world can be shown; for the arguments see `watch`.

    Raises:
        RecapError: There is no display, or no such destination, or the port is in use.
        MissingExtra: There is no viewer.
    """
    if foxglove_port is not None:
        from carla_recap.show.foxglove.websocket import FoxgloveServer

        with FoxgloveServer("", foxglove_port):
            return
    check_rerun()
    if to is None:
        if not has_display():
            raise RecapError("there is no display for the Rerun viewer; an .rrd can be written instead")
        RerunViewer()
    elif not str(to).startswith(_ADDRESS):
        if Path(to).suffix.lower() != _SUFFIX:
            raise RecapError(f"{to}: an .rrd, or the address of a viewer, {_ADDRESS}://..., was expected")
        check_free(to, force=force)


@contextmanager
def _in_foxglove(
    server: FoxgloveServer, header: Header, follow: Follow, road_map: RoadMap | None, ready: Callable[[str], object]
) -> Iterator[tuple[FoxgloveView, Callable[[], bool]]]:
    """Let Foxglove connect; yield what shows frames, and a function that returns whether it is still open."""
    from carla_recap.show.foxglove.websocket import FoxgloveView

    ready(server.address)
    yield FoxgloveView(server, header, follow, road_map), lambda: True


@contextmanager
def _in_rerun(
    to: Path | str | None, header: Header, source: str, follow: Follow, view: View, road_map: RoadMap | None
) -> Iterator[tuple[LiveView, Callable[[], bool]]]:
    """Open Rerun's viewer or a file; yield what shows frames, and a function that returns whether it is still open."""
    from carla_recap.show.rerun.blueprint import live_blueprint
    from carla_recap.show.rerun.sinks import rrd_file, sent
    from carla_recap.show.rerun.writer import LiveView

    arrangement = live_blueprint(road_map, view=view)
    with ExitStack() as stack:
        is_open: Callable[[], bool] = lambda: True  # noqa: E731
        if to is None:
            process = stack.enter_context(RerunViewer())
            address = f"rerun+http://{LOOPBACK}:{process.port(GRPC_PORT)}/proxy"
            stream, is_open = stack.enter_context(sent(arrangement, address)), lambda: process.is_running
        elif str(to).startswith(_ADDRESS):
            stream = stack.enter_context(sent(arrangement, str(to)))
        else:
            stream = stack.enter_context(rrd_file(to, arrangement, live=True))
        yield LiveView(stream, header, source, follow=follow, view=view, road_map=road_map), is_open


def _road_map(map: carla.Map) -> RoadMap | None:
    """Return the roads, or None if they cannot be read."""
    with TemporaryDirectory(prefix="carla-recap-") as folder:
        path = Path(folder) / f"{map.name.rpartition('/')[2]}.xodr"
        path.write_text(map.to_opendrive(), "utf-8")
        try:
            return load_map(path)
        except RecapError:
            return None
