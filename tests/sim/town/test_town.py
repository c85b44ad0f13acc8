from __future__ import annotations

import random
import subprocess
import sys
from contextlib import suppress
from functools import cache
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest

from carla_recap.errors import RecapError
from carla_recap.roads import find_map
from carla_recap.sim.town.junctions import SignalKind
from carla_recap.sim.town.lanes import NO_LANE
from carla_recap.sim.town.loading import BUILT_IN, Town, load_town, main_lanes, make_town
from tests.roads.towns import lane, mirrored, opendrive, road, section, town
from tests.samples import ROOT
from tests.sim.two_levels import two_levels
from tests.waiting import time_limit

NAMES = (BUILT_IN, "Town01", "Town02", "Town10HD")
LIGHT = (
    '<signals><signal name="" id="7" s="{s}" t="-5" zOffset="0" hOffset="0" orientation="{way}" dynamic="yes" country=""'
    ' type="{kind}" subtype="-1" value="{value}"/></signals>'
)


@cache
def loaded(name: str) -> Town:
    return load_town() if name == BUILT_IN else load_town(town(name))


@pytest.fixture(params=NAMES)
def any_town(request: pytest.FixtureRequest) -> Town:
    return loaded(request.param)


@pytest.fixture
def brickfield() -> Town:
    return loaded(BUILT_IN)


def made_of(tmp_path: Path, *roads: str) -> Town:
    path = tmp_path / "small.xodr"
    path.write_text(opendrive(*roads))
    return load_town(path)


def sign(kind: str, *, s: float, way: str = "+", value: float = -1) -> str:
    return LIGHT.format(kind=kind, s=s, way=way, value=value)


def gap_to_lanes(place: Town, points: np.ndarray) -> np.ndarray:
    """Return the distances of points from the middle of the nearest lane."""
    on_lane, _ = place.index.at(*place.nearest_lane(points[:, 0], points[:, 1]))
    return np.linalg.norm(on_lane[:, :2] - points[:, :2], axis=1)


# --- lanes ---------------------------------------------------------------------------------------------


def test_lanes_follow_each_other_without_a_gap(any_town: Town) -> None:
    for one in any_town.lanes:
        assert one.successors
        for number in one.successors:
            after = any_town.lanes[number]
            assert one.index in after.predecessors
            assert np.linalg.norm(one.points[-1] - after.points[0]) < 0.3
            assert np.cos(one.heading[-1] - after.heading[0]) > np.cos(np.radians(10))


def test_points_are_evenly_spaced_and_headings_point_along_them(any_town: Town) -> None:
    for one in any_town.lanes:
        steps = np.diff(one.points, axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        assert lengths == pytest.approx(np.diff(one.s), rel=0.02)
        assert lengths.max() < 1.01
        middle = (one.heading[1:] + one.heading[:-1]) / 2
        assert (np.cos(middle - np.arctan2(steps[:, 1], steps[:, 0])) > np.cos(np.radians(8))).all()
        assert (np.abs(np.diff(one.heading)) < 0.6).all()


def test_from_every_spawn_point_one_gets_to_every_other(any_town: Town) -> None:
    main = set(main_lanes(any_town.lanes))
    assert len(main) > 0.85 * len(any_town.lanes)
    places = np.array([(point.location.x, point.location.y, point.location.z) for point in any_town.spawn_points])
    yaw = np.array([point.rotation.yaw for point in any_town.spawn_points])
    assert ((yaw > -180) & (yaw <= 180)).all()
    lanes, s = any_town.nearest_lane(places[:, 0], places[:, 1], heading=np.radians(yaw))
    assert set(lanes.tolist()) <= main
    on_lane, heading = any_town.index.at(lanes, s)
    assert places == pytest.approx(on_lane + np.array((0, 0, 0.3)), abs=0.05)
    assert (np.cos(heading - np.radians(yaw)) > 0.999).all()
    assert len(places) >= 150
    apart = [np.sort(np.linalg.norm(places - place, axis=1))[1] for place in places]
    assert min(apart) > 2.9  # beside each other, on neighbouring lanes


def test_turns_in_junctions(brickfield: Town) -> None:
    turns = [one.turn for one in brickfield.lanes if one.junction is not None]
    assert {turn: turns.count(turn) for turn in turns} == {"straight": 24, "left": 20, "right": 20}
    for one in brickfield.lanes:
        bend = one.heading[-1] - one.heading[0]
        if one.turn == "right":
            assert bend == pytest.approx(np.pi / 2, abs=0.01)  # from x to y
        if one.junction is None:
            assert one.turn == "straight"


@pytest.mark.parametrize("rule", ["RHT", "LHT"])
def test_a_marking_allows_changes_from_where_it_begins(tmp_path: Path, rule: str) -> None:
    marks = '<roadMark sOffset="0" laneChange="none"/><roadMark sOffset="60" laneChange="both"/>'
    lanes = lane(-1).replace("</lane>", f"{marks}</lane>") + lane(-2)
    town = made_of(tmp_path, road(sections=section(0, right=lanes)).replace("<road ", f'<road rule="{rule}" '))
    outer, inner = sorted(town.lanes, key=lambda each: each.lane_id)
    stations = inner.s if rule == "RHT" else inner.length - inner.s
    to_outer, to_inner = (inner.right, outer.left) if rule == "RHT" else (inner.left, outer.right)
    assert to_outer.tolist() == np.where(stations >= 60, outer.index, NO_LANE).tolist()
    assert to_inner.tolist() == np.where(stations >= 60, inner.index, NO_LANE).tolist()


def test_speed_limits(brickfield: Town) -> None:
    limits = {round(limit * 3.6) for one in brickfield.lanes if one.junction is None for limit in one.limits}
    assert limits == {30, 50}
    town01 = np.round(loaded("Town01").index.limits * 3.6, 3)
    assert np.unique(town01).tolist() == [30, 40.234, 60, 90]  # of signs, and 25 mph of roads


def test_without_records_the_speed_limit_is_that_of_a_sign_or_else_of_carla(tmp_path: Path) -> None:
    told = made_of(tmp_path, road(sections=section(0, right=lane(-1)), inside=sign("274", s=5, value=70)))
    assert told.index.limit(np.array((0, 0)), np.array((4.0, 6.0))) * 3.6 == pytest.approx([30, 70])
    (limit,) = told.signals
    assert (limit.kind, limit.speed_limit) == (SignalKind.SPEED_LIMIT, pytest.approx(70 / 3.6))
    assert limit.stops == ((0, pytest.approx(5, abs=0.1)),)
    assert made_of(tmp_path, road()).lanes[0].limits == pytest.approx(30 / 3.6)


# --- places on lanes -----------------------------------------------------------------------------------


def test_places_beside_lanes_are_found_again(any_town: Town) -> None:
    dice = np.random.default_rng(7)
    lanes = dice.integers(0, len(any_town.lanes), 500)
    s = dice.random(500) * any_town.index.length[lanes]
    place, heading = any_town.index.at(lanes, s)
    aside = dice.uniform(-1.5, 1.5, 500)
    x, y = place[:, 0] - np.sin(heading) * aside, place[:, 1] + np.cos(heading) * aside
    along, right = any_town.project(lanes, x, y, s + dice.uniform(-3, 3, 500))
    assert along == pytest.approx(s, abs=0.3)
    assert right == pytest.approx(aside, abs=0.1)
    found, _ = any_town.index.at(*any_town.nearest_lane(x, y))
    assert (np.hypot(found[:, 0] - x, found[:, 1] - y) <= np.abs(aside) + 0.05).all()
    _, direction = any_town.index.at(*any_town.nearest_lane(x, y, heading=heading))
    assert (np.cos(direction - heading) > 0.5).all()


def test_a_lane_goes_on_straight_before_and_after_its_ends(brickfield: Town) -> None:
    one = brickfield.lanes[0]
    ahead = np.array((np.cos(one.heading[-1]), np.sin(one.heading[-1])))
    x, y = one.points[-1, :2] + 5 * ahead
    s, right = brickfield.project([0], [x], [y], [one.length])
    assert (s[0], right[0]) == (pytest.approx(one.length + 5, abs=0.01), pytest.approx(0, abs=0.1))
    place, _ = brickfield.index.at([0, 0], [-3.0, one.length + 3])
    assert place == pytest.approx(one.points[[0, -1]])


def test_far_from_all_roads_there_still_is_a_lane(any_town: Town) -> None:
    x, y = np.array((0.0, 1e7, -1e4)), np.array((-1e6, 1e7, 3.0))
    lanes, s = any_town.nearest_lane(x, y, z=np.zeros(3))
    assert ((lanes >= 0) & (lanes < len(any_town.lanes))).all()
    assert ((s >= 0) & (s <= any_town.index.length[lanes])).all()
    assert np.isfinite(any_town.height(x, y)).all()


def test_heights_are_those_of_the_road(brickfield: Town) -> None:
    summit = brickfield.height([180.0, 180.0], [-220.0, -223.0])
    assert summit == pytest.approx([2.5, 2.5], abs=0.05)
    assert brickfield.height([60.0], [-110.0]) == pytest.approx([0.0], abs=0.01)
    points = brickfield.index.points
    assert brickfield.height(points[:, 0] + 0.4, points[:, 1] - 0.4) == pytest.approx(points[:, 2], abs=0.1)


def test_lanes_above_each_other_are_distinguished_by_height(tmp_path: Path) -> None:
    below = road(1, sections=section(0, right=lane(-1)))
    above = road(2, x=50, y=-50, heading=np.pi / 2, height=6, sections=section(0, right=lane(-1)))
    both = made_of(tmp_path, below, above)
    (cross,) = ({(round(x), round(y)) for x, y in both.lanes[0].points[:, :2]}) & {(52, 2)}
    for z, expected in ((0.0, 1), (6.0, 2)):
        lanes, _ = both.nearest_lane([cross[0]], [cross[1]], z=[z])
        assert both.lanes[lanes[0]].road_id == expected


def test_each_of_many_roads_above_each_other_has_its_height(tmp_path: Path) -> None:
    levels = 5.0 * np.arange(8)
    turns = enumerate(levels.tolist())
    place = made_of(
        tmp_path, *(road(n + 1, x=(n % 2) * 50, y=(n % 2) * -50, heading=(n % 2) * np.pi / 2, height=z) for n, z in turns)
    )
    assert place.height(np.full(8, 50.0), np.zeros(8), levels + 0.2) == pytest.approx(levels)


# --- signals and junctions -----------------------------------------------------------------------------


def test_lights_stand_before_the_junctions_that_they_govern(any_town: Town) -> None:
    lights = [signal for signal in any_town.signals if signal.kind is SignalKind.LIGHT]
    assert lights
    for light in lights:
        assert light.stops
        assert light.controller
        for number, s in light.stops:
            one = any_town.lanes[number]
            assert one.junction is None
            assert s == pytest.approx(one.length)
            assert set(one.successors) <= set(light.governs)
            ahead = np.degrees(one.heading[-1]) - light.transform.rotation.yaw
            if any_town.name == BUILT_IN:
                assert np.cos(np.radians(ahead)) == pytest.approx(1, abs=1e-3)
        assert {any_town.lanes[number].junction for number in light.governs} == {light.junction}


def test_every_light_is_in_one_phase_of_its_junction(any_town: Town) -> None:
    phased = [light for junction in any_town.junctions for phase in junction.phases for light in phase]
    lights = [signal.index for signal in any_town.signals if signal.kind is SignalKind.LIGHT]
    assert sorted(phased) == lights
    for junction in any_town.junctions:
        assert {any_town.signals[light].junction for phase in junction.phases for light in phase} <= {junction.id}


def test_lights_of_one_phase_never_let_two_streams_cross_of_which_none_turns(brickfield: Town) -> None:
    signalised = [junction for junction in brickfield.junctions if junction.phases]
    assert len(signalised) == 5
    for junction in signalised:
        assert len(junction.phases) == 2
        for phase in junction.phases:
            green = {number for light in phase for number in brickfield.signals[light].governs}
            for conflict in junction.conflicts:
                if {conflict.lane, conflict.other} <= green:
                    turns = {brickfield.lanes[conflict.lane].turn, brickfield.lanes[conflict.other].turn}
                    assert "left" in turns


def test_conflicts_have_two_sides_of_which_one_yields(any_town: Town) -> None:
    for junction in any_town.junctions:
        sides = {(conflict.lane, conflict.other): conflict for conflict in junction.conflicts}
        assert len(sides) == len(junction.conflicts)
        for (one, other), conflict in sides.items():
            assert sides[other, one].yields is not conflict.yields
            assert sides[other, one].merging is conflict.merging
            assert 0 <= conflict.begin < conflict.end <= any_town.lanes[one].length + 1e-6
            if conflict.merging:
                assert conflict.end == pytest.approx(any_town.lanes[one].length, abs=0.01)


def test_lanes_that_come_close_are_in_conflict_and_no_others(any_town: Town) -> None:
    for junction in any_town.junctions:
        known = {frozenset((conflict.lane, conflict.other)) for conflict in junction.conflicts}
        for one, other in combinations([any_town.lanes[number] for number in junction.lanes], 2):
            gap = np.linalg.norm(one.points[:, None] - other.points, axis=2).min()
            parting = bool(set(one.predecessors) & set(other.predecessors))
            assert (frozenset((one.index, other.index)) in known) == (gap < 0.35 * (one.width + other.width) and not parting)


def test_a_left_turn_yields_to_oncoming_traffic(any_town: Town) -> None:
    seen = 0
    slowed = {one for signal in any_town.signals if signal.kind in ("stop", "yield") for one in signal.governs}
    for junction in any_town.junctions:
        for conflict in junction.conflicts:
            one, other = any_town.lanes[conflict.lane], any_town.lanes[conflict.other]
            oncoming = np.cos(one.heading[0] - other.heading[0]) < -0.9
            if oncoming and (one.turn, other.turn) == ("left", "straight") and not slowed & {one.index, other.index}:
                assert conflict.yields
                seen += 1
    assert seen or any_town.name == "Town10HD"


def test_left_hand_traffic_is_right_hand_traffic_in_a_mirror(brickfield: Town) -> None:
    other = make_town(mirrored(brickfield.opendrive), Path("Mirrored.xodr"))
    number = {(lane.road_id, lane.section, -lane.lane_id): lane.index for lane in other.lanes}
    same = {lane.index: number[lane.road_id, lane.section, lane.lane_id] for lane in brickfield.lanes}
    for one in brickfield.lanes:
        seen = other.lanes[same[one.index]]
        assert seen.points == pytest.approx(one.points * (1, -1, 1), abs=1e-3)
        assert np.cos(seen.heading + one.heading) == pytest.approx(1)
        assert {same[lane] for lane in one.successors} == set(seen.successors)
        assert seen.left.tolist() == [same.get(lane, NO_LANE) for lane in one.right.tolist()]
        assert seen.right.tolist() == [same.get(lane, NO_LANE) for lane in one.left.tolist()]
        assert seen.turn == {"left": "right", "right": "left"}.get(one.turn, one.turn)
        assert seen.limits == pytest.approx(one.limits)
    places = [
        {(round(at.location.x, 2), round(side * at.location.y, 2)) for at in spawned.spawn_points}
        for side, spawned in ((1, brickfield), (-1, other))
    ]
    assert places[0] == places[1]
    for signal, seen in zip(brickfield.signals, other.signals, strict=True):
        assert dict(seen.stops) == pytest.approx({same[lane]: s for lane, s in signal.stops}, abs=1e-3)
        assert {same[lane] for lane in signal.governs} == set(seen.governs)
    for junction, seen in zip(brickfield.junctions, other.junctions, strict=True):
        yields = {(conflict.lane, conflict.other): conflict.yields for conflict in seen.conflicts}
        for conflict in junction.conflicts:
            one, rival = brickfield.lanes[conflict.lane], brickfield.lanes[conflict.other]
            if np.cos(one.heading[0] - rival.heading[0]) < -0.9:
                assert yields[same[one.index], same[rival.index]] == conflict.yields


def test_stop_signs_yield_and_without_any_the_right_goes_first(brickfield: Town) -> None:
    (stop,) = (signal for signal in brickfield.signals if signal.kind is SignalKind.STOP)
    junctions = {junction.id: junction for junction in brickfield.junctions}
    before_sign = [conflict for conflict in junctions[stop.junction or 0].conflicts if conflict.lane in stop.governs]
    assert before_sign
    assert all(conflict.yields or conflict.other in stop.governs for conflict in before_sign)
    seen = set()
    for conflict in junctions[208].conflicts:
        one, other = brickfield.lanes[conflict.lane], brickfield.lanes[conflict.other]
        if np.sin(other.heading[0] - one.heading[0]) < -0.9:  # it heads to the left, so it comes from the right
            seen.add(conflict.yields)
    assert seen == {True}


def test_priorities_of_the_file_decide(tmp_path: Path) -> None:
    text = (find_map(BUILT_IN) or Path()).read_text()
    junction = text.index('<junction id="208"')
    built_in = loaded(BUILT_IN)
    (conflicts,) = (junction.conflicts for junction in built_in.junctions if junction.id == 208)
    crossing = next(conflict for conflict in conflicts if not conflict.merging)
    one, other = (built_in.lanes[lane].road_id for lane in (crossing.lane, crossing.other))
    priority = f'<priority high="{other}" low="{one}"/><connection'
    reverse = f'<priority high="{one}" low="{other}"/><connection'
    for words, yields in ((priority, True), (reverse, False)):
        path = tmp_path / "ruled.xodr"
        path.write_text(text[:junction] + text[junction:].replace("<connection", words, 1))
        ruled = load_town(path)
        (conflict,) = (
            conflict
            for junction in ruled.junctions
            for conflict in junction.conflicts
            if (ruled.lanes[conflict.lane].road_id, ruled.lanes[conflict.other].road_id) == (one, other)
        )
        assert conflict.yields is yields


def test_lights_without_controllers_change_with_those_opposite(tmp_path: Path) -> None:
    text = (find_map(BUILT_IN) or Path()).read_text()
    path = tmp_path / "uncontrolled.xodr"
    path.write_text(text.replace("<control ", "<nothing "))
    phases = {junction.id: {frozenset(phase) for phase in junction.phases} for junction in load_town(path).junctions}
    assert phases == {
        junction.id: {frozenset(phase) for phase in junction.phases} for junction in loaded(BUILT_IN).junctions
    }


def test_a_light_that_names_no_lane_is_for_the_lanes_of_its_direction(tmp_path: Path) -> None:
    both = made_of(tmp_path, road(inside=sign("1000001", s=60, way="-")))
    (light,) = both.signals
    ((number, s),) = light.stops
    assert both.lanes[number].lane_id == 1
    assert s == pytest.approx(40, abs=0.5)
    assert light.junction is None


# --- walks and barriers --------------------------------------------------------------------------------


def test_walks_are_one_graph_with_crossings(any_town: Town) -> None:
    walks = any_town.walks
    assert walks.crossing.sum() >= 20
    assert len(any_town.crossings) >= 20
    assert len(any_town.sidewalks) >= 40
    apart = np.linalg.norm(walks.nodes[:, None] - walks.nodes, axis=2)[np.triu_indices(len(walks.nodes), 1)]
    assert apart.min() > 0.05  # sidewalks that meet share a node
    reached = np.zeros(len(walks.nodes), np.bool_)
    reached[0] = True
    for _ in range(len(walks.nodes)):
        before = reached.sum()
        reached[walks.edges[reached[walks.edges].any(axis=1)]] = True
        if reached.sum() == before:
            break
    assert reached.all()


def test_one_walks_on_roads_over_crossings_only(any_town: Town) -> None:
    start, stop = any_town.walks.nodes[any_town.walks.edges].transpose(1, 0, 2)
    gaps = gap_to_lanes(any_town, np.linspace(start, stop, 20).reshape(-1, 3)).reshape(20, -1).min(axis=0)
    assert (gaps[any_town.walks.crossing] < 0.5).all()
    width = max(one.width for one in any_town.lanes)
    assert (gaps[~any_town.walks.crossing] > width / 2 - 0.6).all()


def test_barriers_are_beyond_the_roads(any_town: Town) -> None:
    assert len(any_town.barriers) >= 40
    posts = [np.linspace(one, other, 100) for line in any_town.barriers for one, other in pairwise(line)]
    assert gap_to_lanes(any_town, np.concatenate(posts)).min() > 4.0


# --- the built-in town, and other files ----------------------------------------------------------------


def test_the_built_in_town_is_what_its_tool_writes(brickfield: Town) -> None:
    done = subprocess.run([sys.executable, ROOT / "tools" / "make-town"], capture_output=True, check=True, text=True)
    assert done.stdout == brickfield.opendrive
    assert len(done.stdout) < 200_000
    assert (brickfield.name, load_town(BUILT_IN).name) == (BUILT_IN, BUILT_IN)


def test_towns_are_found_by_name_or_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "Hamlet.xodr").write_text(opendrive(road()))
    assert load_town("Hamlet", tmp_path).name == "Hamlet"
    assert load_town(tmp_path / "Hamlet.xodr").name == "Hamlet"
    monkeypatch.setenv("CARLA_RECAP_MAPS", str(tmp_path))
    assert load_town("Carla/Maps/Hamlet").name == "Hamlet"
    with pytest.raises(RecapError, match=f"town 'Nowhere': expected {BUILT_IN}, an .xodr file, or a map"):
        load_town("Nowhere")
    with pytest.raises(RecapError, match="No such file"):
        load_town(tmp_path / "none.xodr")


def test_a_town_may_lack_all_but_a_lane(tmp_path: Path) -> None:
    bare = made_of(tmp_path, road(length=30, sections=section(0, right=lane(-1))))
    assert len(bare.lanes) == 1
    assert bare.on_road([15.0] * 3, [3.4, 3.6, 3.9], [0.0] * 3, 0.3).tolist() == [True, True, False]
    assert len(bare.spawn_points) == 2
    assert (bare.signals, bare.junctions, bare.sidewalks, bare.crossings) == ([], [], [], [])
    assert len(bare.walks.nodes) == len(bare.walks.edges) == 0


@pytest.mark.parametrize("content", ["", opendrive(road(sections=section(0, right=lane(-1, kind="sidewalk"))))])
def test_a_file_that_is_no_town_is_an_error_of_one_line(tmp_path: Path, content: str) -> None:
    path = tmp_path / "odd.xodr"
    path.write_text(content)
    with pytest.raises(RecapError, match=rf"^{path}: [^\n]*$"):
        load_town(path)


@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_town_is_loaded_or_refused(tmp_path: Path, seed: int) -> None:
    dice = random.Random(seed)
    content = bytearray((find_map(BUILT_IN) or Path()).read_bytes())
    for _ in range(dice.randrange(1, 4)):
        content[dice.randrange(400, len(content))] = dice.choice(b"0123456789.e-")
    path = tmp_path / "damaged.xodr"
    path.write_bytes(content)
    with time_limit(), suppress(RecapError):
        odd = load_town(path)
        assert np.isfinite(odd.index.points).all()
        assert np.isfinite(odd.walks.nodes).all()


@pytest.mark.parametrize("keeps_left", [False, True])
def test_spawn_points_head_as_the_waypoints_of_carlas_client(brickfield: Town, *, keeps_left: bool) -> None:
    carla = pytest.importorskip("carla", reason="the extra carla is not installed")
    text = mirrored(brickfield.opendrive) if keeps_left else brickfield.opendrive
    made, client = make_town(text, Path("Town.xodr")), carla.Map("", text)
    for at in made.spawn_points[::7]:
        pose = client.get_waypoint(carla.Location(at.location.x, at.location.y, at.location.z - 0.3)).transform
        aside = pose.get_right_vector()
        assert abs((at.location.x - pose.location.x) * aside.x + (at.location.y - pose.location.y) * aside.y) < 0.05
        assert np.cos(np.radians(at.rotation.yaw - pose.rotation.yaw)) > np.cos(np.radians(0.5))
    entered = sorted(made.lanes, key=lambda lane: (lane.road_id, lane.reverse, lane.lane_id))
    for at, entry in zip(made.standalone().spawn_points, entered, strict=True):
        assert (at.location.x, at.location.y) == pytest.approx(entry.points[0, :2].tolist())


def test_a_map_that_a_client_sends_has_a_spawn_point_at_each_entry_of_a_road(tmp_path: Path) -> None:
    town = load_town(two_levels(tmp_path)).standalone()
    places = [(point.location.x, point.location.y, point.location.z) for point in town.spawn_points]
    right = [(-60, 1.75, 3), (60, 1.75, 3), (-1.75, -60, 9), (-1.75, 60, 9)]
    left = [(60, -1.75, 3), (1.75, -60, 9), (1.75, 60, 9), (-60, -1.75, 3)]
    expected = [place for pair in zip(right, left, strict=True) for place in pair]
    assert np.array(places) == pytest.approx(np.array(expected), abs=0.01)
    assert [round(point.rotation.yaw) for point in town.spawn_points] == [0, 180, 0, -90, 90, -90, 90, 180]


def test_a_bridge_has_barriers_over_the_road_below_it(tmp_path: Path) -> None:
    lines = load_town(two_levels(tmp_path)).barriers
    across = [(line[start], line[start + 1]) for line in lines for start in range(len(line) - 1)]
    beside = {(round(a[0], 1), round(a[2])) for a, b in across if a[1] * b[1] < 0 and abs(a[0] - b[0]) < 0.1}
    assert beside == {(-6.2, 6), (6.2, 6)}
