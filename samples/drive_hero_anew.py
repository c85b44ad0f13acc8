"""Replay a recording without its hero, and let the traffic manager drive a hero from the position of the recorded one.

All other actors follow the recording, independently of the new hero.
"""

import carla
from common import DELTA, connect, recording_options, synchronous, traffic_options


def main():
    """Drive, and print the position of the hero once a second, and its collisions."""
    parser = recording_options(__doc__)
    traffic_options(parser)
    parser.add_argument("-s", "--start", default=0.0, type=float, metavar="S", help="where to start in the recording, in s")
    parser.add_argument("-t", "--time", default=10.0, type=float, metavar="T", help="how long to drive, in s")
    arguments = parser.parse_args()

    client = connect(arguments)
    world = client.get_world()
    traffic = client.get_trafficmanager(arguments.tm_port)
    with synchronous(world, traffic):
        blueprint, transform, velocity = recorded_hero(client, world, arguments)
        client.set_replayer_ignore_hero(True)
        print(client.replay_file(arguments.recorder_filename, arguments.start, 0.0, 0))
        transform.location.z += 0.1
        hero = world.spawn_actor(blueprint, transform)
        sensor = world.spawn_actor(world.get_blueprint_library().find("sensor.other.collision"), carla.Transform(), hero)
        try:
            sensor.listen(lambda event: print(f"the hero collides with {event.other_actor.type_id}"))
            hero.set_target_velocity(velocity)
            hero.set_autopilot(True, arguments.tm_port)
            for number in range(round(arguments.time / DELTA)):
                world.tick()
                if number % round(1 / DELTA) == 0:
                    print_state(arguments.start + number * DELTA, hero)
        finally:
            sensor.destroy()
            hero.destroy()
            client.stop_replayer(False)
            client.set_replayer_ignore_hero(False)


def recorded_hero(client, world, arguments):
    """Return the blueprint, transform and velocity of the recorded hero at the start, from a short replay."""
    client.set_replayer_ignore_hero(False)
    client.set_replayer_time_factor(1.0)
    print(client.replay_file(arguments.recorder_filename, arguments.start, 0.0, 0))
    for _ in range(2):
        world.tick()
    heroes = [actor for actor in world.get_actors().filter("vehicle.*") if actor.attributes.get("role_name") == "hero"]
    if not heroes:
        raise SystemExit(f"{arguments.recorder_filename} has no hero at {arguments.start:g} s")
    hero = heroes[-1]
    blueprint = world.get_blueprint_library().find(hero.type_id)
    blueprint.set_attribute("role_name", "hero")
    found = blueprint, hero.get_transform(), hero.get_velocity()
    client.stop_replayer(False)
    world.tick()
    return found


def print_state(elapsed, hero):
    """Print the position and the speed of the hero."""
    location, speed = hero.get_location(), 3.6 * hero.get_velocity().length()
    print(f"{elapsed:5.1f} s: ({location.x:.1f}, {location.y:.1f}) at {speed:.0f} km/h")


if __name__ == "__main__":
    main()
