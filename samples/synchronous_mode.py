"""Drive in synchronous mode: each tick waits for what the sensors say of the one before.

A sensor calls back from another thread. Queues bring its data to the thread that ticks: one for the GNSS sensor, which
tells of each tick, and one for the collision sensor, which tells of collisions alone.
"""

import queue

import carla
from common import DELTA, connect, options, spawn_collision_course, synchronous


def main():
    """Drive into a parked car, and print what the sensors say."""
    parser = options(__doc__)
    parser.add_argument("-t", "--time", default=10.0, type=float, metavar="T", help="how many seconds to drive")
    arguments = parser.parse_args()

    client = connect(arguments)
    world = client.get_world()
    with synchronous(world):
        hero, obstacle = spawn_collision_course(client, 50.0)
        gnss, places = listen(world, "sensor.other.gnss", hero)
        detector, collisions = listen(world, "sensor.other.collision", hero)
        try:
            hero.apply_control(carla.VehicleControl(throttle=0.6))
            for number in range(round(arguments.time / DELTA)):
                frame = world.tick()
                place = of_frame(places, frame)
                if number % round(1 / DELTA) == 0:
                    print(f"frame {frame}: {place.latitude:.6f}, {place.longitude:.6f}")
                while not collisions.empty():
                    collision = collisions.get()
                    print(f"frame {collision.frame}: collision with {collision.other_actor.type_id}")
                    hero.apply_control(carla.VehicleControl(brake=1.0))
        finally:
            for actor in (gnss, detector, hero, obstacle):
                actor.destroy()


def listen(world, name, vehicle):
    """Attach a sensor to a vehicle; returns it, and the queue of its data."""
    sensor = world.spawn_actor(world.get_blueprint_library().find(name), carla.Transform(), vehicle)
    data = queue.Queue()
    sensor.listen(data.put)
    return sensor, data


def of_frame(data, frame):
    """What a sensor says of a frame; what it said of those before is dropped."""
    while (item := data.get(timeout=5.0)).frame < frame:
        pass
    return item


if __name__ == "__main__":
    main()
