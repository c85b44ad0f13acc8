"""What differs of two recordings: in words and rows, and as a loop over frames and actors finds it."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap import convert, open_recording
from carla_recap.errors import RecapError
from carla_recap.formats.base import Reader
from carla_recap.model.frame import Header
from carla_recap.model.lives import ActorLife
from carla_recap.model.records import Spawn, attributes
from carla_recap.queries.differences import Differences, differences
from carla_recap.queries.matching import match
from tests.replay.scripts import build, light, pose
from tests.samples import SAMPLES, reading
from tests.twins import differences as twin

Drive = Callable[..., Reader]
Poses = dict[int, tuple[float, ...]]

RATE = 20.0
HERO = Spawn(10, 1, 100.0, 200.0, type_id="vehicle.a", attributes=attributes(role_name="hero"))
CAR = Spawn(11, 1, 500.0, 0.0, type_id="vehicle.b")
WALKER = Spawn(12, 2, -300.0, 0.0, type_id="walker.c")
LIGHT = Spawn(13, 3, 900.0, 900.0, type_id="traffic.traffic_light")
CAST = (HERO, CAR, WALKER, LIGHT)
HIT = {"collisions": [(0, 10, 12, 1, 0)]}


def forward(time: float) -> Poses:
    """Poses of a drive along x at 10 m/s; the walker stands."""
    return {10: (100 + 1000 * time, 200.0), 11: (500 + 1000 * time, 0.0), 12: (-300.0, 0.0)}


@pytest.fixture
def drive(tmp_path: Path, opened: Callable[[Path], Reader]) -> Drive:
    """Writes a drive of two seconds, and opens it."""

    def make(
        poses: Callable[[float], Poses] = forward,
        *,
        spawns: Sequence[Spawn] = CAST,
        events: dict[int, dict[str, Any]] | None = None,
        green: float = 1.0,
        shift: int = 0,
        seconds: float = 2.0,
        map_name: str = "Town01",
        clock: Callable[[int], float] = lambda n: n / RATE,
    ) -> Reader:
        times = [clock(n) for n in range(round(seconds * RATE) + 1)]
        present = {spawn.id for spawn in spawns}
        frames: list[dict[str, Any]] = []
        for time in times:
            rows = [pose(id + shift, *place) for id, place in poses(time).items() if id in present]
            lights = [light(13 + shift, 2 if time < green else 0)] if LIGHT in spawns else []
            frames.append({"transforms": rows, "light_states": lights})
        frames[0] = {"spawned": [replace(spawn, id=spawn.id + shift) for spawn in spawns], **frames[0]}
        frames = [frame | (events or {}).get(n, {}) for n, frame in enumerate(frames)]
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.mcap"
        return opened(build(path, Header(map_name, 0), frames, times=times))

    return make


def row_of(found: Differences, id: int) -> Any:
    return next(row for row in found.actors if row.id_a == id)


@pytest.mark.parametrize("name", ["crash.mcap", "junction.mcap", "crossing.log", "town01-carla-0.9.13.log"])
def test_a_recording_equals_its_conversion(name: str, tmp_path: Path) -> None:
    other = tmp_path / ("other.log" if name.endswith(".mcap") else "other.mcap")
    convert(SAMPLES / name, other)
    with open_recording(SAMPLES / name) as first, open_recording(other) as second:
        assert first.diff(second).summary == second.diff(first).summary == "equal within 0 m"


def test_a_spectator_does_not_count(drive: Drive) -> None:
    spawns = (*CAST, Spawn(14, 0, type_id="spectator"))
    a, b = (drive(lambda time, x=x: forward(time) | {14: (x, 0.0)}, spawns=spawns) for x in (0.0, 100.0))
    assert differences(a, b).equal
    assert differences(a, drive()).equal
    hit = drive(spawns=spawns, events={20: {"collisions": [(0, 14, 12, 0, 0)]}})
    assert differences(hit, hit).equal


# --- paths ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("moved", "first", "said"),
    [
        (
            {10: (1.0, 100 + 1000, 250.0), 12: (0.5, -300.0, 700.0)},
            10,
            ["the paths differ from 1.00 s on: vehicle.a (hero, 10) by 0.50 m", "1 other actor before, from 0.50 s on"],
        ),
        (
            {11: (1.5, 500.0, 0.0), 12: (0.0, -300.0, 1.0)},
            11,
            ["the paths differ from 1.50 s on: vehicle.b (11) by 15.00 m", "1 other actor before, from 0.00 s on"],
        ),
        ({12: (1.0, math.nan, math.inf)}, 12, ["the paths differ from 1.00 s on: walker.c (12) by an unknown distance"]),
    ],
    ids=["the hero", "vehicles before others", "no numbers"],
)
def test_who_leads_the_text(drive: Drive, moved: dict[int, tuple[float, float, float]], first: int, said: list[str]) -> None:
    """Actors jump to a place at a time, and stay there."""

    def poses(time: float) -> Poses:
        return forward(time) | {id: tuple(place) for id, (since, *place) in moved.items() if time >= since}

    found = differences(drive(), drive(poses))
    assert found.first is row_of(found, first)
    assert found.reasons[: len(said)] == said


def test_frames_at_one_time(drive: Drive) -> None:
    still = drive(lambda time: forward(0.0), clock=lambda n: 0.0)
    backward = drive(clock=lambda n: n % 7 / RATE)
    strange = drive(lambda time: forward(0.0), clock=lambda n: (math.nan, 0.1, math.inf, -math.inf)[n % 4])
    for each in (still, backward, strange):
        assert differences(each, each).equal
        assert not differences(each, drive()).equal


# --- actors ------------------------------------------------------------------------------------------------------------


def test_other_ids(drive: Drive) -> None:
    found = differences(drive(), drive(shift=100))
    assert found.equal
    assert {(row.id_a, row.id_b, row.matched_by) for row in found.actors} == {
        (10, 110, "role"),
        (11, 111, "birth"),
        (12, 112, "birth"),
        (13, 113, "position"),
    }


@pytest.mark.parametrize(("metres", "matched"), [((9.0,), [20]), ((11.0,), []), ((50.0, 2.0), [21])])
def test_actors_are_matched_by_order_only_near_each_other(
    drive: Drive, metres: tuple[float, ...], matched: list[int]
) -> None:
    others = [replace(WALKER, id=20 + n, x=WALKER.x + 100 * far) for n, far in enumerate(metres)]
    found = differences(drive(spawns=(WALKER,)), drive(spawns=others))
    assert [(row.id_a, row.id_b, row.matched_by) for row in found.actors] == [(12, id, "order") for id in matched]
    assert [len(found.missing), len(found.extra)] == [1 - len(matched), len(metres) - len(matched)]


def test_a_sensor_in_one_recording_does_not_count(drive: Drive) -> None:
    found = differences(drive(), drive(spawns=(*CAST, Spawn(15, 5, type_id="sensor.camera.rgb"))))
    assert [actor.id for actor in found.extra] == [15]
    assert found.equal


def test_another_blueprint_of_the_hero(drive: Drive) -> None:
    found = differences(drive(), drive(spawns=(replace(HERO, type_id="vehicle.other"), CAR, WALKER, LIGHT)))
    row = row_of(found, 10)
    assert (row.type_id_a, row.type_id_b, row.differs) == ("vehicle.a", "vehicle.other", True)
    assert not found.equal


def test_actors_whose_spawn_is_unknown_are_matched_by_id(drive: Drive) -> None:
    a, b = (drive(events={n: {"transforms": [pose(77, 0, y), pose(12, -300)]} for n in range(41)}) for y in (5.0, 105.0))
    assert differences(a, a).equal
    row = row_of(differences(a, b), 77)
    assert (row.matched_by, row.max) == ("id", 1.0)
    assert [actor.id for actor in differences(a, drive()).missing] == [77]


# --- lights, events, maps ------------------------------------------------------------------------------------------------


def test_lights_with_other_phases(drive: Drive) -> None:
    other = drive(green=1.05)
    assert differences(drive(), other).summary == "1 of 1 traffic light differs, first at 1.00 s"
    assert differences(drive(), other, tolerance=0.1).equal


def test_a_collision_in_one_recording(drive: Drive) -> None:
    hit = drive(events={20: HIT})
    found = differences(drive(), hit)
    (row,) = found.events
    assert (row.kind, row.start_a, row.start_b, row.actors_b) == ("collision", None, 1.0, (10, 12))
    assert found.summary == "1 event differs, first only in B, at 1.00 s: hero collides with walker.c (12)"
    assert differences(drive(), hit, events=False).equal
    assert differences(hit, drive(events={20: HIT})).equal


@pytest.mark.parametrize(
    ("a", "b", "given", "rows"),
    [
        ([10], [30], {}, [(0.5, 1.5)]),
        ([30], [10], {}, [(1.5, 0.5)]),
        ([9], [30], {}, [(0.45, None), (None, 1.5)]),
        ([30], [9], {}, [(None, 0.45), (1.5, None)]),
        ([9], [30], {"time_tolerance": 2.0}, []),
        ([20], [26], {"tolerance": 0.1}, []),  # times may differ by 1 s then
        ([20], [26], {"tolerance": 0.1, "time_tolerance": 0.2}, [(1.0, 1.3)]),
        ([20, 130], [130], {"time_tolerance": 10.0}, [(1.0, None)]),  # the nearest one is the same
        ([130], [20, 130], {"time_tolerance": 10.0}, [(None, 1.0)]),
    ],
)
def test_events_are_the_same_up_to_a_second_apart(drive: Drive, a: Any, b: Any, given: dict[str, float], rows: Any) -> None:
    first, second = (drive(seconds=8, events=dict.fromkeys(frames, HIT)) for frames in (a, b))
    assert [(row.start_a, row.start_b) for row in differences(first, second, **given).events] == rows


def test_other_maps_are_said(drive: Drive) -> None:
    found = differences(drive(), drive(map_name="Town02"), tolerance=1.0)
    assert found.summary == "the maps are Town01 and Town02"
    for name in ("Carla/Maps/Town01", "Town01_Opt"):
        assert differences(drive(), drive(map_name=name)).equal


def test_recordings_without_frames(drive: Drive, tmp_path: Path, opened: Callable[[Path], Reader]) -> None:
    a, b = (opened(build(tmp_path / name, Header("Town01", 0), [])) for name in ("empty.log", "empty.mcap"))
    assert differences(a, b).equal
    assert len(differences(a, drive()).extra) == 4
    assert not differences(drive(), a).equal


@pytest.mark.parametrize("options", [{"tolerance": -1.0}, {"tolerance": math.nan}, {"time_tolerance": -0.5}])
def test_invalid_tolerances(drive: Drive, options: dict[str, float]) -> None:
    recording = drive()
    with pytest.raises(RecapError, match=f"{next(iter(options)).replace('_', ' ')} of .* cannot be"):
        differences(recording, recording, **options)


TYPES = ("spawned", "destroyed", "transforms", "light_states")
ACTORS, LIVES = 3, 2
LAMP = ACTORS

times = st.one_of(
    st.builds(
        lambda rate, count, start: [start + n / rate for n in range(count)],
        st.sampled_from([0.3, 1.0, 5.0, 10.0, 20.0, 100.0]) | st.floats(0.2, 200),
        st.integers(1, 12),
        st.just(0.0) | st.floats(-3, 3),
    ),
    st.lists(st.sampled_from([0, 1, 2, 3, 3.0000004, 4, 5, 5.0000015]) | st.floats(0, 8), min_size=1, max_size=12).map(
        sorted
    ),
)
numbers = st.sampled_from([0.0, 1.0, 100.0, 501.0, 10_000.0, math.nan, math.inf, -3e38]) | st.floats(-1000, 1000, width=32)
poses = st.tuples(numbers, numbers, st.just(0.0), st.floats(-720, 720, width=32) | numbers)
tolerances = st.sampled_from([0.0, 1e-6, 0.5, 1.0, 5.0, math.inf]) | st.floats(0, 1e4)


@st.composite
def drives(draw: Any, pose: Callable[[int, float], tuple[float, ...]]) -> list[tuple[float, dict[str, Any]]]:
    """Frames of three actors, which come and go, each with two lives, and of a traffic light."""
    clock = draw(times)
    frames: list[tuple[float, dict[str, Any]]] = []
    cuts = [sorted(draw(st.tuples(*[st.integers(0, len(clock))] * 4))) for _ in range(ACTORS)]
    aside = draw(st.sampled_from([0.0, 0.0, 30.0, 600.0]))
    change = draw(st.integers(0, len(clock)))
    for n, time in enumerate(clock):
        records: dict[str, list[Any]] = {name: [] for name in TYPES}
        if n == 0:
            records["spawned"].append(born(LAMP, 0))
        for id, (start, stop, again, end) in enumerate(cuts):
            for life, (first, last) in enumerate(((start, stop), (again, end))):
                records["spawned"] += [born(id, life)] * (n == first)
                records["destroyed"] += [id] * (n == last and first < last)
                if first <= n < last and draw(st.integers(0, 5)):
                    x, y, z, yaw = draw(poses) if not draw(st.integers(0, 7)) else pose(id, time)
                    records["transforms"].append((id, x + aside * (n % 2), y, z, 0.0, 0.0, yaw))
        if draw(st.integers(0, 5)):
            records["light_states"].append((LAMP, 0, 0.0, 2 if n < change else draw(st.integers(0, 2))))
        frames.append((time, records))
    return frames


def born(id: int, life: int) -> Spawn:
    kind, type_id = (3, "traffic.traffic_light") if id == LAMP else (1, f"vehicle.{id}.{life}")
    return Spawn(id, kind, type_id=type_id, attributes=attributes(role_name=f"{id}.{life}"))


def along(id: int, time: float) -> tuple[float, ...]:
    return 1000.0 * time + id, 100.0 * id, 0.0, 30.0 * time - 170.0


@given(drives(along), drives(along), tolerances, st.none() | tolerances, st.sampled_from([".log", ".mcap"]))
def test_differences_are_those_of_a_loop(
    a: Any, b: Any, tolerance: float, time_tolerance: float | None, suffix: str
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        first, second = (
            build(
                Path(folder) / name, Header("Town01", 0), [records for _, records in side], times=[time for time, _ in side]
            )
            for name, side in ((f"a{suffix}", a), ("b.log", b))
        )
        with reading(first) as reader_a, reading(second) as reader_b:
            found = differences(reader_a, reader_b, tolerance=tolerance, time_tolerance=time_tolerance, events=False)
            ours, theirs = twin.Drive(reader_a), twin.Drive(reader_b)
    if time_tolerance is None:
        time_tolerance = 1.0 if tolerance else 0.0
    assert {row.role_name for row in found.actors} == ours.lives.keys() & theirs.lives.keys()
    assert {life.role_name for life in found.missing} == ours.lives.keys() - theirs.lives.keys()
    assert {life.role_name for life in found.extra} == theirs.lives.keys() - ours.lives.keys()
    for row in found.actors:
        expected = twin.paths(row.role_name, ours, theirs, tolerance)
        measured = {name: getattr(row, name) for name in expected}
        if not any(math.isclose(distance, tolerance) for distance in (row.max, row.first_distance or math.nan)):
            assert row.differs == twin.actor_differs(row.role_name, ours, theirs, tolerance, time_tolerance)
        assert known(measured) == pytest.approx(known(expected), rel=1e-6, abs=1e-6, nan_ok=True)
    for row in found.lights:
        expected = twin.light(f"{LAMP}.0", ours, theirs)
        assert known({name: getattr(row, name) for name in expected}) == pytest.approx(known(expected))
        assert row.differs == (row.first is not None and (row.seconds > time_tolerance or time_tolerance == 0))


def known(values: dict[str, float | None]) -> list[float]:
    return [-1.0 if value is None else value for value in values.values()]


spawns = st.tuples(st.integers(0, 3), st.sampled_from([0.0, 0.2, 0.4, 0.5, 0.6, 5.0]), st.sampled_from([0.0, 0.3, 1.0, 1.5]))


@given(st.lists(spawns, max_size=30), st.lists(spawns, max_size=30))
def test_the_nearest_spawns_are_matched_as_by_all_pairs(a: Any, b: Any) -> None:
    ours, theirs = (
        [ActorLife(id, "walker.a", "walker", "", time, time, spawn=Spawn(id, 2, 100 * x)) for id, x, time in side]
        for side in (a, b)
    )
    pairs = sorted(
        (math.dist(p.place, q.place), abs(p.spawned_at - q.spawned_at), p.id != q.id, m, n)
        for m, p in enumerate(ours)
        for n, q in enumerate(theirs)
        if math.dist(p.place, q.place) <= 0.5 and abs(p.spawned_at - q.spawned_at) <= 1
    )
    left = set(range(len(ours))), set(range(len(theirs)))
    expected = []
    for *_, m, n in pairs:
        if m in left[0] and n in left[1]:
            left[0].remove(m)
            left[1].remove(n)
            expected.append((m, n))
    assert sorted((p, q) for p, q, by in match(ours, theirs) if by == "birth") == sorted(expected)
