"""Draw the points of a lidar into the image of a camera.

Both are at the same point, so that they see the same: each point falls on a pixel of its own class.
"""

import numpy as np
from common import DELTA
from pictures import camera_options, drive, pixels, project, save

EVERY = 10  # ticks; of the others, no picture is saved
POINT = np.dtype([("location", "<f4", 3), ("cosine", "<f4"), ("actor", "<u4"), ("tag", "<u4")])
LIDAR = {"channels": 48, "range": 60.0, "points_per_second": 480_000, "upper_fov": 5.0, "lower_fov": -28.0}
NEAR, FAR = 3.0, 50.0  # m


def main():
    """Drive, and save pictures."""
    arguments = camera_options(__doc__).parse_args()
    names = "sensor.camera.rgb", "sensor.camera.semantic_segmentation", "sensor.lidar.ray_cast_semantic"
    with drive(arguments, *names, rotation_frequency=1 / DELTA, **LIDAR) as (_, _, _, tick):
        for number in range(round(arguments.time / DELTA)):
            color, semantic, scan = tick()
            if number % EVERY:
                continue
            points = np.frombuffer(scan.raw_data, POINT)
            placed = np.column_stack((points["location"], np.ones(len(points)))) @ np.array(scan.transform.get_matrix()).T
            x, y, depth = project(placed[:, :3], color).T
            inside = (depth > 0.5) & (x >= 0) & (x < color.width) & (y >= 0) & (y < color.height)
            columns, rows = x[inside].astype(int), y[inside].astype(int)
            same = pixels(semantic)[rows, columns, 0] == points["tag"][inside]
            picture = pixels(color).copy()
            for right, down in ((0, 0), (1, 0), (0, 1), (1, 1)):  # a dot of four pixels
                picture[np.minimum(rows + down, color.height - 1), np.minimum(columns + right, color.width - 1)] = rainbow(
                    depth[inside]
                )
            save(picture, arguments.out / f"lidar_{color.frame:06}.png")
            print(f"frame {color.frame}: {inside.sum()} points in the image, {same.mean():.1%} on their own class")


def rainbow(depth):
    """Return a colour for each depth in m: red is near, blue is far."""
    share = np.clip((np.log(np.maximum(depth, NEAR)) - np.log(NEAR)) / np.log(FAR / NEAR), 0, 1)
    red, green, blue = 2 - 4 * share, 2 - np.abs(4 * share - 2), 4 * share - 2
    return (255 * np.clip(np.column_stack((red, green, blue)), 0, 1)).astype(np.uint8)


if __name__ == "__main__":
    main()
