"""Exports to OpenSCENARIO."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from carla_recap import Spawn, create_recording, export_openscenario, open_recording
from tests.samples import CRASH

ROWS = [(7, 0, 0, 0, 0, 0, 0), (8, 0, 0, 0, 0, 0, 0)]


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    path = tmp_path_factory.mktemp("xosc") / "crash.xosc"
    with open_recording(CRASH) as recording:
        export_openscenario(recording, path, opendrive="/maps/Brickfield.xodr")
    return ElementTree.parse(path).getroot()


def vertices(scenario, name):
    (group,) = [each for each in scenario.iter("ManeuverGroup") if each.get("name") == name]
    positions = [(vertex.get("time"), vertex.find("Position/WorldPosition")) for vertex in group.iter("Vertex")]
    return np.array(
        [(float(time), *(float(position.get(axis)) for axis in ("x", "y", "h"))) for time, position in positions]
    )


def test_each_vehicle_and_walker_is_an_entity_with_its_size(scenario):
    with open_recording(CRASH) as recording:
        actors = [actor for actor in recording.actors.values() if actor.kind in ("vehicle", "walker")]
    objects = list(scenario.find("Entities"))
    assert len(objects) == len(actors)
    hero = next(each for each in objects if each.get("name") == "hero")
    size = hero.find("Vehicle/BoundingBox/Dimensions")
    box = next(actor.bounding_box for actor in actors if actor.is_hero)
    assert float(size.get("length")) == pytest.approx(2 * box.extent_x, abs=1e-3)


def test_the_trajectory_is_that_of_the_recording(scenario):
    with open_recording(CRASH) as recording:
        path = recording.trajectory(recording.heroes[0].id)
    found = vertices(scenario, "hero")
    for column, expected in enumerate((path.x, path.y), 1):
        assert np.abs(np.interp(path.time, found[:, 0], found[:, column]) - expected).max() < 1e-3
    yaw = np.interp(path.time, found[:, 0], np.degrees(found[:, 3]))
    assert np.abs((yaw - path.yaw + 180) % 360 - 180).max() < 0.1
    assert np.abs(np.diff(found[:, 3])).max() < 1  # angles do not wrap


def test_the_map_and_the_end_are_named(scenario):
    assert scenario.find("RoadNetwork/LogicFile").get("filepath") == "Brickfield.xodr"
    condition = scenario.find("Storyboard/StopTrigger//SimulationTimeCondition")
    assert float(condition.get("value")) == pytest.approx(59.95)


def test_names_are_unique_and_printable(tmp_path):
    spawns = [Spawn(id, 1, type_id=name) for id, name in ((7, "vehicle.\x01"), (8, "vehicle.\x02"), (7, "vehicle.\x01"))]
    with create_recording(tmp_path / "own.log", map_name="") as recorder:
        recorder.add_frame(0.0, spawned=spawns[:2], transforms=ROWS)
        recorder.add_frame(1.0, destroyed=[7], transforms=ROWS[1:])
        recorder.add_frame(2.0, spawned=spawns[2:], transforms=ROWS)
    with open_recording(tmp_path / "own.log") as recording:
        export_openscenario(recording, tmp_path / "own.xosc")
    names = [each.get("name") for each in ElementTree.parse(tmp_path / "own.xosc").getroot().find("Entities")]
    assert len(set(names)) == len(names) == 3
    assert all(name.isprintable() for name in names)
