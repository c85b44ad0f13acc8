"""The incident page: a folder that shows the incidents of a recording in a browser, with or without a server."""

from __future__ import annotations

import shutil
from collections import Counter
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple
from urllib.request import ProxyHandler, build_opener

from carla_recap.errors import RecapError
from carla_recap.export import viewer_folder
from carla_recap.export.report import script
from carla_recap.export.report.base_map import base_map
from carla_recap.export.report.drawing import draw
from carla_recap.export.report.samples import SampledReplay, Sampler
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
"""The pictures of incidents: drawn from above, taken by Rerun's viewer from behind the first actor, or none."""

BUDGET: Final = 15_000_000
"""The most bytes of samples in a page, 20 MB as text; of a longer recording, a page has only the time around incidents."""

RATES: Final = (20.0, 10.0)  # samples per second of a whole recording
REPLAYED: Final = 200  # the most incidents with a picture and, of a long recording, with a replay
FIRST: Final = ("collision", "hard braking", "blocked")  # the kinds of incidents in the order in which they are chosen
PICTURE_SIZE: Final = (640, 400)
LISTED: Final = 2000  # the most incidents in the list
VIEWER_FILES: Final = ("re_viewer.js", "re_viewer_bg.wasm")
_TIMEOUT: Final = 30.0  # s


class Report(NamedTuple):
    """The content of a page.

    Attributes:
        folder: The folder.
        incidents: The number of incidents in the list.
        pictures: The number of pictures.
        whole: Whether it replays the whole recording, not only the time around incidents.
        seconds: The length of the replay in seconds.
        size: The size of all files in bytes.
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
        folder: The folder to write; its `index.html` opens from the disk, or from any server.
        before: The seconds before an incident in its picture and, of a long recording, in the replay.
        after: The seconds after it.
        min_time: The time of standing still that counts as an incident, in seconds; see `carla_recap.queries.incidents`.
        min_distance: The distance at which an actor has moved, in cm.
        deceleration: The deceleration that counts as an incident, in m/s².
        road_map: The roads to show.
        pictures: "drawn": a drawing of each incident, from above; "rerun": a view from behind the first actor, which takes
            seconds for each, and the extra `rerun`; or "none".
        viewer: Add Rerun's viewer, to see the scene in 3D; it needs the extra `rerun`, and a server for the page.
        force: Write into a folder that is not empty.
        progress: Gets the scenes and their player, and yields the scenes.

    Raises:
        RecapError: The recording is damaged or empty, the folder is not empty, or Rerun's viewer cannot draw here.
        MissingExtra: `pictures` or `viewer` need Rerun, and it is not installed.
    """
    if not (before >= 0 and after >= 0):
        raise RecapError(f"{before:g} s before and {after:g} s after incidents cannot be shown; 0 or more were expected")
    check_folder(folder, force=force)
    recording = source if isinstance(source, Recording) else Recording(source)
    all_found = incidents(recording.reader, min_time=min_time, min_distance=min_distance, deceleration=deceleration)
    found = all_found[:LISTED]
    player = Player(recording)
    shown = sorted(range(len(found)), key=lambda index: FIRST.index(found[index].kind))[:REPLAYED]
    replay, whole = _sample(recording, [found[index] for index in shown], before, after, progress)
    roads = base_map(road_map, replay)
    if viewer and not whole:
        raise RecapError(f"{recording.path}: is too long for the viewer in a page; clips of its incidents are not")
    with new_folder(folder) as room:
        copy_files(viewer_folder() / "page", room)
        if viewer:
            _add_viewer(recording, room / "rerun", road_map)
        (room / "data").mkdir()
        (room / "pictures").mkdir()
        names: dict[int, str] = {}
        for index in shown if pictures != "none" else ():
            incident = found[index]
            followed = next((id for id in incident.actors if id in replay.ids(incident.start)), None)
            if pictures == "rerun" and followed is not None:
                names[index] = f"pictures/incident-{index + 1:04}.png"
                picture = _taken(recording, incident, followed, road_map)
            elif replay.covers(incident.start):
                names[index] = f"pictures/incident-{index + 1:04}.svg"
                picture = draw(incident, replay, roads, before=before, after=after).encode()
            else:
                continue
            (room / names[index]).write_bytes(picture)
        summary = _summary(recording, player, found, names, whole=whole)
        summary |= {"viewer": viewer, "omitted": len(all_found) - len(found)}
        (room / "data" / "report.js").write_text(script.script("REPORT", summary), "ascii")
        (room / "data" / "ground.js").write_text(script.script("GROUND", script.base_map_data(roads)), "ascii")
        (room / "data" / "recording.js").write_text(script.script("RECORDING", script.recording_data(replay)), "ascii")
        size = sum(file.stat().st_size for file in room.rglob("*") if file.is_file())
    seconds = sum(stop - start for start, stop in replay.spans)
    return Report(Path(folder), len(found), len(names), whole, seconds, size)


def _taken(recording: Recording, incident: Incident, followed: int, road_map: RoadMap | None) -> bytes:
    from carla_recap.export.screenshots import picture

    return picture(recording, at=incident.start, follow=followed, road_map=road_map, size=PICTURE_SIZE)


def _add_viewer(recording: Recording, folder: Path, road_map: RoadMap | None) -> None:
    """Write Rerun's viewer, a recording for it, and a blueprint for each actor that it can follow, into a new folder."""
    from carla_recap.export.rerun import export_rerun

    folder.mkdir()
    copy_files(viewer_folder() / "page" / "rerun", folder)
    _copy_viewer(folder)
    export_rerun(recording, folder / "recording.rrd", road_map=road_map, cameras=folder / "cameras")


def _copy_viewer(folder: Path) -> None:
    """Copy the web viewer from Rerun's own server."""
    from carla_recap.export.viewer import HOST, WEB_PORT, RerunViewer

    opener = build_opener(ProxyHandler({}))
    with RerunViewer("--serve-web", "--web-viewer-port", "0") as process:
        port = process.port(WEB_PORT)
        try:
            for name in VIEWER_FILES:
                url = f"http://{HOST}:{port}/{name}"
                with opener.open(url, timeout=_TIMEOUT) as source, (folder / name).open("wb") as file:
                    shutil.copyfileobj(source, file)
        except OSError as error:
            raise RecapError(f"the Rerun viewer does not hand out {name}: {error}") from None


def _sample(
    recording: Recording, found: Sequence[Incident], before: float, after: float, progress: Progress | None
) -> tuple[SampledReplay, bool]:
    """Return the samples of a recording, or if they are too large, those around its incidents; and whether it is all."""
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
            break  # it would be too large at half the rate, too
    player, sampler = Player(recording), Sampler(RATES[0])
    scenes = _around(player, _windows(found, before, after, player.total), sampler)
    for scene in progress(scenes, player) if progress else scenes:
        sampler.add(scene)
        if sampler.size > BUDGET:
            break
    return sampler.finish(), False


def _windows(found: Sequence[Incident], before: float, after: float, total: float) -> list[tuple[float, float]]:
    """Return the intervals around incidents; those that overlap are joined."""
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
        "incidents": [_incident(incident, pictures.get(index)) for index, incident in enumerate(found)],
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
