"""An .rrd in memory, or through a pipe: Rerun's own writer of files waits for ever where a disk is full."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Final, Self

import rerun as rr
import rerun_bindings as bindings

from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import TracebackType

    import rerun.blueprint as rrb

APPLICATION: Final = "carla_recap"
"""The kind of data, by which the viewer knows which blueprints fit."""

_PATIENCE: Final = 60.0  # s; so long it may take to compress what is left
_PIECE: Final = 1 << 20
_DESCRIPTORS: Final = Path("/dev/fd")  # where a pipe has a name


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
        send_blueprint(arrangement, self.stream)

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


@contextmanager
def piped(arrangement: rrb.Blueprint, put: Callable[[bytes], object]) -> Iterator[rr.RecordingStream]:
    """A stream whose bytes are handed on as they come, so that they never fill the memory; while a `with` block runs.

    Args:
        arrangement: How the viewer is to show it.
        put: Takes the bytes, in a thread of its own; what it raises is raised at the end.
    """
    if not _DESCRIPTORS.exists():
        with Rrd(arrangement) as rrd:
            yield rrd.stream
            put(rrd.take())
        return
    stream = rr.RecordingStream(APPLICATION, send_properties=False)
    try:
        drain = _connect(stream, put)
        try:
            send_blueprint(arrangement, stream)
            yield stream
        finally:
            stream.disconnect()
            drain.join()
        drain.check()
    finally:
        del stream
        _give_back()


@contextmanager
def sent(arrangement: rrb.Blueprint, address: str) -> Iterator[rr.RecordingStream]:
    """A stream to a viewer that listens; while a `with` block runs.

    Args:
        arrangement: How the viewer is to show it.
        address: Where it listens: `rerun+http://127.0.0.1:9876/proxy`.

    Raises:
        RecapError: That is no address.
    """
    stream = rr.RecordingStream(APPLICATION, send_properties=False)
    try:
        try:
            stream.connect_grpc(address)
        except (RuntimeError, ValueError) as error:
            raise RecapError(f"{address}: {' '.join(str(error).split())}") from None
        send_blueprint(arrangement, stream)
        yield stream
    finally:
        stream.disconnect()
        del stream
        _give_back()


def _connect(stream: rr.RecordingStream, put: Callable[[bytes], object]) -> _Drain:
    end, ours = os.pipe()
    try:
        stream.save(f"{_DESCRIPTORS}/{ours}")
    except RuntimeError as error:
        os.close(end)
        raise RecapError(f"a pipe for Rerun cannot be made: {' '.join(str(error).split())}") from None
    finally:
        os.close(ours)
    drain = _Drain(end, put)
    drain.start()
    return drain


class _Drain(Thread):
    """Hands on what comes through a pipe; it is read to its end, whatever happens to the pieces."""

    def __init__(self, end: int, put: Callable[[bytes], object]) -> None:
        super().__init__(name="carla-recap-rrd", daemon=True)
        self._end = end
        self._put = put
        self._error: Exception | None = None

    def run(self) -> None:
        """Read on."""
        with os.fdopen(self._end, "rb", buffering=0) as pipe:
            while piece := pipe.read(_PIECE):
                if self._error is None:
                    try:
                        self._put(piece)
                    except Exception as error:
                        self._error = error

    def check(self) -> None:
        """Raise what went wrong, if anything did."""
        if self._error is not None:
            raise self._error


def rbl(arrangement: rrb.Blueprint) -> bytes:
    """The content of a blueprint's file.

    Raises:
        RecapError: Rerun does not give it.
    """
    stream = _blueprint_stream(APPLICATION)
    data = rr.binary_stream(stream)
    send_blueprint(arrangement, stream)
    content = _read(data)
    stream.disconnect()
    del stream, data
    _give_back()
    return content


def send_blueprint(arrangement: rrb.Blueprint, stream: rr.RecordingStream) -> None:
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
