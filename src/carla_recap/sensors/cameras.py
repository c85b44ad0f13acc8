"""The cameras of a rig: what they see is drawn by a renderer, and comes back as arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.rendering.camera import Camera, DrawnView, ImageKind
from carla_recap.rendering.sky import Sky
from carla_recap.replay.pose import LOCATION, rotations

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from concurrent.futures import Future

    from carla_recap.rendering.camera import Images
    from carla_recap.rendering.process import RenderProcess
    from carla_recap.replay import Scene
    from carla_recap.scene.instances import Instances
    from carla_recap.sensors.encoding import Image
    from carla_recap.sensors.rig import SensorSpec
    from carla_recap.util.arrays import Floats, Ids

_DEPTH_STEPS: Final = (1 << 24) - 1
_FARTHEST: Final = 1000.0  # m, that depth images reach; what is farther, and the sky, has this depth
_PIXELS_TOGETHER: Final = 1 << 22  # of the images that are drawn at once: 16 MB
_IDS: Final = 1 << 16  # that instance images tell apart


def camera_of(spec: SensorSpec, pose: Floats) -> Camera:
    """Return the camera of a sensor."""
    width, height = int(spec.number("image_size_x")), int(spec.number("image_size_y"))
    return Camera(width, height, spec.number("fov"), pose[LOCATION], rotations(pose))


class PlacedSensor(NamedTuple):
    """A sensor that is due."""

    spec: SensorSpec  # the sensor
    pose: Floats  # its pose in m and degrees, right-handed, (6,)


class _Pass:
    """What cameras of the same pose, size and field of view see."""

    def __init__(self, camera: Camera, hidden: frozenset[int]) -> None:
        self.camera = camera
        self.hidden = hidden
        self.previous: tuple[Camera, Instances] | None = None
        self.sensors: list[tuple[str, ImageKind]] = []

    @property
    def kinds(self) -> set[ImageKind]:
        """The kinds of images."""
        return {kind for _, kind in self.sensors}

    @property
    def drawn(self) -> set[ImageKind]:
        """The kinds that are drawn: images of instances have the semantic tags, too."""
        return self.kinds - {ImageKind.SEMANTIC} if ImageKind.INSTANCE in self.kinds else self.kinds


class RigCameras:
    """The cameras of a rig."""

    def __init__(self, renderer: RenderProcess) -> None:
        self._renderer = renderer
        self._previous: dict[str, tuple[Camera, Instances]] = {}  # by the id of a camera of optical flow

    def forget(self) -> None:
        """Let the optical flow begin anew, as with the first image."""
        self._previous.clear()

    def submit(
        self,
        sensors: Iterable[PlacedSensor],
        instances: Instances,
        scene: Scene,
        hidden: Callable[[SensorSpec], frozenset[int]],
    ) -> list[Callable[[], dict[str, Image]]]:
        """Have the images of a moment drawn, those of cameras of the same pose, size and field of view in one pass.

        Args:
            sensors: The cameras that take an image.
            instances: The actors.
            scene: The scene, which has the weather.
            hidden: Returns the ids of the actors that a camera does not see.

        Returns:
            What waits for images, each for those of some cameras, and returns them as arrays by the id of the sensor; see
            `decoded`.
        """
        views: dict[tuple[object, ...], _Pass] = {}
        found: list[_Pass] = []
        for spec, pose in sorted(sensors, key=lambda sensor: sensor.spec.image is ImageKind.FLOW):
            kind, camera, left_out = spec.image, camera_of(spec, pose), hidden(spec)
            assert kind is not None
            place = *pose.tolist(), camera.width, camera.height, camera.fov, left_out
            view, previous = views.get(place), None
            if kind is ImageKind.FLOW:
                previous, self._previous[spec.id] = self._previous.get(spec.id), (camera, instances)
                if view is not None and kind in view.kinds and _actors_of(view.previous) is not _actors_of(previous):
                    view = None  # it shows the motion since another moment
            if view is None:
                view = views[place] = _Pass(camera, left_out)
                found.append(view)
            view.previous = previous or view.previous
            view.sensors.append((spec.id, kind))
        sky = Sky.of_weather(scene.weather)
        return [self._drawn(part, instances, sky) for part in _together(found)]

    def _drawn(self, passes: list[_Pass], instances: Instances, sky: Sky) -> Callable[[], dict[str, Image]]:
        """Have the images of some views drawn, and return what waits for them."""
        views = [DrawnView(each.camera, tuple(each.drawn), each.previous, each.hidden) for each in passes]
        future: Future[list[Images]] = self._renderer.submit(views, instances, sky)

        def images() -> dict[str, Image]:
            found: dict[str, Image] = {}
            for each, drawn in zip(passes, future.result(), strict=True):
                of = {kind: drawn.get(kind, drawn.get(ImageKind.INSTANCE)) for kind in each.kinds}
                arrays = {kind: decoded(kind, image, instances.ids) for kind, image in of.items() if image is not None}
                found |= {id: arrays[kind] for id, kind in each.sensors}
            return found

        return images


def _together(passes: Iterable[_Pass]) -> list[list[_Pass]]:
    """Return views in groups that are drawn at once, each of at most `_PIXELS_TOGETHER` or of one view."""
    found: list[list[_Pass]] = []
    pixels = 0
    for each in passes:
        more = each.camera.width * each.camera.height * len(each.drawn)
        if not found or pixels + more > _PIXELS_TOGETHER:
            found.append([])
            pixels = 0
        found[-1].append(each)
        pixels += more
    return found


def _actors_of(previous: tuple[Camera, Instances] | None) -> Instances | None:
    return None if previous is None else previous[1]


def decoded(kind: ImageKind, image: Image, ids: Ids) -> Image:
    """Return an image in the encoding of CARLA's sensors as numbers.

    Args:
        kind: The kind of image.
        image: The image, as the renderer draws it.
        ids: The ids of the actors that can be in it.

    Returns:
        RGB: red, green, blue, (height, width, 3) of uint8. Depth: along the axis of view in m, (height, width) of float32,
        infinite for the sky and from 1,000 m on. Semantic segmentation: CARLA's tags, (height, width) of uint8. Instance
        segmentation: ids of actors, 0 for the town and the sky, (height, width) of uint32. Normals: in the axes of the
        world, right-handed, (height, width, 3) of float32; 0 for the sky. Optical flow: the motion since the image before
        in pixels, to the right and down, (height, width, 2) of float32.
    """
    if kind is ImageKind.RGB:
        return image[..., 2::-1]
    if kind is ImageKind.SEMANTIC:
        return np.ascontiguousarray(image[..., 2])
    if kind is ImageKind.DEPTH:
        steps = image.view(">u4")[..., 0] >> 8
        depth = steps.astype(np.float32)
        depth *= np.float32(_FARTHEST / _DEPTH_STEPS)
        depth[steps == _DEPTH_STEPS] = np.inf
        return depth
    if kind is ImageKind.INSTANCE:
        found = image.view(">u2")[..., 0].astype(np.uint32)
        if len(ids) and ids[-1] >= _IDS:
            table = np.zeros(_IDS, np.uint32)
            table[ids % _IDS] = ids
            found = table[found]
        return found
    if kind is ImageKind.NORMALS:
        normals = image[..., 2::-1] * np.float32(2 / 255) - np.float32(1)
        normals[..., 1] *= -1
        normals[(np.abs(normals) < 0.01).all(axis=-1)] = 0.0
        return normals
    _, width = image.shape[:2]
    return image * np.array((width / 2, -image.shape[0] / 2), np.float32)
