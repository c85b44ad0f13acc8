"""The recorder of a world: from start to stop, a frame for each tick."""

from __future__ import annotations

import os
import re
import time
import warnings
import weakref
from errno import ENOENT
from pathlib import Path, PureWindowsPath
from threading import RLock
from typing import TYPE_CHECKING, Final

from carla_recap.editing.convert import check_free
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.formats import SUFFIXES
from carla_recap.model.frame import Header
from carla_recap.sim.errors import DestinationError
from carla_recap.sim.recording.sampler import WorldSampler
from carla_recap.sim.recording.writer_process import RecordingWriter, start_process
from carla_recap.sim.settings import source_date

if TYPE_CHECKING:
    import subprocess
    from collections.abc import Callable, Mapping

    from carla_recap.sim.episode import Episode
    from carla_recap.sim.recording.snapshots import SnapshotBatch

FOLDER: Final = "CARLA_RECAP_RECORDINGS"
"""The environment variable that contains the folder of recordings."""
DEFAULT_FOLDER: Final = "recordings"
_LOG, _MCAP = SUFFIXES
_FOLDER_NAME: Final = re.compile(r"(^|[/\\])\.{0,2}$")
"""The end of names that only folders can have."""


def recordings_folder(folder: Path | str | None = None) -> Path:
    """Return the folder of recordings whose names are no paths: by default $CARLA_RECAP_RECORDINGS, else `recordings`."""
    return Path(folder or os.environ.get(FOLDER) or DEFAULT_FOLDER)


def recording_path(name: Path | str, folder: Path | str | None = None) -> Path:
    r"""Return the path of a recording: a name with `/`, `\` or `:` is a path, any other one is in the folder of recordings.

    Of a path with a Windows drive, other systems take the last part as a name. An empty name is a `RecapError`.
    """
    if os.name != "nt" and PureWindowsPath(name).drive.endswith(":"):
        name = PureWindowsPath(name).name
    if not str(name):
        raise RecapError("expected the name of a recording, found an empty text")
    return Path(name) if _is_path(name) else recordings_folder(folder) / name


def is_within(path: Path, folder: Path) -> bool:
    """Return whether a path lies below a folder once links are followed; False where they cannot be."""
    try:
        return folder.resolve() in path.resolve().parents
    except (OSError, ValueError, RuntimeError):  # such as a loop of links
        return False


def _is_path(name: Path | str) -> bool:
    return bool(re.search(r"[/\\:]", str(name)))


class WorldRecorder:
    """Records a world; a listener of its ticks.

    A disk error ends the recording, and not the simulation: a warning contains the reason.

    Attributes:
        error: The error that ended the latest recording early; None without one.
        failures: The errors of recordings that have ended early, by the absolute paths of their destinations.
        frames: The number of frames of the latest recording.
        duration: The time from its first frame to its last one, in s.
    """

    def __init__(self, episode: Episode, folder: Path | str | None, date: int | None, parameters: Mapping[str, str]) -> None:
        self.episode = episode
        self.error: RecapError | None = None
        self.failures: dict[Path, RecapError] = {}
        self.frames = 0
        self.duration = 0.0
        self._folder = folder
        self._date = date
        self._parameters = parameters
        self._sampler: WorldSampler | None = None
        self._writer: RecordingWriter | None = None
        self._finish: weakref.finalize[[], WorldRecorder] | None = None
        self._lock = RLock()  # a recording may be stopped by several threads

    @property
    def path(self) -> Path | None:
        """The destination of the running recording; None between recordings."""
        writer = self._writer
        return writer.path if writer else None

    @property
    def date(self) -> int:
        """The date of a recording that begins now, in Unix seconds."""
        return source_date(time.time()) if self._date is None else self._date

    def start(
        self,
        name: Path | str,
        additional_data: bool = False,
        *,
        force: bool = True,
        visible: bool = False,
        now: bool = False,
        in_process: bool = False,
        wide: bool = False,
        process: subprocess.Popen[bytes] | None = None,
    ) -> Path:
        """Begin a recording; one that is running is completed first, and an older one of that name replaced at the end.

        Args:
            name: `crash` or `crash.mcap`; `crash.log`, or any other suffix, for CARLA's format; see `recording_path`. A
                folder that is missing is made below the folder of recordings.
            additional_data: Record velocities, boxes, physics and the times of lights, too.
            force: Overwrite an older recording; else one that exists at the start is an error, and one that exists at
                the end stays: the new recording lies beside it then, and a warning contains its path.
            visible: Put a recording without frames under the name at once; else the name appears with the complete one.
            now: Record the world as it is as the first frame; else the first frame is the end of the next tick.
            in_process: Write in this process, which saves the start of another one; see `RecordingWriter`.
            wide: Record in double precision, and without physics, as CARLA 0.10 does.
            process: The process that writes, of `start_process`, which takes a moment; by default, it is started here.

        Raises:
            DestinationError: The destination cannot be written to.
            RecapError: The name is that of a folder, or of the recording that is being replayed; or an actor has data
                that no record can hold.
        """
        with self._lock:
            self.stop()
            self.error = None
            path = self._destination(name, force=force)
            header = Header(self.episode.town.name, self.date, wide=wide, shifted=wide, parameters=self._parameters)
            sampler = WorldSampler(self.episode, additional_data=additional_data, wide=wide)
            format = path.suffix.lower() if path.suffix.lower() in SUFFIXES else _LOG
            process = process or (None if in_process else start_process())
            self._writer = RecordingWriter(path, header, process, force=force, format=format, visible=visible)
            self._sampler = sampler
            # A recording that is never stopped is completed with the recorder or the interpreter.
            self._finish = weakref.finalize(self, self._writer.close)
            self.frames, self.duration = 0, 0.0
            self.failures.pop(path.absolute(), None)
            if now:
                self._write(self._writer, sampler, sampler.sample_now())
            return path

    def stop(self) -> None:
        """Complete the recording, and wait until it is complete; without a recording, do nothing."""
        with self._lock:
            self.end()()

    def end(self) -> Callable[[], None]:
        """End the recording with the latest tick; return what completes its file, which may run in a thread."""
        with self._lock:
            writer, finish = self._writer, self._finish
            self._writer = self._sampler = self._finish = None

        def complete() -> None:
            if writer is None or finish is None:
                return
            finish()
            self.error = writer.error
            if self.error is not None:
                self.failures[writer.path.absolute()] = self.error
                warnings.warn(f"the recording has ended: {self.error}", RecapWarning, stacklevel=3)

        return complete

    def __call__(self) -> None:
        """Record the tick that ends."""
        with self._lock:
            if self._writer is None or self._sampler is None:
                return
            if self._writer.error is not None:
                self.stop()
                return
            self._write(self._writer, self._sampler, self._sampler.sample(self.episode.clock.delta))

    def _write(self, writer: RecordingWriter, sampler: WorldSampler, batch: SnapshotBatch) -> None:
        writer.write(batch)
        self.frames, self.duration = sampler.count, sampler.elapsed

    def destination(self, name: Path | str) -> Path:
        """Return the path at which a recording of a name will be; `RecapError`: no recording can have the name."""
        named = recording_path(name, self._folder)
        if "\0" in str(name):
            raise RecapError(f"{str(name)!r:.200}: expected the name of a recording, found an embedded null byte")
        if _FOLDER_NAME.search(str(name)):
            raise RecapError(f"{str(name)!r:.200}: expected the name of a recording, found that of a folder")
        return named if named.suffix else named.with_name(named.name + _MCAP)

    def _destination(self, name: Path | str, *, force: bool) -> Path:
        """Check the destination, and make its folder if that is the one of recordings, or lies below it."""
        path = self.destination(name)
        check_free(path, force=force)
        if (folder := recording_path(name, self._folder)).is_dir():
            raise RecapError(f"{folder}: expected the name of a recording, found a folder")
        source = self.episode.replayed
        if source is not None and path.exists() and path.samefile(source):
            raise RecapError(f"{path}: is being replayed; the recorder needs another name")
        folder = recordings_folder(self._folder)
        if is_within(path, folder):
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                reason = f"the folder of recordings cannot be made: {error.strerror}"
                raise DestinationError(f"{path.parent}: {reason}") from None
        elif not path.parent.is_dir():
            raise DestinationError(f"{path}: cannot be written: {os.strerror(ENOENT)}")
        return path
