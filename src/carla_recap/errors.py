"""The errors of the package: each message is one line, with the file, the offset and what was expected.

RecapError
├── FormatError            a file contradicts its format
│   └── NotARecording      a file is not a recording
├── Closed                 a closed recording is used
├── RecordError            records that cannot be written (too many, wrong shape, unknown name)
└── NotSetUp               the machine lacks something, whatever the file
    ├── MissingExtra       an optional dependency is not installed
    └── NoCredentials      the environment has no credentials for an object store
RecapWarning               part of a file is left out
"""

from __future__ import annotations

import sys
from threading import local
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


class RecapError(Exception):
    """Base of all errors of this package."""


class FormatError(RecapError):
    """A file contradicts its format.

    Args:
        location: The path of the file, or its URL.
        offset: The offset of the fault, in bytes; None where it has no single one.
        message: What was found and what was expected.
    """

    def __init__(self, location: Path | str, offset: int | None, message: str) -> None:
        super().__init__(location, offset, message)
        self.location = str(location)
        self.offset = offset
        self.message = message

    def __str__(self) -> str:
        offset = "" if self.offset is None else f"byte {self.offset}: "
        return f"{self.location}: {offset}{self.message}"


class NotARecording(FormatError):
    """A file is neither a CARLA log nor an MCAP recording of this package."""

    def __init__(self, location: Path | str, message: str) -> None:
        super().__init__(location, None, message)
        self.args = (location, message)


class Closed(RecapError):
    """A closed recording is used.

    Args:
        location: The path of the file, or its URL.
    """

    def __init__(self, location: Path | str) -> None:
        super().__init__(location)
        self.location = str(location)

    def __str__(self) -> str:
        return f"{self.location}: the recording is closed"


class RecordError(RecapError):
    """Records cannot be written as given."""


def _has_carla() -> bool:
    """Return whether CARLA publishes its library for this Python and machine."""
    import platform  # which every start would wait for

    machines = {"linux": "x86_64", "win32": "AMD64"}
    return sys.version_info < (3, 13) and machines.get(sys.platform) == platform.machine()


class NotSetUp(RecapError):
    """The machine lacks something that is needed, whatever the file."""


class NoCredentials(NotSetUp):
    """The environment has no credentials for an object store."""


class MissingExtra(NotSetUp):
    """An optional dependency is not installed.

    Args:
        what: The feature that was asked for.
        extra: The extra of this package that brings it.
    """

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(what, extra)
        self.what = what
        self.extra = extra

    def __str__(self) -> str:
        if self.extra == "carla" and not _has_carla():
            return f"{self.what} needs CARLA's library, which exists for Python up to 3.12 on Linux (x86-64) and Windows"
        return f"{self.what} needs an optional dependency: {install_command(self.extra)} in a clone of carla-recap"


def install_command(extra: str) -> str:
    """Return the command that installs an extra, in a clone."""
    return f"pip install '.[{extra}]'"


class RecapWarning(UserWarning):
    """Part of a file was left out; the message contains how much, and why."""

    _made = local()

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)
        RecapWarning._made.count = RecapWarning.made_in_thread() + 1

    @classmethod
    def made_in_thread(cls) -> int:
        """Return how many there were so far in this thread, shown or not: filters of warnings are those of all threads."""
        count: int = getattr(cls._made, "count", 0)
        return count
