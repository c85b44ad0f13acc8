"""Writing an index: recordings that are new or have changed are read, and their rows are written from time to time."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Generator
from dataclasses import astuple, dataclass, replace
from datetime import datetime, timedelta
from functools import lru_cache, partial
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.fleet.engine import map_sources
from carla_recap.fleet.index.database import create_index
from carla_recap.fleet.index.reading import read_recording
from carla_recap.fleet.index.tables import RECORDING, RECORDINGS, TABLES, RecordingRow
from carla_recap.fleet.sources import find_sources
from carla_recap.queries.score import read_routes
from carla_recap.roads import find_map
from carla_recap.util.files import check_path

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    import pyarrow as pa
    from distributed import Client

    from carla_recap.fleet.index.database import RecordingIndex
    from carla_recap.fleet.index.reading import Tables
    from carla_recap.fleet.outcomes import Outcome
    from carla_recap.fleet.sources import SourceFile

    Reading = tuple[dict[str, Any], Tables]
    Progress = Callable[[Iterable[Outcome[Reading]], int], Iterable[Outcome[Reading]]]

_ROWS: Final = 20_000  # of all tables, that wait to be written, at most
_PAUSE: Final = 1.0  # s between two transactions, at least
_SHARE: Final = 0.2  # of the time of the whole run, that this pause is at least
_EPOCH: Final = datetime(1970, 1, 1)


@dataclass(frozen=True, slots=True)
class IndexSummary:
    """What became of the recordings when an index was written.

    Attributes:
        recordings: The number of recordings that were meant.
        read: The number of those that were read.
        failed: The number of those that could not be read.
        unchanged: The number of those that had not changed since they were read.
        unreadable: The number of unchanged ones that could not be read then.
        removed: The number of recordings that the index had before, and no longer has.
        unknown_maps: The names of the maps that are unknown, of recordings that were measured without their roads.
    """

    recordings: int
    read: int
    failed: int
    unchanged: int
    unreadable: int
    removed: int
    unknown_maps: tuple[str, ...]


def write_index(
    sources: Iterable[str | Path],
    index: Path | str,
    *,
    jobs: int | None = None,
    client: Client | None = None,
    measures: bool = False,
    road_map: Path | str | None = None,
    route: Path | str | None = None,
    prune: bool = False,
    retry: bool = False,
    again: bool = False,
    progress: Progress | None = None,
    report: Callable[[str], None] | None = None,
) -> IndexSummary:
    """Write the rows of recordings into an index, a DuckDB file.

    Recordings that the index has, and that have not changed, are not read. Those that cannot be read become rows with their
    error. If the process ends early, however it does, the next call goes on with what is missing. Several processes may
    write an index at the same time.

    Args:
        sources: Files, folders, globs and URLs of recordings.
        index: The file, which is made if it does not exist.
        jobs: The number of processes; None: as many as there are processors.
        client: Dask's client, whose cluster reads instead of processes of this machine.
        measures: Read every frame, also of recordings of which this was not done: for near misses, for the measures of
            heroes, and for incidents of the road where the map is known; also of recordings whose map was unknown then, and
            is known now. Else their events are read alone.
        road_map: The map, or the folder with maps to look in; None: the usual folders.
        route: A route file, by which recordings are scored, those too that have not changed, but were scored by another one
            or not at all; None: those that are read get no score.
        prune: Remove all recordings from the index that the sources do not mean.
        retry: Read recordings again that could not be read, even if they have not changed.
        again: Read all recordings again.
        progress: Gets the outcomes and their number, and yields the outcomes.
        report: Is called with the error of each recording that cannot be read.

    Raises:
        MissingExtra: DuckDB or pyarrow is not installed.
        RecapError: A folder or glob means no recordings, or the index is at a URL, of another version, damaged, or in use by
            another process for a minute, or it cannot be written.
    """
    check_path(index)
    meant = {_unicode(source.location): source for source in map(_absolute, find_sources(sources))}
    written = create_index(index)
    written.verify()
    known = {row.pop(RECORDING): RecordingRow(**row) for row in written.table(RECORDINGS.name).to_pylist()}
    maps = None if road_map is None else str(Path(road_map).absolute())
    routes = None if route is None else read_routes(Path(route).absolute())
    route_file = None if routes is None else routes[0].path
    finds = _finder(maps)
    changed = {
        key: source
        for key, source in meant.items()
        if again
        or key not in known
        or not _suffices(known[key], source, finds, retry=retry, measured=measures, route_file=route_file)
    }
    if route_file is not None:  # what is read again for its score alone keeps its measures
        measures |= any(known[key].measured for key in changed if key in known)
    kept = [known[key] for key in meant.keys() - changed.keys()]
    without_roads = {each.map or "" for each in kept if measures and each.lacks_roads}
    writing = _Writing(written)
    read = partial(read_recording, measured=measures, road_map=maps, routes=routes)
    outcomes: Iterable[Outcome[Reading]] = map_sources(read, changed.values(), jobs=jobs, client=client)
    watched = progress(outcomes, len(changed)) if progress else outcomes
    failed = 0
    try:
        for key, outcome in zip(changed, watched, strict=True):
            writing.add(key, outcome)
            if measures and outcome.value is not None and not outcome.value[0]["roads_known"]:
                without_roads.add(outcome.value[0]["map"])
            if outcome.error is not None:
                failed += 1
                if report:
                    report(outcome.error)
    finally:
        writing.flush()
        for each in (watched, outcomes):
            if isinstance(each, Generator):
                each.close()
    removed = known.keys() - meant.keys() if prune else set()
    if removed:
        written.remove(removed)
    return IndexSummary(
        recordings=len(meant),
        read=len(changed) - failed,
        failed=failed,
        unchanged=len(kept),
        unreadable=sum(each.error is not None for each in kept),
        removed=len(removed),
        unknown_maps=tuple(sorted(without_roads)),
    )


def _suffices(
    row: RecordingRow,
    source: SourceFile,
    finds: Callable[[str], bool],
    *,
    retry: bool,
    measured: bool,
    route_file: str | None,
) -> bool:
    """Return whether a recording need not be read again: it is as its row says, and was read as is wanted."""
    size, modified, etag = _state(source)
    if etag is not None:
        is_as_before = (row.size, row.etag) == (size, etag)
    else:
        is_as_before = size is not None and (row.size, row.modified) == (size, modified)
    if row.error is not None:
        return is_as_before and not retry
    if measured and (not row.measured or (row.lacks_roads and finds(row.map or ""))):
        return False
    return is_as_before and route_file in (None, row.route_file)


def _finder(maps: str | None) -> Callable[[str], bool]:
    """Return a function that returns whether a map is known; see `write_index`."""
    if maps is not None and not Path(maps).is_dir():
        return lambda name: True
    return lru_cache(None)(lambda name: find_map(name, maps) is not None)


def _state(source: SourceFile) -> tuple[int | None, datetime | None, str | None]:
    """Return the size, the time and the ETag, without its quotes, of a recording."""
    return source.size, _time(source.modified), None if source.etag is None else source.etag.replace('"', "")


class _Writing:
    """Collects rows, and writes them from time to time."""

    def __init__(self, index: RecordingIndex) -> None:
        self._index = index
        self._begin = self._last = monotonic()
        self._rows: defaultdict[str, list[tuple[Any, ...]]] = defaultdict(list)

    def add(self, key: str, outcome: Outcome[Reading]) -> None:
        """Add the rows of a recording."""
        read, children = outcome.value or ({}, {})
        warning = "; ".join(dict.fromkeys(outcome.warnings)) or None
        row = RecordingRow(*_state(outcome.source), outcome.error, warning, **read)
        for name, rows in {RECORDINGS.name: [RECORDINGS.cells_of(row)], **children}.items():
            self._rows[name] += [(key, *cells) for cells in rows]
        pause = max(_PAUSE, _SHARE * (monotonic() - self._begin))
        if sum(map(len, self._rows.values())) >= _ROWS or monotonic() - self._last >= pause:
            self.flush()

    def flush(self) -> None:
        """Write the rows that wait, if there are any."""
        if self._rows:
            self._index.replace({name: _table(name, rows) for name, rows in self._rows.items() if rows})
            self._rows.clear()
            self._last = monotonic()


def _table(name: str, rows: list[tuple[Any, ...]]) -> pa.Table:
    import pyarrow as pa

    schema, columns = TABLES[name].schema, zip(*rows, strict=True)
    return pa.table([_array(values, field.type) for values, field in zip(columns, schema, strict=True)], schema=schema)


def _array(values: Iterable[Any], kind: pa.DataType) -> pa.Array:
    """Return values as an Arrow array; numbers that are not finite or too large, which SQL can hardly use, become null."""
    import pyarrow as pa

    if pa.types.is_floating(kind):
        numbers = np.array([*values], np.float64)
        return pa.array(numbers, kind, mask=~np.isfinite(numbers))
    if pa.types.is_string(kind):
        values = [value if value is None or value.isascii() else _unicode(value) for value in values]
    if pa.types.is_integer(kind):
        values = [value if value is None or abs(value) < 1 << 63 else None for value in values]
    if pa.types.is_map(kind):
        values = [None if value is None else list(value.items()) for value in values]
    if pa.types.is_struct(kind):
        values = [value and astuple(value) for value in values]
    return pa.array(values, kind)


def _absolute(source: SourceFile) -> SourceFile:
    """Return a recording with its absolute path, or its URL."""
    location = source.location
    if "://" in location:
        return source
    return replace(source, location=os.path.abspath(location))  # noqa: PTH100 - which leaves links as they are


def _unicode(text: str) -> str:
    """Return a text without what is not Unicode, as in names of files."""
    return text.encode("utf-8", "backslashreplace").decode()


def _time(seconds: float | None) -> datetime | None:
    """Return a time since 1970 in UTC, to the microsecond."""
    try:
        return None if seconds is None else _EPOCH + timedelta(microseconds=int(seconds * 1e6))
    except (OverflowError, ValueError):
        return None
