#!/usr/bin/env python3
"""Draw the labels of a frame of a KITTI dataset on its image: classes, distances, boxes in the world and in the image.

usage: show_labels.py DATASET FRAME [PICTURE]

DATASET is the folder, FRAME the name of a frame, such as 000003. Without PICTURE, the picture is FRAME.png.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw

COLORS = {"Car": "#ffb020", "Van": "#3cc8e8", "Truck": "#3cc8e8", "Pedestrian": "#6ee07a", "Cyclist": "#e070e0"}
OTHER = "#ffffff"
EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
NEAREST = 0.1  # m; edges that are nearer to the camera are cut there


class Label(NamedTuple):
    """A road user in an image, as a line of `label_2` describes it: m and radians, in the axes of the camera."""

    kind: str
    truncated: float
    occluded: int
    box: tuple[float, ...]  # left, top, right, bottom in pixels
    size: tuple[float, ...]  # height, width, length
    bottom: tuple[float, ...]  # the centre of the lower face: to the right, down, forward
    rotation: float

    @classmethod
    def of(cls, line):
        """Return the label of a line."""
        kind, *words = line.split()
        values = [float(word) for word in words]
        box, size, bottom = values[3:7], values[7:10], values[10:13]
        return cls(kind, values[0], int(values[1]), tuple(box), tuple(size), tuple(bottom), values[13])

    def corners(self):
        """Return the corners of the box, (8, 3), those of the lower face first."""
        height, width, length = self.size
        forward = np.array((1, 1, -1, -1, 1, 1, -1, -1)) * length / 2
        aside = np.array((1, -1, -1, 1, 1, -1, -1, 1)) * width / 2
        down = np.array((0, 0, 0, 0, -1, -1, -1, -1)) * height
        cos, sin = np.cos(self.rotation), np.sin(self.rotation)
        return np.column_stack((cos * forward + sin * aside, down, -sin * forward + cos * aside)) + self.bottom


def draw_labels(folder, frame):
    """Return the image of a frame with its labels."""
    image = Image.open(folder / "training" / "image_2" / f"{frame}.png").convert("RGB")
    calibration = (folder / "training" / "calib" / f"{frame}.txt").read_text().splitlines()
    (projection,) = (line.split()[1:] for line in calibration if line.startswith("P2:"))
    projection = np.array(projection, float).reshape(3, 4)
    draw = ImageDraw.Draw(image)
    lines = (folder / "training" / "label_2" / f"{frame}.txt").read_text().splitlines()
    for label in sorted(map(Label.of, lines), key=lambda label: -label.bottom[2]):  # the farthest first
        color = COLORS.get(label.kind, OTHER)
        corners = label.corners()
        for first, second in EDGES:
            if ends := cut(corners[first], corners[second]):
                draw.line([project(projection, end) for end in ends], color, 2)
        left, top, right, bottom = label.box
        draw.rectangle((left, top, right, bottom), outline="#ffffff")
        text = f"{label.kind} {label.bottom[2]:.0f} m"
        draw.text((left, top - 3), text, color, anchor="lb", stroke_width=2, stroke_fill="#000000")
    return image


def cut(start, stop):
    """Return the part of a line that is in front of the camera: its ends, or None."""
    if max(start[2], stop[2]) < NEAREST:
        return None
    ends = []
    for end, other in ((start, stop), (stop, start)):
        share = (NEAREST - end[2]) / (other[2] - end[2]) if end[2] < NEAREST else 0.0
        ends.append(end + share * (other - end))
    return ends


def project(projection, point):
    """Return where a point is in the image, in pixels."""
    x, y, depth = projection @ (*point, 1.0)
    return x / depth, y / depth


def main():
    """Write the picture."""
    if len(sys.argv) not in (3, 4):
        sys.exit(__doc__)
    folder, frame = Path(sys.argv[1]), sys.argv[2]
    picture = Path(sys.argv[3] if len(sys.argv) > 3 else f"{frame}.png")
    try:
        draw_labels(folder, frame).save(picture)
    except (OSError, ValueError) as error:
        sys.exit(f"show_labels.py: {error}")
    print(f"wrote {picture}")


if __name__ == "__main__":
    main()
