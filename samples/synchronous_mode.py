"""Drive in synchronous mode: each tick waits for the sensor data of the previous one.

Sensors call back in another thread, and queues pass their data to the thread that ticks: one for the GNSS sensor, which
sends data in each tick, and one for the collision sensor, which sends collisions only.
"""

import carla
from common import DELTA, connect, listen, of_frame, options, spawn_collision_course, synchronous


def main():
    """Drive into a parked car, and print the data of the sensors."""
    parser = options(__doc__)
    parser.add_argument("-t", "--time", default=10.0, type=float, metavar="T", help="how long to drive, in s")
    arguments = parser.parse_args()

    client = connect(arguments)
    world = client.get_world()
    with synchronous(world):
        hero, obstacle = spawn_collision_course(client, 50.0)
        gnss, positions = listen(world, "sensor.other.gnss", hero)
        detector, collisions = listen(world, "sensor.other.collision", hero)
        try:
            hero.apply_control(carla.VehicleControl(throttle=0.6))
            for number in range(round(arguments.time / DELTA)):
                frame = world.tick()
                position = of_frame(positions, frame)
                if number % round(1 / DELTA) == 0:
                    print(f"frame {frame}: {position.latitude:.6f}, {position.longitude:.6f}")
                while not collisions.empty():
                    collision = collisions.get()
                    print(f"frame {collision.frame}: collision with {collision.other_actor.type_id}")
                    hero.apply_control(carla.VehicleControl(brake=1.0))
        finally:
            for actor in (gnss, detector, hero, obstacle):
                actor.destroy()


if __name__ == "__main__":
    main()
