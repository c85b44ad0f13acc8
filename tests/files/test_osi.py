"""Exports to ASAM OSI, read back with the messages of OSI."""

from __future__ import annotations

import importlib.util
import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from carla_recap import ActorKind, Spawn, attributes, create_recording, open_recording

pytest.importorskip("betterosi", reason="the extra `osi` is not installed")

from carla_recap.files.osi import GROUND_TRUTH, MAP, export_osi, message_class
from tests.samples import SAMPLES

BRICKFIELD = Path(__file__).parents[2] / "src" / "carla_recap" / "sim" / "towns" / "Brickfield.xodr"


def export(source, destination, **options):
    with open_recording(source) as recording:
        return export_osi(recording, destination, **options)


def messages(path, topic="ground_truth", name=GROUND_TRUTH):
    with path.open("rb") as file:
        return [
            (message.log_time, message_class(name).FromString(message.data))
            for _, _, message in make_reader(file, validate_crcs=True).iter_messages(topics=[topic])
        ]


@pytest.fixture(scope="module")
def crash(tmp_path_factory):
    path = tmp_path_factory.mktemp("osi") / "crash.mcap"
    export(SAMPLES / "crash.mcap", path, opendrive=BRICKFIELD)
    return path


@pytest.fixture
def own(tmp_path):
    """A car that turns left and goes up, ever faster, with a box whose middle is ahead of its origin; a walker stands."""
    path = tmp_path / "own.log"
    with create_recording(path, map_name="Somewhere", date=1_700_000_000, additional_data=True) as recorder:
        for index in range(5):
            records = {"transforms": [(7, 100 * index**2, -200, 50, 0, 10, -90), (8, 0, 0, 90, 0, 0, 0)]}
            if not index:
                hero = Spawn(7, ActorKind.VEHICLE, type_id="vehicle.ford.ambulance", attributes=attributes(role_name="hero"))
                records["spawned"] = [hero, Spawn(8, ActorKind.WALKER, type_id="walker.pedestrian.0001")]
                records["bounding_boxes"] = [(7, 100, 0, 0, 300, 100, 120)]
            recorder.add_frame(index / 10, **records)
    return path


def test_each_frame_is_a_message_at_its_time(crash):
    with open_recording(SAMPLES / "crash.mcap") as recording:
        times = [round(frame.elapsed * 1e9) for frame in recording]
    found = messages(crash)
    assert [time for time, _ in found] == times
    assert [truth.timestamp.seconds * 10**9 + truth.timestamp.nanos for _, truth in found] == times
    assert {(truth.version.version_major, truth.version.version_minor) for _, truth in found} == {(3, 7)}


def test_positions_are_the_centres_of_boxes_in_right_handed_metres(tmp_path, own):
    export(own, tmp_path / "own.mcap")
    first = messages(tmp_path / "own.mcap")[0][1]
    car, walker = first.moving_object
    assert (car.id.value, walker.id.value, first.host_vehicle_id.value) == (7, 8, 7)
    assert (car.type, walker.type, car.vehicle_classification.role) == (2, 3, 3)
    assert not walker.HasField("vehicle_classification")
    # A yaw of -90 in CARLA's axes turns left. The pitch of 10 raises the front there, and is negative here.
    forward = np.array([0.0, math.cos(math.radians(10)), math.sin(math.radians(10))])
    centre = np.array([0.0, 2.0, 0.5]) + forward
    assert np.allclose((car.base.position.x, car.base.position.y, car.base.position.z), centre)
    assert np.allclose(
        (car.base.orientation.roll, car.base.orientation.pitch, car.base.orientation.yaw),
        (0, -math.radians(10), math.pi / 2),
    )
    assert np.allclose((car.base.dimension.length, car.base.dimension.width, car.base.dimension.height), (6, 2, 2.4))


def test_velocities_that_were_not_recorded_are_derived(tmp_path, own):
    export(own, tmp_path / "own.mcap")
    cars = [truth.moving_object[0] for _, truth in messages(tmp_path / "own.mcap")]
    assert np.allclose([car.base.velocity.x for car in cars], [10, 20, 40, 60, 70], atol=1e-4)
    assert np.allclose([car.base.acceleration.x for car in cars], [0, 100, 200, 200, 100], atol=1e-2)


def test_a_jump_is_no_motion(tmp_path):
    with create_recording(tmp_path / "odd.log", map_name="") as recorder:
        for index in range(20):
            spawned = [Spawn(7, 1, type_id="vehicle.a")] if index == 0 else []
            x = 100 * index if index < 10 else 10_000 + 50 * index
            recorder.add_frame(index / 20, spawned=spawned, transforms=[(7, x, 0, 0, 0, 0, 0)])
    export(tmp_path / "odd.log", tmp_path / "odd.mcap")
    found = [truth.moving_object[0].base for _, truth in messages(tmp_path / "odd.mcap")]
    assert [each.velocity.x for each in found] == pytest.approx([20.0] * 10 + [10.0] * 10, abs=1e-3)
    assert [each.acceleration.x for each in found] == pytest.approx([0.0] * 20, abs=0.1)


def test_recorded_velocities_are_taken(crash):
    with open_recording(SAMPLES / "crash.mcap") as recording:
        (hero,) = recording.heroes
        path = recording.trajectory(hero.id)
    found = [truth.moving_object for _, truth in messages(crash)]
    speeds = [next(each.base.velocity for each in objects if each.id.value == hero.id) for objects in found]
    assert np.allclose([(v.x, v.y) for v in speeds], np.stack((path.vx, path.vy), axis=1), atol=1e-6)


def test_lights_have_colours_and_the_map_is_in_the_file(crash):
    truth = messages(crash)[-1][1]
    with open_recording(SAMPLES / "crash.mcap") as recording:
        states = recording.frame_at(math.inf)["light_states"]
    assert {light.id.value: light.classification.color for light in truth.traffic_light} == {
        int(row["id"]): {0: 2, 1: 3, 2: 4}[int(row["state"])] for row in states
    }
    ((_, town),) = messages(crash, "ground_truth_map", MAP)
    assert town.open_drive_xml_content == BRICKFIELD.read_text("utf-8")
    assert town.map_reference == truth.map_reference == "Brickfield"


def test_the_metadata_are_those_of_a_trace(crash):
    with crash.open("rb") as file:
        reader = make_reader(file)
        found = {item.name: item.metadata for item in reader.iter_metadata()}
        channels = {channel.topic: channel.metadata for channel in reader.get_summary().channels.values()}
    assert found["net.asam.osi.trace"]["min_osi_version"] == "3.7.0"
    assert all(each["net.asam.osi.trace.channel.osi_version"] == "3.7.0" for each in channels.values())


def test_poses_that_are_no_numbers_are_left_out(tmp_path):
    path = tmp_path / "odd.log"
    with create_recording(path, map_name="") as recorder:
        recorder.add_frame(0.0, spawned=[Spawn(7, 1, type_id="vehicle.a")], transforms=[(7, math.nan, 0, 0, 0, 0, 0)])
        recorder.add_frame(0.5, transforms=[(7, 0, 0, 0, 0, 0, 0)])
        recorder.add_frame(1.0, transforms=[(7, 0, 0, 0, 0, 0, 0)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert export(path, tmp_path / "odd.mcap").frames == 3
    found = [[each.base for each in truth.moving_object] for _, truth in messages(tmp_path / "odd.mcap")]
    assert [[(each.velocity.x, each.acceleration.x) for each in frame] for frame in found] == [[], [(0, 0)], [(0, 0)]]


@pytest.mark.skipif(importlib.util.find_spec("omega_prime") is None, reason="omega-prime (1.2 GB) is not installed")
def test_omega_prime_validates_the_file(crash):
    import omega_prime

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = omega_prime.Recording.from_file(str(crash), validate=True)
    assert len(found.df) == sum(len(truth.moving_object) for _, truth in messages(crash))
