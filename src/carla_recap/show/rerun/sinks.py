"""Rerun streams to files and to viewers."""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

import rerun as rr
import rerun_bindings as bindings

from carla_recap.errors import RecapError
from carla_recap.util.files import AtomicFile
from carla_recap.util.text import single_line

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import rerun.blueprint as rrb

APPLICATION: Final = "carla_recap"
"""The application id, by which the viewer finds the blueprints of a recording."""

_PROBE: Final = bytes(1 << 16)  # is written to find out why Rerun could not write


class RrdFile(AtomicFile):
    """An .rrd, which Rerun writes; see `AtomicFile`. A `live` one has no index at the end, which would be kept in memory.

    Attributes:
        stream: The stream to write to, until the file is closed.
    """

    def __init__(self, path: Path | str, arrangement: rrb.Blueprint, *, live: bool = False, force: bool = True) -> None:
        super().__init__(path, live=live, force=force)
        self.stream = rr.RecordingStream(APPLICATION, send_properties=False)
        self._begin(lambda: self._open(arrangement))

    def abandon(self) -> Path:
        """See `AtomicFile`."""
        self._end()
        return super().abandon()

    def _open(self, arrangement: rrb.Blueprint) -> None:
        try:
            self.stream.save(self._partial.absolute(), write_footer=not self._live)
        except RuntimeError as error:
            raise self._failed(error) from None
        send_blueprint(arrangement, self.stream)

    def _finish(self) -> None:
        try:
            self.stream.flush()
        except RuntimeError as error:
            raise self._failed(error) from None
        self._end()

    def _failed(self, error: RuntimeError) -> RecapError:
        self._file.seek(0, os.SEEK_END)
        self._file.write(_PROBE)
        self._file.flush()
        return RecapError(f"{self.path}: cannot be written: {single_line(error)}")

    def _end(self) -> None:
        if hasattr(self, "stream"):
            self.stream.disconnect()
            del self.stream
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


def save_blueprint(arrangement: rrb.Blueprint, path: Path) -> None:
    """Write an arrangement as a file of its own, or raise `RecapError`."""
    try:
        arrangement.save(APPLICATION, path)
    except RuntimeError as error:
        raise RecapError(f"{path}: cannot be written: {single_line(error)}") from None
    _clean_up()


def send_blueprint(arrangement: rrb.Blueprint, stream: rr.RecordingStream) -> None:
    """Send an arrangement and use it; `stream.send_blueprint` would keep a copy, and its threads, until the process ends."""
    native = bindings.new_blueprint(
        application_id=rr.get_application_id(stream) or APPLICATION,
        make_default=False,
        make_thread_default=False,
        default_enabled=True,
    )
    drawn = rr.RecordingStream._from_native(native)
    drawn.set_time("blueprint", sequence=0)
    arrangement._log_to_stream(drawn)
    memory = drawn.memory_recording().storage
    bindings.send_blueprint(memory, make_active=True, make_default=True, recording=stream.to_native())
    drawn.disconnect()
    del drawn, memory, native
    _clean_up()


def _clean_up() -> None:
    """End the threads of unused streams, and free their memory."""
    bindings.flush_and_cleanup_orphaned_recordings()
