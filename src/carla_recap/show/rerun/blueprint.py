"""The arrangement of the viewer: the followed actor large, beside it the map, its plots, the lights and the log."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from carla_recap.model.records import CM
from carla_recap.queries.recorded_actors import actors
from carla_recap.queries.sensors import IMAGES, PICTURES, kind_of, sensors
from carla_recap.replay import camera
from carla_recap.replay.recorded_map import first_locations
from carla_recap.scene import style
from carla_recap.scene.appearance import look_of_present
from carla_recap.scene.follow import CONTROLS
from carla_recap.show.rerun import entities
from carla_recap.show.rerun.followed import FARTHEST, LATEST, LOOK_DOWN, Triple, chase_eye
from carla_recap.show.rerun.stream import FRAME, SIM_TIME

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.lives import ActorLife
    from carla_recap.replay import Player
    from carla_recap.roads import RoadMap

View = Literal["chase", "top"]
"""The camera: behind and above the actor, or straight above it."""

MOST_IMAGES: Final = 16
"""The number of cameras whose images have a view."""

_IN_A_COLUMN: Final = 3  # images; more are in two columns
_TRAIL: Final = 4.0  # s; the time for which the trail is shown
_TRAIL_FRAMES: Final = 80  # the same in frames
_MIN_RADIUS: Final = 30.0  # m; of what an overview shows
_ACCELERATIONS: Final = (-10.0, 6.0)  # m/s²; those of a collision are beyond
_EYE_SPEED: Final = 20.0  # m/s, by the keyboard


def blueprint(
    player: Player,
    *,
    view: View = "chase",
    followed: int | None = None,
    lives: Iterable[ActorLife] | None = None,
    verdicts: bool = False,
) -> rrb.Blueprint:
    """Return the arrangement of views for a recording, with or without verdicts; the other camera is a tab beside `view`.

    The cameras follow the actor that the player follows, or another one, which needs the axes that `write` adds with
    `cameras`; without one, they stand still. The actors of the recording are given if they are known.
    """
    images = _images(player.reader)
    shown = [rrb.Spatial2DView(origin=path.rpartition("/")[0], contents=path, name=path.split("/")[-2]) for path in images]
    hidden = [path for path, kind in images.items() if kind not in PICTURES]
    followed = player.followed if followed is None else followed
    if followed is None:
        cameras = _overviews(first_locations(player), hidden)
    else:
        present = actors(player.reader) if lives is None else lives
        look = next((look_of_present(life) for life in present if life.id == followed), None)
        own = followed == player.followed
        axes, suffix = (entities.CHASE, "") if own else (entities.camera(followed), f" {followed}")
        cameras = _follow_views(axes, suffix, player.followed, None if look is None else look.half_extents, hidden)
    return _arranged(cameras, view, player.followed, images=shown[:MOST_IMAGES], verdicts=verdicts)


def _images(reader: Reader) -> dict[str, str]:
    """Return the kinds of the images of sensors by their paths."""
    kinds = ((sensor.id, kind_of(topic)) for sensor in sensors(reader) for topic in sensor.topics)
    return {entities.sensor(id, kind): kind for id, kind in kinds if kind in IMAGES}


def _arranged(
    cameras: Mapping[View, rrb.Spatial3DView],
    view: View,
    ego: int | None,
    *,
    live: bool = False,
    images: Sequence[rrb.Spatial2DView] = (),
    verdicts: bool = False,
) -> rrb.Blueprint:
    """Return the arrangement of views around those of the cameras.

    One actor may have plots. A live one shows the latest frame; verdicts of rules are before the other lanes.
    """
    log = rrb.TextLogView(
        origin=entities.EVENTS,
        name="Events",
        columns=rrb.TextLogColumns(timeline_columns=[SIM_TIME], text_log_columns=["loglevel", "body"]),
    )
    lanes = [rrb.StateTimelineView(origin=entities.STATES, name="All traffic lights")]
    if ego is not None:
        lanes.insert(0, rrb.StateTimelineView(origin=entities.LIGHT_AHEAD, name=f"Light ahead of {ego}"))
    lanes.append(rrb.StateTimelineView(origin=entities.INCIDENTS, name="Incidents"))
    if verdicts:
        lanes.insert(0, rrb.StateTimelineView(origin=entities.VERDICTS, name="Verdicts"))
    scene = rrb.Vertical(
        rrb.Tabs(*cameras.values(), active_tab=list(cameras).index(view)),
        rrb.Horizontal(rrb.Tabs(*lanes), log, column_shares=[2, 3]),
        row_shares=[4, 1],
    )
    beside: list[rrb.View | rrb.Container] = [
        rrb.Spatial2DView(origin=entities.MAP, name="Map", background=[*style.MAP, 255])
    ]
    if ego is not None:
        beside += _plots(ego, live=live)
    columns: list[rrb.Container] = [scene, rrb.Vertical(*beside, row_shares=[2] + [1] * (len(beside) - 1))]
    if images:
        columns.insert(1, rrb.Grid(*images, grid_columns=1 if len(images) <= _IN_A_COLUMN else 2, name="Cameras"))
    return rrb.Blueprint(
        rrb.Horizontal(*columns, column_shares=[3, 1] if not images else [5, 3, 2]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=SIM_TIME, play_state="following" if live else "playing"),
    )


def live_blueprint(
    road_map: RoadMap | None = None,
    *,
    view: View = "chase",
    followed: int | None = None,
    half_extents: Triple | None = None,
) -> rrb.Blueprint:
    """Return the arrangement of views for a running simulation: the map as a whole, until an actor is followed."""
    if followed is not None:
        return _arranged(_follow_views(entities.CHASE, "", followed, half_extents), view, followed, live=True)
    locations = np.concatenate(road_map.centre_lines) if road_map is not None else np.zeros((0, 3))
    return _arranged(_overviews(locations), view, None, live=True)


def _overviews(locations: NDArray[np.float64], hidden: Sequence[str] = ()) -> dict[View, rrb.Spatial3DView]:
    """Return the views of cameras that stand still and see some locations: (n, 3) in m, right-handed."""
    ends = np.stack((locations.min(axis=0), locations.max(axis=0))) if len(locations) else np.zeros((2, 3))
    x, y, z = centre = tuple(ends.mean(axis=0).tolist())
    radius = max(_MIN_RADIUS, float(np.linalg.norm(ends[1] - ends[0])) / 2)
    return {
        "chase": _view(
            "Overview", entities.WORLD, (x - 1.5 * radius, y, z + 1.2 * radius), (x, y, z), (0, 0, 1), hidden=hidden
        ),
        "top": _view("Top", entities.WORLD, (x, y, z + 2.2 * radius), centre, (0, 1, 0), hidden=hidden),
    }


def _follow_views(
    axes: str, suffix: str, ego: int | None, half_extents: Triple | None = None, hidden: Sequence[str] = ()
) -> dict[View, rrb.Spatial3DView]:
    """Return the views of cameras that stand still in axes that move, with the end of their titles and the ego's trail."""
    back, _, up = eye = chase_eye(half_extents)
    ahead = up - back * math.tan(math.radians(LOOK_DOWN))
    return {
        "chase": _view(f"Chase{suffix}", axes, eye, (0, 0, ahead), (0, 0, 1), ego, hidden),
        "top": _view(f"Top{suffix}", axes, (0, 0, camera.TOP_UP * CM), (0, 0, 0), (1, 0, 0), ego, hidden),
    }


def _plots(id: int, *, live: bool) -> list[rrb.View | rrb.Container]:
    others = rrb.Tabs(
        _plot(entities.TIMES, "Collision (red), headway (s)", (0.0, LATEST)),
        _plot(entities.DISTANCES, "Gap (white), headway (m)", (0.0, FARTHEST)),
    )
    steering = rr.SeriesLines(visible_series=[name == "steer" for name in CONTROLS])
    return [
        _plot(entities.SPEED, f"Speed of {id} (km/h)"),
        _plot(entities.ACCELERATION, "Acceleration (m/s²)", _ACCELERATIONS),
        *(() if live else (others,)),
        _plot(
            entities.EGO,
            "Throttle, brake, steer",
            (-1.05, 1.05),
            contents=[entities.CONTROLS, entities.PEDALS],
            overrides={entities.CONTROLS: steering},
        ),
    ]


def _plot(origin: str, name: str, values: tuple[float, float] | None = None, **options: Any) -> rrb.TimeSeriesView:
    """Return a plot of the values in a range, without a legend, which would cover the lines."""
    axis = None if values is None else rrb.ScalarAxis(range=values)
    return rrb.TimeSeriesView(origin=origin, name=name, axis_y=axis, plot_legend=rrb.PlotLegend(visible=False), **options)


def _view(
    name: str,
    origin: str,
    position: tuple[float, float, float],
    target: tuple[float, float, float],
    up: tuple[float, float, float],
    ego: int | None = None,
    hidden: Sequence[str] = (),
) -> rrb.Spatial3DView:
    """Return the view of a camera in some axes, with the trail of the ego, and without the paths that are hidden."""
    now = rr.TimeRangeBoundary.cursor_relative()
    trail = rrb.VisibleTimeRanges(
        [
            rr.VisibleTimeRange(SIM_TIME, start=rr.TimeRangeBoundary.cursor_relative(seconds=-_TRAIL), end=now),
            rr.VisibleTimeRange(FRAME, start=rr.TimeRangeBoundary.cursor_relative(seq=-_TRAIL_FRAMES), end=now),
        ]
    )
    return rrb.Spatial3DView(
        origin=origin,
        contents=[f"+ {entities.WORLD}/**", *(f"- {path}" for path in hidden)],
        name=name,
        background=[*style.HORIZON, 255],
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=position, look_target=target, eye_up=up, speed=_EYE_SPEED),
        overrides={entities.trail(ego): trail} if ego is not None else None,
    )
