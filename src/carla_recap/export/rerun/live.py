"""A world that goes on, in a Rerun stream: it looks as its recording would."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from carla_recap.export.rerun import tree
from carla_recap.export.rerun.blueprint import View, arranged, follow_views, overviews
from carla_recap.export.rerun.rrd import send_blueprint
from carla_recap.export.rerun.stage import Stage, introduce
from carla_recap.replay.follow import HERO, Follow
from carla_recap.replay.live import LiveScenes

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from carla_recap.maps import RoadMap
    from carla_recap.model.frame import Frame, Header
    from carla_recap.replay import Scene


def live_blueprint(road_map: RoadMap | None = None, *, view: View = "chase", followed: int | None = None) -> rrb.Blueprint:
    """The arrangement of views for a world that goes on.

    Args:
        road_map: The map of the town, which is seen as a whole as long as nobody is followed.
        view: Which of the two cameras is shown first.
        followed: Whom they follow; None: nobody.
    """
    if followed is not None:
        return arranged(follow_views(tree.CHASE, "", followed), view, followed, live=True)
    places = np.concatenate(road_map.centre_lines) if road_map is not None else np.zeros((0, 3))
    return arranged(overviews(places), view, None, live=True)


class LiveView:
    """Shows frames as they come.

    Args:
        stream: Where to; its blueprint is that of `live_blueprint`.
        header: What is shown.
        source: Where it comes from.
        follow: Whom the camera follows as soon as it is there: an id, or "hero": whoever is the hero.
        view: Which camera is shown first.
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
        introduce(stream, header, f"{header.map_name}, live", source)
        self._stage = Stage(stream, road_map=road_map)

    def enter(self, frame: Frame) -> None:
        """Take a frame in."""
        scene = self._scenes.scene(frame)
        if self._followed not in scene.actors:
            self._look_for_followed(scene)
        self._stage.enter(scene)

    def flush(self) -> None:
        """Show what was taken in."""
        self._stage.flush()

    def close(self) -> None:
        """Show the rest.

        Warns:
            RecapWarning: There were too many actors to show all of them.
        """
        self._stage.close()

    def _look_for_followed(self, scene: Scene) -> None:
        if self._follow == HERO:
            found = next((id for id, actor in scene.actors.items() if actor.is_hero), None)
        else:
            found = self._follow if self._follow in scene.actors else None
        if found is not None and found != self._followed:
            self._followed = found
            self._stage.follow(found)
            send_blueprint(live_blueprint(view=self._view, followed=found), self._stream)
