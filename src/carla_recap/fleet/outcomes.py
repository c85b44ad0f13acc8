"""What comes of one recording among many: a value, or an error."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from collections.abc import Callable

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


def outcome_of(function: Callable[[SourceFile], T], source: SourceFile) -> Outcome[T]:
    """Return the outcome of a function for a recording, in this process."""
    if source.error is not None:
        return Outcome(source, None, source.error)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            value, error = function(source), None
        except RecapError as failure:
            value, error = None, str(failure)
        except OSError as failure:
            value, error = None, f"{source.location}: {failure.strerror or failure}"
        except MemoryError:
            value, error = None, f"{source.location}: not enough memory"
    return Outcome(source, value, error, tuple(str(warning.message) for warning in caught))
