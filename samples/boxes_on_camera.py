"""Draw the 3D boxes of vehicles into the image of a camera.

Of each vehicle, the rectangle around its box in the image is printed, and the one around its own pixels, which a camera for
instance segmentation finds.
"""

import numpy as np
from common import DELTA
from pictures import camera_options, drive, pixels, project, save
from PIL import Image, ImageDraw

EVERY = 10  # ticks; of the others, no picture is saved
FARTHEST = 60.0  # m
EDGES = ((0, 1), (1, 3), (3, 2), (2, 0), (4, 5), (5, 7), (7, 6), (6, 4), (0, 4), (1, 5), (2, 6), (3, 7))
GREEN = (80, 255, 120)


def main():
    """Drive, and save pictures."""
    arguments = camera_options(__doc__).parse_args()
    names = "sensor.camera.rgb", "sensor.camera.instance_segmentation"
    with drive(arguments, *names) as (world, hero, _, tick):
        for number in range(round(arguments.time / DELTA)):
            color, instances = tick()
            if number % EVERY:
                continue
            picture = Image.fromarray(pixels(color))
            _, low, high = np.moveaxis(pixels(instances).astype(int), -1, 0)
            for vehicle in world.get_actors().filter("vehicle.*"):
                if vehicle.id == hero.id or vehicle.get_location().distance(hero.get_location()) > FARTHEST:
                    continue
                corners = vehicle.bounding_box.get_world_vertices(vehicle.get_transform())
                box = project(np.array([(corner.x, corner.y, corner.z) for corner in corners]), color)
                shown = (low + 256 * high == vehicle.id & 0xFFFF) & (pixels(instances)[:, :, 0] != 0)
                if (box[:, 2] < 0.5).any() or not shown.any():
                    continue
                draw(picture, box)
                rows, columns = np.nonzero(shown)
                around = [box[:, 0].min(), box[:, 1].min(), box[:, 0].max(), box[:, 1].max()]
                own = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
                distance = vehicle.get_location().distance(hero.get_location())
                print(f"frame {color.frame}: {vehicle.type_id} {vehicle.id} at {distance:.1f} m: ", end="")
                print(f"box {' '.join(f'{value:.1f}' for value in around)}, pixels {' '.join(map(str, own))}")
            save(np.array(picture), arguments.out / f"boxes_{color.frame:06}.png")


def draw(picture, box):
    """Draw the edges of a projected box."""
    pen = ImageDraw.Draw(picture)
    for start, stop in EDGES:
        pen.line([tuple(box[start, :2]), tuple(box[stop, :2])], fill=GREEN, width=2)


if __name__ == "__main__":
    main()
