"""Functions for campaigns: a car brakes in front of the hero, and a pedestrian crosses the street in front of it.

`carla-recap campaign samples/campaign.py:follow --seeds 1:20 --out runs` runs the first one with 20 seeds, each run a
recording. The driver under test sees late what happens ahead; how late is a parameter.
"""

import math

from carla_recap.sim import Location, Rotation, Transform, Vector, VehicleControl, WalkerControl
from carla_recap.sim.scenarios import point_on_lane, spawn_on_lane, straight_section
from carla_recap.sim.traffic import populate

LENGTH = 100.0  # m, of the straight lane on which they drive
CRUISE = 10.0  # m/s
STEP_OUT = 4.5  # m, from the middle of the lane to where the pedestrian waits
SIGHT = 25.0  # m ahead, within which the driver sees a pedestrian on the lane


class LateDriver:
    """The driver under test: brakes some time after it could have seen the reason.

    Args:
        delay: That time in s.
        speed: Its cruising speed in m/s.
    """

    def __init__(self, delay, speed=CRUISE):
        self.delay = delay
        self.cruise = speed
        self.seen_at = None

    def control(self, now, speed, reason):
        """Return the control of the hero at a time in s, for its speed in m/s."""
        if reason and self.seen_at is None:
            self.seen_at = now
        if self.seen_at is not None and now >= self.seen_at + self.delay:
            return VehicleControl(brake=0.6)
        return keep(speed, self.cruise)


def keep(speed, cruise=CRUISE):
    """Return the control that keeps a cruising speed."""
    return VehicleControl(throttle=min(max((cruise - speed) * 0.4, 0.0), 0.8))


def follow(world, delay=None, gap=None, seconds=10.0):
    """Let the car ahead brake; what is not given depends on the seed."""
    drawn = [float(world.random.uniform(*span)) for span in ((9, 16), (4, 6), (0.4, 0.8), (0.2, 1.2))]
    gap, delay = gap or drawn[0], delay or drawn[3]
    brakes_at, force = drawn[1:3]
    driver = LateDriver(delay)
    lane, begin = straight_section(world.town, LENGTH)
    hero = spawn_on_lane(world, "vehicle.tesla.model3", lane, begin, "hero")
    ahead = spawn_on_lane(world, "vehicle.audi.tt", lane, begin + gap, "ahead")
    world.spawn("sensor.other.collision", Transform(), parent=hero)
    populate(world, 0, 8)
    while world.elapsed < seconds:
        brakes = world.elapsed >= brakes_at
        ahead.apply_control(VehicleControl(brake=force) if brakes else keep(ahead.velocity.length()))
        hero.apply_control(driver.control(world.elapsed, hero.velocity.length(), brakes))
        world.tick()


def pedestrian(world, delay=3.0, speed=1.5, reaction=0.8, seconds=12.0):
    """Let a pedestrian step onto the street after a delay in s, and cross it at a speed in m/s."""
    driver = LateDriver(reaction)
    lane, begin = straight_section(world.town, LENGTH)
    hero = spawn_on_lane(world, "vehicle.tesla.model3", lane, begin, "hero")
    world.spawn("sensor.other.collision", Transform(), parent=hero)
    point, heading = point_on_lane(lane, begin + 60.0)
    right = Vector(-math.sin(heading), math.cos(heading), 0.0)
    place = Location(point.x + STEP_OUT * right.x, point.y + STEP_OUT * right.y, point.z + 1.0)
    walker = world.spawn("walker.pedestrian.0004", Transform(place, Rotation(yaw=math.degrees(heading) - 90.0)))
    while world.elapsed < seconds:
        if world.elapsed >= delay:
            walker.apply_control(WalkerControl(Vector(-right.x, -right.y, 0.0), speed))
        place = walker.transform.location
        aside = abs((place.x - point.x) * right.x + (place.y - point.y) * right.y)
        is_seen = aside < lane.width / 2 and place.distance(hero.transform.location) < SIGHT
        hero.apply_control(driver.control(world.elapsed, hero.velocity.length(), is_seen))
        world.tick()
