"""The buffers of the renderer: images, the ground, models with their instances, and the light around lit lamps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.rendering import shaders
from carla_recap.rendering.camera import ImageKind
from carla_recap.scene.materials import LAMP_BITS, MATERIALS, Material

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from carla_recap.rendering.camera import Images
    from carla_recap.rendering.camera_view import CameraView
    from carla_recap.scene.instances import Instances
    from carla_recap.scene.mesh import Mesh
    from carla_recap.scene.models import Model
    from carla_recap.util.arrays import Floats

    BufferOfRows = tuple[Any, np.dtype[np.void], str]  # with the fields of a row, and "/i" where each is for an instance

CORNER: Final = np.dtype([("corner", "2f4")])
"""A corner of the image, from -1 to 1."""
HALO: Final = np.dtype([("center", "4f4"), ("light", "3f4")])
"""A disc of light: its centre relative to the camera and its radius in m, and its colour, from 0 to 1."""
_HALO_RADIUS: Final = 2.6  # of the halo, in those of the lamp
_LEAST_HALO: Final = 0.0022  # the radius of the smallest halo, as a part of the distance
_HALO_REACH: Final = 400.0  # m
_CLOSED: Final = 0.1  # the length of the mean normal of a lamp below which it is a closed body
_IN_FRONT: Final = 0.12  # m, of the lamp


class ImageBuffers:
    """The buffers of images of a size: width and height."""

    def __init__(self, context: Any, width: int, height: int) -> None:
        self._context = context
        self.size = width, height
        self._depth = context.depth_renderbuffer(self.size)
        self._textures: dict[ImageKind, Any] = {}
        self._framebuffers: dict[tuple[ImageKind, ...], Any] = {}

    def texture(self, kind: ImageKind) -> Any:
        """Return the image of a kind that is being drawn."""
        return self._textures[kind]

    def framebuffer(self, kinds: tuple[ImageKind, ...]) -> Any:
        """Return a framebuffer of some kinds of images; all of a size have the same buffers."""
        if kinds not in self._framebuffers:
            for kind in kinds:
                if kind not in self._textures:
                    flow = kind is ImageKind.FLOW
                    self._textures[kind] = self._context.texture(self.size, 2 if flow else 4, dtype="f4" if flow else "f1")
            textures = [self._textures[kind] for kind in kinds]
            self._framebuffers[kinds] = self._context.framebuffer(textures, self._depth)
        return self._framebuffers[kinds]

    def read(self, kinds: tuple[ImageKind, ...]) -> Images:
        """Return the images; see `Renderer.draw`."""
        framebuffer = self.framebuffer(kinds)
        images: Images = {}
        for index, kind in enumerate(kinds):
            shape, dtype = image_format(kind, *self.size)
            image = np.empty(shape, dtype)
            framebuffer.read_into(
                image, components=shape[2], attachment=index, alignment=1, dtype="f4" if dtype == np.float32 else "f1"
            )
            images[kind] = image
        return images

    def release(self) -> None:
        """Release the buffers."""
        for each in (*self._framebuffers.values(), *self._textures.values(), self._depth):
            each.release()


class GroundBuffers:
    """The tiles of a town in one buffer, of which those in view are drawn by one call."""

    def __init__(self, context: Any, tiles: Sequence[Mesh]) -> None:
        tiles = [tile for tile in tiles if len(tile.triangles) and np.isfinite(tile.vertices).all()]
        self.bounds = np.array([(tile.vertices.min(axis=0), tile.vertices.max(axis=0)) for tile in tiles], np.float64)
        self.bounds = self.bounds.reshape(-1, 2, 3)
        self.origin = self.bounds.mean(axis=(0, 1)).round() if tiles else np.zeros(3)
        self._middles = self.bounds.mean(axis=1)
        counts = [len(tile.vertices) for tile in tiles]
        vertices = np.zeros(sum(counts), shaders.VERTEX)
        if tiles:
            vertices["position"] = np.concatenate([tile.vertices - self.origin for tile in tiles])
            vertices["normal"] = np.concatenate([tile.normals for tile in tiles])
            vertices["material"] = np.concatenate([tile.materials for tile in tiles])
        corners = [tile.triangles.size for tile in tiles]
        self._commands = np.zeros((len(tiles), 5), np.uint32)  # count, instances, first index, base vertex, base instance
        self._commands[:, 0], self._commands[:, 1] = corners, 1
        self._commands[:, 2] = np.cumsum([0, *corners])[:-1]
        self._commands[:, 3] = np.cumsum([0, *counts])[:-1]
        triangles = np.concatenate([np.zeros((0, 3), np.uint32), *(tile.triangles for tile in tiles)])
        self.tables: list[BufferOfRows] = [
            (context.buffer(vertices.tobytes() or bytes(shaders.VERTEX.itemsize)), shaders.VERTEX, "")
        ]
        self.triangles = context.buffer(triangles.astype(np.uint32).tobytes() or bytes(12))
        self.commands = context.buffer(reserve=max(self._commands.nbytes, 20))

    def visible(self, view: CameraView) -> NDArray[np.uint32]:
        """Return the draw commands of the tiles in view, the nearest first."""
        rows = np.flatnonzero(view.sees_boxes(self.bounds))
        offsets = self._middles[rows] - view.camera.location
        found: NDArray[np.uint32] = self._commands[rows[np.argsort((offsets**2).sum(axis=1), kind="stable")]]
        return found


class ModelBuffers:
    """A model, and the instances of it in view, as buffers."""

    def __init__(self, context: Any, model: Model) -> None:
        mesh = model.mesh
        vertices = np.zeros(len(mesh.vertices), shaders.MODEL_VERTEX)
        vertices["position"], vertices["normal"], vertices["material"] = mesh.vertices, mesh.normals, mesh.materials
        vertices["color"] = mesh.painted() / np.float32(255)
        vertices["pivot"][:, :2], vertices["pivot"][:, 2] = model.pivots, model.steered
        self._loaded: InstanceGroup | None = None
        self.is_flat = not len(mesh.vertices) or bool(np.ptp(mesh.vertices[:, 2]) < 1e-3)
        self.triangles = context.buffer(mesh.triangles.astype(np.uint32).tobytes() or bytes(12))
        self._instances = context.buffer(reserve=shaders.INSTANCE.itemsize * 64, dynamic=True)
        self._previous = context.buffer(reserve=shaders.PREVIOUS.itemsize * 64, dynamic=True)
        self.tables: list[BufferOfRows] = [
            (context.buffer(vertices.tobytes() or bytes(shaders.MODEL_VERTEX.itemsize)), shaders.MODEL_VERTEX, ""),
            (self._instances, shaders.INSTANCE, "/i"),
            (self._previous, shaders.PREVIOUS, "/i"),
        ]

    def load(self, group: InstanceGroup) -> None:
        """Fill the buffers of instances, if another group is in them."""
        if group is self._loaded:
            return
        for buffer, rows in ((self._instances, group.table), (self._previous, group.before)):
            fill(buffer, rows)
        self._loaded = group


class InstanceGroup:
    """Instances of one model.

    `shadows` is how many of them, from the first, have a shadow of their shape.
    """

    def __init__(
        self, model: ModelBuffers, table: NDArray[np.void], before: NDArray[np.void], *, is_solid: bool, shadows: int
    ) -> None:
        self.model, self.table, self.before = model, table, before
        self.is_solid, self.shadows = is_solid, shadows

    def load(self) -> int:
        """Fill the buffers of the model, and return the number of instances."""
        self.model.load(self)
        return len(self.table)


def image_format(kind: ImageKind, width: int, height: int) -> tuple[tuple[int, int, int], type[np.generic]]:
    """Return the shape and the type of an image."""
    flow = kind is ImageKind.FLOW
    return (height, width, 2 if flow else 4), np.float32 if flow else np.uint8


def contents_for(program: Any, tables: Iterable[BufferOfRows]) -> list[tuple[Any, ...]]:
    """Return the buffers that a program reads, with their formats; it may not read all of their fields."""
    contents = []
    for buffer, dtype, divisor in tables:
        formats, names = [], []
        for name in dtype.names or ():
            field = dtype[name]
            if name in program:
                formats.append(f"{int(np.prod(field.shape))}{field.base.kind}")
                names.append(name)
            else:
                formats.append(f"{field.itemsize}x")
        if names:
            contents.append((buffer, " ".join(formats) + divisor, *names))
    return contents


def fill(buffer: Any, rows: NDArray[np.void]) -> None:
    """Write rows to a buffer, which grows where they need more room."""
    if buffer.size < rows.nbytes:
        buffer.orphan(2 * rows.nbytes)
    buffer.write(rows.tobytes())


def instance_table(seen: Instances, offsets: NDArray[np.float64]) -> NDArray[np.void]:
    """Return instances as the shaders read them."""
    table = np.zeros(len(seen), shaders.INSTANCE)
    lamps = seen.lamps & LAMP_BITS
    table["location"] = offsets
    table["rotation"] = np.swapaxes(seen.rotations, 1, 2).reshape(-1, 9)
    table["extents"][:, :3] = seen.half_extents
    table["extents"][:, 3] = np.nan_to_num(seen.steering)
    table["paint"][:, :3] = seen.colors / np.float32(255)
    table["paint"][:, 3] = seen.opacity
    table["marks"][:, 0] = lamps & np.uint64(0xFFFFFFFF)
    table["marks"][:, 1] = lamps >> np.uint64(32)
    table["marks"][:, 2] = seen.ids
    table["marks"][:, 3] = seen.tags
    return table


class Halos:
    """Makes the halos of the lit lamps of instances."""

    def __init__(self, models: Sequence[Model]) -> None:
        self._models = models
        self._lamps: dict[int, tuple[NDArray[np.uint64], Floats, Floats, Floats, Floats]] = {}  # of those that were lit

    def around(self, seen: Instances, offsets: Floats, strength: float) -> NDArray[np.void]:
        """Return the halos.

        The strength is the brightness of the halos: 1 at night.
        """
        lit = np.flatnonzero((seen.lamps & LAMP_BITS != 0) & ((offsets**2).sum(axis=1) < _HALO_REACH**2))
        parts = [
            self._of_model(model, seen, offsets, lit[seen.models[lit] == model])
            for model in np.unique(seen.models[lit]).tolist()
        ]
        found = np.concatenate([np.zeros(0, HALO), *parts])
        found["light"] *= strength
        return found

    def _of_model(self, model: int, seen: Instances, offsets: Floats, rows: NDArray[np.intp]) -> NDArray[np.void]:
        if model not in self._lamps:
            self._lamps[model] = _lamps_of(self._models[model].mesh)
        materials, centers, normals, radii, colors = self._lamps[model]
        row, lamp = np.nonzero((seen.lamps[rows][:, None] >> materials[None]) & np.uint64(1))
        rows = rows[row]
        half = seen.half_extents[rows].astype(np.float64)
        turned = seen.rotations[rows].astype(np.float64)
        at = offsets[rows] + np.einsum("nij,nj->ni", turned, centers[lamp] * half)
        direction = np.einsum("nij,nj->ni", turned, normals[lamp] / np.maximum(half, 1e-3))
        distance = np.linalg.norm(at, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            facing = -np.einsum("ni,ni->n", direction, at) / (np.linalg.norm(direction, axis=1) * distance)
        found = np.zeros(len(rows), HALO)
        size = radii[lamp] * np.sqrt(half[:, 1] * half[:, 2])
        found["center"][:, :3] = at * np.maximum(1 - _IN_FRONT / np.maximum(distance, 1e-3), 0.0)[:, None]
        found["center"][:, 3] = np.maximum(_HALO_RADIUS * size, _LEAST_HALO * distance)
        found["light"] = colors[lamp] * np.clip(facing * 1.6, 0, 1)[:, None]
        shown: NDArray[np.void] = found[facing > 0]
        return shown


def _lamps_of(mesh: Mesh) -> tuple[NDArray[np.uint64], Floats, Floats, Floats, Floats]:
    """Return the lamps of a model: material, centre, direction, radius and colour; each side of a model has its own."""
    lamps = []
    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    centers = corners.mean(axis=1)
    crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(crossed, axis=1) / 2 + 1e-12
    materials = mesh.materials[mesh.triangles[:, 0]] if len(mesh.triangles) else np.zeros(0, np.uint8)
    sides = np.round(centers[:, 1] * 2).clip(-1, 1)  # the middle, or a side
    for material in np.unique(materials):
        glow = MATERIALS[Material(material)].glow
        if glow is None:
            continue
        for side in np.unique(sides[materials == material]):
            part = (materials == material) & (sides == side)
            weights = areas[part] / areas[part].sum()
            normal = weights @ mesh.normals[mesh.triangles[part, 0]]
            if np.linalg.norm(normal) < _CLOSED:  # its light goes out of the nearer end of the model
                normal = np.array((np.sign(weights @ centers[part, 0]), 0.0, 0.0))
            points = corners[part].reshape(-1, 3)
            radius = 0.5 * np.ptp(points[:, 1:], axis=0).max()
            lamps.append((material, weights @ centers[part], normal, radius, np.array(glow) / 255))
    columns = zip(*lamps, strict=True) if lamps else ((),) * 5
    material, center, normal, radius, color = (np.array(column, np.float64) for column in columns)
    return material.astype(np.uint64), center.reshape(-1, 3), normal.reshape(-1, 3), radius, color.reshape(-1, 3)
