"""Rerun streams to files and to viewers.

Rerun's own writer of files does not return if a disk gets full, or leaves the index out without a word: so Rerun writes to a
pipe.
"""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Final

import rerun as rr
import rerun_bindings as bindings

from carla_recap.errors import RecapError
from carla_recap.util.files import WholeFile
from carla_recap.util.text import single_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import rerun.blueprint as rrb

APPLICATION: Final = "carla_recap"
"""The application id, by which the viewer finds the blueprints of a recording."""

_PIECE: Final = 1 << 20
_DESCRIPTORS: Final = Path("/dev/fd")  # in which pipes have names


@contextmanager
def rrd_file(
    path: Path | str, arrangement: rrb.Blueprint, *, live: bool = False, force: bool = True
) -> Iterator[rr.RecordingStream]:
    """Open a stream to an .rrd, see `WholeFile`; a context manager. A full disk is an error at its end.

    A `live` one has no index at the end, which would be kept in memory.
    """
    with WholeFile(path, live=live, force=force) as file:
        stream = rr.RecordingStream(APPLICATION, send_properties=False)
        try:
            if _DESCRIPTORS.exists():
                reader = _connect(stream, file.write, index=not live)
                try:
                    send_blueprint(arrangement, stream)
                    yield stream
                finally:
                    stream.disconnect()
                    reader.join()
                reader.check()
            else:
                written = rr.binary_stream(stream)
                send_blueprint(arrangement, stream)
                yield stream
                stream.disconnect()
                file.write(written.read() or b"")
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
    reader = _PipeReader(end, put)
    reader.start()
    return reader


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


def save_blueprint(arrangement: rrb.Blueprint, path: Path) -> None:
    """Write an arrangement as a file of its own."""
    stream = _blueprint_stream(APPLICATION)
    written = rr.binary_stream(stream)
    send_blueprint(arrangement, stream)
    content = written.read() or b""
    stream.disconnect()
    del stream, written
    _clean_up()
    path.write_bytes(content)


def send_blueprint(arrangement: rrb.Blueprint, stream: rr.RecordingStream) -> None:
    """Send an arrangement and use it; `stream.send_blueprint` would keep a copy, and its threads, until the process ends."""
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


def _clean_up() -> None:
    """End the threads of unused streams, and free their memory."""
    bindings.flush_and_cleanup_orphaned_recordings()
