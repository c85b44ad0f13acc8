"""The server: one event loop for the calls of clients, the streams, and the time of the world."""

from __future__ import annotations

import asyncio
import os
import signal
from contextlib import suppress
from threading import Thread
from typing import TYPE_CHECKING, Any, Final

import carla_recap.server.calls  # noqa: F401  (fills the table of calls)
from carla_recap.ending import ended_by_signals
from carla_recap.errors import RecapError
from carla_recap.server.client import Client
from carla_recap.server.mishaps import tell
from carla_recap.server.pace import Pace

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.server.host import Host

_BACKLOG: Final = 512
_TRIES: Final = 20
_STDIN: Final = 0


async def serve(host: Host, address: str, port: int, ready: Callable[[int], None], *, attached: bool = False) -> None:
    """Serve a world until SIGINT, SIGTERM or SIGHUP.

    Args:
        host: The world and what is served of it.
        address: Where to listen.
        port: Where to listen for calls; streams are at the next one. 0 for two ports that are free.
        ready: Is told the port of the calls once clients can connect.
        attached: End, too, when the standard input ends or says something: whoever holds its other end may be killed.

    Raises:
        RecapError: The ports are not to be had.
    """
    loop = asyncio.get_running_loop()
    done = asyncio.Event()
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)  # a client that is gone must not end the server
    loop.set_exception_handler(_tell)

    def end() -> None:
        with suppress(RuntimeError):  # the loop has ended by itself
            loop.call_soon_threadsafe(done.set)

    if attached:
        Thread(target=_wait_for_input, args=(end,), name="carla-recap-attached", daemon=True).start()
    with ended_by_signals(lambda _: end()):
        calls, streams = await _listen_both(lambda: Client(host), host.streams.connection, address, port)
        port, host.streams.port = (server.sockets[0].getsockname()[1] for server in (calls, streams))
        pace = asyncio.create_task(Pace(host).keep())
        ready(port)
        try:
            stopped = asyncio.create_task(done.wait())
            await asyncio.wait((stopped, pace), return_when=asyncio.FIRST_COMPLETED)
            if pace.done():
                pace.result()
        finally:
            pace.cancel()
            calls.close()
            streams.close()
            host.world.close()


def _wait_for_input(end: Callable[[], None]) -> None:
    with suppress(OSError):
        os.read(_STDIN, 1)
    end()


async def _listen_both(
    call: Callable[[], asyncio.Protocol], stream: Callable[[], asyncio.Protocol], address: str, port: int
) -> tuple[asyncio.Server, asyncio.Server]:
    """Listen at a port and the next one; where any will do, until both are free."""
    for left in reversed(range(_TRIES)):
        calls = await _listen(call, address, port)
        try:
            return calls, await _listen(stream, address, calls.sockets[0].getsockname()[1] + 1)
        except RecapError:
            calls.close()
            if port or not left:
                raise
    raise AssertionError


async def _listen(make: Callable[[], asyncio.Protocol], address: str, port: int) -> asyncio.Server:
    loop = asyncio.get_running_loop()
    try:
        return await loop.create_server(make, address, port, backlog=_BACKLOG)
    except OSError as error:
        raise RecapError(f"{address}:{port}: cannot be listened at: {error.strerror}") from None


def _tell(_: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Say in a line what has gone wrong with a connection; it concerns nobody else."""
    tell(context["message"], context.get("exception"))
