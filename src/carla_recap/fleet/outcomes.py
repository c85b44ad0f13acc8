"""What comes of one recording among many: a value, such as what was written, or an error."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from carla_recap.errors import RecapError
from carla_recap.util.files import reason_of
from carla_recap.util.text import single_line

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from carla_recap.fleet.sources import SourceFile

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Outcome(Generic[T]):
    """What came of one recording.

    Attributes:
        source: The recording.
        value: What the function returned; None after an error.
        error: The error, in one line; None if there was none.
        warnings: The warnings, a line each.
    """

    source: SourceFile
    value: T | None
    error: str | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class WrittenFile:
    """What was written for a recording."""

    notes: tuple[str, ...] = ()  # what is to be said of it, in words
    frames: int | None = None
    seconds: float | None = None
    size: int | None = None  # its size in bytes; None: as found
    facts: Mapping[str, Any] = field(default_factory=dict)  # more facts, for JSON
    hints: tuple[str, ...] = ()  # what is to be said once, however many recordings there are
    path: str = ""  # path or URL; what `write_file` calls returns that of the file to open in a folder, or nothing


def outcome_of(function: Callable[[SourceFile], T], source: SourceFile) -> Outcome[T]:
    """Return the outcome of a function for a recording, in this process."""
    if source.error is not None:
        return Outcome(source, None, source.error)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            value, error = function(source), None
        except (RecapError, OSError, MemoryError) as failure:
            value, error = None, one_line(failure, source)
    return Outcome(source, value, error, tuple(source.as_given(str(warning.message)) for warning in caught))


def one_line(error: Exception, source: SourceFile) -> str:
    """Return what an error with a recording says, in one line."""
    location = source.location
    if isinstance(error, RecapError):
        return source.as_given(str(error))
    if isinstance(error, MemoryError):
        return f"{location}: not enough memory"
    if isinstance(error, OSError):
        return f"{location}: {reason_of(error)}"
    return f"{location}: {type(error).__name__}: {single_line(error)}"
