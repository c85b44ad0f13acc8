"""Time that passes by itself, and what may go wrong with it."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from carla_recap.server.host import Host
from carla_recap.server.pace import Pace
from carla_recap.server.structs import EpisodeSettings
from tests.sim.flat import flat_world

if TYPE_CHECKING:
    import pytest


def test_a_tick_that_fails_is_told_in_a_line_and_others_follow(capsys: pytest.CaptureFixture[str]) -> None:
    host = Host(flat_world())
    host.apply_settings(EpisodeSettings(fixed_delta_seconds=0.002))
    failures = iter(range(3))

    def listener() -> None:
        if next(failures, None) is not None:
            raise KeyError("lost")

    host.world.listeners.append(listener)

    async def wait() -> None:
        pace = asyncio.create_task(Pace(host).keep())
        while host.frame < 6:
            assert not pace.done()
            await asyncio.sleep(0.005)
        pace.cancel()

    asyncio.run(asyncio.wait_for(wait(), 10))
    assert capsys.readouterr().err == "carla-recap: a tick has failed: KeyError('lost')\n"
