"""Speeds at collisions, and answers of `collisions` and `incidents` from the digest of an MCAP file and without it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carla_recap.editing.convert import convert
from carla_recap.errors import RecapError
from carla_recap.formats.base import PartName, Reader
from carla_recap.formats.mcap.reader import McapReader
from carla_recap.model.frame import Frame, Header
from carla_recap.model.records import NO_ACTOR, Spawn
from carla_recap.queries import contacts as contacts_module
from carla_recap.queries.collisions import collisions
from carla_recap.queries.incidents import IncidentOptions, incidents
from tests import strategies
from tests.queries.conftest import Make, write
from tests.samples import CARLA_LOGS, RANDOM_LOGS, reading, warnings_ignored
from tests.samples import write as write_frames

CAST = [Spawn(1, 1, type_id="vehicle.a"), Spawn(2, 2, type_id="walker.b"), Spawn(3, 3, type_id="traffic.traffic_light")]
HIT = {"collisions": [(0, 1, 2, 0, 0)]}


def poses(*places: tuple[int, float, float, float]) -> list[tuple[float, ...]]:
    return [(id, x, y, z, 0.0, 0.0, 0.0) for id, x, y, z in places]


def moving(*speeds: tuple[int, float, float, float]) -> list[tuple[float, ...]]:
    return poses(*speeds)


def speeds(reader: Reader) -> list[tuple[float, float]]:
    return [(row.impact_speed, row.relative_speed) for row in collisions(reader)]


# --- definitions ---------------------------------------------------------------------------------------------------------


def test_speeds_are_those_recorded_in_the_frame_before(make: Make) -> None:
    before = {"spawned": CAST, "velocities": moving((1, 3, 4, 12), (2, 3, -4, 12))}
    reader = make({"velocities": moving((1, 9, 9, 9))}, before, HIT | {"velocities": moving((1, 0, 0, 0), (2, 0, 0, 0))})
    assert speeds(reader) == [(13.0, 8.0)]


def test_speeds_that_are_not_recorded_are_those_of_positions_before(make: Make) -> None:
    """A frame takes 0.5 s; positions are in cm."""
    frames = ({"transforms": poses((1, 100 * n, 0, 0), (2, 0, 200 * n, 0))} for n in range(2))
    reader = make(*frames, HIT | {"transforms": poses((1, 5000, 0, 0), (2, 0, 5000, 0))})
    assert speeds(reader) == [(2.0, pytest.approx(math.hypot(2.0, 4.0)))]


@pytest.mark.parametrize("id2", [NO_ACTOR, 0, 3])
def test_what_never_moves_stands_still(make: Make, id2: int) -> None:
    reader = make({"spawned": CAST, "velocities": moving((1, 0, 5, 0))}, {"collisions": [(0, 1, id2, 0, 0)]})
    assert speeds(reader) == [(5.0, 5.0)]


def test_of_what_stands_still_the_speed_is_0(make: Make) -> None:
    reader = make({"spawned": CAST, "velocities": moving((1, 0, 5, 0))}, {"collisions": [(0, 3, 1, 0, 0)]})
    assert speeds(reader) == [(0.0, 5.0)]


@pytest.mark.parametrize(
    "before",
    [
        [],
        [{}],
        [{"transforms": poses((1, 0, 0, 0), (2, 0, 0, 0))}],
        [{"transforms": poses((1, 0, 0, 0))}, {}],
        [{}, {"transforms": poses((1, 0, 0, 0))}],
        [{"transforms": poses((1, 0, 0, 0))}, {"transforms": poses((1, 5001, 0, 0))}],
        [{"transforms": poses((1, 0, 0, 0))}, {"transforms": poses((1, math.nan, 0, 0))}],
        [{"velocities": moving((1, math.nan, 0, 0))}],
        [{"velocities": moving((1, 1, 0, 0))}, {}],
    ],
)
def test_unknown_speeds(make: Make, before: list[dict[str, Any]]) -> None:
    ((impact, relative),) = speeds(make(*before, HIT | {"velocities": moving((1, 1, 0, 0), (2, 1, 0, 0))}))
    assert math.isnan(impact)
    assert math.isnan(relative)


def test_positions_far_apart_in_time_give_no_speed(tmp_path: Path, suffix: str) -> None:
    frames = [{"transforms": poses((1, n, 0, 0), (2, n, 0, 0))} for n in range(2)]
    path = write(tmp_path / f"slow{suffix}", [*frames, HIT], durations=[1.5, 0.1, 0.1])
    with reading(path) as reader:
        assert all(map(math.isnan, speeds(reader)[0]))


def test_speeds_of_one_side_are_enough_for_the_impact(make: Make) -> None:
    ((impact, relative),) = speeds(make({"velocities": moving((1, 0, 0, 2))}, HIT))
    assert impact == 2.0
    assert math.isnan(relative)


# --- the same answers with the digest and without ------------------------------------------------------------------------

OPTIONS: list[dict[str, Any]] = [
    {},
    {"kinds": ["collision", "hard braking"]},
    {"kinds": ["blocked", "hard braking"]},
    {"kinds": ["collision", "blocked"]},
    {"deceleration": 3.0},
    {"kinds": ["collision", "hard braking"], "start": 2.0},
    {"kinds": ["collision"], "start": 1.0, "stop": 3.0},
]


class WithoutDigest(McapReader):
    """A reader of files without a digest."""

    def digest(self, part: PartName) -> None:
        return None


def answers(reader: Reader) -> Iterator[str]:
    for type1, type2 in (("a", "a"), ("h", "a"), ("v", "w")):
        yield repr(list(collisions(reader, type1, type2)))
    for options in OPTIONS:
        yield repr(list(incidents(reader, IncidentOptions(min_time=1.0, **options))))


def assert_equal_answers(*paths: Path) -> list[str]:
    found = []
    for path in paths:
        with reading(path) as reader:
            found.append(list(answers(reader)))
        if path.suffix == ".mcap":
            without = WithoutDigest(path)
            found.append(list(answers(without)))
            without.close()
    assert all(each == found[0] for each in found)
    return found[0]


def crowd(seed: int) -> tuple[Header, list[Frame]]:
    """A crowd of few actors that come and go, jump, brake, and touch each other, in frames of various lengths."""
    random = np.random.default_rng(seed)
    header = Header("Town01", 1_600_000_000)
    ids, present = np.arange(1, 6), np.ones(5, np.bool_)
    place, speed, elapsed = random.uniform(-500, 500, (5, 3)), random.uniform(0, 20, 5), 0.0
    tick = random.choice([0.05, 0.1, 0.6, 2.0])
    measured = random.random() < 0.5
    spawned = {int(id): Spawn(int(id), int(random.choice([0, 1, 1, 2])), type_id=f"kind.{id}") for id in ids}
    frames = []
    for number in range(int(random.integers(2, 120))):
        records: dict[str, Any] = {}
        if number == 0:
            late = random.random() < 0.3
            records["spawned"] = [spawn for spawn in spawned.values() if not (late and spawn.id == 3)]
        elif random.random() < 0.05:
            id = int(random.choice(ids))
            records["spawned" if not present[id - 1] or random.random() < 0.3 else "destroyed"] = (
                [Spawn(id, int(random.choice([1, 2])), type_id="again")] if not present[id - 1] else [(id,)]
            )
            present[id - 1] = not present[id - 1]
        if "spawned" in records and not all(isinstance(each, Spawn) for each in records["spawned"]):
            records["destroyed"] = records.pop("spawned")
        speed = np.maximum(0.0, speed + random.choice([0.0, 0.3, -9.0], 5) * tick)
        place[:, 0] += speed * 100 * tick
        if random.random() < 0.03:
            place[int(random.integers(5)), 1] += 30_000
        there = np.flatnonzero(present)
        records["transforms"] = poses(*((int(ids[n]), *place[n].tolist()) for n in there))
        if measured:
            records["velocities"] = moving(*((int(ids[n]), float(speed[n]), 0.0, 0.0) for n in there if n != 4))
        if random.random() < 0.3:
            pairs = random.choice([1, 2, 3, 4, NO_ACTOR], (int(random.integers(1, 4)), 2))
            records["collisions"] = [(0, int(a), int(b), int(random.random() < 0.2), 0) for a, b in pairs]
        frame = Frame(number, number + 1, elapsed, tick, [])
        frames.append(frame.replace(**records))
        elapsed += tick
    return header, frames


@settings(max_examples=8)
@given(seed=st.integers(0, 1 << 20))
def test_a_crowd(tmp_path: Path, seed: int) -> None:
    header, frames = crowd(seed)
    one_by_one = write_frames(tmp_path / "one-by-one.mcap", header, frames)
    log = write_frames(tmp_path / "crowd.log", header, frames)
    convert(log, tmp_path / "crowd.mcap", force=True)
    assert_equal_answers(log, one_by_one, tmp_path / "crowd.mcap")


@settings(max_examples=25)
@given(recording=strategies.recordings())
def test_any_recording(tmp_path: Path, recording: tuple[Header, list[Frame]]) -> None:
    with warnings_ignored():
        mcap, log = (write_frames(tmp_path / name, *recording) for name in ("any.mcap", "any.log"))
        assert_equal_answers(mcap, log)


@pytest.mark.skipif(not CARLA_LOGS.is_dir(), reason="the logs of CARLA are not here: they are not part of the repository")
def test_logs_of_carla(tmp_path: Path) -> None:
    for number, log in enumerate(sorted([*CARLA_LOGS.glob("*.log"), *sorted(RANDOM_LOGS.glob("*.log"))[:8]])):
        with warnings_ignored():
            try:
                convert(log, tmp_path / f"{number}.mcap")
            except RecapError:  # it is damaged
                continue
            assert_equal_answers(log, tmp_path / f"{number}.mcap")


def test_too_many_look_ups_read_all_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    header, frames = crowd(5)
    path = write_frames(tmp_path / "crowd.mcap", header, frames)
    with reading(path) as reader:
        expected = list(answers(reader))
    monkeypatch.setattr(contacts_module, "LOOK_UPS", 0)
    without = WithoutDigest(path)
    assert list(answers(without)) == expected
    without.close()
