"""The commands that are clients of a CARLA server: one records it, the other one shows it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

import click

from carla_recap.cli import options
from carla_recap.cli.options import FOLLOW, NUMBER, command, option
from carla_recap.cli.output import counted, end, note, wrote
from carla_recap.cli.progress import watch_ticks
from carla_recap.util.text import first_of

if TYPE_CHECKING:
    from carla_recap.sensors.rig import SensorRig


_server = options.together(
    option("--host", default="127.0.0.1", metavar="ADDRESS", help="The server's address."),
    option("--port", type=click.IntRange(1, 65535), default=2000, help="Its port."),
)


def _seconds(what: str) -> Any:
    """Return the option for how long."""
    words = f"Simulated s to {what}; else until Ctrl-C."
    return option("--duration", type=NUMBER, default=math.inf, show_default=False, metavar="S", help=words)


@command(
    options.destination,
    _server,
    _seconds("record"),
    options.additional_data,
    options.rig("Spawn the sensors of this JSON file, and record what they send."),
    options.carrier,
    option("--sensors", type=click.Choice(["existing"]), help="Record what the sensors send that are there already."),
    options.force,
    options.written,
)
def capture(
    destination: str,
    duration: float,
    rig: SensorRig | None,
    sensors: Literal["existing"] | None,
    **given: Any,
) -> None:
    """Record what a CARLA server does, as one of its clients, to .mcap or .log; with sensors, to .mcap."""
    from carla_recap.capture import capture as run

    if rig is not None and sensors is not None:
        raise click.UsageError("--rig and --sensors exclude each other.")
    progress = watch_ticks("capturing", duration)
    captured = run(destination, duration=duration, sensors=sensors if rig is None else rig, progress=progress, **given)
    notes = [f"{counted(captured.missed, 'tick')} missed"] if captured.missed else []
    facts: dict[str, Any] = {"missed": captured.missed, "end": captured.why}
    if rig is not None or sensors is not None:
        facts |= {"samples": dict(captured.samples), "dropped": dict(captured.dropped)}
        notes.append(counted(sum(captured.samples.values()), "sample"))
    if captured.dropped:
        few = first_of([f"{count} of {id}" for id, count in captured.dropped.items()])
        notes.append(f"{few} dropped, since writing was slower")
    if captured.samples and not captured.is_cut_short:
        for hint in _layouts(destination):
            note(hint)
    wrote(destination, *notes, captured.why, frames=captured.frames, seconds=captured.seconds, **facts)
    if captured.is_cut_short:
        end(unmet=True)


def _layouts(path: str) -> list[str]:
    """Write layouts for Foxglove that show the sensors of a recording, beside it; return where they are."""
    from carla_recap.recording import open_recording
    from carla_recap.show.foxglove.layouts import hints_of, write_layouts
    from carla_recap.show.foxglove.topics import passed_topics

    with open_recording(path) as recording:
        return hints_of(write_layouts(path, passed_topics(recording.reader)))


@command(
    _server,
    _seconds("show"),
    options.force,
    option("--to", metavar="FILE|URL", help="Write an .rrd, or send to the viewer at rerun+http://...; else one is opened."),
    option(
        "--follow",
        type=FOLLOW,
        default="hero",
        metavar="ID|hero",
        help="The actor to follow; without a hero, one that moves.",
    ),
    options.camera,
    options.models,
    options.foxglove,
)
def watch(to: str | None, foxglove_port: int | None, **given: Any) -> None:
    """Show what a CARLA server does live, in Rerun's viewer or in Foxglove."""
    from carla_recap.capture.live import watch as run

    if foxglove_port is not None and to is not None:
        raise click.UsageError("--to goes with Rerun's viewer.")
    why = run(to, foxglove_port=foxglove_port, ready=click.echo, **given)
    note(f"{to or ('the viewer' if foxglove_port is None else 'Foxglove')}: {why}")
