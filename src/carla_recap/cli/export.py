"""The commands that export: files for viewers, clips, pictures, the incident page; and the viewer itself."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import click
from click.core import ParameterSource

from carla_recap.cli import options
from carla_recap.cli.output import counted, note, wants_json, warn, wrote
from carla_recap.util.text import number

if TYPE_CHECKING:
    from collections.abc import Collection

    from carla_recap.export.clips import IncidentClip
    from carla_recap.export.report import Pictures
    from carla_recap.export.rerun.blueprint import View
    from carla_recap.export.video.cameras import VideoView
    from carla_recap.queries.incidents import Kind
    from carla_recap.replay.follow import Follow

VIEWERS: Final = {".rrd": "rerun", ".mcap": "foxglove"}
EXCHANGED: Final = {".csv": "csv", ".xosc": "xosc", ".mcap": "osi"}
_TABLES: Final = ("source", "destination", "to", "force")  # the parameters of exports of tables
_TRACES: Final = (*_TABLES, "start", "duration")  # those of exports to other programs' formats

_window = options.together(options.follow, options.start, options.duration, options.road_map)


@click.command()
@options.source
@options.destination
@click.option(
    "--to",
    type=click.Choice(["rerun", "foxglove", "parquet", "osi", "csv", "xosc"]),
    help="What to write; else DST's suffix says: .rrd for Rerun, .mcap for Foxglove, .csv, .xosc.",
)
@_window
@options.camera
@click.option("--cameras", type=click.Path(), metavar="DIR", help="Write a small .rbl for each actor, to follow it (Rerun).")
@options.force
@options.written
@click.pass_context
def export(
    ctx: click.Context,
    /,
    source: str,
    destination: str,
    to: str | None,
    follow: Follow | None,
    start: float | None,
    duration: float | None,
    road_map: str | None,
    view: View,
    cameras: str | None,
    force: bool,
) -> None:
    """Write a recording for Rerun (.rrd) or Foxglove (.mcap), or as tables or traces for other programs.

    With --to parquet, DST is a folder: a file for each record type, and actors, collisions and incidents. --to osi writes
    ASAM OSI's ground truth (.mcap); --to csv the tracks of vehicles and walkers; --to xosc their trajectories as
    OpenSCENARIO. SRC#t=12.1 means from 5 s before that moment to 5 s after it.
    """
    from carla_recap.cli.progress import watch_scenes
    from carla_recap.recording import open_recording

    if to == "parquet":
        _export_tables(ctx, source, destination, force=force)
        return
    suffix = Path(destination).suffix.lower()
    if to in EXCHANGED.values() or (to is None and suffix in EXCHANGED and suffix not in VIEWERS):
        _export_exchanged(ctx, source, destination, to or EXCHANGED[suffix])
        return
    viewer = VIEWERS.get(Path(destination).suffix.lower())
    if viewer is None or to not in (None, viewer):
        expected = "".join(name for name, each in VIEWERS.items() if each == to) or " or ".join(VIEWERS)
        hint = "; tables are written to a folder with --to parquet" if to is None else ""
        raise click.BadParameter(f"{destination!r} does not end in {expected}{hint}.", param_hint="DST")
    if viewer == "foxglove" and cameras:
        raise click.BadParameter("Foxglove has no such files.", param_hint="--cameras")
    source, start, duration = options.timed(source, start, duration)
    with open_recording(source) as recording:
        roads, progress = options.road_map_of(recording, road_map, start, duration), watch_scenes("exporting")
        if viewer == "rerun":
            from carla_recap.export.rerun import export_rerun

            played = export_rerun(
                recording,
                destination,
                follow=follow,
                start=start,
                duration=duration,
                road_map=roads,
                view=view,
                cameras=cameras,
                progress=progress,
                force=force,
            )
        else:
            from carla_recap.export.foxglove import export_foxglove, layout_files

            played = export_foxglove(
                recording,
                destination,
                follow=follow,
                start=start,
                duration=duration,
                road_map=roads,
                progress=progress,
                force=force,
            )
            for viewer, path in layout_files().items():
                note(f"the layout for {viewer}: {path}")
    wrote(destination, frames=played.frames, seconds=played.seconds)


def _export_tables(ctx: click.Context, source: str, folder: str, *, force: bool) -> None:
    """Write Parquet files; refuse options that concern viewers."""
    from carla_recap.cli.progress import watch
    from carla_recap.export.parquet import export_parquet
    from carla_recap.recording import open_recording

    _refuse_others(ctx, _TABLES, "parquet")
    with open_recording(source) as recording:
        files = export_parquet(recording, folder, force=force, progress=watch("exporting"))
        about, count = recording.info, len(files)
        wrote(folder, counted(count, "file"), frames=about.frames, seconds=about.duration, files=count)


def _refuse_others(ctx: click.Context, allowed: Collection[str], to: str) -> None:
    """Check that only parameters that concern an export are given, or all commands, such as --quiet."""
    for param in ctx.command.params:
        name = param.name or ""
        if param.expose_value and name not in allowed and ctx.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            raise click.UsageError(f"{param.opts[0]} does not go with --to {to}.", ctx)


def _export_exchanged(ctx: click.Context, source: str, destination: str, to: str) -> None:
    """Write a file for other programs."""
    from carla_recap.cli.progress import watch_scenes
    from carla_recap.recording import open_recording

    if EXCHANGED.get(Path(destination).suffix.lower()) != to:
        expected = next(suffix for suffix, name in EXCHANGED.items() if name == to)
        raise click.BadParameter(f"{destination!r} does not end in {expected}.", param_hint="DST")
    extra = {"osi": ("follow", "road_map"), "xosc": ("road_map",), "csv": ()}[to]
    _refuse_others(ctx, (*_TRACES, *extra), to)
    source, start, duration = options.timed(source, ctx.params["start"], ctx.params["duration"])
    given = {"start": start, "duration": duration, "force": ctx.params["force"]}
    with open_recording(source) as recording:
        watched = {**given, "progress": watch_scenes("exporting")}
        if to == "csv":
            from carla_recap.export.tracks import export_csv

            played = export_csv(recording, destination, **watched)
        else:
            opendrive = options.map_file_of(recording, ctx.params["road_map"])
            if to == "xosc":
                from carla_recap.export.openscenario import export_openscenario

                played = export_openscenario(recording, destination, opendrive=opendrive, **watched)
                if opendrive is not None:
                    note(f"the map that belongs beside it: {opendrive}")
            else:
                from carla_recap.export.osi import export_osi

                follow = ctx.params["follow"]
                played = export_osi(recording, destination, follow=follow, opendrive=opendrive, **watched)
    wrote(destination, frames=played.frames, seconds=played.seconds)


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
@options.min_time
@options.min_distance
@options.deceleration
@options.road_map
@click.option(
    "--limit", type=click.IntRange(min=1), default=100, show_default=True, metavar="N", help="The largest number of clips."
)
@options.written
def clips(
    source: str,
    folder: str,
    kinds: tuple[Kind, ...] | Literal["all"] | None,
    suffix: str,
    rrd: bool | None,
    video: bool,
    before: float,
    after: float,
    min_time: float,
    min_distance: float,
    deceleration: float,
    road_map: str | None,
    limit: int,
    force: bool,
) -> None:
    """Cut a clip of each incident, into a folder."""
    from carla_recap.cli.progress import watch_incidents
    from carla_recap.export.clips import clips as run
    from carla_recap.fleet.roads import kinds_and_roads
    from carla_recap.recording import open_recording

    with open_recording(source) as recording:
        kinds, network = kinds_and_roads(kinds, recording.reader, road_map)
        roads = options.road_map_of(recording, road_map) if rrd is not False else None
        town = partial(options.town_of, recording, road_map)
    written = run(
        source,
        folder,
        kinds=kinds,
        roads=network,
        before=before,
        after=after,
        suffix=f".{suffix}",
        rerun=rrd,
        video=video,
        min_time=min_time,
        min_distance=min_distance,
        deceleration=deceleration,
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
    from carla_recap.export.viewer import view as run
    from carla_recap.recording import open_recording

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
    from carla_recap.export.video import snapshot as run
    from carla_recap.recording import open_recording

    source, time = options.moment(source, at)
    with open_recording(source) as recording:
        town = partial(options.town_of, recording, road_map, time, options.MOMENT)
        run(recording, destination, at=time, follow=follow, view=view, town=town, size=size, overlay=overlay, force=force)
    wrote(destination, f"a picture at {number(time)} s", time=time)


@click.command()
@options.source
@options.destination
@options.any_view
@_window
@click.option(
    "--speed", type=options.POSITIVE, default=1, metavar="X", help="2: twice as fast as it happened; 0.25: in slow motion."
)
@click.option("--size", type=options.SIZE, metavar="WxH", help="In pixels; 1280x720, of a GIF 640x360, of a camera its own.")
@click.option("--fps", type=options.POSITIVE, metavar="N", help="Frames per second; 30, of a GIF 12.5.")
@click.option("--smooth", is_flag=True, help="Draw smooth edges, which takes about twice as long.")
@options.overlay
@options.force
@options.written
def video(
    source: str,
    destination: str,
    view: VideoView,
    follow: Follow | None,
    start: float | None,
    duration: float | None,
    road_map: str | None,
    speed: float,
    size: tuple[int, int] | None,
    fps: float | None,
    smooth: bool,
    overlay: bool,
    force: bool,
) -> None:
    """Write a video, an .mp4 or .gif, without GPU or display.

    SRC#t=12.1 means from 5 s before that moment to 5 s after it.
    """
    from carla_recap.cli.progress import watch_scenes
    from carla_recap.export.video import export_video
    from carla_recap.recording import open_recording

    source, start, duration = options.timed(source, start, duration)
    with open_recording(source) as recording:
        written = export_video(
            recording,
            destination,
            view=view,
            follow=follow,
            start=start,
            duration=duration,
            speed=speed,
            size=size,
            rate=fps,
            smooth=smooth,
            overlay=overlay,
            town=partial(options.town_of, recording, road_map, start, duration),
            progress=watch_scenes("filming"),
            force=force,
        )
    width, height = written.size
    facts = {"width": width, "height": height}
    wrote(destination, f"{width}x{height}", frames=written.frames, seconds=written.seconds, **facts)


@click.command()
@click.argument("sources", nargs=-1, type=click.Path(), metavar="SRC [OTHER]")
@click.argument("destination", type=click.Path(), metavar="DST")
@options.before
@options.after
@options.road_map
@click.option(
    "--pictures",
    type=click.Choice(["drawn", "rendered", "none"]),
    default="drawn",
    show_default=True,
    help="Of incidents: drawn from above, or rendered from behind.",
)
@click.option("--viewer", is_flag=True, help="Add Rerun's viewer, in 3D, to a folder; it needs --serve or another server.")
@options.force
@click.option("--serve", is_flag=True, help="Serve the folder to a browser on this machine, until Ctrl-C.")
@click.option("--port", type=click.IntRange(0, 65535), metavar="N", help="The port to serve at; else any free one.")
@options.min_time
@options.min_distance
@options.deceleration
@options.written
@click.pass_context
def report(
    ctx: click.Context,
    /,
    sources: tuple[str, ...],
    destination: str,
    before: float,
    after: float,
    road_map: str | None,
    pictures: Pictures,
    viewer: bool,
    force: bool,
    serve: bool,
    port: int | None,
    min_time: float,
    min_distance: float,
    deceleration: float,
) -> None:
    """Write the incident page, for any browser.

    It lists what went wrong, with a replay from above. DST is a single file, if its name ends in .html, or else a folder.
    With a second recording, the page compares both, side by side or one over the other. --before and --after are for a
    recording that is too long to be replayed as a whole.
    """
    from carla_recap.cli.progress import watch_scenes
    from carla_recap.export.report import serve as serve_page
    from carla_recap.export.report import write_report
    from carla_recap.export.report.report import SINGLE
    from carla_recap.fleet.roads import WITHOUT_ROADS
    from carla_recap.recording import open_recording

    single = Path(destination).suffix.lower() in SINGLE
    if not sources:
        raise click.MissingParameter(ctx=ctx, param_hint="'DST'", param_type="argument")
    if len(sources) > 2:
        raise click.UsageError("A page shows one recording, or compares two.", ctx)
    if port is not None and not serve:
        raise click.UsageError("--port goes with --serve.", ctx)
    if serve and wants_json(ctx):
        raise click.UsageError("--json goes with a page that is written; --serve prints its address.", ctx)
    for name, given in (("--serve", serve), ("--viewer", viewer)):
        if single and given:
            raise click.UsageError(f"{name} goes with a folder; {destination} is a single file.", ctx)
    if viewer and len(sources) > 1:
        raise click.UsageError("--viewer goes with one recording.", ctx)
    with ExitStack() as stack:
        recording, *others = (stack.enter_context(open_recording(source)) for source in sources)
        roads, map_name = options.roads_of(recording, road_map), recording.header.map_name
        written = write_report(
            recording,
            destination,
            other=others[0] if others else None,
            before=before,
            after=after,
            min_time=min_time,
            min_distance=min_distance,
            deceleration=deceleration,
            road_map=options.road_map_of(recording, road_map) if viewer else None,
            town=options.town_of(recording, road_map),
            roads=roads,
            pictures=pictures,
            viewer=viewer,
            progress=watch_scenes("sampling"),
            force=force,
        )
    page = destination if single else Path(destination) / "index.html"
    wrote(page, counted(written.incidents, "incident"), size=written.size, incidents=written.incidents)
    if roads is None:
        warn(f"the map {map_name!r} is unknown; {WITHOUT_ROADS}")
    if serve:
        serve_page(destination, port or 0, ready=_announce)


def _announce(address: str) -> None:
    """Print the address of a server, on stdout for programs."""
    click.echo(address)
    sys.stdout.flush()
    note("Ctrl-C ends it")
