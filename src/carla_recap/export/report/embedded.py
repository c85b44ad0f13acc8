"""Rerun's viewer as a part of a page: its program has the files that browsers need, and hands them out."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Final
from urllib.request import ProxyHandler, build_opener

from carla_recap.errors import RecapError
from carla_recap.export.assets import viewer_folder
from carla_recap.util.files import copy_files

if TYPE_CHECKING:
    from pathlib import Path

    from carla_recap.maps import RoadMap
    from carla_recap.recording import Recording

FILES: Final = ("re_viewer.js", "re_viewer_bg.wasm")
_PATIENCE: Final = 30.0  # s


def embed(recording: Recording, folder: Path, road_map: RoadMap | None) -> None:
    """Write the viewer, a recording for it, and a blueprint for each actor that can be followed.

    Args:
        recording: The recording.
        folder: A new folder, for all of it.
        road_map: The map of the town.

    Raises:
        RecapError: The viewer cannot be had from its program.
        MissingExtra: There is no viewer.
    """
    from carla_recap.export.rerun import export_rerun

    folder.mkdir()
    copy_files(viewer_folder() / "page" / "rerun", folder)
    _copy_viewer(folder)
    export_rerun(recording, folder / "recording.rrd", road_map=road_map, cameras=folder / "cameras")


def _copy_viewer(folder: Path) -> None:
    from carla_recap.export.viewer_process import HOST, HOSTING, Program

    opener = build_opener(ProxyHandler({}))
    with Program("--serve-web", "--web-viewer-port", "0") as program:
        port = program.port(HOSTING)
        try:
            for name in FILES:
                url = f"http://{HOST}:{port}/{name}"
                with opener.open(url, timeout=_PATIENCE) as source, (folder / name).open("wb") as file:
                    shutil.copyfileobj(source, file)
        except OSError as error:
            raise RecapError(f"the Rerun viewer does not hand out {name}: {error}") from None
