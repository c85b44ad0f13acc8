"""The software renderer: pictures of a town and its actors by OpenGL, on the CPU where there is no GPU.

All kinds of images of a camera are drawn in one pass, in the byte encodings of CARLA's sensors. Optical flow is the motion
from the previous image to this one, as twice the part of the image's width to the right and of its height upwards: in
pixels, it is x · width / 2 and -y · height / 2.

A `Renderer` belongs to the thread that has made it, and holds Python's lock while it draws; `rendering.process` draws in
another process instead.
"""

from __future__ import annotations

import ctypes
import sys
from collections import OrderedDict
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.rendering import shaders
from carla_recap.rendering.buffers import (
    CORNER,
    HALO,
    GroundBuffers,
    Halos,
    ImageBuffers,
    InstanceGroup,
    ModelBuffers,
    contents_for,
    fill,
    instance_table,
)
from carla_recap.rendering.camera import ImageKind, check_quality
from carla_recap.rendering.camera_view import CameraView, valid_camera
from carla_recap.rendering.sky import Sky

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from numpy.typing import NDArray

    from carla_recap.rendering.camera import Camera, Images, Quality
    from carla_recap.scene.instances import Instances
    from carla_recap.scene.mesh import Mesh
    from carla_recap.scene.models import Model

LARGEST: Final = 8192
"""The largest width and height of an image, in pixels."""
_EGL_VENDOR: Final = 0x3053  # the name of the vendor in eglQueryString
_LARGEST_BUFFER: Final = 16384  # pixels along a side, that OpenGL draws
_SIZES: Final = 8  # image sizes whose buffers are kept
_SHADOWED: Final = 12  # pixels: half the size of the smallest actor whose shadow has a shape
_GRAIN: Final = 256  # pixels of the texture of surfaces and clouds
_SKY_MAP: Final = 1024  # pixels along a side of the map of the sky


def check_size(camera: Camera) -> None:
    """Check the width and height of the images of a camera."""
    if not (1 <= camera.width <= LARGEST and 1 <= camera.height <= LARGEST):
        size = f"{camera.width} x {camera.height}"
        raise RecapError(f"an image of {size} pixels: 1 to {LARGEST} along each side can be drawn")


class Renderer:
    """Draws images of a town and its actors.

    Args:
        tiles: The tiles of the town, of which those in view are drawn.
        models: The models that instances refer to; by default, those of this package.
        quality: How RGB images are drawn.
        supersampling: The RGB image alone is drawn this many times as wide and high, and averaged: 1 to 4, for both or for
            each. None: by the quality, (1, 2) for epic, which smooths what is nearly level, such as markings far away.

    Raises:
        MissingExtra: moderngl is not installed.
        RecapError: There is no driver for OpenGL, or no such quality.
    """

    def __init__(
        self,
        tiles: Sequence[Mesh] = (),
        *,
        models: Sequence[Model] | None = None,
        quality: Quality = "epic",
        supersampling: int | tuple[int, int] | None = None,
    ) -> None:
        if models is None:
            from carla_recap.scene.models import MODELS

            models = MODELS
        check_quality(quality)
        self._is_epic = quality == "epic"
        if supersampling is None:
            supersampling = (1, 2) if self._is_epic else 1
        samples = (supersampling, supersampling) if isinstance(supersampling, int) else supersampling
        self._samples = max(1, min(4, samples[0])), max(1, min(4, samples[1]))
        self._context = create_context()
        self._programs: dict[Any, Any] = {}
        self._arrays: dict[Any, Any] = {}
        self._targets: OrderedDict[tuple[int, int], ImageBuffers] = OrderedDict()
        with self._context:
            self._load(tiles, models)

    def _load(self, tiles: Sequence[Mesh], models: Sequence[Model]) -> None:
        make = self._context.buffer
        self._frame = make(reserve=shaders.FRAME.itemsize)
        self._materials = make(shaders.material_block().tobytes())
        self._corners = make(np.array([(-1, -1), (1, -1), (-1, 1), (1, 1)], "f4").tobytes())
        noise, linear = _noise(_GRAIN), self._context.LINEAR
        self._noise = self._context.texture((_GRAIN, _GRAIN), 2, noise.tobytes())
        self._noise.build_mipmaps()
        self._noise.filter = self._context.LINEAR_MIPMAP_NEAREST, linear
        self._clouds = self._context.texture((_GRAIN, _GRAIN), 1, noise[..., 0].tobytes())
        self._clouds.filter = linear, linear
        self._sky_map = self._context.texture((_SKY_MAP, _SKY_MAP), 4)
        self._sky_map.filter = linear, linear
        self._sky_map.repeat_x = self._sky_map.repeat_y = False
        self._mapped_sky: Sky | None = None
        self._ground = GroundBuffers(self._context, tiles)
        self._lamps = Halos(models)
        self._halos = make(reserve=64 * HALO.itemsize, dynamic=True)
        self._shapes = models
        self._models: dict[int, ModelBuffers] = {}  # those that have been drawn

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release everything; a second call does nothing."""
        if self._context is not None:
            self._context.release()  # and with it all that it has
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
    ) -> Images:
        """Draw images of a moment.

        Args:
            camera: The camera.
            instances: The actors.
            kinds: The kinds of images.
            sky: The weather; by default, a clear day.
            previous: The camera and the actors of the previous image, for optical flow; None: nothing moves.
            without: The ids of actors to leave out.

        Returns:
            The images by kind; see `ImageKind`.

        Raises:
            RecapError: The size of the image is not between 1 and `LARGEST` pixels.
        """
        kinds = tuple(kind for kind in ImageKind if kind in kinds)
        check_size(camera)
        with self._context:
            return self._draw(valid_camera(camera), instances, kinds, sky or Sky(), previous, without)

    def _draw(
        self,
        camera: Camera,
        instances: Instances | None,
        kinds: tuple[ImageKind, ...],
        sky: Sky,
        previous: tuple[Camera, Instances | None] | None,
        without: Collection[int],
    ) -> Images:
        """Draw images of a moment; see `draw`."""
        targets = self._targets_of(camera.width, camera.height)
        view = CameraView(camera, sky, self._ground.origin, valid_camera(previous[0]) if previous else None)
        groups: list[InstanceGroup] = []
        halos = np.zeros(0, HALO)
        if instances is not None:
            with_shadows = ImageKind.RGB in kinds and self._is_epic
            seen, offsets = self._in_view(view, instances, without, view.shadow_length if with_shadows else 0.0)
            groups = self._groups(view, seen, offsets, previous[1] if previous else None)
            if ImageKind.RGB in kinds:
                halos = self._lamps.around(seen, offsets, sky.halo)
        rest = kinds
        if ImageKind.RGB in kinds and self._samples != (1, 1):
            rest = tuple(kind for kind in kinds if kind != ImageKind.RGB)
            samples = (
                min(self._samples[0], _LARGEST_BUFFER // camera.width),
                min(self._samples[1], _LARGEST_BUFFER // camera.height),
            )
            large = self._targets_of(camera.width * samples[0], camera.height * samples[1])
            self._draw_kinds(large, (ImageKind.RGB,), view, groups, halos)
            self._reduce(large, targets, samples)
        if rest:
            self._draw_kinds(targets, rest, view, groups, halos)
        return targets.read(kinds)

    def _draw_kinds(
        self,
        targets: ImageBuffers,
        kinds: tuple[ImageKind, ...],
        view: CameraView,
        groups: list[InstanceGroup],
        halos: NDArray[np.void],
    ) -> None:
        """Draw images of a moment in one pass."""
        self._frame.write(view.block(*targets.size).tobytes())
        context = self._context
        self._frame.bind_to_uniform_block(0)
        self._materials.bind_to_uniform_block(1)
        self._noise.use(0)
        if ImageKind.RGB in kinds:
            self._map_sky(view.sky)
        solid, clear = ([group for group in groups if group.is_solid is wanted] for wanted in (True, False))
        framebuffer = targets.framebuffer(kinds)
        framebuffer.use()
        framebuffer.clear(depth=1.0)
        context.enable_only(context.DEPTH_TEST)
        context.depth_func, context.front_face = "<", "cw"  # the rows of images run downwards
        context.enable(context.CULL_FACE)  # so that a camera within an actor sees what is around it
        for group in solid:
            self._surface(kinds, group.model).render(instances=group.load())
        context.disable(context.CULL_FACE)
        self._draw_ground(kinds, view)
        context.depth_func = "<="
        self._array("sky", kinds).render(context.TRIANGLE_STRIP)
        if ImageKind.RGB in kinds:
            self._draw_shadows(targets, view, [*solid, *clear])
            self._draw_clear(targets, clear)
            self._draw_halos(targets, halos)

    def _map_sky(self, sky: Sky) -> None:
        """Draw the map of the sky, which is the same for all cameras, unless it is that of this weather."""
        if sky != self._mapped_sky:
            framebuffer = self._context.framebuffer([self._sky_map])
            framebuffer.use()
            self._context.enable_only(self._context.NOTHING)
            self._clouds.use(2)
            self._array("sky_map").render(self._context.TRIANGLE_STRIP)
            framebuffer.release()
            self._mapped_sky = sky
        self._sky_map.use(3)

    def _reduce(self, large: ImageBuffers, targets: ImageBuffers, samples: tuple[int, int]) -> None:
        """Average the pixels of an RGB image that is a multiple of another one."""
        framebuffer = targets.framebuffer((ImageKind.RGB,))
        framebuffer.use()
        self._context.enable_only(self._context.NOTHING)
        large.texture(ImageKind.RGB).use(1)
        options = shaders.reducing(*samples)
        self._array("reduce", (ImageKind.RGB,), *options).render(self._context.TRIANGLE_STRIP)

    def _draw_ground(self, kinds: tuple[ImageKind, ...], view: CameraView) -> None:
        tiles = self._ground.visible(view)
        if len(tiles):
            self._ground.commands.write(tiles.tobytes())
            self._surface(kinds, None).render_indirect(self._ground.commands, count=len(tiles))

    def _draw_shadows(self, targets: ImageBuffers, view: CameraView, groups: list[InstanceGroup]) -> None:
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
                    self._array("blob", model=group.model).render(context.TRIANGLE_STRIP, instances=count)
                    if group.shadows and self._is_epic and view.shadow_length:
                        self._array("shadow", model=group.model).render(instances=group.shadows)
            context.blend_equation = context.FUNC_ADD
            _mask(framebuffer, (True, True, True, True))
            context.blend_func = context.ZERO, context.DST_ALPHA, context.ONE, context.ZERO
            context.disable(context.DEPTH_TEST)
            self._array("cover").render(context.TRIANGLE_STRIP)
            context.enable_only(context.DEPTH_TEST)
            framebuffer.depth_mask = True

    def _draw_clear(self, targets: ImageBuffers, groups: list[InstanceGroup]) -> None:
        """Draw actors that can be seen through: their nearest surfaces only."""
        context = self._context
        framebuffer = targets.framebuffer((ImageKind.RGB,))
        framebuffer.use()
        for group in groups:
            _mask(framebuffer, (False, False, False, False))
            count = group.load()
            context.enable(context.CULL_FACE)
            array = self._surface((ImageKind.RGB,), group.model, "TRANSLUCENT")
            array.render(instances=count)
            _mask(framebuffer, (True, True, True, False))
            context.enable(context.BLEND)
            context.blend_func = context.SRC_ALPHA, context.ONE_MINUS_SRC_ALPHA
            array.render(instances=count)
            context.disable(context.BLEND | context.CULL_FACE)
        _mask(framebuffer, (True, True, True, True))

    def _draw_halos(self, targets: ImageBuffers, halos: NDArray[np.void]) -> None:
        """Add the light around lit lamps to the RGB image."""
        if not len(halos):
            return
        context = self._context
        fill(self._halos, halos)
        framebuffer = targets.framebuffer((ImageKind.RGB,))
        framebuffer.depth_mask = False
        framebuffer.use()
        context.enable(context.BLEND)
        context.blend_func = context.ONE, context.ONE
        self._array("halo").render(context.TRIANGLE_STRIP, instances=len(halos))
        context.disable(context.BLEND)
        framebuffer.depth_mask = True

    def _in_view(
        self, view: CameraView, instances: Instances, without: Collection[int], shadow: float
    ) -> tuple[Instances, NDArray[np.float64]]:
        """Return the instances in view, and their centres relative to the camera.

        `shadow` is the length of shadows, as a part of the height; they may be in view alone.
        """
        offsets = instances.locations - view.camera.location
        with np.errstate(invalid="ignore", over="ignore"):
            half = instances.half_extents.astype(np.float64)
            radii = np.sqrt((half**2).sum(axis=1)) + 2 * shadow * half[:, 2]
            keep = view.sees_spheres(offsets, radii) & (instances.models < len(self._shapes))
        keep &= np.isfinite(instances.rotations).all(axis=(1, 2))
        if without:
            keep &= ~np.isin(instances.ids, list(without))
        return instances.take(keep), offsets[keep]

    def _groups(
        self, view: CameraView, seen: Instances, offsets: NDArray[np.float64], previous: Instances | None
    ) -> list[InstanceGroup]:
        """Return instances by their models, the nearest first; of those that are not opaque, the farthest."""
        if not len(seen):
            return []
        table = instance_table(seen, offsets)
        before = view.previous_poses(seen, table, previous)
        distances = np.einsum("ij,ij->i", offsets, offsets)
        solid = seen.opacity >= 1
        order = np.lexsort((np.where(solid, distances, -distances), seen.models, ~solid))
        cuts = np.flatnonzero((np.diff(seen.models[order].astype(int)) != 0) | np.diff(solid[order])) + 1
        large = (seen.half_extents**2).sum(axis=1) * view.camera.focal_length**2 > _SHADOWED**2 * distances
        return [
            InstanceGroup(
                self._model(int(seen.models[part[0]])),
                table[part],
                before[part],
                is_solid=bool(solid[part[0]]),
                shadows=int(large[part].sum()) if solid[part[0]] else len(part),
            )
            for part in np.split(order, cuts)
        ]

    # --- what is made once ---------------------------------------------------------------------------------------------

    def _model(self, index: int) -> ModelBuffers:
        if index not in self._models:
            self._models[index] = ModelBuffers(self._context, self._shapes[index])
        return self._models[index]

    def _targets_of(self, width: int, height: int) -> ImageBuffers:
        found = self._targets.pop((width, height), None)
        if found is None:
            while len(self._targets) >= _SIZES:
                self._targets.popitem(last=False)[1].release()
            found = ImageBuffers(self._context, width, height)
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
            for texture, unit in (("image", 1), ("clouds", 2), ("sky_map", 3)):
                if texture in program:
                    program[texture] = unit
            self._programs[key] = program
        return self._programs[key]

    def _surface(self, kinds: tuple[ImageKind, ...], model: ModelBuffers | None, *options: str) -> Any:
        if model is not None:
            options = (*options, "INSTANCED")
        elif self._is_epic and ImageKind.RGB in kinds:
            options = (*options, "GRAIN")
        return self._array("surface", kinds, *options, model=model)

    def _array(
        self, name: str, kinds: tuple[ImageKind, ...] = (ImageKind.RGB,), *options: str, model: ModelBuffers | None = None
    ) -> Any:
        """Return the vertices for a program: those of a model, of the ground, or of the corners of the image."""
        key = name, kinds, options, model
        if key not in self._arrays:
            program = self._program(name, kinds, *options)
            shape = model or self._ground
            tables = [(self._corners, CORNER, ""), (self._halos, HALO, "/i"), *shape.tables]
            triangles = () if "corner" in program else (shape.triangles,)
            self._arrays[key] = self._context.vertex_array(program, contents_for(program, tables), *triangles)
        return self._arrays[key]


def drawing_device() -> dict[str, str]:
    """Return what draws, as OpenGL names it: device, vendor, version, and the vendor of EGL, empty if it is unknown.

    Raises:
        MissingExtra: moderngl is not installed.
        RecapError: OpenGL cannot be used.
    """
    context = create_context()
    try:
        info = context.info
        names = {"device": "GL_RENDERER", "vendor": "GL_VENDOR", "version": "GL_VERSION"}
        return {name: str(info.get(key, "")) for name, key in names.items()} | {"egl_vendor": _egl_vendor()}
    finally:
        context.release()


def _egl_vendor() -> str:
    """Return the vendor of the EGL that the current context has; empty if there is none."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
        egl.eglGetCurrentDisplay.restype = ctypes.c_void_p
        egl.eglQueryString.argtypes, egl.eglQueryString.restype = (ctypes.c_void_p, ctypes.c_int), ctypes.c_char_p
        vendor: bytes | None = egl.eglQueryString(egl.eglGetCurrentDisplay(), _EGL_VENDOR)
    except (OSError, AttributeError):
        return ""
    return (vendor or b"").decode("ascii", "replace")


def create_context() -> Any:
    """Return a context of OpenGL without a window.

    Raises:
        MissingExtra: moderngl is not installed.
        RecapError: There is no driver.
    """
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


def _mask(framebuffer: Any, colors: tuple[bool, bool, bool, bool]) -> None:
    """Bind a framebuffer, and have some of its channels written alone."""
    framebuffer.color_mask = colors
    framebuffer.use()  # which applies the mask


def _noise(size: int) -> NDArray[np.uint8]:
    """Return a square of noise that can be repeated, (size, size, 2): coarse noise as of clouds, and fine noise."""
    random = np.random.default_rng(1)
    frequencies = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size)[None]) * size
    frequencies[0, 0] = np.inf
    layers = []
    for falloff, contrast in ((1.25, 45), (0.45, 34)):
        values = np.real(np.fft.ifft2(np.fft.fft2(random.standard_normal((size, size))) / frequencies**falloff))
        layers.append(127.5 + contrast * (values - values.mean()) / values.std())
    found: NDArray[np.uint8] = np.clip(np.stack(layers, axis=-1), 0, 255).astype(np.uint8)
    return found
