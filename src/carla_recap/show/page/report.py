"""The incident page: what went wrong in a recording, in a browser, with or without a server; or in two, to compare them."""

from __future__ import annotations

import math
import shutil
import warnings
from collections import Counter
from dataclasses import replace
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

from carla_recap.errors import FormatError, MissingExtra, RecapError, RecapWarning
from carla_recap.model.lives import ROAD_USERS
from carla_recap.queries.incidents import Incident, IncidentOptions, incidents, with_roads
from carla_recap.queries.kinds import KINDS
from carla_recap.recording import Recording
from carla_recap.replay.player import Player
from carla_recap.roads.find import map_key
from carla_recap.roads.surfaces import road_network_of_map
from carla_recap.scene.falls import RecordedContacts
from carla_recap.scene.style import LIGHTS, OTHER, STYLES
from carla_recap.show.page import script
from carla_recap.show.page.base_map import base_map
from carla_recap.show.page.images import PageImages, camera_of, page_images
from carla_recap.show.page.samples import measure, sample
from carla_recap.show.page.script import Packer, data_address, single_page
from carla_recap.town.mesh import load_town_of, town_of_map
from carla_recap.util.files import WholeFile, check_folder, check_path, copy_files, new_folder
from carla_recap.util.resources import viewer_folder
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from carla_recap.formats.base import Reader
    from carla_recap.queries.differences import Differences
    from carla_recap.replay.player import Progress
    from carla_recap.roads import RoadMap
    from carla_recap.town.mesh import TownMesh

Pictures = Literal["drawn", "rendered", "none"]
"""The pictures of incidents: drawn from above, rendered from behind the first actor, or none."""

SINGLE: Final = (".html", ".htm")  # the suffixes of a page that is one file
ALL: Final = IncidentOptions(kinds="all")
MEASURED: Final = 20  # the most actors whose acceleration and gap are plotted
REPLAYED: Final = 200  # the most incidents with a taken picture and, of a long recording, with a replay
PICTURE_SIZE: Final = (640, 400)
FRAME: Final = 720  # pixels; the height of a page in a notebook
LISTED: Final = 2000  # the most incidents in the list
TOLERANCE: Final = 0.5  # m by which actors of two recordings may be apart, unless differences are given
NOTES: Final = 4  # the most notes
VIEWER_FILES: Final = ("re_viewer.js", "re_viewer_bg.wasm")
_TIMEOUT: Final = 30.0  # s


class Report(NamedTuple):
    """The content of a page."""

    path: Path  # the folder or file
    incidents: int  # the number of incidents in the list
    whole: bool  # whether it replays the whole recording, not only the time around incidents
    seconds: float  # the length of the replay
    images: int  # the number of images of cameras
    size: int  # the size of all files in bytes

    def _repr_html_(self) -> str:
        """Return the page, in a frame of a notebook; of a folder, its place."""
        if self.path.suffix.lower() not in SINGLE:
            return f"<p>{escape(str(self.path / 'index.html'))}</p>"
        page = escape(self.path.read_text("utf-8"))
        return f'<iframe srcdoc="{page}" style="width: 100%; height: {FRAME}px; border: 0"></iframe>'


class Opening(NamedTuple):
    """What a page shows first."""

    # the moment, in elapsed seconds, shown from a little before; None: that of the last incident, with its actors, or
    # without incidents the beginning
    time: float | None = None
    actors: tuple[int, ...] = ()  # the ids of its actors, of which the first is followed
    notes: tuple[str, ...] = ()  # what the page is about, such as broken rules, a line each


class _Reported:
    """A recording in a page."""

    def __init__(
        self,
        recording: Recording,
        options: IncidentOptions,
        around: tuple[float, float],
        camera: str | None,
        progress: Progress | None,
    ) -> None:
        self.recording = recording
        shown = camera_of(recording, camera)
        self.followed = Player(recording).followed
        found = incidents(recording.reader, options)
        self.incidents = found[:LISTED]
        self.omitted = len(found) - len(self.incidents)
        ranks = list(KINDS)
        chosen = sorted(range(len(self.incidents)), key=lambda index: ranks.index(found[index].kind))[:REPLAYED]
        self.chosen = {index: self.incidents[index] for index in chosen}
        self.replay, self.whole = sample(recording, list(self.chosen.values()), *around, progress)
        self.measured = measure(recording, self._plotted(), self.replay.times)
        self.pictures: dict[int, bytes] = {}
        self.images: PageImages | None = None
        if shown is not None:
            try:
                self.images = page_images(recording, shown, self.replay.spans)
            except (FormatError, MissingExtra) as error:
                if camera is not None:
                    raise
                warnings.warn(f"the page has no images of the camera {shown}: {error}", RecapWarning, stacklevel=4)

    @property
    def counts(self) -> tuple[int, int]:
        """The number of incidents and that of images of a camera."""
        return len(self.incidents), len(self.images.images) if self.images else 0

    def _plotted(self) -> list[int]:
        """Return the actors whose acceleration and gap are plotted: the followed one, heroes, and those of incidents."""
        actors = self.recording.actors
        heroes = [id for id, actor in actors.items() if actor.is_hero]
        involved = [id for incident in self.incidents for id in incident.actors]
        followed = [] if self.followed is None else [self.followed]
        ids = dict.fromkeys([*followed, *heroes, *involved])
        return [id for id in ids if id in actors and actors[id].kind in ROAD_USERS][:MEASURED]

    def take_pictures(self, town: TownMesh | None) -> None:
        """Render a picture of each chosen incident, from behind the first of its actors that is present."""
        from carla_recap.show.video.film import opened_renderer
        from carla_recap.show.video.picture import picture

        contacts = RecordedContacts(self.recording.reader)
        with opened_renderer(None, town, self.recording, supersampling=2) as opened:
            for index, incident in self.chosen.items():
                followed = next((id for id in incident.actors if id in self.replay.ids(incident.start)), None)
                if followed is not None:
                    self.pictures[index] = picture(
                        self.recording,
                        at=incident.start,
                        follow=followed,
                        size=PICTURE_SIZE,
                        overlay=False,
                        renderer=opened.result(),
                        form="JPEG",
                        contacts=contacts,
                    )


def write_report(
    source: Recording | Reader,
    path: Path | str,
    options: IncidentOptions = ALL,
    *,
    other: Recording | Reader | None = None,
    differences: Differences | None = None,
    opening: Opening | None = None,
    before: float = 5.0,
    after: float = 5.0,
    road_map: RoadMap | None = None,
    town: TownMesh | None = None,
    pictures: Pictures = "drawn",
    camera: str | None = None,
    viewer: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> Report:
    """Write the incident page of a recording, or of two that are compared.

    Args:
        source: The recording.
        path: The folder to write, whose `index.html` opens from the disk, or from any server; or if its name ends in
            `.html`, a single file.
        options: Which incidents to list, see `carla_recap.queries.incidents`; without roads, those of `road_map` count.
        other: Another recording of the same map, to be shown beside the first one, or over it.
        differences: The differences of both, which the page names, and with which it begins with one over the other; None:
            those beyond 0.5 m, with both side by side.
        opening: What the page shows first; None: the beginning.
        before: The seconds before an incident in the replay of a long recording.
        after: The seconds after it.
        road_map: The roads to show; None: those of the map of the recording, looked for as `carla_recap.find_map` does, or
            where it is unknown, what vehicles have driven along.
        town: Their surfaces, if they are made already.
        pictures: "drawn": a drawing of each incident, from above; "rendered": a view from behind the first actor, which
            takes the extra `cameras`; or "none".
        camera: The camera of each recording whose stored images are shown beside the map; None: the one that looks ahead
            the most, where a recording has images. They take the extras `foxglove` and `video`.
        viewer: Add Rerun's viewer, to see the scene in 3D; it needs the extra `rerun`, and a server for the page.
        force: Write into a folder that is not empty, or over a file.
        progress: Gets the scenes and their player, and yields the scenes; once for each recording.

    Raises:
        RecapError: A recording is damaged or empty, the two are of different maps, the folder is not empty, the file exists,
            the viewer is wanted in a single file or a comparison, there are no images of the camera, or nothing can be
            rendered here.
        MissingExtra: `pictures`, `camera` or `viewer` need an extra that is not installed.

    Warns:
        RecapWarning: Images that were not asked for cannot be shown.
    """
    if not (before >= 0 and after >= 0):
        raise RecapError(f"{before:g} s before and {after:g} s after incidents cannot be shown; 0 or more were expected")
    check_path(path)
    path = Path(path)
    single = path.suffix.lower() in SINGLE
    _check_destination(path, single=single, force=force)
    recordings = [each if isinstance(each, Recording) else Recording(each) for each in (source, other) if each is not None]
    _check_maps(recordings)
    if viewer and (single or len(recordings) > 1):
        raise RecapError(f"{path}: the viewer goes with a folder and one recording, not with a single file or a comparison")
    options = replace(options, roads=options.roads or road_network_of_map(road_map))
    options = with_roads(recordings[0].reader, options)  # of both, since they are of one map
    if town is None:
        town = load_town_of(recordings[0], options.road_map) if road_map is None else town_of_map(road_map)
    reported = [_Reported(recording, options, (before, after), camera, progress) for recording in recordings]
    if viewer and not reported[0].whole:
        raise RecapError(f"{recordings[0].location}: is too long for the viewer in a page; clips of its incidents are not")
    for each in reported if pictures == "rendered" else ():
        each.take_pictures(town)
    packer = Packer()
    ground = packer.pack(script.base_map_data(base_map(town, [each.replay for each in reported]), packer))
    shown: dict[str, Any] = {"drawn": pictures == "drawn", "viewer": viewer}
    if other is not None:
        found = differences or recordings[0].diff(recordings[1], tolerance=TOLERANCE, events=False)
        shown["differences"] = {"over": differences is not None, **_differences(found)}
    if opening is not None:
        shown["opening"] = _opening(opening, reported[0].incidents)
    data = {
        "data/kinds.js": script.script("KINDS", script.kind_data()),
        "data/ground.js": script.script("GROUND", ground),
        "data/images.js": script.script("IMAGES", [each.images and script.image_data(each.images) for each in reported]),
        "data/recordings.js": script.script("RECORDINGS", [_packed(each) for each in reported]),
    }
    if single:
        names = [{i: data_address(one, "image/jpeg") for i, one in each.pictures.items()} for each in reported]
        data["data/reports.js"] = _summaries(reported, names, shown)
        content = single_page(viewer_folder() / "page", data).encode()
        with WholeFile(path, force=force) as file:
            file.write(content)
        size = len(content)
    else:
        with new_folder(path) as room:
            copy_files(viewer_folder() / "page", room)
            if viewer:
                _add_viewer(recordings[0], room / "rerun", road_map)
            (room / "data").mkdir()
            data["data/reports.js"] = _summaries(reported, _write_pictures(reported, room), shown)
            for name, text in data.items():
                (room / name).write_text(text, "ascii")
            size = sum(file.stat().st_size for file in room.rglob("*") if file.is_file())
    seconds = max(sum(stop - start for start, stop in each.replay.spans) for each in reported)
    listed, images = (sum(counts) for counts in zip(*(each.counts for each in reported), strict=True))
    return Report(path, listed, all(each.whole for each in reported), seconds, images, size)


def _check_destination(path: Path, *, single: bool, force: bool) -> None:
    """Refuse a file or folder that must not be replaced."""
    if not single:
        check_folder(path, force=force)
    elif path.exists() and not path.is_file():
        raise RecapError(f"{path}: is no file; the name of a file was expected, since it ends in {path.suffix}")
    elif path.exists() and not force:
        raise RecapError(f"{path}: exists already; --force (in Python, force=True) replaces it")


def _check_maps(recordings: Sequence[Recording]) -> None:
    """Refuse recordings of different maps; the layered variant of a map is the same."""
    names = [readable(recording.header.map_name).rpartition("/")[2] for recording in recordings]
    if len({map_key(name) for name in names if name}) > 1:
        first, second = (recording.location for recording in recordings)
        raise RecapError(f"{first} is of the map {names[0]}, {second} of {names[1]}; recordings of one map were expected")


def _packed(reported: _Reported) -> str:
    packer = Packer()
    return packer.pack(script.recording_data(reported.replay, reported.measured, packer))


def _write_pictures(reported: Iterable[_Reported], folder: Path) -> list[dict[int, str]]:
    """Write the taken pictures, and return their addresses by the indices of the incidents."""
    names: list[dict[int, str]] = []
    for number, each in enumerate(reported, 1):
        names.append({})
        for index, content in each.pictures.items():
            (folder / "pictures").mkdir(exist_ok=True)
            names[-1][index] = f"pictures/{number}-incident-{index + 1:04}.jpg"
            (folder / names[-1][index]).write_bytes(content)
    return names


def _add_viewer(recording: Recording, folder: Path, road_map: RoadMap | None) -> None:
    """Write Rerun's viewer, a recording for it, and a blueprint for each actor that it can follow, into a new folder."""
    from carla_recap.show.rerun.export import export_rerun

    folder.mkdir()
    copy_files(viewer_folder() / "page" / "rerun", folder)
    _copy_viewer(folder)
    export_rerun(recording, folder / "recording.rrd", road_map=road_map, cameras=folder / "cameras")


def _copy_viewer(folder: Path) -> None:
    """Copy the web viewer from Rerun's own server."""
    from urllib.request import ProxyHandler, build_opener  # which imports much

    from carla_recap.show.rerun.viewer import HOST, WEB_PORT, RerunViewer

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


def _summaries(reported: Iterable[_Reported], pictures: Iterable[dict[int, str]], shown: dict[str, Any]) -> str:
    """Return the script with what is known of each recording."""
    found = [_summary(each, names) | shown for each, names in zip(reported, pictures, strict=True)]
    return script.script("REPORTS", found)


def _summary(reported: _Reported, pictures: dict[int, str]) -> dict[str, Any]:
    recording = reported.recording
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
        "whole": reported.whole,
        "omitted": reported.omitted,
        "follow": reported.followed,
        "incidents": [_incident(incident, pictures.get(index)) for index, incident in enumerate(reported.incidents)],
    }


def _differences(found: Differences) -> dict[str, Any]:
    """Return what a page shows of the differences: a text, since when paths differ, and which actors are the same.

    An actor is its id and the time of its spawn.
    """
    pairs = [
        [row.id_a, script.number(row.spawned_at_a), row.id_b, script.number(row.spawned_at_b)]
        for row in found.actors
        if row.kind in ROAD_USERS
    ]
    reasons = found.reasons or [found.summary]
    text = reasons[0][:1].upper() + reasons[0][1:]
    return {"text": text[: 2 * script.LONGEST], "since": found.first and found.first.first, "pairs": pairs}


def _opening(opening: Opening, found: Sequence[Incident]) -> dict[str, Any]:
    if opening.time is None and found:
        opening = opening._replace(time=found[-1].start, actors=found[-1].actors)
    notes = [note[: 2 * script.LONGEST] for note in opening.notes[:NOTES]]
    if len(opening.notes) > NOTES:
        notes.append(f"and {len(opening.notes) - NOTES} more")
    time = None if opening.time is None else script.number(opening.time)
    return {"time": time, "actors": list(opening.actors), "notes": notes}


def _incident(incident: Incident, picture: str | None) -> dict[str, Any]:
    place = incident.x, incident.y
    return {
        "kind": incident.kind,
        "start": script.number(incident.start, 6),
        "stop": script.number(incident.stop, 6),
        "actors": list(incident.actors),
        "types": [script.shortened(type_id) for type_id in incident.type_ids],
        "place": [round(value, 2) for value in place] if all(map(math.isfinite, place)) else None,
        "text": incident.text[: 2 * script.LONGEST],
        "picture": picture,
    }
