"""The pictures of a video: where the camera is in each, what it sees, and what is written on it."""

from __future__ import annotations

import math
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.recording import open_recording
from carla_recap.rendering.camera import DrawnView, ImageKind
from carla_recap.roads.find import plain_name
from carla_recap.scene.ahead import NO_LIGHT, stop_points
from carla_recap.scene.captions import incidents_around, readable_name, shown_options
from carla_recap.scene.follow import followed_series
from carla_recap.show.video.camera_paths import (
    Transparency,
    camera_path,
    camera_size,
    covered_by,
    number_or_none,
    pixels_per_metre,
    subject_of,
)
from carla_recap.show.video.overlay import Captions, LightAhead, Overlay, Readings, is_near

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.incidents import IncidentOptions
    from carla_recap.recording import Recording
    from carla_recap.rendering.camera import Camera, Images
    from carla_recap.rendering.process import RenderProcess
    from carla_recap.replay import Follow, Player, Scene
    from carla_recap.scene.falls import RecordedContacts
    from carla_recap.scene.follow import FollowedSeries
    from carla_recap.scene.instances import Instances
    from carla_recap.show.video.camera_paths import Subject, VideoView
    from carla_recap.show.video.encoding import Picture, Size
    from carla_recap.town.mesh import TownMesh

    Town = TownMesh | Callable[[], TownMesh | None]
    Progress = Callable[[Iterable[Scene], Player], Iterable[Scene]]

RATE: Final = 30.0
"""The frames per second of a video, unless they are given."""


class VideoShot(NamedTuple):
    """A picture to be drawn: the camera, the actors, the scene, and what is written on it."""

    camera: Camera
    instances: Instances
    scene: Scene
    readings: Readings


class Film:
    """The pictures of a video or a single one, as what is to be drawn, between the start and the stop of a player.

    The speed is in seconds of the recording in a second of the video, the rate in frames per second; without a number of
    frames, it is a single picture. Nothing is written on the pictures unless it is said which incidents are `shown`; see
    `carla_recap.scene.captions.shown_options`. The contacts of the recording are given if there are several films of it.
    """

    def __init__(
        self,
        recording: Recording,
        player: Player,
        view: VideoView,
        size: Size,
        *,
        speed: float = 1.0,
        rate: float = RATE,
        frames: int | None = None,
        shown: IncidentOptions | None = None,
        contacts: RecordedContacts | None = None,
    ) -> None:
        from carla_recap.scene.actor_instances import SceneActors  # here, while the renderer starts

        self._player = player
        self._rate = rate
        self._speed = speed
        self._frames = frames
        self._view = view
        self._actors = SceneActors()
        self._actors.recall(player, contacts)
        self._followed = player.followed
        self._subject: Subject | None = None
        self._series: FollowedSeries | None = None
        if self._followed is not None:
            stops = stop_points(recording.reader) if shown else {}
            self._series = followed_series(recording, self._followed, stops, start=player.start, stop=player.stop)
        self._path = camera_path(view, size)
        self._transparency = Transparency()
        self._captions: Captions | None = None
        self._overlay: Overlay | None = None
        if shown is not None:
            span = {"start": player.start, "stop": player.stop}
            found = incidents_around(recording.reader, shown, player.followed, **span)
            self._captions = Captions(found, **span, speed=speed, followed=player.followed)
            marks = list(self._captions.marks()) if frames else []
            map_name = plain_name(recording.header.map_name)
            self._overlay = Overlay(size, map_name=map_name, speed=speed, marks=marks)

    def shots(self, progress: Progress | None = None) -> Iterator[VideoShot]:
        """Yield all pictures."""
        scenes: Iterable[Scene] = islice(self._player.scenes(self._rate / self._speed), self._frames)
        for index, scene in enumerate(progress(scenes, self._player) if progress else scenes):
            yield self.shot(scene, index)

    def shot(self, scene: Scene, index: int = 0) -> VideoShot:
        """Return the picture of a scene; scenes have to come in order."""
        instances = self._actors.at(scene)
        if self._followed is not None and self._series is not None:
            self._subject = subject_of(self._followed, scene, instances, self._series) or self._subject
        camera = self._path.camera(scene, instances, self._subject)
        if self._view == "chase":
            seconds = 1 / self._rate if index else math.inf
            instances = self._transparency.apply(camera, instances, self._followed, seconds)
        return VideoShot(camera, instances, scene, self._readings(scene, camera, index))

    def finished(self, images: Future[list[Images]], shot: VideoShot) -> Picture:
        """Wait for the images of a shot, and return the picture with what is written on it."""
        picture = images.result()[0][ImageKind.RGB]
        if self._overlay is not None:
            self._overlay.draw(picture, shot.readings)
        return picture

    def written(self, picture: Picture, scene: Scene, index: int) -> Picture:
        """Return the picture of a scene by another camera, with what is written on it; scenes have to come in order."""
        if self._overlay is not None:
            if self._followed is not None and self._series is not None:
                instances = self._actors.at(scene)
                self._subject = subject_of(self._followed, scene, instances, self._series) or self._subject
            self._overlay.draw(picture, self._readings(scene, None, index))
        return picture

    def _readings(self, scene: Scene, camera: Camera | None, index: int) -> Readings:
        subject, series = self._subject, self._series
        if self._captions is None:
            return Readings(scene.time)
        centre = subject.ground if subject is not None else np.zeros(3) if camera is None else camera.location
        near = is_near(float(centre[0]), float(centre[1]))
        ground = float(centre[2]) if subject is not None else 0.0
        actor = None if self._followed is None else scene.actors.get(self._followed)
        progress = index / max(self._frames - 1, 1) if self._frames else None
        if actor is None or series is None:
            return Readings(scene.time, progress, captions=self._captions.at(scene.time, near))
        row = series.row_at(scene.time)
        controls = (*series.pedals[row].tolist(), float(series.controls[row, 2]))
        light = LightAhead(int(series.light_state[row]), float(series.light_distance[row]))
        return Readings(
            scene.time,
            progress,
            _label(actor),
            number_or_none(series.speed[row]),
            controls if math.isfinite(sum(controls)) else None,
            None if series.light[row] == NO_LIGHT else light,
            self._captions.at(scene.time, near),
            None if camera is None else pixels_per_metre(camera, ground),
            None if subject is None or camera is None else covered_by(camera, subject),
        )


def _label(actor: ActorLife) -> str:
    """Return the name of the followed actor for the panel."""
    name = "hero" if actor.is_hero else readable_name(actor.type_id)
    return f"{name[:1].upper()}{name[1:]} ({actor.id})"


def _check_view(recording: Recording, view: VideoView) -> None:
    """Check that a camera exists."""
    if not isinstance(view, int):
        return
    cameras = [actor for actor in recording.actors.values() if actor.type_id.startswith("sensor.camera.")]
    if view in {actor.id for actor in cameras}:
        return
    named = ", ".join(f"{actor.id} ({actor.type_id})" for actor in cameras[:5]) or "none"
    raise RecapError(f"{recording.location}: no camera {view} is recorded; the recorded cameras are: {named}")


def followed_of(recording: Recording, view: VideoView, follow: Follow | None) -> Follow | None:
    """Return the actor that is given to be followed; of a recorded camera, else the actor that it is attached to."""
    _check_view(recording, view)
    camera = recording.actors.get(view) if isinstance(view, int) else None
    if follow is None and camera is not None and camera.parent in recording.actors:
        return camera.parent
    return follow


def overlay_options(
    recording: Recording, view: VideoView, overlay: bool | None, incidents: IncidentOptions | None
) -> IncidentOptions | None:
    """Return which incidents are shown; None: nothing is written on pictures, by default on those of recorded cameras."""
    wanted = not isinstance(view, int) if overlay is None else overlay
    return shown_options(recording.reader, incidents) if wanted else None


def recorded_size(recording: Recording, view: VideoView) -> Size | None:
    """Return the size of the images of a recorded camera as even numbers; None for another view."""
    actor = recording.actors.get(view) if isinstance(view, int) else None
    size = None if actor is None else camera_size(actor.attributes)
    return None if size is None else (size[0] & ~1, size[1] & ~1)


@contextmanager
def opened_renderer(
    renderer: RenderProcess | None,
    town: Town | None,
    recording: Recording,
    *,
    start: float = 0.0,
    stop: float = math.inf,
    supersampling: int = 1,
) -> Iterator[Future[RenderProcess]]:
    """Yield a renderer: a given one, which stays open, or a new one, which is made in another thread, and closed.

    The town of a new one, if none is given, is that of the recording's map, or if that is unknown, roads where its vehicles
    have driven around what is shown, from `start` to `stop` in elapsed seconds. Pictures are drawn `supersampling` times as
    wide and high before they are made smaller.
    """
    if renderer is not None:
        given: Future[RenderProcess] = Future()
        given.set_result(renderer)
        yield given
        return
    with ThreadPoolExecutor(1, "carla-recap-town") as thread:
        made = thread.submit(_make_renderer, town, recording.location, start, stop, supersampling)
        try:
            yield made
        finally:
            if made.exception() is None:
                made.result().close()


def _make_renderer(town: Town | None, source: str, start: float, stop: float, supersampling: int) -> RenderProcess:
    from carla_recap.rendering.process import RenderProcess
    from carla_recap.town.mesh import load_town_of

    mesh = town() if callable(town) else town
    if mesh is None:
        with open_recording(source) as recording:  # another thread reads the caller's
            mesh = load_town_of(recording, None, start, stop - start if stop < math.inf else 0.0, longest=math.inf)
    return RenderProcess(mesh, supersampling=supersampling)


def submit(renderer: RenderProcess, shot: VideoShot) -> Future[list[Images]]:
    """Have a picture drawn."""
    from carla_recap.rendering.sky import Sky

    return renderer.submit([DrawnView(shot.camera)], shot.instances, Sky.of_weather(shot.scene.weather))
