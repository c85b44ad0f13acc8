"""Recordings as OpenSCENARIO 1.2: each vehicle and walker follows its recorded trajectory.

Units are m, s and radians; axes are right-handed: x forward, y left, z up, as in OpenDRIVE.
"""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from carla_recap.editing.convert import check_destination
from carla_recap.errors import RecapError
from carla_recap.model.lives import ROAD_USERS
from carla_recap.replay import Played, Player
from carla_recap.replay.pose import right_handed, wrap
from carla_recap.scene.appearance import look_of_present
from carla_recap.scene.materials import Tag
from carla_recap.util.files import WholeFile
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from carla_recap.model.lives import ActorLife
    from carla_recap.recording import Recording
    from carla_recap.replay.player import Progress
    from carla_recap.scene.appearance import Look
    from carla_recap.util.arrays import Floats


_CATEGORIES: Final = {Tag.TRUCK: "truck", Tag.BUS: "bus", Tag.MOTORCYCLE: "motorbike", Tag.BICYCLE: "bicycle"}
_SAME: Final = 1e-6  # m and radians; an actor that moves by less between two frames stands
_MOST: Final = 2_000_000  # vertices
_AXLE: Final = 0.3  # of the length, from the middle to each axle


def export_openscenario(
    source: Recording,
    destination: Path | str,
    *,
    start: float = 0.0,
    duration: float = 0.0,
    opendrive: Path | str | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Played:
    """Write the trajectories of vehicles and walkers as an OpenSCENARIO file, for esmini and other players; see `export`.

    The scenario has the name of the map, if that is given, without its folder. Return the number of frames, and the seconds
    that they span; a `RecapError` says that the recording is too long.
    """
    reader = source.reader
    check_destination(reader.location, destination, force=force)
    player = Player(source, start=start, duration=duration)
    actors: dict[tuple[int, float], ActorLife] = {}
    parts: dict[tuple[int, float], list[Floats]] = {}
    frames = vertices = 0
    for batch in player.batches(progress):
        frames += len(batch)
        poses = right_handed(batch.poses)
        for column, id in enumerate(batch.ids.tolist()):
            actor = batch.actors.get(id)
            if actor is None or actor.kind not in ROAD_USERS:
                continue
            key = id, actor.spawned_at
            actors.setdefault(key, actor)
            rows = np.column_stack((batch.time - player.start, poses[:, column]))
            parts.setdefault(key, []).append(rows[np.isfinite(rows).all(axis=1)])
            vertices += len(rows)
        if vertices > _MOST:
            raise RecapError(f"{reader.location}: more than {_MOST:,} poses; --start and --duration export a part of it")
    paths = {key: _reduced(np.concatenate(rows)) for key, rows in parts.items()}
    paths = {key: path for key, path in paths.items() if len(path)}
    scenario = _scenario(_printable(readable(reader.header.map_name)), opendrive, player.stop - player.start)
    names = _names([actors[key] for key in paths])
    for (key, path), name in zip(paths.items(), names, strict=True):
        _add_actor(scenario, name, actors[key], path)
    indent(scenario)
    with WholeFile(destination, force=force) as file:
        file.write(b'<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(scenario) + b"\n")
    return Played(frames, player.stop - player.start)


def map_hint(_destination: Path | str, opendrive: Path | None = None, **_: object) -> list[str]:
    """Return what belongs beside a scenario, as a line if the map is known."""
    return [] if opendrive is None else [f"the map that belongs beside it: {opendrive}"]


def _names(actors: list[ActorLife]) -> list[str]:
    """Return a name for each actor: its role, if no other has it, else its blueprint with its id."""
    roles = Counter(actor.role_name for actor in actors)
    names = [
        actor.role_name if actor.role_name and roles[actor.role_name] == 1 else f"{actor.type_id}.{actor.id}"
        for actor in actors
    ]
    seen: Counter[str] = Counter()
    for index, name in enumerate(names):
        clean = _printable(name)
        seen[clean] += 1
        names[index] = clean if seen[clean] == 1 else f"{clean}.{seen[clean]}"
    return names


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else "_" for c in text)


def _reduced(rows: Floats) -> Floats:
    """Return a path with radians, unwrapped, and with only the ends of the times in which the actor stands."""
    rows[:, 4:] = np.unwrap(np.radians(wrap(rows[:, 4:])), axis=0)
    rows = rows[np.append(True, np.diff(rows[:, 0]) > 0)[: len(rows)]]
    still = np.abs(np.diff(rows[:, 1:], axis=0)).max(axis=1) < _SAME
    return rows[~np.concatenate(([False], still[:-1] & still[1:], [False]))] if len(rows) > 2 else rows


def _scenario(map_name: str, opendrive: Path | str | None, seconds: float) -> Element:
    root = Element("OpenSCENARIO")
    SubElement(
        root,
        "FileHeader",
        revMajor="1",
        revMinor="2",
        date=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S"),
        description=f"Trajectories recorded in {map_name}",
        author="carla-recap",
    )
    for name in ("ParameterDeclarations", "CatalogLocations"):
        SubElement(root, name)
    network = SubElement(root, "RoadNetwork")
    if opendrive is not None:
        SubElement(network, "LogicFile", filepath=Path(opendrive).name)
    SubElement(root, "Entities")
    board = SubElement(root, "Storyboard")
    SubElement(SubElement(board, "Init"), "Actions")
    story = SubElement(board, "Story", name="recording")
    act = SubElement(story, "Act", name="recording")
    SubElement(act, "StartTrigger").append(_time_condition("start", 0.0, "greaterOrEqual"))
    SubElement(board, "StopTrigger").append(_time_condition("stop", seconds, "greaterThan"))
    return root


def _time_condition(name: str, seconds: float, rule: str) -> Element:
    group = Element("ConditionGroup")
    condition = SubElement(group, "Condition", name=name, delay="0", conditionEdge="none")
    SubElement(SubElement(condition, "ByValueCondition"), "SimulationTimeCondition", value=f"{seconds:.9g}", rule=rule)
    return group


def _add_actor(root: Element, name: str, actor: ActorLife, path: Floats) -> None:
    look = look_of_present(actor)
    thing = SubElement(_child(root, "Entities"), "ScenarioObject", name=name)
    if actor.kind == "walker":
        body = SubElement(thing, "Pedestrian", name=_printable(actor.type_id), mass="75", pedestrianCategory="pedestrian")
        SubElement(body, "ParameterDeclarations")
        _add_box(body, look)
        SubElement(body, "Properties")
    else:
        _add_vehicle(thing, actor, look)
    private = SubElement(_child(root, "Storyboard/Init/Actions"), "Private", entityRef=name)
    position = SubElement(SubElement(SubElement(private, "PrivateAction"), "TeleportAction"), "Position")
    _add_position(position, path[0])
    act = _child(root, "Storyboard/Story/Act")
    group = Element("ManeuverGroup", name=name, maximumExecutionCount="1")
    act.insert(len(act) - 1, group)
    SubElement(SubElement(group, "Actors", selectTriggeringEntities="false"), "EntityRef", entityRef=name)
    event = SubElement(SubElement(group, "Maneuver", name=name), "Event", name=name, priority="overwrite")
    action = SubElement(SubElement(event, "Action", name=name), "PrivateAction")
    follow = SubElement(SubElement(action, "RoutingAction"), "FollowTrajectoryAction")
    trajectory = SubElement(SubElement(follow, "TrajectoryRef"), "Trajectory", name=name, closed="false")
    SubElement(trajectory, "ParameterDeclarations")
    line = SubElement(SubElement(trajectory, "Shape"), "Polyline")
    for row in path:
        vertex = SubElement(line, "Vertex", time=f"{row[0]:.9g}")
        _add_position(SubElement(vertex, "Position"), row)
    reference = SubElement(follow, "TimeReference")
    SubElement(reference, "Timing", domainAbsoluteRelative="absolute", scale="1", offset="0")
    SubElement(follow, "TrajectoryFollowingMode", followingMode="position")
    SubElement(event, "StartTrigger").append(_time_condition(name, float(path[0, 0]), "greaterOrEqual"))


def _child(root: Element, path: str) -> Element:
    found = root.find(path)
    assert found is not None
    return found


def _add_vehicle(thing: Element, actor: ActorLife, look: Look | None) -> None:
    category = _CATEGORIES.get(look.tag, "car") if look else "car"
    if actor.spawn.attribute("base_type") == "van":
        category = "van"
    body = SubElement(thing, "Vehicle", name=_printable(actor.type_id), vehicleCategory=category)
    SubElement(body, "ParameterDeclarations")
    _add_box(body, look)
    SubElement(body, "Performance", maxSpeed="70", maxAcceleration="10", maxDeceleration="10")
    axles = SubElement(body, "Axles")
    length, width, _ = (2 * extent for extent in look.half_extents) if look else (4.5, 1.8, 1.5)
    for axle, steering, side in (("FrontAxle", "0.7", 1.0), ("RearAxle", "0", -1.0)):
        SubElement(
            axles,
            axle,
            maxSteering=steering,
            wheelDiameter="0.65",
            trackWidth=f"{0.85 * width:.3f}",
            positionX=f"{side * _AXLE * length:.3f}",
            positionZ="0.325",
        )
    SubElement(body, "Properties")


def _add_box(body: Element, look: Look | None) -> None:
    half, center = (look.half_extents, look.center) if look else ((2.25, 0.9, 0.75), (0.0, 0.0, 0.75))
    box = SubElement(body, "BoundingBox")
    SubElement(box, "Center", {axis: f"{value:.4f}" for axis, value in zip("xyz", center, strict=True)})
    length, width, height = (f"{2 * extent:.4f}" for extent in half)
    SubElement(box, "Dimensions", width=width, length=length, height=height)


def _add_position(position: Element, row: Floats) -> None:
    names = ("x", "y", "z", "r", "p", "h")
    SubElement(position, "WorldPosition", {name: f"{row[1 + i]:.6f}" for i, name in enumerate(names)})
