"""Pictures of a Rerun recording, taken by Rerun's viewer where there is no display, nor a GPU."""

from __future__ import annotations

from contextlib import ExitStack
from time import monotonic
from typing import TYPE_CHECKING, Final, Self

from carla_recap.errors import RecapError
from carla_recap.export.viewer_process import HOST, LISTENING, Program

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

    from rerun.experimental import ViewerState

Size = tuple[int, int]
"""Width and height, in pixels."""

SMALLEST: Final = 64
LARGEST: Final = 4096
"""The least and the most pixels of a picture's side."""

_AROUND: Final = (7, 71)  # pixels of the window that surround a view
_SETTLED: Final = 0.15  # s; for so long a picture must not change
_UNSETTLED: Final = 10.0  # s; after which it is taken as it is


class Photographer:
    """Takes pictures of a recording, while a `with` block runs.

    with Photographer("run.rrd") as photographer:
        Path("crash.png").write_bytes(photographer.take(24.6))

    Args:
        recording: The .rrd, or what else the viewer opens: a recording by its importer, the address of a server.
        size: That of the pictures.
        only_view: Picture the only view that the recording's blueprint has, and nothing around it; else the whole window.

    Raises:
        RecapError: No pictures of such a size can be taken; on entry: the viewer cannot draw here, or not the recording.
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
            program = Program("--headless", "--window-size", f"{width}x{height}", self._recording)
            self._program = stack.enter_context(program)
            self._client = ViewerClient.connect(f"rerun+http://{HOST}:{program.port(LISTENING)}/proxy")
            state = program.wait_for("recording", self._loaded)
            self._shown = state.views[0].view_id if self._only_view else None
            self._stack = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._stack.close()

    @property
    def state(self) -> ViewerState:
        """What the viewer shows.

        Raises:
            RecapError: It does not answer.
        """
        with self._program.answering():
            return self._client.get_state()

    def take(self, time: float) -> bytes:
        """Take a picture.

        Args:
            time: Elapsed seconds.

        Returns:
            A PNG.

        Raises:
            RecapError: The viewer does not answer, or cannot draw what is there.
        """
        from carla_recap.export.rerun.stream import SIM_TIME

        with self._program.answering():
            self._client.set_time(SIM_TIME, duration=float(time), play_state="paused")
            picture = self._settled_picture()
        for view in self.state.views:
            for report in view.reports:
                if report.severity == "error":
                    raise RecapError(f"{self._recording}: the Rerun viewer cannot draw it: {report.summary}")
        return picture

    def _settled_picture(self) -> bytes:
        """What is shown once nothing changes any more: the viewer loads data when it has to show it."""
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
            return None  # it does not listen yet
        return state if state.active_recording and state.views and not state.loading else None
