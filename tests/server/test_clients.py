from __future__ import annotations

import subprocess
import sys
import time

import carla
import pytest

from tests.cli.command import error
from tests.waiting import PATIENCE, wait_until

DYING = """
import os, sys, carla
client = carla.Client("127.0.0.1", int(sys.argv[1]))
client.set_timeout(600.0)
world = client.get_world()
world.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))
world.tick()
os.kill(os.getpid(), 9)
"""


def test_two_clients_tick_one_world(world: carla.World, other_client: carla.Client) -> None:
    theirs = other_client.get_world()
    frames = [ticking.tick() for _ in range(20) for ticking in (world, theirs)]
    assert frames == list(range(frames[0], frames[0] + 40))


def test_in_asynchronous_mode_a_tick_waits_for_the_next_frame(world: carla.World) -> None:
    world.apply_settings(carla.WorldSettings())
    frames = [world.tick() for _ in range(5)]
    assert frames == sorted(set(frames))
    assert world.get_snapshot().frame >= frames[-1]


def test_a_new_fixed_delta_applies_at_once(world: carla.World) -> None:
    def seconds_to_apply() -> float:
        world.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))
        start = time.monotonic()
        world.apply_settings(carla.WorldSettings(synchronous_mode=False, fixed_delta_seconds=0.1))
        return time.monotonic() - start

    wait_until(lambda: seconds_to_apply() < 2.0)  # the client asks 30 times if need be
    assert world.wait_for_tick(PATIENCE).delta_seconds == pytest.approx(0.1)


def test_variable_ticks_are_as_long_as_the_clock_says(world: carla.World) -> None:
    world.apply_settings(carla.WorldSettings())

    def seconds_gained() -> float:
        first, start = world.wait_for_tick(PATIENCE), time.monotonic()
        for _ in range(20):
            last = world.wait_for_tick(PATIENCE)
        return last.elapsed_seconds - first.elapsed_seconds - (time.monotonic() - start)

    wait_until(lambda: abs(seconds_gained()) < 0.3)  # a machine without time for them has shorter ones


def test_a_world_stays_synchronous_when_its_client_dies_as_with_carla(port: int, other_client: carla.Client) -> None:
    subprocess.run([sys.executable, "-c", DYING, str(port)], timeout=PATIENCE, check=False)
    world = other_client.get_world()
    assert world.get_settings().synchronous_mode
    frame = wait_until(lambda: world.get_snapshot().frame)  # in synchronous mode get_world does not wait for the first one
    time.sleep(0.2)
    assert world.tick() == frame + 1
    world.apply_settings(carla.WorldSettings())


def test_a_port_in_use_is_an_error_in_one_line(port: int) -> None:
    expected = f":{port}: cannot be listened at: Address already in use; choose another port with --port"
    assert expected in error("serve", f"--port={port}")
