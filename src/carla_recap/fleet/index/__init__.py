"""The index of many recordings: a DuckDB file, which is written incrementally and queried with SQL."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from carla_recap.util.lazy import lazily

if TYPE_CHECKING:
    from carla_recap.fleet.index.database import RecordingIndex, open_index
    from carla_recap.fleet.index.writing import IndexSummary, write_index

__all__ = ["IndexSummary", "RecordingIndex", "open_index", "write_index"]

_get, __dir__ = lazily(
    __name__,
    {"database": ("RecordingIndex", "open_index"), "writing": ("IndexSummary", "write_index")},
)


def __getattr__(name: str) -> Any:
    return _get(name)
