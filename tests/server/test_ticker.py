"""The ticks of the asynchronous mode."""

from __future__ import annotations

import asyncio
import time

import pytest

from carla_recap.server.host import Host
from carla_recap.server.rpc.structs import EpisodeSettings
from carla_recap.server.serving import Ticker
from tests.sim.flat import flat_world


@pytest.mark.parametrize(
    ("fails", "messages"),
    [("listener", ["a tick goes on without function: 'lost'"]), ("publish", ["a tick has failed: KeyError('lost')"] * 3)],
)
async def test_a_failing_tick_is_logged_and_others_follow(
    fails: str, messages: list[str], caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    host = Host(flat_world())
    host.apply_settings(EpisodeSettings(fixed_delta_seconds=0.002))
    failures = iter(range(3))

    def fail() -> None:
        if next(failures, None) is not None:
            raise KeyError("lost")

    if fails == "listener":
        host.world.listeners.append(fail)
    else:
        monkeypatch.setattr(host, "publish", fail)

    pace = asyncio.create_task(Ticker(host).run())
    while host.frame < 6:
        assert not pace.done()
        await asyncio.sleep(0.005)
    pace.cancel()
    assert caplog.messages == messages


async def test_calls_are_served_between_ticks_that_take_longer_than_they_last(monkeypatch: pytest.MonkeyPatch) -> None:
    host, pauses, sleep = Host(flat_world()), [], asyncio.sleep
    host.apply_settings(EpisodeSettings(fixed_delta_seconds=0.002))
    monkeypatch.setattr(host, "tick", lambda _: time.sleep(0.02))

    async def pause(seconds: float) -> None:
        pauses.append(seconds)
        await sleep(0)

    monkeypatch.setattr(asyncio, "sleep", pause)
    pace = asyncio.create_task(Ticker(host).run())
    while len(pauses) < 4:
        await sleep(0)
    pace.cancel()
    assert min(pauses[1:4]) >= 0.002
