"""The commands that export: files for viewers, clips, pictures, the incident page; and the viewer itself."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import click
from click.core import ParameterSource

from carla_recap.cli import options
from carla_recap.cli.output import counted, note, wants_json, wrote
from carla_recap.cli.writing import WriteRequest, writes
from carla_recap.fleet.outcomes import WrittenFile
from carla_recap.util.text import number

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from carla_recap.queries.incidents import IncidentOptions
    from carla_recap.replay.follow import Follow
    from carla_recap.show.clips import IncidentClip
    from carla_recap.show.rerun.blueprint import View
    from carla_recap.show.video.cameras import VideoView

_window = options.together(options.follow, options.start, options.duration, options.road_map)


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """What is exported, and how: what the options of the command say, or None."""

    follow: Follow | None
    start: float | None
    duration: float | None
    road_map: str | None
    view: View
    cameras: str | None


class ExportFormat(NamedTuple):
    """What an export is to.

    Attributes:
        suffix: The suffix of its files; empty for folders.
        write: The function that writes one.
        options: The options that go with it.
        is_default: Whether the suffix alone means it.
    """

    suffix: str
    write: Callable[[ExportOptions, str, str, bool], WrittenFile]
    options: Collection[str]
    is_default: bool = True


@click.command()
@writes
@click.option(
    "--to",
    type=click.Choice(["rerun", "foxglove", "parquet", "osi", "csv", "xosc"]),
    help="What to write; else the suffix of DST says: .rrd for Rerun, .mcap for Foxglove, .csv, .xosc.",
)
@_window
@options.camera
@click.option("--cameras", type=click.Path(), metavar="DIR", help="Write a small .rbl for each actor, to follow it (Rerun).")
def export(request: WriteRequest, to: str | None, **shown: Any) -> None:
    """Write recordings for Rerun (.rrd) or Foxglove (.mcap), or as tables or traces for other programs.

    With --to parquet, a recording becomes a folder: a file for each record type, and actors, collisions and incidents. --to
    osi writes ASAM OSI's ground truth (.mcap); --to csv the tracks of vehicles and walkers; --to xosc their trajectories as
    OpenSCENARIO. SRC#t=12.1 means from 5 s before that moment to 5 s after it. Many recordings go to a folder.
    """
    context, given = click.get_current_context(), Path(request.destination).suffix.lower()
    is_many = request.has_many or (to != "parquet" and request.is_into_folder)
    if to is None and is_many:
        raise click.UsageError("--to says what is written to a folder.", context)
    name = to or next((name for name, each in _FORMATS.items() if each.is_default and each.suffix == given), "")
    if name not in _FORMATS or not (is_many or _FORMATS[name].suffix in ("", given)):
        expected = _FORMATS[name].suffix if name else ".rrd or .mcap; tables are written to a folder with --to parquet"
        raise click.BadParameter(f"{request.destination!r} does not end in {expected}.", param_hint="DST")
    form = _FORMATS[name]
    for param in context.command.params:
        is_given = context.get_parameter_source(str(param.name)) is ParameterSource.COMMANDLINE
        if is_given and param.name in shown and param.name not in form.options:
            raise click.UsageError(f"{param.opts[0]} does not go with --to {name}.", context)
    write = partial(form.write, ExportOptions(**shown))
    if not is_many:
        request.write_one(write)
    elif shown["cameras"]:
        raise click.UsageError("--cameras goes with one recording.", context)
    else:
        request.write_many(write, form.suffix, "exporting")


def _rerun(shown: ExportOptions, source: str, destination: str, force: bool) -> WrittenFile:
    from carla_recap.cli.progress import watch_scenes
    from carla_recap.recording import open_recording
    from carla_recap.show.rerun import export_rerun

    source, start, duration = options.timed(source, shown.start, shown.duration)
    with open_recording(source) as recording:
        played = export_rerun(
            recording,
            destination,
            follow=shown.follow,
            start=start,
            duration=duration,
            road_map=options.road_map_of(recording, shown.road_map, start, duration),
            view=shown.view,
            cameras=shown.cameras,
            progress=watch_scenes("exporting"),
            force=force,
        )
    return WrittenFile(frames=played.frames, seconds=played.seconds)


def _foxglove(shown: ExportOptions, source: str, destination: str, force: bool) -> WrittenFile:
    from carla_recap.cli.progress import watch_scenes
    from carla_recap.recording import open_recording
    from carla_recap.show.foxglove import export_foxglove, layout_files

    source, start, duration = options.timed(source, shown.start, shown.duration)
    with open_recording(source) as recording:
        played = export_foxglove(
            recording,
            destination,
            follow=shown.follow,
            start=start,
            duration=duration,
            road_map=options.road_map_of(recording, shown.road_map, start, duration),
            progress=watch_scenes("exporting"),
            force=force,
        )
    hints = tuple(f"the layout for {viewer}: {path}" for viewer, path in layout_files().items())
    return WrittenFile(frames=played.frames, seconds=played.seconds, hints=hints)


def _parquet(_: ExportOptions, source: str, folder: str, force: bool) -> WrittenFile:
    from carla_recap.cli.progress import watch
    from carla_recap.files.parquet import export_parquet
    from carla_recap.recording import open_recording

    with open_recording(source) as recording:
        count = len(export_parquet(recording, folder, force=force, progress=watch("exporting")))
        about = recording.info
    return WrittenFile((counted(count, "file"),), about.frames, about.duration, facts={"files": count})


def _csv(shown: ExportOptions, source: str, destination: str, force: bool) -> WrittenFile:
    from carla_recap.cli.progress import watch_scenes
    from carla_recap.files.tracks import export_csv
    from carla_recap.recording import open_recording

    source, start, duration = options.timed(source, shown.start, shown.duration)
    with open_recording(source) as recording:
        watched = watch_scenes("exporting")
        played = export_csv(recording, destination, start=start, duration=duration, progress=watched, force=force)
    return WrittenFile(frames=played.frames, seconds=played.seconds)


def _osi(shown: ExportOptions, source: str, destination: str, force: bool) -> WrittenFile:
    from carla_recap.cli.progress import watch_scenes
    from carla_recap.files.osi import export_osi
    from carla_recap.recording import open_recording

    source, start, duration = options.timed(source, shown.start, shown.duration)
    with open_recording(source) as recording:
        played = export_osi(
            recording,
            destination,
            follow=shown.follow,
            opendrive=options.map_file_of(recording, shown.road_map),
            start=start,
            duration=duration,
            progress=watch_scenes("exporting"),
            force=force,
        )
    return WrittenFile(frames=played.frames, seconds=played.seconds)


def _xosc(shown: ExportOptions, source: str, destination: str, force: bool) -> WrittenFile:
    from carla_recap.cli.progress import watch_scenes
    from carla_recap.files.openscenario import export_openscenario
    from carla_recap.recording import open_recording

    source, start, duration = options.timed(source, shown.start, shown.duration)
    with open_recording(source) as recording:
        opendrive = options.map_file_of(recording, shown.road_map)
        played = export_openscenario(
            recording,
            destination,
            opendrive=opendrive,
            start=start,
            duration=duration,
            progress=watch_scenes("exporting"),
            force=force,
        )
    hints = () if opendrive is None else (f"the map that belongs beside it: {opendrive}",)
    return WrittenFile(frames=played.frames, seconds=played.seconds, hints=hints)


_SPAN: Final = ("start", "duration")
_FORMATS: Final = {
    "rerun": ExportFormat(".rrd", _rerun, ("follow", *_SPAN, "road_map", "view", "cameras")),
    "foxglove": ExportFormat(".mcap", _foxglove, ("follow", *_SPAN, "road_map", "view")),
    "parquet": ExportFormat("", _parquet, (), is_default=False),
    "osi": ExportFormat(".mcap", _osi, ("follow", *_SPAN, "road_map"), is_default=False),
    "csv": ExportFormat(".csv", _csv, _SPAN),
    "xosc": ExportFormat(".xosc", _xosc, (*_SPAN, "road_map")),
}
"""What an export can be to."""


@click.command()
@options.source
@options.folder
@options.force
@options.kinds
@options.before
@options.after
@click.option(
    "--format", "suffix", type=click.Choice(["mcap", "log"]), default="mcap", show_default=True, help="Of the clips."
)
@click.option("--rrd/--no-rrd", default=None, help="Write an .rrd beside each clip; by default if Rerun is installed.")
@click.option("--video", is_flag=True, help="Write a video beside each clip.")
@options.incident_options
@click.option(
    "--limit", type=click.IntRange(min=1), default=100, show_default=True, metavar="N", help="The largest number of clips."
)
@options.written
def clips(
    source: str,
    folder: str,
    wanted: IncidentOptions,
    suffix: str,
    rrd: bool | None,
    video: bool,
    before: float,
    after: float,
    limit: int,
    force: bool,
) -> None:
    """Cut a clip of each incident, into a folder."""
    from carla_recap.cli.progress import watch_incidents
    from carla_recap.recording import open_recording
    from carla_recap.show.clips import clips as run

    with open_recording(source) as recording:
        roads = options.road_map_of(recording, wanted.road_map) if rrd is not False else None
        town = partial(options.town_of, recording, wanted.road_map)
    written = run(
        source,
        folder,
        wanted,
        before=before,
        after=after,
        suffix=f".{suffix}",
        rerun=rrd,
        video=video,
        road_map=roads,
        town=town,
        limit=limit,
        progress=watch_incidents("cutting"),
        force=force,
    )
    for each in written:
        wrote(each.recording, each.incident.text, **_facts(each))
    if not written:
        note(f"{folder}: no incidents, no clips")


def _facts(clip: IncidentClip) -> dict[str, Any]:
    """Return an incident and the files beside its clip, for JSON."""
    others = {name: path and str(path) for name, path in (("rrd", clip.rrd), ("video", clip.video))}
    return {"kind": clip.incident.kind, "incident": clip.incident.text, "start": clip.incident.start, **others}


@click.command()
@options.source
@_window
@options.camera
@click.option("--web", is_flag=True, help="Serve the viewer to a browser on this machine.")
def view(
    source: str,
    follow: Follow | None,
    start: float | None,
    duration: float | None,
    road_map: str | None,
    view: View,
    web: bool,
) -> None:
    """Open a recording in Rerun's viewer.

    SRC#t=12.1 means from 5 s before that moment to 5 s after it.
    """
    from carla_recap.cli.progress import watch_scenes
    from carla_recap.recording import open_recording
    from carla_recap.show.viewer import view as run

    source, start, duration = options.timed(source, start, duration)
    with open_recording(source) as recording:
        run(
            recording,
            road_map=options.road_map_of(recording, road_map, start, duration),
            progress=watch_scenes("exporting"),
            ready=_announce,
            follow=follow,
            start=start,
            duration=duration,
            view=view,
            web=web,
        )


@click.command()
@options.source
@options.destination
@click.option("--at", type=options.TIME, metavar="S", help="The moment, in s; negative: before the end. Or as SRC#t=S.")
@options.follow
@options.any_view
@options.road_map
@click.option("--size", type=options.SIZE, metavar="WxH", help="In pixels; 1280x720, or of a recorded camera its own.")
@options.overlay
@options.force
@options.written
def snapshot(
    source: str,
    destination: str,
    at: float | None,
    follow: Follow | None,
    view: VideoView,
    road_map: str | None,
    size: tuple[int, int] | None,
    overlay: bool,
    force: bool,
) -> None:
    """Take a picture of a moment, without GPU or display."""
    from carla_recap.recording import open_recording
    from carla_recap.show.video import snapshot as run

    source, time = options.moment(source, at)
    with open_recording(source) as recording:
        town = partial(options.town_of, recording, road_map, time, options.MOMENT)
        run(recording, destination, at=time, follow=follow, view=view, town=town, size=size, overlay=overlay, force=force)
    wrote(destination, f"a picture at {number(time)} s", time=time)


@click.command()
@writes
@click.option(
    "--format",
    "suffix",
    type=click.Choice(["mp4", "gif"]),
    help="The format of files in a folder, by default mp4; a single file has the one of its suffix.",
)
@options.any_view
@_window
@click.option(
    "--speed", type=options.POSITIVE, default=1, metavar="X", help="2: twice as fast as it happened; 0.25: in slow motion."
)
@click.option("--size", type=options.SIZE, metavar="WxH", help="In pixels; 1280x720, of a GIF 640x360, of a camera its own.")
@click.option("--fps", "rate", type=options.POSITIVE, metavar="N", help="Frames per second; 30, of a GIF 12.5.")
@click.option("--smooth", is_flag=True, help="Draw smooth edges, which takes about twice as long.")
@options.overlay
def video(
    request: WriteRequest,
    suffix: str | None,
    start: float | None,
    duration: float | None,
    road_map: str | None,
    **shown: Any,
) -> None:
    """Write videos, .mp4 or .gif, without GPU or display.

    SRC#t=12.1 means from 5 s before that moment to 5 s after it. Many recordings go to a folder.
    """
    request.write(partial(_video, start, duration, road_map, shown), suffix, "mp4", "filming")


def _video(
    start: float | None,
    duration: float | None,
    road_map: str | None,
    shown: dict[str, Any],
    source: str,
    destination: str,
    force: bool,
) -> WrittenFile:
    from carla_recap.cli.progress import watch_scenes
    from carla_recap.recording import open_recording
    from carla_recap.show.video import export_video

    source, start, duration = options.timed(source, start, duration)
    with open_recording(source) as recording:
        written = export_video(
            recording,
            destination,
            start=start,
            duration=duration,
            town=partial(options.town_of, recording, road_map, start, duration),
            progress=watch_scenes("filming"),
            force=force,
            **shown,
        )
    width, height = written.size
    facts = {"width": width, "height": height}
    return WrittenFile((f"{width}x{height}",), written.frames, written.seconds, facts=facts)


@click.command()
@writes
@click.option("--compare", metavar="OTHER", type=click.Path(), help="A second recording to show beside it, or over it.")
@options.before
@options.after
@click.option(
    "--pictures",
    type=click.Choice(["drawn", "rendered", "none"]),
    default="drawn",
    show_default=True,
    help="Of incidents: drawn from above, or rendered from behind.",
)
@click.option("--viewer", is_flag=True, help="Add Rerun's viewer, in 3D, to a folder; it needs --serve or another server.")
@click.option("--serve", is_flag=True, help="Serve the folder to a browser on this machine, until Ctrl-C.")
@click.option("--port", type=click.IntRange(0, 65535), metavar="N", help="The port to serve at; else any free one.")
@options.incident_options
@click.pass_context
def report(
    ctx: click.Context,
    /,
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
        raise click.UsageError("--port goes with --serve.", ctx)
    if serve and wants_json(ctx):
        raise click.UsageError("--json goes with a page that is written; --serve prints its address.", ctx)
    for name, given in (("--serve", serve), ("--viewer", viewer)):
        if single and given:
            raise click.UsageError(f"{name} goes with a folder; {request.destination} is a single file.", ctx)
    for name, given in (("--serve", serve), ("--viewer", viewer), ("--compare", compare is not None)):
        if request.has_many and given:
            raise click.UsageError(f"{name} goes with one recording.", ctx)
    if viewer and compare:
        raise click.UsageError("--viewer goes with one recording.", ctx)
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
    from carla_recap.cli.progress import watch_scenes
    from carla_recap.recording import open_recording
    from carla_recap.show.page import write_report

    with ExitStack() as stack:
        recording, *others = (stack.enter_context(open_recording(each)) for each in (source, compare) if each)
        written = write_report(
            recording,
            destination,
            wanted,
            other=others[0] if others else None,
            road_map=options.road_map_of(recording, wanted.road_map) if viewer else None,
            town=options.town_of(recording, wanted.road_map),
            viewer=viewer,
            progress=watch_scenes("sampling"),
            force=force,
            **shown,
        )
    notes, facts = (counted(written.incidents, "incident"),), {"incidents": written.incidents}
    path = "index.html" if Path(destination).is_dir() else ""
    return WrittenFile(notes, size=written.size, facts=facts, path=path)


def _announce(address: str) -> None:
    """Print the address of a server, on stdout for programs."""
    click.echo(address)
    sys.stdout.flush()
    note("Ctrl-C ends it")
