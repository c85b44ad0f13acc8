"""Take pictures by a pair of cameras: of each tick, one in colour and one of what is where.

Both are of the same frame. They are saved as one picture, blended; the colours of classes are those of Cityscapes.
"""

import carla
import numpy as np
from common import DELTA
from pictures import camera_options, drive, pixels, save

EVERY = 10  # ticks; of the others, no picture is saved


def main():
    """Drive, and save pictures."""
    arguments = camera_options(__doc__).parse_args()
    with drive(arguments, "sensor.camera.rgb", "sensor.camera.semantic_segmentation") as (_, _, _, tick):
        for number in range(round(arguments.time / DELTA)):
            color, semantic = tick()
            if number % EVERY:
                continue
            tags = pixels(semantic)[:, :, 0].copy()  # a tag of carla.CityObjectLabel for each pixel
            semantic.convert(carla.ColorConverter.CityScapesPalette)
            blended = (pixels(color) * 0.6 + pixels(semantic) * 0.4).astype(np.uint8)
            save(blended, arguments.out / f"pair_{color.frame:06}.png")
            cars = (tags == int(carla.CityObjectLabel.Car)).mean()
            road = (tags == int(carla.CityObjectLabel.Roads)).mean()
            print(f"frames {color.frame} and {semantic.frame}: {road:.1%} road, {cars:.2%} cars")


if __name__ == "__main__":
    main()
