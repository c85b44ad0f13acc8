from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from carla_recap import convert, open_recording
from carla_recap.errors import RecapError
from carla_recap.formats import create_writer
from carla_recap.formats.base import Reader
from carla_recap.model.frame import LAST_FRAME_DURATION, Frame, Header, Packet
from carla_recap.model.records import FRAME_END, UE4, Spawn, attributes
from carla_recap.queries.differences import Differences, differences
from tests.samples import SAMPLES, carla_log, reading

CRASH, JUNCTION = SAMPLES / "crash.mcap", SAMPLES / "junction.mcap"
HEADER = Header("Town01", 1_600_000_000)
RATE = 20.0

HERO = Spawn(10, 1, 100.0, 200.0, type_id="vehicle.a", attributes=attributes(role_name="hero"))
CAR = Spawn(11, 1, 500.0, 0.0, type_id="vehicle.b")
WALKER = Spawn(12, 2, -300.0, 0.0, type_id="walker.c")
LIGHT = Spawn(13, 3, 900.0, 900.0, type_id="traffic.traffic_light")
CAST = (HERO, CAR, WALKER, LIGHT)

Poses = dict[int, tuple[float, ...]]


def forward(time: float) -> Poses:
    """Poses of a drive along x at 10 m/s; the walker stands."""
    return {10: (100 + 1000 * time, 200.0), 11: (500 + 1000 * time, 0.0), 12: (-300.0, 0.0)}


@pytest.fixture
def drive(tmp_path: Path, opened: Callable[[Path], Reader]) -> Callable[..., Reader]:
    """Writes a drive of two seconds, and opens it."""

    def make(
        poses: Callable[[float], Poses] = forward,
        *,
        spawns: Sequence[Spawn] = CAST,
        ids: Callable[[int], int] = lambda id: id,
        events: dict[int, dict[str, Any]] | None = None,
        light: Callable[[float], int] = lambda time: 2 if time < 1 else 0,
        rate: float = RATE,
        seconds: float = 2.0,
        header: Header = HEADER,
        suffix: str = ".mcap",
        clock: Callable[[int], float] | None = None,
    ) -> Reader:
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}{suffix}"
        count = round(seconds * rate) + 1
        with create_writer(path, header) as writer:
            for n in range(count):
                time = clock(n) if clock else n / rate
                records: dict[str, Any] = {}
                if n == 0:
                    records["spawned"] = [replace(spawn, id=ids(spawn.id)) for spawn in spawns]
                present = {spawn.id for spawn in spawns}
                rows = [
                    (ids(id), *pose[:2], *((0.0,) * 3), *(pose[2:] or (0.0,)))
                    for id, pose in poses(time).items()
                    if id in present
                ]
                records["transforms"] = [(id, x, y, z, roll, pitch, yaw) for id, x, y, z, roll, pitch, yaw in rows]
                if LIGHT in spawns:
                    records["light_states"] = [(ids(13), 0, 0.0, light(time))]
                records |= (events or {}).get(n, {})
                last = n == count - 1
                writer.write(frame(n, time, LAST_FRAME_DURATION if last else 1 / rate, records))
        return opened(path)

    return make


def frame(n: int, time: float, duration: float, records: dict[str, Any]) -> Frame:
    order = ("spawned", "destroyed", "parented", "collisions", "transforms", "light_states")
    types = [UE4.named(name) for name in order if name in records]
    packets = [Packet(type.id, type, records=type.records(records[type.name])) for type in types]
    return Frame(n, n + 1, time, duration, [*packets, Packet(FRAME_END, UE4[FRAME_END], b"")])


def row_of(found: Differences, id: int) -> Any:
    return next(row for row in found.actors if row.id_a == id)


# --- equal recordings -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sample", [CRASH, JUNCTION, SAMPLES / "crossing.log"])
def test_a_recording_equals_its_conversion(sample: Path, tmp_path: Path) -> None:
    other = tmp_path / ("other.log" if sample.suffix == ".mcap" else "other.mcap")
    convert(sample, other)
    for pair in ((sample, other), (other, sample)):
        with open_recording(pair[0]) as first, open_recording(pair[1]) as second:
            assert first.diff(second).summary == "equal within 0 m"


@pytest.mark.parametrize("name", ["carla-0.9.10-lane-center.log", "carla-0.9.13-lane-center.log", "blocked.log"])
def test_recordings_of_carla_equal_themselves(name: str) -> None:
    with reading(carla_log(name)) as first, reading(carla_log(name)) as second:
        assert differences(first, second).summary == "equal within 0 m"


def test_a_spectator_does_not_count(drive: Callable[..., Reader]) -> None:
    spawns = (*CAST, Spawn(14, 0, type_id="spectator"))
    a = drive(lambda time: forward(time) | {14: (0.0, 0.0)}, spawns=spawns)
    b = drive(lambda time: forward(time) | {14: (100.0, 0.0)}, spawns=spawns)
    assert differences(a, b).equal
    assert differences(a, drive()).equal
    hit = drive(spawns=spawns, events={20: {"collisions": [(0, 14, 12, 0, 0)]}})
    assert differences(hit, hit).equal


# --- paths ------------------------------------------------------------------------------------------------------------


def aside(start: float, y: float) -> Callable[[float], Poses]:
    """The drive, with the hero y cm aside from a time on."""

    def poses(time: float) -> Poses:
        found = forward(time)
        if time >= start:
            found[10] = (found[10][0], found[10][1] + y)
        return found

    return poses


def test_paths_that_part(drive: Callable[..., Reader]) -> None:
    found = differences(drive(), drive(aside(1.0, 50)))
    row = row_of(found, 10)
    assert found.actors[0] is row
    assert (row.first, row.first_distance) == (1.0, 0.5)
    assert (row.max, row.max_at, row.final) == (0.5, 1.0, 0.5)
    assert row.frames == 41
    assert row.mean == pytest.approx(0.5 * 21 / 41)
    assert row.rms == pytest.approx(0.5 * math.sqrt(21 / 41))
    assert row.heading == 0
    assert row.differs
    assert [other.differs for other in found.actors] == [True, False, False, False]
    assert found.summary.startswith("the paths differ from 1.00 s on: vehicle.a (hero, 10) by 0.50 m; 1 of 4 actors differs")


def test_the_hero_leads(drive: Callable[..., Reader]) -> None:
    def poses(time: float) -> Poses:
        return aside(1.0, 50)(time) | ({12: (-300.0, 700.0)} if time >= 0.5 else {})

    found = differences(drive(), drive(poses))
    assert found.first is row_of(found, 10)
    assert found.reasons[:2] == [
        "the paths differ from 1.00 s on: vehicle.a (hero, 10) by 0.50 m",
        "1 other actor before, from 0.50 s on",
    ]


def test_vehicles_lead_if_the_hero_does_not_part(drive: Callable[..., Reader]) -> None:
    def poses(time: float) -> Poses:
        found = forward(time) | {12: (-300.0, 1.0)}
        return found | ({11: (500.0, 0.0)} if time >= 1.5 else {})

    found = differences(drive(), drive(poses))
    assert found.first is row_of(found, 11)


def test_poses_that_are_no_numbers(drive: Callable[..., Reader]) -> None:
    broken = lambda time: forward(time) | ({12: (math.nan, math.inf)} if time >= 1.0 else {})  # noqa: E731
    assert differences(drive(broken), drive(broken)).equal
    found = differences(drive(), drive(broken), tolerance=5.0)
    row = row_of(found, 12)
    assert (row.first, row.max, row.mean, row.final) == (1.0, math.inf, 0.0, math.inf)
    assert "by an unknown distance" in found.summary


def test_frames_at_one_time(drive: Callable[..., Reader]) -> None:
    still = drive(lambda time: forward(0.0), clock=lambda n: 0.0, seconds=50.0)
    assert differences(still, still).equal
    backward = drive(clock=lambda n: n % 7 / RATE)
    assert differences(backward, backward).equal
    strange = drive(lambda time: forward(0.0), clock=lambda n: (math.nan, 0.1, math.inf, -math.inf)[n % 4])
    assert differences(strange, strange).equal
    differences(strange, drive())
    differences(drive(), strange)


# --- actors ------------------------------------------------------------------------------------------------------------


def test_other_ids(drive: Callable[..., Reader]) -> None:
    found = differences(drive(), drive(ids=lambda id: id + 100))
    assert found.equal
    assert {(row.id_a, row.id_b, row.matched_by) for row in found.actors} == {
        (10, 110, "role"),
        (11, 111, "birth"),
        (12, 112, "birth"),
        (13, 113, "position"),
    }


def test_a_missing_and_an_extra_actor(drive: Callable[..., Reader]) -> None:
    found = differences(drive(), drive(spawns=(HERO, WALKER, LIGHT, Spawn(15, 1, type_id="vehicle.new"))))
    assert [actor.id for actor in found.missing] == [11]
    assert [actor.id for actor in found.extra] == [15]
    assert not found.equal
    assert found.summary == "1 actor only in A; 1 actor only in B"


@pytest.mark.parametrize(("metres", "pairs"), [(9.0, [(12, 112)]), (11.0, [])])
def test_actors_are_matched_by_order_only_near_each_other(
    drive: Callable[..., Reader], metres: float, pairs: list[tuple[int, int]]
) -> None:
    elsewhere = drive(spawns=(replace(WALKER, x=WALKER.x + 100 * metres),), ids=lambda id: id + 100)
    found = differences(drive(spawns=(WALKER,)), elsewhere)
    assert [(row.id_a, row.id_b) for row in found.actors if row.matched_by == "order"] == pairs
    assert (len(found.missing), len(found.extra)) == (1 - len(pairs),) * 2


def test_a_match_by_order_passes_over_those_far_away(drive: Callable[..., Reader]) -> None:
    far, near = replace(WALKER, id=20, x=WALKER.x + 5000), replace(WALKER, id=21, x=WALKER.x + 200)
    found = differences(drive(spawns=(WALKER,)), drive(spawns=(far, near)))
    assert [(row.id_a, row.id_b, row.matched_by) for row in found.actors] == [(12, 21, "order")]
    assert [actor.id for actor in found.extra] == [20]


def test_a_sensor_in_one_recording_does_not_count(drive: Callable[..., Reader]) -> None:
    found = differences(drive(), drive(spawns=(*CAST, Spawn(15, 5, type_id="sensor.camera.rgb"))))
    assert [actor.id for actor in found.extra] == [15]
    assert found.equal


def test_another_blueprint_of_the_hero(drive: Callable[..., Reader]) -> None:
    found = differences(drive(), drive(spawns=(replace(HERO, type_id="vehicle.other"), CAR, WALKER, LIGHT)))
    row = row_of(found, 10)
    assert (row.type_id_a, row.type_id_b, row.differs) == ("vehicle.a", "vehicle.other", True)
    assert not found.equal


def test_actors_whose_spawn_is_unknown_are_matched_by_id(drive: Callable[..., Reader]) -> None:
    everyone = lambda time: forward(time) | {77: (0.0, 5.0)}  # noqa: E731

    def unknown(poses: Callable[[float], Poses], pose: Sequence[float]) -> Reader:
        rows = {n: {"transforms": [(77, *pose, 0, 0, 0, 0), (12, -300, 0, 0, 0, 0, 0)]} for n in range(41)}
        return drive(poses, events=rows)

    a, b = unknown(everyone, (0.0, 5.0)), unknown(everyone, (0.0, 105.0))
    assert differences(a, a).equal
    found = differences(a, b)
    assert (row_of(found, 77).matched_by, row_of(found, 77).max) == ("id", 1.0)
    found = differences(a, drive())
    assert [actor.id for actor in found.missing] == [77]


# --- lights, events, clocks, maps ----------------------------------------------------------------------------------------


def test_lights_with_other_phases(drive: Callable[..., Reader]) -> None:
    found = differences(drive(), drive(light=lambda time: 2 if time < 1.5 else 0))
    (row,) = found.lights
    assert (row.first, row.differs) == (1.0, True)
    assert row.seconds == pytest.approx(0.5)
    assert found.summary == "1 of 1 traffic light differs, first at 1.00 s"
    assert differences(drive(), drive(light=lambda time: 2 if time < 1.5 else 0), tolerance=0.1).equal


def test_a_collision_in_one_recording(drive: Callable[..., Reader]) -> None:
    hit = {20: {"collisions": [(0, 10, 12, 1, 0)]}}
    found = differences(drive(), drive(events=hit))
    (row,) = found.events
    assert (row.kind, row.start_a, row.start_b, row.actors_b) == ("collision", None, 1.0, (10, 12))
    assert found.summary == "1 event differs, first only in B, at 1.00 s: hero collides with walker.c (12)"
    assert differences(drive(), drive(events=hit), events=False).equal
    assert differences(drive(events=hit), drive(events=hit, ids=lambda id: id)).equal


def test_a_collision_at_another_time(drive: Callable[..., Reader]) -> None:
    a, b = (drive(events={n: {"collisions": [(0, 10, 12, 1, 0)]}}) for n in (20, 26))
    (row,) = differences(a, b).events
    assert (row.start_a, row.start_b) == (1.0, 1.3)
    assert differences(a, b, tolerance=0.1).equal
    assert not differences(a, b, tolerance=0.1, time_tolerance=0.2).equal


@pytest.mark.parametrize(("frames", "rows"), [((10, 30), 1), ((30, 10), 1), ((9, 30), 2), ((30, 9), 2)])
def test_events_are_the_same_up_to_a_second_apart(drive: Callable[..., Reader], frames: tuple[int, int], rows: int) -> None:
    a, b = (drive(events={n: {"collisions": [(0, 10, 12, 1, 0)]}}) for n in frames)
    assert len(differences(a, b).events) == rows
    assert len(differences(a, b, time_tolerance=2.0).events) == 0


def test_an_event_is_the_same_as_the_nearest_one(drive: Callable[..., Reader]) -> None:
    hit = {"collisions": [(0, 10, 12, 1, 0)]}
    both, one = drive(seconds=8, events={20: hit, 130: hit}), drive(seconds=8, events={130: hit})
    for a, b, starts in ((both, one, (1.0, None)), (one, both, (None, 1.0))):
        (row,) = differences(a, b, time_tolerance=10.0).events
        assert (row.start_a, row.start_b) == starts


def test_a_recording_that_ends_earlier(drive: Callable[..., Reader]) -> None:
    found = differences(drive(), drive(seconds=0.5), tolerance=1.0)
    assert found.summary == "41 frames in 2.00 s, and 11 in 0.50 s"
    assert row_of(found, 10).frames == 11
    assert found.clock == 0.55
    assert differences(drive(), drive(seconds=1.5), tolerance=1.0).equal


def test_other_maps_are_said(drive: Callable[..., Reader]) -> None:
    found = differences(drive(), drive(header=Header("Town02", 0)), tolerance=1.0)
    assert found.summary == "the maps are Town01 and Town02"
    for name in ("Carla/Maps/Town01", "Town01_Opt"):
        assert differences(drive(), drive(header=Header(name, 0))).equal


def test_recordings_without_frames(drive: Callable[..., Reader], tmp_path: Path, opened: Callable[[Path], Reader]) -> None:
    for name in ("empty.log", "empty.mcap"):
        with create_writer(tmp_path / name, HEADER):
            pass
    a, b = opened(tmp_path / "empty.log"), opened(tmp_path / "empty.mcap")
    assert differences(a, b).equal
    found = differences(a, drive())
    assert len(found.extra) == 4
    assert not differences(drive(), a).equal
    assert math.isnan(found.a.step)


@pytest.mark.parametrize("options", [{"tolerance": -1.0}, {"tolerance": math.nan}, {"time_tolerance": -0.5}])
def test_invalid_tolerances(drive: Callable[..., Reader], options: dict[str, float]) -> None:
    recording = drive()
    with pytest.raises(RecapError, match="must be 0 or more"):
        differences(recording, recording, **options)


def numbered(count: int, rows: Callable[[int], Sequence[tuple[float, ...]]], spawns: Sequence[Spawn]) -> Iterator[Frame]:
    for n in range(count):
        yield frame(n, n / RATE, 1 / RATE, {"transforms": rows(n), **({"spawned": spawns} if n == 0 else {})})


def test_other_actors_in_every_frame(tmp_path: Path, opened: Callable[[Path], Reader]) -> None:
    path = tmp_path / "restless.log"
    with create_writer(path, HEADER) as writer:
        for each in numbered(100, lambda n: [(50 * n + k, 1.0, 0, 0, 0, 0, 0) for k in range(50)], []):
            writer.write(each)
    found = differences(opened(path), opened(path))
    assert found.equal
    assert len(found.actors) == 5_000
