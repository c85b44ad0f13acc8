"""Functions that the sample scripts share: options, connecting, synchronous mode, sensors, and a collision course."""

import queue
import socket
import time
from argparse import ArgumentDefaultsHelpFormatter, ArgumentParser
from contextlib import contextmanager

import carla

DELTA = 0.05  # s, the length of a tick in synchronous mode
HEIGHT = 0.5  # m above the road, where vehicles are spawned


def options(description):
    """Return a parser with the options of all scripts."""
    parser = ArgumentParser(description=description.splitlines()[0], formatter_class=ArgumentDefaultsHelpFormatter)
    parser.add_argument("--host", default="127.0.0.1", metavar="H", help="the address of the server")
    parser.add_argument("-p", "--port", default=2000, type=int, metavar="P", help="its port")
    return parser


def recording_options(description):
    """Return a parser with the options of scripts about a recording."""
    parser = options(description)
    parser.add_argument("-f", "--recorder-filename", default="test1.log", metavar="F", help="the recording")
    return parser


def traffic_options(parser):
    """Add the options of scripts with a traffic manager."""
    parser.add_argument("--tm-port", default=8000, type=int, metavar="P", help="the port of the traffic manager")


def connect(arguments):
    """Return a client of the server, which may be starting: a client waits in vain for one that does not listen yet."""
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        try:
            socket.create_connection((arguments.host, arguments.port), 1.0).close()
            break
        except OSError:
            time.sleep(0.1)
    client = carla.Client(arguments.host, arguments.port)
    client.set_timeout(60.0)
    return client


@contextmanager
def synchronous(world, traffic=None):
    """Switch the world, and the traffic manager if there is one, to synchronous mode, and back afterwards."""
    before = world.get_settings()
    settings = world.get_settings()
    settings.synchronous_mode = True
    settings.fixed_delta_seconds = DELTA
    world.apply_settings(settings)
    if traffic is not None:
        traffic.set_synchronous_mode(True)
    try:
        yield
    finally:
        if traffic is not None:
            traffic.set_synchronous_mode(False)
        world.apply_settings(before)


def straight_roads(world, length):
    """Yield the ends of straight lanes of a length in m, as pairs of transforms for vehicles."""
    for start in world.get_map().get_spawn_points():
        for end in world.get_map().get_waypoint(start.location).next(length):
            location = end.transform.location + carla.Location(z=HEIGHT)
            is_straight = abs(location.distance(start.location) - length) < 0.01 * length
            if is_straight and start.get_forward_vector().dot(end.transform.get_forward_vector()) > 0.9999:
                yield start, carla.Transform(location, end.transform.rotation)


def spawn_collision_course(client, length):
    """Spawn a hero, and a car with its hand brake on at a distance in m straight ahead of it."""
    world = client.get_world()
    blueprints = world.get_blueprint_library()
    hero_blueprint = blueprints.find("vehicle.tesla.model3")
    hero_blueprint.set_attribute("role_name", "hero")
    for start, end in straight_roads(world, length):
        hero = world.try_spawn_actor(hero_blueprint, start)
        if hero is None:
            continue
        obstacle = world.try_spawn_actor(blueprints.find("vehicle.audi.tt"), end)
        if obstacle is not None:
            obstacle.apply_control(carla.VehicleControl(hand_brake=True))
            return hero, obstacle
        # `destroy` has no effect on an actor that the client has not yet seen in a tick.
        client.apply_batch_sync([carla.command.DestroyActor(hero)], False)
    raise SystemExit(f"{world.get_map().name} has no straight lane of {length:g} m that is free")


def listen(world, name, vehicle, place=None, **attributes):
    """Attach a sensor to a vehicle; return it, and the queue of its data."""
    blueprint = world.get_blueprint_library().find(name)
    for key, value in attributes.items():
        blueprint.set_attribute(key, str(value))
    sensor = world.spawn_actor(blueprint, place or carla.Transform(), vehicle)
    data = queue.Queue()
    sensor.listen(data.put)
    return sensor, data


def of_frame(data, frame):
    """Return the data of a sensor for a frame, and drop older data."""
    while (item := data.get(timeout=60.0)).frame < frame:
        pass
    return item
