"""Pictures of recordings, drawn by Rerun's viewer without a display and without a GPU."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.export.rerun import Rrd, View, camera_views, write
from carla_recap.export.viewer import GRPC_PORT, HOST, RerunViewer
from carla_recap.replay import Player
from carla_recap.util.files import WholeFile

if TYPE_CHECKING:
    from types import TracebackType

    from rerun.experimental import ViewerState

    from carla_recap.formats.base import Reader
    from carla_recap.maps import RoadMap
    from carla_recap.recording import Recording
    from carla_recap.replay.follow import Follow

Size = tuple[int, int]
"""Width and height, in pixels."""

SMALLEST: Final = 64
LARGEST: Final = 4096
"""The limits of the width and the height of a picture, in pixels."""

_AROUND: Final = (7, 71)  # pixels of the window around a view
_SETTLED: Final = 0.15  # s without a change, after which a picture is complete
_UNSETTLED: Final = 10.0  # s, after which it is taken in any case
_LEAD: Final = 5.0  # s of the trail in a picture
_SHORTEST: Final = 1e-3  # s; a duration of 0 would be the whole recording


class ScreenshotTaker:
    """Takes pictures of a recording during a `with` block.

    with ScreenshotTaker("run.rrd") as screenshots:
        Path("crash.png").write_bytes(screenshots.take(24.6))

    Args:
        recording: An .rrd, or another source that the viewer opens: a recording by its importer, the address of a server.
        size: The size of the pictures.
        only_view: Take the only view of the recording's blueprint; else the whole window.

    Raises:
        RecapError: The size is out of range; on entry: the viewer cannot draw here, or cannot open the recording.
        MissingExtra: On entry: there is no viewer.
    """

    def __init__(self, recording: Path | str, size: Size = (1280, 720), *, only_view: bool = False) -> None:
        if not all(SMALLEST <= side <= LARGEST for side in size):
            width, height = size
            raise RecapError(f"{width} x {height}: the sides of a picture are from {SMALLEST} to {LARGEST} pixels")
        self._recording = str(recording)
        self._size = size
        self._only_view = only_view

    def __enter__(self) -> Self:
        from rerun.experimental import ViewerClient

        width, height = (side + around * self._only_view for side, around in zip(self._size, _AROUND, strict=True))
        with ExitStack() as stack:
            process = RerunViewer("--headless", "--window-size", f"{width}x{height}", self._recording)
            self._process = stack.enter_context(process)
            self._client = ViewerClient.connect(f"rerun+http://{HOST}:{process.port(GRPC_PORT)}/proxy")
            state = process.wait_for("recording", self._loaded)
            self._shown = state.views[0].view_id if self._only_view else None
            self._stack = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._stack.close()

    @property
    def state(self) -> ViewerState:
        """The state of the viewer.

        Raises:
            RecapError: The viewer does not answer.
        """
        with self._process.answering():
            return self._client.get_state()

    def take(self, time: float) -> bytes:
        """Take a picture.

        Args:
            time: Elapsed seconds.

        Returns:
            A PNG.

        Raises:
            RecapError: The viewer does not answer, or cannot draw the scene.
        """
        from carla_recap.export.rerun.stream import SIM_TIME

        with self._process.answering():
            self._client.set_time(SIM_TIME, duration=float(time), play_state="paused")
            picture = self._settled_picture()
        for view in self.state.views:
            for report in view.reports:
                if report.severity == "error":
                    raise RecapError(f"{self._recording}: the Rerun viewer cannot draw it: {report.summary}")
        return picture

    def _settled_picture(self) -> bytes:
        """Return the picture when it has stopped changing; the viewer loads data as it shows it."""
        begun = since = monotonic()
        picture = b""
        while (now := monotonic()) - since < _SETTLED and now - begun < _UNSETTLED:
            before, picture = picture, self._client.take_screenshot(self._shown)
            if picture != before:
                since = monotonic()
        return picture

    def _loaded(self) -> ViewerState | None:
        try:
            state = self.state
        except RecapError:
            return None  # it does not accept connections yet
        return state if state.active_recording and state.views and not state.loading else None


def picture(
    source: Recording | Reader,
    *,
    at: float,
    follow: Follow | None = None,
    view: View = "chase",
    road_map: RoadMap | None = None,
    size: Size = (1280, 720),
) -> bytes:
    """Return a picture of a recording at a time, as Rerun's viewer draws it.

    Args:
        source: The recording.
        at: The time in elapsed seconds; a negative number is counted from the end.
        follow: The actor that the camera follows: an id or "hero"; None: see `choose_followed`, in the seconds before.
        view: The camera: from behind, or from above.
        road_map: The map of the town.
        size: Width and height, in pixels.

    Returns:
        A PNG.

    Raises:
        RecapError: There is no such time or actor, or the viewer cannot draw here.
        FormatError: The file contradicts its format.
    """
    now = Player(source, start=at, follow=follow)
    time = now.at(now.start).time
    if follow is not None and now.followed not in now.at(time).ids:
        raise RecapError(f"{now.reader.path}: actor {now.followed} is not there at {time:g} s, so it cannot be followed")
    pose = None if now.followed is None else now.at(time).pose_of(now.followed)
    if pose is not None and not np.isfinite(pose).all():
        raise RecapError(f"{now.reader.path}: actor {now.followed} has no place at {time:g} s: its pose is no number")
    start = max(0.0, time - _LEAD)
    player = Player(source, start=start, duration=max(time - start, _SHORTEST), follow=follow)
    with TemporaryDirectory(prefix="carla-recap-") as folder:
        path = Path(folder) / "moment.rrd"
        _save(path, player, view, road_map)
        with ScreenshotTaker(path, size, only_view=True) as screenshots:
            return screenshots.take(time)


def _save(path: Path, player: Player, view: View, road_map: RoadMap | None) -> None:
    """Write an .rrd that shows one view without panels."""
    import rerun.blueprint as rrb

    panels = (rrb.TopPanel, rrb.BlueprintPanel, rrb.SelectionPanel, rrb.TimePanel)
    alone = rrb.Blueprint(camera_views(player)[view], *(panel(state="hidden") for panel in panels))
    with WholeFile(path) as file, Rrd(alone) as rrd:
        write(rrd.stream, player, road_map=road_map)
        file.write(rrd.take())
