"""Datasets of many recordings: each is sensed in a worker process, and what they have written is put together."""

from __future__ import annotations

import math
from contextlib import closing
from functools import partial
from hashlib import sha256
from pathlib import Path
from shutil import rmtree
from typing import TYPE_CHECKING, Final

from carla_recap.errors import RecapError
from carla_recap.exports import combine_parts
from carla_recap.files.datasets import SPLITS, TRAIN, DatasetPart, dataset_folder
from carla_recap.fleet.destinations import DestinationFolder, write_files
from carla_recap.fleet.engine import processors

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Mapping

    from distributed import Client

    from carla_recap.exports import ExportFormat
    from carla_recap.fleet.outcomes import Outcome, WrittenFile
    from carla_recap.fleet.sources import SourceFile

    WritePart = Callable[[str, Path, str], WrittenFile]
    """A function that writes the part of a recording: it gets the source, an empty folder and the recording's name."""

_SUFFIX: Final = ".part"  # of the folder of a part
_EXACT: Final = 1e-6  # by which the sum of shares may differ from 1


def write_dataset(
    write: WritePart,
    sources: Iterable[SourceFile],
    folder: Path | str,
    form: ExportFormat,
    *,
    split: Mapping[str, float] | None = None,
    force: bool = False,
    jobs: int | None = None,
    client: Client | None = None,
) -> Generator[Outcome[WrittenFile]]:
    """Yield what is written of each of many recordings, or the error, in their order; behind them, the dataset appears.

    Args:
        write: The function that writes a part: that of a module, or a partial of one.
        sources: The recordings.
        folder: The folder of the dataset.
        form: The format.
        split: The shares of the splits; None: all recordings are in `train`.
        force: Write into a folder that is not empty, over files of the same names.
        jobs: The number of worker processes; None: as many as there are processors, or none for one recording.
        client: See `map_sources`.

    Raises:
        RecapError: The folder cannot be written, or no recording could be; see `splits_of`, too.
    """
    found = list(sources)
    with dataset_folder(folder, force=force) as (whole, below):
        place = DestinationFolder(str(below), _SUFFIX)
        names = {place.file_of(source): _name_in(place, source) for source in found if source.error is None}
        splits = splits_of(names.values(), split or {TRAIN: 1.0})
        parts = []
        writing = partial(_write_part, write, below)
        jobs = jobs or (processors() if len(found) > 1 else 1)
        with closing(write_files(writing, found, place, jobs=jobs, client=client)) as outcomes:
            for outcome in outcomes:
                if outcome.value is not None:
                    path = place.file_of(outcome.source)
                    parts.append(DatasetPart(names[path], Path(path), splits[names[path]]))
                yield outcome
        if not parts:
            raise RecapError(f"{folder}: is not written, since no recording could be")
        combine_parts(parts, whole, to=form.name)


def splits_of(names: Iterable[str], shares: Mapping[str, float]) -> dict[str, str]:
    """Return the split of each recording, which depends on the names alone.

    Args:
        names: The names of the recordings.
        shares: The share of each split, which add up to 1.

    Raises:
        RecapError: They do not, or a split is unknown.
    """
    for name, share in shares.items():
        if name not in SPLITS:
            raise RecapError(f"split {name!r}: is unknown; one of {', '.join(SPLITS)} was expected")
        if not 0 <= share <= 1:
            raise RecapError(f"split {name!r}: a share of {share:g}; one from 0 to 1 was expected")
    total = math.fsum(shares.values())
    if abs(total - 1) > _EXACT:
        raise RecapError(f"the shares of the splits add up to {total:g}; 1 was expected")
    mixed = sorted(set(names), key=lambda name: sha256(name.encode("utf-8", "surrogateescape")).digest())
    found: dict[str, str] = {}
    reached = 0.0
    for split, share in shares.items():
        reached += share
        while len(found) < round(reached * len(mixed)):
            found[mixed[len(found)]] = split
    return found


def _name_in(place: DestinationFolder, source: SourceFile) -> str:
    return Path(place.file_of(source)).relative_to(place.location).as_posix().removesuffix(_SUFFIX)


def _write_part(write: WritePart, below: Path, source: str, destination: str, force: bool) -> WrittenFile:
    """Write a part; what a process has left of it that ended is removed."""
    folder = Path(destination)
    rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return write(source, folder, folder.relative_to(below).as_posix().removesuffix(_SUFFIX))
