"""The instances of the actors of a recording: models, poses, lamps, what collisions leave behind."""

from __future__ import annotations

import math
from contextlib import ExitStack

import numpy as np
import pytest

from carla_recap import open_recording
from carla_recap.model.blueprints import blueprint_sizes, other_names
from carla_recap.model.lives import BoundingBox
from carla_recap.model.records import ActorKind
from carla_recap.replay import Player
from carla_recap.scene.actor_instances import SceneActors
from carla_recap.scene.appearance import look_of
from carla_recap.scene.lamps import lamps_of_vehicles
from carla_recap.scene.materials import Material, Tag
from carla_recap.scene.models import INDEX, MODELS
from tests.replay.scripts import light, pose, spawn, write


def bits(*materials: Material) -> int:
    return sum(1 << material for material in materials)


def model_of(type_id: str, kind: ActorKind = ActorKind.VEHICLE, box: BoundingBox | None = None, **attributes: str) -> str:
    look = look_of(type_id, kind, attributes, box)
    assert look is not None
    return MODELS[look.model].name


# --- looks ---------------------------------------------------------------------------------------------


def test_every_blueprint_has_a_model_and_its_box():
    for type_id, size in blueprint_sizes().items():
        kind = {"vehicle": ActorKind.VEHICLE, "walker": ActorKind.WALKER}.get(type_id.split(".")[0], ActorKind.OTHER)
        look = look_of(type_id, kind, {})
        assert look is not None, type_id
        assert np.array(look.half_extents) * 2 == pytest.approx(np.maximum(size, 0.01)), type_id
        assert look.center[2] == pytest.approx(0 if kind == ActorKind.WALKER else look.half_extents[2], abs=0.01), type_id


def test_every_vehicle_has_a_model_of_its_class():
    names = {type_id: model_of(type_id) for type_id in blueprint_sizes() if type_id.startswith("vehicle.")}
    assert "box" not in names.values()
    for type_id, like in other_names().items():
        look, same = look_of(type_id, ActorKind.VEHICLE, {}), look_of(like, ActorKind.VEHICLE, {})
        assert look is not None
        assert same is not None
        assert (look.model, look.half_extents) == (same.model, same.half_extents), type_id


@pytest.mark.parametrize(
    ("type_id", "model"),
    [
        ("vehicle.carlamotors.firetruck", "fire engine"),
        ("vehicle.mitsubishi.fusorosa", "bus"),
        ("vehicle.gazelle.omafiets", "bicycle"),
        ("vehicle.volkswagen.t2_2021", "minibus"),
        ("vehicle.lincoln.mkz2017", "sedan"),
        ("vehicle.test2.car", "sedan"),
        ("vehicle.omnibuster.car", "sedan"),
        ("static.prop.streetsign04", "board"),
        ("static.prop.streetfountain", "fountain"),
        ("static.prop.mailbox", "bin"),
        ("static.prop.creasedbox02", "debris"),
        ("static.prop.box01", "cardboard box"),
    ],
)
def test_the_longest_word_in_its_name_says_the_model(type_id, model):
    assert model_of(type_id, ActorKind.VEHICLE if type_id.startswith("vehicle") else ActorKind.OTHER) == model


@pytest.mark.parametrize(
    ("extent", "half"), [(2.0, 2.0), *((extent, 3.71 / 2) for extent in (math.nan, math.inf, -1.0, 0.0, 1e30))]
)
def test_a_recorded_box_that_makes_sense_counts_more_than_that_of_the_blueprint(extent, half):
    look = look_of("vehicle.audi.a2", ActorKind.VEHICLE, {}, BoundingBox(0.1, 0, 0.7, extent, 1, 0.6))
    assert look is not None
    assert look.half_extents[0] == pytest.approx(half)
    assert (look.center[0] == 0.1) == (extent == half)


@pytest.mark.parametrize(
    ("attributes", "half", "expected"),
    [
        ({"number_of_wheels": "2"}, (0.8, 0.3, 0.8), "bicycle"),
        ({"number_of_wheels": "2"}, (1.1, 0.4, 0.8), "motorcycle"),
        ({"number_of_wheels": "4"}, (2.4, 1.0, 0.75), "sedan"),
        ({"number_of_wheels": "4"}, (2.4, 1.0, 0.9), "suv"),
        ({}, (5.2, 1.3, 1.6), "bus"),
        ({}, (4.0, 1.3, 1.6), "lorry"),
        ({}, (3.2, 1.1, 1.4), "box truck"),
        ({"base_type": "van"}, (2.4, 1.0, 1.0), "van"),
    ],
)
def test_unknown_vehicles_are_told_by_wheels_and_size(attributes, half, expected):
    assert model_of("vehicle.unknown.thing", box=BoundingBox(0, 0, half[2], *half), **attributes) == expected


@pytest.mark.parametrize(
    ("attributes", "half_height", "expected"),
    [
        ({"age": "adult", "gender": "female"}, 0.93, "woman"),
        ({"age": "adult", "gender": "male"}, 0.93, "man"),
        ({"age": "child", "gender": "male"}, 0.93, "child"),
        ({"gender": "male"}, 0.6, "child"),
    ],
)
def test_walkers_are_told_by_age_gender_and_size(attributes, half_height, expected):
    box = BoundingBox(0, 0, 0, 0.2, 0.2, half_height)
    assert model_of("walker.pedestrian.0099", ActorKind.WALKER, box, **attributes).split()[0] == expected


@pytest.mark.parametrize("color", ["", "red", "1,2", "1,2,300", "-1,2,3", "1,2,3,4", "nan,nan,nan"])
def test_without_a_valid_colour_an_actor_keeps_one_of_its_own(color):
    colors = [look_of("vehicle.audi.a2", ActorKind.VEHICLE, {"color": color}, id=id) for id in (7, 7, 8)]
    assert colors[0] == colors[1] != colors[2]


@pytest.mark.parametrize("type_id", ["sensor.camera.rgb", "spectator", "controller.ai.walker", "static.trigger.friction"])
def test_what_has_no_body_is_not_drawn(type_id):
    assert look_of(type_id, ActorKind.OTHER, {}) is None


def test_signs_are_part_of_the_town_unless_asked_for():
    assert look_of("traffic.stop", ActorKind.TRAFFIC_SIGN, {}) is None
    assert look_of("another.stop", ActorKind.TRAFFIC_SIGN, {}) is None
    names = {}
    for type_id in ("traffic.stop", "traffic.yield", "traffic.speed_limit.30", "traffic.speed_limit.33", "traffic.unknown"):
        look = look_of(type_id, ActorKind.TRAFFIC_SIGN, {}, signs=True)
        assert look is not None
        names[type_id] = MODELS[look.model].name
    assert list(names.values()) == ["stop sign", "yield sign", "speed limit 30", "speed limit", "sign"]


def test_tags_are_those_of_carla():
    tags = {
        "vehicle.audi.a2": Tag.CAR,
        "vehicle.mitsubishi.fusorosa": Tag.BUS,
        "vehicle.vespa.zx125": Tag.MOTORCYCLE,
        "vehicle.bh.crossbike": Tag.BICYCLE,
        "vehicle.carlamotors.firetruck": Tag.TRUCK,
        "walker.pedestrian.0001": Tag.PEDESTRIANS,
        "static.prop.barrel": Tag.STATIC,
    }
    found = {type_id: look_of(type_id, ActorKind.OTHER, {}) for type_id in tags}
    assert {type_id: look.tag for type_id, look in found.items() if look is not None} == tags


# --- scenes --------------------------------------------------------------------------------------------

CAR, WALKER, LIGHT = 5, 6, 7
SPAWNS = [
    spawn(CAR, "vehicle.audi.a2", color="10,20,30"),
    spawn(WALKER, "walker.pedestrian.0001"),
    spawn(LIGHT, "traffic.traffic_light", x=100, yaw=90),
]


@pytest.fixture
def played(tmp_path):
    with ExitStack() as stack:

        def play(*frames, **options):
            path = write(tmp_path / "recording.log", [frames[0] | {"spawned": SPAWNS}, *frames[1:]], tick=0.1)
            return Player(stack.enter_context(open_recording(path)), **options)

        yield play


@pytest.fixture
def shown(played):
    """Return a function that returns the instances of a scene."""

    def instances(*poses, **records):
        (scene,) = played({"transforms": poses, **records}).scenes()
        return SceneActors().at(scene)

    return instances


def control(steer: float = 0, brake: float = 0, gear: int = 1) -> list[tuple[float, ...]]:
    return [(CAR, steer, 0, brake, 0, gear)]


def test_instances_stand_where_their_actors_do(shown):
    found = shown(pose(CAR, 1000, 2000, 50, yaw=90), pose(WALKER, 300, 0, 93))
    assert found.ids.tolist() == [CAR, WALKER, LIGHT]
    assert found.locations[0] == pytest.approx((10, -20, 0.5 + 1.55 / 2))
    assert found.locations[1] == pytest.approx((3, 0, 0.93))
    assert found.rotations[0, :, 0] == pytest.approx((0, -1, 0), abs=1e-6)  # right in CARLA's axes
    assert found.colors[0].tolist() == [10, 20, 30]


def test_a_light_stands_where_it_was_spawned_and_faces_the_traffic_that_it_stops(shown):
    """CARLA's lights are turned by 90 degrees from the lane: x points across it, away from the road."""
    found = shown()  # yaw 90: the lane has yaw 0
    assert found.ids[-1] == LIGHT
    assert found.locations[-1][:2] == pytest.approx((1, 0), abs=0.25)  # the housing is in front of the post
    mesh = MODELS[INDEX["traffic light"]].mesh
    facing = found.rotations[-1] @ mesh.normals[mesh.materials == Material.RED_LAMP][0]
    assert facing == pytest.approx((-1, 0, 0), abs=1e-6)


@pytest.mark.parametrize(
    ("state", "lamp"), [(0, Material.RED_LAMP), (1, Material.YELLOW_LAMP), (2, Material.GREEN_LAMP), (3, None), (9, None)]
)
def test_the_lamp_of_a_light_shows_its_state(shown, state, lamp):
    assert int(shown(light_states=[light(LIGHT, state)]).lamps[-1]) == (bits(lamp) if lamp else 0)


@pytest.mark.parametrize(
    ("flags", "lamps"),
    [
        (8, (Material.TAIL_LIGHT, Material.BRAKE_LIGHT)),
        (16, (Material.RIGHT_INDICATOR,)),
        (32, (Material.LEFT_INDICATOR,)),
        (64, (Material.REVERSE_LIGHT,)),
        (2, (Material.HEADLIGHT, Material.TAIL_LIGHT)),
        (4, (Material.HEADLIGHT, Material.TAIL_LIGHT)),
        (1, (Material.TAIL_LIGHT,)),
        (512, (Material.BEACON,)),
        (1 << 20, ()),
    ],
)
def test_recorded_lights_are_lit(flags, lamps):
    assert int(lamps_of_vehicles(np.array([flags]))[0]) == bits(*lamps)


def test_lamps_and_steering_are_those_of_the_vehicle(shown):
    turning = control(steer=0.5, gear=-1)
    found = shown(pose(CAR), pose(WALKER), vehicle_controls=turning, vehicle_lights=[(CAR, 32)])
    assert int(found.lamps[0]) == bits(Material.LEFT_INDICATOR, Material.REVERSE_LIGHT)
    assert found.steering[0] == pytest.approx(-math.radians(20))  # to the right
    assert not found.steering[1:].any()
    assert shown(pose(CAR), vehicle_controls=control(steer=math.nan)).steering[0] == 0


def test_a_walker_who_is_recorded_lying_lies_as_recorded(shown):
    found = shown(pose(CAR), pose(WALKER, 0, 0, 20, pitch=90))
    assert found.rotations[1, :, 0] == pytest.approx((0, 0, 1), abs=1e-6)  # on its back


# --- collisions ----------------------------------------------------------------------------------------


def accident(yaw: float = 0.0):
    """Return frames in which a car drives along x at 5 m/s into a walker, and passes over it."""
    frames = [{"transforms": [pose(CAR, 50 * min(n - 2, 0)), pose(WALKER, 200, 0, 93, yaw=yaw)]} for n in range(80)]
    frames[2]["collisions"] = [(0, CAR, WALKER, 0, 0)]
    return frames


@pytest.mark.parametrize(("yaw", "facing"), [(0.0, -1.0), (180.0, 1.0), (60.0, -1.0), (-120.0, 1.0)])
def test_a_walker_who_was_knocked_down_lies_in_the_direction_of_the_hit(played, yaw, facing):
    actors = SceneActors(marks=False)
    found = [actors.at(scene) for scene in played(*accident(yaw)).scenes()]
    assert found[0].rotations[1, :, 2] == pytest.approx((0, 0, 1), abs=1e-6)
    lying = found[-1]
    assert lying.rotations[1, :, 2] == pytest.approx((1, 0, 0), abs=1e-6)
    assert lying.rotations[1, 2, 0] == pytest.approx(facing)  # hit from behind, it lies on its face
    assert np.linalg.det(lying.rotations[1]) == pytest.approx(1)
    assert lying.locations[1, 2] == pytest.approx(lying.half_extents[1, 0])  # on the ground


def test_neighbouring_vehicles_without_a_recorded_colour_have_different_ones():
    for step in (1, 2, 3, 4, 5):
        colors = [look_of("vehicle.audi.tt", ActorKind.VEHICLE, {}, id=200 + step * number).color for number in range(10)]
        assert len(set(colors)) == 10


@pytest.mark.parametrize(("start", "marks"), [(3.0, 1), (4.9, 1), (7.5, 0)])
def test_collisions_before_the_beginning_are_recalled(played, start, marks):
    actors, player = SceneActors(), played(*accident(), start=start)
    actors.recall(player)
    found = [actors.at(scene) for scene in player.scenes()]
    assert found[0].rotations[1, :, 2] == pytest.approx((1, 0, 0), abs=1e-6)
    assert (found[0].models == INDEX["collision mark"]).sum() == marks
    assert not (found[-1].models == INDEX["collision mark"]).any()
