"""An export to Rerun: the .rrd of a recording."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from carla_recap.editing.convert import check_destination
from carla_recap.errors import RecapError
from carla_recap.queries.recorded_actors import actors
from carla_recap.recording import Recording
from carla_recap.replay import Played, Player
from carla_recap.show.rerun import check_rerun
from carla_recap.util.files import check_folder, new_folder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carla_recap.formats.base import Reader
    from carla_recap.queries.incidents import IncidentOptions
    from carla_recap.queries.verdicts import Verdict
    from carla_recap.replay.follow import Follow
    from carla_recap.replay.player import Progress
    from carla_recap.roads import RoadMap
    from carla_recap.show.rerun.blueprint import View


def export_rerun(
    source: Recording | Reader,
    destination: Path | str,
    *,
    follow: Follow | None = None,
    start: float = 0.0,
    duration: float = 0.0,
    view: View = "chase",
    road_map: RoadMap | None = None,
    incidents: IncidentOptions | None = None,
    verdicts: Sequence[Verdict] = (),
    cameras: Path | str | None = None,
    ghost: Recording | Reader | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Played:
    """Write an .rrd, which Rerun's viewer opens with a camera behind the followed actor; see `export`.

    `view` is the camera that is shown first. `cameras` is a folder for a blueprint of each vehicle and walker,
    `follow_<id>.rbl`: opened together with the .rrd, it makes the camera follow that actor. `ghost` is another recording of
    the same scenario, whose vehicles and walkers are shown as ghosts from when on they are elsewhere. Return the number of
    scenes, and the seconds that they span.
    """
    check_rerun()
    from carla_recap.show.rerun.blueprint import blueprint
    from carla_recap.show.rerun.ghosts import write_ghosts
    from carla_recap.show.rerun.sinks import rrd_file, save_blueprint
    from carla_recap.show.rerun.writer import filmed, write

    reader = source.reader if isinstance(source, Recording) else source
    other = ghost.reader if isinstance(ghost, Recording) else ghost
    for read in filter(None, (reader, other)):
        check_destination(read.location, destination, force=force)
    if cameras is not None:
        check_folder(cameras, force=force)
        if Path(cameras).absolute() == Path(destination).absolute():
            raise RecapError(f"{cameras}: is the destination itself; a folder was expected")
    player = Player(reader, start=start, duration=duration, follow=follow)
    lives = actors(reader)
    cameras_of = [] if cameras is None else filmed(player, lives)
    with (
        nullcontext(Path()) if cameras is None else new_folder(cameras) as folder,
        rrd_file(destination, blueprint(player, view=view, lives=lives, verdicts=bool(verdicts)), force=force) as stream,
    ):
        played = write(
            stream,
            player,
            road_map=road_map,
            incidents=incidents,
            verdicts=verdicts,
            progress=progress,
            cameras=cameras_of,
        )
        if other is not None:
            write_ghosts(stream, reader, other, start=player.start, duration=played.seconds, follow=player.followed)
        for id in cameras_of:
            save_blueprint(blueprint(player, view=view, followed=id, lives=lives), folder / f"follow_{id}.rbl")
    return played
