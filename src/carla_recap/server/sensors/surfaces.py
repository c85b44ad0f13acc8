"""The surfaces of towns for cameras and rays, loaded beside the event loop."""

from __future__ import annotations

import logging
from concurrent.futures import Future
from importlib import import_module
from threading import Thread
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.records import ActorKind
from carla_recap.rendering.camera import Camera, DrawnView
from carla_recap.server.sensors.images import ImagesUnavailable

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from carla_recap.rendering.camera import ImageKind, Quality
    from carla_recap.rendering.rays import RayScene
    from carla_recap.scene.instances import Instances
    from carla_recap.server.sensors.images import View
    from carla_recap.sim.town.loading import Town
    from carla_recap.town.mesh import TownMesh

T = TypeVar("T")

_TRIAL: Final = "vehicle.tesla.model3"
_TRIAL_CAMERA: Final = Camera(16, 16, 90.0, np.array((-8.0, 0.0, 1.0)), np.eye(3))

_LOG: Final = logging.getLogger(__name__)


class TownSurfaces:
    """The surfaces of the present town, loaded in a thread."""

    def __init__(self) -> None:
        self._town: Town | None = None
        self._mesh: Future[TownMesh] | None = None
        self._rays: Future[RayScene] | None = None
        self._has_warned = False

    def mesh(self, town: Town) -> Future[TownMesh]:
        """Return the mesh of a town, which may take some seconds."""
        if self._mesh is None or town is not self._town:
            self._town, self._rays = town, None
            self._mesh = _in_thread(_load, town)
            _in_thread(import_module, "carla_recap.server.sensors.drawn_actors")  # it takes time, too
        return self._mesh

    def rays(self, town: Town) -> Future[RayScene]:
        """Return the same for rays; its result is an error without Embree."""
        mesh = self.mesh(town)
        if self._rays is None:
            self._rays = _in_thread(_ray_scene, mesh)
        return self._rays

    def ready_rays(self, town: Town) -> RayScene | None:
        """Return the same if it is ready; a failure is logged once."""
        if not town.opendrive:
            return None
        future = self.rays(town)
        if not future.done():
            return None
        error = future.exception()
        if error is None:
            return future.result()
        if not self._has_warned:
            self._has_warned = True
            text = str(error) if isinstance(error, RecapError) else repr(error)
            _LOG.warning("lidars, radars and obstacle sensors meet the boxes of actors alone: %s", text)
        return None


class DrawnImages:
    """Draws the images of a town in a process of its own; `RecapError`: an optional package or a driver is missing."""

    def __init__(self, surfaces: TownSurfaces, quality: Quality, town: Town) -> None:
        from carla_recap.rendering.process import RenderProcess, RenderProcessNotStarted
        from carla_recap.rendering.sky import Sky
        from carla_recap.util.child import ChildEnded

        self._sky = Sky.of_weather
        self._not_started = RenderProcessNotStarted
        self._process = RenderProcess(surfaces.mesh(town).result, quality=quality)
        try:
            camera, vehicle = _trial()
            self._process.draw(DrawnView(camera), vehicle)  # the first image takes the time of compiling shaders
        except ChildEnded:
            pass  # another is started for the next image
        except RecapError:
            self._process.close()
            raise

    def draw(self, view: View) -> Mapping[ImageKind, NDArray[Any]]:
        """See `ImageSource.draw`."""
        sky = self._sky(view.weather)
        try:
            camera, instances = view.scene
            return self._process.draw(DrawnView(camera, view.kinds, view.previous, view.hidden), instances, sky)
        except self._not_started as error:
            raise ImagesUnavailable(str(error)) from None

    def close(self) -> None:
        """See `ImageSource.close`."""
        self._process.close()


def _trial() -> tuple[Camera, Instances]:
    """Return a small camera, and a vehicle in front of it."""
    from carla_recap.scene.actor_instances import instances
    from carla_recap.scene.appearance import look_of
    from carla_recap.scene.description import LookColumns

    looks = [look] if (look := look_of(_TRIAL, ActorKind.VEHICLE, {})) is not None else []
    return _TRIAL_CAMERA, instances(LookColumns(np.arange(len(looks), dtype=np.uint32), looks), np.zeros((len(looks), 6)))


def _in_thread(function: Callable[..., T], *arguments: Any) -> Future[T]:
    """Call a function in a thread that the end of the process does not wait for."""
    future: Future[T] = Future()

    def run() -> None:
        try:
            future.set_result(function(*arguments))
        except Exception as error:
            future.set_exception(error)

    Thread(target=run, name="carla-recap-town", daemon=True).start()
    return future


def _load(town: Town) -> TownMesh:
    from carla_recap.town.mesh import TownMesh, town_mesh_of

    return town_mesh_of(town.opendrive, town.name) if town.opendrive else TownMesh(town.name, [])


def _ray_scene(mesh: Future[TownMesh]) -> RayScene:
    from carla_recap.rendering.rays import RayScene
    from carla_recap.scene.models import MODELS

    return RayScene(mesh.result().tiles, MODELS)
