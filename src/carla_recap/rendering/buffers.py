"""The buffers of the renderer: images, the ground, and models with their instances."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from carla_recap.rendering import shaders
from carla_recap.rendering.camera import ImageKind
from carla_recap.scene.materials import LAMPS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.rendering.camera_view import CameraView
    from carla_recap.scene.instances import Instances
    from carla_recap.scene.mesh import Mesh

    Images = dict[ImageKind, NDArray[Any]]


class TiledMesh(Protocol):
    """What is drawn of a town: `carla_recap.rendering.town.TownMesh`."""

    @property
    def tiles(self) -> Sequence[Mesh]:
        """The ground and what stands on it, in parts that are drawn where they are in view."""
        ...


class ModelShape(Protocol):
    """What is drawn of a model: `carla_recap.scene.models.Model`."""

    @property
    def mesh(self) -> Mesh:
        """The triangles, within -1 to 1 along each axis."""
        ...

    @property
    def pivots(self) -> NDArray[np.float32]:
        """The steering axis of each vertex: x and y, (vertices, 2)."""
        ...

    @property
    def steered(self) -> NDArray[np.bool_]:
        """Whether each vertex turns with the steering, (vertices,)."""
        ...


class ImageBuffers:
    """The buffers of images of a size.

    Args:
        context: The context of OpenGL.
        width: The width in pixels.
        height: The height in pixels.

    Attributes:
        size: Width and height.
    """

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

    def read(self, kinds: tuple[ImageKind, ...], into: Images | None) -> Images:
        """Return the images; see `Renderer.draw`."""
        framebuffer = self.framebuffer(kinds)
        images: Images = {}
        for index, kind in enumerate(kinds):
            shape, dtype = image_format(kind, *self.size)
            image = np.empty(shape, dtype) if into is None else into[kind]
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
        self.vertices = context.buffer(vertices.tobytes() or bytes(shaders.VERTEX.itemsize))
        self.triangles = context.buffer(triangles.astype(np.uint32).tobytes() or bytes(12))
        self.commands = context.buffer(reserve=max(self._commands.nbytes, 20))

    @property
    def buffers(self) -> tuple[Any, ...]:
        """The buffers to release."""
        return self.vertices, self.triangles, self.commands

    def visible(self, view: CameraView) -> NDArray[np.uint32]:
        """Return the draw commands of the tiles in view, the nearest first."""
        rows = np.flatnonzero(view.sees_boxes(self.bounds))
        offsets = self.bounds[rows].mean(axis=1) - view.camera.location
        found: NDArray[np.uint32] = self._commands[rows[np.argsort((offsets**2).sum(axis=1), kind="stable")]]
        return found


class ModelBuffers:
    """A model, and the instances of it in view, as buffers."""

    def __init__(self, context: Any, model: ModelShape) -> None:
        mesh = model.mesh
        vertices = np.zeros(len(mesh.vertices), shaders.MODEL_VERTEX)
        vertices["position"], vertices["normal"], vertices["material"] = mesh.vertices, mesh.normals, mesh.materials
        vertices["color"] = mesh.painted() / np.float32(255)
        vertices["pivot"][:, :2], vertices["pivot"][:, 2] = model.pivots, model.steered
        self._loaded: InstanceGroup | None = None
        self.is_flat = not len(mesh.vertices) or bool(np.ptp(mesh.vertices[:, 2]) < 1e-3)
        self._vertices = context.buffer(vertices.tobytes() or bytes(shaders.MODEL_VERTEX.itemsize))
        self.triangles = context.buffer(mesh.triangles.astype(np.uint32).tobytes() or bytes(12))
        self._instances = context.buffer(reserve=shaders.INSTANCE.itemsize * 64, dynamic=True)
        self._previous = context.buffer(reserve=shaders.PREVIOUS.itemsize * 64, dynamic=True)

    @property
    def buffers(self) -> tuple[Any, ...]:
        """The buffers to release."""
        return self._vertices, self.triangles, self._instances, self._previous

    def contents(self, program: Any) -> list[tuple[Any, ...]]:
        """Return the buffers with their formats for a program: vertices, instances, and their previous poses."""
        found = [
            content_of(program, self._vertices, shaders.MODEL_VERTEX),
            content_of(program, self._instances, shaders.INSTANCE, "/i"),
        ]
        if "previous_location" in program:
            found.append(content_of(program, self._previous, shaders.PREVIOUS, "/i"))
        return found

    def load(self, group: InstanceGroup) -> None:
        """Fill the buffers of instances, if another group is in them."""
        if group is self._loaded:
            return
        for buffer, rows in ((self._instances, group.table), (self._previous, group.before)):
            fill(buffer, rows)
        self._loaded = group


class InstanceGroup:
    """Instances of one model.

    Args:
        model: The model.
        table: The instances; see `instance_table`.
        before: Where they were in the previous image.
        is_solid: Whether they are opaque.
        shadows: How many of them, from the first, have a shadow of their shape.
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


def content_of(program: Any, buffer: Any, dtype: np.dtype[np.void], divisor: str = "") -> tuple[Any, ...]:
    """Return a buffer with its format for a program, which may not read all of its fields."""
    formats, names = [], []
    for name in dtype.names or ():
        field = dtype[name]
        if name in program:
            formats.append(f"{int(np.prod(field.shape))}{field.base.kind}")
            names.append(name)
        else:
            formats.append(f"{field.itemsize}x")
    return buffer, " ".join(formats) + divisor, *names


def fill(buffer: Any, rows: NDArray[np.void]) -> None:
    """Write rows to a buffer, which grows where they need more room."""
    if buffer.size < rows.nbytes:
        buffer.orphan(2 * rows.nbytes)
    buffer.write(rows.tobytes())


def instance_table(seen: Instances, offsets: NDArray[np.float64]) -> NDArray[np.void]:
    """Return instances as the shaders read them.

    Args:
        seen: The instances.
        offsets: Their centres relative to the camera.
    """
    table = np.zeros(len(seen), shaders.INSTANCE)
    lamps = seen.lamps & LAMPS
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
