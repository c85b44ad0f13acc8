from __future__ import annotations

import asyncio
import socket
import time
from contextlib import closing

from carla_recap.server.quirks import busy_polling_loop


def test_what_is_due_later_is_done_in_time() -> None:
    async def wait() -> float:
        begin = time.monotonic()
        for _ in range(20):
            await asyncio.sleep(0.01)
        return time.monotonic() - begin

    with closing(busy_polling_loop()) as loop:
        assert 0.2 <= loop.run_until_complete(wait()) < 1.0


def test_who_waits_takes_no_processor_time() -> None:
    async def wait() -> float:
        reader, writer = await asyncio.open_connection(*there.getsockname())
        caller, _ = there.accept()
        with caller:
            caller.sendall(b"x")
            await reader.read(1)  # so that the loop has been called just before
            begin = time.process_time()
            await asyncio.sleep(0.5)
            writer.close()
            return time.process_time() - begin

    with socket.create_server(("127.0.0.1", 0)) as there, closing(busy_polling_loop()) as loop:
        assert loop.run_until_complete(wait()) < 0.1
