"""The frames of a running simulation as a Rerun stream."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.replay.follow import HERO, Follow, LiveChoice
from carla_recap.replay.player import LiveScenes
from carla_recap.scene.ahead import add_stop_points
from carla_recap.scene.appearance import look_of_present
from carla_recap.show.rerun.blueprint import View, live_blueprint
from carla_recap.show.rerun.rrd import send_blueprint
from carla_recap.show.rerun.writer import SceneWriter, describe

if TYPE_CHECKING:
    import numpy as np
    import rerun as rr
    from numpy.typing import NDArray

    from carla_recap.model.frame import Frame, Header
    from carla_recap.roads import RoadMap


class LiveView:
    """Shows frames as they come.

    Args:
        stream: The stream, whose blueprint is that of `live_blueprint`.
        header: The header of the recording.
        source: The origin of the frames.
        follow: The actor that the camera follows as soon as it is present: an id, or "hero". As long as there is no hero,
            it follows a vehicle or walker that moves.
        view: The camera that is shown first.
        road_map: The map of the town.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        header: Header,
        source: str,
        *,
        follow: Follow = HERO,
        view: View = "chase",
        road_map: RoadMap | None = None,
    ) -> None:
        self._stream = stream
        self._choice = LiveChoice(follow)
        self._view: View = view
        self._followed: int | None = None
        self._scenes = LiveScenes()
        self._stops: dict[int, NDArray[np.float64]] = {}
        describe(stream, header, f"{header.map_name}, live", source)
        self._writer = SceneWriter(stream, road_map=road_map, stops=self._stops, live=True)

    def enter(self, frame: Frame) -> None:
        """Add a frame."""
        scene = self._scenes.scene(frame)
        add_stop_points(self._stops, frame)
        chosen = self._choice.choose(scene)
        if chosen is not None and chosen != self._followed:
            self._followed = chosen
            self._writer.follow(chosen)
            look = look_of_present(scene.actors[chosen])
            half_extents = None if look is None else look.half_extents
            arrangement = live_blueprint(view=self._view, followed=chosen, half_extents=half_extents)
            send_blueprint(arrangement, self._stream)
        self._writer.write(scene.batch)

    def flush(self) -> None:
        """Show all frames that were added."""
        self._writer.flush()

    def close(self) -> None:
        """Show all frames that were added, and what is known only at the end.

        Warns:
            RecapWarning: There were too many actors to show all of them.
        """
        self._writer.close()
