"""`Recording`: actors, trajectories, controls, lights; that they are equal in both formats is tested with all queries."""

from __future__ import annotations

from dataclasses import fields
from datetime import UTC, datetime
from importlib import import_module

import numpy as np
import pytest

from carla_recap import ActorKind, Attribute, RecapError, Spawn, attributes, create_recording, open_recording
from tests.samples import DATE, log_header, save

HERO, CAMERA, WALKER, LIGHT, PROP = 100, 101, 200, 300, 400
STEP = 0.5


def spawn(id, kind, type_id, **attributes):
    return Spawn(
        id, kind, 100.0, 200.0, 50.0, 1.0, 2.0, 90.0, 5, type_id,
        [Attribute(3, key, value) for key, value in attributes.items()],
    )  # fmt: skip


def record(path):
    """A recording: a hero drives 20 frames along x, a walker is destroyed, a prop never moves, a light changes."""
    with create_recording(path, map_name="Town10HD", date=DATE, additional_data=True) as recorder:
        for n in range(20):
            records = {
                "transforms": {
                    "id": [HERO, PROP, HERO] if n == 3 else [HERO, PROP],
                    "x": [100.0 * n, 7, 1e6][:2] if n != 3 else [0, 7, 300],
                    "y": 10.0 * n,
                    "z": 5.0,
                    "roll": 3.0,
                    "pitch": 4.0,
                    "yaw": 5.0,
                },
                "vehicle_controls": {"id": HERO, "steer": n / 20, "throttle": 1.0, "hand_brake": n % 2, "gear": -1},
                "light_states": {"id": LIGHT, "state": 2 if n >= 10 else 0, "elapsed": n * STEP, "frozen": n == 4},
            }
            if n < 10:
                records["velocities"] = {"id": HERO, "x": 11.0, "y": 12.0, "z": 13.0}
            if n == 0:
                records["spawned"] = [
                    spawn(HERO, ActorKind.VEHICLE, "vehicle.tesla.model3", role_name="hero", color="1,2,3"),
                    spawn(LIGHT, ActorKind.TRAFFIC_LIGHT, "traffic.traffic_light"),
                    spawn(PROP, ActorKind.OTHER, "static.prop", role_name="prop"),
                ]
                box = {"x": 1.0, "y": 2.0, "z": 75.0, "extent_x": 240.0, "extent_y": 100.0, "extent_z": 75.0}
                records["bounding_boxes"] = {
                    "id": [HERO, LIGHT, 999],
                    **{name: [value, np.nan, value] for name, value in box.items()},
                }
            if n == 2:
                records["spawned"] = [
                    spawn(CAMERA, ActorKind.SENSOR, "sensor.camera.rgb"),
                    spawn(WALKER, 42, "walker.pedestrian.0001"),
                ]
                records["parented"] = [(CAMERA, HERO), (998, 999)]
            if n == 6:
                records["destroyed"] = [(WALKER,), (999,)]
            recorder.add_frame(n * STEP, **records)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "drive.log"
    record(path)
    with open_recording(path) as opened:
        yield opened


# --- what it is ------------------------------------------------------------------------------------------


def test_info(recording):
    info = recording.info
    assert (info.map_name, info.version, info.frames, info.duration) == ("Town10HD", 1, 20, 9.5)
    assert info.date == datetime(2021, 11, 23, 12, 39, 25, tzinfo=UTC)
    assert info.additional_data
    assert repr(recording) == f"Recording({str(recording.path)!r})"


def test_a_date_out_of_range_is_none(tmp_path):
    with open_recording(save(tmp_path / "far.log", log_header(date=(1 << 62)))) as recording:
        assert recording.info.date is None
        assert not recording.info.additional_data


# --- who was there ---------------------------------------------------------------------------------------


def test_actors_are_in_order_of_appearance_and_have_their_attributes(recording):
    assert list(recording.actors) == [HERO, LIGHT, PROP, CAMERA, WALKER]
    assert [actor.spawned_at for actor in recording.actors.values()] == [0.0, 0.0, 0.0, 1.0, 1.0]
    assert [actor.destroyed_at for actor in recording.actors.values()] == [None, None, None, None, 3.0]
    assert [actor.parent for actor in recording.actors.values()] == [None, None, None, HERO, None]
    assert [actor.role_name for actor in recording.actors.values()] == ["hero", "", "prop", "", ""]
    assert recording.heroes == [actor for actor in recording.actors.values() if actor.is_hero] == [recording.actors[HERO]]
    assert recording.actors[HERO].attributes == {"role_name": "hero", "color": "1,2,3"}
    assert (recording.actors[HERO].type_id, recording.actors[HERO].kind) == ("vehicle.tesla.model3", "vehicle")
    assert recording.actors[WALKER].kind == "42"  # an unknown one is a number


def test_boxes_are_in_metres_and_right_handed_and_those_without_a_size_are_left_out(recording):
    box = recording.actors[HERO].bounding_box
    found = (box.x, box.y, box.z, box.extent_x, box.extent_y, box.extent_z)
    assert found == pytest.approx((0.01, -0.02, 0.75, 2.4, 1.0, 0.75))
    assert recording.actors[LIGHT].bounding_box is None
    assert recording.actors[PROP].bounding_box is None


def test_an_id_that_is_used_again_is_the_heros_only_while_it_has_it(tmp_path):
    """The hero is gone in the third of five frames, in the fourth a walker has its id."""
    path, hero = tmp_path / "again.log", attributes(role_name="hero")
    with create_recording(path, map_name="Town01") as recorder:
        for frame in range(5):
            spawned = [Spawn(7, 2 if frame else 1, type_id="a", attributes=[] if frame else hero)] if frame in (0, 3) else []
            present = [(7, 100.0 * frame, 0, 0, 0, 0, 0)] if frame != 2 else []
            controls = [(7, 0, 0, 0, 0, frame)] if present else []
            gone = [7] if frame == 2 else []
            recorder.add_frame(frame, spawned=spawned, destroyed=gone, transforms=present, vehicle_controls=controls)
    with open_recording(path) as recording:
        (found,) = recording.heroes
        assert (found.spawned_at, found.destroyed_at, recording.actors[7].kind) == (0, 2, "walker")
        assert recording.actors.columns()["kind"] == ["vehicle", "walker"]
        assert recording.trajectory("hero").x.tolist() == recording.trajectories("vehicle")[7].x.tolist() == [0, 1]
        assert recording.trajectories("walker")[7].x.tolist() == [3, 4]
        assert recording.trajectory(7).x.tolist() == recording.trajectory(np.uint32(7)).x.tolist() == [0, 1, 3, 4]
        assert recording.controls("hero").gear.tolist() == [0, 1]
        assert {row.time for row in recording.measures() if row.measure == "speed"} <= {0, 1}


# --- where they went -------------------------------------------------------------------------------------


def test_an_actor_without_transforms_has_an_empty_trajectory(recording):
    path = recording.trajectory(CAMERA)
    assert (len(path), path.speed.tolist(), path.velocity_recorded.dtype) == (0, [], np.bool_)


@pytest.mark.parametrize("question", ["trajectory", "controls", "light_states", "time_series"])
def test_an_actor_is_named_by_its_id_or_as_the_hero(recording, question):
    ask = getattr(recording, question)
    with pytest.raises(RecapError, match=r"drive\.log: no (actor|vehicle or walker) 102.*; known ids are \d+ \(hero\)"):
        ask(102)
    if question != "light_states":
        np.testing.assert_array_equal(ask("hero").time, ask(HERO).time)
    with pytest.raises(RecapError, match=r"expected an actor id or 'hero'.*, found 'ego'"):
        ask("ego")


# --- what they did ---------------------------------------------------------------------------------------


def test_controls(recording):
    controls = recording.controls(HERO)
    assert controls.time.tolist() == [n * STEP for n in range(20)]
    assert controls.steer == pytest.approx(np.arange(20) / 20)
    assert controls.throttle.tolist() == [1.0] * 20
    assert controls.hand_brake.tolist() == [n % 2 == 1 for n in range(20)]
    assert controls.gear.tolist() == [-1] * 20
    assert len(recording.controls(PROP).time) == 0


def test_light_states(recording):
    states = recording.light_states(LIGHT)
    assert states.state.tolist() == [0] * 10 + [2] * 10
    assert states.elapsed == pytest.approx(np.arange(20) * STEP)
    assert np.flatnonzero(states.frozen).tolist() == [4]


def test_a_time_before_the_first_frame_is_an_error(recording):
    with pytest.raises(RecapError, match=r"drive\.log: no frame at -1 s; it has 20, up to 9\.5 s"):
        recording.frame_at(-1)


@pytest.mark.parametrize(
    ("keywords", "options"),
    [
        ("queries.detectors:IncidentKeywords", "queries.detectors:IncidentOptions"),
        ("queries.score.scoring:ScoreKeywords", "queries.score.scoring:ScoreOptions"),
        ("sensors.options:SensingKeywords", "sensors.options:SensingOptions"),
    ],
)
def test_keywords_are_the_fields_of_the_options(keywords: str, options: str) -> None:
    found, expected = (
        getattr(import_module(f"carla_recap.{name.partition(':')[0]}"), name.partition(":")[2]).__annotations__
        for name in (keywords, options)
    )
    assert {name: kind.__forward_arg__ for name, kind in found.items()} == expected


def test_keywords_of_exports_and_campaigns_are_their_options() -> None:
    from carla_recap.exports import FORMATS, ExportKeywords
    from carla_recap.fleet.campaign import Campaign, CampaignKeywords

    known = set().union(*(form.options for form in FORMATS.values()))
    assert {*ExportKeywords.__annotations__, "road_map"} == known
    assert {"function", "out", *CampaignKeywords.__annotations__} == {field.name for field in fields(Campaign)}
