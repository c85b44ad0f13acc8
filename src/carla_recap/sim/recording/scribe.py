"""The process that writes recordings: no simulation shares its time, or its end, with what goes to a disk.

It is told what to do over its standard input, and answers each time over its standard output, in pickles: None, or what went
wrong. When whoever told it is gone, it completes the recording that it is at.
"""

from __future__ import annotations

import os
import pickle
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import RecapError
from carla_recap.formats import create_writer
from carla_recap.recovery import rescue
from carla_recap.sim.recording.scribes import HELLO

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from typing import BinaryIO

    from carla_recap.formats.base import Writer
    from carla_recap.frame import Header
    from carla_recap.sim.recording.snapshots import Strip


class Scribe:
    """Writes a recording at a time.

    A disk that is full or broken ends the recording: what is on the disk by then is made a whole recording if that can be
    done, and else left beside the destination, where `recover` takes it.
    """

    def __init__(self) -> None:
        self._writer: Writer | None = None

    def begin(self, folder: Path, path: Path, header: Header, force: bool) -> None:
        """Begin a recording.

        Args:
            folder: What the path is relative to.
            path: The destination; the suffix says the format.
            header: The header.
            force: Take the place of what is at the destination by the end.

        Raises:
            RecapError: The suffix is of no format, or the place cannot be written to.
        """
        os.chdir(folder)
        self._writer, self._path = create_writer(path, header, live=True, force=force), path
        self._is_empty = True

    def write(self, strip: Strip) -> None:
        """Add the frames of a strip.

        Raises:
            RecapError: The recording has ended; the message says why, and where what was recorded is.
        """
        assert self._writer is not None
        self._is_empty = False
        try:
            for run in strip.runs():
                self._writer.write_run(run)
        except Exception as error:
            raise self._rescued(error) from None

    def close(self) -> None:
        """Complete the recording, if there is one.

        Raises:
            RecapError: As of `write`.
        """
        if self._writer is None:
            return
        try:
            self._writer.close()
        except Exception as error:
            raise self._rescued(error) from None
        self._writer = None

    def leave(self) -> None:
        """Complete what has been begun, since nobody says what else is to be done; what nothing has come of is given up.

        Raises:
            RecapError: As of `write`.
        """
        if self._writer is not None and self._is_empty:
            self._writer.abort()
        else:
            self.close()

    def _rescued(self, error: Exception) -> RecapError:
        assert self._writer is not None
        writer, self._writer = self._writer, None
        return rescue(writer, self._path, error)


_NICE: Final = 5  # where processors are few, the simulation comes first; this needs a tenth of one
DEEDS: Final[dict[str, Callable[..., None]]] = {"begin": Scribe.begin, "write": Scribe.write, "close": Scribe.close}
"""What a scribe can be told to do."""


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Do what is asked for until nobody asks any more; then complete what has been begun.

    Args:
        requests: Pickles of the name of a deed and its arguments; None is the last one.
        answers: Where a pickle goes when each is done: None, or what went wrong.
    """
    scribe = Scribe()
    with suppress(EOFError, OSError, pickle.UnpicklingError):
        while (request := pickle.load(requests)) is not None:
            name, arguments = request
            pickle.dump(_outcome(DEEDS[name], scribe, arguments), answers)
            answers.flush()
    with suppress(RecapError):
        scribe.leave()


def _outcome(deed: Callable[..., None], scribe: Scribe, arguments: tuple[Any, ...]) -> str | None:
    try:
        deed(scribe, *arguments)
    except RecapError as error:
        return str(error)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None


def main() -> None:
    """Be that process."""
    if hasattr(os, "nice"):
        os.nice(_NICE)
    answers = sys.stdout.buffer
    sys.stdout = sys.stderr
    with suppress(OSError):  # whoever started it may be gone by now
        answers.write(HELLO)
        answers.flush()
    serve(sys.stdin.buffer, answers)
    os._exit(0)  # whoever is still there may be waiting for it
