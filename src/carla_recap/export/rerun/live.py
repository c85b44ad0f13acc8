"""Frames of a running simulation as a Rerun stream, which looks as their recording would."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from carla_recap.export.rerun import paths
from carla_recap.export.rerun.blueprint import View, arranged, follow_views, overviews
from carla_recap.export.rerun.rrd import send_blueprint
from carla_recap.export.rerun.writer import SceneWriter, describe
from carla_recap.replay.follow import HERO, Follow
from carla_recap.replay.player import LiveScenes

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from carla_recap.maps import RoadMap
    from carla_recap.model.frame import Frame, Header
    from carla_recap.replay import Scene


def live_blueprint(road_map: RoadMap | None = None, *, view: View = "chase", followed: int | None = None) -> rrb.Blueprint:
    """Return the arrangement of views for a running simulation.

    Args:
        road_map: The map of the town, which is shown as a whole until an actor is followed.
        view: The camera that is shown first.
        followed: The actor that the cameras follow, if any.
    """
    if followed is not None:
        return arranged(follow_views(paths.CHASE, "", followed), view, followed, live=True)
    locations = np.concatenate(road_map.centre_lines) if road_map is not None else np.zeros((0, 3))
    return arranged(overviews(locations), view, None, live=True)


class LiveView:
    """Shows frames as they come.

    Args:
        stream: The stream, whose blueprint is that of `live_blueprint`.
        header: The header of the recording.
        source: The origin of the frames.
        follow: The actor that the camera follows as soon as it is present: an id, or "hero".
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
        self._follow = follow
        self._view: View = view
        self._followed: int | None = None
        self._scenes = LiveScenes()
        describe(stream, header, f"{header.map_name}, live", source)
        self._writer = SceneWriter(stream, road_map=road_map)

    def enter(self, frame: Frame) -> None:
        """Add a frame."""
        scene = self._scenes.scene(frame)
        if self._followed not in scene.actors:
            self._find_followed(scene)
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

    def _find_followed(self, scene: Scene) -> None:
        if self._follow == HERO:
            found = next((id for id, actor in scene.actors.items() if actor.is_hero), None)
        else:
            found = self._follow if self._follow in scene.actors else None
        if found is not None and found != self._followed:
            self._followed = found
            self._writer.follow(found)
            send_blueprint(live_blueprint(view=self._view, followed=found), self._stream)
