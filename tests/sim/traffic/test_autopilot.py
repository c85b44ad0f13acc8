"""The autopilot: vehicles keep their lane and their distance, stop where they must, and do not collide."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from carla_recap.sim.actors.lights import TrafficLight
from carla_recap.sim.actors.moving import Vehicle, VehicleControl, WalkerControl
from carla_recap.sim.geometry import Location, Transform, Vector
from carla_recap.sim.signals import GREEN, RED, YELLOW
from carla_recap.sim.town.junctions import Conflict, Junction, Signal, SignalKind
from carla_recap.sim.town.lanes import Lane
from carla_recap.sim.traffic.autopilot.junctions import JunctionRules, ReservationRequest, Reservations, StopLine
from carla_recap.sim.world import World
from tests.sim.flat import at, spawn_car
from tests.sim.lanes import LIMIT, lane, ring, small_town

MODEL3 = "vehicle.tesla.model3"
BRAKE, RIGHT_BLINKER, LEFT_BLINKER = 8, 16, 32


def world_of(*lanes: Lane, **others: Any) -> World:
    world = World(small_town(lanes, **others), seed=3, date=0)
    world.settings.collisions_of = "all"
    return world


def car(
    world: World, x: float, y: float = 0.0, *, yaw: float = 0.0, speed: float = 0.0, name: str = MODEL3, drives: bool = True
) -> Vehicle:
    actor = spawn_car(world, at(x, y, yaw=yaw), name, speed=speed)
    actor.set_autopilot(drives)
    return actor


def ticks(world: World, seconds: float) -> Iterator[None]:
    """Tick for some seconds, and expect no collision."""
    for _ in range(round(seconds / world.delta)):
        world.tick()
        assert not world.events.collisions
        yield


def run(world: World, seconds: float) -> None:
    """Tick for some seconds, and expect no collision."""
    for _ in ticks(world, seconds):
        pass


def front(vehicle: Vehicle) -> float:
    return vehicle.transform.location.x + vehicle.box.extent.x


def speed(vehicle: Vehicle) -> float:
    return vehicle.velocity.length()


def offsets(world: World) -> list[float]:
    """Return the distances of the vehicles from the centres of the nearest lanes."""
    x, y, _ = world.vehicles.position.T
    index, s = world.town.nearest_lane(x, y, heading=np.radians(world.vehicles.yaw))
    return [abs(offset) for offset in world.town.project(index, x, y, s)[1].tolist()]


def light(s: float, on: int = 0, governs: tuple[int, ...] = (), kind: SignalKind = SignalKind.LIGHT) -> Signal:
    junction = 1 if governs else None
    return Signal(0, "0", kind, Transform(Location(s, 4.0, 0.0)), None, junction, "0", ((on, s),), governs)


def shown(world: World, state: int) -> TrafficLight:
    """Let the only light of a world stay in a state, and return it."""
    (signal,) = world.traffic_lights
    signal.freeze()
    signal.set_state(state)
    return signal


def crossing() -> tuple[list[Lane], Junction]:
    """Return two lanes that cross in a junction without lights: along x at y = 0, and along y at x = 110."""
    lanes = [
        lane(0, (100, 0), successors=(1,)),
        lane(1, (20, 0), start=(100, 0), successors=(2,), junction=1),
        lane(2, (300, 0), start=(120, 0)),
        lane(3, (100, 0), start=(110, -110), yaw=90, successors=(4,)),
        lane(4, (20, 0), start=(110, -10), yaw=90, successors=(5,), junction=1),
        lane(5, (300, 0), start=(110, 10), yaw=90),
    ]
    conflicts = Conflict(1, 4, 8, 12, False, True), Conflict(4, 1, 8, 12, False, False)
    return lanes, Junction(1, (1, 4), conflicts, ())


@pytest.mark.parametrize(
    ("name", "radius", "most"),
    [(MODEL3, 7.0, 0.5), ("vehicle.carlamotors.firetruck", 12.0, 0.9), ("vehicle.bh.crossbike", 7.0, 0.5)],
)
def test_keeps_its_lane_in_tight_turns_at_a_comfortable_speed(name: str, radius: float, most: float) -> None:
    arc = radius * np.pi / 2
    world = world_of(*ring((40, 0), (arc, 90), (30, 0), (arc, 90)))
    vehicle = car(world, 5.0, name=name)
    errors, sideways, fastest = [], [], 0.0
    for _ in ticks(world, 30.0):
        errors += offsets(world)
        sideways.append(abs(speed(vehicle) * np.radians(vehicle.angular_velocity.z)))
        fastest = max(fastest, speed(vehicle))
    assert max(errors) < most
    assert max(sideways) < 3.5
    assert 5.0 < fastest < 1.06 * LIMIT


@pytest.mark.parametrize("lead", [-8.0, 0.0, 8.0])
def test_long_vehicles_meet_beside_a_narrow_bend_and_not_in_it(lead: float) -> None:
    inner = lane(0, (60, 0), (4 * np.pi, 90), (60, 0))
    outer = lane(1, (60, 0), (6 * np.pi, -90), (60, 0), start=(72.0, 68.0), yaw=-90.0)
    world = world_of(inner, outer)
    one = car(world, 20.0 + lead, name="vehicle.carlamotors.firetruck")
    other = car(world, 72.0, 48.0, yaw=-90.0, name="vehicle.carlamotors.firetruck")
    run(world, 25)
    assert one.transform.location.y > 40
    assert other.transform.location.x < 40


@pytest.mark.parametrize("stops", [(120.0, 160.0), (120.0, 120.0), (90.0, 90.0)])
@pytest.mark.parametrize("red", [0, 1])
def test_of_two_lights_on_a_lane_the_nearest_and_the_strictest_one_acts(stops: tuple[float, float], red: int) -> None:
    in_junction = stops[0] == 90.0
    lanes, junction = crossing() if in_junction else ([lane(0, (300, 0))], None)
    signals = tuple(replace(light(s, governs=(1,) * in_junction), index=index) for index, s in enumerate(stops))
    world = world_of(*lanes, signals=signals, junctions=(junction,) if junction else ())
    for signal in world.traffic_lights:
        signal.freeze()
        signal.set_state(RED if signal.row == red else GREEN)
    vehicle = car(world, 10.0)
    run(world, 25.0)
    assert stops[red] - 1.5 < front(vehicle) < stops[red]


def test_drives_as_fast_as_the_limit_stops_at_red_with_its_brake_lights_on_and_goes_at_green() -> None:
    way = lane(0, (300, 0))
    way.limits[:40] = LIMIT / 2
    world = world_of(way, signals=(light(120.0),))
    vehicle, signal, speeds = car(world, 10.0), shown(world, RED), {}
    for _ in ticks(world, 25.0):
        assert front(vehicle) < 120.0
        speeds[round(vehicle.transform.location.x)] = speed(vehicle)
    assert 0.8 * LIMIT < max(speeds.values()) < 1.06 * LIMIT
    assert 0.8 * LIMIT / 2 < max(each for x, each in speeds.items() if x < 40) < 1.06 * LIMIT / 2 < 0.8 * speeds[55]
    stands = front(vehicle)
    run(world, 10.0)
    assert front(vehicle) == stands
    assert stands > 117.0
    assert speed(vehicle) < 0.01
    assert vehicle.light_state & BRAKE
    signal.set_state(GREEN)
    run(world, 5.0)
    assert front(vehicle) > 125.0
    assert not vehicle.light_state & BRAKE


@pytest.mark.parametrize(("distance", "stops"), [(8.0, False), (60.0, True)])
def test_stops_at_yellow_only_if_the_distance_suffices(distance: float, stops: bool) -> None:
    world = world_of(lane(0, (300, 0)), signals=(light(120.0),))
    vehicle, signal = car(world, 10.0), shown(world, GREEN)
    for _ in ticks(world, 30.0):
        if front(vehicle) > 120.0 - distance:
            signal.set_state(YELLOW)
    assert (front(vehicle) < 120.0) == stops


@pytest.mark.parametrize("state", [YELLOW, RED])
def test_waits_if_the_light_changes_while_it_stands_right_at_the_line(state: int) -> None:
    """It stands behind another car, less than 0.8 m before the line, and was to go on."""
    world = world_of(lane(0, (300, 0)), signals=(light(120.0),))
    signal = shown(world, GREEN)
    ahead = car(world, 124.2, drives=False)
    vehicle = car(world, 100.0)
    run(world, 10.0)
    stands = front(vehicle)
    assert 119.3 < stands < 120.0
    signal.set_state(state)
    ahead.destroy()
    run(world, 10.0)
    assert front(vehicle) == pytest.approx(stands, abs=0.1)
    signal.set_state(GREEN)
    run(world, 5.0)
    assert front(vehicle) > 125.0


@pytest.mark.parametrize(("length", "name"), [(11.1, "vehicle.carlamotors.firetruck"), (8.0, MODEL3)])
def test_stops_at_a_red_light_on_a_short_road_between_two_junctions(length: float, name: str) -> None:
    entry = 110.0 + length
    lanes = [
        lane(0, (100, 0), successors=(1,)),
        lane(1, (10, 0), start=(100, 0), successors=(2,), junction=1),
        lane(2, (length, 0), start=(110, 0), successors=(3,)),
        lane(3, (10, 0), start=(entry, 0), successors=(4,), junction=2),
        lane(4, (200, 0), start=(entry + 10, 0)),
    ]
    junctions = Junction(1, (1,), (), ()), Junction(2, (3,), (), ())
    world = world_of(*lanes, signals=(light(length, 2, (3,)),), junctions=junctions)
    vehicle, signal = car(world, 60.0, name=name), shown(world, RED)
    for _ in ticks(world, 25.0):
        assert front(vehicle) < entry
    assert front(vehicle) > entry - 2.0
    signal.set_state(GREEN)
    run(world, 8.0)
    assert front(vehicle) > entry + 10


def test_stops_at_a_stop_sign_and_continues() -> None:
    lanes, junction = crossing()
    world = world_of(*lanes, signals=(light(100.0, 0, (1,), SignalKind.STOP),), junctions=(junction,))
    vehicle = car(world, 20.0)
    slowest_at_line = min(speed(vehicle) for _ in ticks(world, 25.0) if 96.0 < front(vehicle) < 100.0)
    assert slowest_at_line < 0.3
    assert front(vehicle) > 130.0


def test_keeps_a_distance_that_grows_with_the_speed() -> None:
    world = world_of(lane(0, (900, 0)))
    leader, vehicle = car(world, 60.0, drives=False, name="vehicle.carlamotors.firetruck"), car(world, 10.0)
    leader.set_simulate_physics(False)
    x, gaps = 60.0, []
    for number, _ in enumerate(ticks(world, 40.0)):
        pace = 8.0 if number < 500 else 0.0
        x += pace * world.delta
        leader.transform = at(x)
        leader.set_target_velocity(Vector(pace, 0.0, 0.0))
        gaps.append(x - leader.box.extent.x - front(vehicle))
    assert min(gaps) > 1.0
    assert 8.0 < gaps[499] < 22.0
    assert 1.0 < gaps[-1] < 4.0


def test_lets_a_walker_cross_and_continues() -> None:
    world = world_of(lane(0, (300, 0)))
    vehicle = car(world, 10.0)
    walker = world.spawn("walker.pedestrian.0001", at(70.0, -6.0, z=0.9))
    for _ in ticks(world, 25.0):
        if front(vehicle) > 35.0 and walker.transform.location.y < 6.0:
            walker.apply_control(WalkerControl(Vector(0.0, 1.0, 0.0), 1.2))
        elif walker.transform.location.y >= 6.0:
            walker.apply_control(WalkerControl())
    assert walker.transform.location.y >= 6.0
    assert not walker.has_fallen
    assert front(vehicle) > 90.0


@pytest.mark.parametrize(
    ("name", "aside", "yaw"),
    [("static.prop.streetbarrier", 0.0, yaw) for yaw in (0.0, 90.0)] + [("walker.pedestrian.0001", 1.5, 0.0)],
)
def test_stops_before_what_is_on_the_road(name: str, aside: float, yaw: float) -> None:
    world, road = world_of(lane(0, (300, 0), yaw=yaw)), at(0.0, yaw=yaw)
    place = road.transform(Location(10.0))
    vehicle = car(world, place.x, place.y, yaw=yaw)
    place = road.transform(Location(90.0, aside))
    world.spawn(name, at(place.x, place.y, yaw))
    run(world, 20.0)
    assert 85.0 < vehicle.transform.location.distance(Location()) + vehicle.box.extent.x < 90.0
    assert speed(vehicle) < 0.05


def test_does_not_enter_a_junction_that_it_could_not_leave() -> None:
    lanes, junction = crossing()
    world = world_of(*lanes, junctions=(junction,))
    blocking, _ = car(world, 124.0, drives=False), car(world, 145.0, drives=False)
    waiting, crossing_car = car(world, 60.0), car(world, 110.0, -60.0, yaw=90.0)
    run(world, 20.0)
    assert 95.0 < front(waiting) < 100.0
    assert crossing_car.transform.location.y > 15.0
    blocking.destroy()
    run(world, 15.0)
    assert front(waiting) > 125.0


def test_the_vehicle_with_priority_goes_first() -> None:
    lanes, junction = crossing()
    world = world_of(*lanes, junctions=(junction,))
    yielding, other = car(world, 92.0), car(world, 110.0, -18.0, yaw=90.0)
    run(world, 6.0)
    assert front(yielding) < 100.0
    assert other.transform.location.y > -5.0
    run(world, 8.0)
    assert front(yielding) > 120.0


@pytest.mark.parametrize(("standing", "rear", "goes"), [(11.0, 105.0, True), (9.0, 105.0, False), (11.0, 95.0, False)])
def test_after_long_a_vehicle_goes_beside_one_that_is_stuck(standing: float, rear: float, goes: bool) -> None:
    lanes, junction = crossing()
    reservations = Reservations(
        JunctionRules.of(small_town(lanes, junctions=(junction,))), lambda id: rear, lambda id: standing
    )
    reservations.reserve(1, StopLine(100.0, ((4, 100.0),), 120.0, ()), 5.0)
    request = ReservationRequest(2, StopLine(100.0, ((1, 100.0),), 120.0, ()), 0.0, 1.0, 5.0, 30.0)
    assert bool(reservations.grant([request], 21.0, lambda line: 30.0)) == goes


def test_a_destroyed_vehicle_releases_its_reservations() -> None:
    lanes, junction = crossing()
    world = world_of(*lanes, junctions=(junction,))
    inside, waiting = car(world, 116.0, name="vehicle.carlamotors.firetruck"), car(world, 110.0, -25.0, yaw=90.0)
    car(world, 123.6, drives=False)
    run(world, 8.0)
    assert waiting.transform.location.y < -12.0
    inside.destroy()
    run(world, 15.0)
    assert waiting.transform.location.y > 15.0


@pytest.mark.parametrize(("side", "bit"), [("left", LEFT_BLINKER), ("right", RIGHT_BLINKER)])
def test_indicates_turns(side: str, bit: int) -> None:
    sign = 1 if side == "right" else -1
    lanes = [
        lane(0, (80, 0), successors=(1,)),
        lane(1, (16, 90 * sign), start=(80, 0), successors=(2,), junction=1, turn="right" if sign > 0 else "left"),
    ]
    x, y, _ = lanes[1].points[-1].tolist()
    world = world_of(*lanes, lane(2, (100, 0), start=(x, y), yaw=90.0 * sign), junctions=(Junction(1, (1,), (), ()),))
    vehicle = car(world, 10.0)
    vehicle.light_state = 3
    seen = {}
    for _ in ticks(world, 20.0):
        seen[round(vehicle.transform.location.x), round(sign * vehicle.transform.location.y)] = vehicle.light_state & ~BRAKE
    assert seen[30, 0] == 3
    assert seen[70, 0] == 3 | bit
    assert min(x for (x, _), lights in seen.items() if lights & bit) == pytest.approx(80 - 30 - 1, abs=2)  # of its front end
    assert vehicle.light_state & ~BRAKE == 3
    assert vehicle.transform.rotation.yaw == pytest.approx(90.0 * sign, abs=1.0)


@pytest.mark.parametrize(("changes", "overtakes"), [((0, 500), True), ((110, 160), True), ((200, 500), False)])
def test_overtakes_a_standing_vehicle_where_the_marking_allows_it(changes: tuple[int, int], overtakes: bool) -> None:
    world = world_of(lane(0, (500, 0), right=1), lane(1, (500, 0), start=(0, 3.5), left=0, changes=changes))
    standing, vehicle = car(world, 150.0, 3.5, drives=False), car(world, 20.0, 3.5)
    standing.apply_control(VehicleControl(hand_brake=True))
    bits = 0
    for _ in ticks(world, 30.0):
        bits |= vehicle.light_state
    assert (vehicle.transform.location.x > 180.0) == overtakes
    if not overtakes:
        return
    assert vehicle.transform.location.y == pytest.approx(0.0, abs=0.3)
    assert bits & LEFT_BLINKER
    assert not bits & RIGHT_BLINKER


def test_does_not_change_to_a_lane_that_another_vehicle_occupies() -> None:
    world = world_of(lane(0, (500, 0), right=1), lane(1, (500, 0), start=(0, 3.5), left=0))
    vehicle = car(world, 100.0, 3.5)
    car(world, 102.5, drives=False)
    car(world, 115.0, 3.5, drives=False)
    bits = 0
    for _ in ticks(world, 12.0):
        bits |= vehicle.light_state
    assert not bits & LEFT_BLINKER
    assert 107.0 < vehicle.transform.location.x < 110.0


def test_takes_over_at_speed_without_a_jerk() -> None:
    world = world_of(lane(0, (600, 0)))
    vehicle = car(world, 50.0, 0.8, yaw=4.0, speed=11.0, drives=False)
    vehicle.apply_control(VehicleControl(throttle=0.3))
    world.tick()
    vehicle.set_autopilot()
    along, sideways = [], []
    for _ in ticks(world, 8.0):
        along.append(vehicle.acceleration.x)
        sideways.append(abs(speed(vehicle) * np.radians(vehicle.angular_velocity.z)))
    assert max(map(abs, along)) < 2.0
    assert max(sideways) < 2.5
    assert abs(vehicle.transform.location.y) < 0.1
    assert speed(vehicle) > 9.0


@pytest.mark.parametrize(("y", "yaw"), [(9.0, 0.0), (-6.0, 60.0), (4.0, 100.0)])
def test_returns_to_the_road(y: float, yaw: float) -> None:
    world = world_of(lane(0, (600, 0)))
    vehicle = car(world, 50.0, y, yaw=yaw)
    run(world, 20.0)
    assert abs(vehicle.transform.location.y) < 0.2
    assert vehicle.transform.location.x > 80.0


def test_stands_off_the_road_and_at_its_end() -> None:
    world = world_of(lane(0, (100, 0)))
    lost, driving = car(world, 50.0, 90.0, speed=8.0), car(world, 10.0)
    run(world, 25.0)
    assert lost.transform.location.x < 70.0
    assert speed(lost) == pytest.approx(0.0, abs=0.01)
    assert 95.0 < front(driving) < 100.0
    assert speed(driving) < 0.05


def test_does_not_control_a_vehicle_that_has_it_switched_off() -> None:
    world = world_of(lane(0, (600, 0)))
    vehicle = car(world, 10.0)
    run(world, 3.0)
    vehicle.set_autopilot(False)
    vehicle.apply_control(VehicleControl(brake=1.0))
    run(world, 5.0)
    assert speed(vehicle) == pytest.approx(0.0, abs=0.01)
    assert vehicle.control.brake == 1.0
