"""The cycle of traffic lights, and the states of lanes."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.sim.actors.lights import TrafficLight
from carla_recap.sim.errors import SimError
from carla_recap.sim.signals import GREEN, OFF, RED, YELLOW
from carla_recap.sim.world import World
from tests.sim.flat import flat_world, lane, light


def crossing() -> tuple[World, list[TrafficLight]]:
    """Three lanes with a light each; the first two lights are green together."""
    lanes = [lane(index, 10.0 * index) for index in range(4)]
    signals = [light(index, (index,), y=10.0 * index + 3) for index in range(3)]
    world = flat_world(lanes=lanes, signals=signals, phases=((0, 1), (2,)))
    return world, world.traffic_lights


def shown(lights: list[TrafficLight]) -> list[int]:
    return [light.state for light in lights]


def test_phases_are_green_in_turn_with_all_red_in_between() -> None:
    world, lights = crossing()
    cycle = [(10, [GREEN, GREEN, RED]), (3, [YELLOW, YELLOW, RED]), (2, [RED, RED, RED])]
    cycle += [(10, [RED, RED, GREEN]), (3, [RED, RED, YELLOW]), (2, [RED, RED, RED])]
    for seconds, states in [*cycle, *cycle]:
        assert shown(lights) == states
        world.run(seconds - 0.05)
        assert shown(lights) == states
        world.run(0.05)


def test_elapsed_time_is_the_time_in_a_state() -> None:
    world, lights = crossing()
    world.run(4)
    assert lights[0].elapsed_time == pytest.approx(4)
    world.run(7)
    assert lights[0].elapsed_time == pytest.approx(1)
    assert lights[2].elapsed_time == pytest.approx(11)


def test_changed_times_are_obeyed_and_are_events() -> None:
    world, lights = crossing()
    world.run(4)
    lights[0].green_time = 5.0
    lights[0].yellow_time = 1.0
    lights[0].red_time = 0.5
    world.run(1)
    assert lights[0].state == YELLOW
    world.run(1)
    assert lights[0].state == RED
    world.run(0.5)
    assert lights[2].state == GREEN
    assert (lights[0].green_time, lights[0].yellow_time, lights[0].red_time) == (5.0, 1.0, 0.5)
    lights[1].red_time = 9.0
    world.tick()
    assert world.events.light_times == [lights[1]]
    with pytest.raises(SimError, match="a green time of -1 s: expected 0 s or more"):
        lights[0].green_time = -1


def test_a_group_can_be_frozen_and_continued() -> None:
    world, lights = crossing()
    world.run(5)
    lights[2].freeze()
    assert [light.frozen for light in lights] == [True] * 3
    world.run(60)
    assert shown(lights) == [GREEN, GREEN, RED]
    assert lights[0].elapsed_time == pytest.approx(5)
    lights[0].freeze(False)
    world.run(5)
    assert shown(lights) == [YELLOW, YELLOW, RED]


def test_a_state_that_is_set_lasts_until_the_next_change_of_the_group() -> None:
    world, lights = crossing()
    world.run(5)
    lights[0].set_state(RED)
    world.run(4.9)
    assert shown(lights) == [RED, GREEN, RED]
    world.run(0.1)
    assert shown(lights) == [YELLOW, YELLOW, RED]


def test_reset_restarts_the_cycle() -> None:
    world, lights = crossing()
    world.run(17)
    lights[0].reset_group()
    assert shown(lights) == [GREEN, GREEN, RED]
    world.run(9.9)
    assert shown(lights) == [GREEN, GREEN, RED]


def test_the_state_of_a_lane_is_that_of_its_strictest_light() -> None:
    lanes = [lane(index, 10.0 * index) for index in range(4)]
    signals = [light(0, (0,), y=5.0), light(1, (0, 1), y=15.0)]
    world = flat_world(lanes=lanes, signals=signals, phases=((0,), (1,)))
    assert world.signals.state_of_lane(np.array([0, 1, 2, 0])).tolist() == [RED, RED, OFF, RED]
    world.traffic_lights[1].state = YELLOW
    assert world.signals.state_of_lane(np.array([0, 1, 2])).tolist() == [YELLOW, YELLOW, OFF]
    world.traffic_lights[1].state = OFF
    assert world.signals.state_of_lane(np.array([0, 1, 2])).tolist() == [GREEN, OFF, OFF]


def test_a_light_without_a_junction_changes_by_itself() -> None:
    world = flat_world(signals=[light(0, (0,))])
    states = []
    for _ in range(16):
        states.append(world.traffic_lights[0].state)
        world.run(1)
    assert states == [GREEN] * 10 + [YELLOW] * 3 + [RED] * 2 + [GREEN]
