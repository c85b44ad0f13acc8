"""Labels of the road users that sensors see: boxes in the world and in images, how much of them is visible, lidar points.

Axes of the world and of actors are right-handed: x forward, y left, z up, in m; pixels count to the right and down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.scene.actor_instances import described_instances
from carla_recap.scene.materials import Tag
from carla_recap.scene.models import MODELS
from carla_recap.sensors.encoding import load_pillow

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carla_recap.rendering.camera import Camera
    from carla_recap.sensors.sensing import SensedFrame
    from carla_recap.util.arrays import Booleans, Floats, Ids


_NEAREST: Final = 0.05  # m along the axis of view; what is nearer is behind the image
_DIRECTIONS: Final = 96  # in which the outline of a model is looked for
_ON_SURFACE: Final = 0.03  # m by which a point on a surface may be outside of its box, as a number of 32 bits
_ON_GROUND: Final = 0.05  # m above the bottom of a box, below which points are on the ground
_STEP: Final = 15.0  # degrees between the directions from which the outlines of models are known
_DRAWN: Final = 96  # pixels of the larger side of such an outline
_FACES: Final = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
_EDGES: Final = tuple((a, b) for a in range(8) for b in range(a) if np.abs(_FACES[a] - _FACES[b]).sum() == 2)


class LabelClass(NamedTuple):
    """A class of road users, as datasets call it."""

    kitti: str  # a type
    coco: str  # a category
    nuscenes: str  # a category


_BY_MODEL: Final = {
    "van": LabelClass("Van", "car", "vehicle.car"),
    "minibus": LabelClass("Van", "car", "vehicle.car"),
    "ambulance": LabelClass("Van", "car", "vehicle.emergency.ambulance"),
    "police car": LabelClass("Car", "car", "vehicle.emergency.police"),
    **dict.fromkeys(
        (f"child {number}" for number in range(3)), LabelClass("Pedestrian", "person", "human.pedestrian.child")
    ),
}
"""The classes of models that have others than their tags."""

_BY_TAG: Final = {
    Tag.PEDESTRIANS: LabelClass("Pedestrian", "person", "human.pedestrian.adult"),
    Tag.BICYCLE: LabelClass("Cyclist", "bicycle", "vehicle.bicycle"),
    Tag.CAR: LabelClass("Car", "car", "vehicle.car"),
    Tag.MOTORCYCLE: LabelClass("Misc", "motorcycle", "vehicle.motorcycle"),
    Tag.BUS: LabelClass("Misc", "bus", "vehicle.bus.rigid"),
    Tag.TRUCK: LabelClass("Truck", "truck", "vehicle.truck"),
}
"""The classes of CARLA's semantic tags; actors with other tags have no labels."""

CLASSES: Final = (*dict.fromkeys((*_BY_TAG.values(), *_BY_MODEL.values())),)
"""All classes."""


@dataclass(frozen=True, eq=False)
class LabelledActor:
    """A road user at a moment."""

    id: int
    label: LabelClass
    model: int  # the index of its model, of `carla_recap.scene.models.MODELS`
    center: Floats  # of its box in the world, in m, (3,)
    rotation: Floats  # of its box: a matrix whose columns point forward, left and up, (3, 3)
    half_extents: Floats  # half the size of its box in m, (3,)

    @property
    def corners(self) -> Floats:
        """The corners of the box in the world, in m, (8, 3)."""
        return self.center + (_FACES * self.half_extents) @ self.rotation.T

    def upright(self) -> LabelledActor:
        """Return the actor in the box of the same place whose third axis is the one nearest to the vertical.

        The first axis is the more forward one, as it is unless the actor lies on the ground.
        """
        vertical = int(np.abs(self.rotation[2]).argmax())
        if vertical == 2 and self.rotation[2, 2] > 0:
            return self
        first, second = (axis for axis in range(3) if axis != vertical)
        up = self.rotation[:, vertical] * np.sign(self.rotation[2, vertical])
        forward = self.rotation[:, first]
        rotation = np.stack((forward, np.cross(up, forward), up), axis=1)
        half_extents = self.half_extents[[first, second, vertical]]
        return LabelledActor(self.id, self.label, self.model, self.center, rotation, half_extents)

    def hits(self, points: Floats) -> int:
        """Return how many points in the world, in m, (n, 3), are in the box, without those on the ground below."""
        near = points[np.abs(points - self.center).max(axis=1) <= np.linalg.norm(self.half_extents) + _ON_SURFACE]
        inside = (near - self.center) @ self.rotation
        found = (np.abs(inside) <= self.half_extents + _ON_SURFACE).all(axis=1)
        bottom = self.center[2] - np.abs(self.rotation[2]) @ self.half_extents
        return int((found & (near[:, 2] > bottom + _ON_GROUND)).sum())


@dataclass(frozen=True, eq=False)
class ImageLabel:
    """A road user in an image."""

    actor: LabelledActor
    # The sides of the box around all of its outline that is in the image, also where others are in front of it: left, top,
    # right, bottom in pixels, (4,).
    box: Floats
    truncation: float  # the share of its outline that is outside the image, from 0 to 1
    visibility: float  # the share of what is in the image that nothing is in front of, from 0 to 1
    pixels: int  # the number of its pixels
    mask: Booleans  # which pixels are its own, of those from `corner` on, (height, width)
    corner: tuple[int, int]  # the column and the row of the first pixel of the mask


def labelled_actors(frame: SensedFrame) -> list[LabelledActor]:
    """Return the road users at a moment, but for the carrier of the rig, by ascending ids."""
    found = described_instances(frame.description, marks=False)
    actors = []
    for row, id in enumerate(found.ids.tolist()):
        label = _BY_MODEL.get(MODELS[found.models[row]].name) or _BY_TAG.get(Tag(int(found.tags[row])))
        if label is not None and id != frame.carrier:
            rotation, extents = found.rotations[row].astype(np.float64), found.half_extents[row].astype(np.float64)
            actors.append(LabelledActor(id, label, int(found.models[row]), found.locations[row], rotation, extents))
    return actors


def image_labels(actors: Sequence[LabelledActor], camera: Camera, ids: Ids) -> list[ImageLabel]:
    """Return the labels of the road users of whom an image has a pixel: their ids in each one, (height, width), else 0."""
    present = set(np.unique(ids).tolist())
    labels = []
    for actor in actors:
        if actor.id in present:
            mask = ids == actor.id
            rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
            top, left = int(rows[0]), int(columns[0])
            mask = mask[top : rows[-1] + 1, left : columns[-1] + 1]
            labels.append(_label(actor, camera, mask, (left, top)))
    return labels


def _label(actor: LabelledActor, camera: Camera, mask: Booleans, corner: tuple[int, int]) -> ImageLabel:
    outline = _outline(actor, camera)
    inside = _clipped(outline, camera.width, camera.height)
    pixels, whole, shown = int(mask.sum()), _area(outline), _area(inside)
    if len(inside):
        low, high = inside.min(axis=0), inside.max(axis=0)
    else:  # thinner than a pixel
        low = np.array(corner, np.float64)
        high = low + mask.shape[::-1]
    truncation = 1 - min(shown / whole, 1.0) if whole > 0 else 0.0
    expected = shown * _fill(actor, camera)
    visibility = min(pixels / expected, 1.0) if expected > 0 else 1.0
    return ImageLabel(actor, np.concatenate((low, high)), truncation, visibility, pixels, mask, corner)


def _outline(actor: LabelledActor, camera: Camera) -> Floats:
    """Return the corners of a convex outline of an actor in pixels, in order, (n, 2); of what is in front of the camera."""
    vertices = MODELS[actor.model].mesh.vertices.astype(np.float64)
    points = actor.center + (vertices * actor.half_extents) @ actor.rotation.T
    depth = (points - camera.location) @ camera.rotation[:, 0]
    if depth.min() < _NEAREST:
        corners = actor.corners
        ahead = (corners - camera.location) @ camera.rotation[:, 0] - _NEAREST
        cut = [
            corners[a] + (corners[b] - corners[a]) * ahead[a] / (ahead[a] - ahead[b])
            for a, b in _EDGES
            if (ahead[a] < 0) != (ahead[b] < 0)
        ]
        points = np.concatenate((points[depth >= _NEAREST], np.array(cut).reshape(-1, 3)))
    return _hull(camera.project(points)[:, :2]) if len(points) else np.zeros((0, 2))


def _hull(points: Floats) -> Floats:
    """Return the points that are farthest in each of many directions, in the order of these, (n, 2)."""
    angles = np.linspace(0, math.tau, _DIRECTIONS, endpoint=False)
    far = (points @ np.stack((np.cos(angles), np.sin(angles)))).argmax(axis=0)
    found: Floats = points[far[np.append(True, far[1:] != far[:-1])]]
    return found


def _clipped(polygon: Floats, width: int, height: int) -> Floats:
    """Return the part of a convex polygon that is in an image, (n, 2)."""
    for axis, sign, limit in ((0, 1, 0.0), (0, -1, -float(width)), (1, 1, 0.0), (1, -1, -float(height))):
        if not len(polygon):
            break
        ahead = sign * polygon[:, axis] - limit
        kept: list[Floats] = []
        for index in range(len(polygon)):
            a, b = ahead[index - 1], ahead[index]
            if (a < 0) != (b < 0):
                kept.append(polygon[index - 1] + (polygon[index] - polygon[index - 1]) * (a / (a - b)))
            if b >= 0:
                kept.append(polygon[index])
        polygon = np.array(kept).reshape(-1, 2)
    return polygon


def _area(polygon: Floats) -> float:
    x, y = polygon.T
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)


def _fill(actor: LabelledActor, camera: Camera) -> float:
    """Return the share of the convex outline of an actor that its silhouette fills, as seen from a camera."""
    forward, left, up = (camera.location - actor.center) @ actor.rotation
    azimuth, elevation = math.atan2(left, forward), math.atan2(up, math.hypot(forward, left))
    steps = (round(math.degrees(angle) / _STEP) for angle in (azimuth, elevation))
    return _fill_of(actor.model, *steps)


@lru_cache(maxsize=4096)
def _fill_of(model: int, azimuth: int, elevation: int) -> float:
    """Return the share of the convex outline of a model that its silhouette fills, from a direction in steps."""
    pillow = load_pillow()
    from PIL import ImageDraw

    around, above = (math.radians(steps * _STEP) for steps in (azimuth, elevation))
    mesh, half = MODELS[model].mesh, np.array(MODELS[model].size) / 2
    right = np.array((-math.sin(around), math.cos(around), 0.0))
    up = np.array((-math.cos(around) * math.sin(above), -math.sin(around) * math.sin(above), math.cos(above)))
    points = (mesh.vertices * half) @ np.stack((right, up), axis=1)
    points -= points.min(axis=0)
    points *= _DRAWN / points.max()
    picture = pillow.new("1", (_DRAWN, _DRAWN))
    draw = ImageDraw.Draw(picture)
    for corners in points[mesh.triangles].reshape(-1, 6).tolist():
        draw.polygon(corners, fill=1)
    outline = _area(_hull(points))
    return min(float(np.asarray(picture).sum()) / outline, 1.0) if outline > 0 else 1.0
