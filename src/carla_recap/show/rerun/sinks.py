"""Rerun streams in memory, through a pipe or to a viewer. Rerun's own writer of files never returns if a disk is full."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Final, Self

import rerun as rr
import rerun_bindings as bindings

from carla_recap.errors import RecapError
from carla_recap.util.text import single_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import TracebackType

    import rerun.blueprint as rrb

APPLICATION: Final = "carla_recap"
"""The application id, by which the viewer finds the blueprints of a recording."""

_TIMEOUT: Final = 60.0  # s; to compress what is left
_PIECE: Final = 1 << 20
_DESCRIPTORS: Final = Path("/dev/fd")  # in which pipes have names


class Rrd:
    """A Rerun stream whose bytes are kept, compressed, until they are taken; a context manager.

    Args:
        arrangement: The arrangement of the viewer.
        application: The application id.
        recording_id: The id of the recording; None: a new one.

    Attributes:
        stream: The stream to write to.
    """

    def __init__(
        self, arrangement: rrb.Blueprint, *, application: str = APPLICATION, recording_id: str | None = None
    ) -> None:
        self.stream = rr.RecordingStream(application, recording_id=recording_id, send_properties=False)
        self._bytes = rr.binary_stream(self.stream)
        send_blueprint(arrangement, self.stream)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stream.disconnect()
        self.take()  # or else Rerun prints a warning
        del self.stream, self._bytes
        _clean_up()

    def take(self) -> bytes:
        """Return what was written since the last call, which is a complete .rrd."""
        return _read(self._bytes)


@contextmanager
def piped(arrangement: rrb.Blueprint, put: Callable[[bytes], object], *, live: bool = False) -> Iterator[rr.RecordingStream]:
    """Open a stream whose bytes are passed on as they come, so that they do not fill the memory; a context manager.

    Args:
        arrangement: The arrangement of the viewer.
        put: Takes the bytes, in another thread; its errors are raised at the end.
        live: Leave out the index of all chunks at the end, which the SDK keeps in memory until then.
    """
    if not _DESCRIPTORS.exists():
        with Rrd(arrangement) as rrd:
            yield rrd.stream
            put(rrd.take())
        return
    stream = rr.RecordingStream(APPLICATION, send_properties=False)
    try:
        drain = _connect(stream, put, index=not live)
        try:
            send_blueprint(arrangement, stream)
            yield stream
        finally:
            stream.disconnect()
            drain.join()
        drain.check()
    finally:
        del stream
        _clean_up()


@contextmanager
def sent(arrangement: rrb.Blueprint, address: str) -> Iterator[rr.RecordingStream]:
    """Open a stream to a running viewer; a context manager.

    The address is one such as `rerun+http://127.0.0.1:9876/proxy`.
    """
    stream = rr.RecordingStream(APPLICATION, send_properties=False)
    try:
        try:
            stream.connect_grpc(address)
        except (RuntimeError, ValueError) as error:
            raise RecapError(f"{address}: {single_line(error)}") from None
        send_blueprint(arrangement, stream)
        yield stream
    finally:
        stream.disconnect()
        del stream
        _clean_up()


def _connect(stream: rr.RecordingStream, put: Callable[[bytes], object], *, index: bool) -> _PipeReader:
    end, own = os.pipe()
    try:
        stream.save(f"{_DESCRIPTORS}/{own}", write_footer=index)
    except RuntimeError as error:
        os.close(end)
        raise RecapError(f"a pipe for Rerun cannot be made: {single_line(error)}") from None
    finally:
        os.close(own)
    drain = _PipeReader(end, put)
    drain.start()
    return drain


class _PipeReader(Thread):
    """Passes on what comes through a pipe, which is read to its end even if that fails."""

    def __init__(self, end: int, put: Callable[[bytes], object]) -> None:
        super().__init__(name="carla-recap-rrd", daemon=True)
        self._end = end
        self._put = put
        self._error: Exception | None = None

    def run(self) -> None:
        """Read the pipe to its end."""
        with os.fdopen(self._end, "rb", buffering=0) as pipe:
            while piece := pipe.read(_PIECE):
                if self._error is None:
                    try:
                        self._put(piece)
                    except Exception as error:
                        self._error = error

    def check(self) -> None:
        """Raise the first error, if any."""
        if self._error is not None:
            raise self._error


def rbl(arrangement: rrb.Blueprint) -> bytes:
    """Return the content of a blueprint's file."""
    stream = _blueprint_stream(APPLICATION)
    data = rr.binary_stream(stream)
    send_blueprint(arrangement, stream)
    content = _read(data)
    stream.disconnect()
    del stream, data
    _clean_up()
    return content


def send_blueprint(arrangement: rrb.Blueprint, stream: rr.RecordingStream) -> None:
    """Send an arrangement and use it; `stream.send_blueprint` would keep a copy until the process ends."""
    drawn = _blueprint_stream(rr.get_application_id(stream) or APPLICATION)
    arrangement._log_to_stream(drawn)
    memory = drawn.memory_recording().storage
    bindings.send_blueprint(memory, make_active=True, make_default=True, recording=stream.to_native())
    drawn.disconnect()
    del drawn, memory
    _clean_up()


def _blueprint_stream(application: str) -> rr.RecordingStream:
    native = bindings.new_blueprint(
        application_id=application, make_default=False, make_thread_default=False, default_enabled=True
    )
    stream = rr.RecordingStream._from_native(native)
    stream.set_time("blueprint", sequence=0)
    return stream


def _read(stream: rr.BinaryStream) -> bytes:
    try:
        return stream.read(flush_timeout_sec=_TIMEOUT) or b""
    except RuntimeError as error:
        raise RecapError(f"Rerun: {single_line(error)}") from None


def _clean_up() -> None:
    """End the threads of unused streams, and free their memory."""
    bindings.flush_and_cleanup_orphaned_recordings()
