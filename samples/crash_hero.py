"""Let a hero collide with a car that has broken down; run it while `start_recording.py` records."""

import queue

import carla
from common import connect, options, spawn_collision_course


def main():
    """Spawn both, drive, and wait for the collision."""
    parser = options(__doc__)
    parser.add_argument("--length", default=50.0, type=float, metavar="M", help="the distance between them in m")
    parser.add_argument(
        "--patience", default=30.0, type=float, metavar="T", help="the longest time to wait for the collision, in s"
    )
    arguments = parser.parse_args()

    client = connect(arguments)
    world = client.get_world()
    hero, obstacle = spawn_collision_course(client, arguments.length)
    sensor = world.spawn_actor(world.get_blueprint_library().find("sensor.other.collision"), carla.Transform(), hero)
    collisions = queue.Queue()
    sensor.listen(collisions.put)
    try:
        hero.apply_control(carla.VehicleControl(throttle=0.7))
        collision = collisions.get(timeout=arguments.patience)
        print(f"hero {hero.id} has run into {collision.other_actor.type_id} {collision.other_actor.id}")
        hero.apply_control(carla.VehicleControl(brake=1.0))
        for _ in range(20):
            world.wait_for_tick()
    except queue.Empty:
        raise SystemExit(f"hero {hero.id} has not run into anything") from None
    finally:
        sensor.stop()
        for actor in (sensor, hero, obstacle):
            actor.destroy()


if __name__ == "__main__":
    main()
