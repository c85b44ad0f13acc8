"""The formats that recordings are exported to: a row each, which the command line, `export` and the documentation use."""

from __future__ import annotations

import inspect
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypedDict, Unpack, cast

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.formats.sources import split_time

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from carla_recap.files.datasets import DatasetWriter
    from carla_recap.formats.base import Reader
    from carla_recap.model.lives import ActorName
    from carla_recap.queries.incidents import IncidentOptions
    from carla_recap.queries.verdicts import Verdict
    from carla_recap.recording import Recording
    from carla_recap.rendering.camera import Quality
    from carla_recap.replay import Played
    from carla_recap.replay.follow import Follow
    from carla_recap.sensors.rig import SensorRig
    from carla_recap.show.rerun.blueprint import View

    Progress = Callable[[Iterable[Any], Any], Iterable[Any]]


class ExportFormat(NamedTuple):
    """A format.

    Its function takes a recording, a destination, `force`, `progress` and options of its own, and returns the number of
    scenes and seconds, or the files that it has written into a folder.
    """

    name: str  # the value of `--to`
    suffix: str  # the suffix of its files, which alone means the first format that has it; empty for folders
    text: str  # what is written, in words
    function: str  # that writes it, as `module:name`
    extra: str = ""  # the extra that it needs; empty for none
    hints: str = ""  # a function that returns lines about how to use what was written, of the destination and the options
    dataset: str = ""  # the class of a dataset, whose function writes the part of a recording into a folder

    @property
    def options(self) -> set[str]:
        """The names of its options; `road_map` if it has roads."""
        if self.dataset:
            return self.dataset_class.options()
        parameters = inspect.signature(_load(self.function)).parameters.items()
        names = {name for name, each in parameters if each.kind is each.KEYWORD_ONLY}
        return {"road_map" if name == "opendrive" else name for name in names} - {"force", "progress"}

    @property
    def dataset_class(self) -> type[DatasetWriter]:
        """The class of the dataset."""
        return cast("type[DatasetWriter]", _load(self.dataset))


FORMATS: Final[Mapping[str, ExportFormat]] = {
    row.name: row
    for row in (
        ExportFormat("rerun", ".rrd", "what Rerun's viewer shows", "show.rerun.export:export_rerun", "rerun"),
        ExportFormat(
            *("foxglove", ".mcap", "what Foxglove and Lichtblick show", "show.foxglove:export_foxglove", "foxglove"),
            hints="show.foxglove:layout_hints",
        ),
        ExportFormat("parquet", "", "a table for each record type as Parquet", "files.parquet:export_parquet", "arrow"),
        ExportFormat("osi", ".mcap", "a trace of ground truth as ASAM OSI", "files.osi:export_osi", "osi"),
        ExportFormat("rosbag2", "", "a bag of ROS 2, for RViz and others", "files.rosbag:export_rosbag", "ros"),
        ExportFormat("csv", ".csv", "a row for each vehicle and walker in each frame", "files.tracks:export_csv"),
        ExportFormat(
            "xosc",
            ".xosc",
            "the trajectories of vehicles and walkers as OpenSCENARIO",
            "files.openscenario:export_openscenario",
            hints="files.openscenario:map_hint",
        ),
        *(
            ExportFormat(name, "", f"a dataset: {text}", "files.datasets:write_part", "cameras", dataset=dataset)
            for name, text, dataset in (
                ("kitti", "images, points and labels as KITTI has them", "files.kitti:KittiWriter"),
                ("coco", "images with boxes and masks as COCO has them", "files.coco:CocoWriter"),
                ("nuscenes", "images, points and boxes as nuScenes has them", "files.nuscenes:NuScenesWriter"),
            )
        ),
    )
}
"""All formats."""


class Exported(NamedTuple):
    """What was written.

    Attributes:
        frames: The number of frames, or of scenes.
        seconds: The seconds that they span.
        files: The files in a folder; None if a file was written.
        hints: Lines about how to use it.
    """

    frames: int
    seconds: float
    files: tuple[Path, ...] | None = None
    hints: tuple[str, ...] = ()


def find_format(destination: Path | str, to: str | None = None, *, is_folder: bool = False) -> ExportFormat:
    """Return the format of an export by its name, or by the suffix of the destination, unless that is a folder of several.

    A `RecapError` says that there is no such format, or that the destination has another suffix.
    """
    if to is not None and to not in FORMATS:
        raise RecapError(f"expected a format of exports, one of {', '.join(FORMATS)}, found {to!r}")
    given = Path(destination).suffix.lower()
    found = next((each for each in FORMATS.values() if each.suffix == given != ""), None) if to is None else FORMATS[to]
    if found is None:
        *suffixes, last = dict.fromkeys(each.suffix for each in FORMATS.values() if each.suffix)
        folders = ", ".join(each.name for each in FORMATS.values() if not each.suffix)
        expected = f"{', '.join(suffixes)} or {last}; --to (in Python, to=) names what is a folder: {folders}"
        raise RecapError(f"{str(destination)!r} does not end in {expected}")
    if to is not None and not is_folder and found.suffix not in ("", given):
        raise RecapError(f"{str(destination)!r} does not end in {found.suffix}")
    return found


class ExportKeywords(TypedDict, total=False):
    """The options of all formats but the map of the town; which go with a format, its function says."""

    start: float
    duration: float
    follow: Follow | None
    view: View
    incidents: IncidentOptions | None
    verdicts: Sequence[Verdict]
    cameras: Path | str | None
    ghost: Recording | Reader | None
    rig: SensorRig | Path | str | None
    actor: ActorName
    camera: str | None
    rate: float | None
    quality: Quality


def export(
    recording: Recording,
    destination: Path | str,
    *,
    to: str | None = None,
    road_map: Path | str | None = None,
    force: bool = False,
    progress: Progress | None = None,
    **options: Unpack[ExportKeywords],
) -> Exported:
    """Write a recording in another format: for Rerun, Foxglove and other programs, or as a dataset.

    Args:
        recording: The recording.
        destination: The file or folder; it appears when it is complete.
        to: The name of the format, as the command `export` has it; None: the suffix of the destination says it.
        road_map: The map of the town, an OpenDRIVE file or a folder of them; None: it is looked for in the usual folders.
        force: Replace what is there.
        progress: Gets what is gone through, and yields it; see the function of the format.
        options: Those of the function of the format, among them `start`, the elapsed seconds to begin at, negative: before
            the end; `duration` in seconds, 0: all of the rest; `follow`, the followed actor: an id or "hero", None: see
            `carla_recap.replay.choose_followed`; `incidents`, which ones are shown, None: all kinds, those against the rules
            of the road if the map is known; `verdicts`, what `check` returns: a lane of states for each.

    Raises:
        MissingExtra: The extra of the format is not installed.
        RecapError: There is no such format, time or actor, an option does not go with it, or nothing can be written.
        FormatError: The recording is damaged.
    """
    form = find_format(destination, to)
    about: dict[str, Any] = {"road_map": road_map, "progress": progress, **options}
    if form.dataset:
        from carla_recap.files.datasets import DatasetPart, dataset_folder
        from carla_recap.util.files import files_below

        with dataset_folder(destination, force=force) as (folder, part):
            name = Path(split_time(recording.location)[0]).stem
            written = write_part(recording, part, to=form.name, name=name, **about)
            form.dataset_class.combine([DatasetPart(name, part)], folder)
            files = [path.relative_to(folder) for path in files_below(folder) if part not in path.parents]
        return Exported(written.frames, written.seconds, tuple(Path(destination) / path for path in files))
    written, given = _write(form, recording, destination, {"force": force}, **about)
    hints = tuple(_load(form.hints)(destination, **given)) if form.hints else ()
    if isinstance(written, list):
        return Exported(recording.info.frames, recording.info.duration, tuple(written), hints)
    return Exported(written.frames, written.seconds, None, hints)


def write_part(recording: Recording, folder: Path, *, to: str, name: str, **options: Any) -> Played:
    """Write the part of a dataset that is of a recording, which has a name there, into an empty folder; see `export`."""
    written: Played = _write(FORMATS[to], recording, folder, {"name": name}, **options)[0]
    return written


def _write(
    form: ExportFormat,
    recording: Recording,
    destination: Path | str,
    fixed: Mapping[str, Any],
    *,
    road_map: Path | str | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> tuple[Any, dict[str, Any]]:
    """Return what the function of a format returns, and the options that it got."""
    write, accepted = _load(form.function), form.options
    for name in sorted({*options, *(["road_map"] if road_map is not None else [])} - accepted):
        raise RecapError(f"{name} does not go with an export to {form.name}")
    if form.dataset:
        write, options = partial(write, form.dataset_class), options | {"road_map": road_map}
    elif "road_map" in accepted:
        options |= _map_for(write, recording, road_map, options)
    try:
        return write(recording, destination, progress=progress, **fixed, **options), options
    except MissingExtra as error:
        raise MissingExtra(f"an export to {form.name}", form.extra or error.extra) from None


def _map_for(
    write: Callable[..., Any], recording: Recording, path: Path | str | None, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the map of the town as an argument of a function: its roads, or its file."""
    from carla_recap.queries.roads import find_map_of
    from carla_recap.replay.recorded_map import load_map_of
    from carla_recap.roads import load_map

    if "opendrive" in inspect.signature(write).parameters:
        return {"opendrive": find_map_of(recording.reader, path)}
    start, duration = options.get("start", 0.0), options.get("duration", 0.0)
    return {"road_map": load_map_of(recording, path, load_map, lambda corridors: corridors, start, duration)}


def _load(name: str) -> Callable[..., Any]:
    module, _, function = name.partition(":")
    found: Callable[..., Any] = getattr(import_module(f"carla_recap.{module}"), function)
    return found
