"""`rerun-importer-carla-recap`: if it is on the PATH, Rerun's viewer opens recordings directly.

The viewer runs it for every file that is opened, so it checks the content first, and imports little before that.
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
    from collections.abc import Iterable, Iterator

    from carla_recap.model.frame import Header
    from carla_recap.replay import Player, Scene
    from carla_recap.roads import RoadMap

NOT_OURS: Final = 66
"""The exit code for files that are not recordings; the viewer then tries the next importer."""
FAILED: Final = 1

PART: Final = 256
"""The number of frames that are sent at once."""

_NAME: Final = "rerun-importer-carla-recap"

_LOG_MAGIC: Final = b"CARLA_RECORDER"
_MCAP_MAGIC: Final = b"\x89MCAP"
_MCAP_NAME: Final = b"carla_recap.header"
_ENDS: Final = 64 << 10  # bytes at each end of an MCAP file, one of which contains the name of its metadata


def main() -> None:
    """Write a recording to stdout in the format of the viewer."""
    for name in ("SIGINT", "SIGPIPE"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)  # nothing needs to be cleaned up
    warnings.simplefilter("always", RecapWarning)
    warnings.showwarning = lambda message, *_, **__: _say(f"warning: {message}")
    parser = ArgumentParser(_NAME, description="Opens CARLA's recordings in Rerun's viewer, which runs this.")
    for argument in ("file", "--application-id", "--recording-id"):
        parser.add_argument(argument)
    arguments = parser.parse_known_args()[0]
    try:
        if not _may_be_ours(Path(arguments.file)):
            sys.exit(NOT_OURS)
        _import(arguments)
    except NotARecording:
        sys.exit(NOT_OURS)
    except (RecapError, OSError, MemoryError) as error:
        _say(str(error) or "not enough memory")
        os._exit(FAILED)  # without flushing stdout again


def _may_be_ours(path: Path) -> bool:
    """Return whether the content may be a recording."""
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
    from carla_recap.recording import open_recording
    from carla_recap.replay import Player
    from carla_recap.show.rerun import check_rerun
    from carla_recap.tables.arrow import spare_pandas

    spare_pandas()
    check_rerun()
    import rerun as rr

    from carla_recap.show.rerun.blueprint import blueprint
    from carla_recap.show.rerun.sinks import APPLICATION, send_blueprint
    from carla_recap.show.rerun.writer import write

    with open_recording(arguments.file) as recording:
        player = Player(recording)
        road_map = _road_map(recording.header)
        application = arguments.application_id or APPLICATION
        stream = rr.RecordingStream(application, recording_id=arguments.recording_id, send_properties=False)
        written = rr.binary_stream(stream)  # `stream.stdout()` never returns if nothing can be written there
        send_blueprint(blueprint(player), stream)

        def sending(scenes: Iterable[Scene], _: Player) -> Iterator[Scene]:
            for count, scene in enumerate(scenes, 1):
                yield scene
                if count % PART == 0:
                    _send(written.read())

        write(stream, player, road_map=road_map, progress=sending)
        stream.disconnect()
        _send(written.read())


def _send(data: bytes | None) -> None:
    if sys.stdout is None:
        raise RecapError("stdout: is closed; the recording is written there")
    try:
        sys.stdout.buffer.write(data or b"")
        sys.stdout.buffer.flush()
    except OSError as error:
        raise RecapError(f"stdout: cannot be written: {error.strerror}") from None


def _road_map(header: Header) -> RoadMap | None:
    """Return the map, or None if it is missing or cannot be read."""
    from carla_recap.roads import find_map, load_map

    path = find_map(header.map_name)
    try:
        return load_map(path) if path else None
    except RecapError:
        return None


def _say(message: str) -> None:
    print(f"{_NAME}:", *message.split(), file=sys.stderr)  # one line, whatever the names in the file contain
