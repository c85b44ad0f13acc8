"""The frames of a running simulation as a Rerun stream."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.actors import ROAD_USERS, heroes_of
from carla_recap.replay.follow import HERO, Follow
from carla_recap.replay.player import LiveScenes
from carla_recap.replay.pose import LOCATION
from carla_recap.scene.ahead import add_stop_points
from carla_recap.scene.appearance import look_of_present
from carla_recap.show.rerun.blueprint import View, live_blueprint
from carla_recap.show.rerun.rrd import send_blueprint
from carla_recap.show.rerun.writer import SceneWriter, describe

if TYPE_CHECKING:
    import rerun as rr
    from numpy.typing import NDArray

    from carla_recap.model.frame import Frame, Header
    from carla_recap.replay import Scene
    from carla_recap.roads import RoadMap

_PATIENCE: Final = 3.0  # s after which an actor is followed that does not move
_MOVED: Final = 1.0  # cm from one frame to the next


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


class LiveChoice:
    """Chooses the actor that the camera follows while nothing is known of what comes.

    Args:
        follow: An id, or "hero": the hero as soon as there is one; until then, a vehicle that moves, else a walker that
            does; and if nothing has moved for some seconds, the first vehicle or walker.
    """

    def __init__(self, follow: Follow) -> None:
        self._follow = follow
        self._chosen: int | None = None
        self._since: float | None = None  # the time since which no actor is followed
        self._before: dict[int, NDArray[np.float64]] = {}

    def choose(self, scene: Scene) -> int | None:
        """Return the actor to follow from the next scene on; None if there is none."""
        if self._follow != HERO:
            return self._follow if self._follow in scene.actors else None
        if heroes := heroes_of(scene.actors.values()):
            self._chosen = heroes[0].id
        elif self._chosen not in scene.actors:
            self._chosen = self._other(scene)
        return self._chosen

    def _other(self, scene: Scene) -> int | None:
        if self._since is None:
            self._since = scene.time
        movers = {kind: [id for id, actor in scene.actors.items() if actor.kind == kind] for kind in ROAD_USERS}
        here = {id: pose[LOCATION] for those in movers.values() for id in those if (pose := scene.pose_of(id)) is not None}
        before, self._before = self._before, here
        with np.errstate(invalid="ignore"):
            moved = {id for id in here if id in before and (np.abs(here[id] - before[id]) > _MOVED).any()}
        patient = scene.time - self._since < _PATIENCE
        for those in movers.values():
            found = next((id for id in those if id in moved), None)
            if found is not None:
                break
        else:
            found = None if patient else next((id for those in movers.values() for id in those if id in here), None)
        if found is not None:
            self._since, self._before = None, {}
        return found
