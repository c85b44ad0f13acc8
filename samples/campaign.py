"""Simulate a test campaign: a car brakes in front of the hero, a little differently with each seed.

The driver under test reacts late to the brake lights of the car ahead, how late depends on the seed. Each run becomes a
recording in a folder, which `carla-recap check` judges by the rules in `rules.toml`.
"""

import random
from argparse import ArgumentParser
from pathlib import Path

from carla_recap.sim import Transform, VehicleControl, World, load_town
from carla_recap.sim.scenarios.places import spawn_on_lane, straight_section
from carla_recap.sim.traffic import populate

LENGTH = 100.0  # m, of the straight lane on which they drive
CRUISE = 10.0  # m/s, of both
STEP = 0.05  # s, of a tick


class LateDriver:
    """The driver under test: brakes some time after the brake lights of the car ahead are on.

    Args:
        delay: That time in s.
    """

    def __init__(self, delay):
        self.delay = delay
        self.seen_at = None

    def control(self, now, speed, brake_lights):
        """Return the control of the hero at a time in s, for its speed in m/s."""
        if brake_lights and self.seen_at is None:
            self.seen_at = now
        if self.seen_at is not None and now >= self.seen_at + self.delay:
            return VehicleControl(brake=0.6)
        return keep(speed)


def keep(speed):
    """Return the control that keeps the cruising speed."""
    return VehicleControl(throttle=min(max((CRUISE - speed) * 0.4, 0.0), 0.8))


def run(town, seed, path, seconds):
    """Simulate a run, and record it."""
    chance = random.Random(seed)
    gap, brakes_at, force, delay = (chance.uniform(*span) for span in ((9, 16), (4, 6), (0.4, 0.8), (0.2, 1.2)))
    driver = LateDriver(delay)
    with World(town, seed=seed) as world:
        lane, begin = straight_section(world.town, LENGTH)
        hero = spawn_on_lane(world, "vehicle.tesla.model3", lane, begin, "hero")
        ahead = spawn_on_lane(world, "vehicle.audi.tt", lane, begin + gap, "ahead")
        world.spawn("sensor.other.collision", Transform(), parent=hero)
        populate(world, 0, 8)
        world.start_recorder(str(path), additional_data=True)
        for tick in range(round(seconds / STEP)):
            now = tick * STEP
            brakes = now >= brakes_at
            ahead.apply_control(VehicleControl(brake=force) if brakes else keep(ahead.velocity.length()))
            hero.apply_control(driver.control(now, hero.velocity.length(), brakes))
            world.tick()


def main():
    """Simulate all runs."""
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="the folder of the recordings")
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="the number of runs (default: 20)")
    parser.add_argument("--first", type=int, default=1, metavar="SEED", help="the seed of the first run (default: 1)")
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S", help="the length of each (default: 10)")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    town = load_town()
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        path = (arguments.folder / f"seed-{seed:02}.mcap").absolute()
        run(town, seed, path, arguments.seconds)
        print(path)


if __name__ == "__main__":
    main()
