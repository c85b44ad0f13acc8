"""An .rrd in memory: Rerun's writer of files waits forever where a disk is full, or ends the file without a word."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Self

import rerun as rr
import rerun_bindings as bindings

from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from types import TracebackType

    import rerun.blueprint as rrb

APPLICATION: Final = "carla_recap"
"""The kind of data, by which the viewer knows which blueprints fit."""

_PATIENCE: Final = 60.0  # s; so long it may take to compress what is left


class Rrd:
    """A Rerun stream whose bytes are kept, compressed, until they are taken; while a `with` block runs.

    Args:
        arrangement: How the viewer is to show it.
        application: The kind of data.
        recording_id: Which recording it is; else one of its own.

    Attributes:
        stream: Writes to it.
    """

    def __init__(
        self, arrangement: rrb.Blueprint, *, application: str = APPLICATION, recording_id: str | None = None
    ) -> None:
        self.stream = rr.RecordingStream(application, recording_id=recording_id, send_properties=False)
        self._bytes = rr.binary_stream(self.stream)
        _send(arrangement, self.stream)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stream.disconnect()
        self.take()  # what nobody took, Rerun would complain of
        del self.stream, self._bytes
        _give_back()

    def take(self) -> bytes:
        """All that was written since it was taken last, which is an .rrd in itself.

        Raises:
            RecapError: Rerun does not give it.
        """
        return _read(self._bytes)


def rbl(arrangement: rrb.Blueprint) -> bytes:
    """The content of a blueprint's file.

    Raises:
        RecapError: Rerun does not give it.
    """
    stream = _blueprint_stream(APPLICATION)
    data = rr.binary_stream(stream)
    _send(arrangement, stream)
    content = _read(data)
    stream.disconnect()
    del stream, data
    _give_back()
    return content


def _send(arrangement: rrb.Blueprint, stream: rr.RecordingStream) -> None:
    """Send an arrangement, as the one to use; `stream.send_blueprint` would keep a copy as long as the process lives."""
    drawn = _blueprint_stream(rr.get_application_id(stream) or APPLICATION)
    arrangement._log_to_stream(drawn)
    memory = drawn.memory_recording().storage
    bindings.send_blueprint(memory, make_active=True, make_default=True, recording=stream.to_native())
    drawn.disconnect()


def _blueprint_stream(application: str) -> rr.RecordingStream:
    native = bindings.new_blueprint(
        application_id=application, make_default=False, make_thread_default=False, default_enabled=True
    )
    stream = rr.RecordingStream._from_native(native)
    stream.set_time("blueprint", sequence=0)
    return stream


def _read(stream: rr.BinaryStream) -> bytes:
    try:
        return stream.read(flush_timeout_sec=_PATIENCE) or b""
    except RuntimeError as error:
        raise RecapError(f"Rerun: {' '.join(str(error).split())}") from None


def _give_back() -> None:
    """Let Rerun end the threads of streams that are no longer used, each of which has its memory."""
    bindings.flush_and_cleanup_orphaned_recordings()
