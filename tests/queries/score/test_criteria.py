"""The definitions of infractions: each on a drive that is made for it, and on one that just does not break it."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from carla_recap.errors import RecapWarning
from carla_recap.formats import open_reader
from carla_recap.model.frame import Header
from carla_recap.model.records import Spawn
from carla_recap.queries.score import INFRACTIONS, Infraction, Route, Score, ScoreOptions, score
from carla_recap.queries.score.infractions import penalty_of
from carla_recap.roads import find_road_network
from carla_recap.roads import network as roads
from carla_recap.roads.network import RoadNetwork
from tests.queries.conftest import write
from tests.queries.score.drives import END, OTHER, ROUTE, START, TICK, Drives, Pose, Y, at_speed, vehicle, westward

WALKER = Spawn(OTHER, 2, type_id="walker.pedestrian.0001")
WHOLE = westward(at_speed(10.0, 105.0))
"""The whole route at 10 m/s."""
NONE = 0xFFFFFFFF
"""The id of what is no actor."""


@pytest.fixture
def drives(tmp_path: Path) -> Drives:
    return Drives(tmp_path / "drive.log")


def kinds(score: Score) -> list[str]:
    return [each.kind for each in score.infractions]


# --- the end of the route ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
def test_a_drive_to_the_end_of_the_route_is_perfect(tmp_path: Path, suffix: str) -> None:
    found = Drives(tmp_path / f"drive{suffix}")(WHOLE)
    assert (found.status, found.score, found.completion, found.penalty) == ("Perfect", 100.0, 100.0, 1.0)
    assert found.route_length == pytest.approx(100.0, abs=2.0)
    assert found.stop == pytest.approx(10.0, abs=0.3)  # the rest of the recording does not count


def test_the_completion_is_the_share_of_the_route_that_is_driven(drives: Drives) -> None:
    found = drives(westward(at_speed(10.0, 40.0)))
    assert (found.status, kinds(found)) == ("Failed", [])
    assert found.outcome == f"Failed - Recording ends at {found.completion:.2f} % of the route"
    assert found.completion == pytest.approx(40.0, abs=1.5)
    assert found.score == found.completion


SLOW: Final = 0.5  # s between two frames
ARRIVES: Final = [*westward(at_speed(10.0, 40.0))]


@pytest.mark.parametrize(
    ("poses", "tick", "outcome", "found"),
    [
        (westward([30.0] * 80), TICK, "Perfect", []),
        (WHOLE[::8], 8 * TICK, "Perfect", []),  # frames that are far apart complete a route as well
        (
            ARRIVES + [(215.0, Y + 0.5 * n, 90.0) for n in range(1, 100)],
            TICK,
            "Agent deviated from the route",
            ["route_dev"],
        ),
        (ARRIVES + [(215.0, Y + 0.5 * n, 90.0) for n in range(1, 58)], TICK, "Recording ends", []),
        ([(x, Y + 20.0, yaw) for x, _, yaw in WHOLE], TICK, "deviated", ["route_dev"]),
        ([(x, Y + 14.0, yaw) for x, _, yaw in WHOLE], TICK, "", []),
        (westward([98.0] * 20), TICK, "", []),  # 4.9 m in a tick
        (westward([10.0] * 6 + [0.0] * 370, tick=SLOW), SLOW, "Agent got blocked", ["vehicle_blocked"]),
        (westward([10.0] * 6 + [0.0] * 357 + [0.2, 0.2] + [0.0] * 10, tick=SLOW), SLOW, "Recording ends", []),
        (westward([0.11] * 900, tick=SLOW), SLOW, "Agent timed out", ["route_timeout"]),
    ],
)
def test_how_a_route_ends(drives: Drives, poses: list[Pose], tick: float, outcome: str, found: list[str]) -> None:
    score = drives(poses, tick=tick)
    assert outcome in score.outcome
    assert [kind for kind in kinds(score) if INFRACTIONS[kind].ends] == found
    assert all(each.time == score.stop for each in score.infractions[-1:] if INFRACTIONS[each.kind].ends)


def test_where_and_when_a_route_ends(drives: Drives) -> None:
    found = drives(ARRIVES + [(215.0, Y + 0.5 * n, 90.0) for n in range(1, 100)])
    assert found.infractions[-1].y - Y == pytest.approx(30.0, abs=1.0)
    assert found.completion == pytest.approx(40.0, abs=1.5)
    assert drives([(x, Y + 20.0, yaw) for x, _, yaw in WHOLE]).completion == pytest.approx(30.0, abs=3.0)
    (blocked,) = drives(westward([10.0] * 6 + [0.0] * 370, tick=SLOW), tick=SLOW).infractions
    assert (blocked.time, blocked.x) == (pytest.approx(3.0 + 180.0, abs=0.6), pytest.approx(START - 30.0, abs=0.5))
    assert drives(westward([0.11] * 900, tick=SLOW), tick=SLOW).stop == pytest.approx(326.5, abs=1.0)
    with pytest.warns(RecapWarning, match="the speed of actor 7 is unknown in 8 of 8 frames, in which it counts as moving"):
        assert "route_dev" in kinds(drives(westward([240.0] * 8)))


# --- collisions ----------------------------------------------------------------------------------------------------------


def beside(count: int = len(WHOLE)) -> list[Pose]:
    return [(START - 40, Y + 3.0, 0.0)] * count


@pytest.mark.parametrize(
    ("spawn", "kind"),
    [
        (WALKER, "collisions_pedestrian"),
        (vehicle(OTHER), "collisions_vehicle"),
        (Spawn(OTHER, 4, type_id="static.prop.bin"), "collisions_layout"),
        (Spawn(OTHER, 3, type_id="traffic.traffic_light"), "collisions_layout"),
    ],
)
def test_a_collision_is_of_the_kind_of_the_other_actor(drives: Drives, spawn: Spawn, kind: str) -> None:
    found = drives(WHOLE, others={OTHER: (spawn, beside())}, touches=[(80, OTHER), (81, OTHER)])
    (collision,) = found.infractions
    assert (collision.kind, collision.actor, collision.type_id) == (kind, OTHER, spawn.type_id)
    assert (collision.time, collision.link) == (pytest.approx(80 * TICK), "#t=4.00")
    assert collision.x == pytest.approx(START - 10.0 * 80 * TICK)  # in the frame before


def test_a_collision_with_a_building_is_one_with_the_layout(drives: Drives) -> None:
    (collision,) = drives(WHOLE, touches=[(80, NONE)]).infractions
    assert (collision.kind, collision.actor) == ("collisions_layout", None)


def test_a_hero_that_stands_is_not_at_fault(drives: Drives) -> None:
    stands = westward([*at_speed(10.0, 30.0), *[0.0] * 40])
    with_walker = {OTHER: (WALKER, beside(len(stands)))}
    assert kinds(drives(stands, others=with_walker, touches=[(90, OTHER)])) == []
    assert kinds(drives(stands, others=with_walker, touches=[(50, OTHER)])) == ["collisions_pedestrian"]


@pytest.mark.parametrize(
    ("touches", "count"),
    [
        ([(80, OTHER), (88, 9)], 1),  # within 5 m, which are 10 frames at 10 m/s
        ([(80, OTHER), (95, 9)], 2),
        ([(20, OTHER), (110, OTHER)], 1),  # with one actor within 5 s
        ([(20, OTHER), (130, OTHER)], 2),
        ([(frame, OTHER) for frame in range(20, 180)], 2),  # a contact that lasts counts again after 5 s
    ],
)
def test_collisions_near_each_other_are_one(drives: Drives, touches: list[tuple[int, int]], count: int) -> None:
    others = {OTHER: (WALKER, beside()), 9: (Spawn(9, 2, type_id="walker.pedestrian.0002"), beside())}
    assert len(drives(WHOLE, others=others, touches=touches).infractions) == count


# --- lanes ---------------------------------------------------------------------------------------------------------------


def test_a_drive_outside_the_lanes_counts_by_its_share(drives: Drives) -> None:
    """The road has a lane in each direction, 3.5 m wide: at y = 5.9, the hero is 2.4 m beside the edge of its lane."""
    aside = [(x, Y + (4.15 if 195 < x < 215 else 0.0), yaw) for x, _, yaw in WHOLE]
    found = drives(aside)
    assert (found.status, kinds(found)) == ("Completed", ["outside_route_lanes"])
    assert found.infractions[0].share == pytest.approx(0.2, abs=0.02)
    assert found.penalty == pytest.approx(1 - found.infractions[0].share)
    metres, percentage = map(float, re.findall(r"about ([\d.]+) meters \(([\d.]+)%", found.infractions[0].text)[0])
    assert (metres, percentage) == pytest.approx((20.0, 20.0), abs=2.0)
    assert kinds(drives([(x, Y + (2.2 if 195 < x < 215 else 0.0), yaw) for x, _, yaw in WHOLE])) == []


def test_a_jump_outside_the_lanes_is_not_driven(drives: Drives) -> None:
    """The hero drives 20 m, jumps by 60 m to a place beside the road, and drives 20 m there."""
    poses = westward(at_speed(10, 20)) + westward(at_speed(10, 20), start=START - 80, y=Y + 4.15)
    (found,) = drives(poses, route=None).infractions
    assert found.share == pytest.approx(0.5, abs=0.05)


def test_the_lane_of_the_other_direction_is_outside(drives: Drives) -> None:
    found = drives([(x, -Y if 195 < x < 215 else Y, yaw) for x, _, yaw in WHOLE])
    assert kinds(found) == ["outside_route_lanes"]
    assert found.infractions[0].share == pytest.approx(0.2, abs=0.02)


# --- lights and signs ----------------------------------------------------------------------------------------------------


@cache
def brickfield() -> RoadNetwork:
    found = find_road_network("Brickfield")
    assert found is not None
    return found


def over_line(kind: int, speeds: list[float] | None = None) -> tuple[list[Pose], Spawn]:
    """Return a drive over the stop line of a light or sign, 20 m before it and 10 m behind, and the light or sign."""
    network = brickfield()
    signal = int(np.flatnonzero(network.signals["kind"] == kind)[0])
    line = network.stop_lines[network.stop_lines["signal"] == signal][0]
    x, y = (line["x0"] + line["x1"]) / 2, (line["y0"] + line["y1"]) / 2
    ways = np.cumsum(speeds or at_speed(10.0, 30.0)) * TICK - 20
    heading = float(line["heading"])
    poses = [(x + way * math.cos(heading), y + way * math.sin(heading), math.degrees(heading)) for way in ways.tolist()]
    row = network.signals[signal]
    type_id, number = {roads.LIGHT: ("traffic.traffic_light", 3), roads.STOP: ("traffic.stop", 4)}[kind]
    return poses, Spawn(30, number, 100 * float(row["x"]), -100 * float(row["y"]), type_id=type_id)


RED, GREEN = 0, 2


def test_a_red_light_is_run_by_the_rear_of_the_hero(drives: Drives) -> None:
    poses, light = over_line(roads.LIGHT)
    (infraction,) = drives(poses, route=None, lights={30: (light, RED)}).infractions
    assert (infraction.kind, infraction.actor) == ("red_light", 30)
    assert infraction.time == pytest.approx((20 + 0.8 * 3.8 / 2) / 10, abs=0.15)  # a Mini is 3.8 m long
    assert infraction.text.startswith("Agent ran a red light 30 at (x=")


def test_a_stop_sign_demands_a_stop_before_it(drives: Drives) -> None:
    poses, sign = over_line(roads.STOP)
    (infraction,) = drives(poses, route=None, others={30: (sign, [])}).infractions
    assert (infraction.kind, infraction.actor) == ("stop_infraction", 30)
    assert infraction.time == pytest.approx(2.0, abs=0.1)


JUMPS = [*at_speed(10.0, 5.0), 600.0, *at_speed(10.0, 5.0)]


@pytest.mark.parametrize(
    ("kind", "speeds", "state", "found"),
    [
        (roads.LIGHT, at_speed(10.0, 30.0), GREEN, []),
        (roads.LIGHT, [*at_speed(10.0, 20.5), *[0.0] * 40], RED, []),  # it stops with its front over the line
        (roads.LIGHT, at_speed(10.0, 30.0), [GREEN] * 44 + [RED] * 20, ["red_light"]),  # its rear is 0.6 m behind
        (roads.LIGHT, at_speed(10.0, 30.0), [GREEN] * 46 + [RED] * 20, []),
        (roads.LIGHT, JUMPS, RED, []),
        (roads.STOP, JUMPS, RED, []),
        (roads.STOP, [*at_speed(10.0, 17.0), 0.0, 0.0, *at_speed(10.0, 13.0)], RED, []),
        (roads.STOP, [*at_speed(10.0, 10.0), 0.0, 0.0, *at_speed(10.0, 20.0)], RED, ["stop_infraction"]),  # too early
    ],
)
def test_what_runs_a_light_or_a_stop_sign(
    drives: Drives, kind: int, speeds: list[float], state: int | list[int], found: list[str]
) -> None:
    poses, signal = over_line(kind, speeds)
    lights = {"red_light", "stop_infraction"}
    assert [each for each in kinds(drives(poses, route=None, lights={30: (signal, state)})) if each in lights] == found


# --- other traffic -------------------------------------------------------------------------------------------------------


def test_a_hero_slower_than_the_traffic_is_too_slow(drives: Drives) -> None:
    others = {OTHER: (vehicle(OTHER, "background"), westward([20.0] * len(WHOLE), start=250.0, y=40.0))}
    found = drives(WHOLE, others=others)
    assert kinds(found) == ["min_speed_infractions"] * 5  # the last quarter counts twice
    assert [each.share for each in found.infractions] == pytest.approx([0.5] * 5, abs=0.02)
    assert found.infractions[0].text.startswith("Average speed is 5")
    assert found.penalty == pytest.approx((1 - 0.3 * 0.5) ** 5, abs=0.02)
    assert kinds(drives(WHOLE, others=others, formula="1.0")) == []
    slower = {OTHER: (vehicle(OTHER, "background"), westward([5.0] * len(WHOLE), start=250.0, y=40.0))}
    assert kinds(drives(WHOLE, others=slower)) == []
    scenery = {OTHER: (vehicle(OTHER, "scenario"), westward([20.0] * len(WHOLE), start=250.0, y=40.0))}
    assert kinds(drives(WHOLE, others=scenery)) == []


def test_traffic_far_from_the_hero_is_as_fast_as_when_it_was_near(drives: Drives) -> None:
    """The evaluator's traffic manager moves it without physics, so that CARLA says no speed of it."""
    far = {OTHER: (vehicle(OTHER, "background"), westward([20.0] * len(WHOLE), start=250.0, y=100.0))}
    assert kinds(drives(WHOLE, others=far)) == []
    leaves = [*at_speed(20.0, 40.0), *[0.0] * (len(WHOLE) - 40)]
    left_behind = westward(leaves, start=250.0, y=40.0)
    moved = [(x, y + (100.0 if number >= 40 else 0.0), yaw) for number, (x, y, yaw) in enumerate(left_behind)]
    found = drives(WHOLE, others={OTHER: (vehicle(OTHER, "background"), moved)})
    assert [each.share for each in found.infractions] == pytest.approx([0.5] * 5, abs=0.02)


def test_an_emergency_vehicle_that_stays_behind_was_not_let_pass(drives: Drives) -> None:
    ambulance = vehicle(OTHER, "scenario", "vehicle.ford.ambulance", special_type="emergency")
    behind = [(x + 15.0, y, yaw) for x, y, yaw in WHOLE]
    found = drives(WHOLE, others={OTHER: (ambulance, behind)})
    assert kinds(found) == ["yield_emergency_vehicle_infractions"]
    assert found.infractions[0].actor == OTHER
    assert kinds(drives(WHOLE, others={OTHER: (ambulance, behind)}, formula="1.0")) == []
    passes = [(x + 15.0 - 0.3 * number, y, yaw) for number, (x, y, yaw) in enumerate(WHOLE)]
    assert kinds(drives(WHOLE, others={OTHER: (ambulance, passes)})) == []
    other = vehicle(OTHER, "scenario", "vehicle.ford.ambulance")
    assert kinds(drives(WHOLE, others={OTHER: (other, behind)})) == []


# --- ids that are used again, and unknown speeds ---------------------------------------------------------------------------


def scored(path: Path, frames: list[dict[str, Any]], **options: Any) -> Score:
    """Return the score of frames of 0.05 s along the route."""
    write(path, frames, header=Header("Brickfield", 1_600_000_000), durations=[0.05] * len(frames))
    with closing(open_reader(path)) as reader:
        return score(reader, ROUTE, ScoreOptions(**options))


def moving(id: int, poses: Sequence[Pose]) -> list[tuple[float, ...]]:
    return [(id, 100 * x, -100 * y, 0.0, 0.0, 0.0, -yaw) for x, y, yaw in poses]


@pytest.mark.parametrize("is_destroyed", [True, False])
def test_an_earlier_actor_with_an_id_is_not_scored(tmp_path: Path, is_destroyed: bool) -> None:
    background = [vehicle(id, "background") for id in (8, 9)]
    before = [{"transforms": [*moving(7, [(50.0, 100.0, 0.0)]), *moving(9, [(255.0, 5.0, 180.0)])]} for _ in range(40)]
    before[0]["spawned"] = [vehicle(7), background[1]]
    before.append({"destroyed": [(7,), (9,)]} if is_destroyed else {})
    tracks = (7, WHOLE), (8, westward([6.0] * len(WHOLE), y=9.0)), (9, westward([10.0] * len(WHOLE), y=5.0))
    frames = [{"transforms": list(each)} for each in zip(*(moving(*track) for track in tracks), strict=True)]
    frames[0]["spawned"] = [vehicle(7, "hero"), *background]
    found, alone = scored(tmp_path / "again.mcap", before + frames), scored(tmp_path / "once.mcap", frames)
    assert (found.status, found.score, found.infractions) == ("Perfect", 100.0, ())
    assert found.start == pytest.approx(41 * 0.05)
    assert found.efficiency == alone.efficiency == pytest.approx(100 * 10 / 8, abs=0.01)


def test_a_hero_whose_speed_is_unknown_counts_as_moving(drives: Drives) -> None:
    tick = 1.05  # s: poses that are more than 1 s apart
    with pytest.warns(RecapWarning, match="in which it counts as moving"):
        found = drives(westward([10.0] * 11, tick=tick), tick=tick, others={8: (vehicle(8), [])}, touches=[(5, 8)])
    assert kinds(found) == ["collisions_vehicle"]


@pytest.mark.parametrize(("stays", "stop", "expected"), [(True, np.inf, 1), (False, np.inf, 1), (False, 1.9, 0)])
def test_a_contact_counts_though_the_hero_has_no_pose_then(tmp_path: Path, stays: bool, stop: float, expected: int) -> None:
    frames: list[dict[str, Any]] = [{"transforms": moving(7, [pose])} for pose in WHOLE[: 80 if stays else 41]]
    frames[0]["spawned"] = [vehicle(7, "hero"), vehicle(8)]
    frames[40] = {"collisions": [(0, 7, 8, True, False)]} | ({} if stays else {"destroyed": [(7,)]})
    found = scored(tmp_path / "contact.mcap", frames, stop=stop)
    assert kinds(found) == ["collisions_vehicle"] * expected


def test_a_jump_is_not_driven(drives: Drives) -> None:
    """The hero drives 20 m, jumps by 60 m, and drives 20 m, on both halves beside traffic at its own speed."""
    poses = westward(at_speed(10, 20)) + westward(at_speed(10, 20), start=START - 80)
    traffic = {OTHER: (vehicle(OTHER, "background"), westward([10.0] * len(poses), y=5.25))}
    found = drives(poses, route=None, others=traffic)
    assert found.driven == found.route_length == pytest.approx(39.5 - TICK * 10)
    assert found.efficiency == pytest.approx(100, abs=0.5)


# --- without a route -----------------------------------------------------------------------------------------------------


def test_without_a_route_the_drive_is_judged(drives: Drives) -> None:
    found = drives(WHOLE, route=None, others={OTHER: (WALKER, beside())}, touches=[(80, OTHER)])
    assert (found.route, found.status, found.completion) == ("", "Driven", 100.0)
    assert kinds(found) == ["collisions_pedestrian"]
    assert found.driven == pytest.approx(105.0, abs=1.0)


def test_a_route_of_the_other_direction_is_not_completed(drives: Drives) -> None:
    back = Route("2", "Brickfield", np.array([(END, -Y, 0.0), (START, -Y, 0.0)]))
    found = drives(WHOLE, route=back)
    assert found.completion == pytest.approx(2.0, abs=0.2)  # the points that are passed in the first tick
    assert found.status == "Failed - Agent deviated from the route"


def test_without_a_route_a_hero_that_stands_has_driven_until_it_is_blocked(drives: Drives) -> None:
    stands = westward([1.0, *[0.0] * 40])
    assert drives(stands, route=None).status == "Driven"
    with (
        pytest.warns(RecapWarning, match="the speed of actor 7 is unknown in 41 of 41 frames, in which it counts as moving"),
        pytest.warns(RecapWarning, match="40 frames last longer than 5 s, the first at 0.00 s; of each, 5 s count"),
    ):
        assert drives(stands, route=None, tick=10.0).status == "Driven"
    found = drives(westward([1.0, *[0.0] * 190]), route=None, tick=1.0)
    assert (found.status, kinds(found)) == ("Failed - Agent got blocked", ["vehicle_blocked"])


BOTH = (("outside_route_lanes", 0.2), ("min_speed_infractions", 0.5))
LATER = (("min_speed_infractions", 0.5), ("yield_emergency_vehicle_infractions", 1.0))
ENDS = tuple((name, 1.0) for name, kind in INFRACTIONS.items() if kind.ends)
EACH = tuple((name, 1.0) for name in INFRACTIONS if name != "outside_route_lanes")
FACTORS = 0.5 * 0.6 * 0.65 * 0.7 * 0.8  # of pedestrians, vehicles, layout, lights, stop signs


@pytest.mark.parametrize(
    ("infractions", "formula", "penalty"),
    [
        ((), "2.0", 1.0),
        ((("collisions_pedestrian", 1.0), ("red_light", 1.0), ("red_light", 1.0)), "1.0", 0.5 * 0.7 * 0.7),
        ((("collisions_pedestrian", 1.0), ("red_light", 1.0), ("red_light", 1.0)), "2.0", 0.5 * 0.7 * 0.7),
        ((("collisions_pedestrian", 1.0), ("red_light", 1.0), ("stop_infraction", 1.0)), "2.1", 1 / (1 + 1.0 + 0.4 + 0.25)),
        (BOTH[:1], "1.0", 0.8),
        (BOTH[1:], "2.0", 1 - 0.3 * 0.5),
        (BOTH, "2.1", 0.8 / (1 + 0.4 * 0.5)),
        (LATER, "1.0", 1.0),  # which knows neither slow drives nor emergency vehicles
        *((ENDS, formula, 1.0) for formula in ("1.0", "2.0", "2.1")),
        (EACH, "1.0", FACTORS),
        (EACH, "2.0", FACTORS * 0.7**3),
        (EACH, "2.1", 1 / (1 + 1.0 + 0.7 + 0.6 + 0.4 + 0.25 + 0.4 + 0.4 + 0.4)),
    ],
)
def test_penalties(infractions: tuple[tuple[str, float], ...], formula: str, penalty: float) -> None:
    found = [Infraction(kind, 1.0, 0.0, 0.0, 0.0, None, "", share, "") for kind, share in infractions]
    assert penalty_of(found, formula) == pytest.approx(penalty)
