"""A picture of a moment, drawn by Rerun's viewer without a display and without a GPU."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.editing.convert import check_destination
from carla_recap.errors import RecapError
from carla_recap.export.rerun import Rrd, View, camera_views, write
from carla_recap.export.screenshots import Photographer, Size
from carla_recap.recording import Recording
from carla_recap.replay import Player
from carla_recap.util.files import WholeFile

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader
    from carla_recap.maps import RoadMap
    from carla_recap.replay.follow import Follow

_LEAD: Final = 5.0  # s; of what came before, a picture shows the trail
_SHORTEST: Final = 1e-3  # s; no duration at all would be all of the recording


def snapshot(
    source: Recording | Reader,
    destination: Path | str,
    *,
    at: float,
    follow: Follow | None = None,
    view: View = "chase",
    road_map: RoadMap | None = None,
    size: Size = (1280, 720),
    force: bool = False,
) -> None:
    """Write a picture of a moment.

    Args:
        source: The recording.
        destination: The .png; it appears when it is complete.
        at: The moment, in elapsed seconds; negative: so long before the end.
        follow: Whom the camera follows: an id or "hero"; None: see `choose_followed`, of the seconds before.
        view: From behind, or from above.
        road_map: The map of the town.
        size: Width and height, in pixels.
        force: Overwrite what is there.

    Raises:
        RecapError: There is no such moment or actor, the destination cannot be written, or the viewer cannot draw here.
        FormatError: The file contradicts its format.
    """
    reader = source.reader if isinstance(source, Recording) else source
    path = Path(destination)
    if path.suffix.lower() != ".png":
        raise RecapError(f"{path}: a picture is written as .png")
    check_destination(reader.path, path, force=force)
    data = picture(reader, at=at, follow=follow, view=view, road_map=road_map, size=size)
    with WholeFile(path) as file:
        file.write(data)


def picture(
    source: Recording | Reader,
    *,
    at: float,
    follow: Follow | None = None,
    view: View = "chase",
    road_map: RoadMap | None = None,
    size: Size = (1280, 720),
) -> bytes:
    """Take a picture of a moment.

    Args:
        source: The recording.
        at: See `snapshot`, as for all that follow.
        follow: Whom.
        view: From where.
        road_map: The map of the town.
        size: Width and height.

    Returns:
        A PNG.

    Raises:
        RecapError: There is no such moment or actor, or the viewer cannot draw here.
        FormatError: The file contradicts its format.
    """
    now = Player(source, start=at, follow=follow)
    moment = now.at(now.start).time
    if follow is not None and now.followed not in now.at(moment).ids:
        raise RecapError(f"{now.reader.path}: actor {now.followed} is not there at {moment:g} s, so it cannot be followed")
    pose = None if now.followed is None else now.at(moment).pose_of(now.followed)
    if pose is not None and not np.isfinite(pose).all():
        raise RecapError(f"{now.reader.path}: actor {now.followed} has no place at {moment:g} s: its pose is no number")
    start = max(0.0, moment - _LEAD)
    player = Player(source, start=start, duration=max(moment - start, _SHORTEST), follow=follow)
    with TemporaryDirectory(prefix="carla-recap-") as folder:
        path = Path(folder) / "moment.rrd"
        _save(path, player, view, road_map)
        with Photographer(path, size, only_view=True) as photographer:
            return photographer.take(moment)


def _save(path: Path, player: Player, view: View, road_map: RoadMap | None) -> None:
    """Write an .rrd that shows one view, and nothing around it."""
    import rerun.blueprint as rrb

    panels = (rrb.TopPanel, rrb.BlueprintPanel, rrb.SelectionPanel, rrb.TimePanel)
    alone = rrb.Blueprint(camera_views(player)[view], *(panel(state="hidden") for panel in panels))
    with WholeFile(path) as file, Rrd(alone) as rrd:
        write(rrd.stream, player, road_map=road_map)
        file.write(rrd.take())
