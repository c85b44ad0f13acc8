"""The incident page: a folder that shows what happened in a recording, in any browser, with or without a server."""

from __future__ import annotations

from collections import Counter
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

from carla_recap.errors import RecapError
from carla_recap.export.assets import viewer_folder
from carla_recap.export.report import script
from carla_recap.export.report.drawing import draw
from carla_recap.export.report.embedded import embed
from carla_recap.export.report.ground import ground
from carla_recap.export.report.tracks import Sampler, Tracks
from carla_recap.export.style import LIGHTS, OTHER, STYLES
from carla_recap.model.stationary import MIN_DISTANCE, MIN_TIME
from carla_recap.queries.incidents import HARD, Incident, incidents
from carla_recap.recording import Recording
from carla_recap.replay.player import Player
from carla_recap.util.files import check_folder, copy_files, new_folder
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from carla_recap.formats.base import Reader
    from carla_recap.maps import RoadMap
    from carla_recap.replay.player import Progress
    from carla_recap.replay.scene import Scene

Pictures = Literal["drawn", "rerun", "none"]
"""Drawn from above; taken from behind the first actor, through Rerun's viewer; or none."""

BUDGET: Final = 15_000_000
"""Bytes of samples that a page loads at once, 20 MB as text; of a longer recording it has the time around incidents."""

RATES: Final = (20.0, 10.0)  # samples per second, of a recording as a whole
REPLAYED: Final = 200  # incidents with a picture and, of a long recording, with a replay
FIRST: Final = ("collision", "hard braking", "blocked")  # which of them, if there are more
PICTURE_SIZE: Final = (640, 400)
LISTED: Final = 2000  # incidents in the list


class Report(NamedTuple):
    """What a page holds.

    Attributes:
        folder: Where it is.
        incidents: How many incidents it lists.
        pictures: How many pictures it has.
        whole: Whether it replays all of the recording, not only the time around incidents.
        seconds: How many seconds it replays.
        size: Bytes of all its files.
    """

    folder: Path
    incidents: int
    pictures: int
    whole: bool
    seconds: float
    size: int


def write_report(
    source: Recording | Reader,
    folder: Path | str,
    *,
    before: float = 5.0,
    after: float = 5.0,
    min_time: float = MIN_TIME,
    min_distance: float = MIN_DISTANCE,
    deceleration: float = HARD,
    road_map: RoadMap | None = None,
    pictures: Pictures = "drawn",
    viewer: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> Report:
    """Write the incident page of a recording.

    Args:
        source: The recording.
        folder: Where to; its `index.html` opens from the disk, or from any server.
        before: Seconds before an incident that its picture shows; and the replay, of a recording too long for all of it.
        after: Seconds after it.
        min_time: What counts as an incident, as the next two: see `carla_recap.queries.incidents`.
        min_distance: In cm.
        deceleration: In m/s².
        road_map: The roads to show.
        pictures: "drawn": a drawing of each incident, from above; "rerun": a view from behind the first actor, which takes
            seconds for each, and the extra `rerun`; or "none".
        viewer: Add Rerun's viewer, to see the scene in 3D; it needs the extra `rerun`, and a server for the page.
        force: Write into a folder that has something in it already.
        progress: Is given the stream of scenes and their player, and passes the scenes on.

    Raises:
        RecapError: The recording is damaged or empty, the folder is taken, or Rerun's viewer cannot draw here.
        MissingExtra: Pictures through Rerun, or its viewer, were asked for without it.
    """
    if not (before >= 0 and after >= 0):
        raise RecapError(f"{before:g} s before and {after:g} s after incidents cannot be shown; 0 or more were expected")
    check_folder(folder, force=force)
    recording = source if isinstance(source, Recording) else Recording(source)
    all_found = incidents(recording.reader, min_time=min_time, min_distance=min_distance, deceleration=deceleration)
    found = all_found[:LISTED]
    player = Player(recording)
    shown = sorted(range(len(found)), key=lambda place: FIRST.index(found[place].kind))[:REPLAYED]
    tracks, whole = _sample(recording, [found[place] for place in shown], before, after, progress)
    below = ground(road_map, tracks)
    if viewer and not whole:
        raise RecapError(f"{recording.path}: is too long for the viewer in a page; clips of its incidents are not")
    with new_folder(folder) as room:
        copy_files(viewer_folder() / "page", room)
        if viewer:
            embed(recording, room / "rerun", road_map)
        (room / "data").mkdir()
        (room / "pictures").mkdir()
        names: dict[int, str] = {}
        for place in shown if pictures != "none" else ():
            incident = found[place]
            followed = next((id for id in incident.actors if id in tracks.ids(incident.start)), None)
            if pictures == "rerun" and followed is not None:
                names[place] = f"pictures/incident-{place + 1:04}.png"
                picture = _taken(recording, incident, followed, road_map)
            elif tracks.covers(incident.start):
                names[place] = f"pictures/incident-{place + 1:04}.svg"
                picture = draw(incident, tracks, below, before=before, after=after).encode()
            else:
                continue
            (room / names[place]).write_bytes(picture)
        summary = _summary(recording, player, found, names, whole=whole)
        summary |= {"viewer": viewer, "omitted": len(all_found) - len(found)}
        (room / "data" / "report.js").write_text(script.script("REPORT", summary), "ascii")
        (room / "data" / "ground.js").write_text(script.script("GROUND", script.layers(below)), "ascii")
        (room / "data" / "recording.js").write_text(script.script("RECORDING", script.recording(tracks)), "ascii")
        size = sum(file.stat().st_size for file in room.rglob("*") if file.is_file())
    seconds = sum(stop - start for start, stop in tracks.spans)
    return Report(Path(folder), len(found), len(names), whole, seconds, size)


def _taken(recording: Recording, incident: Incident, followed: int, road_map: RoadMap | None) -> bytes:
    from carla_recap.export.snapshot import picture

    return picture(recording, at=incident.start, follow=followed, road_map=road_map, size=PICTURE_SIZE)


def _sample(
    recording: Recording, found: Sequence[Incident], before: float, after: float, progress: Progress | None
) -> tuple[Tracks, bool]:
    """All of a recording if it is small enough, else the time around its incidents; and which of the two."""
    for rate in RATES:
        player = Player(recording)
        sampler = Sampler(rate)
        scenes = progress(player.scenes(), player) if progress else player.scenes()
        for scene in scenes:
            sampler.add(scene, last=player.finished)
            if sampler.size > BUDGET:
                break
        else:
            return sampler.finish(), True
        if scene.time - player.start < RATES[-1] / RATES[0] * (player.stop - player.start):
            break  # at half the rate it would still be too much
    player, sampler = Player(recording), Sampler(RATES[0])
    scenes = _around(player, _windows(found, before, after, player.total), sampler)
    for scene in progress(scenes, player) if progress else scenes:
        sampler.add(scene)
        if sampler.size > BUDGET:
            break
    return sampler.finish(), False


def _windows(found: Sequence[Incident], before: float, after: float, total: float) -> list[tuple[float, float]]:
    """The times around incidents, those that overlap as one."""
    windows: list[tuple[float, float]] = []
    for start, stop in sorted((max(0.0, one.start - before), min(total, one.start + after)) for one in found):
        if windows and start <= windows[-1][1]:
            windows[-1] = (windows[-1][0], max(stop, windows[-1][1]))
        else:
            windows.append((start, stop))
    return windows


def _around(player: Player, windows: Sequence[tuple[float, float]], sampler: Sampler) -> Iterator[Scene]:
    for start, stop in windows:
        sampler.begin()
        yield player.at(start)
        for scene in player.scenes():
            if scene.time > stop:
                break
            yield scene


def _summary(
    recording: Recording, player: Player, found: Sequence[Incident], pictures: dict[int, str], *, whole: bool
) -> dict[str, Any]:
    info = recording.info
    counts = Counter(actor.kind.replace("_", " ") for actor in recording.actors.values())
    colors = {style.name: script.hexadecimal(style.color) for style in (*STYLES.values(), OTHER)}
    kinds = [kind for kind in colors if kind in counts] + [kind for kind in counts if kind not in colors]
    return {
        "program": f"carla-recap {version('carla-recap')}",
        "source": script.shortened(recording.path.name),
        "map": script.shortened(readable(info.map_name).rpartition("/")[2]),
        "date": None if info.date is None else info.date.isoformat(),
        "version": info.version,
        "frames": info.frames,
        "duration": script.number(info.duration),
        "kinds": [[kind, counts[kind], colors.get(kind, colors[OTHER.name])] for kind in kinds],
        "lights": [[name, script.hexadecimal(color)] for name, color in LIGHTS],
        "whole": whole,
        "follow": player.followed,
        "incidents": [_incident(incident, pictures.get(place)) for place, incident in enumerate(found)],
    }


def _incident(incident: Incident, picture: str | None) -> dict[str, Any]:
    return {
        "kind": incident.kind,
        "start": script.number(incident.start),
        "stop": script.number(incident.stop),
        "actors": list(incident.actors),
        "types": [script.shortened(type_id) for type_id in incident.type_ids],
        "place": [script.number(value, 2) for value in (incident.x, incident.y, incident.z)],
        "text": incident.text[: 2 * script.LONGEST],
        "picture": picture,
    }
