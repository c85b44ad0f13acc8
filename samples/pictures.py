"""Functions that the scripts with cameras share: a drive past others, pixels, and where points are in an image."""

from argparse import ArgumentTypeError
from contextlib import contextmanager
from pathlib import Path

import carla
import numpy as np
from common import connect, listen, of_frame, options, spawn_collision_course, synchronous
from PIL import Image

WIDTH, HEIGHT = 800, 600  # pixels
FOV = 90.0  # degrees, horizontal
BONNET = carla.Transform(carla.Location(x=2.2, z=1.6))
COURSE = 30.0  # m from the hero to the parked car
OTHERS = (
    ("vehicle.carlamotors.firetruck", 27.0, -3.5, 180.0),
    ("vehicle.gazelle.omafiets", 13.0, 2.2, 0.0),
    ("vehicle.mercedes.sprinter", 15.0, -3.5, 180.0),
    ("walker.pedestrian.0002", 11.0, 4.2, 0.0),
    ("walker.pedestrian.0048", 19.0, 4.6, 150.0),
    ("walker.pedestrian.0019", 22.0, 4.0, 200.0),
    ("static.prop.trafficcone01", 26.0, 1.6, 0.0),
)
"""What stands along the road: metres ahead of the hero and to its right, and degrees from its direction."""


def new_folder(name):
    """Return a folder, which is made if it is missing."""
    try:
        Path(name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ArgumentTypeError(f"{name}: {error.strerror}") from None
    return Path(name)


def camera_options(description):
    """Return a parser with the options of scripts with cameras."""
    parser = options(description)
    parser.add_argument(
        "-o", "--out", default="pictures", type=new_folder, metavar="FOLDER", help="where the pictures are saved"
    )
    parser.add_argument("-t", "--time", default=3.0, type=float, metavar="T", help="how long to drive, in s")
    return parser


@contextmanager
def drive(arguments, *names, **attributes):
    """Have a hero drive towards a parked car, with sensors on its bonnet, in synchronous mode.

    Args:
        arguments: The options.
        names: The blueprints of the sensors.
        attributes: The attributes of the sensors that have them.

    Yields:
        The world, the hero, the sensors, and a function that ticks and returns the data of each sensor for that tick.
    """
    client = connect(arguments)
    world = client.get_world()
    attributes |= {"image_size_x": WIDTH, "image_size_y": HEIGHT, "fov": FOV}
    actors = []
    with synchronous(world):
        try:
            hero, obstacle = spawn_collision_course(client, COURSE)
            actors += [hero, obstacle]
            world.tick()  # after which the hero has its transform
            actors += list(spawn_others(world, hero.get_transform()))
            sensors, queues = [], []
            for name in names:
                blueprint = world.get_blueprint_library().find(name)
                chosen = {key: value for key, value in attributes.items() if blueprint.has_attribute(key)}
                sensor, data = listen(world, name, hero, BONNET, **chosen)
                sensors.append(sensor)
                actors.append(sensor)
                queues.append(data)
            hero.apply_control(carla.VehicleControl(throttle=0.4))

            def tick():
                frame = world.tick()
                return [of_frame(data, frame) for data in queues]

            yield world, hero, sensors, tick
        finally:
            for actor in reversed(actors):
                actor.destroy()


def spawn_others(world, start):
    """Spawn what stands along the road, as far as there is room for it, and yield it."""
    ahead, right = start.get_forward_vector(), start.get_right_vector()
    for name, distance, aside, turn in OTHERS:
        place = start.location + ahead * distance + right * aside
        place.z += 1.0 if name.startswith("walker") else 0.3
        rotation = carla.Rotation(yaw=start.rotation.yaw + turn)
        actor = world.try_spawn_actor(world.get_blueprint_library().find(name), carla.Transform(place, rotation))
        if actor is not None:
            yield actor


def pixels(image):
    """Return the red, green and blue of each pixel, (height, width, 3)."""
    return np.frombuffer(image.raw_data, np.uint8).reshape(image.height, image.width, 4)[:, :, 2::-1]


def project(points, image):
    """Return where points are in an image: x to the right and y down in pixels, and the depth in m, (n, 3).

    Args:
        points: The points in the world, (n, 3).
        image: The image, which knows where its camera was.
    """
    inverse = np.array(image.transform.get_inverse_matrix())
    forward, right, up = (np.column_stack((points, np.ones(len(points)))) @ inverse.T)[:, :3].T
    focal_length = image.width / 2 / np.tan(np.radians(image.fov) / 2)
    depth = np.where(np.abs(forward) < 1e-6, 1e-6, forward)
    x = image.width / 2 + focal_length * right / depth
    y = image.height / 2 - focal_length * up / depth
    return np.column_stack((x, y, forward))


def save(array, path):
    """Save red, green and blue of pixels as a picture."""
    Image.fromarray(np.ascontiguousarray(array)).save(path)
