"""Datasets of many recordings: each is sensed in a worker process, and what they have written is put together."""

from __future__ import annotations

import math
from contextlib import closing
from functools import partial
from hashlib import sha256
from pathlib import Path
from shutil import rmtree
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from carla_recap.errors import RecapError
from carla_recap.exports import FORMATS, write_part
from carla_recap.files.datasets import SPLITS, TRAIN, DatasetPart, dataset_folder
from carla_recap.fleet.destinations import DestinationFolder, write_files
from carla_recap.fleet.engine import processors
from carla_recap.fleet.outcomes import WrittenFile
from carla_recap.fleet.sources import find_sources
from carla_recap.sensors.options import SensingOptions
from carla_recap.sensors.rig import as_rig

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Mapping
    from typing import Unpack

    from distributed import Client

    from carla_recap.exports import ExportFormat
    from carla_recap.fleet.engine import Processes
    from carla_recap.fleet.outcomes import Outcome
    from carla_recap.fleet.sources import SourceFile, Sources
    from carla_recap.sensors.options import SensingKeywords
    from carla_recap.sensors.rig import SensorRig

    WritePart = Callable[[str, Path, str], WrittenFile]
    """A function that writes the part of a recording: it gets the source, an empty folder and the recording's name."""

_SUFFIX: Final = ".part"  # of the folder of a part
_EXACT: Final = 1e-6  # by which the sum of shares may differ from 1


class ExportedDataset(NamedTuple):
    """What was written of many recordings.

    Attributes:
        frames: The number of labelled moments.
        seconds: The seconds that they span, summed over the recordings.
        recordings: The recordings that the dataset has, as they are named.
        failed: The errors of those that it does not have, by recording.
    """

    frames: int
    seconds: float
    recordings: tuple[str, ...]
    failed: Mapping[str, str]


def export_dataset(
    sources: Sources,
    folder: Path | str,
    *,
    to: str,
    rig: SensorRig | Path | str,
    camera: str | None = None,
    split: Mapping[str, float] | None = None,
    force: bool = False,
    jobs: int | None = None,
    client: Client | None = None,
    **options: Unpack[SensingKeywords],
) -> ExportedDataset:
    """Write one dataset of many recordings, as `carla-recap export` does; those that fail are left out.

    A script calls this function below `if __name__ == "__main__":`, since worker processes import it.

    Args:
        sources: Files, folders, globs and URLs of recordings, or one of them.
        folder: The folder of the dataset; it appears when it is complete.
        to: The format: kitti, coco or nuscenes.
        rig: The sensors, or their file.
        camera: The id of the camera of KITTI; None: the first one of the rig.
        split: The shares of train, val and test, which add up to 1; None: all recordings are in train.
        force: Write into a folder that is not empty, over files of the same names.
        jobs: The number of worker processes; None: as many as there are processors.
        client: Dask's client, whose cluster is used instead. Its workers have to see the recordings and the folder.
        options: The fields of `SensingOptions`, such as `rate` and `quality`.

    Raises:
        RecapError: There is no such format, rig or camera, the folder cannot be written, or no recording could be sensed.
        MissingExtra: An optional dependency is not installed.
    """
    datasets = [name for name, each in FORMATS.items() if each.dataset]
    if to not in datasets:
        raise RecapError(f"{to!r} is no format of datasets; one of {', '.join(datasets)} was expected")
    given: dict[str, Any] = {"rig": as_rig(rig), **({} if camera is None else {"camera": camera}), **options}
    FORMATS[to].dataset_class.sensors_of(given["rig"], camera)
    SensingOptions(**options)
    write = partial(_export_part, to, given)
    found = find_sources(sources, errors="yield")
    frames, seconds, written, failed = 0, 0.0, [], {}
    with closing(
        write_dataset(write, found, folder, FORMATS[to], split=split, force=force, jobs=jobs, client=client)
    ) as outcomes:
        for outcome in outcomes:
            if outcome.value is None:
                failed[outcome.source.location] = str(outcome.error)
            else:
                frames += outcome.value.frames or 0
                seconds += outcome.value.seconds or 0.0
                written.append(outcome.source.location)
    return ExportedDataset(frames, seconds, tuple(written), failed)


def _export_part(to: str, options: Mapping[str, Any], source: str, folder: Path, name: str) -> WrittenFile:
    from carla_recap.recording import open_recording

    with open_recording(source) as recording:
        done = write_part(recording, folder, to=to, name=name, **options)
    return WrittenFile(frames=done.frames, seconds=done.seconds)


def write_dataset(
    write: WritePart,
    sources: Iterable[SourceFile],
    folder: Path | str,
    form: ExportFormat,
    *,
    split: Mapping[str, float] | None = None,
    force: bool = False,
    **processes: Unpack[Processes],
) -> Generator[Outcome[WrittenFile]]:
    """Yield what is written of each of many recordings, or the error, in their order; behind them, the dataset appears.

    Without a split, all recordings are in `train`.
    """
    found = list(sources)
    with dataset_folder(folder, force=force) as (whole, below):
        place = DestinationFolder(str(below), _SUFFIX)
        names = {place.file_of(source): _name_in(place, source) for source in found if source.error is None}
        splits = splits_of(names.values(), split or {TRAIN: 1.0})
        parts = []
        writing = partial(_write_part, write, below)
        processes["jobs"] = processes.get("jobs") or (processors() if len(found) > 1 else 1)
        with closing(write_files(writing, found, place, **processes)) as outcomes:
            for outcome in outcomes:
                if outcome.value is not None:
                    path = place.file_of(outcome.source)
                    parts.append(DatasetPart(names[path], Path(path), splits[names[path]]))
                yield outcome
        if not parts:
            raise RecapError(f"{folder}: is not written, since no recording could be")
        form.dataset_class.combine(parts, whole)


def splits_of(names: Iterable[str], shares: Mapping[str, float]) -> dict[str, str]:
    """Return the split of each recording, which depends on the names alone."""
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
