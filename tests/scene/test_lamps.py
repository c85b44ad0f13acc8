"""Which lamps of vehicles are lit: by recorded lights and controls, else by how they slow down."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np
import pytest

from carla_recap import open_recording
from carla_recap.replay import Player
from carla_recap.scene.actor_instances import SceneActors
from carla_recap.scene.lamps import (
    BRAKE,
    LEFT_BLINKER,
    REVERSE,
    VehicleLamps,
    lamps_of_lights,
    state_of_lamps,
)
from carla_recap.scene.materials import Material
from tests.replay.scripts import pose, spawn, write

CAR = 1
TICK = 0.1  # s
LIT = 1 << Material.BRAKE_LIGHT


@pytest.fixture
def recorded(tmp_path):
    """Return a function that opens a recording of frames."""
    with ExitStack() as stack:
        yield lambda frames: stack.enter_context(open_recording(write(tmp_path / "x.log", frames, tick=TICK)))


def controlled(*, brakes=(), gear=1, count=30):
    """Return frames of a car at a standstill, and its brake control in the first ones."""
    brakes = [*brakes, *[0.0] * (count - len(brakes))]
    frames = [{"transforms": [pose(CAR)], "vehicle_controls": [(CAR, 0.0, 0.0, brake, 0, gear)]} for brake in brakes]
    frames[0]["spawned"] = [spawn(CAR)]
    return frames


def slowing(deceleration, *, speed=20.0, since=1.0, until=2.0, count=40, velocities=False):
    """Return frames of an imported car, without controls and lights, that slows down for a while."""
    frames, x = [], 0.0
    for number in range(count):
        time = number * TICK
        now = speed - deceleration * min(max(time - since, 0.0), until - since)
        frames.append({"transforms": [pose(CAR, 100 * x)]})
        if velocities:
            frames[-1]["velocities"] = [(CAR, now, 0.0, 0.0, 0.0, 0.0, 0.0)]
        x += now * TICK
    frames[0]["spawned"] = [spawn(CAR)]
    return frames


def flags(recording, lamps=None):
    """Return the times and the flags of the car in all frames."""
    lamps = VehicleLamps() if lamps is None else lamps
    found = [(batch.time, lamps.flags(batch).sum(axis=1)) for batch in Player(recording).batches()]
    time, bits = (np.concatenate(column) for column in zip(*found, strict=True))
    return dict(zip(time.round(3).tolist(), bits.tolist(), strict=True))


def braking_times(found):
    return [time for time, bits in found.items() if bits & BRAKE]


@pytest.mark.parametrize(
    ("brakes", "lit"),
    [
        ([0, 0, 0.021, 0, 0, 0.5, 0], pytest.approx([0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])),  # for half a second
        ([0.019, 0.019], []),  # it is hardly touched
    ],
)
def test_brake_lamps_do_not_flicker(recorded, brakes, lit):
    assert braking_times(flags(recorded(controlled(brakes=brakes)))) == lit


def test_a_reverse_gear_lights_reversing_lamps(recorded):
    assert set(flags(recorded(controlled(gear=-1))).values()) == {REVERSE}


def test_recorded_lights_are_lit_besides_the_brake(recorded):
    frames = controlled(brakes=[1.0])
    for frame in frames[:10]:
        frame["vehicle_lights"] = [(CAR, LEFT_BLINKER)]
    found = flags(recorded(frames))
    assert (found[0.0], found[0.7], found[1.5]) == (BRAKE | LEFT_BLINKER, LEFT_BLINKER, 0)


@pytest.mark.parametrize("velocities", [False, True])
@pytest.mark.parametrize(("deceleration", "lit"), [(6.5, True), (2.0, True), (0.8, False), (-3.0, False), (0.0, False)])
def test_a_car_without_controls_brakes_when_it_slows_down(recorded, deceleration, lit, velocities):
    found = braking_times(flags(recorded(slowing(deceleration, velocities=velocities))))
    assert bool(found) == lit
    if lit:
        assert 1.0 < found[0] < 1.6
        assert 2.2 < found[-1] < 3.1


def test_a_car_whose_lights_are_recorded_off_brakes_without_lamps(recorded):
    frames = slowing(6.5)
    for frame in frames:
        frame["vehicle_lights"] = [(CAR, 0)]
    assert not any(flags(recorded(frames)).values())


@pytest.mark.parametrize("beside", [[], [pose(CAR + 1)]])
def test_a_car_in_every_other_frame_brakes(recorded, beside):
    frames = slowing(6.5)
    for number, frame in enumerate(frames):
        frame["transforms"] = [*beside, *([] if number % 2 else frame["transforms"])]
    found = braking_times(flags(recorded(frames)))
    assert 1.0 < found[0] < 1.6
    assert 2.2 < found[-1] < 3.1


def test_a_new_actor_with_the_id_of_one_that_braked_does_not_brake(recorded):
    frames = controlled(brakes=[1.0] * 5)
    frames[5]["destroyed"] = [CAR]
    frames[6]["spawned"] = [spawn(CAR)]
    found = flags(recorded(frames))
    assert (found[0.4], found[0.7]) == (BRAKE, 0)


@pytest.mark.parametrize(
    "frames",
    [controlled(brakes=[0, 0, 0, 1, 1, 1]), slowing(6.5), slowing(3.0, velocities=True)],
    ids=["pedal", "poses", "speeds"],
)
def test_a_single_moment_is_as_in_the_whole_recording(recorded, frames):
    recording = recorded(frames)
    for time, expected in flags(recording).items():
        actors, player = SceneActors(), Player(recording, start=time)
        actors.recall(player)
        found = actors.at(player.tick(0))
        assert bool(found.lamps[0] & LIT) == bool(expected & BRAKE), time


def test_moments_between_frames_are_as_the_frame_before(recorded):
    recording = recorded(slowing(6.5))
    expected, lamps = flags(recording), VehicleLamps()
    for scene in Player(recording).scenes(40.0):
        bits = int(lamps.flags(scene.batch)[0, 0])
        before = max(time for time in expected if time <= scene.time + 1e-6)
        assert bits <= expected[before], scene.time
        if scene.time == pytest.approx(before):
            assert bits == expected[before]


def test_a_seek_forgets_what_was_before(recorded):
    recording = recorded(controlled(brakes=[0] * 10 + [1.0] * 5))
    lamps = VehicleLamps()
    assert flags(recording, lamps)[1.4] == BRAKE
    assert flags(recording, lamps)[0.0] == 0


def test_the_lamps_of_a_running_simulation_are_held_too():
    lamps, ids, off = VehicleLamps(), np.array([7, 3], np.uint32), np.zeros(2, np.uint32)
    brakes = {0.0: (0.5, 0.0), 0.4: (0.0, 0.0), 0.6: (0.0, 0.3)}
    found = [
        lamps.flags_at(time, ids, off, np.array(values), np.array((False, True))).tolist() for time, values in brakes.items()
    ]
    assert found == [[BRAKE, REVERSE], [BRAKE, REVERSE], [0, BRAKE | REVERSE]]
    gone = lamps.flags_at(0.7, ids[1:], off[1:], np.zeros(1), np.zeros(1, np.bool_))
    assert gone.tolist() == [BRAKE]


def test_the_state_of_a_traffic_light_is_known_by_its_lamps():
    assert [state_of_lamps(int(lamps)) for lamps in lamps_of_lights(np.arange(5))] == [0, 1, 2, 3, 3]
