"""The server: one event loop for the calls of clients, the streams, and the time of the world."""

from __future__ import annotations

import asyncio
import errno
import gc
import logging
import os
import signal
import sys
import time
from contextlib import suppress
from functools import partial
from threading import Thread
from typing import TYPE_CHECKING, Any, Final

import carla_recap.server.calls  # noqa: F401  (registers the calls)
from carla_recap.errors import RecapError
from carla_recap.server.host import Client
from carla_recap.server.rpc.connection import ClientConnection
from carla_recap.server.rpc.registry import CALLS
from carla_recap.util.files import reason_of
from carla_recap.util.signals import call_on_termination

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.server.host import Host

_LOG: Final = logging.getLogger(__name__)
_BACKLOG: Final = 512
_TRIES: Final = 20
_STDIN: Final = 0
_SWITCH: Final = 1e-3  # s: how long a thread, such as one that opens a recording, may keep a call waiting
_TICK: Final = 0.05  # s: the time between two ticks without a fixed time step
_LONGEST: Final = 0.25  # s: a longer tick, because something took its time, is this long
_BEHIND: Final = 1.0  # s: a longer delay is not made up for
_PAUSE: Final = 0.1  # of the time that a tick took, before the next one: for calls, where ticks take longer than they last


async def serve(
    host: Host,
    address: str,
    port: int,
    ready: Callable[[int], None],
    *,
    streaming_port: int | None = None,
    attached: bool = False,
    load_ahead: bool = True,
) -> None:
    """Serve a world until SIGINT, SIGTERM or SIGHUP; `ready` gets the port for calls when clients can connect.

    A port of 0 is a free one; without a streaming port, that is the one after `port`. If it is `attached`, it ends, too,
    when the standard input ends or has data, whose other end belongs to a process that may be killed. With `load_ahead`, it
    loads at once what sensors will need.

    Raises:
        RecapError: The ports are unavailable.
    """
    loop = asyncio.get_running_loop()
    done = asyncio.Event()
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)  # a client that has left must not end the server
    loop.set_exception_handler(_log_exception)

    def end() -> None:
        with suppress(RuntimeError):  # the loop has ended by itself
            loop.call_soon_threadsafe(done.set)

    if attached:
        Thread(target=_wait_for_input, args=(end,), name="carla-recap-attached", daemon=True).start()
    with call_on_termination(lambda _: end()):
        host.prepare()
        gc.freeze()  # to look for cycles among what stays would keep clients waiting
        sys.setswitchinterval(_SWITCH)
        connect = partial(ClientConnection, CALLS, host.connections, partial(Client, host))
        calls, streams = await _listen_both(connect, host.streams.connection, address, port, streaming_port)
        port, host.streams.port = (server.sockets[0].getsockname()[1] for server in (calls, streams))
        ticker = asyncio.create_task(Ticker(host).run())
        ready(port)
        if load_ahead and not attached:  # such servers are started by tests, most of which have no cameras
            host.load_ahead()
        try:
            stopped = asyncio.create_task(done.wait())
            await asyncio.wait((stopped, ticker), return_when=asyncio.FIRST_COMPLETED)
            if ticker.done():
                ticker.result()
        finally:
            ticker.cancel()
            calls.close()
            streams.close()
            host.close()


class Ticker:
    """Ticks a world in asynchronous mode, at the pace of the clock."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._changed = asyncio.Event()
        host.on_settings.append(self._changed.set)

    async def run(self) -> None:
        """Tick for ever."""
        while True:
            self._changed.clear()
            if self._host.settings.synchronous_mode:
                await self._changed.wait()
            else:
                await self._run_until_changed()

    async def _run_until_changed(self) -> None:
        """Tick until the settings change."""
        fixed = self._host.settings.fixed_delta_seconds
        due = last = time.monotonic()
        took = 0.0
        while not self._changed.is_set():
            due = max(due + (fixed or _TICK), time.monotonic() - _BEHIND)
            await asyncio.sleep(max(due - time.monotonic(), _PAUSE * took))
            await self._host.between_batches()
            if self._changed.is_set():
                return
            now = time.monotonic()
            try:
                self._host.tick(fixed or min(now - last, _LONGEST))
            except Exception as error:  # the next tick may succeed
                _LOG.error("a tick has failed: %r", error)
            last, took = now, time.monotonic() - now


def _wait_for_input(end: Callable[[], None]) -> None:
    with suppress(OSError):
        os.read(_STDIN, 1)
    end()


async def _listen_both(
    call: Callable[[], asyncio.Protocol],
    stream: Callable[[], asyncio.Protocol],
    address: str,
    port: int,
    streaming_port: int | None,
) -> tuple[asyncio.Server, asyncio.Server]:
    """Listen on two ports; for port 0 without a port for streams, try until that and the next one are free."""
    for left in reversed(range(_TRIES)):
        calls = await _listen(call, address, port)
        after = calls.sockets[0].getsockname()[1] + 1
        try:
            return calls, await _listen(stream, address, after if streaming_port is None else streaming_port)
        except RecapError:
            calls.close()
            if port or not left:
                raise
    raise AssertionError


async def _listen(make: Callable[[], asyncio.Protocol], address: str, port: int) -> asyncio.Server:
    loop = asyncio.get_running_loop()
    try:
        return await loop.create_server(make, address, port, backlog=_BACKLOG)
    except (OSError, UnicodeError) as error:  # the latter about a name such as a..b
        if isinstance(error, OSError) and error.errno in (errno.EADDRINUSE, errno.EACCES):
            reason = f"{os.strerror(error.errno)}; choose another port with --port"
        else:
            reason = reason_of(error)
        raise RecapError(f"{address}:{port}: cannot be listened at: {reason}") from None


def _log_exception(_: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Log in a line what has gone wrong with a connection; the others go on."""
    error = context.get("exception")
    _LOG.error("%s", context["message"] if error is None else f"{context['message']}: {error!r}")
