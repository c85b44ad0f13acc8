"""The recordings that clients name: where they lie, and which of them a client may have."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from carla_recap.server.rpc.registry import CallError
from carla_recap.sim.recording.recorder import recording_path, recordings_folder
from carla_recap.sim.replaying.replayer import find_recording

if TYPE_CHECKING:
    from pathlib import Path

    from carla_recap.sim.world import World

_SHOWN: Final = 200  # characters of a name in a message


class Recordings:
    """Finds recordings by the names that clients give them.

    Args:
        world: The world that records and replays.
        confined: Refuse what lies outside the folder of recordings, however it is named.
    """

    def __init__(self, world: World, *, confined: bool = False) -> None:
        self._world = world
        self._confined = confined

    def start(self, name: str, additional_data: bool) -> Path:
        """Begin a recording; see `World.start_recorder`.

        Returns:
            Where it will be.

        Raises:
            RecapError: It cannot be recorded there.
        """
        _expect_name(name)
        self._check(name, recording_path(name, self._world.recordings))
        return self._world.start_recorder(name, additional_data).absolute()

    def find(self, name: str) -> Path:
        """Where a recording lies, or would, if it were there; its suffix may be missing.

        Raises:
            CallError: It must not be read, or cannot be.
        """
        _expect_name(name)
        try:
            path = find_recording(name, self._world.recordings).absolute()
        except OSError as error:
            raise CallError(f"{_shown(name)}: cannot be read: {error.strerror}") from None
        except ValueError:  # as of the root, or the working directory
            raise _no_name(name) from None
        self._check(name, path)
        return path

    def find_complete(self, name: str) -> Path:
        """Where a recording lies that is not being recorded just now; see `find`.

        Raises:
            CallError: It is, or must not be read, or cannot be.
        """
        path = self.find(name)
        running = self._world.recorder.path
        if running is not None and running.absolute() in (path, path.with_name(path.name + running.suffix)):
            raise CallError(f"{running} is being recorded; it can be asked about after stop_recorder()")
        return path

    def _check(self, name: str, path: Path) -> None:
        if not self._confined:
            return
        folder = recordings_folder(self._world.recordings)
        try:
            is_within = folder.resolve() in path.resolve().parents
        except (OSError, ValueError, RuntimeError):  # what it leads to cannot be told, as of a loop of links
            is_within = False
        if not is_within:
            raise CallError(
                f"{_shown(name)}: lies outside the folder of recordings, {folder}; this server is confined to it"
            )


def _expect_name(name: str) -> None:
    if "\0" in name:
        raise _no_name(name)


def _no_name(name: str) -> CallError:
    return CallError(f"{_shown(name)}: the name of a recording was expected")


def _shown(name: str) -> str:
    return f"{name!r:.{_SHOWN}}"
