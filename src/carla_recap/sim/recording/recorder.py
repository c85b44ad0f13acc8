"""The recorder of a world: from start to stop, a frame for each tick."""

from __future__ import annotations

import os
import re
import warnings
import weakref
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.conversion import check_free
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.formats import SUFFIXES
from carla_recap.frame import Header
from carla_recap.sim.recording.background import BackgroundWriter
from carla_recap.sim.recording.sampling import Sampler

if TYPE_CHECKING:
    from carla_recap.sim.interfaces import RecordedWorld

FOLDER: Final = "CARLA_RECAP_RECORDINGS"
"""The environment variable that names the folder of recordings."""
DEFAULT_FOLDER: Final = "recordings"
_OF_FOLDERS: Final = re.compile(r"(^|[/\\])\.{0,2}$")
"""What names end with that can be none but those of folders."""


def recordings_folder(folder: Path | str | None = None) -> Path:
    """The folder of recordings that have a name and no place.

    Args:
        folder: The one that is wanted; else the environment variable CARLA_RECAP_RECORDINGS says it, else it is
            `recordings` in the working directory.
    """
    return Path(folder or os.environ.get(FOLDER) or DEFAULT_FOLDER)


def recording_path(name: Path | str, folder: Path | str | None = None) -> Path:
    r"""Where a recording lies.

    Args:
        name: With `/`, `\` or `:` in it, a path; else a name in the folder of recordings, as with CARLA.
        folder: See `recordings_folder`.

    Raises:
        RecapError: The name is empty.
    """
    if not str(name):
        raise RecapError("the name of a recording was expected, found an empty text")
    return Path(name) if _is_path(name) else recordings_folder(folder) / name


def _is_path(name: Path | str) -> bool:
    return bool(re.search(r"[/\\:]", str(name)))


class Recorder:
    """Records a world; a listener of its ticks.

    What goes wrong on the disk while it records ends the recording, and not the simulation: a warning tells of it.

    Args:
        world: The world.
        folder: Where recordings go whose names are no paths; see `recordings_folder`.

    Attributes:
        error: Why the latest recording ended early; None where it did not.
    """

    def __init__(self, world: RecordedWorld, folder: Path | str | None = None) -> None:
        self.error: RecapError | None = None
        self._world = world
        self._folder = folder
        self._sampler: Sampler | None = None
        self._writer: BackgroundWriter | None = None
        self._finish: weakref.finalize[[], Recorder] | None = None

    @property
    def path(self) -> Path | None:
        """What is being recorded to; None between recordings."""
        return self._writer.path if self._writer else None

    def start(self, name: Path | str, additional_data: bool = False, *, force: bool = True) -> Path:
        """Begin a recording; one that is running is completed first.

        It takes the place of an older one of that name when it is complete, as with CARLA.

        Args:
            name: `crash` or `crash.mcap`; `crash.log` for CARLA's format; see `recording_path`.
            additional_data: Tell of velocities, boxes, physics and the times of lights, too.
            force: Overwrite what is there; else what is there at the start is an error, and what is there at the end
                stays: the new recording lies beside it then, and a warning says where.

        Returns:
            Where it will be, once it is complete.

        Raises:
            RecapError: The suffix is of no format, the place cannot be written to, or an actor cannot be told of; or it
                is the recording that is being replayed.
        """
        self.stop()
        self.error = None
        path = self._destination(name, force=force)
        header = Header(self._world.town.name, self._world.date)
        sampler = Sampler(self._world, additional_data=additional_data)
        self._writer = BackgroundWriter(path, header, force=force)
        self._sampler = sampler
        # Whoever forgets to stop, or to close the world, finds a whole recording.
        self._finish = weakref.finalize(self, self._writer.close)
        return path

    def stop(self) -> None:
        """Complete the recording, and wait until it is; harmless where there is none."""
        if self._writer is None or self._finish is None:
            return
        self._finish()
        self.error = self._writer.error
        self._writer = self._sampler = self._finish = None
        if self.error is not None:
            warnings.warn(f"the recording has ended: {self.error}", RecapWarning, stacklevel=2)

    def __call__(self) -> None:
        """Take in the tick that ends."""
        if self._writer is None or self._sampler is None:
            return
        if self._writer.error is not None:
            self.stop()
            return
        self._writer.write(self._sampler.snapshot(self._world.delta))

    def _destination(self, name: Path | str, *, force: bool) -> Path:
        """Where a recording of a name goes; its folder is made, unless the name is a path.

        Raises:
            RecapError: No recording can be there.
        """
        named = recording_path(name, self._folder)
        if "\0" in str(name):
            raise RecapError(f"{str(name)!r:.200}: the name of a recording was expected, found an embedded null byte")
        if _OF_FOLDERS.search(str(name)):
            raise RecapError(f"{str(name)!r:.200}: the name of a recording was expected, and this is that of a folder")
        path = named if named.suffix else named.with_name(named.name + SUFFIXES[-1])
        check_free(path, force=force)
        if named.is_dir():
            raise RecapError(f"{named}: the name of a recording was expected, and this is a folder")
        source = self._world.replayed
        if source is not None and path.exists() and path.samefile(source):
            raise RecapError(f"{path}: is being replayed; the recorder needs another name")
        if not _is_path(name):
            _make(path.parent)
        return path


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecapError(f"{folder}: the folder of recordings cannot be made: {error.strerror}") from None
