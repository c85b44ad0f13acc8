"""The commands that export: files for viewers, clips, pictures, data of sensors, the incident page; the viewer itself."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click
from click.core import ParameterSource

from carla_recap.cli import opening, options
from carla_recap.cli.check import loaded_rules
from carla_recap.cli.options import PORT, POSITIVE, SIZE, TIME, argument, command, flag, option
from carla_recap.cli.output import counted, json_of_written, note, wrote
from carla_recap.cli.progress import watch
from carla_recap.cli.writing import WriteRequest, writes
from carla_recap.errors import MissingExtra
from carla_recap.exports import FORMATS, find_format, write_part
from carla_recap.exports import export as write_export
from carla_recap.fleet.outcomes import WrittenFile
from carla_recap.util.text import number

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.exports import ExportFormat
    from carla_recap.queries.incidents import IncidentOptions
    from carla_recap.rules.rule_sets import RuleSet
    from carla_recap.show.clips import IncidentClip
    from carla_recap.show.rerun.blueprint import View

_MODULES = {
    "foxglove": ("foxglove_schemas_protobuf",),
    "cameras": ("moderngl", "embreex", "simplejpeg", "PIL"),
    "video": ("av",),
}
"""The modules of the extras that sensing needs."""
_OF_DATASETS = ("split",)  # options of all datasets that are not those of a part
_window = options.together(options.follow, options.start, options.duration, options.road_map)


_LIST = "\n".join(f"    {form.name:9} {form.suffix or 'folder':7} {form.text}" for form in FORMATS.values())


@command(
    writes,
    option("--to", "--format", "to", type=click.Choice(list(FORMATS)), help="The format; else the suffix of DST says it."),
    _window,
    options.camera,
    options.shown_kinds,
    options.path("--rules", help="Show the verdicts of these rules, too; see check."),
    options.models,
    options.path("--cameras", metavar="DIR", help="Write a small .rbl for each actor, to follow it (Rerun)."),
    options.rig("Sensors, as JSON: of a dataset, or of rosbag2 besides."),
    options.sensing,
    options.dataset,
    help=f"""Write recordings for viewers, or as tables or traces for other programs.

    \b
{_LIST}

    SRC#t=12.1 means from 5 s before that moment to 5 s after it. Many recordings go to a folder; of a dataset, together.
    """,
)
def export(
    request: WriteRequest,
    to: str | None,
    kinds: frozenset[str] | Literal["all"],
    split: dict[str, float] | None,
    rules: str | None,
    **shown: Any,
) -> None:
    """Write recordings in other formats."""
    shown["incidents"], shown["verdicts"] = options.shown_incidents(kinds), ()
    is_many = request.has_many or (request.is_into_folder and (to is None or bool(FORMATS[to].suffix)))
    if to is None and is_many:
        raise click.UsageError("--to says what is written to a folder.")
    form = find_format(request.destination, to, is_folder=is_many)
    for param in click.get_current_context().command.params:
        name = {"kinds": "incidents", "rules": "verdicts"}.get(str(param.name), param.name)
        is_known = name in form.options or (form.dataset and name in _OF_DATASETS)
        if _is_given(str(param.name)) and (name in shown or name in _OF_DATASETS) and not is_known:
            raise click.UsageError(f"{param.opts[0]} does not go with --to {form.name}.")
    if form.dataset:
        _export_dataset(request, form, split, shown)
        return
    write = partial(_export, form.name, shown, None if rules is None else loaded_rules(rules))
    if not is_many:
        request.write_one(write)
    elif shown["cameras"]:
        raise click.UsageError("--cameras goes with one recording.")
    else:
        request.write_many(write, form.suffix, "exporting")


def _export_dataset(
    request: WriteRequest, form: ExportFormat, split: dict[str, float] | None, shown: dict[str, Any]
) -> None:
    if request.newer:
        raise click.UsageError(f"--newer does not go with --to {form.name}, which is one folder.")
    if shown["rig"] is None:
        raise click.UsageError(f"--to {form.name} needs --rig RIG.json.")
    form.dataset_class.sensors_of(shown["rig"], shown["camera"])
    request.write_dataset(partial(_export_part, form.name, shown), form, split)


def _export_part(to: str, shown: dict[str, Any], source: str, folder: Path, name: str) -> WrittenFile:
    with opening.opened_part(source, shown) as (recording, part):
        given = {key: value for key, value in part.items() if key in FORMATS[to].options and value is not None}
        done = write_part(recording, folder, to=to, name=name, progress=watch("sensing"), **given)
    return WrittenFile(frames=done.frames, seconds=done.seconds)


def _export(
    name: str, shown: dict[str, Any], rules: RuleSet | None, source: str, destination: str, force: bool
) -> WrittenFile:
    from carla_recap.recording import open_recording

    accepted = FORMATS[name].options
    if FORMATS[name].extra in ("rerun", "arrow"):
        from carla_recap.tables.arrow import spare_pandas

        spare_pandas()
    if "start" in accepted:
        source, shown = opening.timed(source, shown)
    given = {key: value for key, value in shown.items() if key in accepted}
    with open_recording(source) as recording:
        if rules is not None:
            from carla_recap.rules.rule_sets import check

            given["verdicts"] = check(recording, rules, road_map=shown["road_map"])
        done = write_export(recording, destination, to=name, progress=watch("exporting"), force=force, **given)
    if done.files is None:
        return WrittenFile(frames=done.frames, seconds=done.seconds, hints=done.hints)
    count = len(done.files)
    return WrittenFile((counted(count, "file"),), done.frames, done.seconds, facts={"files": count}, hints=done.hints)


@command(
    options.source,
    argument("folder", "DIR"),
    options.force,
    options.kinds,
    options.before,
    options.after,
    option("--to", "--format", "suffix", type=click.Choice(["mcap", "log"]), default="mcap", help="Of the clips."),
    option(
        "--rrd/--no-rrd", "rerun", default=None, help="Write an .rrd beside each clip; by default if Rerun is installed."
    ),
    flag("--video", help="Write a video beside each clip."),
    options.models,
    options.incident_options,
    option("--limit", type=click.IntRange(min=1), default=100, metavar="N", help="The largest number of clips."),
    options.written,
)
def clips(
    source: str,
    folder: str,
    wanted: IncidentOptions,
    suffix: str,
    rerun: bool | None,
    **how: Any,
) -> None:
    """Cut a clip of each incident, into a folder."""
    from carla_recap.recording import open_recording
    from carla_recap.show.clips import clips as run

    with open_recording(source) as recording:
        roads = opening.road_map_of(recording, wanted.road_map) if rerun is not False else None
        town = partial(opening.town_of, recording, wanted.road_map)
        written = run(
            source,
            folder,
            wanted,
            suffix=f".{suffix}",
            rerun=rerun,
            road_map=roads,
            town=town,
            progress=watch("cutting"),
            **how,
        )
    for each in written:
        wrote(each.recording, each.incident.text, **_facts(each))
    if not written:
        note(f"{folder}: no incidents, no clips")


def _facts(clip: IncidentClip) -> dict[str, Any]:
    """Return an incident and the files beside its clip, for JSON."""
    others = {name: path and str(path) for name, path in (("rrd", clip.rrd), ("video", clip.video))}
    return {"kind": clip.incident.kind, "incident": clip.incident.text, "start": clip.incident.start, **others}


@command(
    options.source,
    _window,
    options.camera,
    options.models,
    flag("--web", help="Serve the viewer to a browser on this machine."),
    option("--web-port", type=PORT, metavar="N", help="The same at this port; --web alone takes any free one."),
    options.foxglove,
)
def view(
    source: str,
    road_map: str | None,
    view: View,
    web: bool,
    web_port: int | None,
    foxglove_port: int | None,
    **shown: Any,
) -> None:
    """Open a recording in Rerun's viewer, or let Foxglove play it.

    SRC#t=12.1 means from 5 s before that moment to 5 s after it.
    """
    for name in ("view", "web", "web_port"):
        if foxglove_port is not None and _is_given(name):
            raise click.UsageError(f"--{name.replace('_', '-')} goes with Rerun's viewer.")
    with opening.opened_part(source, shown) as (recording, part):
        roads = opening.road_map_of(recording, road_map, part["start"], part["duration"])
        if foxglove_port is None:
            from carla_recap.show.rerun.viewer import view as open_viewer
            from carla_recap.tables.arrow import spare_pandas

            spare_pandas()
            how: dict[str, Any] = {"view": view, "web": web or web_port is not None, "web_port": web_port or 0, **part}
            open_viewer(recording, road_map=roads, progress=watch("exporting"), ready=_announce, **how)
        else:
            from carla_recap.show.foxglove import connection_hints
            from carla_recap.show.foxglove.websocket import serve_recording

            ready = partial(_announce, hints=connection_hints(recording.location))
            serve_recording(recording, road_map=roads, progress=watch("searching"), port=foxglove_port, ready=ready, **part)


@command(
    options.source,
    options.destination,
    option("--at", type=TIME, metavar="S", help="The moment, in s; negative: before the end. Or as SRC#t=S."),
    options.follow,
    options.any_view,
    options.road_map,
    option("--size", type=SIZE, metavar="WxH", help="In pixels; 1280x720, or of a recorded camera its own."),
    options.overlay,
    options.shown_kinds,
    options.models,
    options.force,
    options.written,
)
def snapshot(
    source: str,
    destination: str,
    at: float | None,
    road_map: str | None,
    kinds: frozenset[str] | Literal["all"],
    **shown: Any,
) -> None:
    """Take a picture of a moment, without GPU or display."""
    from carla_recap.recording import open_recording
    from carla_recap.show.video import snapshot as run

    source, time = opening.moment(source, at)
    with open_recording(source) as recording:
        time = opening.printed(recording.reader, time)
        town = partial(opening.town_of, recording, road_map, time, opening.MOMENT)
        run(recording, destination, at=time, town=town, incidents=options.shown_incidents(kinds, road_map), **shown)
    wrote(destination, f"a picture at {number(time)} s", time=time)


@command(
    writes,
    options.format_of_files(["mp4", "gif"]),
    options.any_view,
    option(
        "--camera",
        "cameras",
        multiple=True,
        metavar="ID",
        help="Film by a camera of the recording or of --rig.",
    ),
    flag("--grid", help="Film by all cameras of the recording, or of --rig, side by side."),
    options.rig("Sensors on the hero, or --follow, as JSON."),
    _window,
    option(
        "--speed",
        type=POSITIVE,
        default=1,
        show_default=False,
        metavar="X",
        help="2: twice as fast as it happened; 0.25: in slow motion.",
    ),
    option("--size", type=SIZE, metavar="WxH", help="In pixels; 1280x720, of a GIF 640x360, of a camera its own."),
    option("--fps", "rate", type=POSITIVE, metavar="N", help="Frames per second; 30, of a GIF 12.5."),
    flag("--smooth", help="Draw smooth edges, which takes about twice as long."),
    options.overlay,
    options.shown_kinds,
    options.models,
)
def video(
    request: WriteRequest,
    suffix: str | None,
    kinds: frozenset[str] | Literal["all"],
    **shown: Any,
) -> None:
    """Write videos, .mp4 or .gif, without GPU or display.

    SRC#t=12.1 means from 5 s before that moment to 5 s after it. Many recordings go to a folder.
    """
    shown["incidents"] = options.shown_incidents(kinds, shown["road_map"])
    if shown.pop("grid"):
        if shown["cameras"]:
            raise click.UsageError("--grid shows all cameras; --camera chooses some. One of them was expected.")
        shown["cameras"] = "all"
    if shown["rig"] is not None and not shown["cameras"]:
        raise click.UsageError("--rig goes with --camera or --grid.")
    if shown["cameras"] and _is_given("view"):
        raise click.UsageError("--view goes without --camera and --grid.")
    request.write(partial(_video, shown), suffix, "mp4", "filming")


def _video(shown: dict[str, Any], source: str, destination: str, force: bool) -> WrittenFile:
    from carla_recap.show.video import export_video

    with opening.opened_part(source, shown) as (recording, part):
        town = partial(opening.town_of, recording, part["road_map"], part["start"], part["duration"])
        written = export_video(recording, destination, town=town, progress=watch("filming"), force=force, **part)
    width, height = written.size
    facts = {"width": width, "height": height}
    return WrittenFile((f"{width}x{height}",), written.frames, written.seconds, facts=facts)


@command(
    writes,
    options.rig("The sensors, as JSON.", is_required=True),
    options.start,
    options.duration,
    options.sensing,
    options.road_map,
    flag("--video", help="Write RGB images as H.264, which takes less room, instead of as JPEGs."),
    options.models,
)
def sense(request: WriteRequest, **given: Any) -> None:
    """Write recordings with what the sensors of a rig would have measured: .mcap files.

    DST is the recording, and has its scene and the data of the sensors for Foxglove, Lichtblick and Rerun; layouts for the
    first two are beside it. SRC#t=12.1 means from 5 s before that moment to 5 s after it. Many recordings go to a folder.
    """
    request.write(partial(_sense, given), None, "mcap", "sensing")


def _sense(given: dict[str, Any], source: str, destination: str, force: bool) -> WrittenFile:
    from carla_recap.sensors.ray_process import processes_for
    from carla_recap.util.child import started_ahead

    processes = processes_for(given["rig"])
    try:
        with started_ahead(*processes), opening.opened_part(source, given) as (recording, part):
            from carla_recap.show.foxglove.layouts import hints_of
            from carla_recap.show.foxglove.sensed import export_sensed

            done = export_sensed(recording, destination, force=force, progress=watch("sensing"), **part)
    except MissingExtra as error:
        asked = ["foxglove", *["cameras"] * bool(processes), *["video"] * given["video"]]
        missing = {extra for extra in asked if not all(map(find_spec, _MODULES[extra]))}
        raise MissingExtra(error.what, ",".join(sorted({error.extra, *missing}))) from None
    samples = sum(done.samples.values())
    notes = counted(len(done.samples), "sensor"), counted(samples, "sample")
    facts = {"samples": dict(done.samples), "layouts": [str(path) for path in done.layouts.values()]}
    return WrittenFile(notes, done.frames, done.seconds, facts=facts, hints=tuple(hints_of(done.layouts)))


@command(
    writes,
    options.shown_kinds,
    options.path("--compare", metavar="OTHER", help="A second recording to show beside it, or over it."),
    options.before,
    options.after,
    option(
        "--pictures",
        type=click.Choice(["drawn", "rendered", "none"]),
        default="drawn",
        help="Of incidents: drawn from above, or rendered from behind.",
    ),
    option(
        "--camera",
        metavar="ID",
        help="The camera whose recorded images are beside the map; by default, the one that looks ahead.",
    ),
    flag("--viewer", help="Add Rerun's viewer, in 3D, to a folder; it needs --serve or another server."),
    flag("--serve", help="Serve the folder to a browser on this machine, until Ctrl-C."),
    option("--port", type=PORT, metavar="N", help="The port to serve at; else any free one."),
    options.models,
    options.incident_options,
)
def report(
    request: WriteRequest,
    compare: str | None,
    wanted: IncidentOptions,
    viewer: bool,
    serve: bool,
    port: int | None,
    **shown: Any,
) -> None:
    """Write the incident page, for any browser.

    It lists what went wrong, with a replay from above. DST is a single file, if its name ends in .html, or else a folder.
    With --compare, the page shows two recordings, side by side or one over the other. Many recordings go to a folder, a
    single file each. --before and --after are for a recording that is too long to be replayed as a whole.
    """
    from carla_recap.show.page import serve as serve_page
    from carla_recap.show.page.report import SINGLE

    single = Path(request.destination).suffix.lower() in SINGLE
    if port is not None and not serve:
        raise click.UsageError("--port goes with --serve.")
    if serve and json_of_written() is not None:
        raise click.UsageError("--json goes with a page that is written; --serve prints its address.")
    for name, given in (("--serve", serve), ("--viewer", viewer)):
        if single and given:
            raise click.UsageError(f"{name} goes with a folder; {request.destination} is a single file.")
    for name, given in (("--serve", serve), ("--viewer", viewer), ("--compare", compare is not None)):
        if request.has_many and given:
            raise click.UsageError(f"{name} goes with one recording.")
    if viewer and compare:
        raise click.UsageError("--viewer goes with one recording.")
    write = partial(_report, compare, wanted, viewer, shown)
    if request.has_many:
        request.write_many(write, ".html", "sampling")
        return
    request.write_one(write)
    if serve:
        serve_page(request.destination, port or 0, ready=_announce)


def _report(
    compare: str | None,
    wanted: IncidentOptions,
    viewer: bool,
    shown: dict[str, Any],
    source: str,
    destination: str,
    force: bool,
) -> WrittenFile:
    from carla_recap.recording import open_recording
    from carla_recap.show.page import write_report

    with ExitStack() as stack:
        recording, *others = (stack.enter_context(open_recording(each)) for each in (source, compare) if each)
        written = write_report(
            recording,
            destination,
            wanted,
            other=others[0] if others else None,
            road_map=opening.road_map_of(recording, wanted.road_map) if viewer else None,
            viewer=viewer,
            progress=watch("sampling"),
            force=force,
            **shown,
        )
    notes, facts = [counted(written.incidents, "incident")], {"incidents": written.incidents, "images": written.images}
    if written.images:
        notes.append(counted(written.images, "image"))
    path = "index.html" if Path(destination).is_dir() else ""
    return WrittenFile(tuple(notes), size=written.size, facts=facts, path=path)


def _is_given(name: str) -> bool:
    """Return whether a parameter of the command is given."""
    return click.get_current_context().get_parameter_source(name) is ParameterSource.COMMANDLINE


def _announce(address: str, hints: Iterable[str] = ()) -> None:
    """Print the address of a server, on stdout for programs, and how to use it."""
    click.echo(address)
    sys.stdout.flush()
    for hint in hints:
        note(hint)
    note("Ctrl-C ends it")
