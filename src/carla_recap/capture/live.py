"""Shows a server's world in Rerun's viewer while it goes on.

Whoever shows it is a client of its own, in its own process: a slow viewer never holds up the world. It sees at most
`RATE` ticks in a second, and leaves the others out.
"""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from typing import TYPE_CHECKING, Final

from carla_recap.capture.observer import HOST, PORT, Observer
from carla_recap.capture.recording import header_of, live_frames
from carla_recap.conversion import check_free
from carla_recap.errors import RecapError
from carla_recap.export.program import HOST as LOOPBACK
from carla_recap.export.program import LISTENING, Program
from carla_recap.export.rerun import LiveView, View, live_blueprint, piped, sent
from carla_recap.export.viewer import has_display
from carla_recap.export.whole import WholeFile
from carla_recap.maps import RoadMap, load_map
from carla_recap.replay.follow import HERO, Follow
from carla_recap.util.signals import call_on_termination

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import carla
    import rerun as rr
    import rerun.blueprint as rrb

RATE: Final = 30.0
"""So many ticks in a second of the wall's clock are shown at the most."""

_SHOWN: Final = 0.1  # s, after which the viewer gets what there is
_SUFFIX: Final = ".rrd"
_ADDRESS: Final = "rerun+http"


def watch(
    to: Path | str | None = None,
    *,
    host: str = HOST,
    port: int = PORT,
    follow: Follow = HERO,
    view: View = "chase",
    force: bool = False,
) -> str:
    """Show the world of a CARLA server, until the viewer is closed, the server is gone, or Ctrl-C is pressed.

    Nothing is changed there. Collisions are shown where a collision sensor tells of them.

    Args:
        to: An .rrd, or the address of a viewer that listens: `rerun+http://127.0.0.1:9876/proxy`; else a viewer is opened.
        host: Where the server is.
        port: Its port.
        follow: Whom the camera follows as soon as it is there: an id, or "hero".
        view: Which camera is shown first.
        force: Overwrite what is there.

    Returns:
        Why it has ended, in words.

    Raises:
        RecapError: There is no server, no display, or the file cannot be written.
        MissingExtra: There is no viewer.
    """
    check_target(to, force=force)
    with Observer(host, port, additional_data=True, interval=1 / RATE) as observer, call_on_termination(observer.end):
        road_map = _road_map(observer.map)
        arrangement = live_blueprint(road_map, view=view)
        with _opened(to, arrangement) as (stream, is_open):
            live = LiveView(stream, header_of(observer), f"{host}:{port}", follow=follow, view=view, road_map=road_map)

            def show() -> None:
                live.flush()
                if not is_open():
                    observer.end("the viewer was closed")

            due = 0.0
            for frame in live_frames(observer.sights(idle=show), additional_data=True):
                live.enter(frame)
                if monotonic() >= due:
                    show()
                    due = monotonic() + _SHOWN
            live.close()
    return observer.why


def check_target(to: Path | str | None, *, force: bool) -> None:
    """See that there is something to show it in; for the arguments see `watch`.

    Raises:
        RecapError: There is not.
        MissingExtra: There is no viewer.
    """
    if to is None:
        if not has_display():
            raise RecapError("there is no display for the Rerun viewer; an .rrd can be written instead")
        Program()
    elif not str(to).startswith(_ADDRESS):
        if Path(to).suffix.lower() != _SUFFIX:
            raise RecapError(f"{to}: an .rrd, or the address of a viewer, {_ADDRESS}://..., was expected")
        check_free(to, force=force)


@contextmanager
def _opened(to: Path | str | None, arrangement: rrb.Blueprint) -> Iterator[tuple[rr.RecordingStream, Callable[[], bool]]]:
    """Where it is shown, and whether it still can be."""
    with ExitStack() as stack:
        if to is None:
            program = stack.enter_context(Program())
            address = f"rerun+http://{LOOPBACK}:{program.port(LISTENING)}/proxy"
            yield stack.enter_context(sent(arrangement, address)), lambda: program.is_running
        elif str(to).startswith(_ADDRESS):
            yield stack.enter_context(sent(arrangement, str(to))), lambda: True
        else:
            file = stack.enter_context(WholeFile(to, live=True))
            yield stack.enter_context(piped(arrangement, file.write)), lambda: True


def _road_map(map: carla.Map) -> RoadMap | None:
    """The roads, where they can be read."""
    with TemporaryDirectory(prefix="carla-recap-") as folder:
        path = Path(folder) / f"{map.name.rpartition('/')[2]}.xodr"
        path.write_text(map.to_opendrive(), "utf-8")
        try:
            return load_map(path)
        except RecapError:
            return None
