"""The command that writes what sensors would have measured."""

from __future__ import annotations

from functools import partial
from typing import Any

import click

from carla_recap.cli import options
from carla_recap.cli.output import counted
from carla_recap.cli.writing import WriteRequest, writes
from carla_recap.fleet.outcomes import WrittenFile


@click.command()
@writes
@options.rig("The sensors, as JSON.", is_required=True)
@options.start
@options.duration
@options.sensing
@options.road_map
@click.option("--video", is_flag=True, help="Write RGB images as H.264, which takes less room, instead of as JPEGs.")
@options.models
def sense(request: WriteRequest, **given: Any) -> None:
    """Write recordings with what the sensors of a rig would have measured: .mcap files.

    DST is the recording, and has its scene and the data of the sensors for Foxglove, Lichtblick and Rerun; layouts for the
    first two are beside it. SRC#t=12.1 means from 5 s before that moment to 5 s after it. Many recordings go to a folder.
    """
    request.write(partial(_sense, given), None, "mcap", "sensing")


def _sense(given: dict[str, Any], source: str, destination: str, force: bool) -> WrittenFile:
    from carla_recap.cli.progress import watch_scenes
    from carla_recap.recording import open_recording
    from carla_recap.show.foxglove.layouts import hints_of
    from carla_recap.show.foxglove.sensed import export_sensed

    source, given = options.timed(source, given)
    with open_recording(source) as recording:
        done = export_sensed(recording, destination, force=force, progress=watch_scenes("sensing"), **given)
    samples = sum(done.samples.values())
    notes = counted(len(done.samples), "sensor"), counted(samples, "sample")
    facts = {"samples": dict(done.samples), "layouts": [str(path) for path in done.layouts.values()]}
    return WrittenFile(notes, done.frames, done.seconds, facts=facts, hints=tuple(hints_of(done.layouts)))
