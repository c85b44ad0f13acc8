"""The layouts that viewers import: those of exports, and those that show the sensors of a rig, too."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from carla_recap.queries.sensors import IMAGES, PICTURES, ROOT, kind_of
from carla_recap.util.files import WholeFile
from carla_recap.util.resources import viewer_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from carla_recap.formats.base import Topic

    Layout = dict[str, Any]

_FOXGLOVE, _LICHTBLICK = "Foxglove", "Lichtblick and Foxglove 1.x"
_SUFFIXES: Final = {_FOXGLOVE: ".foxglove.json", _LICHTBLICK: ".lichtblick.json"}
_IN_A_ROW: Final = 4
_MOST: Final = 12  # panels of images
_STATES: Final = "/states"
_SCENE_SHARE: Final = 62  # % of the height for the panels of the scene, above images
_LARGEST_DEPTH: Final = 65_535  # mm
_COLORS: Final = {"points": "intensity", "detections": "velocity"}  # by what the points of a topic are coloured


def layout_files() -> dict[str, Path]:
    """Return the layouts for an export, by the viewers that import them."""
    folder = viewer_folder() / "foxglove"
    return {viewer: folder / f"carla-recap{suffix}" for viewer, suffix in _SUFFIXES.items()}


def layout_hints(path: Path | str, **_: object) -> list[str]:
    """Return where the layouts of a file are, a line for each viewer: those beside it, or else those of all exports."""
    beside = sensor_layout_files(path)
    return hints_of(beside if all(each.is_file() for each in beside.values()) else layout_files())


def connection_hints(path: Path | str) -> list[str]:
    """Return where the layout of the viewer is that connects to what plays a file, and how others show it."""
    return [
        *layout_hints(path)[:1],
        f"{_LICHTBLICK} cannot connect; they open what 'carla-recap export --to foxglove' writes",
    ]


def hints_of(layouts: Mapping[str, Path]) -> list[str]:
    """Return where layouts are, a line for each viewer."""
    return [f"the layout for {viewer}: {path}" for viewer, path in layouts.items()]


def sensor_layout_files(destination: Path | str) -> dict[str, Path]:
    """Return where the layouts of a recording with sensors are, by the viewers that import them."""
    path = Path(destination)
    stem = path.stem.removesuffix(".foxglove")  # as of run.foxglove.mcap
    return {viewer: path.with_name(stem + suffix) for viewer, suffix in _SUFFIXES.items()}


def has_panels(topics: Iterable[Topic]) -> bool:
    """Return whether layouts show some of the topics of sensors: their images or points."""
    return any(topic.name.startswith(ROOT) and kind_of(topic.name) in (*IMAGES, *_COLORS) for topic in topics)


def write_layouts(destination: Path | str, topics: Iterable[Topic], rules: Iterable[str] = ()) -> dict[str, Path]:
    """Write the layouts of a recording beside it, with its sensors and the verdicts of rules; return them by the viewers."""
    names = [topic.name for topic in topics if topic.name.startswith(ROOT)]
    images = [name for name in names if kind_of(name) in IMAGES][:_MOST]
    clouds = [name for name in names if kind_of(name) in _COLORS]
    makers: dict[str, Callable[[Layout, list[str], list[str]], Layout]] = {_FOXGLOVE: _foxglove, _LICHTBLICK: _lichtblick}
    files = sensor_layout_files(destination)
    verdicts = [_verdict_path(index, rule) for index, rule in enumerate(rules)]
    for viewer, path in layout_files().items():
        layout = makers[viewer](json.loads(path.read_text("utf-8")), images, clouds)
        for config in _configs(layout):
            if config.get("paths", [{}])[0].get("value", "").startswith(_STATES):
                config["paths"] = verdicts + config["paths"]
        with WholeFile(files[viewer]) as file:
            file.write(json.dumps(layout, indent=2).encode())
    return files


def _configs(layout: Layout) -> Iterable[Layout]:
    """Return the settings of the panels of a layout of either viewer."""
    return layout["configById"].values() if "configById" in layout else [p["config"] for p in _panels(layout["content"])]


def _verdict_path(index: int, rule: str) -> Layout:
    """Return the path of a rule's states in a panel of states."""
    return {"value": f"{_STATES}.verdicts[{index}].text", "label": rule, "enabled": True, "timestampMethod": "receiveTime"}


def _foxglove(layout: Layout, images: list[str], clouds: list[str]) -> Layout:
    """Return the layout of Foxglove with images and points of sensors."""
    for panel in _panels(layout["content"]):
        if panel["panelType"] == "ThreeDee":
            panel["config"]["topics"] |= _clouds(clouds)
    if images:
        rows = [_split("row", [_image_panel(name) for name in row]) for row in _rows(images)]
        shares = [(_SCENE_SHARE, layout["content"]), (100 - _SCENE_SHARE, _split("column", rows))]
        items = [{"proportion": share, "content": content} for share, content in shares]
        layout["content"] = {"type": "split", "direction": "column", "items": items}
    return layout


def _panels(content: Layout) -> Iterable[Layout]:
    if content["type"] == "panel":
        yield content
    for item in content.get("items", ()):
        yield from _panels(item["content"])


def _split(direction: str, parts: list[Layout]) -> Layout:
    if len(parts) == 1:
        return parts[0]
    items = [{"proportion": 100 / len(parts), "content": part} for part in parts]
    return {"type": "split", "direction": direction, "items": items}


def _image_panel(name: str) -> Layout:
    return {"type": "panel", "panelType": "Image", "title": _title(name), "version": 1, "config": _image(name)}


def _lichtblick(layout: Layout, images: list[str], clouds: list[str]) -> Layout:
    """Return the layout of Lichtblick with images and points of sensors."""
    panels = layout["configById"]
    for id, config in panels.items():
        if id.startswith("3D!"):
            config["topics"] |= _clouds(clouds)
    if images:
        panels |= {_panel_id(name): {**_image(name), "foxglovePanelTitle": _title(name)} for name in images}
        rows = [_mosaic("row", [_panel_id(name) for name in row]) for row in _rows(images)]
        second = _mosaic("column", rows)
        shown = {"direction": "column", "splitPercentage": _SCENE_SHARE, "first": layout["layout"], "second": second}
        layout["layout"] = shown
    return layout


def _panel_id(name: str) -> str:
    return f"Image!{_title(name).replace(' ', '_')}"


def _mosaic(direction: str, parts: list[Any]) -> Any:
    """Return panels side by side or one below the other, of equal sizes."""
    first, *rest = parts
    if not rest:
        return first
    second = _mosaic(direction, rest)
    return {"direction": direction, "splitPercentage": 100 / len(parts), "first": first, "second": second}


def _rows(names: list[str]) -> list[list[str]]:
    """Return names in rows of about equal length."""
    count = -(-len(names) // _IN_A_ROW)
    length = -(-len(names) // count)
    return [names[start : start + length] for start in range(0, len(names), length)]


def _title(name: str) -> str:
    """Return the title of the panel of an image: the sensor's id, and what it shows unless that is plain to see."""
    _, _, id, kind = name.split("/")
    return id if kind in PICTURES or id == kind else f"{id} {kind}"


def _image(name: str) -> Layout:
    """Return the configuration of a panel of images."""
    mode: Layout = {"imageTopic": name, "calibrationTopic": name.rpartition("/")[0] + "/calibration"}
    if name.endswith("/depth"):
        mode |= {"minValue": 0, "maxValue": _LARGEST_DEPTH, "colorMode": "colormap", "colorMap": "turbo"}
    return {"imageMode": mode}


def _clouds(names: list[str]) -> Layout:
    """Return the settings of points in panels of the scene, by topic."""
    return {
        name: {
            "visible": True,
            "colorField": _COLORS[kind_of(name)],
            "colorMode": "colormap",
            "colorMap": "turbo",
            "pointSize": 2,
        }
        for name in names
    }
