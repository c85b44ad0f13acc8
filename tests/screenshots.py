"""Pictures of recordings, drawn by Rerun's viewer without a display and without a GPU."""

from __future__ import annotations

from contextlib import ExitStack
from time import monotonic
from typing import TYPE_CHECKING, Final, Self

from carla_recap.errors import RecapError
from carla_recap.show.rerun import viewer
from carla_recap.show.rerun.viewer import GRPC_PORT, HOST, RerunViewer
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

    from rerun.experimental import ViewerState

Size = tuple[int, int]
"""Width and height, in pixels."""

_SETTLED: Final = 0.15  # s without a change, after which a picture is complete
_SAME: Final = 4  # pictures without a change: on a busy machine, one takes that long
_UNSETTLED: Final = 60.0  # s, after which it is taken in any case

viewer.TIMEOUT = PATIENCE


class ScreenshotTaker:
    """Takes pictures of the whole window with a recording, during a `with` block.

    with ScreenshotTaker("run.rrd") as screenshots:
        Path("crash.png").write_bytes(screenshots.take(24.6))

    Args:
        recording: An .rrd, or another source that the viewer opens: a recording by its importer, the address of a server.
        size: The size of the pictures.

    Raises:
        RecapError: On entry: the viewer cannot draw here, or cannot open the recording.
        MissingExtra: On entry: there is no viewer.
    """

    def __init__(self, recording: Path | str, size: Size = (1280, 720)) -> None:
        self._recording = str(recording)
        self._size = size

    def __enter__(self) -> Self:
        from rerun.experimental import ViewerClient

        width, height = self._size
        with ExitStack() as stack:
            process = RerunViewer("--headless", "--window-size", f"{width}x{height}", self._recording)
            self._process = stack.enter_context(process)
            self._client = ViewerClient.connect(f"rerun+http://{HOST}:{process.port(GRPC_PORT)}/proxy")
            process.wait_for("recording", self._loaded)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._stack.close()

    @property
    def state(self) -> ViewerState:
        """The state of the viewer."""
        return self._client.get_state()

    def take(self, time: float) -> bytes:
        """Take a picture.

        Args:
            time: Elapsed seconds.

        Returns:
            A PNG.

        Raises:
            RecapError: The viewer cannot draw the scene.
        """
        from carla_recap.show.rerun.stream import SIM_TIME

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
        picture, same = b"", 0
        while ((now := monotonic()) - since < _SETTLED or same < _SAME) and now - begun < _UNSETTLED:
            before, picture = picture, self._client.take_screenshot()
            same += 1
            if picture != before:
                since, same = monotonic(), 1
        return picture

    def _loaded(self) -> ViewerState | None:
        try:
            state = self.state
        except (OSError, RuntimeError):
            return None  # it does not accept connections yet
        return state if state.active_recording and state.views and not state.loading else None
