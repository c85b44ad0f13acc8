"""The maps that clients can load, and loading them off the event loop."""

from __future__ import annotations

import asyncio
import logging
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.errors import RecapError
from carla_recap.roads.find import described_folder, loadable_maps, plain_name
from carla_recap.server.navmesh import prepare_navigation
from carla_recap.server.rpc.registry import CallError
from carla_recap.sim.town.loading import BUILT_IN, is_unknown, load_corridors, load_town

if TYPE_CHECKING:
    from carla_recap.sim.town.loading import Town

_LOG: Final = logging.getLogger(__name__)
_SENT: Final = "OpenDriveMap"
"""The name of a map that a client has sent, as with CARLA."""
_SHOWN: Final = 100  # characters of a name in an error


class Maps:
    """The maps of a server; the lock `loading` is held while one is loaded.

    The first town can be loaded again by its name. With `stand_in`, the built-in town is served under the name of a map that
    is missing.
    """

    def __init__(self, first: Town, folder: Path | str | None = None, *, stand_in: bool = False) -> None:
        self.loading = asyncio.Lock()
        self._first = first
        self._folder = None if folder is None else Path(folder)
        self._stand_in = stand_in
        self._sent: Town | None = None
        self._stood_in: set[str] = set()

    @property
    def names(self) -> list[str]:
        """The names of all maps."""
        return sorted({*loadable_maps(self._folder), self._first.name})

    async def receive(self, text: str) -> None:
        """Parse a map that a client sends, for later episodes; raise `CallError` if it is no OpenDRIVE map."""
        self._sent = await asyncio.to_thread(_parse, text)

    async def load(self, name: str) -> Town:
        """Load a map by its name in any case, with or without its folder, with what the first calls of a client need of it.

        A `RecapError` is raised if there is no such map, or it cannot be read.
        """
        asked = plain_name(name)
        if asked == _SENT:
            if self._sent is None:
                raise CallError(f"{name}: no map has been sent to this server")
            return await asyncio.to_thread(_prepared, self._sent)
        found = next((known for known in self.names if known.casefold() == asked.casefold()), None)
        if found == self._first.name:
            return await asyncio.to_thread(_prepared, self._first)
        if found is not None:
            return await asyncio.to_thread(lambda: _prepared(load_town(found, self._folder)))
        if not self._stand_in:
            raise self._missing(name)
        _LOG.warning("%s: there is no such map; %s stands in for it", asked[:_SHOWN], BUILT_IN)
        self._stood_in.add(asked)
        return await asyncio.to_thread(lambda: _prepared(load_town(called=asked)))

    def is_only_here(self, name: str, *, stand_in: bool = True) -> bool:
        """Return whether only `load` knows a map: the first one, one that was sent, or one that is stood in for.

        With `stand_in`, a map counts, too, that would be stood in for, but has not been so far.
        """
        asked = plain_name(name)
        if asked.casefold() in map(str.casefold, loadable_maps(self._folder)):
            return False
        is_stood_in = asked in self._stood_in or (self._stand_in and stand_in)
        return is_stood_in or asked == self._first.name or (asked == _SENT and self._sent is not None)

    async def preload(self, name: str, recording: Path | None = None) -> None:
        """Parse a map for what loads it next on the event loop, such as a replay; errors are left to that.

        If there is no such map, the corridors of a recording are parsed, if one is given.
        """
        with suppress(RecapError, OSError):
            if recording is not None and is_unknown(name, self._folder) and plain_name(name) != self._first.name:
                await asyncio.to_thread(load_corridors, recording, name)
            else:
                await asyncio.to_thread(load_town, plain_name(name), self._folder)

    def _missing(self, name: str) -> CallError:
        shown = name if len(name) <= _SHOWN else f"{name[:_SHOWN]}…"
        folder = described_folder(self._folder)
        return CallError(
            f"{shown!r}: there is no such map; there are {', '.join(self.names)}; "
            f"to add one, put its .xodr into {folder}, or have {BUILT_IN} stand in for it by `serve --stand-in`"
        )


def _prepared(town: Town) -> Town:
    prepare_navigation(town)
    return town


def _parse(text: str) -> Town:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{_SENT}.xodr"
        path.write_bytes(text.encode(errors="surrogateescape"))
        try:
            return load_town(path).standalone()
        except RecapError as error:
            raise CallError(str(error).replace(str(path), _SENT)) from None
