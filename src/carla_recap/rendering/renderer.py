"""The software renderer: pictures of a town and its actors by OpenGL, on the CPU where there is no GPU.

All kinds of images of a camera are drawn in one pass, in the byte encodings of CARLA's sensors. Optical flow is the motion
from the previous image to this one, as twice the part of the image's width to the right and of its height upwards: in
pixels, it is x · width / 2 and -y · height / 2.

A `Renderer` belongs to the thread that has made it, and holds Python's lock while it draws; `rendering.process` draws in
another process instead.
"""

from __future__ import annotations

import sys
from collections import OrderedDict
from dataclasses import replace
from enum import StrEnum
from importlib import import_module
from math import radians, tan
from typing import TYPE_CHECKING, Any, Final, Protocol, Self

import numpy as np

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.rendering import shaders
from carla_recap.rendering.camera import ImageKind
from carla_recap.rendering.sky import Sky

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from numpy.typing import NDArray

    from carla_recap.rendering.camera import Camera
    from carla_recap.rendering.instances import Instances
    from carla_recap.rendering.mesh import Mesh

    Images = dict[ImageKind, NDArray[Any]]

NEAR: Final = 0.1
"""The distance of the nearest surface that is drawn, in m, along the view axis."""
FAR: Final = 5000.0
"""The distance of the farthest surface that is drawn, in m, along the view axis."""
LARGEST: Final = 8192
"""The largest width and height of an image, in pixels."""
_SIZES: Final = 8  # image sizes whose buffers are kept
_GRAIN: Final = 256  # pixels of the texture of surfaces and clouds
_PERIOD: Final = 64.0  # m after which the grain of surfaces repeats


class Quality(StrEnum):
    """How images are drawn: `LOW` without shadows and grain of surfaces, `EPIC` with them."""

    LOW = "low"
    EPIC = "epic"


class TiledMesh(Protocol):
    """What is drawn of a town: `carla_recap.rendering.town.TownMesh`."""

    @property
    def tiles(self) -> Sequence[Mesh]:
        """The ground and what stands on it, in parts that are drawn where they are in view."""
        ...


class ModelShape(Protocol):
    """What is drawn of a model: `carla_recap.rendering.models.Model`."""

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


class Renderer:
    """Draws images of a town and its actors.

    Args:
        town: The town; None for none.
        models: The models that instances refer to; by default, those of this package.
        quality: How images are drawn.
        supersampling: The RGB image alone is drawn this many times as wide and high, and averaged; 1 to 4.

    Raises:
        MissingExtra: moderngl is not installed.
        RecapError: There is no driver for OpenGL.
    """

    def __init__(
        self,
        town: TiledMesh | None = None,
        *,
        models: Sequence[ModelShape] | None = None,
        quality: Quality | str = Quality.EPIC,
        supersampling: int = 1,
    ) -> None:
        if models is None:
            models = import_module("carla_recap.rendering.models").MODELS
        self._quality = Quality(quality)
        self._samples = max(1, min(4, supersampling))
        self._context = _create_context()
        self._programs: dict[Any, Any] = {}
        self._arrays: dict[Any, Any] = {}
        self._targets: OrderedDict[tuple[int, int], _Targets] = OrderedDict()
        with self._context:
            self._load(town, models)

    def _load(self, town: TiledMesh | None, models: Sequence[ModelShape]) -> None:
        make = self._context.buffer
        self._frame = make(reserve=shaders.FRAME.itemsize)
        self._materials = make(shaders.material_block().tobytes())
        self._corners = make(np.array([(-1, -1), (1, -1), (-1, 1), (1, 1)], "f4").tobytes())
        self._noise = self._make_noise()
        self._ground = _Ground(self._context, town.tiles if town is not None else ())
        self._models = [_ModelBuffers(self._context, model) for model in models]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release everything; a second call does nothing."""
        if self._context is None:
            return
        with self._context:
            for array in self._arrays.values():
                array.release()
            for targets in self._targets.values():
                targets.release()
            for program in self._programs.values():
                program.release()
            for buffer in (self._frame, self._materials, self._corners, self._noise, *self._ground.buffers):
                buffer.release()
            for model in self._models:
                for buffer in model.buffers:
                    buffer.release()
        self._context.release()
        self._context = None

    def draw(
        self,
        camera: Camera,
        instances: Instances | None = None,
        kinds: Sequence[ImageKind] = (ImageKind.RGB,),
        sky: Sky | None = None,
        previous: tuple[Camera, Instances | None] | None = None,
        *,
        without: Collection[int] = (),
        into: Images | None = None,
    ) -> Images:
        """Draw images of a moment.

        Args:
            camera: The camera.
            instances: The actors.
            kinds: The kinds of images.
            sky: The weather; by default, a clear day.
            previous: The camera and the actors of the previous image, for optical flow; None: nothing moves.
            without: The ids of actors to leave out.
            into: An array to write to for each kind; by default, new ones are made.

        Returns:
            The images by kind; see `ImageKind`.

        Raises:
            RecapError: The size of the image is not between 1 and `LARGEST` pixels.
        """
        kinds = tuple(kind for kind in ImageKind if kind in kinds)
        width, height = camera.width, camera.height
        if not (1 <= width <= LARGEST and 1 <= height <= LARGEST):
            raise RecapError(f"an image of {width} x {height} pixels: 1 to {LARGEST} along each side can be drawn")
        with self._context:
            return self._draw(_valid(camera), instances, kinds, sky or Sky(), previous, without, into)

    def _draw(
        self,
        camera: Camera,
        instances: Instances | None,
        kinds: tuple[ImageKind, ...],
        sky: Sky,
        previous: tuple[Camera, Instances | None] | None,
        without: Collection[int],
        into: Images | None,
    ) -> Images:
        """Draw images of a moment; see `draw`."""
        targets = self._targets_of(camera.width, camera.height)
        moment = instances, sky, previous, without
        if ImageKind.RGB in kinds and self._samples > 1:
            rest = tuple(kind for kind in kinds if kind is not ImageKind.RGB)
            size = {"width": camera.width * self._samples, "height": camera.height * self._samples}
            large = self._targets_of(size["width"], size["height"])
            self._draw_kinds(large, replace(camera, **size), (ImageKind.RGB,), *moment)
            self._reduce(large, targets)
        else:
            rest = kinds
        if rest:
            self._draw_kinds(targets, camera, rest, *moment)
        return targets.read(kinds, into)

    def _draw_kinds(
        self,
        targets: _Targets,
        camera: Camera,
        kinds: tuple[ImageKind, ...],
        instances: Instances | None,
        sky: Sky,
        previous: tuple[Camera, Instances | None] | None,
        without: Collection[int],
    ) -> None:
        """Draw images of a moment in one pass."""
        view = _View(camera, sky, self._quality, self._ground.origin, _valid(previous[0]) if previous else None)
        self._frame.write(view.block().tobytes())
        context = self._context
        self._frame.bind_to_uniform_block(0)
        self._materials.bind_to_uniform_block(1)
        self._noise.use(0)
        groups = self._groups(view, instances, previous[1] if previous else None, without)
        solid, clear = ([group for group in groups if group.is_solid is wanted] for wanted in (True, False))

        framebuffer = targets.framebuffer(kinds)
        framebuffer.use()
        framebuffer.clear(depth=1.0)
        context.enable_only(context.DEPTH_TEST)
        context.depth_func = "<"
        for group in solid:
            self._surface(kinds, group.model).render(instances=group.load())
        self._draw_ground(kinds, view)
        context.depth_func = "<="
        self._full("sky", kinds).render(context.TRIANGLE_STRIP)
        if ImageKind.RGB in kinds:
            self._draw_shadows(targets, view, [*solid, *clear])
            self._draw_clear(targets, clear)

    def _reduce(self, large: _Targets, targets: _Targets) -> None:
        """Average the pixels of an RGB image that is a multiple of another one."""
        framebuffer = targets.framebuffer((ImageKind.RGB,))
        framebuffer.use()
        self._context.enable_only(self._context.NOTHING)
        large.texture(ImageKind.RGB).use(1)
        array = self._full("reduce", (ImageKind.RGB,))
        array.program["image"], array.program["samples"] = 1, self._samples
        array.render(self._context.TRIANGLE_STRIP)

    def _draw_ground(self, kinds: tuple[ImageKind, ...], view: _View) -> None:
        tiles = self._ground.visible(view)
        if len(tiles):
            self._ground.commands.write(tiles.tobytes())
            self._surface(kinds, None).render_indirect(self._ground.commands, count=len(tiles))

    def _draw_shadows(self, targets: _Targets, view: _View, groups: list[_Group]) -> None:
        """Draw the shadows into the alpha channel of the RGB image, and darken it by that channel."""
        context = self._context
        framebuffer = targets.framebuffer((ImageKind.RGB,))
        if groups:
            _mask(framebuffer, (False, False, False, True))
            framebuffer.depth_mask = False
            framebuffer.use()
            context.enable(context.BLEND)
            context.blend_equation = context.MIN
            for group in groups:
                if not group.model.is_flat:
                    count = group.load()
                    self._array("blob", group.model).render(context.TRIANGLE_STRIP, instances=count)
                    if self._quality is Quality.EPIC and view.has_shadows:
                        self._array("shadow", group.model).render(instances=count)
            context.blend_equation = context.FUNC_ADD
            _mask(framebuffer, (True, True, True, True))
            context.blend_func = context.ZERO, context.DST_ALPHA, context.ONE, context.ZERO
            context.disable(context.DEPTH_TEST)
            self._full("cover", (ImageKind.RGB,)).render(context.TRIANGLE_STRIP)
            context.enable_only(context.DEPTH_TEST)
            framebuffer.depth_mask = True

    def _draw_clear(self, targets: _Targets, groups: list[_Group]) -> None:
        """Draw actors that can be seen through: their nearest surfaces only."""
        context = self._context
        framebuffer = targets.framebuffer((ImageKind.RGB,))
        framebuffer.use()
        for group in groups:
            _mask(framebuffer, (False, False, False, False))
            count = group.load()
            array = self._surface((ImageKind.RGB,), group.model, "TRANSLUCENT")
            array.render(instances=count)
            _mask(framebuffer, (True, True, True, False))
            context.enable(context.BLEND)
            context.blend_func = context.SRC_ALPHA, context.ONE_MINUS_SRC_ALPHA
            array.render(instances=count)
            context.disable(context.BLEND)
        _mask(framebuffer, (True, True, True, True))

    def _groups(
        self, view: _View, instances: Instances | None, previous: Instances | None, without: Collection[int]
    ) -> list[_Group]:
        """Return the instances in view by their models, the nearest first; of those that are not opaque, the farthest."""
        if instances is None or not len(instances):
            return []
        offsets = instances.locations - view.camera.location
        radii = np.sqrt((instances.half_extents.astype(np.float64) ** 2).sum(axis=1))
        with np.errstate(invalid="ignore", over="ignore"):
            keep = view.sees_spheres(offsets, radii) & (instances.models < len(self._models))
            keep &= np.isfinite(instances.rotations).all(axis=(1, 2))
        if without:
            keep &= ~np.isin(instances.ids, list(without))
        rows = np.flatnonzero(keep)
        if not len(rows):
            return []
        seen, offsets = instances.take(rows), offsets[rows]
        table = np.zeros(len(rows), shaders.INSTANCE)
        table["location"] = offsets
        table["rotation"] = np.swapaxes(seen.rotations, 1, 2).reshape(-1, 9)
        table["extents"][:, :3] = seen.half_extents
        table["extents"][:, 3] = np.nan_to_num(seen.steering)
        table["paint"][:, :3] = seen.colors / np.float32(255)
        table["paint"][:, 3] = seen.opacity
        table["marks"][:, 0] = seen.lamps & np.uint64(0xFFFFFFFF)
        table["marks"][:, 1] = seen.lamps >> np.uint64(32)
        table["marks"][:, 2] = seen.ids
        table["marks"][:, 3] = seen.tags
        before = view.previous_poses(seen, table, previous)
        distances = np.einsum("ij,ij->i", offsets, offsets)
        solid = seen.opacity >= 1
        order = np.lexsort((np.where(solid, distances, -distances), seen.models, ~solid))
        groups = []
        cuts = np.flatnonzero((np.diff(seen.models[order].astype(int)) != 0) | np.diff(solid[order])) + 1
        for part in np.split(order, cuts):
            model = self._models[seen.models[part[0]]]
            is_solid = bool(solid[part[0]])
            groups.append(_Group(model, table[part], before[part], is_solid))
        return groups

    # --- what is made once ---------------------------------------------------------------------------------------------

    def _targets_of(self, width: int, height: int) -> _Targets:
        found = self._targets.pop((width, height), None)
        if found is None:
            while len(self._targets) >= _SIZES:
                self._targets.popitem(last=False)[1].release()
            found = _Targets(self._context, width, height)
        self._targets[width, height] = found
        return found

    def _program(self, name: str, kinds: tuple[ImageKind, ...], *options: str) -> Any:
        key = name, kinds, options
        if key not in self._programs:
            vertex, fragment = shaders.sources(name, kinds, *options)
            program = self._context.program(vertex_shader=vertex, fragment_shader=fragment)
            for block, binding in (("Frame", 0), ("Materials", 1)):
                if block in program:
                    program[block].binding = binding
            self._programs[key] = program
        return self._programs[key]

    def _surface(self, kinds: tuple[ImageKind, ...], model: _ModelBuffers | None, *options: str) -> Any:
        if model is not None:
            options = (*options, "INSTANCED")
        elif self._quality is Quality.EPIC and ImageKind.RGB in kinds:
            options = (*options, "GRAIN")
        key = kinds, model, options
        if key not in self._arrays:
            program = self._program("surface", kinds, *options)
            contents = model.contents(program) if model else [_content(program, self._ground.vertices, shaders.VERTEX)]
            triangles = model.triangles if model else self._ground.triangles
            self._arrays[key] = self._context.vertex_array(program, contents, triangles)
        return self._arrays[key]

    def _array(self, name: str, model: _ModelBuffers) -> Any:
        key = name, model
        if key not in self._arrays:
            program = self._program(name, (ImageKind.RGB,))
            if name == "blob":
                contents = [(self._corners, "2f", "corner"), model.contents(program)[1]]
                self._arrays[key] = self._context.vertex_array(program, contents)
            else:
                self._arrays[key] = self._context.vertex_array(program, model.contents(program)[:2], model.triangles)
        return self._arrays[key]

    def _full(self, name: str, kinds: tuple[ImageKind, ...]) -> Any:
        key = name, kinds
        if key not in self._arrays:
            program = self._program(name, kinds)
            self._arrays[key] = self._context.vertex_array(program, [(self._corners, "2f", "corner")])
        return self._arrays[key]

    def _make_noise(self) -> Any:
        texture = self._context.texture((_GRAIN, _GRAIN), 1, _noise(_GRAIN).tobytes())
        texture.build_mipmaps()
        texture.filter = self._context.LINEAR_MIPMAP_LINEAR, self._context.LINEAR
        return texture


class _View:
    """A camera and the light at a moment."""

    def __init__(
        self, camera: Camera, sky: Sky, quality: Quality, ground: NDArray[np.float64], before: Camera | None
    ) -> None:
        self.camera = camera
        self._before = before or camera
        self._sky, self._quality, self._ground = sky, quality, ground
        self._light = sky.light()
        self.has_shadows = self._light.shade < 1
        rows = np.array([_projection(camera)[index] for index in (0, 1, 3)]) @ _axes(camera)
        self._planes = np.array((rows[2] + rows[0], rows[2] - rows[0], rows[2] + rows[1], rows[2] - rows[1], rows[2]))
        self._planes /= np.linalg.norm(self._planes, axis=1, keepdims=True)

    def sees_spheres(self, offsets: NDArray[np.float64], radii: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which spheres are in view; false for those that are not finite.

        Args:
            offsets: The centres, relative to the camera.
            radii: The radii, in m.
        """
        seen: NDArray[np.bool_] = (offsets @ self._planes.T >= -radii[:, None]).all(axis=1)
        return seen

    def sees_boxes(self, bounds: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which boxes are in view.

        Args:
            bounds: The lower and upper corners, in m, (boxes, 2, 3).
        """
        centres, halves = bounds.mean(axis=1) - self.camera.location, (bounds[:, 1] - bounds[:, 0]) / 2
        seen: NDArray[np.bool_] = (centres @ self._planes.T + halves @ np.abs(self._planes).T >= 0).all(axis=1)
        return seen

    def previous_poses(self, seen: Instances, table: NDArray[np.void], previous: Instances | None) -> NDArray[np.void]:
        """Return where instances were, relative to the previous camera; those of no earlier pose have not moved."""
        found = np.zeros(len(seen), shaders.PREVIOUS)
        locations, rotations = seen.locations, table["rotation"]
        if previous is not None and len(previous):
            index = np.minimum(np.searchsorted(previous.ids, seen.ids), len(previous) - 1)
            known = previous.ids[index] == seen.ids
            known &= np.isfinite(previous.locations[index]).all(axis=1)
            known &= np.isfinite(previous.rotations[index]).all(axis=(1, 2))
            locations = np.where(known[:, None], previous.locations[index], locations)
            before = np.swapaxes(previous.rotations[index], 1, 2).reshape(-1, 9)
            rotations = np.where(known[:, None], before, rotations)
        found["previous_location"] = locations - self._before.location
        found["previous_rotation"] = rotations
        return found

    def block(self) -> NDArray[np.void]:
        """Return the uniform block."""
        camera, light = self.camera, self._light
        block = np.zeros((), shaders.FRAME)
        block["clip"] = _clip(camera).T
        block["previous_clip"] = _clip(self._before).T
        block["origin"][:3] = self._ground - camera.location
        block["previous_origin"][:3] = self._ground - self._before.location
        forward, left, up = camera.rotation.T
        across = tan(radians(camera.fov) / 2)
        block["forward"][:3] = forward
        block["right"][:3] = -left * across
        block["up"][:3] = up * across * camera.height / camera.width
        block["size"][:3] = camera.width, camera.height, camera.focal_length
        block["sun"] = (*light.sun, light.shade)
        block["sunlight"] = (*light.sunlight, light.disc)
        block["skylight"] = (*light.skylight, self._sky.wetness)
        block["groundlight"][:3] = light.groundlight
        block["zenith"] = (*light.zenith, self._sky.cloudiness)
        block["haze"][:3] = light.haze
        block["fog"] = self._sky.density, self._sky.fog_distance, 1.0, self._quality is Quality.EPIC
        block["world"][:2] = np.mod(camera.location[:2], _PERIOD)
        return block


class _Targets:
    """The buffers of images of a size."""

    def __init__(self, context: Any, width: int, height: int) -> None:
        self._context = context
        self._size = width, height
        self._depth = context.depth_renderbuffer(self._size)
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
                    self._textures[kind] = self._context.texture(self._size, 2 if flow else 4, dtype="f4" if flow else "f1")
            textures = [self._textures[kind] for kind in kinds]
            self._framebuffers[kinds] = self._context.framebuffer(textures, self._depth)
        return self._framebuffers[kinds]

    def read(self, kinds: tuple[ImageKind, ...], into: Images | None) -> Images:
        """Return the images; see `Renderer.draw`."""
        framebuffer = self.framebuffer(kinds)
        images: Images = {}
        for index, kind in enumerate(kinds):
            shape, dtype = image_format(kind, *self._size)
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


class _Ground:
    """The tiles of a town in one buffer, of which those in view are drawn by one call."""

    def __init__(self, context: Any, tiles: Sequence[Mesh]) -> None:
        tiles = [tile for tile in tiles if len(tile.triangles)]
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

    def visible(self, view: _View) -> NDArray[np.uint32]:
        """Return the draw commands of the tiles in view, the nearest first."""
        rows = np.flatnonzero(view.sees_boxes(self.bounds))
        offsets = self.bounds[rows].mean(axis=1) - view.camera.location
        found: NDArray[np.uint32] = self._commands[rows[np.argsort((offsets**2).sum(axis=1), kind="stable")]]
        return found


class _ModelBuffers:
    """A model, and the instances of it in view, as buffers."""

    def __init__(self, context: Any, model: ModelShape) -> None:
        mesh = model.mesh
        vertices = np.zeros(len(mesh.vertices), shaders.MODEL_VERTEX)
        vertices["position"], vertices["normal"], vertices["material"] = mesh.vertices, mesh.normals, mesh.materials
        vertices["pivot"][:, :2], vertices["pivot"][:, 2] = model.pivots, model.steered
        self._loaded: _Group | None = None
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
            _content(program, self._vertices, shaders.MODEL_VERTEX),
            _content(program, self._instances, shaders.INSTANCE, "/i"),
        ]
        if "previous_location" in program:
            found.append(_content(program, self._previous, shaders.PREVIOUS, "/i"))
        return found

    def load(self, group: _Group) -> None:
        """Fill the buffers of instances, if another group is in them."""
        if group is self._loaded:
            return
        for buffer, rows in ((self._instances, group.table), (self._previous, group.before)):
            if buffer.size < rows.nbytes:
                buffer.orphan(2 * rows.nbytes)
            buffer.write(rows.tobytes())
        self._loaded = group


class _Group:
    """Instances of one model."""

    def __init__(self, model: _ModelBuffers, table: NDArray[np.void], before: NDArray[np.void], is_solid: bool) -> None:
        self.model, self.table, self.before, self.is_solid = model, table, before, is_solid

    def load(self) -> int:
        """Fill the buffers of the model, and return the number of instances."""
        self.model.load(self)
        return len(self.table)


def image_format(kind: ImageKind, width: int, height: int) -> tuple[tuple[int, int, int], type[np.generic]]:
    """Return the shape and the type of an image."""
    flow = kind is ImageKind.FLOW
    return (height, width, 2 if flow else 4), np.float32 if flow else np.uint8


def _create_context() -> Any:
    try:
        import moderngl
    except ImportError:
        raise MissingExtra("a camera", "cameras") from None
    try:
        backend: dict[str, Any] = {"backend": "egl"} if sys.platform == "linux" else {}
        return moderngl.create_context(standalone=True, require=330, **backend)
    except Exception as error:
        hint = "install libegl1 and libgl1-mesa-dri" if sys.platform == "linux" else "a graphics driver is needed"
        raise RecapError(f"OpenGL cannot be used, which draws cameras and videos: {hint} ({error})") from None


def _valid(camera: Camera) -> Camera:
    """Return a camera that can be drawn; one of numbers that are not finite is at the origin, and points forward."""
    if not 0.01 <= camera.fov <= 179:
        fov = float(np.clip(camera.fov, 0.01, 179)) if np.isfinite(camera.fov) else 90.0
        camera = replace(camera, fov=fov)
    if not (np.isfinite(camera.location).all() and np.isfinite(camera.rotation).all()):
        camera = replace(camera, location=np.zeros(3), rotation=np.eye(3))
    return camera


def _mask(framebuffer: Any, colors: tuple[bool, bool, bool, bool]) -> None:
    """Bind a framebuffer, and have some of its channels written alone."""
    framebuffer.color_mask = colors
    framebuffer.use()  # which applies the mask


def _content(program: Any, buffer: Any, dtype: np.dtype[np.void], divisor: str = "") -> tuple[Any, ...]:
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


def _axes(camera: Camera) -> NDArray[np.float64]:
    """Return the rows right, up and backwards of a camera."""
    forward, left, up = np.asarray(camera.rotation, np.float64).T
    return np.array((-left, up, -forward))


def _projection(camera: Camera) -> NDArray[np.float64]:
    """Return the rows of clip coordinates x, y, z, w of right, up, backwards; y points down, for rows from the top."""
    across = tan(radians(camera.fov) / 2)
    rows = np.zeros((4, 3))
    rows[0, 0] = 1 / across
    rows[1, 1] = -camera.width / camera.height / across
    rows[2, 2] = -(FAR + NEAR) / (FAR - NEAR)
    rows[3, 2] = -1
    return rows


def _clip(camera: Camera) -> NDArray[np.float64]:
    """Return the matrix from positions relative to a camera to clip coordinates."""
    matrix = np.zeros((4, 4))
    matrix[:, :3] = _projection(camera) @ _axes(camera)
    matrix[2, 3] = -2 * FAR * NEAR / (FAR - NEAR)
    return matrix


def _noise(size: int) -> NDArray[np.uint8]:
    """Return a square of noise that can be repeated, of all scales from a pixel to half the square."""
    random = np.random.default_rng(1)
    frequencies = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size)[None]) * size
    frequencies[0, 0] = np.inf
    spectrum = np.fft.fft2(random.standard_normal((size, size))) / frequencies**0.9
    values = np.real(np.fft.ifft2(spectrum))
    values = (values - values.mean()) / values.std()
    found: NDArray[np.uint8] = np.clip(127.5 + 40 * values, 0, 255).astype(np.uint8)
    return found
