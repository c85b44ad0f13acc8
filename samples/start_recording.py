"""Record traffic: spawn vehicles, have the traffic manager drive them, and record them for a while.

The vehicles are destroyed before the recording ends, so that a replay leaves the world as empty as it was.
"""

import random
import time

from carla import command
from common import connect, recording_options, traffic_options


def main():
    """Record for a time, or until Ctrl-C."""
    parser = recording_options(__doc__)
    traffic_options(parser)
    parser.add_argument("-n", "--number-of-vehicles", default=10, type=int, metavar="N", help="the number of vehicles")
    parser.add_argument("-t", "--recorder-time", default=0.0, type=float, metavar="T", help="duration in s; 0: until Ctrl-C")
    parser.add_argument("--safe", action="store_true", help="spawn no two-wheelers")
    parser.add_argument("--additional-data", action="store_true", help="record velocities, boxes and physics, too")
    arguments = parser.parse_args()

    client = connect(arguments)
    client.get_trafficmanager(arguments.tm_port)
    print("Recording on file:", client.start_recorder(arguments.recorder_filename, arguments.additional_data))
    vehicles = []
    try:
        vehicles = spawn(client, arguments)
        print(f"spawned {len(vehicles)} vehicles, press Ctrl+C to exit.", flush=True)
        end = time.monotonic() + (arguments.recorder_time or float("inf"))
        while time.monotonic() < end:
            time.sleep(0.1)
    except KeyboardInterrupt:
        pass
    finally:
        client.apply_batch_sync([command.DestroyActor(vehicle) for vehicle in vehicles])
        time.sleep(0.2)  # for a tick, which records that
        client.stop_recorder()  # for which the client does not wait
        client.get_server_version()  # but for this, which comes after it
        print(f"Stopped recording, destroyed {len(vehicles)} vehicles.")


def spawn(client, arguments):
    """Spawn vehicles on autopilot at random spawn points; return their ids."""
    world = client.get_world()
    blueprints = list(world.get_blueprint_library().filter("vehicle.*"))
    if arguments.safe:
        blueprints = [blueprint for blueprint in blueprints if int(blueprint.get_attribute("number_of_wheels")) == 4]
    places = world.get_map().get_spawn_points()
    random.shuffle(places)
    commands = []
    for place in places[: arguments.number_of_vehicles]:
        blueprint = random.choice(blueprints)
        blueprint.set_attribute("role_name", "autopilot")
        commands.append(
            command.SpawnActor(blueprint, place).then(command.SetAutopilot(command.FutureActor, True, arguments.tm_port))
        )
    responses = client.apply_batch_sync(commands)
    for response in responses:
        if response.error:
            print(response.error)
    return [response.actor_id for response in responses if not response.error]


if __name__ == "__main__":
    main()
