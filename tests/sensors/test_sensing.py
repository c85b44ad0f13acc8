"""What rigs measure in recordings: a hero in Brickfield's axes, with a car ahead and one on each side."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import carla_recap
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.replay.pose import LOCATION, right_handed, rotations
from carla_recap.scene.materials import Tag
from carla_recap.scene.models import MODELS
from carla_recap.sensors.rig import SensorRig
from carla_recap.sensors.sensing import SensedFrame, sense
from tests.sensors.cars import (
    AHEAD,
    BOX,
    CAMERA,
    CAMERA_HEIGHT,
    CARS,
    GAP,
    HERO,
    HERO_POSE,
    LEFT,
    MOTION,
    RIG,
    RIGHT,
    SPEED,
    STEP,
    car_pose,
    drive,
    spawn,
)

if TYPE_CHECKING:
    from pathlib import Path

MIRROR = np.array((1.0, -1.0, 1.0))


@pytest.fixture(scope="module")
def frames(driver: None, tmp_path_factory: pytest.TempPathFactory) -> list[SensedFrame]:
    """Return what the rig measures in three frames."""
    path = drive(tmp_path_factory.mktemp("sensing") / "cars.mcap")
    with carla_recap.open_recording(path) as recording:
        return list(sense(recording, RIG, quality="low"))


def test_a_car_ahead_has_its_distance_in_the_depth_image_and_in_points(frames: list[SensedFrame]) -> None:
    for index, frame in enumerate(frames):
        distance = pytest.approx(GAP + SPEED * STEP * index, abs=0.05)
        assert frame.samples["depth"].data[frame.samples["ids"].data == AHEAD].min() == distance
        points = frame.samples["semantic_lidar"].data
        points = points[points["actor"] == AHEAD]
        assert points["x"].min() == distance
        assert np.abs(points["y"]).max() < BOX[4] / 100 + 0.01
        plain = frame.samples["lidar"].data
        assert plain["x"][(np.abs(plain["y"]) < 0.9) & (plain["z"] > -0.9) & (plain["x"] > 0)].min() == distance


def corners(id: int, time: float = 0.0) -> np.ndarray:
    """Return the corners of the box of a car in the world, (8, 3) in m, right-handed."""
    return in_world(id, np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, -1).T, time)


def in_world(id: int, points: np.ndarray, time: float = 0.0) -> np.ndarray:
    """Return points in the box of a car, from -1 to 1, in the world, (n, 3) in m, right-handed."""
    pose = right_handed(car_pose(id, time))
    centre, extent = np.array(BOX[:3]) / 100 * MIRROR, np.array(BOX[3:]) / 100
    return np.asarray(pose[LOCATION] + (centre + points * extent) @ rotations(pose).T)


def pixels_of(frame: SensedFrame, id: int) -> np.ndarray:
    """Return the edges of the pixels of a car: left, top, right, bottom."""
    rows, columns = np.nonzero(frame.samples["ids"].data == id)
    return np.array((columns.min(), rows.min(), columns.max() + 1, rows.max() + 1))


def bounds(points: np.ndarray) -> np.ndarray:
    """Return the edges of projected points: left, top, right, bottom."""
    return np.concatenate((points[:, :2].min(axis=0), points[:, :2].max(axis=0)))


def test_boxes_and_models_are_where_their_pixels_are(frames: list[SensedFrame]) -> None:
    for index, frame in enumerate(frames):
        camera = frame.samples["ids"].camera
        assert bounds(camera.project(corners(AHEAD, index * STEP))) == pytest.approx(pixels_of(frame, AHEAD), abs=2)
        for id in CARS:
            look = frame.description.actors.look_of(id)
            assert look is not None
            vertices = in_world(id, MODELS[look.model].mesh.vertices, index * STEP)
            assert bounds(camera.project(vertices)) == pytest.approx(pixels_of(frame, id), abs=1)


def test_left_is_left_and_up_is_up_in_images(frames: list[SensedFrame]) -> None:
    samples = frames[0].samples
    left, right = pixels_of(frames[0], LEFT), pixels_of(frames[0], RIGHT)
    assert left[2] < 400 < right[0]
    tags, depth, normals = samples["tags"].data, samples["depth"].data, samples["normals"].data
    assert (tags[:200] == Tag.SKY).mean() > 0.9
    assert np.isinf(depth[tags == Tag.SKY]).all()
    assert not (tags[400:] == Tag.SKY).any()
    assert depth[599, 400] == pytest.approx(CAMERA_HEIGHT / (299.5 / 400), abs=0.1)  # the road below the camera
    assert normals[599, 400] == pytest.approx((0, 0, 1), abs=0.02)
    rear = rotations(right_handed(HERO_POSE))[:, 0] * -1
    column, row = pixels_of(frames[0], AHEAD).reshape(2, 2).mean(axis=0).astype(int)
    assert normals[row, column] == pytest.approx(rear, abs=0.2)
    assert (normals[tags == Tag.SKY] == 0).all()
    assert {int(tag) for tag in np.unique(tags[samples["ids"].data == LEFT])} == {int(Tag.CAR)}
    red, _, blue = samples["front"].data[samples["ids"].data == LEFT].astype(int).mean(axis=0)
    assert red > 1.5 * blue


def test_left_is_left_and_up_is_up_in_points(frames: list[SensedFrame]) -> None:
    points = frames[0].samples["semantic_lidar"].data
    assert (points["y"][points["actor"] == LEFT] > 5).all()
    assert (points["y"][points["actor"] == RIGHT] < -3).all()
    road = points[(points["actor"] == 0) & (np.hypot(points["x"], points["y"]) < 8)]
    assert road["z"] == pytest.approx(-CAMERA_HEIGHT, abs=0.3)
    roofs = points["z"][np.isin(points["actor"], list(CARS))]
    assert roofs.max() == pytest.approx(1.5 - CAMERA_HEIGHT, abs=0.15)
    assert set(np.unique(points["actor"])) == {0, *CARS}
    assert (np.abs(points["cosine"]) <= 1).all()


def test_points_lie_on_the_pixels_of_their_actors(frames: list[SensedFrame]) -> None:
    sample, image = frames[0].samples["semantic_lidar"], frames[0].samples["ids"]
    points = sample.data[np.isin(sample.data["actor"], list(CARS)) & (sample.data["x"] > 1)]
    own = np.stack([points[axis] for axis in "xyz"], axis=1)
    pixels = image.camera.project(sample.pose[LOCATION] + own @ rotations(sample.pose).T)
    column, row = pixels[:, :2].astype(int).T
    inside = (column >= 0) & (column < 800) & (row >= 0) & (row < 600)
    assert inside.sum() > 300
    seen = image.data[row[inside], column[inside]]
    assert (seen == points["actor"][inside]).mean() > 0.97
    depth = frames[0].samples["depth"].data[row[inside], column[inside]]
    assert np.median(np.abs(depth - pixels[inside, 2])) < 0.05


def test_radars_measure_where_and_how_fast(frames: list[SensedFrame]) -> None:
    for frame in frames[1:]:
        found = frame.samples["radar"].data
        assert frame.samples["radar"].velocity == pytest.approx((0, 0, 0))
        assert len(found) > 500
        ahead = found[(np.abs(found["azimuth"]) < 0.05) & (found["altitude"] > -0.05) & (found["depth"] < 30)]
        assert ahead["velocity"] == pytest.approx(SPEED, abs=0.05)
        assert ahead["depth"].min() == pytest.approx(GAP + SPEED * frame.time, abs=0.05)
        sides = found[(np.abs(found["azimuth"]) > 0.2) & (found["altitude"] > -0.02) & (found["depth"] < 20)]
        assert (sides["azimuth"] > 0).any()
        assert sides["velocity"] == pytest.approx(0, abs=1e-3)
        left = found[(found["azimuth"] > 0.3) & (found["altitude"] > -0.02) & (found["depth"] < 20)]
        y = left["depth"] * np.cos(left["altitude"]) * np.sin(left["azimuth"])
        assert y.min() == pytest.approx(7 - 0.95, abs=0.3)


def test_optical_flow_is_the_motion_of_pixels(frames: list[SensedFrame]) -> None:
    assert np.abs(frames[0].samples["flow"].data).max() < 1e-3
    flow, ids = frames[2].samples["flow"].data, frames[2].samples["ids"].data
    assert np.abs(flow[ids == LEFT]).max() < 0.01
    camera = frames[2].samples["flow"].camera
    rear = np.array([(-1.0, 0.0, -0.3)])
    now, before = (camera.project(in_world(AHEAD, rear, time))[0, :2] for time in (2 * STEP, STEP))
    column, row = now.astype(int)
    shown = flow[row - 2 : row + 3, column - 2 : column + 3].mean(axis=(0, 1))
    assert shown == pytest.approx(now - before, abs=0.05)
    assert shown[1] < -0.2  # it goes away, so that what is below the horizon moves up
    left, _, right, _ = pixels_of(frames[2], AHEAD)
    assert flow[row, left + 4, 0] > 0.1
    assert flow[row, right - 4, 0] < -0.1


def test_a_camera_alone_shows_what_it_shows_among_others(frames: list[SensedFrame], tmp_path: Path) -> None:
    rig = SensorRig.of([each for each in RIG.to_dicts() if each["id"] == "flow"])
    with carla_recap.open_recording(drive(tmp_path / "cars.mcap")) as recording:
        for alone, frame in zip(sense(recording, rig, quality="low"), frames, strict=True):
            assert (alone.samples["flow"].data == frame.samples["flow"].data).all()


def test_a_carrier_at_rest(frames: list[SensedFrame]) -> None:
    for frame in frames:
        inertia = frame.samples["imu"].data
        assert inertia["acceleration"] == pytest.approx((0, 0, 9.81))
        assert inertia["angular_velocity"] == pytest.approx((0, 0, 0))
        assert float(inertia["compass"]) == pytest.approx(np.radians(120))  # 30 degrees to the right of east
        assert float(frame.samples["speed"].data) == 0.0
        assert frame.carrier == HERO
        assert frame.carrier_pose == pytest.approx(right_handed(HERO_POSE))
        assert frame.samples["front"].pose[2] == pytest.approx(CAMERA_HEIGHT)


# --- rigs without cameras, which need no driver ------------------------------------------------------------------------


def circle(path: Path, *, velocities: bool, rate: float = 20.0) -> Path:
    """Write a recording of a hero that drives to the left along a circle of 20 m at 10 m/s."""
    with carla_recap.create_recording(path, map_name="Brickfield", date=0, additional_data=velocities) as recorder:
        for frame in range(int(2 * rate)):
            time = frame / rate
            angle = 0.5 * time  # rad
            place = 2000 * np.sin(angle), -2000 * (1 - np.cos(angle)), 0.0
            pose = np.array((*place, 0.0, 0.0, -np.degrees(angle)))
            records: dict[str, Any] = {"transforms": [(HERO, *pose)]}
            if velocities:
                moving = 10 * np.cos(angle), -10 * np.sin(angle), 0.0
                records["velocities"] = [(HERO, *moving, 0.0, 0.0, -np.degrees(0.5))]
            if not frame:
                records["spawned"] = [spawn(HERO, pose)]
            recorder.add_frame(time, **records)
    return path


@pytest.mark.parametrize("velocities", [True, False])
@pytest.mark.parametrize("rate", [None, 50.0])
@pytest.mark.parametrize(("ahead", "felt"), [(0.0, (0, 5.0, 9.81)), (4.0, (-1.0, 5.0, 9.81))])
def test_an_imu_measures_the_motion_of_its_place(
    tmp_path: Path, ahead: float, felt: tuple[float, ...], rate: float | None, velocities: bool
) -> None:
    rig = SensorRig.of([spec | {"x": ahead} for spec in MOTION.to_dicts()])
    with carla_recap.open_recording(circle(tmp_path / "circle.mcap", velocities=velocities)) as recording:
        found = list(sense(recording, rig, start=0.5, duration=1.0, rate=rate))
    assert len(found) == (51 if rate else 21)
    for frame in found:
        inertia = frame.samples["imu"].data
        assert inertia["acceleration"] == pytest.approx(felt, abs=0.3)  # to the left, and to the centre of the circle
        assert inertia["angular_velocity"] == pytest.approx((0, 0, 0.5), abs=0.01)
        assert float(frame.samples["speed"].data) == pytest.approx(10, abs=0.05)


def test_ticks_are_counted_from_the_first_moment(tmp_path: Path) -> None:
    rig = SensorRig.of([{"type": "sensor.speedometer", "id": "speed", "sensor_tick": 0.1}, *MOTION.to_dicts()[:1]])
    with carla_recap.open_recording(circle(tmp_path / "circle.mcap", velocities=True)) as recording:
        found = ["speed" in frame.samples for frame in sense(recording, rig, start=0.55, duration=0.2)]
    assert found == [True, False, True, False, True]


def test_a_speedometer_measures_along_the_carrier_however_it_is_mounted(tmp_path: Path) -> None:
    rig = SensorRig.of([{"type": "sensor.speedometer", "id": "speed", "yaw": 90.0, "pitch": 30.0}])
    with carla_recap.open_recording(circle(tmp_path / "circle.mcap", velocities=True)) as recording:
        for frame in sense(recording, rig, start=0.5, duration=0.2):
            assert float(frame.samples["speed"].data) == pytest.approx(10, abs=0.05)


def lives(path: Path) -> Path:
    """Write a recording: a hero from 1 s to 2 s, and another one from 3 s on; one pose is not a number."""
    with carla_recap.create_recording(path, map_name="Brickfield", date=0) as recorder:
        for frame in range(9):
            time = frame * 0.5
            id = 1 if 1 <= time < 2 else 2 if time >= 3 else None
            records: dict[str, Any] = {"transforms": [(5, 0, 0, 0, 0, 0, 0)]}
            if id is not None:
                records["transforms"].append((id, np.nan if time == 3.5 else 100 * time, 0, 0, 0, 0, 0))
            if time in (1, 3):
                records["spawned"] = [spawn(id or 0, HERO_POSE, "hero")]
            if not frame:
                records["spawned"] = [spawn(5, HERO_POSE)]
            if time == 2:
                records["destroyed"] = [1]
            recorder.add_frame(time, **records)
    return path


def test_there_are_no_samples_while_the_carrier_is_absent(tmp_path: Path) -> None:
    with carla_recap.open_recording(lives(tmp_path / "lives.mcap")) as recording:
        found = list(sense(recording, MOTION))
        assert [frame.carrier for frame in found] == [None, None, 1, 1, None, None, 2, 2, 2]
        assert [len(frame.samples) for frame in found] == [0, 0, 2, 2, 0, 0, 2, 0, 2]
        assert np.isnan(found[0].carrier_pose).all()
        assert found[3].carrier_pose[0] == pytest.approx(1.5)
        assert [frame.carrier for frame in sense(recording, MOTION, actor=5)] == [5] * 9


def test_a_carrier_that_never_exists_and_times_that_make_no_sense_are_errors(small: Path) -> None:
    with carla_recap.open_recording(small) as recording:
        with pytest.raises(RecapError, match=r"small.log: no actor 12345 to carry the rig"):
            sense(recording, MOTION, actor=12345)
        for wrong in (-1.0, np.nan):
            with pytest.raises(RecapError, match=f"^a duration of {wrong:g} s; 0 or more was expected$"):
                sense(recording, MOTION, duration=wrong)
        for wrong in (0.0, -1.0, np.nan, np.inf):
            with pytest.raises(RecapError, match=f"^a rate of {wrong:g} per second; a number above 0 was expected$"):
                sense(recording, MOTION, rate=wrong)
        with pytest.raises(RecapError, match="nothing at 1e\\+06 s"):
            sense(recording, MOTION, start=1e6)


LIDAR = {"type": "sensor.lidar.ray_cast_semantic", "id": "lidar", "x": 0.0, "y": 0.0, "z": 2.0, "range": 30.0}


def test_without_its_map_a_rig_sees_where_vehicles_have_driven(tmp_path: Path) -> None:
    pytest.importorskip("embreex")
    path = tmp_path / "circle.mcap"
    with carla_recap.create_recording(path, map_name="Elsewhere", date=0) as recorder:
        for frame in range(60):
            records = {"spawned": [spawn(HERO, np.zeros(6))]} if not frame else {}
            recorder.add_frame(frame * 0.1, transforms=[(HERO, 100.0 * frame, 0, 0, 0, 0, 0)], **records)
    said = pytest.warns(RecapWarning, match="the map Elsewhere is not found: the roads are where vehicles have driven")
    with carla_recap.open_recording(path) as recording, said:
        frame = next(iter(sense(recording, SensorRig.of([LIDAR]), start=3.0)))
    assert (frame.samples["lidar"].data["tag"] == Tag.ROADS).any()


@pytest.mark.parametrize(("rate", "share"), [(None, 1), (10.0, 2), (40.0, 0.5)])
def test_sweeps_are_as_long_as_the_time_between_moments(tmp_path: Path, rate: float | None, share: float) -> None:
    pytest.importorskip("embreex")
    every = {**LIDAR, "points_per_second": 64_000, "lower_fov": -80.0, "upper_fov": -20.0}  # all rays meet the ground
    for frames in (1, 5):
        with carla_recap.open_recording(drive(tmp_path / "cars.mcap", frames)) as recording:
            found = [len(frame.samples["lidar"].data) for frame in sense(recording, SensorRig.of([every]), rate=rate)]
        assert found == pytest.approx([64_000 * STEP * share] * len(found), rel=0.02)


def test_without_a_driver_other_sensors_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RecapError("OpenGL cannot be used")

    monkeypatch.setattr("carla_recap.rendering.process.RenderProcess", fail)
    cameras = [{"type": "sensor.camera.rgb", "id": "front", **CAMERA}]
    with carla_recap.open_recording(drive(tmp_path / "cars.mcap", 1)) as recording:
        with pytest.raises(RecapError, match=r"^OpenGL cannot be used$"):
            next(iter(sense(recording, SensorRig.of(cameras))))
        rig = SensorRig.of([*cameras, *MOTION.to_dicts()])
        with pytest.warns(RecapWarning, match="cameras measure nothing: OpenGL cannot be used"):
            (frame,) = sense(recording, rig)
    assert frame.samples.keys() == {"imu", "speed"}


@pytest.mark.parametrize(("x", "z", "is_seen"), [(-8.0, 3.0, True), (0.0, 1.0, False)])
def test_a_camera_sees_its_carrier_but_from_inside(driver: None, tmp_path: Path, x: float, z: float, is_seen: bool) -> None:
    camera = {"type": "sensor.camera.instance_segmentation", "id": "ids", **CAMERA, "x": x, "z": z, "pitch": -10.0}
    with carla_recap.open_recording(drive(tmp_path / "cars.mcap", 1)) as recording:
        (frame,) = sense(recording, SensorRig.of([camera]), quality="low")
    assert (HERO in frame.samples["ids"].data) == is_seen
