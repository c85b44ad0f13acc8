"""What cameras of a recording show at some moments: the images that it has of them, or else drawn anew."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

from carla_recap.errors import RecapError
from carla_recap.queries.sensors import has_images, sensors
from carla_recap.replay import Player
from carla_recap.sensors.rig import SensorRig

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from carla_recap.model.lives import ActorName
    from carla_recap.recording import Recording
    from carla_recap.replay import Scene
    from carla_recap.replay.player import Progress
    from carla_recap.sensors.rig import SensorSpec

_RGB: Final = "sensor.camera.rgb"
_DRAWN: Final = "--rig RIG.json (in Python, rig=...) draws what cameras would have seen"


class CameraMoment(NamedTuple):
    """A scene, and what cameras show then."""

    scene: Scene
    # the images by the ids of the cameras: red, green, blue, (height, width, 3) of uint8; without those of which there
    # is none yet
    images: dict[str, NDArray[np.uint8]]


class CameraChoice:
    """RGB cameras of a recording or of a rig.

    Args:
        recording: The recording.
        cameras: The ids of the cameras; "all": all RGB cameras of the rig, or without one, of the recording.
        rig: The sensors that are drawn; None: those of the recording, which are drawn if it has no images of them.

    Attributes:
        ids: The ids of the cameras, each once.

    Raises:
        RecapError: There is no such camera; the message lists those that there are.
    """

    def __init__(self, recording: Recording, cameras: Sequence[str] | Literal["all"], rig: SensorRig | None = None) -> None:
        self._recording = recording
        self._stored: set[str] = set()
        if rig is None:
            recorded = [sensor for sensor in sensors(recording.reader) if sensor.type == _RGB]
            if not recorded:
                raise RecapError(f"{recording.location}: has no data of cameras; {_DRAWN}")
            self._stored = {sensor.id for sensor in recorded if has_images(sensor)}
            specs = [spec for sensor in recorded for spec in SensorRig.of([{**sensor.spec, "id": sensor.id}])]
            rig = SensorRig(tuple(specs), recording.location)
        self._specs = {spec.id: spec for spec in rig.rgb_cameras(None if cameras == "all" else cameras)}
        self.ids = list(self._specs)

    def size(self, id: str) -> tuple[int, int]:
        """Return the width and the height of a camera's images in pixels."""
        spec = self._specs[id]
        return int(spec.number("image_size_x")), int(spec.number("image_size_y"))

    def scenes(
        self,
        *,
        start: float = 0.0,
        duration: float = 0.0,
        rate: float | None = None,
        actor: ActorName = "hero",
        road_map: Path | str | None = None,
        progress: Progress | None = None,
    ) -> Iterator[CameraMoment]:
        """Yield scenes with the latest image of each camera.

        Args:
            start: The elapsed seconds to begin at.
            duration: The seconds of the recording; 0: all of the rest.
            rate: The scenes per second of the recording; None: the recorded ones.
            actor: The actor that carries the cameras that are drawn: an id or "hero".
            road_map: The town's map for those; None: looked for in the usual folders.
            progress: Is given all scenes and the player, and passes the scenes on.

        Raises:
            RecapError: There is no such time or actor, or nothing can be drawn here.
            FormatError: The recording contradicts its format.
            MissingExtra: An optional dependency is not installed.
        """
        from carla_recap.sensors.decoding import StoredImages

        player = Player(self._recording, start=start, duration=duration)
        span = player.start, player.stop
        kept = {id: StoredImages(self._recording.reader, id, *span) for id in self.ids if id in self._stored}
        drawn = [self._specs[id] for id in self.ids if id not in kept]
        latest: dict[str, NDArray[np.uint8]] = {}
        for scene, images in self._drawn(drawn, player, rate, actor, road_map, progress):
            latest |= images
            for id, stored in kept.items():
                if (image := stored.at(scene.time)) is not None:
                    latest[id] = image
            yield CameraMoment(scene, {id: latest[id] for id in self.ids if id in latest})

    def _drawn(
        self,
        specs: list[SensorSpec],
        player: Player,
        rate: float | None,
        actor: ActorName,
        road_map: Path | str | None,
        progress: Progress | None,
    ) -> Iterator[CameraMoment]:
        """Yield scenes with the images of the cameras that are drawn."""
        if not specs:
            scenes = player.scenes(rate)
            for scene in progress(scenes, player) if progress else scenes:
                yield CameraMoment(scene, {})
            return
        from carla_recap.sensors.options import SensingOptions
        from carla_recap.sensors.sensing import sensed_frames

        always = tuple(replace(spec, attributes={**spec.attributes, "sensor_tick": 0.0}) for spec in specs)
        part = SensingOptions(
            actor=actor, start=player.start, duration=player.stop - player.start, rate=rate, road_map=road_map
        )
        frames = sensed_frames(self._recording, SensorRig(always), part, progress)
        with closing(frames):
            for frame in frames:
                yield CameraMoment(frame.scene, {id: sample.data for id, sample in frame.samples.items()})
