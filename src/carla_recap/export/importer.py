"""`rerun-importer-carla-recap`: with it on the PATH, Rerun's viewer opens recordings as they are.

The viewer runs it for every file that is opened, so it looks at the content first, and imports little before that.
"""

from __future__ import annotations

import os
import signal
import sys
import warnings
from argparse import ArgumentParser
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.errors import NotARecording, RecapError, RecapWarning

if TYPE_CHECKING:
    from argparse import Namespace

    from rerun import RecordingStream

    from carla_recap.frame import Header
    from carla_recap.maps import RoadMap

NOT_OURS: Final = 66
"""The exit code that tells the viewer to ask the next importer."""
FAILED: Final = 1

_NAME: Final = "rerun-importer-carla-recap"

_LOG_MAGIC: Final = b"CARLA_RECORDER"
_MCAP_MAGIC: Final = b"\x89MCAP"
_MCAP_NAME: Final = b"carla_recap.header"
_ENDS: Final = 64 << 10  # bytes, at each end of an MCAP file, in which its metadata is named


def main() -> None:
    """Write a recording to stdout as the viewer reads it."""
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # Rerun's writer would wait forever for a viewer that has gone
    warnings.simplefilter("always", RecapWarning)
    warnings.showwarning = lambda message, *_, **__: _say(f"warning: {message}")
    arguments = _arguments()
    try:
        if not _may_be_ours(Path(arguments.file)):
            sys.exit(NOT_OURS)
        _import(arguments)
    except NotARecording:
        sys.exit(NOT_OURS)
    except (RecapError, OSError, MemoryError) as error:
        _say(str(error) or "not enough memory")
        sys.exit(FAILED)


def _arguments() -> Namespace:
    parser = ArgumentParser(
        "rerun-importer-carla-recap", description="Opens CARLA's recordings in Rerun's viewer, which runs this."
    )
    parser.add_argument("file")
    parser.add_argument("--application-id")
    parser.add_argument("--recording-id")
    return parser.parse_known_args()[0]


def _may_be_ours(path: Path) -> bool:
    """Whether the content looks like a recording, at a glance."""
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            content = file.read(_ENDS)
            if content[4:].upper().startswith(_LOG_MAGIC):
                return True
            if not content.startswith(_MCAP_MAGIC):
                return False
            file.seek(max(0, file.seek(0, os.SEEK_END) - _ENDS))
            return _MCAP_NAME in content or _MCAP_NAME in file.read(_ENDS)
    except (OSError, ValueError):
        return False


def _import(arguments: Namespace) -> None:
    from carla_recap.export.rerun import blueprint, write
    from carla_recap.recording import open_recording
    from carla_recap.replay import Player

    with open_recording(arguments.file) as recording:
        player = Player(recording)
        road_map = _road_map(recording.header)
        with _new_stream(arguments) as stream:
            stream.stdout(default_blueprint=blueprint(player))
            write(stream, player, road_map=road_map)


def _new_stream(arguments: Namespace) -> RecordingStream:
    import rerun as rr

    from carla_recap.export.rerun import APPLICATION

    return rr.RecordingStream(arguments.application_id or APPLICATION, recording_id=arguments.recording_id)


def _road_map(header: Header) -> RoadMap | None:
    """The map, where there is one and what reads it."""
    from carla_recap.maps import find_map, load_map

    path = find_map(header.map_name)
    try:
        return load_map(path) if path else None
    except RecapError:
        return None


def _say(message: str) -> None:
    print(f"{_NAME}:", *message.split(), file=sys.stderr)  # a name from a stranger's file must not break the line
